"""Reading the log of a command: one battery of it, or all of them as one pack."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uavbatt.cli.options import remark
from uavbatt.cli.progress import progress_bar
from uavbatt.errors import BadInput, UsageError

if TYPE_CHECKING:
    from uavbatt.dataset import DataSet
    from uavbatt.records import Flight

InstanceOption = Annotated[
    int | None, typer.Option("--instance", min=0, help="Number of the battery in the log, from 0.")
]
JoinOption = Annotated[str, typer.Option("--join", help="parallel or series: all batteries of the log as one pack.")]

SourcesArgument = Annotated[
    list[Path], typer.Argument(metavar="LOG|DATASET...", help="Flight logs, folders of logs, data sets.")
]
SystemOption = Annotated[
    int | None, typer.Option("--system", min=1, max=255, help="Vehicle of a .tlog that holds several.")
]


def asked_flight(log: Path, instance: int | None, join: str, system: int | None = None) -> Flight:
    """Read the flight with these options. Raises UsageError if they contradict each other or the log."""
    from uavbatt.telemetry import read_log
    from uavbatt.telemetry.join import Wiring, read_joined

    check_join(instance, join)
    return read_joined(log, Wiring(join), system) if join else read_log(log, instance, system)


def data_sets_and_logs(sources: Sequence[Path]) -> tuple[list[DataSet], list[Path]]:
    """Return the data sets among the sources, and the logs: those that are named, and those in folders.

    Raises UsageError for a folder of neither.
    """
    from uavbatt import dataset

    is_data_set = {path: path.is_dir() and _holds_tests(path) for path in sources}
    others = [path for path in sources if not is_data_set[path]]
    logs = logs_in(others, "a data set with battery.toml and discharge.csv, or logs")
    return [dataset.load(path) for path in sources if is_data_set[path]], logs


def _holds_tests(folder: Path) -> bool:
    """Return True if a folder holds a file of a data set."""
    from uavbatt import dataset

    return any((folder / name).exists() for name in dataset.TEMPLATE_FILES)


def logs_in(sources: Sequence[Path], expected: str) -> list[Path]:
    """Return the logs that are named, and for a folder those in it, at any depth, by name.

    expected : what a source should be, in words. Raises UsageError with it for a folder without logs.
    """
    from uavbatt.fleet.logs import find_logs

    logs = list[Path]()
    for source in sources:
        if not source.is_dir():
            logs.append(source)
            continue
        try:
            logs += [Path(log.name) for log in find_logs([str(source)])]
        except UsageError:
            raise UsageError(f"{source}: expected {expected}") from None
    return logs


def asked_flights(
    logs: Sequence[Path], instance: int | None, join: str = "", system: int | None = None
) -> list[Flight]:
    """Read the flights of logs with these options: of a log in which the pack was changed each flight by itself.

    A log that cannot be read is left out with a warning if another one can: a card of a season has some of no battery,
    or of no bytes. So is a second recording of a flight. Raises BadInput if none can be read, and for a name of no
    file.
    """
    from uavbatt.telemetry.discharges import of_discharges
    from uavbatt.telemetry.recorded_twice import without_second_recordings

    flights: list[Flight] = []
    unread: list[BadInput] = []
    with progress_bar("reading") as advance:
        for log in logs:
            try:
                flights += of_discharges(asked_flight(log, instance, join, system))
            except BadInput as error:
                if not log.exists():
                    raise
                unread.append(error)
            advance(1.0 / len(logs))
    if unread and not flights:
        raise unread[0]
    for reason in unread:
        remark(f"warning: {reason}: left out")
    kept, left_out = without_second_recordings(flights)
    for second, first in left_out:
        remark(f"warning: {second.source}: the same flight as {first.source}: left out")
    return kept


def of_sound_sensors(flight: Flight, cells: int, capacity_Ah: float) -> Flight:
    """Return the flight without the rows of failed sensors, and warn of what is left out.

    cells : in series; capacity_Ah : of the pack [Ah]
    """
    from uavbatt.fitting.failed_sensors import without_failed

    sound, spans = without_failed(flight, cells, capacity_Ah)
    for span in spans:
        remark(f"warning: {flight.source}: {span.after_s:.0f} to {span.until_s:.0f} s left out: {span.reason}")
    return sound


def check_join(instance: int | None, join: str) -> None:
    """Raise UsageError for an unknown wiring, or for a wiring together with a single battery."""
    from uavbatt.telemetry.join import Wiring

    if join and join not in tuple(Wiring):
        raise UsageError(f"--join {join}: expected parallel or series")
    if join and instance is not None:
        raise UsageError("--instance names one battery and --join takes them all: expected one of the two")


def distinct_names(logs: Sequence[Path]) -> list[str]:
    """Return a different name for each log, with the names of its folders in front if they are needed for that.

    No name is that of another log's second flight (`a-2`). Raises UsageError if a log is named twice.
    """
    twice = next((log for k, log in enumerate(logs) if log.resolve() in {other.resolve() for other in logs[:k]}), None)
    if twice is not None:
        raise UsageError(f"{twice}: expected each log once, it is named twice")
    whole = [log.resolve() for log in logs]
    stems = {log.stem for log in whole}
    is_later = any(found and found[1] in stems for found in (re.fullmatch(r"(.+)-\d+", stem) for stem in stems))
    is_alone = len({(log.parent, log.stem) for log in whole}) == len(logs) and not is_later
    parts = [(*log.parent.parts[1:], log.stem if is_alone else log.name) for log in whole]
    count = 1
    while len({of_one[-count:] for of_one in parts}) < len(logs):
        count += 1
    return ["_".join(of_one[-count:]) for of_one in parts]
