"""Requests to the autopilot, if the operator allows them (`--request`): a message rate, and parameters.

The parameters are those of the batteries, and of a vehicle that has a home or a mission those of its speeds and its
way home.

SET_MESSAGE_INTERVAL is sent while BATTERY_STATUS comes slower than half the wanted rate, with growing pauses.
PARAM_REQUEST_READ is sent a few times for each parameter that is not known, again after a gap (the pack may have been
changed), and at once for a parameter that seems to have changed in flight (see `HeardParameters`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from uavbatt.mavlink import fields
from uavbatt.mavlink.outgoing import Outgoing
from uavbatt.telemetry.parameters import HeardOnce, ardupilot_prefix, is_of_pack

FIRST_PAUSE_S, LONGEST_PAUSE_S = 2.0, 30.0
PARAMETER_PAUSE_S = 0.1
AGAIN_PAUSE_S = 1.0
MOST_ASKED = 4
OF_ARDUPILOT = (
    "CAPACITY", "LOW_VOLT", "CRT_VOLT", "LOW_MAH", "CRT_MAH", "FS_LOW_ACT", "FS_CRT_ACT", "OPTIONS", "MONITOR",
    "SUM_MASK",
)  # fmt: skip
OF_PX4 = ("COM_LOW_BAT_ACT", "BAT_CRIT_THR")  # of all batteries together


def parameter_names(instances: Iterable[int], is_px4: bool) -> list[str]:
    """Return the names of the parameters that describe the packs of these batteries."""
    names = []
    for instance in sorted(instances) or [0]:
        if is_px4:
            names += [f"BAT{instance + 1}_{what}" for what in ("N_CELLS", "CAPACITY", "V_EMPTY")]
        else:
            names += [ardupilot_prefix(instance) + what for what in OF_ARDUPILOT]
    return [*names, *OF_PX4] if is_px4 else names


class Requests:
    """Requests decides what to ask the autopilot for, and counts what was asked."""

    def __init__(self, rate_Hz: float) -> None:
        self._rate_Hz = rate_Hz
        self._pause_s, self._rate_next_s, self._name_next_s = FIRST_PAUSE_S, float("-inf"), float("-inf")
        self._asked: dict[str, int] = {}
        self._again: dict[str, tuple[float, int, float]] = {}  # doubted name -> value, times asked, next time [s]
        self._rows, self._rows_since_s = 0, 0.0

    def row(self) -> None:
        """Count a BATTERY_STATUS that has come."""
        self._rows += 1

    def begin_again(self) -> None:
        """Ask for everything again: after a gap the pack may have been changed."""
        self._asked.clear()
        self._pause_s, self._rate_next_s = FIRST_PAUSE_S, float("-inf")

    def again(self, now_s: float, component: int, doubted: Mapping[str, HeardOnce], out: Outgoing) -> list[bytes]:
        """Return requests for parameters whose change in flight is in doubt: at once, then every second a few times."""
        made = []
        for name, doubt in doubted.items():
            if is_of_pack(name):  # the battery says it again by itself
                continue
            was, times, next_s = self._again.get(name, (doubt.value, 0, now_s))
            if was != doubt.value:
                times, next_s = 0, now_s
            if times < MOST_ASKED and now_s >= next_s:
                self._again[name] = (doubt.value, times + 1, now_s + AGAIN_PAUSE_S)
                made.append(out.parameter_request(component, name))
        self._again = {name: asked for name, asked in self._again.items() if name in doubted}
        return made

    def frames(
        self, now_s: float, component: int, known: Mapping[str, float], names: Iterable[str], out: Outgoing
    ) -> list[bytes]:
        """Return the requests that are due: for the rate of BATTERY_STATUS, and for a parameter not known yet."""
        made = []
        if now_s >= self._rate_next_s:
            elapsed_s = now_s - self._rows_since_s
            if self._rows < 0.5 * self._rate_Hz * elapsed_s or self._rate_next_s == float("-inf"):
                made.append(out.interval_request(component, fields.BATTERY_STATUS, self._rate_Hz))
                self._pause_s = min(2.0 * self._pause_s, LONGEST_PAUSE_S)
            self._rows, self._rows_since_s, self._rate_next_s = 0, now_s, now_s + self._pause_s
        if now_s >= self._name_next_s and (name := self._next_name(known, names)):
            self._asked[name] = self._asked.get(name, 0) + 1
            self._name_next_s = now_s + PARAMETER_PAUSE_S
            made.append(out.parameter_request(component, name))
        return made

    def _next_name(self, known: Mapping[str, float], names: Iterable[str]) -> str:
        """Return the parameter to ask for: one asked for least often so far; empty if none is to be asked for.

        Each is asked for once, also a known one, then those that are not known, a few times: a vehicle has not all.
        """
        asked = ((self._asked.get(name, 0), name in known, name) for name in names)
        due = [(times, name) for times, is_known, name in asked if times < (1 if is_known else MOST_ASKED)]
        return min(due, key=lambda one: one[0], default=(0, ""))[1]
