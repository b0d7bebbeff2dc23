"""`uavbatt plan`: endurance before take-off."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from uavbatt.cli import pack_memory
from uavbatt.cli.logs import InstanceOption
from uavbatt.cli.missions import WindOption, check_wind
from uavbatt.cli.options import (
    DEFAULT_BATTERY,
    AmbientOption,
    BatteryOption,
    CapacityOption,
    CellsOption,
    CutoffOption,
    PackOption,
    PacksOption,
    ReportOption,
    ReserveOption,
    ResultFiles,
    UncertifiedOption,
    check_writable,
    number_option,
    positive_or_nan,
    read_battery,
    stated_pack,
)
from uavbatt.cli.plan_mission import plan_and_tell, planned_mission
from uavbatt.errors import NotEnoughData, UsageError
from uavbatt.output import clock

if TYPE_CHECKING:
    from uavbatt.battery.battery_file import BatteryFile
    from uavbatt.battery.sizing.pack_size import PackOptions
    from uavbatt.plan.endurance import Endurance, Plan
    from uavbatt.prediction.load.scenarios import Load
    from uavbatt.records import Flight


def plan(
    battery: BatteryOption = DEFAULT_BATTERY,
    power_w: Annotated[
        float | None, typer.Option("--power-w", help="Mean power of the flight [W]; with --mission, that of the hover.")
    ] = None,
    like: Annotated[Path | None, typer.Option("--like", help="A past log: its load is flown again.")] = None,
    vehicle: Annotated[
        Path | None, typer.Option("--vehicle", help="Vehicle file: how this aircraft flew before.")
    ] = None,
    mission: Annotated[
        Path | None,
        typer.Option("--mission", help="Does this .waypoints or .plan file fit? With --vehicle or --power-w."),
    ] = None,
    wind: WindOption = None,
    ambient_c: AmbientOption = 20.0,
    start_soc: Annotated[float, number_option("--start-soc", 0.01, 1.0, "State of charge at take-off.")] = 1.0,
    cells: CellsOption = None,
    capacity_ah: CapacityOption = None,
    cutoff_voltage: CutoffOption = None,
    reserve_soc: ReserveOption = 0.0,
    allow_uncertified: UncertifiedOption = False,
    instance: InstanceOption = None,
    packs: PacksOption = None,
    pack: PackOption = "",
    report: ReportOption = None,
    summary: Annotated[Path | None, typer.Option("--json", help="Summary as JSON.")] = None,
) -> None:
    """Work out the endurance before take-off, or whether a mission fits; with a table over ambient temperature.

    Example: uavbatt plan --cells 4 --capacity-ah 5 --power-w 250 --ambient-c 10
    """
    from uavbatt.plan.endurance import TakeOff, make_plan, resolve
    from uavbatt.telemetry import read_log
    from uavbatt.telemetry.discharges import of_discharges

    _check_power(power_w, like, vehicle, mission)
    check_wind(wind, mission)
    check_writable(report, summary, reads=(like, vehicle, mission, packs))
    files = ResultFiles(summary, report)
    content = read_battery(battery, allow_uncertified)
    options = stated_pack(cells, capacity_ah, cutoff_voltage, reserve_soc)
    flight = of_discharges(read_log(like, instance))[0] if like is not None else None
    with pack_memory.open_memory(packs, pack, only_read=True) as memory:
        known = memory.recalled_now(content)
    options = known.completed(options) if known is not None else options
    resolved = resolve(content, options, flight)
    take_off = TakeOff(ambient_c, start_soc, reserve_soc, known.health if known is not None else None)
    if known is not None:
        files.say(f"pack {known.name}: {known.words}")
    if mission is not None:
        planned = planned_mission(mission, vehicle, positive_or_nan(power_w, "--power-w"), wind)
        plan_and_tell(planned, mission.name, content, resolved, take_off, files)
        return
    load = _load(positive_or_nan(power_w, "--power-w"), flight, vehicle, content, options)
    _tell(make_plan(content, resolved, load, take_off), content, reserve_soc, files)


def _check_power(power_W: float | None, like: Path | None, vehicle: Path | None, mission: Path | None) -> None:
    """Raise UsageError unless the options state the power of the flight, and in one way only."""
    if sum(given is not None for given in (power_W, like, vehicle)) != 1:
        raise UsageError("the power is not known: expected exactly one of --power-w W, --like LOG, --vehicle FILE")
    if mission is not None and like is not None:
        raise UsageError("--mission: expected --vehicle FILE, or --power-w W for an aircraft without one; found --like")


def _tell(found: Plan, battery: BatteryFile, reserve_soc: float, files: ResultFiles) -> None:
    """Print the plan, and write the files that are wanted."""
    for line in _lines(found):
        files.say(line)
    if files.page is not None:
        from uavbatt.report.page import write_page
        from uavbatt.report.plan import plan_report

        write_page(files.page, plan_report(found))
    files.write_json(_as_json(found, reserve_soc, battery.certificate.content_sha256))


def _load(
    power_W: float, flight: Flight | None, vehicle: Path | None, battery: BatteryFile, options: PackOptions
) -> tuple[Load, str]:
    """Return the load to come and its name."""
    from uavbatt.battery import vehicle_file
    from uavbatt.fitting.vehicle import fit_vehicle
    from uavbatt.prediction.load.library import learned_load
    from uavbatt.prediction.load.scenarios import STATED_SPREAD, ConstantLoad
    from uavbatt.prediction.take_off import FromTakeOff

    if math.isfinite(power_W):
        return ConstantLoad(power_W, STATED_SPREAD), f"{power_W:g} W"
    if flight is not None:
        try:
            flown = fit_vehicle(Path(flight.source).stem, [flight], battery, options)
        except NotEnoughData as error:
            raise NotEnoughData(f"--like {error}") from None
        words = f"as in {Path(flight.source).name}, {flown.phases.flight_W:.0f} W on average"
    else:
        assert vehicle is not None
        flown = vehicle_file.read_vehicle(vehicle)
        words = f"as {flown.name} flew {len(flown.traces)} times, {flown.phases.flight_W:.0f} W on average"
    return FromTakeOff(learned_load(flown)), words


def _lines(plan: Plan) -> list[str]:
    """Return the plan as lines of text."""
    resolved, here = plan.resolved, plan.here
    lines = [
        f"{resolved.battery} ({resolved.status}): {resolved.words}",
        f"  load       {plan.load}; charge {plan.start_soc:.0%} at take-off",
        *(f"  warning    {warning}" for warning in plan.warnings),
        f"  at {here.ambient_C:g} °C: {_headline(here)}",
        f"  {'ambient':>8}  {'median':>8}  {'5 %':>8}  {'95 %':>8}",
    ]
    for e in plan.rows:
        times = "  ".join(f"{clock(value_s):>8}" for value_s in (e.median_s, e.lo_s, e.hi_s))
        lines.append(f"  {e.ambient_C:>5.0f} °C  {times}  {e.remark}".rstrip())
    return lines


def _headline(here: Endurance) -> str:
    """Return the endurance at the planned temperature in words, or why it is not known."""
    if not math.isfinite(here.median_s):
        return here.remark or "not known"
    said = f"{clock(here.median_s)} [{clock(here.lo_s)}, {clock(here.hi_s)}]"
    said += f"; low-voltage warning after {clock(here.to_low_s)}" if math.isfinite(here.to_low_s) else ""
    return said + (f"; {here.remark}" if here.remark else "")


def _as_json(plan: Plan, reserve_soc: float, content_sha256: str) -> dict[str, Any]:
    """Return the plan for JSON: sources of the numbers, the planned temperature, the table."""
    return {
        "battery": plan.resolved.battery,
        "certificate_status": plan.resolved.status,
        "content_sha256": content_sha256,
        **plan.resolved.numbers(),
        "load": plan.load,
        "start_soc": plan.start_soc,
        "reserve_soc": reserve_soc,
        "warnings": list(plan.warnings),
        "planned": asdict(plan.here),
        "table": [asdict(e) for e in plan.rows],
    }
