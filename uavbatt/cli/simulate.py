"""`uavbatt simulate`: a simulated flight, as a log."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uavbatt.cli.missions import WindOption, check_wind, mission_from_home, stated_wind
from uavbatt.cli.options import (
    DEFAULT_BATTERY,
    AmbientOption,
    BatteryOption,
    CapacityOption,
    CellsOption,
    CutoffOption,
    UncertifiedOption,
    check_writable,
    number_option,
    read_battery,
    remark,
    stated_pack,
)
from uavbatt.errors import UsageError

if TYPE_CHECKING:
    from uavbatt.battery.battery_file import BatteryFile
    from uavbatt.battery.scaling import Pack
    from uavbatt.battery.sizing.pack_size import PackOptions
    from uavbatt.records import Sample
    from uavbatt.simulate.flight import SimulatedFlight
    from uavbatt.simulate.route import RouteFlight


def simulate(
    output: Annotated[Path, typer.Option("-o", "--output", help="FILE.tlog, FILE.BIN or FILE.csv")],
    battery: BatteryOption = DEFAULT_BATTERY,
    power_w: Annotated[
        float, number_option("--power-w", 1.0, math.inf, "Mean power [W]; with --mission, that of the hover.")
    ] = 200.0,
    mission: Annotated[
        Path | None, typer.Option("--mission", help="Mission to fly: a .waypoints or .plan file.")
    ] = None,
    wind: WindOption = None,
    ambient_c: AmbientOption = 20.0,
    start_soc: Annotated[float, number_option("--start-soc", 0.05, 1.0, "State of charge at take-off.")] = 1.0,
    effect: Annotated[
        list[str] | None, typer.Option("--effect", help="Effect to plant, NAME=VALUE; may be repeated.")
    ] = None,
    seed: Annotated[
        int, typer.Option("--seed", min=0, help="Seed of the noise: the same seed gives the same log.")
    ] = 1,
    rate_hz: Annotated[float, number_option("--rate-hz", 0.05, 50.0, "Rows of telemetry a second.")] = 2.0,
    cells: CellsOption = 4,
    capacity_ah: CapacityOption = 5.0,
    cutoff_voltage: CutoffOption = None,
    allow_uncertified: UncertifiedOption = False,
) -> None:
    """Simulate a flight with the model of a battery file, until the pack is empty or the mission is over; write a log.

    Example: uavbatt simulate -o flight.tlog --power-w 250 --effect weak_cell=0.1
    """
    from uavbatt.simulate.flight import SimulatedFlight, check_kind, simulate_flight, write_log

    check_writable(output, reads=[mission])
    check_wind(wind, mission)
    route = _route(mission, wind) if mission is not None else None
    check_kind(output, route)
    content = read_battery(battery, allow_uncertified)
    stated = stated_pack(cells or content.battery.cells_series, capacity_ah, cutoff_voltage)
    pack = _pack(content, stated, dict(_effect(text) for text in effect or []))
    flight = SimulatedFlight(power_w, ambient_c, start_soc, rate_hz, seed)
    samples = simulate_flight(pack, flight) if route is None else _along(route, pack, flight)
    write_log(output, samples, pack, route)
    remark(f"{output}: {len(samples)} rows, {samples[-1].time_s:.0f} s")


def _pack(content: BatteryFile, stated: PackOptions, effects: dict[str, float]) -> Pack:
    """Return the pack of the battery file with the stated size and the planted effects."""
    from uavbatt.battery.scaling import pack_of
    from uavbatt.simulate.flight import with_effects

    kind = content.battery
    cells = stated.cells or kind.cells_series
    share = cells / kind.cells_series
    cutoff_V = kind.cutoff_V * share if math.isnan(stated.cutoff_V) else stated.cutoff_V
    low_V = (kind.low_V or math.nan) * share
    return with_effects(pack_of(content, cells, stated.capacity_Ah, cutoff_V, low_V), effects)


def _route(mission: Path, wind: str | None) -> RouteFlight:
    """Return the flight of a mission file. Raises UsageError for one without a home position, or without an end."""
    from uavbatt.simulate.flight import IDLE_S
    from uavbatt.simulate.route import route_flight

    planned, home = mission_from_home(mission)
    return route_flight(planned.mission, home, stated_wind(wind), IDLE_S, cruise_ms=planned.cruise_ms)


def _along(route: RouteFlight, pack: Pack, flight: SimulatedFlight) -> list[Sample]:
    """Return the rows of a flight along a route."""
    from uavbatt.simulate.flight import simulate_flight
    from uavbatt.simulate.route import watts_of

    watts = watts_of(flight.power_W)
    return simulate_flight(pack, flight, lambda time_s: route.power_W(time_s, watts), route.lands_s)


def _effect(text: str) -> tuple[str, float]:
    name, equals, value = text.partition("=")
    try:
        return name, float(value)
    except ValueError:
        raise UsageError(f"--effect {text}: expected NAME=VALUE" + ("" if equals else ", `=` is missing")) from None
