"""A validation with the values that only its page needs: the model's mean curve, and consistency."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uavbatt.validation.gating.heldout import HeldOut, known_mean
from uavbatt.validation.iso5725 import mandel
from uavbatt.validation.judging.readings import SURFACE, VOLTAGE, Readings
from uavbatt.validation.study.paper import PaperReplay
from uavbatt.validation.validate import Validation

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Consistency:
    """Consistency holds Mandel's h and k of the samples at one instant, with their critical values at 5 % and 1 %."""

    quantity: str
    time_s: float
    samples: tuple[str, ...]
    h: Array
    k: Array
    h_critical: tuple[float, float]
    k_critical: tuple[float, float]


@dataclass(frozen=True, slots=True)
class ModelCurve:
    """ModelCurve holds the mean prediction of held-out tests at the gated ambient temperature.

    `surface_C` is None where it was not predicted.
    """

    name: str
    time_s: Array
    voltage_V: Array
    surface_C: Array | None = None


@dataclass(frozen=True, slots=True)
class ValidationPage:
    """ValidationPage holds a validation, `found`, with the values that are worked out for the page only.

    `paper` is the study's method replayed, None where it cannot be applied.
    """

    found: Validation
    paper: PaperReplay | None
    consistency: Sequence[Consistency]
    model: ModelCurve

    @property
    def is_study(self) -> bool:
        """Return True if the tests are the study's own, so that its printed tables and figures can be compared."""
        return self.paper is not None and bool(self.paper.agreements)


def page_of(validation: Validation, paper: PaperReplay | None) -> ValidationPage:
    """Work out what the page needs besides the validation."""
    return ValidationPage(
        found=validation,
        paper=paper,
        consistency=consistency(validation.readings),
        model=mean_prediction(validation.held),
    )


def consistency(readings: Readings) -> tuple[Consistency, ...]:
    """Compute Mandel's h and k per instant at the gated temperature, for two samples or more with repeats."""
    consistencies = []
    for quantity in (VOLTAGE, SURFACE):
        levels = readings.levels(readings.ambient_C, quantity)
        if levels is None or len(levels.samples) < 2:
            continue
        for i, t in enumerate(levels.time_s):
            cells = levels.cells(i)
            if len(cells) != len(levels.samples):
                continue
            m = mandel(cells)
            criticals = (m.h_critical_5, m.h_critical_1), (m.k_critical_5, m.k_critical_1)
            consistencies.append(Consistency(quantity, float(t), levels.samples, m.h, m.k, *criticals))
    return tuple(consistencies)


def mean_prediction(held_out: HeldOut) -> ModelCurve:
    """Average the predictions over the held-out occasions; an instant that none predicts is NaN."""
    surface = None if held_out.model_C is None else known_mean(held_out.model_C, axis=(0, 1))
    return ModelCurve(held_out.model, held_out.time_s, known_mean(held_out.model_V, axis=(0, 1)), surface)
