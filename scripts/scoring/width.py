"""Sources of the width of the interval: one doubt after the other is replaced by the truth.

The belief of a flight is taken some minutes before its end, and its 128 draws fly on: as they are, under the power that
was flown, and with the true charge, the true capacity or both put into each of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from peers.columns import FloatArray

from scoring.other_pack import CELLS, CUTOFF_V, FULL_AH
from scoring.table import Table, figure
from scoring.wrong_cases import Case
from scoring.wrong_judged import battery
from uavbatt.battery.capacity_prior import capacities
from uavbatt.battery.scaling import pack_of
from uavbatt.battery.state_space import X
from uavbatt.estimation.filter import SocFilter, estimate_of
from uavbatt.prediction.batch import Question, end_times
from uavbatt.prediction.forecaster import Forecaster, ForecastSettings
from uavbatt.prediction.load.power_history import RecentLoad
from uavbatt.prediction.load.scenarios import FlightPoint, LoggedLoad
from uavbatt.prediction.simulation.sampling import Normals
from uavbatt.prediction.simulation.time_to_end import time_to_end

BEFORE_END_S = (360.0, 240.0, 120.0, 60.0)
LEVELS = (0.05, 0.5, 0.95)
NEVER_S = 1e9


@dataclass(frozen=True, slots=True)
class Instant:
    """An Instant is one forecast: true time left [s], the points of each variant, errors of the belief in its sds."""

    before_s: float
    true_s: float
    points_s: dict[str, FloatArray]  # at LEVELS
    soc_sds: float
    charge_sds: float  # of charge times capacity


def instants(case: Case) -> Iterator[Instant]:
    """Yield the forecasts of one flight; those before take-off are left out."""
    flown = case.flown()
    pack = pack_of(battery(case.battery, case.make), CELLS, FULL_AH, CUTOFF_V, math.nan)
    forecaster = Forecaster(pack, ForecastSettings(forecast_period_s=NEVER_S))
    power_W = np.array(flown.voltage_V) * np.array(flown.current_A)
    logged = LoggedLoad(np.array([row.time_s for row in flown.rows]), power_W)
    due = list(BEFORE_END_S)
    rows = SocFilter(pack, capacities=capacities(pack)).run(flown.rows)
    for sample, row, soc in zip(flown.rows, rows, flown.soc, strict=True):
        refusal, _ = forecaster.update(sample, estimate_of(sample, row), row.belief)
        left_s = flown.end_s - sample.time_s
        if not due or left_s > due[0]:
            continue
        before_s = due.pop(0)
        if refusal or row.belief is None:
            continue
        question = forecaster.question(row.belief, sample.time_s)
        if question is not None:
            yield _instant(before_s, left_s, question, logged, soc, math.log(case.capacity_Ah / FULL_AH))


def _instant(
    before_s: float, true_s: float, question: Question, logged: LoggedLoad, soc: float, log_capacity: float
) -> Instant:
    x = question.flying.x
    told = x[X.SOC] * np.exp(x[X.LOG_CAPACITY])
    points_s = {name: np.quantile(ends, LEVELS) for name, ends in _variants(question, logged, soc, log_capacity)}
    charge = soc * math.exp(log_capacity)
    return Instant(before_s, true_s, points_s, _sds(x[X.SOC], soc), _sds(told, charge))


def _sds(draws: FloatArray, truth: float) -> float:
    return float((np.mean(draws) - truth) / np.std(draws))


def _variants(q: Question, logged: LoggedLoad, soc: float, log_capacity: float) -> Iterator[tuple[str, FloatArray]]:
    """Return the ends of the draws [s], with one doubt less in each variant."""
    yield "as it is", _ends(q)
    now = FlightPoint(
        q.time_s, since_take_off_s=0.0, soc=soc, flight_W=0.0, recent=RecentLoad()
    )  # a log asks for the time alone
    flying, dt_s = q.flying, q.flying.dt_s
    one_W = logged.scenarios(now, float(dt_s[0]), dt_s.size).power_W
    known = q._replace(flying=flying._replace(power_W=np.broadcast_to(one_W, flying.power_W.shape)))
    yield "power known", _ends(known)
    yield "power and charge known", _ends(_with(known, {X.SOC: soc}))
    yield "power and capacity known", _ends(_with(known, {X.LOG_CAPACITY: log_capacity}))
    both = _with(known, {X.SOC: soc, X.LOG_CAPACITY: log_capacity})
    yield "power, charge and capacity known", _ends(both)
    flying = both.flying._replace(reserve_soc=0.0, by_rows=False)
    still = time_to_end(flying, Normals(np.zeros_like(flying.power_W), np.empty((0, 1)))).end_s
    yield "power, charge and capacity known, no drift ahead", np.minimum(still, both.horizon_s)


def _with(q: Question, truth: dict[int, float]) -> Question:
    x = q.flying.x.copy()
    for component, value in truth.items():
        x[component] = value
    return q._replace(flying=q.flying._replace(x=x))


def _ends(q: Question) -> FloatArray:
    return np.minimum(end_times(q.flying).end_s, q.horizon_s)


def table(title: str, found: Sequence[Instant]) -> Table:
    """Return one row a variant; in each column width [s], how many hold the truth, bias of the median [s]."""
    columns = [[i for i in found if i.before_s == before_s] for before_s in BEFORE_END_S]
    names = list(found[0].points_s)
    rows = [(name, *(_cell(name, some) for some in columns)) for name in names]
    rows.append(("rms error of the charge [sd]", *(_rms([i.soc_sds for i in some]) for some in columns)))
    rows.append(("rms error of charge x capacity [sd]", *(_rms([i.charge_sds for i in some]) for some in columns)))
    head = ("what is known", *(f"{before_s:.0f} s before" for before_s in BEFORE_END_S))
    note = (
        "Mean width of the 90 % interval [s], flights that it holds, bias of the median [s]. A forecast by itself, "
        "without what was expected at take-off, the bound by the voltage and the smoothing."
    )
    return Table(title, head, tuple(rows), note)


def _cell(name: str, some: Sequence[Instant]) -> str:
    if not some:
        return "–"
    points_s, true_s = np.array([i.points_s[name] for i in some]), np.array([i.true_s for i in some])
    low_s, median_s, high_s = points_s.T
    inside = int(np.sum((low_s <= true_s) & (true_s <= high_s)))
    bias_s = figure(float(np.mean(median_s - true_s)), sign=True)
    return f"{figure(float(np.mean(high_s - low_s)))}, {inside} of {len(some)}, {bias_s}"


def _rms(sds: Sequence[float]) -> str:
    return figure(float(np.sqrt(np.mean(np.square(sds)))), 2) if sds else "–"
