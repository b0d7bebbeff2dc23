"""One flight of a pack that is not ours through the estimator, against its truth: figures and lines."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from peers.columns import FloatArray

from scoring.lines import Lines, ours
from scoring.other_pack import CELLS, FULL_AH, Flown, Make
from scoring.wrong_cases import GAUGED, GENERIC, Case, fitted
from uavbatt.battery import battery_file
from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.estimation.monitor import FAR_OFF, SMALL
from uavbatt.estimator import Estimator
from uavbatt.log_replay.run import ReplayedRow, steps
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.prediction.voltage_bound import FALLS_FASTER
from uavbatt.records import PackFacts

PERIOD_S = 5.0
BEFORE_END_S = (120.0, 60.0, 20.0, 5.0)
LAST_S, SETTLED_S = 120.0, 30.0
WORDS = (FALLS_FASTER, SMALL, FAR_OFF)
NAN = math.nan


@dataclass(frozen=True, slots=True)
class Said:
    """Said holds what was shown at an instant, and how long it really took [s]; NaN where refused."""

    true_s: float
    median_s: float
    lo_s: float
    hi_s: float

    @property
    def error_s(self) -> float:
        """Return the error of the median [s]; positive is too long."""
        return self.median_s - self.true_s


@dataclass(frozen=True, slots=True)
class Judged:
    """Judged holds a flight in figures [s]; shares are of its rows in the air."""

    case: Case
    flown_s: float
    half: Said
    before: dict[float, Said]
    lo_excess_s: float  # of the 5 % point over the truth, the worst of the last two minutes; NaN: all refused
    covered: float  # of the 90 % interval, a refusal is a miss
    refused: float
    alarm_s: float  # true time left at the two-minute alarm; 0: never
    words_s: float  # true time left when a warning first said what is wrong; NaN: never
    nees: float  # of soc
    soc_rmse: float


@cache
def battery(name: str, make: Make) -> BatteryFile:
    """Return a packaged battery by its name, the generic one of LiPo cells, or one fitted to the make."""
    packaged = battery_file.GENERIC if name in (GENERIC, GAUGED) else name
    return battery_file.read_battery(packaged) if packaged in battery_file.packaged() else fitted(make, name)


def estimator(case: Case) -> Estimator:
    """Return a fresh estimator that is told what is stated of the pack."""
    options = PackOptions(cells=CELLS, capacity_Ah=NAN if told(case) else FULL_AH, cutoff_V=case.cutoff_V)
    return Estimator(battery(case.battery, case.make), options, ForecastSettings(forecast_period_s=PERIOD_S))


def told(case: Case) -> tuple[tuple[float, PackFacts], ...]:
    """Return what a smart pack tells of itself from the first row on; nothing of another pack."""
    facts = PackFacts(capacity_Ah=FULL_AH, full_share=case.full_share)
    return ((0.0, facts),) if case.battery == GAUGED else ()


def replayed(case: Case) -> tuple[Flown, list[ReplayedRow]]:
    """Return the flight, and every row of it through an estimator."""
    flown = case.flown()
    return flown, list(steps(replace(flown.flight(case.name), facts=told(case)), estimator(case)))


def judged(case: Case) -> Judged:
    """Return a flight, flown and in figures."""
    return judge(case, *replayed(case))


def judged_through(case: Case, misread: Callable[[float], float]) -> Judged:
    """Return a flight in figures, whose voltmeter shows `misread(volts)`; the end is that of the true voltage."""
    flown = case.flown()
    shown = replace(flown, rows=tuple(replace(s, voltage_V=misread(s.voltage_V)) for s in flown.rows))
    return judge(case, flown, list(steps(shown.flight(case.name), estimator(case))))


def late_excess_s(lines: Lines, end_s: float) -> FloatArray:
    """Return by how much the 5 % point was too long in each line of the last two minutes [s]; NaN where refused."""
    assert lines.lo_s is not None
    late = lines.time_s > end_s - LAST_S
    return np.asarray(lines.lo_s[late] - (end_s - lines.time_s[late]))


def worst_s(excess_s: FloatArray) -> float:
    """Return the largest excess that is known [s]; NaN if none is."""
    return float(np.nanmax(excess_s)) if np.isfinite(excess_s).any() else NAN


def judge(case: Case, flown: Flown, run: Sequence[ReplayedRow]) -> Judged:
    """Return the figures of what was said of a flight."""
    lines, start_s, end_s = ours(run), flown.start_s, flown.end_s
    score = lines.scored(case.name, case.battery, start_s, end_s)
    columns = np.stack([lines.time_s, lines.remaining_s, *(c for c in (lines.lo_s, lines.hi_s) if c is not None)])
    excess_s = late_excess_s(lines, end_s)
    nees, rmse = _charge(run, flown, start_s + SETTLED_S)
    words = [s.estimate.time_s for s in run if any(w in s.estimate.warnings for w in WORDS)]
    return Judged(
        case,
        flown_s=end_s - start_s,
        half=_said(columns, start_s + 0.5 * (end_s - start_s), end_s),
        before={left_s: _said(columns, end_s - left_s, end_s) for left_s in BEFORE_END_S},
        lo_excess_s=worst_s(excess_s),
        covered=score.coverage,
        refused=score.refused,
        alarm_s=score.alarm_at_s,
        words_s=end_s - words[0] if words else NAN,
        nees=nees,
        soc_rmse=rmse,
    )


def _said(columns: FloatArray, at_s: float, end_s: float) -> Said:
    """Return the last row at or before an instant."""
    time_s, median_s, lo_s, hi_s = (float(c) for c in columns[:, int(np.searchsorted(columns[0], at_s + 1e-6)) - 1])
    return Said(end_s - time_s, median_s, lo_s, hi_s)


def _charge(run: Sequence[ReplayedRow], flown: Flown, since_s: float) -> tuple[float, float]:
    """Return NEES and root mean square error of the state of charge."""
    known = [(s.estimate.soc, s.estimate.soc_sd, s.estimate.time_s) for s in run]
    soc, sd, time_s = (np.array(c) for c in zip(*known, strict=True))
    apart = soc - np.array(flown.soc)
    counts = (time_s >= since_s) & np.isfinite(soc) & (sd > 0.0)
    if not counts.any():
        return NAN, NAN
    return float(np.mean((apart[counts] / sd[counts]) ** 2)), float(np.sqrt(np.mean(apart[counts] ** 2)))
