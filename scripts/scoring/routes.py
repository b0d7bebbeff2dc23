"""Forecasts that know the route, beside those that do not: 40 real flights with their missions, and simulated missions.

The Matrice 100 flights are left out one aircraft at a time, battery and vehicle learned from the two others; positions
were never logged. The simulated missions fly on a battery from `truth/lab` and `truth/reference` and a vehicle learned
from `missions/learn`; p01 to p06 were looked at while this was built, p07 to p12 were not.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from scoring.data import M100_CELLS, M100_CUTOFF_V, M100_LOADED_A
from scoring.lines import logged, ours
from scoring.m100 import RATED_AH
from scoring.table import DASH, Table, figure, grid
from uavbatt import dataset
from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.sizing import PackOptions
from uavbatt.estimator import Estimator
from uavbatt.fitting.battery import Size, fit_battery
from uavbatt.fitting.vehicle import vehicle_file
from uavbatt.log_replay import ReplayedRow, steps
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.prediction.load import Load
from uavbatt.prediction.load_library import LearnedLoad, learned_load
from uavbatt.records import Flight, Route
from uavbatt.scoring.scores import FlightScore, end_of_flight, pool
from uavbatt.telemetry import read_log

ROUTE, LEARNED, LOG = "ours, route", "ours, learned", "ours, log"
INSTANTS = ("360 s", "240 s", "120 s", "60 s")
BEFORE_TURN_S = (300.0, 120.0, 60.0)
OF_MISSION = (0.5, 0.75, 0.9)
TRUTH_CELLS, TRUTH_AH, TRUTH_CUTOFF_V = 4, 5.0, 13.2
LATE_S = 15.0


@dataclass(frozen=True, slots=True)
class Known:
    """A battery and what the vehicle asks of it."""

    battery: BatteryFile
    pack: PackOptions
    library: LearnedLoad


@dataclass(frozen=True, slots=True)
class Mission:
    """One simulated mission with its answers, as it was forecast with its route."""

    name: str
    answer: dict[str, Any]
    run: list[ReplayedRow]


def tables(data: Path, say: Callable[[str], None]) -> list[Table]:
    """All tables of both sets."""
    missions, scores = _missions(data, say)
    return [
        *_errors("M100 routes, one aircraft left out", _m100(data, say)),
        *_errors("Simulated missions", scores),
        _turn_backs(missions),
        _touchdowns(missions),
    ]


def _run(flight: Flight, known: Known, load: Load) -> list[ReplayedRow]:
    return list(steps(flight, Estimator(known.battery, known.pack, ForecastSettings(load))))


def _scored(
    flight: Flight, known: Known, span_s: tuple[float, float], run: list[ReplayedRow]
) -> dict[str, FlightScore]:
    """The flight with its route (already run), without it, and with its own later load."""
    without = replace(flight, navigation=())
    runs = {
        ROUTE: run,
        LEARNED: _run(without, known, known.library),
        LOG: _run(without, known, logged(flight)),
    }
    name = Path(flight.source).stem
    return {method: ours(lines).scored(name, "", *span_s) for method, lines in runs.items()}


def _m100(data: Path, say: Callable[[str], None]) -> dict[str, list[FlightScore]]:
    logs = {path.stem: read_log(path) for path in sorted((data / "flights" / "m100_routes").glob("*.tlog"))}
    found: dict[str, list[FlightScore]] = {}
    pack = PackOptions(cells=M100_CELLS, capacity_Ah=RATED_AH, cutoff_V=M100_CUTOFF_V)
    for aircraft in sorted({name[-3:] for name in logs}):
        say(f"routes: learning from the aircraft other than {aircraft}")
        others = [flight for name, flight in logs.items() if not name.endswith(aircraft)]
        size = Size(f"m100-without-{aircraft}", M100_CELLS, RATED_AH, M100_CUTOFF_V)
        battery = fit_battery(size, [], others).file
        known = Known(battery, pack, learned_load(vehicle_file(size.name, others, battery, pack)))
        for name in (name for name in logs if name.endswith(aircraft)):
            span_s = _span_s(logs[name], M100_CUTOFF_V, M100_LOADED_A)
            if not math.isfinite(span_s[1]):
                continue
            say(f"routes: {name}")
            run = _run(logs[name], known, known.library)
            for method, score in _scored(logs[name], known, span_s, run).items():
                found.setdefault(method, []).append(score)
    return found


def _span_s(flight: Flight, cutoff_V: float, loaded_A: float) -> tuple[float, float]:
    """The first row under load and the end of flight [s]."""
    rows = flight.samples
    columns = ([s.time_s for s in rows], [s.voltage_V for s in rows], [s.current_A for s in rows])
    end_s = end_of_flight(*columns, cutoff_V=cutoff_V, min_current_A=loaded_A)
    return next(s.time_s for s in rows if s.current_A > loaded_A), end_s


def _missions(data: Path, say: Callable[[str], None]) -> tuple[list[Mission], dict[str, list[FlightScore]]]:
    say("routes: learning battery and vehicle of the simulated missions")
    pack = PackOptions(cells=TRUTH_CELLS, capacity_Ah=TRUTH_AH, cutoff_V=TRUTH_CUTOFF_V)
    reference = [read_log(path) for path in sorted((data / "truth/reference/r0").glob("flight_*.tlog"))]
    size = Size("truth-lab", TRUTH_CELLS, TRUTH_AH, TRUTH_CUTOFF_V)
    battery = fit_battery(size, [dataset.load(data / "truth" / "lab")], reference).file
    learn = [read_log(path) for path in sorted((data / "missions/learn").glob("*.tlog"))]
    known = Known(battery, pack, learned_load(vehicle_file("learn", learn, battery, pack)))
    missions, scores = [], dict[str, list[FlightScore]]()
    for path in sorted((data / "missions/practice").glob("*.tlog")):
        say(f"routes: {path.stem}")
        flight, answer = read_log(path), json.loads((data / "missions/answers" / f"{path.stem}.json").read_text())
        run = _run(flight, known, known.library)
        missions.append(Mission(path.stem, answer, run))
        if answer["end_s"] is None:
            continue
        start_s, _ = _span_s(flight, TRUTH_CUTOFF_V, 2.0)
        for method, score in _scored(flight, known, (start_s, answer["end_s"]), run).items():
            scores.setdefault(method, []).append(score)
    return missions, scores


def _errors(title: str, found: dict[str, list[FlightScore]]) -> list[Table]:
    """Error, bias, interval and dangerous optimism of each method."""
    rows = []
    for method, scores in found.items():
        by_label = {row.label: row for row in pool(scores).rows}
        at = [by_label[label] for label in INSTANTS]
        rows.append((f"{method}: MAE (bias) [s]", [f"{r.mae_s:.0f} ({r.bias_s:+.0f})" for r in at]))
        rows.append((f"{method}: inside, width [s]", [f"{r.inside} of {r.flights}, {figure(r.width_s)}" for r in at]))
        worst = [sum(s.at[label].error_s > 60.0 for s in scores if label in s.at) for label in INSTANTS]
        rows.append((f"{method}: more than 60 s optimistic", [str(count) for count in worst]))
    flights = len(next(iter(found.values())))
    return [grid(f"{title}: {flights} flights with an end", INSTANTS, rows, "Seconds before the end.")]


def _in_force(mission: Mission, time_s: float) -> Route | None:
    said = [step.remaining for step in mission.run if step.remaining.time_s <= time_s + 1e-6]
    return said[-1].route if said else None


def _turn_backs(missions: list[Mission]) -> Table:
    """Error of the turn-back at instants before the true one, and when its 5 % point reaches zero."""
    head = (*(f"{before:.0f} s before" for before in BEFORE_TURN_S), "5 % point at zero")
    rows, errors, alarms = [], [[] for _ in BEFORE_TURN_S], []
    for mission in (m for m in missions if m.answer["turn_back_s"] is not None):
        true_s, cells = mission.answer["turn_back_s"], []
        for column, before_s in zip(errors, BEFORE_TURN_S, strict=True):
            route = _in_force(mission, true_s - before_s)
            error_s = route.turn_back_s - before_s if route is not None else math.nan
            column.append(abs(error_s) if math.isfinite(error_s) else before_s)
            cells.append(f"{error_s:+.0f}" if math.isfinite(error_s) else DASH)
        alarms.append(_alarm_s(mission) - true_s)
        rows.append((mission.name, [*cells, f"{alarms[-1]:+.0f} s"]))
    early = sum(alarm_s <= 0.0 for alarm_s in alarms)
    late = sum(alarm_s > LATE_S for alarm_s in alarms)
    last = f"early in {early} of {len(alarms)}, late by > {LATE_S:.0f} s in {late}"
    rows.append(("MAE [s]", [*(figure(float(np.mean(column))) for column in errors), last]))
    return grid(
        "Simulated missions: error of turn_back_s [s]", head, rows, "Positive: too late. No number counts as 0."
    )


def _alarm_s(mission: Mission) -> float:
    """When 'turn back now' is said first; never is the end of the flight."""
    said = (s.remaining for s in mission.run if s.remaining.route is not None)
    return next(
        (r.time_s for r in said if r.route is not None and r.route.turn_back_lo_s <= 0.0),
        mission.run[-1].remaining.time_s,
    )


def _touchdowns(missions: list[Mission]) -> Table:
    """Error of the charge at touchdown along the missions that land."""
    rows, errors = [], [[] for _ in OF_MISSION]
    for mission in (m for m in missions if m.answer["landed_s"] is not None):
        cells = []
        for column, part in zip(errors, OF_MISSION, strict=True):
            route = _in_force(mission, part * mission.answer["landed_s"])
            error = 100.0 * (route.soc - mission.answer["soc_at_touchdown"]) if route is not None else math.nan
            column.append(abs(error))
            cells.append(f"{error:+.1f}")
        rows.append((mission.name, cells))
    rows.append(("MAE [%]", [figure(float(np.nanmean(column)), 1) for column in errors]))
    head = tuple(f"{part:.0%} of the flight" for part in OF_MISSION)
    return grid("Simulated missions: error of route_soc [% of the charge]", head, rows)
