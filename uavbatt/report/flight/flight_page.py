"""The flight page: the answer, its limits, the pilot's chart; then details, and the source of every number."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path, PurePath

import numpy as np

from uavbatt.battery.battery_file import BatteryFile, Certificate
from uavbatt.battery.sizing.pack_size import PackSize
from uavbatt.log_replay.outcome import Outcome
from uavbatt.log_replay.run import ReplayedRow
from uavbatt.records import Flight, Status
from uavbatt.report.flight.answer import first_answer
from uavbatt.report.flight.axis import TimeAxis
from uavbatt.report.flight.chart import save_time_left, time_left_chart
from uavbatt.report.flight.cursor import cursor, cursor_script
from uavbatt.report.flight.events import events
from uavbatt.report.flight.figures import figures
from uavbatt.report.flight.limits import against_a_reserve, limits_of
from uavbatt.report.flight.route import route_section
from uavbatt.report.flight.series import Stretch, rows, stretches, warnings_of, with_gaps
from uavbatt.report.page import (
    DASH,
    UNKNOWN,
    Html,
    answer,
    badge,
    bullets,
    details,
    duration,
    element,
    facts,
    grid,
    number,
    page,
    paragraph,
    percent,
    section,
    sentence,
    table,
)

STATUS_WORDS = {
    "certified": "Certified: the model of this battery passed the gate on repeated tests of its own type.",
    "fitted": "Fitted: the model comes from data of this battery but has not passed the gate; its intervals are wider.",
    "generic": "Generic: a prior for batteries of this kind, not measured on this one; its intervals are wide.",
    "edited": "Edited: not what was sealed, or failed at its gate; let through by the caller, nobody vouches for it.",
}
MOST_CLAIMS = 8  # rows of a table that needs no fold
MOST_WARNINGS = 20  # different ones; the JSON Lines hold all
SHOWN_AS = {
    Status.REFUSED: "refused (hatched)", Status.CONVERGING: "converging (shaded)", Status.STALE: "gap (left blank)",
}  # fmt: skip


def flight_report(
    flight: Flight, steps: Sequence[ReplayedRow], resolved: PackSize, outcome: Outcome, battery: BatteryFile
) -> str:
    """Return the whole page as HTML.

    `steps` are the rows of the replay, `resolved` the pack's size and where it came from, `outcome` the figures.
    """
    periods, name = stretches(steps), _name(flight)
    chart_rows = with_gaps(rows(steps))
    axis = TimeAxis(chart_rows, periods, outcome)
    chart = time_left_chart(chart_rows, axis, events(flight, steps, outcome, resolved.low_V))
    engineers = details(
        "For engineers: charge, voltage, innovation, current and temperature over the same time",
        grid(*figures(chart_rows, axis, outcome, resolved)),
    )
    return page(
        f"{name}: battery {flight.instance}",
        "uavbatt replay",
        _answer(outcome, resolved, periods, steps),
        section("Over the flight", chart, cursor(), engineers, _stretches(periods)),
        *route_section(flight, steps),
        section("Forecast against the truth", _checkpoints(outcome)),
        section("Battery and certificate", *_battery(resolved, battery)),
        section("The log", *_log(flight, outcome, steps)),
        script=cursor_script(chart_rows),
    )


def save_charts(
    paths: Iterable[Path], flight: Flight, steps: Sequence[ReplayedRow], resolved: PackSize, outcome: Outcome
) -> bool:
    """Write the page's main chart to files, PNG or SVG by their names, under the name of the log and the answer.

    Returns False, with nothing written, for a flight without a forecast.
    """
    chart_rows = with_gaps(rows(steps))
    if not np.isfinite(chart_rows.remaining_s).any():
        return False
    axis = TimeAxis(chart_rows, stretches(steps), outcome)
    marks = events(flight, steps, outcome, resolved.low_V)
    title = f"{_name(flight)}: {first_answer(outcome.landing, outcome.end_of_flight_s, resolved.cutoff_V)}"
    for path in paths:
        save_time_left(path, chart_rows, axis, marks, title)
    return True


def _name(flight: Flight) -> str:
    return PurePath(flight.source).name or flight.source


def _answer(outcome: Outcome, resolved: PackSize, periods: Sequence[Stretch], steps: Sequence[ReplayedRow]) -> Html:
    """Return the box at the top: the first answer, then the sentences that limit it."""
    first = first_answer(outcome.landing, outcome.end_of_flight_s, resolved.cutoff_V)
    limits = [*limits_of(outcome, resolved, steps), _refused_words(outcome, periods)]
    status = element("span", badge(resolved.status), f" {STATUS_WORDS.get(resolved.status, '')}")
    return answer(paragraph(first), bullets([*filter(None, limits), status]))


def _refused_words(outcome: Outcome, periods: Sequence[Stretch]) -> str:
    refused_s = sum(s.duration_s for s in periods if s.status is Status.REFUSED)
    if refused_s <= 0.0:
        return ""
    air = outcome.refused_in_air
    share = f"{percent(air)} of the rows" if air > 0.0 else "none of it"
    flying = f", {share} in the air after the first minute" if math.isfinite(air) else ""
    return f"No forecast was given for {duration(refused_s)} in all{flying}."


def _stretches(periods: Sequence[Stretch]) -> Html:
    """Explain the hatching and the shading."""
    if not periods:
        return paragraph("No number was refused.", css="quiet")
    body = [
        (
            f"{duration(s.begin_s)} to {duration(s.end_s)}",
            SHOWN_AS.get(s.status, s.status.value),
            s.reason if s.reason == s.last_reason else f"{s.reason}; at the end: {s.last_reason}",
            str(s.rows),
        )
        for s in periods
    ]
    stretch_table = table(("when", "what", "why", "rows"), body, text_columns=(0, 1, 2))
    return details(f"Where a number was refused or not yet settled ({len(periods)})", stretch_table)


def _checkpoints(outcome: Outcome) -> Html:
    if outcome.reserve_soc > 0.0:
        return paragraph(f"{sentence(against_a_reserve(outcome.reserve_soc))}.")
    if not outcome.checkpoints:
        return paragraph("The log does not show the end of flight, or it is too short before it: nothing to compare.")
    body = []
    for c in outcome.checkpoints:
        refused = not math.isfinite(c.remaining_s)
        interval = DASH if refused else f"{number(c.lo_s, 0)} to {number(c.hi_s, 0)}"
        verdict = badge("not enough data", "refused: a miss") if refused else _hit(c.inside)
        forecast = "refused" if refused else number(c.remaining_s, 0)
        body.append((c.label, number(c.before_end_s, 0), forecast, interval, number(c.error_s, 0, sign=True), verdict))
    head = ("instant", "truth (s)", "forecast (s)", "5 % to 95 % (s)", "error (s)", "truth in the interval")
    note = "The forecast in force at each instant, made from earlier rows alone; a positive error is optimistic."
    return table(head, body, note, text_columns=(0, 5))


def _hit(inside: bool) -> Html:
    return badge("pass", "inside") if inside else badge("fail", "outside")


def _battery(resolved: PackSize, battery: BatteryFile) -> list[Html]:
    certificate = battery.certificate
    validated = certificate.validated_ambient_C
    span = f"{min(validated):g} to {max(validated):g} °C" if validated else "none"
    return [
        paragraph(badge(resolved.status), f" {STATUS_WORDS.get(resolved.status, '')}"),
        facts(
            (
                ("battery file", f"{resolved.battery} ({battery.battery.chemistry})"),
                ("cells in series", f"{resolved.cells} (from: {resolved.cells_from})"),
                ("capacity", f"{number(resolved.capacity_Ah, 2, 'Ah')} (from: {resolved.capacity_from})"),
                ("cut-off voltage", f"{number(resolved.cutoff_V, 2, 'V')} (from: {resolved.cutoff_from})"),
                ("low voltage", f"{number(resolved.low_V, 2, 'V')} (from: {resolved.low_from})"),
                ("validated ambient", span),
                ("what the model leaves", number(battery.discrepancy.voltage_rmse_V * 1000.0, 0, "mV RMSE a pack")),
                ("data set", certificate.data_sha256[:16] or "none"),
                ("file content", certificate.content_sha256[:16] or UNKNOWN),
            )
        ),
        _claims(certificate, resolved.status),
        *_notes("Remarks in the battery file", battery.battery.remarks),
    ]


def _claims(certificate: Certificate, status: str) -> Html:
    """Return the claims of the certificate with their verdicts; more than MOST_CLAIMS are folded."""
    if not certificate.verdicts:
        why = "what it claimed was of other content" if status == "edited" else "nothing was put to a gate"
        return paragraph(f"The certificate makes no claim: {why}.")
    body = [
        (v.claim, UNKNOWN if v.ambient_C is None else f"{v.ambient_C:+g} °C", badge(v.verdict), v.reason)
        for v in certificate.verdicts
    ]
    claims = table(("claim", "ambient", "verdict", "why"), body, text_columns=(0, 1, 2, 3))
    return claims if len(body) <= MOST_CLAIMS else details(f"{len(body)} claims of the certificate", claims)


def _log(flight: Flight, outcome: Outcome, steps: Sequence[ReplayedRow]) -> list[Html]:
    instances = ", ".join(str(i) for i in flight.instances)
    nis = number(outcome.mean_nis, 2)
    has_temp = any(math.isfinite(s.estimate.temp_C) for s in steps)
    expected = "between 1 and 2 (rows with a temperature count two)" if has_temp else "1"
    skipped = f"{flight.skipped_bytes} unreadable bytes passed over" if flight.skipped_bytes else "no byte skipped"
    return [
        facts(
            (
                ("file", flight.source),
                ("kind", flight.kind),
                ("battery", f"{flight.instance} (the log has: {instances})"),
                ("rows", f"{outcome.rows} in {duration(outcome.duration_s)}"),
                ("last voltage", number(outcome.end_voltage_V, 2, "V")),
                ("skipped", skipped),
                ("mean NIS", f"{nis}; {expected} if the filter's uncertainty is right"),
            )
        ),
        *_notes("Notes on the log", flight.notes),
        *_notes("Warnings", _warnings(steps)),
    ]


def _notes(title: str, items: Sequence[str]) -> list[Html]:
    return [element("h3", title), bullets(items)] if items else []


def _warnings(steps: Sequence[ReplayedRow]) -> list[str]:
    """Return each warning once, with its first time and its number of rows, in order of time."""
    warnings = warnings_of(steps)
    out = [
        text + (" (all rows)" if it.rows == len(steps) else f" (from {duration(it.since_s)}, {it.rows} rows)")
        for text, it in list(warnings.items())[:MOST_WARNINGS]
    ]
    return [*out, f"and {len(warnings) - MOST_WARNINGS} more"] if len(warnings) > MOST_WARNINGS else out
