"""`uavbatt replay`: flight logs through the estimator, line by line, with a summary and a report."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from uavbatt.cli import pack_memory
from uavbatt.cli.logs import InstanceOption, JoinOption, SystemOption, asked_flight, distinct_names
from uavbatt.cli.options import (
    DEFAULT_BATTERY,
    STANDARD_OUTPUT,
    BatteryOption,
    CapacityOption,
    CellsOption,
    CutoffOption,
    LoadOption,
    PackOption,
    PacksOption,
    ReserveOption,
    UncertifiedOption,
    VehicleOption,
    check_apart,
    check_ending,
    check_named,
    check_writable,
    read_battery,
    remark,
    say,
    stated_pack,
)
from uavbatt.errors import UavbattError, UsageError, terminal_line

if TYPE_CHECKING:
    from uavbatt.battery.battery_file import BatteryFile
    from uavbatt.battery.sizing import PackOptions
    from uavbatt.battery.vehicle_file import VehicleFile
    from uavbatt.cli.pack_memory import PackMemory
    from uavbatt.telemetry.formats.mission_file import PlannedFlight


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
    system: SystemOption = None,
    load: LoadOption = "learned",
    vehicle: VehicleOption = None,
    packs: PacksOption = None,
    pack: PackOption = "",
    mission: Annotated[
        Path | None, typer.Option("--mission", help="The planned mission: a .waypoints or .plan file.")
    ] = None,
    jsonl: Annotated[Path | None, typer.Option("--jsonl", help="Estimates as JSON Lines.")] = None,
    csv: Annotated[Path | None, typer.Option("--csv", help="Estimates as CSV.")] = None,
    summary: Annotated[Path | None, typer.Option("--json", help="Summary as JSON.")] = None,
    report: Annotated[Path | None, typer.Option("--report", help="HTML report, opens offline.")] = None,
    png: Annotated[Path | None, typer.Option("--png", help="The chart of the time left as PNG.")] = None,
    svg: Annotated[Path | None, typer.Option("--svg", help="The same as SVG.")] = None,
    plain: Annotated[bool, typer.Option("--plain", help="Only a few sentences for the pilot.")] = False,
) -> None:
    """Replay flight logs: state of charge and remaining time at every row, and how accurate they were.

    With several logs, --jsonl, --csv, --report, --png and --svg name folders (one file a log) and --json holds a list.
    If a log cannot be replayed, the reason is printed, the others are replayed, and the exit code is 1.
    With --packs each flight begins with the health of its pack in the ledger, and is added to the ledger.

    Example: uavbatt replay flight.BIN --report flight.html
    """
    from uavbatt.battery import vehicle_file
    from uavbatt.telemetry.formats.mission_file import read_mission

    several = len(logs) > 1
    names = distinct_names(logs)
    targets = [
        [_target(path, name, ending, several) for path, ending in _endings(jsonl, csv, report, png, svg)]
        for name in names
    ]
    outputs = [summary, *(target for of_one in targets for target in of_one)]
    check_named(png, svg)
    if several:
        _check_folders(jsonl, csv, report, png, svg)
        check_apart(outputs, reads=[*logs, vehicle, mission])
        for folder in (jsonl, csv, report, png, svg):
            if folder is not None:
                folder.mkdir(parents=True, exist_ok=True)
    check_writable(*outputs, reads=[*logs, vehicle, mission, packs])
    for path, option, ending in ((report, "--report", ".html"), (png, "--png", ".png"), (svg, "--svg", ".svg")):
        check_ending(path if not several else None, option, ending)
    content = read_battery(battery, allow_uncertified)
    planned = read_mission(mission) if mission is not None else None
    flown = vehicle_file.read_vehicle(vehicle) if vehicle is not None else None
    options = stated_pack(cells, capacity_ah, cutoff_voltage, reserve_soc)
    results, failed = list[dict[str, Any]](), False
    with pack_memory.open_memory(packs, pack) as memory:
        for log, of_one in zip(logs, targets, strict=True):
            chosen, to_come, outputs_of_one = (instance, join, system), (load, flown), (*of_one, summary)
            stated = (options, reserve_soc)
            try:
                results.append(_one(log, content, stated, to_come, chosen, memory, outputs_of_one, planned, plain))
            except UavbattError as error:
                if not several:
                    raise
                failed = True
                remark(f"uavbatt: {error}")
                results.append({"log": str(log), "error": terminal_line(error)})
    if summary is not None:
        from uavbatt.files import write_json

        write_json(summary, results if several else results[0])
    if failed:
        raise typer.Exit(1)


def _one(
    log: Path,
    content: BatteryFile,
    stated: tuple[PackOptions, float],
    load: tuple[str, VehicleFile | None],
    chosen: tuple[int | None, str, int | None],
    memory: PackMemory,
    outputs: Sequence[Path | None],
    planned: PlannedFlight | None,
    is_plain: bool,
) -> dict[str, Any]:
    """Replay one log: write its outputs, print its result, and return its summary for JSON."""
    from uavbatt import output
    from uavbatt.log_replay.outcome import outcome
    from uavbatt.log_replay.run import estimator_for, recorded_period_s, size_of_replayed, steps, with_mission
    from uavbatt.prediction.forecaster import ForecastSettings
    from uavbatt.prediction.load_options import stated_load
    from uavbatt.report import flight_text

    jsonl, csv, report, *charts = outputs[:5]
    flight, (options, reserve_soc) = asked_flight(log, *chosen), stated
    if planned is not None:
        flight = with_mission(flight, planned)
    to_come = stated_load(load[0], flight, load[1], content)
    settings = ForecastSettings(to_come, reserve_soc, recorded_period_s(flight))
    health = memory.health_before(flight, content)
    estimator = estimator_for(flight, content, options, settings, health)
    run = []
    with ExitStack() as stack:
        out = [stack.enter_context(output.json_lines(jsonl))] if jsonl is not None else []
        out += [stack.enter_context(output.csv_table(csv, flight.has_way))] if csv is not None else []
        for step in _with_progress(steps(flight, estimator), len(flight.samples), log.name):
            run.append(step)
            for sink in out:
                sink.write(output.line(step.estimate, step.remaining))
        resolved = size_of_replayed(estimator, flight)
        found = outcome(run, resolved.cutoff_V, reserve_soc)
        if any(charts):
            from uavbatt.report.flight import save_charts

            wanted = [path for path in charts if path is not None]
            if not save_charts(wanted, flight, run, resolved, found):
                remark(f"uavbatt: {', '.join(map(str, wanted))}: not written, the time left was refused throughout")
        if report is not None:
            from uavbatt.report.flight import flight_report
            from uavbatt.report.page import write_page

            write_page(report, flight_report(flight, run, resolved, found, content))
    learned = memory.learn(flight, content, options, health)
    lines = flight_text.plain_lines if is_plain else flight_text.lines
    for line in [*lines(flight, resolved, found, run), *learned.lines]:
        say(line, *outputs)
    return {**flight_text.summary(flight, resolved, found, run, content), **learned.fields}


def _with_progress(rows: Any, total: int, name: str) -> Any:
    """Return the rows with a progress bar on stderr, if that is a terminal and the log is long."""
    if not sys.stderr.isatty() or total < 2000:
        return rows
    from rich.console import Console
    from rich.progress import track

    return track(rows, total=total, description=terminal_line(name), console=Console(stderr=True), transient=True)


def _endings(*paths: Path | None) -> list[tuple[Path | None, str]]:
    """Return each output, in the order of the options, with the ending of its file."""
    return list(zip(paths, (".jsonl", ".csv", ".html", ".png", ".svg"), strict=True))


def _target(path: Path | None, name: str, ending: str, several: bool) -> Path | None:
    return path / (name + ending) if path is not None and several else path


def _check_folders(*folders: Path | None) -> None:
    for folder in folders:
        if folder is None:
            continue
        if folder == STANDARD_OUTPUT or (folder.exists() and not folder.is_dir()):
            raise UsageError(f"{folder}: expected a folder, several logs write one file each")
