"""`uavbatt plan --mission`: does a mission fit? As text, as JSON and as a page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uavbatt.cli.missions import mission_from_home, stated_wind
from uavbatt.errors import UsageError
from uavbatt.output import clock, rounded

if TYPE_CHECKING:
    from uavbatt.battery.battery_file import BatteryFile
    from uavbatt.battery.powers import Powers
    from uavbatt.battery.sizing.pack_size import PackSize
    from uavbatt.cli.options import ResultFiles
    from uavbatt.navigation import ReturnSettings
    from uavbatt.plan.endurance import TakeOff
    from uavbatt.plan.mission import LegEnd, MissionPlan, PlannedMission, RouteFit
    from uavbatt.records import Route

MOST_LEGS = 40  # lines on a terminal


def planned_mission(mission: Path, vehicle: Path | None, hover_W: float, wind: str | None) -> PlannedMission:
    """Return a mission with the aircraft that flies it, and the wind. Raises UsageError if a file lacks something.

    hover_W : power in hover [W] of an aircraft without a vehicle file
    """
    from uavbatt.navigation import ReturnSettings, completed
    from uavbatt.plan.mission import PlannedMission

    read, home = mission_from_home(mission)
    powers, usual = _flown_by(vehicle, hover_W)
    stated = ReturnSettings(cruise_ms=read.cruise_ms, is_px4=not read.mission.has_home_item)
    return PlannedMission(read.mission, home, completed(stated, usual), powers, stated_wind(wind))


def _flown_by(vehicle: Path | None, hover_W: float) -> tuple[Powers, ReturnSettings]:
    """Return the powers of an aircraft, and its speeds; without a vehicle file those of a usual multirotor."""
    from uavbatt.battery import vehicle_file
    from uavbatt.battery.powers import of_hover
    from uavbatt.navigation import UNSTATED

    if vehicle is None:
        return of_hover(hover_W), UNSTATED
    flown = vehicle_file.read_vehicle(vehicle)
    if flown.powers is None:
        raise UsageError(
            f"--vehicle {vehicle}: expected [powers]; `uavbatt fit` learns them from logs with speed and climb"
        )
    return flown.powers, flown.usual


def plan_and_tell(
    planned: PlannedMission, name: str, battery: BatteryFile, size: PackSize, take_off: TakeOff, files: ResultFiles
) -> None:
    """Print whether the mission fits, and write the files that are wanted; `name` is the mission file's."""
    from uavbatt.plan.mission import make_route_plan

    found = make_route_plan(battery, size, planned, take_off)
    for line in _lines(found, name):
        files.say(line)
    if files.page is not None:
        from uavbatt.report.mission import mission_report
        from uavbatt.report.page import write_page

        write_page(files.page, mission_report(found, name))
    files.write_json(_as_json(found, name, take_off.reserve_soc, battery.certificate.content_sha256))


def _lines(plan: MissionPlan, name: str) -> list[str]:
    from uavbatt.plan.words import speed_words, wind_words

    here, route = plan.here, plan.here.route
    lines = [
        f"{plan.resolved.battery} ({plan.resolved.status}): {plan.resolved.words}",
        *(f"  warning    {warning}" for warning in plan.warnings),
        f"  speeds     {speed_words(plan.planned.path.legs)}",
        f"  wind       {wind_words(plan.planned.wind)}",
        f"{name}: {'fits' if here.fits else 'does NOT fit'} at {here.ambient_C:g} °C; "
        f"probability that the battery ends before touchdown {here.risk_text}"
        + (f"; {here.remark}" if here.remark else ""),
        f"  touchdown after {clock(route.left_s)}{_at_touchdown(route)}; "
        f"hover left then {clock(here.spare_s)} [{clock(here.spare_lo_s)}, {clock(here.spare_hi_s)}]",
    ]
    if here.no_way_home:
        lines.append(f"  {here.no_way_home}")
    elif math.isfinite(route.turn_back_s):
        lines.append(f"  turn back by {clock(route.turn_back_lo_s)} to be home with 95 %; {_turning(plan)}")
    lines += _leg_lines(plan.legs)
    lines.append(f"  {'ambient':>8}  {'risk':>5}  {'hover left':>10}  charge at touchdown")
    return lines + [_row(fit) for fit in plan.rows]


