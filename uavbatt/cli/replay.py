"""`uavbatt replay`: flight logs through the estimator, line by line, with a summary and a report."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from uavbatt.cli import pack_memory
from uavbatt.cli.logs import InstanceOption, JoinOption, SystemOption, asked_flight, distinct_names, logs_in
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
    from uavbatt.battery.remembered import PackHealth
    from uavbatt.battery.sizing.pack_size import PackOptions, PackSize
    from uavbatt.battery.vehicle_file import VehicleFile
    from uavbatt.cli.pack_memory import PackMemory
    from uavbatt.log_replay.flights import ReplayedFlight
    from uavbatt.log_replay.outcome import Outcome
    from uavbatt.log_replay.run import ReplayedRow
    from uavbatt.records import Flight
    from uavbatt.telemetry.formats.mission_file import PlannedFlight

ENDINGS = (".jsonl", ".csv", ".html", ".png", ".svg")


class Outputs(NamedTuple):
    """Outputs holds the output files of a log, or the folders of several logs; None if not wanted."""

    jsonl: Path | None
    csv: Path | None
    report: Path | None
    png: Path | None
    svg: Path | None

    def of_flight(self, number: int) -> Outputs:
        """Return the files of a flight of the log; the names of charts and page have its number, from the second on."""
        if number == 1:
            return self
        named = (path and path.with_stem(f"{path.stem}-{number}") for path in (self.report, self.png, self.svg))
        return Outputs(self.jsonl, self.csv, *named)

    def in_folders(self, name: str) -> Outputs:
        """Return the files of one log, by its name, in these folders."""
        return Outputs(*(path and path / (name + ending) for path, ending in zip(self, ENDINGS, strict=True)))


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """ReplayOptions holds the settings with which every log of a call is replayed."""

    battery: BatteryFile
    pack: PackOptions
    reserve_soc: float
    load: str
    vehicle: VehicleFile | None
    mission: PlannedFlight | None
    instance: int | None
    join: str
    system: int | None
    is_plain: bool


def replay(
    sources: Annotated[
        list[Path], typer.Argument(metavar="LOG...", help="Logs (.BIN, .log, .tlog, .ulg or CSV), folders of logs.")
    ],
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
        Path | None, typer.Option("--mission", help="Mission file (.waypoints, .plan); replaces the log's.")
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

    logs = logs_in(sources, "a folder with flight logs, found none in it")
    outputs = _checked_outputs(logs, Outputs(jsonl, csv, report, png, svg), summary, [vehicle, mission, packs])
    options = ReplayOptions(
        battery=read_battery(battery, allow_uncertified),
        pack=stated_pack(cells, capacity_ah, cutoff_voltage, reserve_soc),
        reserve_soc=reserve_soc,
        load=load,
        vehicle=vehicle_file.read_vehicle(vehicle) if vehicle is not None else None,
        mission=read_mission(mission) if mission is not None else None,
        instance=instance,
        join=join,
        system=system,
        is_plain=plain,
    )
    with pack_memory.open_memory(packs, pack) as memory:
        results = _each(logs, options, memory, outputs, summary)
    if summary is not None:
        from uavbatt.files import write_json

        write_json(summary, results if len(logs) > 1 else results[0])
    if any("error" in result for result in results):
        raise typer.Exit(1)


def _checked_outputs(
    logs: list[Path], named: Outputs, summary: Path | None, inputs: list[Path | None]
) -> list[Outputs]:
    """Return the output files of each log, and make their folders; raise UsageError where one cannot be written.

    inputs : the files that the command reads beside the logs
    """
    check_named(named.png, named.svg)
    several, reads = len(logs) > 1, [*logs, *inputs]
    outputs = [named.in_folders(name) for name in distinct_names(logs)] if several else [named]
    targets = [summary, *(path for of_one in outputs for path in of_one)]
    if several:
        _check_folders(named)
        check_apart(targets, reads)
        for folder in filter(None, named):
            folder.mkdir(parents=True, exist_ok=True)
    check_writable(*targets, reads=reads)
    if not several:
        check_ending(named.report, "--report", ".html")
        check_ending(named.png, "--png", ".png")
        check_ending(named.svg, "--svg", ".svg")
    return outputs


def _each(
    logs: list[Path], options: ReplayOptions, memory: PackMemory, outputs: list[Outputs], summary: Path | None
) -> list[dict[str, Any]]:
    """Return the summary of each log; of several logs, the error of one that cannot be replayed takes its place."""
    results = list[dict[str, Any]]()
    for log, of_one in zip(logs, outputs, strict=True):
        try:
            results.append(_one(log, options, memory, of_one, summary))
        except UavbattError as error:
            if len(logs) == 1:
                raise
            remark(f"uavbatt: {error}")
            results.append({"log": str(log), "error": terminal_line(error)})
    return results


def _one(
    log: Path, options: ReplayOptions, memory: PackMemory, outputs: Outputs, summary: Path | None
) -> dict[str, Any]:
    """Replay one log: write its outputs, print its result, and return its summary for JSON."""
    from uavbatt.log_replay.flights import ReplayedFlight, flights_of
    from uavbatt.log_replay.load_options import stated_load
    from uavbatt.log_replay.outcome import outcome
    from uavbatt.log_replay.run import estimator_for, recorded_period_s, size_of_replayed, steps, with_mission
    from uavbatt.prediction.forecaster import ForecastSettings
    from uavbatt.report.flight import text as flight_text
    from uavbatt.telemetry.discharges import of_discharges

    flight = asked_flight(log, options.instance, options.join, options.system)
    if options.mission is not None:
        flight = with_mission(flight, options.mission)
    options = replace(options, pack=memory.known_size(flight, options.battery, options.pack))
    to_come = stated_load(options.load, flight, options.vehicle, options.battery)
    settings = ForecastSettings(to_come, options.reserve_soc, recorded_period_s(flight))
    health = memory.health_before(flight, options.battery)
    later = [memory.health_before(part, options.battery) for part in of_discharges(flight)[1:]]
    estimator = estimator_for(flight, options.battery, options.pack, settings, health)
    with ExitStack() as stack:  # no file appears if a later step fails
        run = _written(steps(flight, estimator, later), flight, log.name, outputs, stack)
        size = size_of_replayed(estimator, flight)
        found = outcome(run, size.cutoff_V, options.reserve_soc)
        parts = flights_of(ReplayedFlight(flight, run, found), size.cutoff_V)
        for number, part in enumerate(parts, start=1):
            _draw(outputs.of_flight(number), *part, size, options.battery)
    told = [
        _told(part, size, options, memory, memory.health_before(part.flight, options.battery) if number else health)
        for number, part in enumerate(parts)
    ]
    for lines, _ in told:
        for line in lines:
            say(line, *outputs, summary)
    if len(parts) == 1:
        return told[0][1]
    return {**flight_text.summary(flight, size, found, run, options.battery), "flights": [of_one for _, of_one in told]}


def _told(
    part: ReplayedFlight, size: PackSize, options: ReplayOptions, memory: PackMemory, health: PackHealth | None
) -> tuple[list[str], dict[str, Any]]:
    """Return the result of a flight as lines and for JSON, and add it to the ledger; `health` is that before it."""
    from uavbatt.report.flight import text as flight_text

    flight, run, found = part
    learned = memory.learn(flight, options.battery, options.pack, health)
    lines = flight_text.plain_lines if options.is_plain else flight_text.lines
    fields = flight_text.summary(flight, size, found, run, options.battery)
    return [*lines(flight, size, found, run), *learned.lines], {**fields, **learned.fields}


def _written(
    rows: Iterator[ReplayedRow], flight: Flight, name: str, outputs: Outputs, stack: ExitStack
) -> list[ReplayedRow]:
    """Return the rows of the replay; write each line to the table files, which are complete when `stack` closes."""
    from uavbatt import output

    sinks = [stack.enter_context(output.json_lines(outputs.jsonl))] if outputs.jsonl is not None else []
    sinks += [stack.enter_context(output.csv_table(outputs.csv, flight.has_way))] if outputs.csv is not None else []
    run = []
    for step in _with_progress(rows, len(flight.samples), name):
        run.append(step)
        for sink in sinks:
            sink.write(output.line(step.estimate, step.remaining))
    return run


def _draw(
    outputs: Outputs, flight: Flight, run: list[ReplayedRow], found: Outcome, size: PackSize, battery: BatteryFile
) -> None:
    """Write the charts and the page that are wanted."""
    charts = [path for path in (outputs.png, outputs.svg) if path is not None]
    if charts:
        from uavbatt.report.flight.flight_page import save_charts

        if not save_charts(charts, flight, run, size, found):
            remark(f"uavbatt: {', '.join(map(str, charts))}: not written, the time left was refused throughout")
    if outputs.report is not None:
        from uavbatt.report.flight.flight_page import flight_report
        from uavbatt.report.page import write_page

        write_page(outputs.report, flight_report(flight, run, size, found, battery))


def _with_progress(rows: Any, total: int, name: str) -> Any:
    """Return the rows with a progress bar on stderr, if that is a terminal and the log is long."""
    if not sys.stderr.isatty() or total < 2000:
        return rows
    from rich.console import Console
    from rich.progress import track

    return track(rows, total=total, description=terminal_line(name), console=Console(stderr=True), transient=True)


def _check_folders(folders: Outputs) -> None:
    for folder in filter(None, folders):
        if folder == STANDARD_OUTPUT or (folder.exists() and not folder.is_dir()):
            raise UsageError(f"{folder}: expected a folder, several logs write one file each")
