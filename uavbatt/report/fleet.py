"""The page of a fleet: a summary, the packs over time, flights to look at, and the accuracy of the forecasts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from pathlib import PurePath

import numpy as np
from numpy.typing import NDArray

from uavbatt import __version__
from uavbatt.report.fleet_figures import errors_figure, resistance_spark, scale_figure
from uavbatt.report.fleet_groups import CHECKPOINTS, MOST_LISTED, Change, Group, Overview, change, verdict
from uavbatt.report.page import (
    DASH,
    Html,
    badge,
    bullets,
    details,
    element,
    facts,
    grid,
    number,
    page,
    paragraph,
    percent,
    section,
    table,
    together,
)

MOST_DRAWN = 6  # groups
MOST_REASONS = 10


def fleet_report(found: Overview, battery: str, remarks: Sequence[tuple[str, str]] = ()) -> str:
    """Return the whole page as HTML.

    battery : name of the battery file of the run; remarks : names and values of the run
    """
    ranked = _ranked(found.groups.values())
    flown = [
        section("Packs over time", *_health(ranked)),
        section("Flights that need a look", *_look(found)),
        section("Forecasts against the truth", *_accuracy(found)),
    ]
    whose = f"{counted(found.flights, 'flight')} of {_whose(list(found.groups))}" if found.flights else "no flight"
    return page(
        f"Fleet: {whose}",
        "uavbatt fleet",
        _answer(found, ranked, battery),
        *(flown if found.flights or not found.failed else []),
        *([section("Logs that could not be replayed", _failed(found))] if found.failed else []),
        section("The run", facts([("battery file", battery), *remarks])),
        footer=f"uavbatt {__version__}. Advisory: this page commands nothing and replaces no reserve.",
    )


Ranked = tuple[Group, Change | None, Change | None]


def _ranked(groups: Iterable[Group]) -> list[Ranked]:
    """Return the groups with the changes of their resistance and capacity; the most certain and largest come first."""
    told = [(g, change(g, g.resistance), change(g, g.capacity)) for g in groups]

    def concern(one: Ranked) -> tuple[bool, float, int]:
        grown = one[1]
        return (
            not (one[0].is_identified and _is_grown(grown)),
            -(grown.difference if grown is not None else -math.inf),
            -one[0].flights,
        )

    return sorted(told, key=concern)


def _is_grown(found: Change | None) -> bool:
    return found is not None and found.is_certain and found.difference > 0.0


def _answer(found: Overview, ranked: Sequence[Ranked], battery: str) -> Html:
    failed = sum(found.failures.values())
    if failed and not found.flights:
        nothing = f"None of {counted(failed, 'log')} could be replayed: this fleet is not known. The reasons are below."
        return element("div", paragraph(nothing), css="answer bad")
    hours = sum(g.flown_s for g in found.groups.values()) / 3600.0
    lost = f"; {counted(failed, 'log')} could not be replayed" if failed else ""
    first = f"{counted(found.flights, 'flight')} in {number(hours, 1)} h; {found.looked} need a look{lost}."
    said = [paragraph(first), paragraph(_health_words(ranked))]
    errors, inside = np.array(found.errors["120"]), found.inside["120"]
    if len(errors):
        judged = len(errors) + found.refused["120"]
        said.append(
            paragraph(
                f"Two minutes before the end the forecasts were off by {number(_mean(np.abs(errors)), 0, 's')} on "
                f"average, in {counted(judged, 'flight')} that show their end; the truth was inside the 90 % interval "
                f"in {inside} of them."
            )
        )
    said.append(
        paragraph(*(badge(status) for status in sorted(found.certificates)), f" battery file: {battery}.", css="quiet")
    )
    return element("div", *said, css="answer unsure" if failed else "answer")


def _health_words(ranked: Sequence[Ranked]) -> str:
    """Return in words which packs have aged, how many have not, and of how many this is not known."""
    judged = [(group.name, verdict(group, resistance, capacity)) for group, resistance, capacity in ranked]
    grown = [name for name, found in judged if found.kind == "grown"]
    steady, untold = (sum(found.kind == kind for _, found in judged) for kind in ("steady", "cannot tell"))
    rest = f"{steady} steady, {untold} not known (see the table)."
    if grown:
        return f"Resistance has grown in: {', '.join(grown[:5])}{', …' if len(grown) > 5 else ''}; {rest}"
    if not steady:
        return "For none of them is it known whether it has aged (see the table)." if ranked else "No log was replayed."
    return f"No ageing found: {rest}"


def _health(ranked: Sequence[Ranked]) -> list[Html]:
    if not ranked:
        return [paragraph("No flight, no health.", css="quiet")]
    told = [one for one in ranked if one[0].flights >= 2 and one[0].is_identified]  # a folder has no history
    shown = told[:MOST_DRAWN]
    drawn = [grid(scale_figure(g, "resistance"), scale_figure(g, "capacity")) for g, _, _ in shown]
    hidden = len(told) - len(shown)
    head = ("pack or aircraft", "verdict", "flights", "hours", "Wh each", "first", "last", "resistance", "capacity")
    rows = [
        (
            g.name, _verdict(g, resistance, capacity), str(g.flights), number(g.flown_s / 3600.0, 1),
            number(g.energy_Wh / g.flights, 0), *_dates(g),
            together((_changed(resistance, g.resistance), resistance_spark(g)), ""), _changed(capacity, g.capacity),
        )
        for g, resistance, capacity in ranked
    ]  # fmt: skip
    explained = (
        "Scales against the battery file: 1 is a pack as the file describes it. A dot a flight, band: two standard "
        "deviations, line: the mean of five flights. a → b is the first third of the flights against the last. Within "
        "one flight the capacity is hardly visible: its scale stays near 1 unless flights go deep, and an aged pack "
        "shows first as resistance."
    )
    more = [paragraph(f"Drawn: the {len(shown)} that changed most; {hidden} more in the table.", css="quiet")]
    return [paragraph(explained), *drawn, *(more if hidden else []), _folded(head, rows)]


def _folded(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Html:
    made = table(head, rows, text_columns=(0, 1))
    return made if len(rows) <= 30 else details(f"All {len(rows)} packs and aircraft", made)


def _changed(found: Change | None, values: Sequence[tuple[float, float]]) -> str:
    if found is None:
        scale, sd = values[-1]
        return f"{number(scale, 2)} ± {number(2.0 * sd, 2)}"
    return f"{number(found.early, 2)} → {number(found.late, 2)} (± {number(2.0 * found.difference_sd, 2)})"


def _verdict(group: Group, resistance: Change | None, capacity: Change | None) -> Html:
    found = verdict(group, resistance, capacity)
    return badge({"steady": "pass", "cannot tell": "not enough data"}.get(found.kind, "fail"), found.words)


def _dates(group: Group) -> tuple[str, str]:
    known = [s for s in group.start_s if math.isfinite(s)]
    if not known:
        return DASH, DASH
    first, last = (datetime.fromtimestamp(s, UTC).strftime("%Y-%m-%d") for s in (min(known), max(known)))
    return first, last


def _look(found: Overview) -> list[Html]:
    if not found.look:
        return [paragraph("None.", css="quiet")]
    rows = [
        (PurePath(row.file).name, row.look, row.aircraft, row.start_utc[:10] or DASH, percent(row.end_soc))
        for row in found.look[:MOST_LISTED]
    ]
    more = found.looked - len(found.look)
    by_count = sorted(found.reasons.items(), key=lambda one: -one[1])
    said = [bullets(f"{counted(n, 'flight')}: {reason}" for reason, n in by_count[:MOST_REASONS])]
    said.append(table(("log", "why", "aircraft", "date", "charge at end"), rows, text_columns=(0, 1, 2, 3)))
    if more > 0:
        words = f"The {len(found.look)} that ask for it most; {more} more in flights.csv, column `look`."
        said.append(paragraph(words, css="quiet"))
    return said


def _failed(found: Overview) -> Html:
    by_count = sorted(found.failures.items(), key=lambda one: -one[1])
    rows = [
        (str(count), reason, ", ".join(PurePath(f).name for f in found.failed[reason]) + (", …" if count > 3 else ""))
        for reason, count in by_count[:MOST_LISTED]
    ]
    return table(("logs", "reason", "files"), rows, text_columns=(0, 1))


def _accuracy(found: Overview) -> list[Html]:
    rows = []
    for key, label in CHECKPOINTS.items():
        errors = np.array(found.errors[key])
        judged = len(errors) + found.refused[key]
        if not judged:
            continue
        absolute = np.abs(errors)
        rows.append(
            (
                label, str(judged), _mean_and_error(absolute), _mean_and_error(errors, sign=True),
                number(float(np.median(absolute)) if len(errors) else math.nan, 0),
                f"{found.inside[key]} ({found.inside[key] / judged:.0%})", str(found.refused[key]),
            )
        )  # fmt: skip
    if not rows:
        return [paragraph("No log reaches the end of its flight, so that no forecast can be checked.", css="quiet")]
    head = ("before the end", "flights", "mean |error| [s]", "bias [s]", "median |error| [s]", "inside 90 %", "refused")
    notes = bullets(
        (
            "Only flights whose log shows the end count: those flown to the cut-off, which are not the typical ones.",
            "Positive errors are optimistic. ± is one standard error over flights.",
            "A refused forecast counts as a miss of the interval and is not in the means.",
        ),
    )
    return [errors_figure(found.errors), table(head, rows), notes]


def _mean_and_error(values: NDArray[np.float64], *, sign: bool = False) -> str:
    if not len(values):
        return DASH
    error = float(np.std(values, ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else math.nan
    return f"{number(_mean(values), 0, sign=sign)} ± {number(error, 0)}"


def _mean(values: NDArray[np.float64]) -> float:
    return float(np.mean(values))


def _whose(groups: Sequence[str]) -> str:
    return groups[0] if len(groups) == 1 else f"{len(groups)} packs or aircraft"


def counted(n: int, what: str) -> str:
    """Return a count with the name of what is counted, in the plural where there is not one: `3 flights`."""
    return f"{n} {what}{'' if n == 1 else 's'}"