def _leg_lines(legs: Sequence[LegEnd]) -> list[str]:
    """Return the legs as a table; of many legs only the first and the last ones."""
    lines = [f"  {'item':>6}  {'after':>7}  {'from home':>9}  {'height':>7}  {'charge at its end':<31}  what"]
    half = MOST_LEGS // 2
    left_out = len(legs) - MOST_LEGS
    shown = legs if left_out <= 0 else (*legs[:half], *legs[-half:])
    for number, leg in enumerate(shown):
        if left_out > 0 and number == half:
            lines.append(f"  {'...':>6}  {left_out} more, in --json and --report")
        item = "home" if leg.item < 0 else str(leg.item)
        charge = _charge(leg.soc, leg.soc_lo, leg.soc_hi)
        away_m = math.hypot(leg.place.north_m, leg.place.east_m)
        place = f"{away_m:>7.0f} m  {leg.place.height_m:>5.0f} m"
        lines.append(f"  {item:>6}  {clock(leg.end_s):>7}  {place}  {charge:<31}  {leg.what}")
    return lines


def _turning(plan: MissionPlan) -> str:
    assert plan.turning is not None
    north, east = plan.turning.north_m, plan.turning.east_m
    ways = "north" if north >= 0.0 else "south", "east" if east >= 0.0 else "west"
    return f"that is {abs(north):.0f} m {ways[0]}, {abs(east):.0f} m {ways[1]} of home"


def _at_touchdown(route: Route) -> str:
    charge = _charge(route.soc, route.soc_lo, route.soc_hi)
    return f" is {charge}" if math.isnan(route.soc) else f" with {charge}"


def _charge(middle: float, lo: float, hi: float) -> str:
    if math.isnan(middle):
        return "not reached"
    return f"{middle:.0%} [{lo:.0%}, {hi:.0%}] of the charge"


def _row(fit: RouteFit) -> str:
    route = fit.route
    charge = _charge(route.soc, route.soc_lo, route.soc_hi)
    return f"  {fit.ambient_C:>5.0f} °C  {fit.risk_text:>5}  {clock(fit.spare_s):>10}  {charge}  {fit.remark}".rstrip()


def _fit(fit: RouteFit) -> dict[str, Any]:
    """Return the result at one temperature for JSON."""
    route = fit.route
    return {
        "ambient_C": fit.ambient_C,
        "fits": fit.fits,
        "risk": route.risk,
        "touchdown_s": route.left_s,
        "soc": route.soc,
        "soc_lo": route.soc_lo,
        "soc_hi": route.soc_hi,
        "spare_s": fit.spare_s,
        "spare_lo_s": fit.spare_lo_s,
        "spare_hi_s": fit.spare_hi_s,
        "turn_back_s": route.turn_back_s,
        "turn_back_lo_s": route.turn_back_lo_s,
        "turn_back_hi_s": route.turn_back_hi_s,
        "remark": fit.remark,
    }


def _charges(leg: LegEnd) -> dict[str, float]:
    return {"soc": leg.soc, "soc_lo": leg.soc_lo, "soc_hi": leg.soc_hi}


def _as_json(plan: MissionPlan, name: str, reserve_soc: float, content_sha256: str) -> dict[str, Any]:
    """Return the plan for JSON: sources of the numbers, the planned temperature, each leg, the table."""
    legs = [
        {"item": leg.item, "what": leg.what, "end_s": leg.end_s, **leg.place._asdict(), **_charges(leg)}
        for leg in plan.legs
    ]
    return {
        "mission": name,
        "battery": plan.resolved.battery,
        "certificate_status": plan.resolved.status,
        "content_sha256": content_sha256,
        **plan.resolved.numbers(),
        "wind_north_ms": rounded(plan.planned.wind.north_ms, 6),
        "wind_east_ms": rounded(plan.planned.wind.east_ms, 6),
        "start_soc": plan.start_soc,
        "reserve_soc": reserve_soc,
        "warnings": list(plan.warnings),
        "planned": _fit(plan.here),
        "turning_point": plan.turning._asdict() if plan.turning is not None else None,
        "legs": legs,
        "table": [_fit(fit) for fit in plan.rows],
    }
