"""Simulated truth: a pack flown by a simulator that is not ours, with its true charge and voltage on record."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from peers.columns import FloatArray

from scoring.lines import logged, ours, replayed
from scoring.table import DASH, Table, figure
from uavbatt import dataset
from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.fitting.battery import RecordedPack, fit_battery
from uavbatt.log_replay.run import ReplayedRow
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.prediction.load.scenarios import RecentMean
from uavbatt.records import Flight
from uavbatt.scoring.end_of_flight import end_of_flight
from uavbatt.telemetry import read_log

CELLS, CAPACITY_AH, CUTOFF_V = 4, 5.0, 13.2
SIZE = RecordedPack("truth-lab", CELLS, CAPACITY_AH, CUTOFF_V)
PACK = PackOptions(cells=CELLS, capacity_Ah=CAPACITY_AH, cutoff_V=CUTOFF_V)
FLYING_A = 2.0
PERIOD_S = 10.0
SETS = ("reference/r0", "practice/p1")


@dataclass(frozen=True, slots=True)
class Answer:
    """An Answer is what the simulator says of one flight."""

    time_s: FloatArray
    soc: FloatArray
    start_s: float
    end_s: float
    ambient_C: float


@dataclass(frozen=True, slots=True)
class Judged:
    """Judged holds one replay against its answer: errors [s], of the flight [-], and of the charge [-]."""

    half_s: float
    half_share: float
    late_s: float
    soc_rmse: float
    inside: str


def truth_battery(data: Path) -> BatteryFile:
    """Fit the battery of the simulated truth, from its bench tests and reference flights."""
    reference = [read_log(log) for log in sorted((data / "truth/reference/r0").glob("flight_*.tlog"))]
    return fit_battery(SIZE, [dataset.load(data / "truth/lab")], reference).file


def tables(data: Path, say: Callable[[str], None]) -> list[Table]:
    """Return two tables: from the bench alone, and from bench and reference flights."""
    folder = data / "truth"
    flights = {name: _flights(folder, name) for name in SETS}
    lab = dataset.load(folder / "lab")
    say("truth: fitting the bench tests")
    bench = fit_battery(SIZE, [lab], []).file
    say("truth: fitting the bench tests and the reference flights")
    reference = [flight for flight, _ in flights["reference/r0"]]
    both = fit_battery(SIZE, [lab], reference).file
    return [
        _table("Simulated truth, battery from truth/lab alone", bench, flights, SETS, say),
        _table("Simulated truth, battery from truth/lab and truth/reference", both, flights, SETS[1:], say),
    ]


def _flights(folder: Path, name: str) -> list[tuple[Flight, Answer]]:
    logs = sorted((folder / name).glob("flight_*.tlog"))
    return [(read_log(log), _answer(folder / "answers" / name / f"{log.stem}.csv")) for log in logs]


def _answer(path: Path) -> Answer:
    with path.open(newline="") as stream:
        rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(stream)]
    time_s, soc, volts, amps, core_C = (np.array([r[key] for r in rows]) for key in ("t", "soc", "v", "i", "core_c"))
    start_s = float(time_s[np.argmax(amps > FLYING_A)])
    return Answer(time_s, soc, start_s, end_of_flight(time_s, volts, cutoff_V=CUTOFF_V), float(core_C[0]))


def _table(
    title: str,
    battery: BatteryFile,
    flights: dict[str, list[tuple[Flight, Answer]]],
    sets: tuple[str, ...],
    say: Callable[[str], None],
) -> Table:
    head = ("flight", "flown [s]", "load", "half time [s]", "half time", "2 min before [s]", "soc RMSE", "inside")
    rows: list[tuple[str, ...]] = []
    together: dict[str, list[Judged]] = {"log": [], "recent": []}
    for name in sets:
        means: dict[str, list[Judged]] = {"log": [], "recent": []}
        for number, (flight, answer) in enumerate(flights[name], 1):
            say(f"truth: {name} flight {number}, {battery.discrepancy.source}")
            for load, known in (("log", logged(flight)), ("recent", RecentMean())):
                settings = ForecastSettings(known, forecast_period_s=PERIOD_S)
                # cells, capacity, cut-off: the vehicle's
                judged = _judge(replayed(flight, battery, PackOptions(), settings), answer)
                means[load].append(judged)
                together[load].append(judged)
                label = f"{name} {number}, {answer.ambient_C:.0f} °C"
                rows.append((label, figure(answer.end_s - answer.start_s), load, *_cells(judged)))
        rows += [(f"{name}, mean |error|", "", load, *_mean_cells(every)) for load, every in means.items()]
    if len(sets) > 1:
        rows += [("all flights, mean |error|", "", load, *_mean_cells(every)) for load, every in together.items()]
    note = (
        "Positive: too optimistic. End of flight: 5 s mean of the true voltage below 13.2 V. soc RMSE over all rows up "
        "to the end, against the true charge of the pack. Inside: of the 90 % interval at the two instants."
    )
    return Table(title, head, tuple(rows), note)


def _judge(run: list[ReplayedRow], answer: Answer) -> Judged:
    score = ours(run).scored("", "", answer.start_s, answer.end_s)
    known = [s.estimate for s in run if np.isfinite(s.estimate.soc) and s.estimate.time_s <= answer.end_s]
    said = np.array([e.soc for e in known])
    true = np.interp([e.time_s for e in known], answer.time_s, answer.soc)
    half, late = score.at["50%"], score.at["120 s"]
    return Judged(
        half_s=half.error_s,
        half_share=half.error_s / (answer.end_s - answer.start_s),
        late_s=late.error_s,
        soc_rmse=float(np.sqrt(np.mean((said - true) ** 2))),
        inside="".join("✓" if i.inside else "✗" for i in (half, late)),
    )


def _cells(judged: Judged) -> tuple[str, ...]:
    return (
        figure(judged.half_s, sign=True),
        f"{judged.half_share:+.1%}",
        figure(judged.late_s, sign=True),
        f"{judged.soc_rmse:.1%}",
        judged.inside,
    )


def _mean_cells(every: list[Judged]) -> tuple[str, ...]:
    """Return mean absolute errors over flights, and the worst soc RMSE."""
    return (
        figure(float(np.mean([abs(j.half_s) for j in every]))),
        f"{np.mean([abs(j.half_share) for j in every]):.1%}",
        figure(float(np.mean([abs(j.late_s) for j in every]))),
        f"{max(j.soc_rmse for j in every):.1%} at most",
        DASH,
    )
