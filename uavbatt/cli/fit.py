"""`uavbatt fit`: battery and vehicle files from bench tests and flights."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uavbatt.cli.logs import (
    InstanceOption,
    JoinOption,
    SourcesArgument,
    SystemOption,
    asked_flights,
    data_sets_and_logs,
    of_sound_sensors,
)
from uavbatt.cli.options import (
    BatteryOption,
    CapacityOption,
    CellsOption,
    CutoffOption,
    UncertifiedOption,
    check_kind,
    check_named,
    check_writable,
    read_battery,
    remark,
    say,
    stated_pack,
)
from uavbatt.cli.progress import progress_bar
from uavbatt.errors import BadInput, UavbattError, UsageError
from uavbatt.output import counted

if TYPE_CHECKING:
    from uavbatt.battery.battery_file import BatteryFile
    from uavbatt.battery.sizing.pack_size import PackOptions, PackSize
    from uavbatt.battery.vehicle_file import VehicleFile
    from uavbatt.dataset import DataSet
    from uavbatt.fitting.battery import FittedBattery, RecordedPack
    from uavbatt.records import Flight

MANY_ROWS = 20_000  # of all logs: plain numpy takes 8 s for them, compiled code 3 s and 1 s to be loaded


def fit(
    sources: SourcesArgument,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="NAME.battery.toml to write.")] = None,
    vehicle: Annotated[Path | None, typer.Option("--vehicle", help="NAME.vehicle.toml to write.")] = None,
    battery: BatteryOption = "",
    cells: CellsOption = None,
    capacity_ah: CapacityOption = None,
    cutoff_voltage: CutoffOption = None,
    allow_uncertified: UncertifiedOption = False,
    instance: InstanceOption = None,
    join: JoinOption = "",
    system: SystemOption = None,
) -> None:
    """Fit a battery file (-o), a vehicle file (--vehicle) or both. With --battery only the vehicle file is fitted.

    Example: uavbatt fit day1.BIN day2.BIN --cells 4 --capacity-ah 5 --vehicle quad.vehicle.toml
    """
    if output is None and vehicle is None:
        raise UsageError("nothing to write: expected -o NAME.battery.toml, --vehicle NAME.vehicle.toml, or both")
    if battery and output is not None:
        raise UsageError("-o fits a battery file and --battery names one: expected one of the two")
    check_named(output, vehicle)
    check_kind(output, vehicle)
    check_writable(output, vehicle, reads=sources)
    datasets, logs = data_sets_and_logs(sources)
    flights = asked_flights(logs, instance, join, system)
    stated = stated_pack(cells, capacity_ah, cutoff_voltage)
    if battery:
        content = _known(read_battery(battery, allow_uncertified), flights, stated)
        flights = [_sound(flight, _size_by(content, flight, stated)) for flight in flights]
    else:
        pack = _pack((output or vehicle or Path("fitted")).name.split(".")[0], datasets, flights, stated)
        flights = [_sound(flight, pack.pack_size) for flight in flights]
        found = _fitted(pack, datasets, flights)
        content = found.file
        for line in _findings(found) if output is not None else []:  # they are about the battery file
            say(line)
    learned = _learned(vehicle, content, flights, stated) if vehicle is not None else None  # before anything is written
    if output is not None:
        say(f"{_written(content, output)}: fitted to {content.discrepancy.source}; not certified")
    if vehicle is not None and learned is not None:
        say(_vehicle(vehicle, learned, len(flights)))


def _written(content: BatteryFile, output: Path) -> Path:
    """Write the battery file and return its path. Raises UavbattError for parameters that no battery has."""
    from uavbatt.battery.battery_file import write_battery

    try:
        return write_battery(content, output)
    except BadInput as error:
        said = "the fit found what no battery has: are cells, capacity and currents as stated?"
        raise UavbattError(f"{said} Nothing is written; {error}") from None


def _known(battery: BatteryFile, flights: list[Flight], stated: PackOptions) -> BatteryFile:
    """Return the battery file. Raises UsageError if a flight contradicts what is stated of its pack."""
    from uavbatt.battery.sizing.log_statements import check_statements

    for flight in flights:
        check_statements(battery, stated, flight)
    return battery


def _size_by(battery: BatteryFile, flight: Flight, stated: PackOptions) -> PackSize | None:
    """Return the size of the flight's pack; None if the flight has no voltage.

    Raises UsageError if a row of the flight contradicts the size for certain.
    """
    from uavbatt.battery.sizing.log_statements import whole_size

    is_read = any(math.isfinite(s.voltage_V) for s in flight.samples)
    return whole_size(battery, stated, flight) if is_read else None


def _sound(flight: Flight, size: PackSize | None) -> Flight:
    """Return the flight without the rows of failed sensors, and warn of what is left out."""
    return flight if size is None else of_sound_sensors(flight, size.cells, size.capacity_Ah)


def _pack(name: str, datasets: list[DataSet], flights: list[Flight], stated: PackOptions) -> RecordedPack:
    """Return the size of the pack of all records. Raises UsageError if a flight contradicts what is stated of it."""
    from uavbatt.battery.sizing.log_statements import check_whole
    from uavbatt.fitting.battery import size_of
    from uavbatt.limits import Resting

    size = size_of(name, datasets, flights, stated.cells, stated.capacity_Ah, stated.cutoff_V)
    for flight in flights:
        check_whole(flight, size.pack_size, Resting())
    for notice in size.notices:
        remark(f"warning: {notice}")
    return size


def _fitted(pack: RecordedPack, datasets: list[DataSet], flights: list[Flight]) -> FittedBattery:
    from uavbatt.fitting.battery import fit_battery

    remark(f"fitting {counted(len(datasets), 'data set')} and {counted(len(flights), 'flight')} ...")
    return fit_battery(pack, datasets, flights)


def _findings(found: FittedBattery) -> list[str]:
    """Return in words what the records tell about the battery, what is doubtful, and what they do not tell."""
    known, doubtful = [f"  {line}" for line in found.known], [f"doubtful: {line}" for line in found.doubtful]
    return known + doubtful + [f"not determined: {line}" for line in found.unknown]


def _learned(path: Path, content: BatteryFile, flights: list[Flight], stated: PackOptions) -> VehicleFile:
    """Return the vehicle file of the flights. Raises UsageError if there are none."""
    from uavbatt.battery import vehicle_file
    from uavbatt.fitting.vehicle import fit_vehicle, other_powers
    from uavbatt.log_replay.run import engine_for

    if not flights:
        raise UsageError("--vehicle: expected flight logs, bench tests say nothing about an aircraft")
    for one in other_powers(flights):
        cause = "another aircraft, or a current sensor that reads wrong?"
        remark(f"warning: {one.source}: {one.power_W:.0f} W, the usual flight {one.usual_W:.0f} W: {cause}")
    engine = engine_for(is_long=sum(len(flight.samples) for flight in flights) >= MANY_ROWS)
    name = path.name.removesuffix(vehicle_file.SUFFIX)
    with progress_bar("vehicle file") as advance:
        return fit_vehicle(name, flights, content, stated, engine, advance)


def _vehicle(path: Path, learned: VehicleFile, flights: int) -> str:
    """Write the vehicle file, and return in words what it holds."""
    from uavbatt.battery.vehicle_file import write_vehicle

    write_vehicle(learned, path)
    phases, used = learned.phases, f"{len(learned.traces)} of {counted(flights, 'flight')}"
    by_speed = "not determined: no log holds two minutes of steady flight with its speed"
    if learned.powers is not None:
        by_speed = f"from {counted(learned.powers.flights, 'flight')}, {learned.powers.seconds / 60.0:.0f} min"
    return (
        f"{path}: {used}; mean power {phases.flight_W:.0f} W, first minute {phases.take_off_W:.0f} W, "
        f"last minute {phases.last_minute_W:.0f} W; power over speed and climb {by_speed}"
    )
