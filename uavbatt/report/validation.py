"""The validation page: the verdict in a sentence, then what it rests on, in the order in which one would doubt it."""

from __future__ import annotations

from uavbatt import __version__
from uavbatt.report import corridor_figures as curves
from uavbatt.report.page import Html, badge, bullets, celsius, details, element, facts, grid, page, paragraph, section
from uavbatt.report.validation_figures import equivalence, judged, mandel, over_ambient
from uavbatt.report.validation_inputs import ClaimLike, ValidationPage
from uavbatt.report.validation_tables import (
    agreement,
    budget_table,
    changes_table,
    claims_table,
    data_overview,
    elsewhere,
    findings_list,
    precision_table,
)

MOODS = {"pass": "good", "fail": "bad", "not enough data": "unsure"}


def validation_report(v: ValidationPage) -> str:
    """The whole page as HTML."""
    return page(
        f"{v.dataset.name}: may its model fly?",
        f"uavbatt validate, method {v.method}",
        _answer(v),
        section("Claims", claims_table(_at_home(v))),
        section("Bias against the limits", *_equivalence(v)),
        section("What the tests say about themselves", findings_list(v.findings)),
        section("Curves and corridors", *_corridors(v)),
        section("Over ambient temperature", *_ambient(v)),
        *([section("Before and after", *_changes(v))] if v.changes or v.conclusions else []),
        section("Precision", *_precision(v)),
        section("Uncertainty budget", *_budgets(v)),
        *([section("Agreement with the study's printed tables", *agreement(v.agreements), bullets(v.paper_notes))]
          if v.agreements else []),
        section("Data", *data_overview(v.dataset)),
        footer=f"uavbatt {__version__}. A certificate holds for the range it names and for packs of the same make.",
    )  # fmt: skip


def _at_home(v: ValidationPage) -> list[ClaimLike]:
    return [c for c in v.claims if c.ambient_C == v.ambient_C]


def _answer(v: ValidationPage) -> Html:
    """The verdict in one sentence that a pilot understands, what to read first, and the limits it was judged by."""
    serious = sum(f.severity == "serious" for f in v.findings)
    first = f"Read first: {serious} serious finding{'s' * (serious > 1)} about the tests themselves, below. "
    limits = "; ".join(f"{name} {value}" for name, value in v.limits)
    return element(
        "div",
        paragraph(badge(v.verdict), f" {verdict_sentence(v)}"),
        *([paragraph(first)] if serious else []),
        paragraph(f"Limits, declared before the data were seen: {limits}."),
        *([paragraph(v.shipped)] if v.shipped else []),
        css=f"answer {MOODS.get(v.verdict, '')}",
    )


def verdict_sentence(v: ValidationPage) -> str:
    """What the verdict means for a flight."""
    where, within = f"at {celsius(v.ambient_C)}", " and ".join(value for _, value in v.limits[:2])
    deciding = [c for c in v.claims if c.gates and c.verdict == v.verdict]
    why = f" ({deciding[0].claim}: {deciding[0].reason})" if deciding else ""
    if v.verdict == "pass":
        packs = any("reproducib" in c.claim and c.verdict != "pass" for c in v.claims)
        unproven = "At other temperatures" + (" and for other packs of the make" if packs else "")
        return (
            f"Tests held back from the fit agree with this model {where} to within {within}, the scatter of the tests "
            f"and the doubt about the instruments counted in. {unproven} it is not proven."
        )
    if v.verdict == "fail":
        return f"Do not fly on this model: {where} it is not right to within {within}{why}."
    return f"Not proven: these tests cannot show {where} that the model is right to within {within}{why}."


def _equivalence(v: ValidationPage) -> list[Html]:
    drawn = equivalence(judged(v.claims, v.ambient_C))
    said = (
        "A claim passes when the whole interval of the bias lies inside the limits. The interval is one-sided 95 % "
        "at each end, over all instants together, with a guard band for the instruments."
    )
    return [paragraph(said), grid(*drawn)] if drawn else [paragraph("No bias could be judged.")]


def _corridors(v: ValidationPage) -> list[Html]:
    drawn = [curves.family(v)]
    volts, heat = v.corridors.get(v.ambient_C), v.surface_corridors.get(v.ambient_C)
    if volts is not None:
        model = v.model.voltage_V
        drawn += [curves.corridor(v, volts, model, 4), curves.departures(v, volts, model), curves.in_time(v)]
    if heat is not None:
        warm = v.model.surface_C
        drawn += [curves.corridor(v, heat, warm, 5), curves.departures(v, heat, warm)]
    named = (("voltage", volts), ("surface temperature", heat))
    notes = bullets((f"{name}: {n}" for name, c in named if c is not None for n in c.notes), css="quiet")
    return [grid(*drawn), notes]


def _ambient(v: ValidationPage) -> list[Html]:
    volts, heat = list(v.corridors.values()), list(v.surface_corridors.values())
    others = [c for c in v.claims if c.ambient_C != v.ambient_C]
    drawn = [curves.over_ambient(v, volts, "voltage_V", 6), curves.crossings(v)]
    drawn += [over_ambient(others), curves.over_ambient(v, heat, "surface_C", 7)]
    return [*(elsewhere(others) if others else []), grid(*(d for d in drawn if d))]


def _changes(v: ValidationPage) -> list[Html]:
    """What extending the model was worth; nothing where it was not tried."""
    said = bullets(v.conclusions)
    return [changes_table(v.changes), details("In words", said)] if v.changes else [said]


def _precision(v: ValidationPage) -> list[Html]:
    words = facts(
        (
            ("s_r, r", "scatter of one sample's results; two of them differ by more than r in one case of twenty"),
            ("s_L", "scatter between samples"),
            ("s_R, R", "scatter of results on different samples, and the limit for two of them"),
            ("A_r, A_R", "how uncertain s_r and s_R themselves are, relative, 95 % (ISO 5725-1)"),
        )
    )
    parts = [words]
    for quantity in ("voltage_V", "surface_C"):
        parts += [precision_table(v.precision, quantity), grid(*mandel(v.consistency, quantity))]
    return parts


def _budgets(v: ValidationPage) -> list[Html]:
    with_budget = [(c, c.budget) for c in v.claims if c.budget is not None and c.ambient_C == v.ambient_C]
    if not with_budget:
        return [paragraph("No claim has a budget.", css="quiet")]
    tables = [budget_table(c, b) for c, b in with_budget]
    return [*tables[:2], *([details("Budgets of the other claims", *tables[2:])] if tables[2:] else [])]
