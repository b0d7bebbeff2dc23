"""`uavbatt fleet`: many flights, one row each, with the health of the packs and the accuracy over all of them."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uavbatt.cli.options import (
    DEFAULT_BATTERY,
    BatteryOption,
    CapacityOption,
    CellsOption,
    CutoffOption,
    PacksOption,
    ReserveOption,
    UncertifiedOption,
    read_battery,
    remark,
    say,
    stated_pack,
)
from uavbatt.errors import UavbattError, UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from uavbatt.fleet.fly import Job
    from uavbatt.fleet.row import FlightRow
    from uavbatt.fleet.run import Finished

PAGE = "fleet.html"
MOST_REASONS = 5


def fleet(
    logs: Annotated[list[str], typer.Argument(metavar="GLOB...", help="Logs, folders, patterns or fsspec addresses.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Folder of the tables and the page.")],
    battery: BatteryOption = DEFAULT_BATTERY,
    cells: CellsOption = None,
    capacity_ah: CapacityOption = None,
    cutoff_voltage: CutoffOption = None,
    reserve_soc: ReserveOption = 0.0,
    allow_uncertified: UncertifiedOption = False,
    workers: Annotated[int | None, typer.Option("--workers", min=1, help="Processes; default: one a core.")] = None,
    scheduler: Annotated[
        str | None, typer.Option("--scheduler", metavar="ADDRESS", help="Existing Dask cluster, tcp://host:8786.")
    ] = None,
    packs: PacksOption = None,
    by: Annotated[
        str,
        typer.Option("--by", metavar="FIELD", help="Column that names the aircraft, as hardware."),
    ] = "",
    aircraft: Annotated[
        str, typer.Option("--aircraft", metavar="REGEX", help="What of a log's path names the aircraft.")
    ] = "",
) -> None:
    """Fly a whole fleet's logs: one row a flight (Parquet, CSV) and a page about packs and forecasts.

    A log that cannot be flown is a row with its reason. Run again, only new and changed logs are flown.
    With --packs what the flights taught of packs with a serial is saved in the ledger.
    """
    from uavbatt.fleet.run import check_extra

    check_extra(scheduler)
    from uavbatt.fleet import run
    from uavbatt.fleet.fly import Job
    from uavbatt.fleet.logs import JOURNAL, find_logs
    from uavbatt.prediction.forecaster import ForecastSettings

    if workers is not None and scheduler is not None:
        raise UsageError("--workers and --scheduler: expected one of them, a cluster has workers of its own")
    options = stated_pack(cells, capacity_ah, cutoff_voltage, reserve_soc)
    settings = ForecastSettings(reserve_soc=reserve_soc)
    content = read_battery(battery, allow_uncertified)
    job = Job(content, options, settings, _column(by), _pattern(aircraft), teaches=packs is not None)
    found = find_logs(logs)
    flown = 0
    crew = run.connected(workers or len(os.sched_getaffinity(0)), scheduler)
    with _progress() as show:
        for finished in run.run_fleet(crew, found, job, output):
            flown += finished.row is not None
            if finished.dropped:
                left_out = f"damaged rows left out: {finished.dropped}; their logs are flown again"
                remark(f"uavbatt: {output / JOURNAL}: {left_out}")
            show(finished)
    _tell(output, run.rows(output, found, job), job, flown, len(found))
    if packs is not None:
        _fill(packs, run.rows(output, found, job))


def _fill(packs: Path, rows: Iterable[FlightRow]) -> None:
    """Save in the ledger what the flights taught."""
    from uavbatt.fleet.ledger import fill
    from uavbatt.packs.ledger import Ledger

    with Ledger(packs) as ledger:
        saved, left_out = fill(ledger, rows)
        count = len(ledger.packs())
    for words in left_out:
        remark(f"uavbatt: {words}")
    say(f"{saved} flights in {packs}, which remembers {count} pack{'s' * (count != 1)}; see `uavbatt packs {packs}`")


def _tell(folder: Path, rows: Iterable[FlightRow], job: Job, flown: int, logs: int) -> None:
    """Write the page; say in a few lines what came of the run. Raises UavbattError when no log could be flown."""
    from uavbatt.fleet.tables import CSV, PARQUET
    from uavbatt.report.fleet import counted, fleet_report
    from uavbatt.report.fleet_groups import gathered
    from uavbatt.report.page import write_page

    overview = gathered(rows)
    battery = f"{job.battery.battery.name} ({job.battery.status})"
    remarks = (("logs", f"{logs}, of which {flown} were flown in this run and the others before"),)
    write_page(folder / PAGE, fleet_report(overview, battery, remarks))
    failed = sum(overview.failures.values())
    say(f"{counted(logs, 'log')} ({flown} done now): {overview.flights} flown, {failed} could not be")
    for reason, count in sorted(overview.failures.items(), key=lambda one: -one[1])[:MOST_REASONS]:
        say(f"  {count:5d}  {reason}")
    say(f"{overview.looked} need a look; see {folder / PAGE}, {folder / CSV}, {folder / PARQUET}")
    if not overview.flights:
        raise UavbattError(f"none of {logs} logs could be flown, the reasons are in {folder / CSV}")


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
def _progress() -> Iterator[Callable[[Finished], None]]:
    """A bar on stderr when that is a terminal, nothing otherwise."""
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("flights"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("flights")
        yield lambda finished: bar.update(task, completed=finished.done, total=finished.total)
