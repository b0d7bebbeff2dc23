"""The page of a planned mission: does it fit, where to turn back, the charge along the way, the effect of
temperature."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from uavbatt.output import counted
from uavbatt.plan.mission import MissionPlan, RouteFit
from uavbatt.plan.words import speed_words, wind_words
from uavbatt.prediction.route.legs import way_points
from uavbatt.records import IN_TIME
from uavbatt.report import plot
from uavbatt.report.page import (
    Html,
    answer,
    badge,
    bullets,
    celsius,
    clock,
    duration,
    facts,
    figure,
    grid,
    number,
    page,
    paragraph,
    percent,
    section,
    strong,
    table,
)
from uavbatt.report.plan import pack_facts
from uavbatt.report.route_map import route_map

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def mission_report(plan: MissionPlan, name: str) -> str:
    """Return the whole page as HTML, under the mission's `name`."""
    points = way_points(plan.planned.path.legs)
    note = "The red point is where the aircraft must turn back to be home with 95 %." if plan.turning else ""
    return page(
        f"{name}: does it fit?",
        "uavbatt plan",
        _answer(plan),
        section("The route", grid(route_map(points, turning=plan.turning, note=note), _charge(plan))),
        section("Leg by leg", _legs(plan)),
        section("Over ambient temperature", _temperatures(plan)),
        section("What it rests on", facts(_basis(plan)), bullets(plan.warnings)),
    )


def _answer(plan: MissionPlan) -> Html:
    here, route = plan.here, plan.here.route
    first = paragraph(
        f"{'It fits' if here.fits else 'It does not fit'}: at {celsius(here.ambient_C)} the probability that the "
        f"battery ends before touchdown is {_spaced(here.risk_text)} (at most {percent(IN_TIME)} is allowed).",
    )
    charge = (
        f"with {percent(route.soc)} of the charge, probably between {percent(route.soc_lo)} and "
        f"{percent(route.soc_hi)} (9 in 10)"
    )
    end = paragraph(
        f"Touchdown after {duration(route.left_s)} {charge if math.isfinite(route.soc) else 'is not reached'}."
    )
    spare = paragraph(f"Hover left at touchdown: {duration(here.spare_s)}, at worst (5 %) {duration(here.spare_lo_s)}.")
    turn = ""
    if here.no_way_home:
        turn = strong(f"{here.no_way_home}.")
    elif math.isfinite(route.turn_back_lo_s):
        turn = strong(f"Turn back by {duration(route.turn_back_lo_s)} after take-off to be home with 95 %.")
    quiet = paragraph(badge(plan.resolved.status), f" battery file: {plan.resolved.battery}.", css="quiet")
    return answer(first, paragraph(turn), end, spare, quiet, mood="good" if here.fits else "bad")


def _charge(plan: MissionPlan) -> Html:
    def draw(axes: Axes) -> None:
        minutes = np.array([0.0, *(leg.end_s / 60.0 for leg in plan.legs)])
        lo, middle, hi = (
            100.0 * np.array([plan.start_soc, *(getattr(leg, key) for leg in plan.legs)])
            for key in ("soc_lo", "soc", "soc_hi")
        )
        axes.fill_between(minutes, lo, hi, color=plot.SKY, alpha=0.35, linewidth=0, label="90 % interval")
        axes.plot(minutes, middle, color=plot.BLUE, label="median")
        axes.set_ylim(bottom=0.0)

    alt = "Charge at each leg's end over time, median and 90 % interval"
    svg = plot.panel(draw, alt, x="time (min)", y="charge (%)", legend_columns=2)
    return figure(svg, "Charge along the way", "From take-off to touchdown, at each leg's end.")


def _legs(plan: MissionPlan) -> Html:
    rows = [
        (
            "home" if leg.item < 0 else str(leg.item),
            leg.what,
            clock(leg.end_s),
            number(math.hypot(leg.place.north_m, leg.place.east_m), 0, "m"),
            number(leg.place.height_m, 0, "m"),
            percent(leg.soc),
            percent(leg.soc_lo),
            percent(leg.soc_hi),
        )
        for leg in plan.legs
    ]
    caption = "Charge at each leg's end; after: minutes:seconds"
    return table(
        ("item", "what", "after", "from home", "height", "charge", "5 %", "95 %"), rows, caption, text_columns=(0, 1)
    )


def _temperatures(plan: MissionPlan) -> Html:
    head = ("ambient", "fits", "risk", "charge at touchdown", "hover left", "turn back by", "remark")
    caption = "The same mission; times in minutes:seconds"
    return table(head, [_row(fit) for fit in plan.rows], caption, text_columns=(0, 1, 6))


def _row(fit: RouteFit) -> tuple[str, ...]:
    route = fit.route
    fits, risk, turn = "yes" if fit.fits else "no", _spaced(fit.risk_text), clock(route.turn_back_lo_s)
    return (celsius(fit.ambient_C), fits, risk, percent(route.soc), clock(fit.spare_s), turn, fit.remark)


def _spaced(percentage: str) -> str:
    """Return a percentage as a page writes it: `5 %`."""
    return percentage.replace("%", " %")


def _basis(plan: MissionPlan) -> list[tuple[str, str]]:
    powers = plan.planned.powers
    flights = counted(powers.flights, "flight")
    return [
        *pack_facts(plan.resolved),
        ("vehicle", f"hover {powers.hover_W:.0f} W ± {percent(powers.level_sd)}, learned from {flights}"),
        ("speeds", speed_words(plan.planned.path.legs)),
        ("wind", wind_words(plan.planned.wind)),
    ]
