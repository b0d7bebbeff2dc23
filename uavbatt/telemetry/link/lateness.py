"""Delay of a vehicle's frames, measured by its own clock: a modem or a tunnel may hold frames back for a minute.

    offset = time of reception - time since its boot     delay = least offset in LOOK_S - base

The base is the least offset that two frames in a row have shown, which is the fastest that this link gets (a single
damaged frame with a good checksum would make all others late). It rises by DRIFT, because two clocks never run alike.
So a link that was late from its first frame on looks fresh. A clock that stands still shows nothing. If the clock falls
back to less than the time of silence before it, or to its first minute, it has begun anew (a reboot, or 49.7 days are
over), and the base begins anew too. If it falls back to more, the same frames came by a slower way. A clock that is off
by more than any link delays is that of another source, such as a replayed log.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from uavbatt.mavlink import framing

SYSTEM_TIME, ATTITUDE, LOCAL_POSITION_NED, GLOBAL_POSITION_INT = 2, 30, 32, 33
BOOT_TIME_AT = {SYSTEM_TIME: 8, ATTITUDE: 0, LOCAL_POSITION_NED: 0, GLOBAL_POSITION_INT: 0}  # place in the payload
BOOT_TIME_BYTES = 4  # milliseconds
DRIFT = 2e-4  # drift of a cheap crystal in the cold [s/s]
LOOK_S = 2.0  # the link is late only if all frames of this time are late
BEGUN_S = 1.0  # tolerance of a boot that seems earlier than possible, because the frames before it were late
JUST_BOOTED_S = 60.0
LONGEST_S = 200.0  # longest delay of a link
KNOWN_S = 30.0  # the delay is unknown if the clock has not been heard for so long


def boot_time_s(frame: bytes, message_id: int) -> float:
    """Return the time since the vehicle's boot [s] in a frame of a message in BOOT_TIME_AT."""
    begin = framing.V2_HEADER if frame[0] == framing.V2 else framing.V1_OVERHEAD - 2
    first, end = begin + BOOT_TIME_AT[message_id], begin + frame[1]
    return int.from_bytes(frame[first : min(first + BOOT_TIME_BYTES, end)], "little") / 1000.0


class ClockOffset(NamedTuple):
    """ClockOffset holds the offset that a frame showed [s], and when it was received [s]."""

    at_s: float
    offset_s: float


class Lateness(NamedTuple):
    """Lateness holds the offsets seen of a vehicle's clock; it is a value, replaced by `after`."""

    boot_s: float = math.nan  # of the last frame
    base: ClockOffset | None = None
    recent: tuple[ClockOffset, ...] = ()  # those of LOOK_S that no later one is smaller than

    def after(self, at_s: float, boot_s: float) -> Lateness:
        """Return the new value after a frame that was received at `at_s` [s] and sent `boot_s` [s] after the boot."""
        seen = ClockOffset(at_s, at_s - boot_s)
        if boot_s == self.boot_s:
            return self
        if not self.recent or self._is_another(seen, boot_s):
            return Lateness(boot_s, None, (seen,))
        shown_twice_s = max(seen.offset_s, self.recent[-1].offset_s)
        risen_s = self.base.offset_s + DRIFT * (at_s - self.base.at_s) if self.base is not None else math.inf
        lower = (was for was in self.recent if at_s - was.at_s <= LOOK_S and was.offset_s < seen.offset_s)
        return Lateness(boot_s, ClockOffset(at_s, min(risen_s, shown_twice_s)), (*lower, seen))

    def _is_another(self, seen: ClockOffset, boot_s: float) -> bool:
        """Return True if the clock has begun anew, or is no longer the one that was heard."""
        last, base = self.recent[-1], self.base or self.recent[-1]
        has_begun = boot_s < self.boot_s and boot_s <= max(seen.at_s - last.at_s + BEGUN_S, JUST_BOOTED_S)
        return has_begun or seen.offset_s - base.offset_s > LONGEST_S

    def late_s(self, now_s: float) -> float:
        """Return the delay of the frames [s]; 0 if the clock has not been heard lately."""
        if self.base is None or now_s - self.recent[-1].at_s > KNOWN_S:
            return 0.0
        return max(min(seen.offset_s for seen in self.recent) - self.base.offset_s, 0.0)
