"""`uavbatt fit`: battery and vehicle files from bench tests and flights."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uavbatt.cli.logs import InstanceOption, JoinOption, SystemOption, asked_flight
from uavbatt.cli.options import (
    BatteryOption,
    CapacityOption,
    CellsOption,
    CutoffOption,
    UncertifiedOption,
    check_named,
    check_writable,
    read_battery,
    remark,
    say,
    stated_pack,
)
from uavbatt.errors import UsageError

if TYPE_CHECKING:
    from uavbatt.battery.battery_file import BatteryFile
    from uavbatt.battery.sizing import PackOptions
    from uavbatt.records import Flight


def fit(
    sources: Annotated[list[Path], typer.Argument(metavar="DATASET|LOG...", help="Data-set folders and flight logs.")],
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
    from uavbatt import dataset
    from uavbatt.battery import battery_file
    from uavbatt.battery.statements import check_statements, check_whole
    from uavbatt.fitting.battery import fit_battery, size_of
    from uavbatt.limits import Resting

    if output is None and vehicle is None:
        raise UsageError("nothing to write: expected -o NAME.battery.toml, --vehicle NAME.vehicle.toml, or both")
    if battery and output is not None:
        raise UsageError("-o fits a battery file and --battery names one: expected one of the two")
    check_named(output, vehicle)
    check_writable(output, vehicle, reads=sources)
    datasets = [dataset.load(path) for path in sources if path.is_dir()]
    flights = [asked_flight(path, instance, join, system) for path in sources if not path.is_dir()]
    stated = stated_pack(cells, capacity_ah, cutoff_voltage)
    if battery:
        content = read_battery(battery, allow_uncertified)
        for flight in flights:
            check_statements(content, stated, flight)
    else:
        name = (output or vehicle or Path("fitted")).name.split(".")[0]
        size = size_of(name, datasets, flights, stated.cells, stated.capacity_Ah, stated.cutoff_V)
        for flight in flights:
            check_whole(flight, size.pack_size, Resting())
        for notice in size.notices:
            remark(f"warning: {notice}")
        remark(f"fitting {len(datasets)} data set(s) and {len(flights)} flight(s) ...")
        found = fit_battery(size, datasets, flights)
        content = found.file
        told = [f"  {line}" for line in found.known]
        told += [f"doubtful: {line}" for line in found.doubtful] + [f"not determined: {line}" for line in found.unknown]
        for line in told if output is not None else []:  # these lines are about the battery file
            say(line)
    if output is not None:
        say(f"{battery_file.write_battery(content, output)}: fitted to {content.discrepancy.source}; not certified")
    if vehicle is not None:
        say(_vehicle(vehicle, content, flights, stated))


def _vehicle(path: Path, content: BatteryFile, flights: list[Flight], stated: PackOptions) -> str:
    from uavbatt.battery import vehicle_file
    from uavbatt.fitting.vehicle import vehicle_file as learn

    if not flights:
        raise UsageError("--vehicle: expected flight logs, bench tests say nothing about an aircraft")
    learned = learn(path.name.removesuffix(vehicle_file.SUFFIX), flights, content, stated)
    vehicle_file.write_vehicle(learned, path)
    phases = learned.phases
    return (
        f"{path}: {len(learned.traces)} of {len(flights)} flights; mean power {phases.flight_W:.0f} W, first minute "
        f"{phases.take_off_W:.0f} W, last minute {phases.last_minute_W:.0f} W"
    )
