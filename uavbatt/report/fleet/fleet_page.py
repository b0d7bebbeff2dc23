"""The page of a fleet: a summary, the packs over time, flights to look at, and the accuracy of the forecasts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import PurePath

import numpy as np
from numpy.typing import NDArray

from uavbatt.fleet.row import FlightRow
from uavbatt.output import counted
from uavbatt.packs.dates import date_text
from uavbatt.report.fleet.figures import errors_figure, resistance_spark, scale_figure
from uavbatt.report.fleet.groups import CHECKPOINTS, MOST_FILES, MOST_LISTED, Change, Group, Overview, change, verdict
from uavbatt.report.page import (
    DASH,
    Html,
    answer,
    badge,
    bullets,
    details,
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
MOST_REASONS = 10  # rows; the flights themselves are in the folded table


def fleet_report(overview: Overview, battery: str, remarks: Sequence[tuple[str, str]] = ()) -> str:
    """Return the whole page as HTML.

    battery : name of the battery file of the run; remarks : names and values of the run
    """
    ranked = _ranked(overview.groups.values())
    parts = [
        section("Packs over time", *_health(ranked)),
        section("Flights that need a look", *_look(overview)),
        section("Forecasts against the truth", *_accuracy(overview)),
    ]
    whose = (
        f"{counted(overview.flights, 'flight')} of {_whose(list(overview.groups))}" if overview.flights else "no flight"
    )
    return page(
        f"Fleet: {whose}",
        "uavbatt fleet",
        _answer(overview, ranked, battery),
        *(parts if overview.flights or not overview.failed else []),
        *([section("Logs that could not be replayed", _failed(overview))] if overview.failed else []),
        section("The run", facts([("battery file", battery), *remarks])),
    )


Ranked = tuple[Group, Change | None, Change | None]


def _ranked(groups: Iterable[Group]) -> list[Ranked]:
    """Return the groups with the changes of their resistance and capacity; the most certain and largest come first."""
    changes = [(g, change(g, g.resistance), change(g, g.capacity)) for g in groups]

    def concern(one: Ranked) -> tuple[bool, float, int]:
        growth = one[1]
        return (
            not (one[0].is_identified and _is_grown(growth)),
            -(growth.difference if growth is not None else -math.inf),
            -one[0].flights,
        )

    return sorted(changes, key=concern)


def _is_grown(trend: Change | None) -> bool:
    return trend is not None and trend.is_certain and trend.difference > 0.0


def _answer(overview: Overview, ranked: Sequence[Ranked], battery: str) -> Html:
    failed = sum(overview.failures.values())
    if failed and not overview.flights:
        none_replayed = (
            f"None of {counted(failed, 'log')} could be replayed: this fleet is not known. The reasons are below."
        )
        return answer(paragraph(none_replayed), mood="bad")
    hours = sum(g.flown_s for g in overview.groups.values()) / 3600.0
    failures = f"; {counted(failed, 'log')} could not be replayed" if failed else ""
    first = f"{counted(overview.flights, 'flight')} in {number(hours, 1)} h; {overview.looked} need a look{failures}."
    paragraphs = [paragraph(first), paragraph(_health_words(ranked))]
    errors, inside = np.array(overview.errors["120"]), overview.inside["120"]
    if len(errors):
        forecasts = len(errors) + overview.refused["120"]
        paragraphs.append(
            paragraph(
                f"Two minutes before the end the forecasts were off by {number(_mean(np.abs(errors)), 0, 's')} on "
                f"average, in {counted(forecasts, 'flight')} that show their end; the truth was inside the 90 % "
                f"interval in {inside} of them."
            )
        )
    paragraphs.append(
        paragraph(
            *(badge(status) for status in sorted(overview.certificates)), f" battery file: {battery}.", css="quiet"
        )
    )
    return answer(*paragraphs, mood="unsure" if failed else "")


def _health_words(ranked: Sequence[Ranked]) -> str:
    """Return in words which packs have aged, how many have not, and of how many this is not known."""
    verdicts = [(group.name, verdict(group, resistance, capacity)) for group, resistance, capacity in ranked]
    names = [name for name, health in verdicts if health.kind == "grown"]
    steady, untold = (sum(health.kind == kind for _, health in verdicts) for kind in ("steady", "cannot tell"))
    rest = f"{steady} steady, {untold} not known (see the table)."
    if names:
        return f"Resistance has grown in: {', '.join(names[:5])}{', …' if len(names) > 5 else ''}; {rest}"
    if not steady:
        return "For none of them is it known whether it has aged (see the table)." if ranked else "No log was replayed."
    return f"No ageing found: {rest}"


def _health(ranked: Sequence[Ranked]) -> list[Html]:
    if not ranked:
        return [paragraph("No flight, no health.", css="quiet")]
    histories = [one for one in ranked if one[0].flights >= 2 and one[0].is_identified]  # a folder has no history
    first_groups = histories[:MOST_DRAWN]
    figures = [grid(scale_figure(g, "resistance"), scale_figure(g, "capacity")) for g, _, _ in first_groups]
    hidden = len(histories) - len(first_groups)
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
    more = f"Drawn: the {len(first_groups)} that changed most; {hidden} more in the table." if hidden else ""
    return [paragraph(explained), *figures, paragraph(more, css="quiet"), _folded(head, rows)]


def _folded(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Html:
    body = table(head, rows, text_columns=(0, 1))
    return body if len(rows) <= 30 else details(f"All {len(rows)} packs and aircraft", body)


def _changed(trend: Change | None, values: Sequence[tuple[float, float]]) -> str:
    if trend is None:
        scale, sd = values[-1]
        return f"{number(scale, 2)} ± {number(2.0 * sd, 2)}"
    return f"{number(trend.early, 2)} → {number(trend.late, 2)} (± {number(2.0 * trend.difference_sd, 2)})"


def _verdict(group: Group, resistance: Change | None, capacity: Change | None) -> Html:
    health = verdict(group, resistance, capacity)
    return badge({"steady": "pass", "cannot tell": "not enough data"}.get(health.kind, "fail"), health.words)


def _dates(group: Group) -> tuple[str, str]:
    starts_s = [s for s in group.start_s if math.isfinite(s)]
    if not starts_s:
        return DASH, DASH
    return date_text(min(starts_s)), date_text(max(starts_s))


def _look(overview: Overview) -> list[Html]:
    if not overview.look:
        return [paragraph("None.", css="quiet")]
    rows = [
        (_name(row), row.look, row.aircraft, row.start_utc[:10] or DASH, percent(row.end_soc))
        for row in overview.look[:MOST_LISTED]
    ]
    more = overview.looked - len(overview.look)
    by_count = sorted(overview.reasons.items(), key=lambda one: -one[1])
    return [
        bullets(f"{counted(n, 'flight')}: {reason}" for reason, n in by_count[:MOST_REASONS]),
        table(("log", "why", "aircraft", "date", "charge at end"), rows, text_columns=(0, 1, 2, 3)),
        paragraph(f"Those that need it most; {more} more in flights.csv, column `look`." if more else "", css="quiet"),
    ]


def _name(row: FlightRow) -> str:
    """Return the name of the flight's log, with the flight's number if it is not the first of its log."""
    name = PurePath(row.file).name
    return f"{name}, flight {row.flight}" if row.flight > 1 else name


def _failed(overview: Overview) -> Html:
    by_count = sorted(overview.failures.items(), key=lambda one: -one[1])
    rows = [
        (
            str(count),
            reason,
            ", ".join(PurePath(f).name for f in overview.failed[reason]) + (", …" if count > MOST_FILES else ""),
        )
        for reason, count in by_count[:MOST_LISTED]
    ]
    return table(("logs", "reason", "files"), rows, text_columns=(0, 1))


def _accuracy(overview: Overview) -> list[Html]:
    rows = []
    for key, label in CHECKPOINTS.items():
        errors = np.array(overview.errors[key])
        forecasts = len(errors) + overview.refused[key]
        if not forecasts:
            continue
        absolute = np.abs(errors)
        rows.append(
            (
                label, str(forecasts), _mean_and_error(absolute), _mean_and_error(errors, sign=True),
                number(float(np.median(absolute)) if len(errors) else math.nan, 0),
                f"{overview.inside[key]} ({percent(overview.inside[key] / forecasts)})", str(overview.refused[key]),
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
    return [errors_figure(overview.errors), table(head, rows), notes]


def _mean_and_error(values: NDArray[np.float64], *, sign: bool = False) -> str:
    if not len(values):
        return DASH
    error = float(np.std(values, ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else math.nan
    return f"{number(_mean(values), 0, sign=sign)} ± {number(error, 0)}"


def _mean(values: NDArray[np.float64]) -> float:
    return float(np.mean(values))


def _whose(groups: Sequence[str]) -> str:
    return groups[0] if len(groups) == 1 else f"{len(groups)} packs or aircraft"
