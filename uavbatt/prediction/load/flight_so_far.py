"""The past of a flight as far as a forecast needs it: recent load, energy drawn, whether the aircraft flies."""

from __future__ import annotations

import math
from typing import NamedTuple

from uavbatt.limits import FLYING_C_RATE, GROUNDED_C_RATE
from uavbatt.prediction.load.power_history import LOWEST_POWER_W, RecentLoad
from uavbatt.records import NAN, Sample

CRUISING_C, ARMED_LONG_S = 0.2, 60.0  # an aeroplane of long endurance, armed for so long
ALOFT_C = 0.05  # if its position shows it in the air
FLYING_TAU_S = 3.0
LANDED_AFTER_S = 90.0  # a descent may idle for a minute; an armed flag ends the flight at once
GLIDED_S = 900.0  # longest glide of an armed aircraft without a position: an autopilot disarms soon after a landing
LONGEST_ROW_S, ROW_MEMORY = 30.0, 0.9
SPOOLED_UP, SPOOL_UP_S = 1.5, 180.0
CARRIED_S = 60.0  # so long under a load that no payload draws: this was a flight, not spool-up
NEW_PIECES = 2  # the newest powers may hold the rise itself
# A load on the ground with heaters or radios on, before the motors take it up: a third of the power then, by less than
# WAITING_C; or a fifth, by less than any multirotor flies with.
WAITED, WAITING_C, SURELY_WAITED = 3.0, 0.75, 5.0


