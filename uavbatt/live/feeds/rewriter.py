"""Writing the time left into BATTERY_STATUS frames on their way to the ground station (see `proxy`)."""

from __future__ import annotations

import struct
from typing import NamedTuple

from uavbatt.mavlink.framing import battery_of, header, pieces, with_battery

ESTIMATE_LAYOUT = "<BBBBddd"  # system, component, battery id, status, remaining [s], soc [0..1], monotonic time [s]
NOTHING, CONVERGING, OK = 0, 1, 2
SILENT_AFTER_S = 3.0


class LastEstimate(NamedTuple):
    """LastEstimate holds the last estimate of one battery, as the control socket carried it."""

    status: int
    remaining_s: float
    soc: float
    since_s: float


class Rewriter:
    """Rewriter holds the last estimate of each battery, and writes its time into the battery's frames."""

    def __init__(self, soc: bool) -> None:
        self.known: dict[tuple[int, int, int], LastEstimate] = {}
        self.rewritten = 0
        self.replaced: dict[tuple[int, int, int], tuple[int, int]] = {}  # autopilot's own time, and ours [s]
        self._soc = soc

    def take(self, body: bytes) -> None:
        """Take in an estimate, packed as ESTIMATE_LAYOUT."""
        if len(body) == struct.calcsize(ESTIMATE_LAYOUT):
            system, component, battery, *rest = struct.unpack(ESTIMATE_LAYOUT, body)
            self.known[system, component, battery] = LastEstimate(*rest)

    def frame(self, frame: bytes, now_s: float) -> bytes:
        """Return the frame with the time left, or unchanged if it must not carry one."""
        if not self.known:
            return frame
        battery = battery_of(frame)
        if battery is None:
            return frame
        sender = header(frame)
        key = (sender.system, sender.component, battery.id)
        known = self.known.get(key)
        if known is None or known.status == NOTHING or not 0.0 <= now_s - known.since_s <= SILENT_AFTER_S:
            return frame
        if battery.time_remaining_s != 0 and known.status != OK:
            return frame
        if not 0.0 <= known.remaining_s < 1e6:
            return frame
        left_s = max(int(known.remaining_s - (now_s - known.since_s)), 1)
        percent = round(known.soc * 100.0) if self._soc and 0.0 <= known.soc <= 1.0 else None
        self.rewritten += 1
        if battery.time_remaining_s != 0:
            self.replaced[key] = (battery.time_remaining_s, left_s)
        return with_battery(frame, left_s, percent)

    def datagram(self, data: bytes, now_s: float) -> bytes:
        """Return a datagram with its frames rewritten."""
        return b"".join(
            self.frame(data[begin:end], now_s) if whole else data[begin:end] for begin, end, whole in pieces(data)
        )
