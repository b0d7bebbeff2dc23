"""The records that `uavbatt diagnose` reads: different flights of one size of pack, with a current."""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from uavbatt.cli.logs import of_sound_sensors
from uavbatt.cli.options import remark
from uavbatt.errors import NotEnoughData, UsageError, terminal_line
from uavbatt.limits import FirstVoltages
from uavbatt.records import Flight, PackFacts

if TYPE_CHECKING:
    from uavbatt.battery.battery_file import BatteryFile
    from uavbatt.battery.sizing.pack_size import PackOptions, PackSize
    from uavbatt.cli.options import ResultFiles
    from uavbatt.dataset import DataSet
    from uavbatt.fitting.observed import ObservedRecord

Size = tuple[int, float, float]  # cells, capacity [Ah], cut-off [V]
SAME_CAPACITY = 0.02  # of two statements about one pack


@dataclass(frozen=True, slots=True)
class DiagnoseOptions:
    """DiagnoseOptions holds the settings of a diagnosis: battery file, pack, and how the logs are read.

    pack : as stated by the options; without : effects to leave out; instance : of the battery in a log
    ledger : the file of --packs; pack_name : of --pack, empty if it is not given
    """

    battery: BatteryFile
    pack: PackOptions
    without: tuple[str, ...]
    instance: int | None
    ledger: Path | None
    pack_name: str


@contextmanager
def reason_written(files: ResultFiles) -> Iterator[None]:
    """Write the reason to the JSON if the block raises NotEnoughData, and raise it again."""
    try:
        yield
    except NotEnoughData as error:
        files.write_json({"verdict": "not_enough_data", "reason": str(error), "classes": []})
        raise


def one_size(sizes: list[Size]) -> Size:
    """Return the size that most records state. Raises NotEnoughData if they are of different packs.

    A log in which the vehicle did not state its pack has the battery file's capacity and cut-off, nearly the same.
    """
    capacities_Ah = [capacity_Ah for _, capacity_Ah, _ in sizes]
    if len({cells for cells, *_ in sizes}) > 1 or max(capacities_Ah) > (1.0 + SAME_CAPACITY) * min(capacities_Ah):
        listed = ", ".join(f"{n}S {q:g} Ah" for n, q in sorted({(n, q) for n, q, _ in sizes}))
        raise NotEnoughData(f"the records are of different packs ({listed}): expected records of one")
    return Counter(sizes).most_common(1)[0][0]


def with_known_start(records: list[ObservedRecord]) -> list[ObservedRecord]:
    """Return the records without the few that begin in the air, and warn of these: their start is not known."""
    from uavbatt.fitting.whole_flights import from_take_off

    kept, left_out = from_take_off(records)
    for words in left_out:
        remark(f"warning: {words}")
    return kept


def observed_of(flight: Flight, cells: int, capacity_Ah: float) -> ObservedRecord:
    """Return the rows of a flight as a record, without those of failed sensors.

    Raises NotEnoughData if it has no current.
    """
    from uavbatt.fitting import observed
    from uavbatt.telemetry.cleaning.readings import MAX_CELL_C

    if not any(math.isfinite(s.current_A) for s in flight.samples):
        raise NotEnoughData(f"{flight.source}: no row has a current, and diagnose needs one")
    sound = of_sound_sensors(flight, cells, capacity_Ah)
    return observed.from_flight(sound, cells, capacity_Ah, hottest_start_C=MAX_CELL_C)


def flown_size(flight: Flight, content: BatteryFile, stated: PackOptions) -> Size:
    """Return the size of a flight's pack. Raises UsageError if the rows of the flight contradict it."""
    from uavbatt.battery.sizing.log_statements import whole_size

    return _rounded(whole_size(content, stated, flight))


def tested_size(dataset: DataSet, content: BatteryFile, stated: PackOptions) -> Size:
    """Return the size of a tested pack: the data set states its pack as a vehicle does.

    Raises UsageError if no size fits.
    """
    from uavbatt.battery.sizing.pack_size import checked, size_of_pack

    said = PackFacts(capacity_Ah=dataset.capacity_Ah or math.nan, critical_voltage_V=dataset.cutoff_V)
    voltages = FirstVoltages(dataset.first_V)
    try:
        return _rounded(
            checked(content, size_of_pack(content, stated, said, dataset.cells_series, voltages=voltages), voltages)
        )
    except UsageError as error:
        raise UsageError(f"{dataset.path}: {error}") from None


def _rounded(size: PackSize) -> Size:
    """Return the size, rounded so that the records of one pack agree."""
    return size.cells, round(size.capacity_Ah, 4), round(size.cutoff_V, 3)


class ProgressLine:
    """ProgressLine shows the present step on stderr, if that is a terminal."""

    def __enter__(self) -> ProgressLine:
        return self

    def __call__(self, step: str) -> None:
        if sys.stderr.isatty():
            print(f"\r\033[K{terminal_line(step)} ...", end="", file=sys.stderr, flush=True)

    def __exit__(self, *_: object) -> None:
        if sys.stderr.isatty():
            print("\r\033[K", end="", file=sys.stderr, flush=True)