class FlightSoFar(NamedTuple):
    """FlightSoFar holds the past of a flight as a value, replaced by `after`.

    time_s : of the last row [s], NaN before the first; rate_c : smoothed C-rate; loaded_s : last row under a load that
    carries the aircraft; flying_since_s : NaN on the ground; took_off_s : begin of the flight whose energy `flown_J`
    [J] was drawn in `flown_s` [s]; row_s : usual distance of two rows [s]; armed, armed_since_s : the flag of the last
    row that had one, and since when it is so.
    """

    load: RecentLoad = RecentLoad()
    rate_c: float = 0.0
    flying_since_s: float = NAN
    loaded_s: float = NAN
    time_s: float = NAN
    row_s: float = NAN
    took_off_s: float = NAN
    flown_s: float = 0.0
    flown_J: float = 0.0
    armed: bool | None = None
    armed_since_s: float = NAN

    @property
    def mean_W(self) -> float:
        """Return the mean power of the flight [W], before there is any that of the last rows; at least 1 W."""
        return max(LOWEST_POWER_W, self.flown_J / self.flown_s if self.flown_s > 0.0 else self.load.mean_W)

    def has_carried(self, power_W: float, c_rate: float) -> bool:
        """Return True if the load so far has surely carried the aircraft, so that a rise now is another load.

        power_W, c_rate : as for `mean_c`
        """
        return self.flown_s >= CARRIED_S and self.mean_c(power_W, c_rate) >= GROUNDED_C_RATE

    def mean_c(self, power_W: float, c_rate: float) -> float:
        """Return the C-rate [1/h] of the mean power; power_W [W], c_rate [1/h] : of a row, which tell that of any."""
        return self.mean_W * (c_rate / max(power_W, LOWEST_POWER_W))

    def after(self, sample: Sample, power_W: float, c_rate: float, is_aloft: bool | None = None) -> FlightSoFar:
        """Return the past with one more row, its power [W] and its C-rate [1/h].

        is_aloft : True in the air by position or by the autopilot, None if not known (`Navigation.is_aloft`).
        """
        dt_s = sample.time_s - self.time_s if math.isfinite(self.time_s) else 0.0
        is_new_flag = sample.armed is not None and sample.armed is not self.armed
        now = (self._with_flag(sample) if is_new_flag else self)._with_rate(sample, dt_s, c_rate, is_aloft)
        if not math.isfinite(now.flying_since_s):
            return now
        load, step_s = now.load.after(sample.time_s, power_W), max(dt_s, 0.0)
        if not math.isfinite(now.took_off_s):
            return now._replace(load=load, took_off_s=sample.time_s)
        now = now._replace(load=load, flown_s=now.flown_s + step_s, flown_J=now.flown_J + step_s * power_W)
        if now.time_s - now.took_off_s <= SPOOL_UP_S:
            return now._spooled_up(power_W, SPOOLED_UP)
        mean_c = now.mean_c(power_W, c_rate)
        if is_aloft is True or power_W <= 0.0 or mean_c >= GROUNDED_C_RATE:
            return now
        return now._spooled_up(power_W, WAITED if mean_c < WAITING_C else SURELY_WAITED)

    def moved(self, shift_s: float) -> FlightSoFar:
        """Return the same past on a clock that shows `shift_s` [s] more."""
        return self._replace(
            load=self.load._replace(time_s=self.load.time_s + shift_s),
            flying_since_s=self.flying_since_s + shift_s,
            loaded_s=self.loaded_s + shift_s,
            time_s=self.time_s + shift_s,
            took_off_s=self.took_off_s + shift_s,
            armed_since_s=self.armed_since_s + shift_s,
        )

    def _with_flag(self, sample: Sample) -> FlightSoFar:
        """Return the past with the armed flag of a row in which it has changed.

        Arming begins a flight, because the load before it was that of a payload. If the load already carries the
        aircraft, the flag was wrong for a moment (one damaged heartbeat).
        """
        if self.armed is False and not math.isfinite(self.flying_since_s):
            self = FlightSoFar(rate_c=self.rate_c, time_s=self.time_s, row_s=self.row_s)
        return self._replace(armed=sample.armed, armed_since_s=sample.time_s)

    def _least_c(self, sample: Sample, is_aloft: bool | None) -> float:
        """Return the C-rate [1/h] from which the load carries the aircraft, by what is known beside it."""
        if sample.armed is False or is_aloft is False:
            return GROUNDED_C_RATE
        if is_aloft:
            return ALOFT_C
        is_long = sample.armed is True and sample.time_s - self.armed_since_s >= ARMED_LONG_S
        return CRUISING_C if is_long else FLYING_C_RATE

    def _landed_after_s(self, is_aloft: bool | None) -> float:
        """Return how long no load may carry the aircraft before it has landed [s], if it is not seen in the air."""
        return GLIDED_S if self.armed is True and is_aloft is None else LANDED_AFTER_S

    def _with_rate(self, sample: Sample, dt_s: float, c_rate: float, is_aloft: bool | None) -> FlightSoFar:
        """Return the past with the row's time and C-rate, and with the aircraft in flight or on the ground by them."""
        row_s, time_s = self.row_s, sample.time_s
        if 0.0 < dt_s <= LONGEST_ROW_S:
            row_s = dt_s + (row_s - dt_s) * ROW_MEMORY if math.isfinite(row_s) else dt_s
        rate_c = c_rate + (self.rate_c - c_rate) * math.exp(-max(dt_s, 0.0) / FLYING_TAU_S) if dt_s else c_rate
        since_s, loaded_s = self.flying_since_s, self.loaded_s
        if rate_c >= self._least_c(sample, is_aloft):
            since_s, loaded_s = since_s if math.isfinite(since_s) else time_s, time_s
        elif sample.armed is False or not (is_aloft is True or time_s - loaded_s < self._landed_after_s(is_aloft)):
            since_s = NAN
        return self._replace(time_s=time_s, row_s=row_s, rate_c=rate_c, flying_since_s=since_s, loaded_s=loaded_s)

    def _spooled_up(self, power_W: float, times: float) -> FlightSoFar:
        """Begin the flight at this row if its power is far above all power before it, which was spool-up or waiting.

        The power is compared with all powers before it, not with their mean, which every burst of a motor that runs at
        intervals exceeds.
        """
        before_W = max((self.mean_W, *self.load.history.pieces_W[:-NEW_PIECES]))
        if not (self.flown_s > 0.0 and self.load.gust_W > times * before_W):
            return self
        fresh = RecentLoad().after(self.time_s, power_W)
        return self._replace(load=fresh, took_off_s=self.time_s, flown_s=0.0, flown_J=0.0)
