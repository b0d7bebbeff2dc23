"""Every shared flight with the packaged generic battery, as for a user who knows capacity and cell count only."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from scoring.data import M100_CELLS, M100_CUTOFF_V
from scoring.lines import ours
from scoring.m100 import RATED_AH
from scoring.table import Table, figure, with_error
from uavbatt.battery import battery_file
from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.errors import UavbattError
from uavbatt.estimator import Estimator
from uavbatt.log_replay.outcome import Outcome, outcome
from uavbatt.log_replay.run import ReplayedRow, steps
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.telemetry import read_log

EMPTIED = "quad_3s_2650_emptied.BIN"
PERIOD_S = 10.0
STATED = {
    EMPTIED: PackOptions(cutoff_V=9.6),
    "m100": PackOptions(cells=M100_CELLS, capacity_Ah=RATED_AH, cutoff_V=M100_CUTOFF_V),
}
PLACES = ("flights/ardupilot/*", "flights/px4/*.ulg", "truth/reference/r0/*", "flights/m100/m100_*.csv")


def tables(data: Path, say: Callable[[str], None]) -> list[Table]:
    """Return the tables of all shared flights, and of the pack that was flown empty."""
    battery = battery_file.read_battery("lipo-generic")
    paths = [path for place in PLACES for path in sorted(data.glob(place))]
    rows: list[tuple[str, ...]] = []
    errors: list[tuple[float, float]] = []
    refused: list[str] = []
    for path in paths:
        say(f"flights: {path.name}")
        try:
            row, error = _row(path, battery)
        except UavbattError as problem:
            row, error = (_name(path), "refused", "", "", "", ""), (math.nan, math.nan)
            refused.append(f"{_name(path)}: {problem}".replace(str(path), path.name))
        rows.append(row)
        if "m100" in path.name:
            errors.append(error)
    half_s, late_s = (np.abs([e[i] for e in errors if math.isfinite(e[i])]) for i in (0, 1))
    means = [with_error(float(e.mean()), float(e.std(ddof=1) / math.sqrt(e.size))) for e in (half_s, late_s)]
    rows.append(("M100, mean |error| ± standard error", "", "", "", *means))
    head = ("flight", "rows", "end voltage [V]", "soc at end", "half time [s]", "2 min before [s]")
    note = (
        "`lipo-generic`, load of an unknown aircraft. Error = forecast - truth, and whether the 90 % interval held "
        "(✓, ✗); – where the log does not reach the cut-off. The logs continue after the cut-off, some to the landing. "
        + "; ".join(f"Refused: {line}" for line in refused)
    )
    emptied = next(path for path in paths if path.name == EMPTIED)
    return [Table("All shared flights", head, tuple(rows), note), _emptied(emptied, battery)]


def _options(path: Path) -> PackOptions:
    return STATED.get(path.name) or STATED.get(path.name.split("_")[0]) or PackOptions()


def _name(path: Path) -> str:
    """Return the file's name, with the name of its set if the file's alone is not enough."""
    return f"{path.parent.name}/{path.name}" if path.name.startswith("flight_") else path.name


def _run(path: Path, battery: BatteryFile) -> tuple[list[ReplayedRow], Outcome]:
    estimator = Estimator(battery, _options(path), ForecastSettings(forecast_period_s=PERIOD_S))
    run = list(steps(read_log(path), estimator))
    if estimator.pack_size is None:
        raise ValueError(f"{path.name}: no voltage")
    return run, outcome(run, estimator.pack_size.cutoff_V)


def _row(path: Path, battery: BatteryFile) -> tuple[tuple[str, ...], tuple[float, float]]:
    """Return the cells of one flight, and its errors [s] at half time and two minutes before the end."""
    _, found = _run(path, battery)
    at = {c.label: c for c in found.checkpoints}
    cells, errors = [], []
    for label in ("half time", "120 s before"):
        if label in at and math.isfinite(at[label].remaining_s):
            cells.append(f"{figure(at[label].error_s, sign=True)} {'✓' if at[label].inside else '✗'}")
            errors.append(at[label].error_s)
        else:
            cells.append("refused" if label in at else figure(math.nan))
            errors.append(math.nan)
    soc = f"{figure(found.end_soc, 2)} ± {figure(found.end_soc_sd, 2)}"
    row = (_name(path), str(found.rows), figure(found.end_voltage_V, 2), soc, *cells)
    return row, (errors[0], errors[1])


def _emptied(path: Path, battery: BatteryFile) -> Table:
    """Return the table of the pack that was flown empty, at every instant."""
    run, found = _run(path, battery)
    start_s = next(s.remaining.time_s for s in run if math.isfinite(s.remaining.remaining_s))
    score = ours(run).scored(path.name, "", start_s, found.end_of_flight_s)
    rows = []
    for label, i in score.at.items():
        seconds = (figure(i.truth_s), figure(i.forecast_s), figure(i.error_s, sign=True), figure(i.width_s))
        rows.append((label, *seconds, "✓" if i.inside else "✗"))
    head = ("before the end", "true [s]", "said [s]", "error [s]", "width [s]", "inside")
    note = f"lipo-generic, cut-off 9.6 V, nothing fitted; two-minute alarm with {score.alarm_at_s:.0f} s left."
    return Table(f"{path.name}, flown empty", head, tuple(rows), note)
