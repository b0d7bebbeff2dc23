"""The default feed `named`: NAMED_VALUE_FLOAT of every battery. No ground station takes it for a measurement.

Names of the first battery: REM_S, REM_LO_S, REM_HI_S [s] and SOC [0..1]. If a route or home is known, also TURN_S [s],
the time until it must turn back, and HOME_SOC [0..1], the charge at home after turning back now. Names of battery N end
in `_N`. An unknown value is NaN, never 0. The first battery may change in flight (`headline`): names that are no longer
used stay NaN, because a ground station keeps the last value it heard, and a single message may be lost. Alarms are sent
by `announced`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from uavbatt.live.report import Report
from uavbatt.mavlink.outgoing import Outgoing


class NamedFeed:
    """NamedFeed makes the frames with the named values of every battery, at `rate_Hz` at most."""

    def __init__(self, rate_Hz: float) -> None:
        self._period_s = 1.0 / rate_Hz
        self._next_s = -math.inf
        self._names: dict[str, None] = {}  # names that were sent so far, in order

    def frames(self, now_s: float, reports: Sequence[Report], out: Outgoing) -> list[bytes]:
        """Return the frames that are due; `now_s` on the monotonic clock [s]."""
        if now_s < self._next_s:
            return []
        self._next_s = now_s + self._period_s
        values: dict[str, float] = {}
        for place, report in enumerate(reports):
            shown = report.at(now_s)
            tail = "" if place == 0 else f"_{report.instance}"
            values |= {
                f"REM_S{tail}": shown.remaining_s,
                f"REM_LO_S{tail}": shown.remaining_lo_s,
                f"REM_HI_S{tail}": shown.remaining_hi_s,
                f"SOC{tail}": shown.soc,
            }
            if (route := report.route_at(now_s)) is not None:
                values |= {f"TURN_S{tail}": route.turn_back_s, f"HOME_SOC{tail}": route.home_soc}
        values = dict.fromkeys(self._names, math.nan) | values
        self._names = dict.fromkeys(values)
        return [out.named_value(name, value, int(now_s * 1000)) for name, value in values.items()]

    def ended(self, now_s: float, out: Outgoing) -> list[bytes]:
        """Return frames that set all names to unknown, for a vehicle that is no longer followed."""
        gone, self._names = self._names, {}
        return [out.named_value(name, math.nan, int(now_s * 1000)) for name in gone]
