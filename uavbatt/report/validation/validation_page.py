"""The validation page: the verdict in a sentence, then its evidence, in the order in which a reader would doubt it."""

from __future__ import annotations

from uavbatt.output import counted
from uavbatt.report.page import (
    MOODS,
    Html,
    answer,
    badge,
    bullets,
    celsius,
    contents,
    details,
    facts,
    grid,
    page,
    paragraph,
    section,
)
from uavbatt.report.validation import corridor as curves
from uavbatt.report.validation.figures import claim_figures, judged, mandel, over_ambient
from uavbatt.report.validation.page_values import ValidationPage, page_of
from uavbatt.report.validation.tables import (
    agreement,
    budget_table,
    claims_table,
    data_overview,
    elsewhere,
    findings_list,
    gains_table,
    precision_table,
)
from uavbatt.validation.gating.gate import Claim
from uavbatt.validation.gating.temperatures import TemperatureLoop
from uavbatt.validation.study.paper import PaperReplay
from uavbatt.validation.validate import Validation


def validation_report(validation: Validation, paper: PaperReplay | None = None) -> str:
    """Return the whole page as HTML; `paper` adds the agreement with the study's printed tables."""
    v = page_of(validation, paper)
    sections = [
        ("Claims", [claims_table(_at_home(v))]),
        ("Bias against the limits", _equivalence(v)),
        ("Findings about the tests", findings_list(v.found.findings)),
        ("Curves and corridors", _corridors(v)),
        ("Over ambient temperature", _ambient(v)),
        *([("Before and after", _changes(v.found.temperatures))] if v.found.temperatures is not None else []),
        ("Precision", [details("s_r, s_L, s_R of every level, and the consistency of the samples", *_precision(v))]),
        ("Uncertainty budget", _budgets(v)),
        *([("Agreement with the study's printed tables", _agreement(v.paper))]
          if v.paper is not None and v.is_study else []),
        ("Data", data_overview(v.found.dataset)),
    ]  # fmt: skip
    return page(
        f"{v.found.dataset.name}: may its model fly?",
        f"uavbatt validate, method {v.found.method}",
        _answer(v),
        contents(*(title for title, _ in sections)),
        *(section(title, *content) for title, content in sections),
        footer="A certificate holds for the range it names and for packs of the same make.",
    )


def _at_home(v: ValidationPage) -> list[Claim]:
    return [c for c in v.found.claims if c.ambient_C == v.found.ambient_C]


def _answer(v: ValidationPage) -> Html:
    """Return the verdict in a sentence for pilots, the most important findings, and the limits."""
    serious = sum(f.severity == "serious" for f in v.found.findings)
    first = f"Read first: {counted(serious, 'serious finding')} about the tests themselves, below. "
    limits = "; ".join(f"{name} {value}" for name, value in _limits(v))
    return answer(
        paragraph(badge(v.found.verdict), f" {verdict_sentence(v)}"),
        paragraph(first if serious else ""),
        paragraph(f"Limits, declared before the data were seen: {limits}."),
        paragraph(_shipped(v.found)),
        mood=MOODS.get(v.found.verdict, ""),
    )


def verdict_sentence(v: ValidationPage) -> str:
    """Return in one sentence what the verdict means for a flight."""
    place, within = f"at {celsius(v.found.ambient_C)}", " and ".join(value for _, value in _limits(v)[:2])
    deciding = [c for c in v.found.claims if c.gates and c.verdict == v.found.verdict]
    why = f" ({deciding[0].claim}: {deciding[0].reason})" if deciding else ""
    if v.found.verdict == "pass":
        packs = any("reproducib" in c.claim and c.verdict != "pass" for c in v.found.claims)
        unproven = "At other temperatures" + (" and for other packs of the make" if packs else "")
        return (
            f"Tests held back from the fit agree with this model {place} to within {within}, including the scatter of "
            f"the tests and the uncertainty of the instruments. {unproven} it is not proven."
        )
    if v.found.verdict == "fail":
        return f"Do not fly on this model: {place} it is not right to within {within}{why}."
    return f"Not proven: these tests cannot show {place} that the model is right to within {within}{why}."


