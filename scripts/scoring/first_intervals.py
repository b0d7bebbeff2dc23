"""The first intervals of each shared flight against its end, or against its last interval where it has no end.

A set is a folder of logs, with what is known of the pack and of the aircraft: nothing (the packaged battery), or files
fitted without the aircraft or the flights that are scored.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from scoring.data import M100_CELLS, M100_CUTOFF_V
from scoring.m100 import RATED_AH
from scoring.shared import STATED
from scoring.truth import PACK as TRUTH_PACK
from scoring.truth import truth_battery
from uavbatt.battery import battery_file
from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.errors import UavbattError
from uavbatt.estimator import Estimator
from uavbatt.fitting.battery import RecordedPack, fit_battery
from uavbatt.fitting.vehicle import fit_vehicle
from uavbatt.log_replay.run import ReplayedRow, steps
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.prediction.load.library import UnknownAircraft, learned_load
from uavbatt.prediction.load.scenarios import Load
from uavbatt.records import Flight, Remaining
from uavbatt.scoring.end_of_flight import end_of_flight
from uavbatt.telemetry import read_log

AFTER_S = (0.0, 5.0, 15.0, 30.0)  # since the first interval that is shown
EARLY_S = 90.0
LOADED_A = 2.0
M100_PACK = PackOptions(cells=M100_CELLS, capacity_Ah=RATED_AH, cutoff_V=M100_CUTOFF_V)


@dataclass(frozen=True, slots=True)
class Set:
    """A Set holds logs that are flown alike. `ends_s` are known by the name of the log; others are looked for in it."""

    name: str
    paths: tuple[Path, ...]
    battery: BatteryFile
    load: Load
    pack: PackOptions
    ends_s: dict[str, float]


@dataclass(frozen=True, slots=True)
class EarlyIntervals:
    """EarlyIntervals holds a flight's early intervals [log time, s] and its end: an instant, or the last interval."""

    of: str
    name: str
    shown: tuple[tuple[float, float] | None, ...]  # one for each of AFTER_S; None is refused
    end_s: tuple[float, float]
    is_end: bool

    def misses(self, k: int) -> bool:
        """Return True if the interval does not contain the end, or does not meet the last interval."""
        interval = self.shown[k]
        return interval is not None and (interval[1] < self.end_s[0] or interval[0] > self.end_s[1])


def generic(data: Path) -> Iterator[Set]:
    """Yield every shared flight, by the packaged battery and an aircraft that nobody knows."""
    battery, load = battery_file.read_battery("lipo-generic"), UnknownAircraft()
    packs, missions = _pack_ends_s(data), _mission_ends_s(data)
    for name, places, pack, ends_s in (
        ("real logs", ("flights/ardupilot/*", "flights/px4/hexa*.ulg"), PackOptions(), {}),
        ("M100", ("flights/m100/m100_*.csv",), M100_PACK, {}),
        ("M100 with routes", ("flights/m100_routes/*.tlog",), M100_PACK, {}),
        ("missions", ("missions/learn/*.tlog", "missions/practice/*.tlog"), PackOptions(), missions),
        ("truth", ("truth/*/*/flight_*.tlog",), PackOptions(), {}),
        ("packs", ("packs/practice/*/flight_*.tlog",), PackOptions(), packs),
    ):
        yield Set(name, _paths(data, places), battery, load, pack, ends_s)


def fitted(data: Path) -> Iterator[Set]:
    """Yield flights with a battery and a vehicle file that the scored aircraft, or flights, had no part in."""
    logs = {path: read_log(path) for path in _paths(data, ("flights/m100_routes/*.tlog",))}
    for aircraft in sorted({path.stem[-3:] for path in logs}):
        others = [flight for path, flight in logs.items() if not path.stem.endswith(aircraft)]
        battery = fit_battery(RecordedPack("without", M100_CELLS, RATED_AH, M100_CUTOFF_V), [], others).file
        load = learned_load(fit_vehicle("without", others, battery, M100_PACK))
        own = tuple(path for path in logs if path.stem.endswith(aircraft))
        tables = tuple(data / "flights/m100" / f"{path.stem}.csv" for path in own)
        yield Set("M100, fitted", tables, battery, load, M100_PACK, {})
        yield Set("M100 with routes, fitted", own, battery, load, M100_PACK, {})
    battery = truth_battery(data)
    learn = [read_log(path) for path in _paths(data, ("missions/learn/*.tlog",))]
    load, practice = learned_load(fit_vehicle("learn", learn, battery, TRUTH_PACK)), ("missions/practice/*.tlog",)
    yield Set("missions, fitted", _paths(data, practice), battery, load, TRUTH_PACK, _mission_ends_s(data))
    packs = _paths(data, ("packs/practice/*/flight_*.tlog",))
    yield Set("packs, fitted battery", packs, battery, UnknownAircraft(), TRUTH_PACK, _pack_ends_s(data))


