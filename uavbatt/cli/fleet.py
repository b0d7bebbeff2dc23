"""`uavbatt fleet`: many flights, one row each, with the health of the packs and the accuracy of the forecasts."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from uavbatt.cli.logs import InstanceOption, JoinOption, check_join
from uavbatt.cli.options import (
    DEFAULT_BATTERY,
    BatteryOption,
    CapacityOption,
    CellsOption,
    CutoffOption,
    LoadOption,
    PacksOption,
    ReserveOption,
    UncertifiedOption,
    VehicleOption,
    read_battery,
    remark,
    say,
    stated_pack,
)
from uavbatt.errors import UavbattError, UsageError
from uavbatt.output import counted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from contextlib import AbstractContextManager

    from uavbatt.fleet.fly import Job, RememberedPack
    from uavbatt.fleet.logs import LogFile
    from uavbatt.fleet.row import FlightRow
    from uavbatt.fleet.run import FinishedLog, Workers

    Crew = Callable[[], AbstractContextManager[Workers[Any]]]

PAGE = "fleet.html"
MOST_REASONS = 5


def fleet(
    logs: Annotated[list[str], typer.Argument(metavar="GLOB...", help="Logs, folders, patterns or fsspec addresses.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Folder of the tables and the page.")],
    exclude: Annotated[
        list[str] | None,
        typer.Option("--exclude", metavar="GLOB", help="Leave out logs of such a name or path; may be repeated."),
    ] = None,
    battery: BatteryOption = DEFAULT_BATTERY,
    cells: CellsOption = None,
    capacity_ah: CapacityOption = None,
    cutoff_voltage: CutoffOption = None,
    reserve_soc: ReserveOption = 0.0,
    allow_uncertified: UncertifiedOption = False,
    vehicle: VehicleOption = None,
    load: LoadOption = "learned",
    instance: InstanceOption = None,
    join: JoinOption = "",
    workers: Annotated[int | None, typer.Option("--workers", min=1, help="Processes; default: one per core.")] = None,
    scheduler: Annotated[
        str | None, typer.Option("--scheduler", metavar="ADDRESS", help="Existing Dask cluster, tcp://host:8786.")
    ] = None,
    packs: PacksOption = None,
    by: Annotated[
        str,
        typer.Option("--by", metavar="FIELD", help="Column that names the aircraft, e.g. hardware."),
    ] = "",
    aircraft: Annotated[
        str, typer.Option("--aircraft", metavar="REGEX", help="Part of a log's path that names the aircraft.")
    ] = "",
) -> None:
    """Replay all logs of a fleet: one row a flight (Parquet, CSV) and a page about packs and forecasts.

    A log that cannot be replayed becomes a row with the reason. A second run replays only new and changed logs, or all
    of them if the options have changed.
    With --packs each flight of a pack with a serial uses what earlier flights have shown of the pack, and is added to
    the ledger.

    Example: uavbatt fleet logs/ -o fleet --by hardware --exclude '*bench*'
    """
    from uavbatt.battery import vehicle_file
    from uavbatt.fleet.run import check_extra

    check_extra(scheduler)
    from uavbatt.fleet import run
    from uavbatt.fleet.fly import Job
    from uavbatt.fleet.logs import find_logs
    from uavbatt.prediction.forecaster import ForecastSettings

    _check_workers(workers, scheduler)
    options = stated_pack(cells, capacity_ah, cutoff_voltage, reserve_soc)
    _check_words(instance, join, load)
    job = Job(
        battery=read_battery(battery, allow_uncertified),
        options=options,
        settings=ForecastSettings(reserve_soc=reserve_soc),
        load=load,
        vehicle=vehicle_file.read_vehicle(vehicle) if vehicle is not None else None,
        instance=instance,
        join=join,
        by=_column(by),
        aircraft_pattern=_pattern(aircraft),
    )
    found = find_logs(logs, exclude or ())
    processes = min(workers or len(os.sched_getaffinity(0)), len(found))
    _replay_and_tell(found, job, output, packs, lambda: run.connected(processes, scheduler))


def _check_workers(workers: int | None, scheduler: str | None) -> None:
    """Raise UsageError if there cannot be so many processes, or for processes beside a cluster."""
    from uavbatt.fleet.processes import check_workers

    if workers is not None and scheduler is not None:
        raise UsageError("--workers and --scheduler: expected one of them, a cluster has workers of its own")
    check_workers(workers)


def _check_words(instance: int | None, join: str, load: str) -> None:
    """Raise UsageError for an unknown --join or --load, before the first log is read."""
    from uavbatt.log_replay.load_options import check_word

    check_join(instance, join)
    check_word(load)


def _replay_and_tell(found: list[LogFile], job: Job, output: Path, packs: Path | None, crew: Crew) -> None:
    """Replay the logs that are new or changed, write tables and page, and print the result; `crew` connects workers."""
    from uavbatt.fleet import run
    from uavbatt.fleet.logs import JOURNAL

    met, told = _health_before_each(packs, crew, found, job, output) if packs is not None else ([], "")
    flown = _worked_off(run.run_fleet(crew(), found, job, output, met), output / JOURNAL, "flights")
    _tell(output, run.rows(output, found, job, met), job, flown, len(found))
    if told:
        say(told)


def _worked_off(finished: Iterable[FinishedLog], journal: Path, what: str) -> int:
    """Process the logs with a progress bar; return how many were done in this run.

    journal : the file with the rows of earlier runs; what : the word beside the bar
    """
    count = 0
    with _progress(what) as show:
        for one in finished:
            count += one.is_new
            if one.dropped:
                remark(f"uavbatt: {journal}: damaged rows left out: {one.dropped}; their logs are replayed again")
            show(one)
    return count


def _health_before_each(
    packs: Path, crew: Crew, found: list[LogFile], job: Job, output: Path
) -> tuple[list[list[RememberedPack]], str]:
    """Fill the ledger in a first pass; return the packs of each log's flights, and a line for the user."""
    from uavbatt.fleet import ledger as fleet_ledger
    from uavbatt.fleet import run
    from uavbatt.fleet.logs import LESSONS
    from uavbatt.packs.ledger import Ledger

    with Ledger(packs) as ledger:
        _worked_off(run.learn_all(crew(), found, job, output), output / LESSONS, "packs")
        lessons = list(run.lessons(output, found, job))
        filled = fleet_ledger.fill(ledger, lessons)
        met = fleet_ledger.packs_met(ledger, lessons, filled, len(found), job.battery.certificate.content_sha256)
        count = len(ledger.packs())
    for (number, _), words in filled.left_out.items():
        remark(f"uavbatt: {found[number].name}: {words}")
    told = f"{counted(filled.saved, 'flight')} in {packs}, which remembers {counted(count, 'pack')}"
    return met, f"{told}; see `uavbatt packs {packs}`"