def _limits(v: ValidationPage) -> tuple[tuple[str, str], ...]:
    """Return the declared limits in words; the first two decide."""
    limits = v.found.limits
    return (
        ("voltage", f"±{limits.voltage_V:.3g} V"),
        ("time", f"±{limits.time_s:g} s"),
        ("crossing voltage", f"{limits.crossing_V:.4g} V"),
        ("surface temperature (informs)", f"±{limits.surface_K:g} K"),
    )


def _shipped(validation: Validation) -> str:
    if validation.battery is None:
        return "Nothing ships."
    certificate = validation.battery.certificate
    validated = ", ".join(f"{t:+g} °C" for t in certificate.validated_ambient_C) or "nowhere"
    return (
        f"The battery file {validation.battery.battery.name} ships as {certificate.status}, validated at {validated}."
    )


def _equivalence(v: ValidationPage) -> list[Html]:
    figures = claim_figures(judged(v.found.claims, v.found.ambient_C))
    note = (
        "A claim passes when the whole interval of the bias lies inside the limits. The interval is one-sided 95 % "
        "at each end, over all instants together, with a guard band for the instruments."
    )
    return [paragraph(note), grid(*figures)] if figures else [paragraph("No bias could be judged.")]


def _corridors(v: ValidationPage) -> list[Html]:
    figures, folded = [curves.family(v)], list[Html]()
    volts, heat = v.found.corridors.get(v.found.ambient_C), v.found.surface_corridors.get(v.found.ambient_C)
    if volts is not None:
        model = v.model.voltage_V
        figures.append(curves.corridor(v, volts, model, 4))
        folded += [curves.departures(v, volts, model), curves.in_time(v)]
    if heat is not None:
        warm = v.model.surface_C
        folded += [curves.corridor(v, heat, warm, 5), curves.departures(v, heat, warm)]
    by_quantity = (("voltage", volts), ("surface temperature", heat))
    notes = bullets((f"{name}: {n}" for name, c in by_quantity if c is not None for n in c.notes), css="quiet")
    named_more = "Deviations from the mean, and the tests in time" + (
        "; the surface temperature" if heat is not None else ""
    )
    more = details(named_more, grid(*folded))
    return [grid(*figures), more, notes]


def _ambient(v: ValidationPage) -> list[Html]:
    volts, heat = list(v.found.corridors.values()), list(v.found.surface_corridors.values())
    others = [c for c in v.found.claims if c.ambient_C != v.found.ambient_C]
    candidates = [curves.over_ambient(v, volts, "voltage_V", 6), curves.crossings(v)]
    candidates += [over_ambient(others), curves.over_ambient(v, heat, "surface_C", 7)]
    folded = details("Curves, crossings and claims over ambient temperature", grid(*candidates))
    return [*(elsewhere(others) if others else []), folded]


def _changes(loop: TemperatureLoop) -> list[Html]:
    """Show the gains of extending the model over temperature."""
    conclusions = bullets(loop.conclusions)
    return [gains_table(loop.gains), details("In words", conclusions)] if loop.gains else [conclusions]


def _agreement(paper: PaperReplay) -> list[Html]:
    """Return the agreement of the study's method with its printed tables, and notes on the comparison."""
    claim, notes = paper.fisher, list(paper.notes)
    if claim is not None:
        verdict = "reproduced" if claim.reproducible else "cannot be reproduced"
        nearest = f"the nearest ratio of any column is {claim.nearest:.2f}"
        notes.insert(0, f"F_emp = {claim.printed:g} is printed; {nearest}: {verdict}.")
    met, of = (sum(getattr(a, which) for a in paper.agreements) for which in ("agree", "total"))
    return [details(f"{met} of {of} printed figures are met", *agreement(paper.agreements), bullets(notes))]


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
        parts += [precision_table(v.found.precision, quantity), grid(*mandel(v.consistency, quantity))]
    return parts


def _budgets(v: ValidationPage) -> list[Html]:
    with_budget = [(c, c.budget) for c in v.found.claims if c.budget is not None and c.ambient_C == v.found.ambient_C]
    if not with_budget:
        return [paragraph("No claim has a budget.", css="quiet")]
    tables = [budget_table(c, b) for c, b in with_budget]
    return [*tables[:1], details("Budgets of the other claims", *tables[1:])]