def firsts(flown: Set, is_wanted: Callable[[int], bool], say: Callable[[str], None]) -> Iterator[EarlyIntervals]:
    """Yield the early intervals of the wanted flights of a set, chosen by their number in it."""
    for number, path in enumerate(flown.paths):
        if is_wanted(number):
            say(f"{flown.name}: {path.parent.name}/{path.name}")
            try:
                found = _first(flown, path)
            except UavbattError as error:
                say(f"{path.name}: {error}")
                continue
            if found is not None:
                yield found


def _first(flown: Set, path: Path) -> EarlyIntervals | None:
    flight = read_log(path)
    begin_s = next((s.time_s for s in flight.samples if s.current_A > LOADED_A), math.nan)
    pack = STATED.get(path.name, flown.pack)
    run, cutoff_V = _flown(_cut(flight, begin_s + EARLY_S + max(AFTER_S)), flown, pack)
    end_s = flown.ends_s.get(_key(path), math.nan)
    end_s = end_s if math.isfinite(end_s) else _end_s(flight, cutoff_V)
    if not math.isfinite(end_s):
        run, _ = _flown(flight, flown, pack)
    said = [step.remaining for step in run if math.isfinite(step.remaining.remaining_s)]
    if not said:
        return None
    shown = tuple(_in_force(run, said[0].time_s + after_s) for after_s in AFTER_S)
    name = f"{path.parent.name}/{path.stem}"
    if math.isfinite(end_s):
        return EarlyIntervals(flown.name, name, shown, (end_s, end_s), True)
    return EarlyIntervals(flown.name, name, shown, _ends(said[-1]), False)


def _end_s(flight: Flight, cutoff_V: float) -> float:
    """Return the time at which the log reaches the cut-off under load [s]; NaN if it does not."""
    columns = ([s.time_s for s in flight.samples], [s.voltage_V for s in flight.samples])
    amps = [s.current_A for s in flight.samples]
    return end_of_flight(*columns, amps, cutoff_V=cutoff_V, min_current_A=LOADED_A)


def _flown(flight: Flight, flown: Set, pack: PackOptions) -> tuple[list[ReplayedRow], float]:
    estimator = Estimator(flown.battery, pack, ForecastSettings(flown.load))
    run = list(steps(flight, estimator))
    return run, estimator.pack_size.cutoff_V if estimator.pack_size is not None else math.nan


def _in_force(run: list[ReplayedRow], time_s: float) -> tuple[float, float] | None:
    last = [step.remaining for step in run if step.remaining.time_s <= time_s + 1e-6][-1]
    return _ends(last) if math.isfinite(last.remaining_s) else None


def _ends(said: Remaining) -> tuple[float, float]:
    return said.time_s + said.remaining_lo_s, said.time_s + said.remaining_hi_s


def _cut(flight: Flight, time_s: float) -> Flight:
    return replace(flight, samples=tuple(s for s in flight.samples if s.time_s <= time_s))


def _paths(data: Path, places: tuple[str, ...]) -> tuple[Path, ...]:
    return tuple(path for place in places for path in sorted(data.glob(place)))


def _key(path: Path) -> str:
    return f"{path.parent.name}/{path.stem}" if path.stem.startswith("flight_") else path.stem


def _mission_ends_s(data: Path) -> dict[str, float]:
    answers = {path.stem: json.loads(path.read_text()) for path in _paths(data, ("missions/answers/*.json",))}
    return {name: answer["end_s"] for name, answer in answers.items() if answer["end_s"] is not None}


def _pack_ends_s(data: Path) -> dict[str, float]:
    rows = json.loads((data / "packs/answers/flights.json").read_text())
    return {f"{row['pack']}/flight_{row['flight']:02d}": row["end_s"] for row in rows if row["end_s"] is not None}
