"""Outcome of a replay: the flight in figures, its landing, and the forecasts against the end that the log shows."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uavbatt.battery.model import Array
from uavbatt.log_replay.in_air import InAir, first_below_s, in_air
from uavbatt.log_replay.run import ReplayedRow
from uavbatt.nan_equal import nan_equal
from uavbatt.prediction.load.waits import Waits, in_air_s, waits_of
from uavbatt.records import NAN, Status

AT_REST_S = 5.0  # a log whose load ends this soon before its end was cut in the air
FORGOTTEN_S, SETTLING_S = 30.0, 60.0
CHECKPOINTS_S = (360.0, 240.0, 120.0, 60.0)


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """A checkpoint compares the forecast at one instant with the end that the log shows.

    Attributes:
        label: the instant in words.
        before_end_s: time left in truth [s].
        remaining_s: the forecast's median [s]; NaN if it was refused.
        lo_s: its 5 % point [s].
        hi_s: its 95 % point [s].
    """

    label: str
    before_end_s: float
    remaining_s: float
    lo_s: float
    hi_s: float

    @property
    def error_s(self) -> float:
        """Return forecast less truth [s]: positive is optimistic, NaN if the forecast was refused."""
        return self.remaining_s - self.before_end_s

    @property
    def inside(self) -> bool:
        """Return True if the truth lies in the 90 % interval."""
        return self.lo_s <= self.before_end_s <= self.hi_s


@nan_equal
@dataclass(frozen=True, slots=True)
class Landing:
    """Landing tells how much longer the aircraft could have flown, by the forecast at the last row in the air.

    time_s [s] is the row's; the forecasts [s] are NaN where none was given there. is_cut: the log ends in the air.
    current_lost_s: since when there was no current to tell by [s]; NaN where there was one.
    """

    time_s: float
    remaining_s: float
    remaining_lo_s: float
    remaining_hi_s: float
    remaining_to_low_s: float
    reason: str = ""
    is_cut: bool = False
    current_lost_s: float = NAN


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome describes a replayed flight in figures; NaN is unknown.

    Attributes:
        rows: rows of the battery.
        duration_s: from the first row to the last [s].
        air_s: time in the air, from the first take-off to the last landing, without the waits [s].
        end_voltage_V: of the pack at the last row [V].
        end_soc: state of charge at the last row, 0 to 1.
        end_soc_sd: its standard deviation.
        end_of_flight_s: when the log itself reaches the end of flight [s].
        refused_in_air: share of the rows in the air, after the first minute, without a forecast.
        mean_nis: mean normalised innovation squared; 1 is what the filter expects.
        checkpoints: forecasts before that end, with their errors; empty without one, and with a reserve.
        landing: the forecast at the last row in the air; None if the log shows no flight.
        reserve_soc: state of charge at which the forecasts end the flight, too; 0 is off.
        waits: on the ground: begin and end of each [s].
    """

    rows: int
    duration_s: float
    air_s: float
    end_voltage_V: float
    end_soc: float
    end_soc_sd: float
    end_of_flight_s: float
    refused_in_air: float
    mean_nis: float
    checkpoints: tuple[Checkpoint, ...]
    landing: Landing | None = None
    reserve_soc: float = 0.0
    waits: Waits = ()

    @property
    def flown_on_s(self) -> float:
        """Return how long the aircraft was in the air after its end of flight [s]; NaN if it did not reach one."""
        return self.landing.time_s - self.end_of_flight_s if self.landing is not None else NAN

    def left_s(self, time_s: ArrayLike) -> Array:
        """Return how much longer the aircraft was in the air, from some times [s] to the end of flight [s].

        Time on the ground between two flights of a pack does not count, as it does not count in a forecast.
        """
        return in_air_s(time_s, self.end_of_flight_s, self.waits)


