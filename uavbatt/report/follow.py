"""The page of followed flights: which effect has begun, since which flight, and the value of each flight as a chart."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from uavbatt.battery.effects import unit_words
from uavbatt.diagnosis.follow import Follow, FollowedEffect
from uavbatt.diagnosis.follow_words import course_words, size_words
from uavbatt.diagnosis.words import QUANTITY
from uavbatt.report import plot
from uavbatt.report.diagnosis import suspect
from uavbatt.report.page import (
    Html,
    answer,
    bullets,
    element,
    figure,
    number,
    page,
    paragraph,
    percent,
    section,
    strong,
    table,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_TICKS = 12  # more numbers of flights would touch each other
ANSWERS = {
    "no_missing_effect": ("good", "Nothing has begun: every flight is as this battery's model has it."),
    "effect_found": ("bad", "Something has begun, and it has a name."),
    "undeclared_effect": ("unsure", "Something is missing, and what is named does not explain all of it."),
}


def follow_report(follow: Follow, dates: Sequence[str], battery: str) -> str:
    """Return the whole page as HTML; `dates` are the days of the flights, empty where they are not known."""
    mood, words = ANSWERS[follow.verdict]
    parts = [_effect_part(one, follow, dates) for one in follow.effects]
    notes = [f"Left out, too short to tell anything: {name}." for name in follow.left_out]
    return page(
        f"{battery}: {len(follow.flights)} flights in order of time",
        "uavbatt diagnose --follow",
        answer(paragraph(strong(words)), *parts, mood=mood),
        section("Doubts", bullets(follow.reasons)),
        *(section(_title(one), course_figure(one)) for one in follow.effects),
        section("Flights", _flights(follow, dates)),
        section("Notes", bullets(notes)),
        footer="Each point is one flight by itself, with its 95 % interval.",
    )


def _title(one: FollowedEffect) -> str:
    return f"{QUANTITY.get(one.quantity, one.quantity)}, flight by flight"


def _effect_part(one: FollowedEffect, follow: Follow, dates: Sequence[str]) -> Html:
    """Return the part on one effect: its course, its rivals, and what to check."""
    course, size = course_words(one, follow.flights, dates), f"{size_words(one)}."
    sure = f"The cause is among what is named with a probability of {percent(one.found.probability)}."
    return element("div", *suspect(one.found.members, course, sure, "flights", size))


def course_figure(one: FollowedEffect) -> Html:
    """Draw each flight's own value with its interval, the file's value, and the course that explains them."""
    flights = np.arange(1, len(one.values) + 1)
    value = np.array([v.value for v in one.values])
    below, above = value - [v.lo for v in one.values], [v.hi for v in one.values] - value
    last = one.found.parameters[one.quantity].value
    course = one.off + one.course.shares(flights.size) * (last - one.off)

    def draw(axes: Axes) -> None:
        axes.axhline(one.off, color=plot.INK, linewidth=0.7, label="battery file")
        axes.plot(flights, course, color=plot.RED, linewidth=1.2, drawstyle="steps-mid", label="course")
        axes.errorbar(flights, value, np.abs([below, above]), fmt="o", color=plot.BLUE, markersize=4, label="flight")
        axes.axvline(one.course.begins + 0.5, color=plot.RED, linewidth=0.7, linestyle=":")
        axes.set_xticks(flights[:: -(-flights.size // MOST_TICKS)])

    unit = unit_words(one.values[0].unit)
    alt = f"{one.quantity} of each flight: {', '.join(f'{v:.3g}' for v in value)} {unit}".rstrip()
    y = f"{one.quantity} [{unit}]" if unit else one.quantity
    return figure(plot.panel(draw, alt, x="flight", y=y), one.quantity)


def _flights(follow: Follow, dates: Sequence[str]) -> Html:
    rows = []
    for place, (name, day) in enumerate(zip(follow.flights, dates, strict=True)):
        values = [number(one.values[place].value, 3, unit_words(one.values[place].unit)) for one in follow.effects]
        rows.append((str(place + 1), day or "not known", Path(name).name, *values))
    heads = ("flight", "day", "log", *(one.quantity for one in follow.effects))
    return table(heads, rows, text_columns=(1, 2))