def _tell(folder: Path, rows: Iterable[FlightRow], job: Job, flown: int, logs: int) -> None:
    """Write the page, and print the result in a few lines. Raises UavbattError if no log could be replayed."""
    from uavbatt.fleet.tables import CSV, PARQUET
    from uavbatt.report.fleet.fleet_page import fleet_report
    from uavbatt.report.fleet.groups import gathered
    from uavbatt.report.page import write_page

    overview = gathered(rows)
    battery = f"{job.battery.battery.name} ({job.battery.status})"
    earlier = f"; {flown} of them read in this run, the others in an earlier one" if flown < logs else ""
    remarks = (("logs", f"{logs}{earlier}"),)
    write_page(folder / PAGE, fleet_report(overview, battery, remarks))
    failed = sum(overview.failures.values())
    say(f"{counted(logs, 'log')} ({flown} done now): {overview.flights} replayed, {failed} failed")
    for reason, count in sorted(overview.failures.items(), key=lambda one: -one[1])[:MOST_REASONS]:
        names = ", ".join(Path(log).name for log in overview.failed[reason])
        say(f"  {count:5d}  {reason} ({names}{', ...' if count > len(overview.failed[reason]) else ''})")
    say(f"{overview.looked} need a look; see {folder / PAGE}, {folder / CSV}, {folder / PARQUET}")
    if not overview.flights:
        raise UavbattError(f"none of {logs} logs could be replayed, the reasons are in {folder / CSV}")


def _column(name: str) -> str:
    from uavbatt.fleet.row import IDENTITIES

    if name and name not in IDENTITIES:
        raise UsageError(f"--by {name}: expected one of {', '.join(IDENTITIES)}")
    return name


def _pattern(text: str) -> str:
    try:
        re.compile(text)
    except re.error as error:
        raise UsageError(f"--aircraft {text}: expected a regular expression: {error}") from None
    return text


@contextmanager
def _progress(what: str) -> Iterator[Callable[[FinishedLog], None]]:
    """Show a progress bar on stderr, if that is a terminal."""
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what)
        yield lambda finished: bar.update(task, completed=finished.done, total=finished.total)