def outcome(run: list[ReplayedRow], cutoff_V: float, reserve_soc: float = 0.0) -> Outcome:
    """Return the figures of a finished replay; forecasts are judged by the end of flight that the log itself shows.

    cutoff_V : cut-off of the pack [V]. With a reserve the forecasts are not judged, because the log shows only when the
    voltage ended the flight.
    """
    time_s, volts, nis = np.array([(s.estimate.time_s, s.estimate.voltage_V, s.estimate.nis) for s in run]).T
    air = in_air(run)
    flown_s = time_s[air.flying]
    end_s = first_below_s(time_s, volts, air, cutoff_V)
    waits = waits_of(time_s, np.array([row.armed is False for row in run]), air.flying)
    is_judged = math.isfinite(end_s) and reserve_soc == 0.0
    is_flight = time_s >= (flown_s[0] if flown_s.size else time_s[0])
    end_soc, end_soc_sd = _charge_at_end(run, air)
    return Outcome(
        rows=len(run),
        duration_s=float(time_s[-1] - time_s[0]),
        air_s=float(in_air_s(flown_s[0], flown_s[-1], waits)) if flown_s.size else NAN,
        end_voltage_V=float(volts[np.isfinite(volts)][-1]) if np.isfinite(volts).any() else NAN,
        end_soc=end_soc,
        end_soc_sd=end_soc_sd,
        end_of_flight_s=end_s,
        refused_in_air=_refused_share(run, air),
        mean_nis=float(np.nanmean(nis)) if np.isfinite(nis).any() else NAN,
        checkpoints=_checkpoints(run, in_air_s(time_s, end_s, waits), is_flight) if is_judged else (),
        landing=_landing(run, air if np.isfinite(air.loaded_A) else air._replace(flying=np.isfinite(volts))),
        reserve_soc=reserve_soc,
        waits=waits,
    )


def _charge_at_end(run: list[ReplayedRow], air: InAir) -> tuple[float, float]:
    """Return the last state of charge and its standard deviation; NaN where it was refused or is not known any more."""
    known = [s.estimate for s in run if math.isfinite(s.estimate.soc)]
    complete = [s for s in known if math.isfinite(s.innovation_V)]  # others are refused for want of a reading alone
    if not complete or complete[-1].status is Status.REFUSED or _is_forgotten(run, air):
        return NAN, NAN
    return known[-1].soc, known[-1].soc_sd


def _refused_share(run: list[ReplayedRow], air: InAir) -> float:
    """Return the share of the rows in the air, after the first minute, without a forecast; NaN if there are none."""
    flown = [row for row, is_flying in zip(run, air.flying, strict=True) if is_flying]
    judged = [row for row in flown if row.estimate.time_s > flown[0].estimate.time_s + SETTLING_S]
    return sum(row.remaining.status is Status.REFUSED for row in judged) / len(judged) if judged else NAN


def _is_forgotten(run: list[ReplayedRow], air: InAir) -> bool:
    """Return True if the flight went on for longer than FORGOTTEN_S without its current: what it drew is not known."""
    lost = air.lost_at_end
    return bool(lost.size) and run[lost[-1]].estimate.time_s - run[lost[0]].estimate.time_s > FORGOTTEN_S


def _landing(run: list[ReplayedRow], air: InAir) -> Landing | None:
    """Return the forecast at the last row in the air, or at the last one before it that was given one.

    If that row has none, the last one before it counts, up to FORGOTTEN_S old: a descending aircraft draws so little
    that a row may have no forecast.
    """
    flying = np.flatnonzero(air.flying)
    if not flying.size:
        return None
    last = int(flying[-1])
    end_s = run[last].estimate.time_s
    is_cut = run[-1].estimate.time_s - end_s < AT_REST_S
    for k in flying[::-1]:
        said = run[k].remaining
        if end_s - said.time_s > FORGOTTEN_S:
            break
        if math.isfinite(said.remaining_s):
            numbers = (said.remaining_s, said.remaining_lo_s, said.remaining_hi_s, said.remaining_to_low_s)
            return Landing(said.time_s, *numbers, is_cut=is_cut)
    lost_s = run[air.lost_at_end[0]].estimate.time_s if air.lost_at_end.size else NAN
    return Landing(end_s, NAN, NAN, NAN, NAN, run[last].remaining.reason, is_cut, lost_s)


def _checkpoints(run: list[ReplayedRow], left_s: Array, is_flight: NDArray[np.bool_]) -> tuple[Checkpoint, ...]:
    """Return the forecasts at half time and at fixed times before the end.

    left_s : true time left at each row [s]; is_flight : False before the first take-off
    """
    wanted = [("half time", float(left_s[is_flight][0]) / 2.0)] + [(f"{s:.0f} s before", s) for s in CHECKPOINTS_S]
    found = []
    for label, before_s in wanted:
        index = int(np.searchsorted(-left_s, -before_s + 1e-6, side="right")) - 1
        if index < 0 or not is_flight[index]:
            continue
        line = run[index].remaining
        true_s = float(left_s[index]) + run[index].estimate.time_s - line.time_s
        found.append(Checkpoint(label, true_s, line.remaining_s, line.remaining_lo_s, line.remaining_hi_s))
    return tuple(found)
