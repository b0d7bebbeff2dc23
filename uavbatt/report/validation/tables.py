"""The tables of the validation page: claims, data, precision, budget, agreement, before and after."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from functools import partial

import numpy as np

from uavbatt.dataset import DataSet
from uavbatt.report.page import (
    DASH,
    Html,
    badge,
    bullets,
    celsius,
    details,
    element,
    facts,
    number,
    paragraph,
    percent,
    table,
    together,
)
from uavbatt.validation.gating.budget import Budget
from uavbatt.validation.gating.gate import Claim
from uavbatt.validation.gating.temperature_gains import Gain
from uavbatt.validation.judging.finding import Finding
from uavbatt.validation.study.paper import Agreement
from uavbatt.validation.validate import LevelPrecision

PASSED = re.compile(r"the interval of the bias is inside ±(?P<limit>\S+) at all (?P<count>\d+)")
KNOWN = re.compile(r"known to ±(?P<is>\d+%)(?: only)? \(declared: ±(?P<most>\d+%)\)")
FIGURE = re.compile(r"bias [-+]\S+( ± \S+)? (?=beyond)| \(largest [^)]*\)")
SHOWN = {"V": (1000.0, "mV", 0), "s": (1.0, "s", 1), "K": (1.0, "K", 2)}
QUANTITY = {"voltage_V": ("Voltage", 1000.0, "mV", "V", 3), "surface_C": ("Surface temperature", 1.0, "K", "°C", 2)}
FOLDED_NOTES = 4  # so many notes, or more, are folded
SEVERITY = {"serious": "fail", "warning": "not enough data", "note": "note"}


def claims_table(claims: Sequence[Claim]) -> Html:
    """Tabulate the claims, one a row: the verdict, the bias that decides, and why."""
    head = ("claim", "verdict", "why", "decides", "bias nearest the limit", "its interval", "limit")
    return table(head, [_claim_row(c) for c in claims], text_columns=(0, 1, 2, 3))


def shown_as(unit: str) -> tuple[float, str, int]:
    """Return how a claim in `unit` is shown: the factor, the unit on the page, the decimals."""
    return SHOWN.get(unit, (1.0, unit, 3))


def nearest(claim: Claim) -> int:
    """Return the index of the instant that decides.

    It is the instant whose bias and half width use most of the limit (without a single limit, the one with the largest
    bias). For a failed claim it is the largest of the biases whose whole interval is beyond the limit, which the reason
    names.
    """
    size, half = np.abs(claim.bias), np.nan_to_num(claim.half_width)
    beyond = size - half > claim.limit
    if claim.verdict == "fail" and beyond.any():
        return int(np.argmax(np.where(beyond, size, -1.0)))
    return int(np.nanargmax(size + half if math.isfinite(claim.limit) else size))


def plain_reason(claim: Claim) -> str:
    """Return why a claim has its verdict, in words for the crew.

    The certificate has the words of statistics ("the interval of the bias is inside"); the words for people name the
    error and its unit.
    """
    return KNOWN.sub(_known, PASSED.sub(partial(_within, claim), claim.reason))


def _known(match: re.Match[str]) -> str:
    return f"uncertain by {match['is']} (at most {match['most']} was declared)"


def _within(claim: Claim, match: re.Match[str]) -> str:
    limit, count = match["limit"], int(match["count"])
    places = f" at all {count} checked instants" if count > 1 else ""
    return f"the error is within ±{limit} {claim.unit}{places}, including its uncertainty"


def _claim_row(c: Claim) -> tuple[str, ...]:
    title, gates = (f"{c.claim}, {celsius(c.ambient_C)}", badge(c.verdict)), "yes" if c.gates else "informs"
    if not np.isfinite(c.bias).any():
        return *title, plain_reason(c), gates, DASH, DASH, DASH
    scale, unit, decimals = shown_as(c.unit)
    i = nearest(c)
    bias, half = float(c.bias[i]) * scale, float(c.half_width[i]) * scale
    interval = DASH
    if math.isfinite(half) and math.isfinite(c.limit):
        interval = f"{number(bias - half, decimals, sign=True)} to {number(bias + half, decimals, unit, sign=True)}"
    limit = f"±{number(c.limit * scale, decimals, unit)}" if math.isfinite(c.limit) else "±C"
    why = FIGURE.sub("", plain_reason(c))  # without its figure, which may be of another instant than the row
    return *title, why, gates, number(bias, decimals, unit, sign=True), interval, limit


def elsewhere(claims: Sequence[Claim]) -> list[Html]:
    """List the claims at other ambient temperatures by verdict, with the whole table to open."""
    by_kind: dict[tuple[str, str], list[float]] = {}
    for c in claims:
        by_kind.setdefault((c.claim, c.verdict), []).append(c.ambient_C)
    items = [
        together((badge(verdict), f" {claim}: {_listed(places)}"), "") for (claim, verdict), places in by_kind.items()
    ]
    return [bullets(items), details(f"Claims at other temperatures ({len(claims)})", claims_table(claims))]


def _listed(ambients_C: Sequence[float]) -> str:
    values = ", ".join(celsius(t).removesuffix(" °C") for t in sorted(ambients_C))
    return f"at {values} °C"


def _span(ambients_C: Sequence[float]) -> str:
    return f"{len(ambients_C)} temperatures, {celsius(min(ambients_C))} to {celsius(max(ambients_C))}"


def findings_list(findings: Sequence[Finding]) -> list[Html]:
    """List the findings in their order, each with its evidence; many notes are folded behind the others."""
    if not findings:
        return [paragraph("No fault was found in the tests.")]
    notes = [f for f in findings if f.severity == "note"]
    if len(notes) < FOLDED_NOTES:
        return [_findings(findings)]
    weighty = [f for f in findings if f.severity != "note"]
    return [*([_findings(weighty)] if weighty else []), details(f"{len(notes)} notes", _findings(notes))]


def _findings(findings: Sequence[Finding]) -> Html:
    items = [
        together(
            (
                paragraph(badge(SEVERITY.get(f.severity, "note"), f.severity), " ", element("strong", f.title)),
                paragraph(f.detail, css="quiet"),
            ),
            "",
        )
        for f in findings
    ]
    return bullets(items, css="findings")


def data_overview(dataset: DataSet) -> list[Html]:
    """Show the tests and their readings, and which readings are suspect."""
    body = []
    for sample in dict.fromkeys(r.sample for r in dataset.runs):
        runs = [r for r in dataset.runs if r.sample == sample]
        ambients = sorted({r.ambient_C for r in runs})
        repeats = max(sum(r.ambient_C == t for r in runs) for t in ambients)
        columns = (("voltage", "voltage_V"), ("current", "current_A"), ("surface temp.", "surface_C"))
        quantities = [q for q, name in columns if any(np.isfinite(getattr(r, name)).any() for r in runs)]
        span = celsius(ambients[0]) if len(ambients) == 1 else _span(ambients)
        body.append(
            (sample, span, str(len(runs)), str(repeats), str(sum(r.time_s.size for r in runs)), ", ".join(quantities))
        )
    head = ("sample", "ambient", "runs", "most repeats", "readings", "read")
    capacity = f"{dataset.capacity_Ah:g} Ah" if dataset.capacity_Ah else "capacity not stated"
    about = (
        ("data set", dataset.name),
        ("battery", f"{dataset.chemistry}, {dataset.cells_series} cells in series, {capacity}"),
        ("cut-off", f"{dataset.cutoff_V:g} V"),
        ("load", dataset.load),
        ("source", dataset.source),
        ("SHA-256", dataset.sha256),
    )
    flags = bullets(f"{f.where}: {f.printed or 'as printed'} ({f.kind}). {f.reason}" for f in dataset.flags)
    suspect = details(f"{len(dataset.flags)} entries flagged as suspect, none changed", flags) if flags else Html("")
    return [facts(about), table(head, body, text_columns=(0, 1, 5)), suspect]


def precision_table(levels: Sequence[LevelPrecision], quantity: str) -> Html:
    """Tabulate s_r, s_L, s_R, r, R per level with 95 % intervals, and their relative uncertainties A_r, A_R."""
    mine = [row for row in levels if row.quantity == quantity]
    if not mine:
        return paragraph("Not measured in repeated tests.", css="quiet")
    name, _, unit, mean_unit, _ = QUANTITY[quantity]
    few = any(row.precision.reproducibility != "ok" for row in mine)
    mark = " †" if few else ""
    head = ("min", f"mean ({mean_unit})", f"s_r ({unit})", "95 % interval", f"r ({unit})", f"s_L{mark} ({unit})",
            f"s_R{mark} ({unit})", "95 % interval", f"R{mark} ({unit})", "A_r", "A_R", "results")  # fmt: skip
    body = [_precision_row(row, quantity) for row in mine]
    levels_table = table(head, body, f"{name}: precision per level (ISO 5725-2)", text_columns=())
    return together((levels_table, bullets(_precision_remarks(mine, few), css="quiet")))


def _precision_row(row: LevelPrecision, quantity: str) -> tuple[str, ...]:
    """Return the cells of one level; dispersions in the unit in which the page shows them."""
    _, scale, unit, _, decimals = QUANTITY[quantity]
    d, p = 1 if unit == "mV" else 3, row.precision

    def shown(value: float) -> str:
        return number(value * scale, d)

    def interval(pair: tuple[float, float]) -> str:
        return f"{shown(pair[0])} to {shown(pair[1])}" if math.isfinite(pair[0]) else DASH

    return (
        f"{row.time_s / 60:g}", number(p.mean, decimals), shown(p.s_r), interval(p.s_r_interval), shown(p.r),
        shown(p.s_L), shown(p.s_R), interval(p.s_R_interval), shown(p.R), percent(p.A_r), percent(p.A_R),
        str(p.n_total),
    )  # fmt: skip


def _precision_remarks(levels: Sequence[LevelPrecision], few: bool) -> list[str]:
    """Return the notes under the table; `few`: too few samples for a statement on other packs."""
    remarks = [*dict.fromkeys(n for row in levels for n in row.precision.notes if "negative" not in n)]
    negative = sum(any("negative" in n for n in row.precision.notes) for row in levels)
    if negative:
        remarks.append(
            f"the between-sample variance came out negative at {negative} of {len(levels)} levels and is set to 0"
        )
    if few:
        remarks.append("† too few samples: not reproducibility, and no statement on other packs of the make")
    return remarks


def budget_table(claim: Claim, budget: Budget) -> Html:
    """Tabulate the standard uncertainties per source and instant, and the resulting half width."""
    scale, unit, decimals = shown_as(budget.unit)
    d = decimals + 1
    in_time = claim.unit in ("V", "K")
    at = [f"{t / 60:g} min" if in_time else f"{t:.4g} V" for t in budget.at]
    body = [(f"{r.source} ({r.kind})", *(number(u * scale, d) for u in r.u), r.how) for r in budget.rows]
    last = len(at) + 1
    used = (np.abs(claim.bias) + claim.half_width) / claim.limit
    body += [
        ("guard band, 1.645 u_B", *(number(g * scale, d) for g in budget.guard), "type B rows alone"),
        ("combined", *(number(u * scale, d) for u in budget.combined), "root of the sum of squares of all rows"),
        (
            "half width",
            *(number(h * scale, d) for h in budget.expanded),
            f"one-sided 95 % over all instants, t up to {budget.coverage:.2f}",
        ),
        ("bias", *(number(b * scale, d, sign=True) for b in claim.bias), "model − tests"),
        ("part of the limit used", *(percent(u) for u in used), f"limit ±{claim.limit * scale:g} {unit}"),
    ]
    caption = f"{claim.claim}, {celsius(claim.ambient_C)}; standard uncertainties in {unit}"
    return table(("source", *at, "how"), body, caption, text_columns=(0, last))


def agreement(tables: Sequence[Agreement]) -> list[Html]:
    """Compare the study's printed tables with the recomputation."""
    body = [(a.table, f"{a.agree} of {a.total}", a.counted) for a in tables]
    slips = bullets(s for a in tables for s in a.slips)
    return [table(("printed", "figures met", "counted"), body, text_columns=(0, 1, 2)), slips]


def gains_table(gains: Sequence[Gain]) -> Html:
    """Tabulate the errors on unseen tests before and after each extension of the model over temperature."""
    body = [
        (
            f"voltage RMSE: {g.question}",
            number(1000.0 * g.before_V, 0, "mV"),
            number(1000.0 * g.after_V, 0, "mV"),
            f"{(g.after_V - g.before_V) / g.before_V:+.0%}".replace("-", "\u2212"),
            f"held-out tests, {'all temperatures' if g.group == 'all' else g.group}",
            f"{'yes' if g.holds else 'no'} (p = {g.p_value:.2g})",
        )
        for g in gains
    ]
    head = ("error of", "before", "after", "change", "on", "does the gain hold?")
    return table(head, body, text_columns=(0, 4, 5))
