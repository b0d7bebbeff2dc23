"""`uavbatt simulate`: a simulated flight, as a log."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uavbatt.cli.options import (
    DEFAULT_BATTERY,
    AmbientOption,
    BatteryOption,
    CapacityOption,
    CellsOption,
    CutoffOption,
    UncertifiedOption,
    WindOption,
    check_writable,
    number_option,
    positive_or_nan,
    read_battery,
    remark,
    stated_wind,
)
from uavbatt.errors import UsageError

if TYPE_CHECKING:
    from uavbatt.battery.scaling import Pack
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
    from uavbatt.battery.scaling import pack_of
    from uavbatt.limits import OPTIONS, check_stated
    from uavbatt.simulate.flight import SimulatedFlight, check_kind, simulate_flight, with_effects, write_log

    check_writable(output, reads=[mission])
    if wind is not None and mission is None:
        raise UsageError("--wind: expected --mission FILE as well: without a route there is no airspeed")
    route = _route(mission, wind) if mission is not None else None
    check_kind(output, route)
    content = read_battery(battery, allow_uncertified)
    series = cells or content.battery.cells_series
    share = series / content.battery.cells_series
    given_V, given_Ah = (
        positive_or_nan(cutoff_voltage, "--cutoff-voltage"),
        positive_or_nan(capacity_ah, "--capacity-ah"),
    )
    check_stated(series, given_Ah, given_V, names=OPTIONS)
    cutoff_V = given_V if given_V == given_V else content.battery.cutoff_V * share
    low_V = (content.battery.low_V or float("nan")) * share
    pack = pack_of(content, series, given_Ah, cutoff_V, low_V)
    pack = with_effects(pack, dict(_effect(text) for text in effect or []))
    flight = SimulatedFlight(power_w, ambient_c, start_soc, rate_hz, seed)
    samples = simulate_flight(pack, flight) if route is None else _along(route, pack, flight)
    write_log(output, samples, pack, route)
    remark(f"{output}: {len(samples)} rows, {samples[-1].time_s:.0f} s")


def _route(mission: Path, wind: str | None) -> RouteFlight:
    """Return the flight of a mission file. Raises UsageError for one without a home position, or without an end."""
    from uavbatt.navigation import Wind
    from uavbatt.simulate.flight import IDLE_S
    from uavbatt.simulate.route import route_flight
    from uavbatt.telemetry.formats.mission_file import read_mission

    planned = read_mission(mission)
    if planned.home is None:
        raise UsageError(f"--mission {mission}: expected the place of home in it")
    return route_flight(planned.mission, planned.home, stated_wind(wind) if wind else Wind(0.0, 0.0), IDLE_S)


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
