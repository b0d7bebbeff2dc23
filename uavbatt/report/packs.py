"""The page of the pack ledger: which pack to retire first, all packs side by side, and the trend of each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from uavbatt.output import counted
from uavbatt.packs.outlook import INTERVAL_SD, RETIRED_AT, shared_sd
from uavbatt.packs.records import LedgerFlight, PackRow
from uavbatt.packs.words import is_not_known, retire_words, trend_words
from uavbatt.report import plot
from uavbatt.report.page import (
    Html,
    answer,
    bullets,
    contents,
    figure,
    grid,
    number,
    page,
    paragraph,
    percent,
    section,
    table,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_FIGURES = 40  # packs with figures of their own; the table holds all
MOST_BARS = 40  # bars of one figure that can be told apart; the table holds all packs
MOST_UNLISTED = 4  # packs that a page shows without a list of contents
ROOM_FOR_NAMES, LETTERS_SHOWN = 130.0, 12  # px on the left of the bars, and the letters that fit there
OHM, CHARGE = 0, 1  # places in the pack's scales (`battery.remembered`)


def packs_report(
    ledger: str, packs: Sequence[PackRow], histories: Sequence[tuple[PackRow, Sequence[LedgerFlight]]]
) -> str:
    """Return the whole page as HTML; `ledger` is its name, `histories` are the packs with their flights."""
    in_order = sorted(packs, key=lambda pack: (pack.outlook.retire_flights, pack.outlook.capacity_Ah / pack.rated_Ah))
    return page(
        f"Packs of {ledger}",
        "uavbatt packs",
        _headline(in_order),
        _contents(histories),
        section("All packs", _side_by_side(in_order), _table(in_order)),
        *(_of_one(pack, flights) for pack, flights in histories),
        footer="Bands: 5 % to 95 %.",
    )


def _contents(histories: Sequence[tuple[PackRow, Sequence[LedgerFlight]]]) -> Html:
    if len(histories) <= MOST_UNLISTED:
        return Html("")
    return contents("All packs", *(pack.name for pack, flights in histories if flights))


def _headline(packs: Sequence[PackRow]) -> Html:
    if not packs:
        return answer(paragraph("No packs are remembered yet."), mood="unsure")
    told = [pack for pack in packs if not is_not_known(pack.outlook)]
    unknown = len(packs) - len(told)
    if told and math.isfinite(told[0].outlook.retire_flights):
        words = f"First to retire: {told[0].name}, {retire_words(told[0].outlook)}."
    else:
        words = "" if unknown else "No end in sight for any of them."
    others = f"It is not known when to retire {counted(unknown, 'pack')} (see the table)." if unknown else ""
    return answer(paragraph(words), paragraph(others), paragraph(f"{counted(len(packs), 'pack')} remembered."))


def _table(packs: Sequence[PackRow]) -> Html:
    head = ("pack", "outlook", "charge", "of rated", "5 % to 95 %", "ohms of its type", "flights", "charge changes")
    rows = []
    for pack in packs:
        outlook = pack.outlook
        words = [retire_words(outlook), *(finding.words for finding in pack.findings)]
        rows.append(
            (
                pack.name,
                "; ".join(words),
                number(outlook.capacity_Ah, 2, "Ah"),
                percent(outlook.capacity_Ah / pack.rated_Ah),
                f"{outlook.capacity_lo_Ah:.2f} to {outlook.capacity_hi_Ah:.2f} Ah",
                percent(outlook.resistance_ohm / pack.type_ohm),
                str(outlook.flights),
                trend_words(outlook.capacity_trend, outlook.capacity_trend_sd),
            )
        )
    return table(head, rows, text_columns=(0, 1, 7))


def _side_by_side(packs: Sequence[PackRow]) -> Html:
    """Draw the capacity of all packs against their ratings, with intervals; the weakest is on top."""
    first_packs = list(packs[:MOST_BARS])[::-1]
    if not first_packs:
        return Html("")

    def draw(axes: Axes) -> None:
        axes.axvline(RETIRED_AT, color=plot.RED, linewidth=1.0, label=f"retired at {percent(RETIRED_AT)}")
        for place, pack in enumerate(first_packs):
            outlook, rated = pack.outlook, pack.rated_Ah
            axes.plot([outlook.capacity_lo_Ah / rated, outlook.capacity_hi_Ah / rated], [place, place], color=plot.BLUE)
            axes.plot([outlook.capacity_Ah / rated], [place], "o", color=plot.BLUE, markersize=4.0)
        axes.set_yticks(range(len(first_packs)), [plot.literal(pack.name)[:LETTERS_SHOWN] for pack in first_packs])
        axes.set_ylim(-0.6, len(first_packs) - 0.4)

    height, alt = 100.0 + 26.0 * len(first_packs), "Charge of all packs against their ratings"
    svg = plot.panel(draw, alt, x="charge / rated", y="", height=height, left=ROOM_FOR_NAMES)
    return figure(svg, "Charge, pack by pack", "Dot: most likely; line: 5 % to 95 %.")


def _of_one(pack: PackRow, flights: Sequence[LedgerFlight]) -> Html:
    """Return the part on one pack: its trend, and the findings of its flights."""
    if not flights:
        return Html("")
    outlook = pack.outlook
    words = f"{retire_words(outlook)}; charge: {trend_words(outlook.capacity_trend, outlook.capacity_trend_sd)}; "
    words += f"resistance: {trend_words(outlook.resistance_trend, outlook.resistance_trend_sd)}."
    parts = [
        f"flight {k} ({after.flight.source}): {finding.words}"
        for k, after in enumerate(flights, 1)
        for finding in after.findings
    ]
    figures = grid(_trend(flights, CHARGE, pack.rated_Ah), _trend(flights, OHM, pack.type_ohm))
    return section(pack.name, paragraph(words[0].upper() + words[1:]), bullets(parts), figures)


def _trend(flights: Sequence[LedgerFlight], which: int, unit: float) -> Html:
    """Draw capacity or resistance from flight to flight: each flight's own evidence, and the belief after it."""
    place = np.arange(1, len(flights) + 1)
    from_flight = np.exp([after.flight.told[which] for after in flights]) / unit
    estimates = np.exp([after.known.mean[which] for after in flights]) / unit
    variance = np.array([after.known.covariance[which, which] for after in flights])
    factor = np.exp(INTERVAL_SD * np.sqrt(variance + shared_sd(flights[-1].flight.battery)[which] ** 2))
    odd: Any = [k for k, after in enumerate(flights) if after.findings]
    name, colour = ("charge / rated", plot.BLUE) if which == CHARGE else ("ohms / type's", plot.AMBER)

    def draw(axes: Axes) -> None:
        if which == CHARGE:
            axes.axhline(RETIRED_AT, color=plot.RED, linewidth=1.0)
        axes.fill_between(place, estimates / factor, estimates * factor, color=colour, alpha=0.15, linewidth=0)
        axes.plot(place, estimates, color=colour, label="believed")
        axes.plot(place, from_flight, "o", color=colour, markersize=3.5, label="the flight itself")
        if odd:
            axes.plot(place[odd], from_flight[odd], "x", color=plot.RED, markersize=7.0, label="odd")
        low, high = float(np.min(estimates / factor)), float(np.max(estimates * factor))
        axes.set_ylim(
            min(0.75 if which == CHARGE else 0.9, low, 0.98 * np.min(from_flight)),
            max(1.1, high, 1.02 * np.max(from_flight)),
        )

    svg = plot.panel(draw, f"{name} from flight to flight", x="flight", y=name)
    return figure(svg, "Charge" if which == CHARGE else "Ohms")
