"""Scores of the forecasts of one flight, and of many, in seconds.

r* is the true remaining time, t_E the end of flight, [t_P, t_E] the window from the first line to the end. The
forecast **in force** at an instant is the last line at or before it, less its age (what a display shows
between two telemetry rows); older than `forecast_lines.MAX_AGE_S` it counts as refused. A line is its median, 5 % and
95 % point, read as a distribution the way `metrics` says.

- MAE, bias: of forecast - r*, over flights, at `BEFORE_END_S` and `OF_FLIGHT`, with standard errors.
- alpha-lambda: the mass inside (1 +- alpha) r* at t_P + lambda (t_E - t_P) is at least beta.
- prognostic horizon: t_E - the first line from which the mass inside r* +- alpha (t_E - t_P) stays >= beta.
- cumulative relative accuracy (CRA): mean over lines of 1 - |median - r*|/r*, lines with r* >= `CRA_FLOOR_S`.
- coverage and width of the 90 % interval, CRPS; the true time left when the two-minute alarm is raised.

**A refusal (NaN) is a miss in every score**: it counts as a forecast of 0 s. So MAE and CRPS take the whole r*, bias
takes -r*, the accuracy of that line in CRA is 0, the interval and alpha-lambda miss, the prognostic horizon starts
after it, and it raises no alarm. Only the width is a mean over the lines that have an interval: read it together with
coverage and the count of refusals. A median without an interval misses coverage; an upper point of +inf covers, and
makes width and CRPS infinite.

Reference: Saxena et al., Metrics for offline evaluation of prognostic performance, IJPHM 1 (2010).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from uavbatt.records import NAN
from uavbatt.scoring.forecast_lines import MAX_AGE_S, ForecastLines
from uavbatt.scoring.metrics import FloatArray, binomial_interval

BEFORE_END_S = (360.0, 240.0, 120.0, 60.0)
OF_FLIGHT = (0.25, 0.5, 0.75)
ALPHAS, LAMBDA, BETA = (0.1, 0.2), 0.5, 0.5
HORIZON_ALPHA = 0.1
ALARM_S = 120.0
CRA_FLOOR_S = 30.0  # nearer to the end than this [s] the relative accuracy divides by next to nothing


@dataclass(frozen=True, slots=True)
class Instant:
    """An Instant holds the forecast in force at one time; `inside` is None where the method gives no interval."""

    truth_s: float
    forecast_s: float  # NaN: refused
    width_s: float
    inside: bool | None
    crps_s: float

    @property
    def error_s(self) -> float:
        """Return forecast - truth [s]; a refusal counts as the forecast 0."""
        return (0.0 if math.isnan(self.forecast_s) else self.forecast_s) - self.truth_s


@dataclass(frozen=True, slots=True)
class FlightScore:
    """A FlightScore holds all scores of one flight. Shares and means are over its lines; times in seconds."""

    name: str
    group: str
    start_s: float
    end_s: float
    at: Mapping[str, Instant]  # "360 s", ... "25 %", ...; an instant before the first line is absent
    alpha_lambda: Mapping[float, float]  # alpha -> mass within (1 +- alpha) r* at lambda
    horizon_s: float
    cra: float
    refused: float
    coverage: float  # NaN without an interval
    coverage_thirds: tuple[float, ...]  # of the lines in each third of the flight
    width_s: float
    crps_s: float
    alarm_at_s: float  # true time left when the two-minute alarm is raised; 0: never raised

    @property
    def alarm_early_s(self) -> float:
        """Return how long before two true minutes the alarm came [s]; negative: late."""
        return self.alarm_at_s - ALARM_S


def score_flight(
    name: str,
    time_s: ArrayLike,
    remaining_s: ArrayLike,
    lo_s: ArrayLike | None = None,
    hi_s: ArrayLike | None = None,
    *,
    end_s: float,
    start_s: float | None = None,
    group: str = "",
    alarm_remaining_s: ArrayLike | None = None,
) -> FlightScore:
    """Score the forecast lines of one flight, NaN where refused, against its end `end_s`.

    start_s : t_P, default the first line; lo_s, hi_s : 5 and 95 % points, left out by a method without them
    alarm_remaining_s : the times that are compared with two minutes, default the median
    """
    interval = lo_s is not None and hi_s is not None
    points = [remaining_s, lo_s if interval else remaining_s, hi_s if interval else remaining_s]
    alarm = remaining_s if alarm_remaining_s is None else alarm_remaining_s
    table = _before_end(name, np.array([time_s, *points, alarm], dtype=float), start_s, end_s)
    lines = ForecastLines(table[0], table[1:4], interval)
    begin_s = float(table[0, 0]) if start_s is None else start_s
    truth_s = end_s - lines.time_s
    inside, window_s = lines.inside(truth_s), end_s - begin_s
    third = np.minimum((3.0 * (lines.time_s - begin_s) / window_s).astype(int), 2)
    accuracy = 1.0 - np.abs(lines.as_scored()[0] - truth_s) / truth_s
    halfway = lines.in_force(np.array([begin_s + LAMBDA * window_s]))
    left_s = np.array([(1.0 - LAMBDA) * window_s])
    return FlightScore(
        name=name,
        group=group,
        start_s=begin_s,
        end_s=end_s,
        at=_instants(lines, begin_s, end_s),
        alpha_lambda={alpha: float(halfway.mass(left_s, alpha * left_s)[0]) for alpha in ALPHAS},
        horizon_s=_horizon_s(truth_s, lines.mass(truth_s, HORIZON_ALPHA * window_s)),
        cra=_mean(accuracy[truth_s >= CRA_FLOOR_S]),
        refused=_mean(np.isnan(lines.points[0])),
        coverage=_mean(inside),
        coverage_thirds=tuple(_mean(inside[third == part]) for part in range(3)),
        width_s=_mean(lines.width_s()),
        crps_s=_mean(lines.crps_s(truth_s)),
        alarm_at_s=_alarm_at_s(lines.time_s, table[4], end_s),
    )


def _before_end(name: str, table: FloatArray, start_s: float | None, end_s: float) -> FloatArray:
    """Return the columns of the lines from the start to the end of a flight; the first row of the table is their time.

    Raises ValueError if the lines are not in the order of time, if there are none, or if the end is not known.
    """
    table = table[:, (table[0] < end_s) & (table[0] >= (-math.inf if start_s is None else start_s))]
    if np.any(np.diff(table[0]) < 0.0):
        raise ValueError(f"{name}: expected forecast lines in the order of time")
    if not math.isfinite(end_s) or table.shape[1] == 0:
        raise ValueError(f"{name}: expected a finite end and forecast lines before it, found end_s = {end_s}")
    return table


def _mean(values: ArrayLike) -> float:
    """Return the mean of the known values; NaN if none is known."""
    finite = np.asarray(values, float)
    finite = finite[~np.isnan(finite)]
    return float(np.mean(finite)) if finite.size else NAN


def _instant_times_s(begin_s: float, end_s: float) -> dict[str, float]:
    """Return the label and the time [s] of each usual instant: before the end, and at a part of the flight."""
    before = {f"{left_s:g} s": end_s - left_s for left_s in BEFORE_END_S}
    return before | {f"{part:.0%}": begin_s + part * (end_s - begin_s) for part in OF_FLIGHT}


def _instants(lines: ForecastLines, begin_s: float, end_s: float) -> dict[str, Instant]:
    """Return the forecasts in force at the usual instants that the lines reach."""
    instants: dict[str, Instant] = {}
    for label, at_s in _instant_times_s(begin_s, end_s).items():
        if at_s < lines.time_s[0] - 1e-6:
            continue
        line, truth_s = lines.in_force(np.array([at_s])), np.array([end_s - at_s])
        inside = bool(line.inside(truth_s)[0]) if lines.interval else None
        width_s, crps_s = float(line.width_s()[0]), float(line.crps_s(truth_s)[0])
        instants[label] = Instant(float(truth_s[0]), float(line.points[0, 0]), width_s, inside, crps_s)
    return instants


def _horizon_s(truth_s: FloatArray, mass: FloatArray) -> float:
    """Return the true time left at the first line from which all masses stay at beta or more; 0 if the last is less."""
    missed = np.flatnonzero(mass < BETA)
    first = int(missed[-1]) + 1 if missed.size else 0
    return float(truth_s[first]) if first < truth_s.size else 0.0


def _alarm_at_s(time_s: FloatArray, remaining_s: FloatArray, end_s: float) -> float:
    """Return the true time left when the forecast, counted down between its lines, first reaches two minutes."""
    reached_s = time_s + np.maximum(remaining_s - ALARM_S, 0.0)
    until_s = np.minimum(np.append(time_s[1:], end_s), time_s + MAX_AGE_S)
    raised = np.flatnonzero(reached_s < until_s)
    return end_s - float(reached_s[raised[0]]) if raised.size else 0.0


@dataclass(frozen=True, slots=True)
class ScoreRow:
    """A ScoreRow holds one instant over all flights that reach it; `_se` is the standard error over flights."""

    label: str
    flights: int
    refused: int
    mae_s: float
    mae_se_s: float
    bias_s: float
    bias_se_s: float
    crps_s: float
    crps_se_s: float
    width_s: float
    inside: int | None  # flights whose interval held the truth; None without an interval
    coverage_95: tuple[float, float]  # binomial interval of inside / flights


@dataclass(frozen=True, slots=True)
class PooledScores:
    """PooledScores holds scores over flights; a pair is (mean, standard error over flights)."""

    flights: int
    rows: tuple[ScoreRow, ...]
    alpha_lambda: Mapping[float, int]  # alpha -> flights with mass >= beta
    horizon_s: tuple[float, float]
    cra: tuple[float, float]
    refused: float
    coverage: tuple[float, float]
    coverage_thirds: tuple[float, ...]
    alarm_early_s: float  # median over flights
    alarm_least_s: float  # the latest alarm: least true time left when raised (0: one was never raised)


def pool(scores: Iterable[FlightScore]) -> PooledScores:
    """Pool the scores of all flights. A flight counts once in each row, so lines of one flight never pass for evidence.

    Flights of one aircraft are not independent either: pool each group too, and compare. Raises ValueError for none.
    """
    every = tuple(scores)
    if not every:
        raise ValueError("expected at least one scored flight")
    labels = _instant_times_s(0.0, 1.0)
    reached = {label: [score.at[label] for score in every if label in score.at] for label in labels}
    return PooledScores(
        flights=len(every),
        rows=tuple(_row(label, instants) for label, instants in reached.items() if instants),
        alpha_lambda={a: sum(score.alpha_lambda[a] >= BETA for score in every) for a in ALPHAS},
        horizon_s=_mean_se([score.horizon_s for score in every]),
        cra=_mean_se([score.cra for score in every]),
        refused=_mean([score.refused for score in every]),
        coverage=_mean_se([score.coverage for score in every]),
        coverage_thirds=tuple(_mean([score.coverage_thirds[part] for score in every]) for part in range(3)),
        alarm_early_s=float(np.median([score.alarm_early_s for score in every])),
        alarm_least_s=min(score.alarm_at_s for score in every),
    )


def _row(label: str, instants: Sequence[Instant]) -> ScoreRow:
    errors = np.array([instant.error_s for instant in instants])
    hits = [instant.inside for instant in instants if instant.inside is not None]
    return ScoreRow(
        label,
        len(instants),
        sum(math.isnan(instant.forecast_s) for instant in instants),
        *_mean_se(np.abs(errors)),
        *_mean_se(errors),
        *_mean_se([instant.crps_s for instant in instants]),
        width_s=_mean([instant.width_s for instant in instants]),
        inside=sum(hits) if hits else None,
        coverage_95=binomial_interval(sum(hits), len(hits)),
    )


def _mean_se(values: ArrayLike) -> tuple[float, float]:
    """Return mean and standard error sd/sqrt(n); the error of a single value is unknown."""
    finite = np.asarray(values, float)
    finite = finite[~np.isnan(finite)]
    spread = float(np.std(finite, ddof=1)) / math.sqrt(finite.size) if finite.size > 1 else NAN
    return _mean(finite), spread
