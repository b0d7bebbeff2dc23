"""`uavbatt replay`: flight logs through the estimator, line by line, with a summary and a report."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from uavbatt.cli.logs import InstanceOption, JoinOption, asked_flight
from uavbatt.cli.options import (
    DEFAULT_BATTERY,
    STANDARD_OUTPUT,
    BatteryOption,
    CapacityOption,
    CellsOption,
    CutoffOption,
    ReserveOption,
    UncertifiedOption,
    check_apart,
    check_writable,
    read_battery,
    say,
    stated_pack,
)
from uavbatt.errors import UsageError, terminal_line

if TYPE_CHECKING:
    from uavbatt.battery.battery_file import BatteryFile
    from uavbatt.battery.sizing import PackOptions, PackSize
    from uavbatt.battery.vehicle_file import VehicleFile
    from uavbatt.log_replay import Outcome, Step
    from uavbatt.records import Flight


def replay(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="DataFlash, tlog, ulg or CSV.")],
    battery: BatteryOption = DEFAULT_BATTERY,
    cells: CellsOption = None,
    capacity_ah: CapacityOption = None,
    cutoff_voltage: CutoffOption = None,
    reserve_soc: ReserveOption = 0.0,
    allow_uncertified: UncertifiedOption = False,
    instance: InstanceOption = None,
    join: JoinOption = "",
    load: Annotated[str, typer.Option("--load", help="learned, recent, log or watts: the load to come.")] = "learned",
    vehicle: Annotated[Path | None, typer.Option("--vehicle", help="Vehicle file of this aircraft.")] = None,
    jsonl: Annotated[Path | None, typer.Option("--jsonl", help="Estimates as JSON Lines.")] = None,
    csv: Annotated[Path | None, typer.Option("--csv", help="Estimates as CSV.")] = None,
    summary: Annotated[Path | None, typer.Option("--json", help="Summary as JSON.")] = None,
    report: Annotated[Path | None, typer.Option("--report", help="HTML report, opens offline.")] = None,
) -> None:
    """Replay flight logs: state of charge and remaining time at every row, and how good it was.

    With several logs, --jsonl, --csv and --report name folders (one file a log) and --json holds a list.
    """
    from uavbatt.battery import vehicle_file

    several = len(logs) > 1
    targets = [[_target(path, log, ending, several) for path, ending in _outputs(jsonl, csv, report)] for log in logs]
    outputs = [summary, *(target for of_one in targets for target in of_one)]
    if several:
        _check_names(logs, jsonl, csv, report)
        check_apart(outputs, reads=[*logs, vehicle])
        for folder in (jsonl, csv, report):
            if folder is not None:
                folder.mkdir(parents=True, exist_ok=True)
    check_writable(*outputs, reads=[*logs, vehicle])
    content = read_battery(battery, allow_uncertified)
    flown = vehicle_file.read(vehicle) if vehicle is not None else None
    options = stated_pack(cells, capacity_ah, cutoff_voltage, reserve_soc)
    results = []
    for log, of_one in zip(logs, targets, strict=True):
        results.append(_one(log, content, (options, reserve_soc), (load, flown), (instance, join), (*of_one, summary)))
    if summary is not None:
        from uavbatt.files import write_json

        write_json(summary, results if several else results[0])


def _one(
    log: Path,
    content: BatteryFile,
    stated: tuple[PackOptions, float],
    load: tuple[str, VehicleFile | None],
    chosen: tuple[int | None, str],
    outputs: Sequence[Path | None],
) -> dict[str, Any]:
    """One log: its lines, table and page written, its summary told and given back."""
    from uavbatt import output
    from uavbatt.battery.statements import check
    from uavbatt.estimator import Estimator
    from uavbatt.log_replay import MANY_ROWS, engine_for, outcome, steps
    from uavbatt.prediction.forecaster import Settings
    from uavbatt.prediction.load_options import stated_load
    from uavbatt.telemetry.formats.recording import forecast_period_s

    jsonl, csv, report = outputs[:3]
    flight, (options, reserve_soc) = asked_flight(log, *chosen), stated
    check(content, options, flight)
    period_s = forecast_period_s(log)
    to_come = stated_load(load[0], flight, load[1], content)
    settings = Settings(to_come, reserve_soc, period_s) if math.isfinite(period_s) else Settings(to_come, reserve_soc)
    estimator = Estimator(content, options, settings, engine_for(is_long=len(flight.samples) >= MANY_ROWS))
    run = []
    with ExitStack() as stack:
        out = [stack.enter_context(output.json_lines(jsonl))] if jsonl is not None else []
        out += [stack.enter_context(output.csv_table(csv))] if csv is not None else []
        for step in _with_progress(steps(flight, estimator), len(flight.samples), log.name):
            run.append(step)
            for sink in out:
                sink.write(output.line(step.estimate, step.remaining))
        resolved = estimator.pack_size
        if resolved is None:
            raise UsageError(f"{log}: expected at least one row with a voltage")
        found = outcome(run, resolved.cutoff_V)
        if report is not None:
            from uavbatt.report.flight import flight_report
            from uavbatt.report.page import write_page

            write_page(report, flight_report(flight, run, resolved, found, content))
    for line in _lines(flight, resolved, found, run):
        say(line, *outputs)
    return _summary(flight, resolved, found, run, content)


def _with_progress(rows: Any, total: int, name: str) -> Any:
    """A progress bar on stderr when it is a terminal and the log is long enough to wait for."""
    if not sys.stderr.isatty() or total < 2000:
        return rows
    from rich.console import Console
    from rich.progress import track

    return track(rows, total=total, description=terminal_line(name), console=Console(stderr=True), transient=True)


def _lines(flight: Flight, resolved: PackSize, found: Outcome, run: list[Step]) -> list[str]:
    """The summary for a person."""
    status = resolved.status if resolved.status == "certified" else f"{resolved.status}, not certified"
    lines = [
        f"{flight.source}: {flight.kind}, {found.rows} rows, {found.duration_s:.0f} s",
        f"  battery    {resolved.battery} ({status}); {resolved.words}",
        f"  at the end {found.end_voltage_V:.2f} V, state of charge {_number(found.end_soc, '.3f')} "
        f"± {_number(found.end_soc_sd, '.3f')}; {_given(found.refused_in_air)}",
    ]
    warnings = dict.fromkeys(w for s in run for w in s.estimate.warnings)
    lines += [f"  warning    {w}" for w in [*warnings, *flight.notes]]
    if flight.skipped_bytes:
        lines.append(f"  warning    {flight.skipped_bytes} bytes of the log were unreadable and skipped")
    if math.isfinite(found.end_of_flight_s):
        lines.append(f"  end of flight at {found.end_of_flight_s:.0f} s; forecasts before it (positive = optimistic):")
        for c in found.checkpoints:
            if math.isfinite(c.remaining_s):
                verdict = "inside" if c.inside else "outside"
                lines.append(
                    f"    {c.label:>13}: said {c.remaining_s:4.0f} s [{c.lo_s:.0f}, {c.hi_s:.0f}], true "
                    f"{c.before_end_s:4.0f} s, error {round(c.error_s):+5d} s, {verdict} the 90 % interval"
                )
            else:
                lines.append(f"    {c.label:>13}: refused, true {c.before_end_s:.0f} s")
    else:
        last = run[-1].remaining
        between = f"{_clock(last.remaining_lo_s)} to {_clock(last.remaining_hi_s)}"
        left = f"{_clock(last.remaining_s)} min left at the last row ({between})"
        said = left if math.isfinite(last.remaining_s) else f"no forecast at the last row: {last.reason}"
        lines.append(f"  the flight ended before its battery did; {said}")
    return lines


def _given(refused_in_air: float) -> str:
    """Say how often a forecast was given while the aircraft flew."""
    if not math.isfinite(refused_in_air):
        return "not seen in the air for more than a minute"
    if refused_in_air == 0.0:
        return "a forecast at all times in the air"
    return f"no forecast at {refused_in_air:.1%} of the rows in the air"


def _clock(seconds: float) -> str:
    """Minutes and seconds, `16:22`."""
    if not math.isfinite(seconds):
        return "unknown"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d}"


def _summary(
    flight: Flight, resolved: PackSize, found: Outcome, run: list[Step], content: BatteryFile
) -> dict[str, Any]:
    """The summary for a program (DESIGN §5)."""
    from dataclasses import asdict

    scores = [
        {**asdict(c), "error_s": c.error_s, "inside": c.inside if math.isfinite(c.remaining_s) else False}
        for c in found.checkpoints
    ]
    return {
        "log": flight.source,
        "kind": flight.kind,
        "instance": flight.instance,
        "battery": resolved.battery,
        "certificate_status": resolved.status,
        "content_sha256": content.certificate.content_sha256,
        "cells": resolved.cells,
        "cells_from": resolved.cells_from,
        "capacity_Ah": resolved.capacity_Ah,
        "capacity_from": resolved.capacity_from,
        "cutoff_V": resolved.cutoff_V,
        "cutoff_from": resolved.cutoff_from,
        "low_V": resolved.low_V,
        "low_from": resolved.low_from,
        "skipped_bytes": flight.skipped_bytes,
        "notes": list(flight.notes),
        "warnings": list(dict.fromkeys(w for s in run for w in s.estimate.warnings)),
        **{k: v for k, v in asdict(found).items() if k != "checkpoints"},
        "scores": scores,
    }


def _number(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else "unknown"


def _outputs(jsonl: Path | None, csv: Path | None, report: Path | None) -> list[tuple[Path | None, str]]:
    return [(jsonl, ".jsonl"), (csv, ".csv"), (report, ".html")]


def _target(path: Path | None, log: Path, ending: str, several: bool) -> Path | None:
    return path / (log.stem + ending) if path is not None and several else path


def _check_names(logs: list[Path], *folders: Path | None) -> None:
    if len({log.stem for log in logs}) < len(logs) and any(folders):
        raise UsageError("several logs of one name: expected different names, one output file is written for each")
    for folder in folders:
        if folder is None:
            continue
        if folder == STANDARD_OUTPUT or (folder.exists() and not folder.is_dir()):
            raise UsageError(f"{folder}: expected a folder, several logs write one file each")
