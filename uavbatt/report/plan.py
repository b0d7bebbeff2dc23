"""The page of a plan: the endurance in words and over ambient temperature, and the sources of its numbers."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from uavbatt.battery.sizing.pack_size import PackSize
from uavbatt.plan.endurance import Endurance, Plan
from uavbatt.report import plot
from uavbatt.report.page import (
    Html,
    answer,
    badge,
    bullets,
    celsius,
    clock,
    duration,
    element,
    facts,
    figure,
    number,
    page,
    paragraph,
    percent,
    section,
    table,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def plan_report(plan: Plan) -> str:
    """Return the whole page as HTML."""
    return page(
        f"{plan.resolved.battery}: how long will it fly?",
        "uavbatt plan",
        _answer(plan),
        section("Over ambient temperature", _figure(plan), _table(plan)),
        section("What it rests on", facts(_basis(plan)), bullets(plan.warnings)),
    )


def _answer(plan: Plan) -> Html:
    here = plan.here
    status = paragraph(badge(plan.resolved.status), f" battery file: {plan.resolved.battery}.", css="quiet")
    if not math.isfinite(here.median_s):
        words = f"The endurance at {celsius(here.ambient_C)} is {here.remark or 'not known'}."
        return answer(paragraph(words), status, mood="unsure")
    first = paragraph(
        f"{duration(here.median_s)} at {celsius(here.ambient_C)}, probably between {duration(here.lo_s)} and "
        f"{duration(here.hi_s)} (9 in 10)."
    )
    terms = paragraph(
        f"Until the pack is below {number(plan.resolved.cutoff_V, 1, 'V')} under load. Load: {plan.load}. Charge at "
        f"take-off: {percent(plan.start_soc)}."
    )
    remark = paragraph(f"{celsius(here.ambient_C)}: {here.remark}." if here.remark else "")
    return answer(first, terms, remark, status)


def _figure(plan: Plan) -> Html:
    def draw(axes: Axes) -> None:
        ambient_C = np.array([e.ambient_C for e in plan.curve])
        lo, median, hi = (
            np.array([getattr(e, key) for e in plan.curve]) / 60.0 for key in ("lo_s", "median_s", "hi_s")
        )
        axes.fill_between(ambient_C, lo, hi, color=plot.SKY, alpha=0.35, linewidth=0, label="90 % interval")
        axes.plot(ambient_C, median, color=plot.BLUE, label="median")
        doubted = np.array([bool(e.remark) for e in plan.curve])
        if doubted.any():
            axes.plot(
                ambient_C[doubted],
                median[doubted],
                "o",
                color=plot.PAPER,
                markeredgecolor=plot.RED,
                label="not validated",
            )
        axes.plot([plan.here.ambient_C], [plan.here.median_s / 60.0], "o", color=plot.BLUE, label="planned")
        axes.set_ylim(bottom=0.0)

    alt = "Endurance in minutes over ambient temperature, median and 90 % interval"
    svg = plot.responsive(draw, alt, x="ambient temperature (°C)", y="endurance (min)")
    return figure(svg, "Endurance over ambient temperature", "The pack rested, and as warm as the air, at take-off.")


def _table(plan: Plan) -> Html:
    rows = [_row(e) for e in plan.rows]
    head = ("ambient", "median", "5 %", "95 %", "to low voltage", "remark")
    return table(head, rows, "Time from take-off (minutes:seconds)", text_columns=(0, 5))


def _row(e: Endurance) -> tuple[Html, ...]:
    """Return the row of one temperature; grey if the battery file does not cover it."""
    times = (clock(t) for t in (e.median_s, e.lo_s, e.hi_s, e.to_low_s))
    css = "quiet" if e.remark else ""
    return tuple(element("span", text, css=css) for text in (celsius(e.ambient_C), *times, e.remark))


def pack_facts(pack: PackSize) -> list[tuple[str, str]]:
    """List battery file, cells, capacity and cut-off of a planned flight, each with its source."""
    return [
        ("battery", f"{pack.battery} ({pack.status})"),
        ("cells", f"{pack.cells} in series, from {pack.cells_from}"),
        ("capacity", f"{number(pack.capacity_Ah, 2, 'Ah')}, from {pack.capacity_from}"),
        ("end of flight", f"below {number(pack.cutoff_V, 2, 'V')}, from {pack.cutoff_from}"),
    ]


def _basis(plan: Plan) -> list[tuple[str, str]]:
    pack = plan.resolved
    return [
        *pack_facts(pack),
        ("low-voltage warning", f"{number(pack.low_V, 2, 'V')}, from {pack.low_from}"),
        ("load", plan.load),
    ]
