"""The validation page: the stage's own values handed to the report, which lies below and knows only their shapes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from uavbatt.dataset import DataSet, whole_minutes
from uavbatt.files import atomic_write
from uavbatt.report.validation import validation_report
from uavbatt.report.validation_inputs import Change, Consistency, ModelCurve, ValidationPage
from uavbatt.validation import reading
from uavbatt.validation.corridor import corridors, time_corridor
from uavbatt.validation.crossing import crossing_time
from uavbatt.validation.heldout import HeldOut
from uavbatt.validation.outliers import mandel
from uavbatt.validation.paper import PaperReplay
from uavbatt.validation.validate import Validation

QUANTITIES = ("voltage_V", "surface_C")


def validation_page(v: Validation, paper: PaperReplay | None = None, changes: Sequence[Change] | None = None) -> str:
    """The page as HTML. `paper` adds the agreement with the study's tables, `changes` the table before and after.

    Without `changes` the table shows what closing the loop over ambient temperature gave, if that was done.
    """
    tests = reading.at_minutes(v.dataset)
    crossing_V = v.limits.crossing_V
    return validation_report(
        ValidationPage(
            dataset=v.dataset,
            tests=tests,
            ambient_C=v.ambient_C,
            verdict=v.verdict,
            limits=_limits(v),
            claims=v.claims,
            findings=v.findings,
            precision=v.precision,
            consistency=consistency(tests, v.ambient_C),
            corridors=v.corridors,
            surface_corridors=corridors(tests, "surface_C"),
            time_corridor=time_corridor(tests, v.ambient_C),
            model=_model(v.held),
            crossing_V=crossing_V,
            crossings=[
                (r.sample, r.ambient_C, crossing_time(r.time_s, r.voltage_V, crossing_V)) for r in v.dataset.runs
            ],
            agreements=() if paper is None else paper.agreements,
            paper_notes=() if paper is None else _paper_notes(paper),
            method=v.method,
            shipped=_shipped(v),
            conclusions=() if v.temperatures is None else v.temperatures.conclusions,
            changes=_gains(v) if changes is None else changes,
        )
    )


def write(
    path: str | Path, v: Validation, paper: PaperReplay | None = None, changes: Sequence[Change] | None = None
) -> None:
    """Write the page to `path` (`-`: standard output), whole or not at all."""
    html = validation_page(v, paper, changes)
    with atomic_write(path) as file:
        file.write(html)


def consistency(tests: DataSet, ambient_C: float) -> tuple[Consistency, ...]:
    """Mandel's h and k per instant, for two samples or more with repeats."""
    found = []
    for quantity in QUANTITIES:
        levels = whole_minutes(tests, ambient_C, quantity)
        if levels is None or len(levels.samples) < 2:
            continue
        for i, t in enumerate(levels.time_s):
            cells = levels.cells(i)
            if len(cells) != len(levels.samples):
                continue
            m = mandel(cells)
            criticals = (m.h_critical_5, m.h_critical_1), (m.k_critical_5, m.k_critical_1)
            found.append(Consistency(quantity, float(t), levels.samples, m.h, m.k, *criticals))
    return tuple(found)


def _gains(v: Validation) -> tuple[Change, ...]:
    """What the extensions over ambient temperature were worth on tests that the fit had not seen."""
    if v.temperatures is None:
        return ()
    return tuple(
        Change(
            quantity=f"voltage RMSE: {g.question}",
            unit="mV",
            before=1000.0 * g.before_V,
            after=1000.0 * g.after_V,
            on=f"held-out tests, {'all temperatures' if g.group == 'all' else g.group}",
            decimals=0,
            verdict=f"{'yes' if g.holds else 'no'} (p = {g.p_value:.2g})",
        )
        for g in v.temperatures.gains
    )


def _limits(v: Validation) -> tuple[tuple[str, str], ...]:
    return (
        ("voltage", f"±{v.limits.voltage_V:.3g} V"),
        ("time", f"±{v.limits.time_s:g} s"),
        ("crossing voltage", f"{v.limits.crossing_V:.4g} V"),
        ("surface temperature (informs)", f"±{v.limits.surface_K:g} K"),
    )


def _model(held: HeldOut) -> ModelCurve:
    """The mean prediction over the held-out occasions; an instant that none predicts is NaN."""

    def mean(
        table: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    ) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        flat = table.reshape(-1, table.shape[-1])
        known = np.isfinite(flat)
        total = np.where(known, flat, 0.0).sum(axis=0)
        return np.where(known.any(axis=0), total / np.maximum(known.sum(axis=0), 1), math.nan)

    surface = None if held.model_C is None else mean(held.model_C)
    return ModelCurve(held.model, held.time_s, mean(held.model_V), surface)


def _paper_notes(paper: PaperReplay) -> tuple[str, ...]:
    claim = paper.fisher
    if claim is None:
        return paper.notes
    said = f"F_emp = {claim.printed:g} is printed; the nearest ratio of any column is {claim.nearest:.2f}"
    verdict = "reproduced" if claim.reproducible else "cannot be reproduced"
    return (f"{said}: {verdict}.", *paper.notes)


def _shipped(v: Validation) -> str:
    if v.battery is None:
        return "Nothing ships."
    certificate = v.battery.certificate
    validated = ", ".join(f"{t:+g} °C" for t in certificate.validated_ambient_C) or "nowhere"
    return f"The battery file {v.battery.battery.name} ships as {certificate.status}, validated at {validated}."
