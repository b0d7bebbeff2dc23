"""What the validation page reads, as shapes: it lies below the validation stage and must not import it.

`validation.page` hands over the stage's own values, which have these shapes, in one `ValidationPage`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from uavbatt.dataset import DataSet

Array = NDArray[np.float64]


class BudgetRowLike(Protocol):
    """One source of uncertainty: standard uncertainty per instant, GUM type A or B, how it was obtained."""

    @property
    def source(self) -> str: ...

    @property
    def kind(self) -> str: ...

    @property
    def u(self) -> Array: ...

    @property
    def how(self) -> str: ...


class BudgetLike(Protocol):
    """The uncertainty budget of one claim; `expanded` is the half width that the gate adds to the bias."""

    @property
    def unit(self) -> str: ...

    @property
    def at(self) -> Array: ...

    @property
    def rows(self) -> Sequence[BudgetRowLike]: ...

    @property
    def combined(self) -> Array: ...

    @property
    def coverage(self) -> float: ...

    @property
    def guard(self) -> Array: ...

    @property
    def expanded(self) -> Array: ...


class ClaimLike(Protocol):
    """One verdict with what it rests on; `at` holds instants [s] or voltages [V]."""

    @property
    def claim(self) -> str: ...

    @property
    def ambient_C(self) -> float: ...

    @property
    def verdict(self) -> str: ...

    @property
    def reason(self) -> str: ...

    @property
    def gates(self) -> bool: ...

    @property
    def at(self) -> Array: ...

    @property
    def bias(self) -> Array: ...

    @property
    def half_width(self) -> Array: ...

    @property
    def limit(self) -> float: ...

    @property
    def unit(self) -> str: ...

    @property
    def budget(self) -> BudgetLike | None: ...


class FindingLike(Protocol):
    """One thing that the tests say about themselves."""

    @property
    def title(self) -> str: ...

    @property
    def detail(self) -> str: ...

    @property
    def severity(self) -> str: ...


class CorridorLike(Protocol):
    """Mean and half-widths at `at` (time_s for values, voltage_V for crossing times); NaN = not known."""

    @property
    def ambient_C(self) -> float: ...

    @property
    def quantity(self) -> str: ...

    @property
    def at(self) -> Array: ...

    @property
    def mean(self) -> Array: ...

    @property
    def C(self) -> Array: ...

    @property
    def tolerance(self) -> Array: ...

    @property
    def simultaneous(self) -> Array: ...

    @property
    def covers_all(self) -> float: ...

    @property
    def basis(self) -> str: ...

    @property
    def notes(self) -> Sequence[str]: ...


class PrecisionLike(Protocol):
    """Precision at one level, in the unit of the results (ISO 5725-2)."""

    @property
    def mean(self) -> float: ...

    @property
    def s_r(self) -> float: ...

    @property
    def s_L(self) -> float: ...

    @property
    def s_R(self) -> float: ...

    @property
    def r(self) -> float: ...

    @property
    def R(self) -> float: ...

    @property
    def p(self) -> int: ...

    @property
    def n_total(self) -> int: ...

    @property
    def A_r(self) -> float: ...

    @property
    def A_R(self) -> float: ...

    @property
    def s_r_interval(self) -> tuple[float, float]: ...

    @property
    def s_R_interval(self) -> tuple[float, float]: ...

    @property
    def reproducibility(self) -> str: ...

    @property
    def notes(self) -> Sequence[str]: ...


class LevelPrecisionLike(Protocol):
    """Precision of one quantity at one instant."""

    @property
    def quantity(self) -> str: ...

    @property
    def time_s(self) -> float: ...

    @property
    def precision(self) -> PrecisionLike: ...


class AgreementLike(Protocol):
    """How many printed figures of a table the recomputation meets, and each that it does not."""

    @property
    def table(self) -> str: ...

    @property
    def agree(self) -> int: ...

    @property
    def total(self) -> int: ...

    @property
    def slips(self) -> Sequence[str]: ...

    @property
    def counted(self) -> str: ...


@dataclass(frozen=True, slots=True)
class Consistency:
    """Mandel's h and k of the samples at one instant, with their critical values at 5 % and 1 %."""

    quantity: str
    time_s: float
    samples: tuple[str, ...]
    h: Array
    k: Array
    h_critical: tuple[float, float]
    k_critical: tuple[float, float]


@dataclass(frozen=True, slots=True)
class ModelCurve:
    """The mean prediction of held-out tests at one ambient temperature; surface None where not predicted."""

    name: str
    time_s: Array
    voltage_V: Array
    surface_C: Array | None = None


@dataclass(frozen=True, slots=True)
class Change:
    """One error before and after the model was extended, on the data named."""

    quantity: str
    unit: str
    before: float
    after: float
    on: str
    decimals: int = 1
    verdict: str = ""


@dataclass(frozen=True, slots=True)
class ValidationPage:
    """Everything that the page shows. `tests` is `dataset` as it was read for judging (fast records at the minutes).

    `limits` are the declared ones in words.
    """

    dataset: DataSet
    tests: DataSet
    ambient_C: float
    verdict: str
    limits: tuple[tuple[str, str], ...]
    claims: Sequence[ClaimLike]
    findings: Sequence[FindingLike]
    precision: Sequence[LevelPrecisionLike]
    consistency: Sequence[Consistency]
    corridors: Mapping[float, CorridorLike]
    surface_corridors: Mapping[float, CorridorLike]
    time_corridor: CorridorLike | None
    model: ModelCurve
    crossing_V: float
    crossings: Sequence[tuple[str, float, float]] = ()  # (sample, ambient_C, time_s)
    agreements: Sequence[AgreementLike] = ()
    paper_notes: Sequence[str] = ()
    method: str = "iso"
    shipped: str = ""
    conclusions: Sequence[str] = ()
    changes: Sequence[Change] | None = None
