"""Forecasts that know the route, beside those that do not: 40 real flights with their missions, and simulated missions.

The Matrice 100 flights are left out one aircraft at a time, battery and vehicle learned from the two others; positions
were never logged. The simulated missions fly on a battery from `truth/lab` and `truth/reference` and a vehicle learned
from `missions/learn`. p07 to p12 were not looked at while routes were built; the rules of the turn, the gusts and the
fit at high airspeed were chosen on l03 to l05 and p04 to p06, with p09 to p12 printed beside them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from scoring import truth
from scoring.data import M100_CELLS, M100_CUTOFF_V, M100_LOADED_A
from scoring.lines import Lines, logged, ours
from scoring.m100 import PX4_SET, RATED_AH
from scoring.peer_lines import PeerPack, calibrated, peer_lines
from scoring.peer_turns import turn_lines
from scoring.table import Table, figure, grid
from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.estimator import Estimator
from uavbatt.fitting.battery import RecordedPack, fit_battery
from uavbatt.fitting.vehicle import fit_vehicle
from uavbatt.log_replay.run import ReplayedRow, steps
from uavbatt.navigation import UNSTATED
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.prediction.load.library import LearnedLoad, learned_load
from uavbatt.prediction.load.scenarios import Load
from uavbatt.records import Flight, Route
from uavbatt.scoring.end_of_flight import end_of_flight
from uavbatt.scoring.scores import FlightScore, pool
from uavbatt.telemetry import read_log

ROUTE, LEARNED, LOG = "ours, route", "ours, learned", "ours, log"
INSTANTS = ("360 s", "240 s", "120 s", "60 s")
BEFORE_TURN_S = (300.0, 120.0, 60.0)
OF_MISSION = (0.5, 0.75, 0.9)
LATE_S = 15.0


@dataclass(frozen=True, slots=True)
class Known:
    """Known holds a battery and what the vehicle asks of it, and what the peers are told of the same flights."""

    battery: BatteryFile
    pack: PackOptions
    library: LearnedLoad
    peers: PeerPack


@dataclass(frozen=True, slots=True)
class Mission:
    """A Mission is one simulated mission with its answers, as it was forecast with its route."""

    name: str
    answer: dict[str, Any]
    run: list[ReplayedRow]
    unheard: dict[str, list[ReplayedRow]]  # the same, if something was never heard
    peers: dict[str, Lines]  # seconds until one must turn back


def tables(data: Path, say: Callable[[str], None]) -> list[Table]:
    """Return all tables of both sets."""
    missions, scores = _missions(data, say)
    return [
        *_errors("M100 routes, one aircraft left out", _m100(data, say)),
        *_errors("Simulated missions", scores),
        _turn_backs(missions),
        _touchdowns(missions),
    ]


def run_of(flight: Flight, known: Known, load: Load) -> list[ReplayedRow]:
    """Return the flight as it is forecast with a load, row by row."""
    return list(steps(flight, Estimator(known.battery, known.pack, ForecastSettings(load))))


def _scored(
    flight: Flight, known: Known, span_s: tuple[float, float], run: list[ReplayedRow]
) -> dict[str, FlightScore]:
    """Return the scores of the flight with its route (already run), without it, and with its own later load."""
    without = replace(flight, navigation=())
    runs = {
        ROUTE: run,
        LEARNED: run_of(without, known, known.library),
        LOG: run_of(without, known, logged(flight)),
    }
    name = Path(flight.source).stem
    said = {**{method: ours(lines) for method, lines in runs.items()}, **peer_lines(known.peers, flight.samples)}
    return {method: lines.scored(name, "", *span_s) for method, lines in said.items()}


def _m100(data: Path, say: Callable[[str], None]) -> dict[str, list[FlightScore]]:
    logs = {path.stem: read_log(path) for path in sorted((data / "flights" / "m100_routes").glob("*.tlog"))}
    found: dict[str, list[FlightScore]] = {}
    pack = PackOptions(cells=M100_CELLS, capacity_Ah=RATED_AH, cutoff_V=M100_CUTOFF_V)
    for aircraft in sorted({name[-3:] for name in logs}):
        say(f"routes: learning from the aircraft other than {aircraft}")
        others = [flight for name, flight in logs.items() if not name.endswith(aircraft)]
        size = RecordedPack(f"m100-without-{aircraft}", M100_CELLS, RATED_AH, M100_CUTOFF_V)
        battery = fit_battery(size, [], others).file
        emptied = [(flight, end_s) for flight in others if math.isfinite(end_s := _m100_span_s(flight)[1])]
        peers = calibrated(M100_CELLS, RATED_AH, emptied, PX4_SET)
        known = Known(battery, pack, learned_load(fit_vehicle(size.name, others, battery, pack)), peers)
        for name in (name for name in logs if name.endswith(aircraft)):
            span_s = _m100_span_s(logs[name])
            if not math.isfinite(span_s[1]):
                continue
            say(f"routes: {name}")
            run = run_of(logs[name], known, known.library)
            for method, score in _scored(logs[name], known, span_s, run).items():
                found.setdefault(method, []).append(score)
    return found


def _m100_span_s(flight: Flight) -> tuple[float, float]:
    return _span_s(flight, M100_CUTOFF_V, M100_LOADED_A)


def _span_s(flight: Flight, cutoff_V: float, loaded_A: float) -> tuple[float, float]:
    """Return the times of the first row under load and of the end of flight [s]."""
    rows = flight.samples
    columns = ([s.time_s for s in rows], [s.voltage_V for s in rows], [s.current_A for s in rows])
    end_s = end_of_flight(*columns, cutoff_V=cutoff_V, min_current_A=loaded_A)
    return next(s.time_s for s in rows if s.current_A > loaded_A), end_s


def _missions(data: Path, say: Callable[[str], None]) -> tuple[list[Mission], dict[str, list[FlightScore]]]:
    say("routes: learning battery and vehicle of the simulated missions")
    known = known_of_missions(data)
    missions, scores = [], dict[str, list[FlightScore]]()
    for path in sorted((data / "missions/practice").glob("*.tlog")):
        say(f"routes: {path.stem}")
        flight, answer = read_log(path), answer_of(data, path.stem)
        run = run_of(flight, known, known.library)
        missions.append(Mission(path.stem, answer, run, _unheard(flight, known), turn_lines(known.peers, flight)))
        if answer["end_s"] is None:
            continue
        start_s, _ = _span_s(flight, truth.CUTOFF_V, 2.0)
        for method, score in _scored(flight, known, (start_s, answer["end_s"]), run).items():
            scores.setdefault(method, []).append(score)
    return missions, scores


def known_of_missions(data: Path) -> Known:
    """Return the battery of the simulated missions, and what vehicle and peers learn from those of `learn`."""
    pack, battery = truth.PACK, truth.truth_battery(data)
    learn = [read_log(path) for path in sorted((data / "missions/learn").glob("*.tlog"))]
    emptied = [(f, end_s) for f in learn if (end_s := answer_of(data, Path(f.source).stem)["end_s"]) is not None]
    peers = calibrated(truth.CELLS, truth.CAPACITY_AH, emptied)
    return Known(battery, pack, learned_load(fit_vehicle("learn", learn, battery, pack)), peers)


def _unheard(flight: Flight, known: Known) -> dict[str, list[ReplayedRow]]:
    """Return the flight as it is forecast where nobody states speeds and heights, and where nobody tells the wind."""
    unstated = tuple(replace(now, settings=UNSTATED) for now in flight.navigation)
    untold = tuple(replace(now, wind=None) for now in flight.navigation)
    return {
        "no parameters": run_of(replace(flight, navigation=unstated), known, replace(known.library, usual=UNSTATED)),
        "no wind": run_of(replace(flight, navigation=untold), known, known.library),
    }


def answer_of(data: Path, name: str) -> dict[str, Any]:
    """Return the true values of a simulated mission."""
    found: dict[str, Any] = json.loads((data / "missions/answers" / f"{name}.json").read_text())
    return found


def _errors(title: str, found: dict[str, list[FlightScore]]) -> list[Table]:
    """Return error, bias, interval and dangerous optimism of each method."""
    rows = []
    for method, scores in found.items():
        by_label = {row.label: row for row in pool(scores).rows}
        at = [by_label[label] for label in INSTANTS]
        rows.append((f"{method}: MAE (bias) [s]", [f"{r.mae_s:.0f} ({r.bias_s:+.0f})" for r in at]))
        if any(math.isfinite(r.width_s) for r in at):
            inside = [f"{r.inside} of {r.flights}, {figure(r.width_s)}" for r in at]
            rows.append((f"{method}: inside, width [s]", inside))
        worst = [sum(s.at[label].error_s > 60.0 for s in scores if label in s.at) for label in INSTANTS]
        rows.append((f"{method}: more than 60 s optimistic", [str(count) for count in worst]))
    flights = len(next(iter(found.values())))
    return [grid(f"{title}: {flights} flights with an end", INSTANTS, rows, "Seconds before the end.")]


def _in_force(run: list[ReplayedRow], time_s: float) -> Route | None:
    said = [step.remaining for step in run if step.remaining.time_s <= time_s + 1e-6]
    return said[-1].route if said else None


def _turn_backs(missions: list[Mission]) -> Table:
    """Return errors of the turn-back at instants before the true one, and the time of the first "turn back now"."""
    head = (*(f"{before:.0f} s before" for before in BEFORE_TURN_S), "turn back now")
    there = [m for m in missions if m.answer["turn_back_s"] is not None]
    found = [turn_back_errors(mission.answer["turn_back_s"], mission.run) for mission in there]
    rows = [(mission.name, one.cells) for mission, one in zip(there, found, strict=True)]
    rows.append((f"{ROUTE}: MAE [s]", turn_back_means(found)))
    for what in there[0].unheard:
        means = turn_back_means(
            [turn_back_errors(mission.answer["turn_back_s"], mission.unheard[what]) for mission in there]
        )
        rows.append((f"{ROUTE}, {what} heard: MAE [s]", means))
    for peer in there[0].peers:
        rows.append((f"{peer}: MAE [s]", turn_back_means([_peer_turn_back(mission, peer) for mission in there])))
    note = "Positive: too late. No number counts as 0. In the last column the peers' zero, without an interval."
    return grid("Simulated missions: error of turn_back_s [s]", head, rows, note)


class TurnBackErrors(NamedTuple):
    """TurnBackErrors holds the errors of one method on one flight [s]; NaN is no number.

    `alarm_s` is when it said to turn first.
    """

    errors_s: tuple[float, ...]
    alarm_s: float

    @property
    def cells(self) -> list[str]:
        """Return the errors as they are printed."""
        return [*(figure(error_s, sign=True) for error_s in self.errors_s), f"{figure(self.alarm_s, sign=True)} s"]


def turn_back_errors(true_s: float, run: list[ReplayedRow]) -> TurnBackErrors:
    """Return the errors of the turn-back of one flight whose true turn-back is at `true_s` [s]."""
    errors = []
    for before_s in BEFORE_TURN_S:
        route = _in_force(run, true_s - before_s)
        errors.append(route.turn_back_s - before_s if route is not None else math.nan)
    return TurnBackErrors(tuple(errors), _alarm_s(run) - true_s)


def _peer_turn_back(mission: Mission, peer: str) -> TurnBackErrors:
    true_s, said = mission.answer["turn_back_s"], mission.peers[peer]
    rows = [int(np.searchsorted(said.time_s, true_s - before_s + 1e-6)) - 1 for before_s in BEFORE_TURN_S]
    errors = tuple(float(max(said.remaining_s[row], 0.0)) - b for row, b in zip(rows, BEFORE_TURN_S, strict=True))
    reached = np.flatnonzero(said.remaining_s <= 0.0)
    first_s = said.time_s[reached[0]] if reached.size else said.time_s[-1]
    return TurnBackErrors(errors, float(first_s) - true_s)


def turn_back_means(found: list[TurnBackErrors]) -> list[str]:
    """Return mean absolute errors over flights, and how often the alarm came early."""
    columns = zip(*(one.errors_s for one in found), strict=True)
    means = [
        float(np.mean([abs(e) if math.isfinite(e) else before_s for e in column]))
        for column, before_s in zip(columns, BEFORE_TURN_S, strict=True)
    ]
    early = sum(one.alarm_s <= 0.0 for one in found)
    late = sum(one.alarm_s > LATE_S for one in found)
    return [*(figure(mean) for mean in means), f"early in {early} of {len(found)}, late by > {LATE_S:.0f} s in {late}"]


def _alarm_s(run: list[ReplayedRow]) -> float:
    """Return the time of the first 'turn back now'; the end of the flight if there is none."""
    said = (s.remaining for s in run if s.remaining.route is not None)
    return next(
        (r.time_s for r in said if r.route is not None and r.route.must_turn_back_now),
        run[-1].remaining.time_s,
    )


def _touchdowns(missions: list[Mission]) -> Table:
    """Return errors of the charge at touchdown along the missions that land."""
    rows: list[tuple[str, list[str]]] = []
    errors: list[list[float]] = [[] for _ in OF_MISSION]
    for mission in (m for m in missions if m.answer["landed_s"] is not None):
        cells = []
        for column, part in zip(errors, OF_MISSION, strict=True):
            route = _in_force(mission.run, part * mission.answer["landed_s"])
            error = 100.0 * (route.soc - mission.answer["soc_at_touchdown"]) if route is not None else math.nan
            column.append(abs(error))
            cells.append(f"{error:+.1f}")
        rows.append((mission.name, cells))
    rows.append(("MAE [%]", [figure(float(np.nanmean(column)), 1) for column in errors]))
    head = tuple(f"{part:.0%} of the flight" for part in OF_MISSION)
    return grid("Simulated missions: error of route_soc [% of the charge]", head, rows)
