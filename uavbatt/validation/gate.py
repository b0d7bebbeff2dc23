"""The gate: is the model equivalent to the tests, within limits declared for flight safety?

Two one-sided tests per instant: the interval of the bias (model minus mean of the held-out occasions) must lie inside
±limit. It is simultaneous over the instants (Bonferroni), has the degrees of freedom of the occasions, and a guard
band for what the scatter of the readings cannot show: calibration, resolution, and the instant of reading.

    pass             the whole interval is inside ±limit at every instant
    fail             the bias itself is beyond the limit somewhere
    not enough data  neither, or too few occasions

"Not significantly different" is never a pass: noisier tests must make the gate harder, not easier.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from uavbatt.battery.model import Array
from uavbatt.dataset import Uncertainty
from uavbatt.validation.crossing import crossing_time
from uavbatt.validation.heldout import HeldOut

Verdict = Literal["pass", "fail", "not enough data"]
LEVEL = 0.05
LEAST_OCCASIONS = 3


@dataclass(frozen=True, slots=True)
class Limits:
    """Declared flight-safety limits, before any data are seen; volts for a 3S pack, scaled by cells."""

    voltage_V: float = 0.15
    time_s: float = 10.0
    surface_K: float = 2.0
    crossing_V: float = 10.0
    limiter_margin_V: float = 0.1

    def for_cells(self, cells: int) -> Limits:
        """The same limits for a pack of `cells` in series."""
        share = cells / 3.0
        return Limits(
            self.voltage_V * share, self.time_s, self.surface_K, self.crossing_V * share, self.limiter_margin_V * share
        )


@dataclass(frozen=True, slots=True)
class Claim:
    """One verdict with what it rests on. `gates`: a fail here keeps the model from shipping."""

    claim: str
    ambient_C: float
    verdict: Verdict
    reason: str
    gates: bool
    at: Array  # instants [s] or voltages [V]
    bias: Array
    half_width: Array  # of the bias' interval, guard band included
    guard: Array
    limit: float
    unit: str


def equivalence(residual: Array, guard: Array, limit: float) -> tuple[Array, Array, Verdict, str]:
    """(bias, half width, verdict, reason) of residuals [occasion, instant] against ±`limit`.

    half width = sqrt((t s/√n)² + guard²), t one-sided at 5 % over all instants together (Bonferroni, n-1 df).
    """
    n, instants = residual.shape
    bias = residual.mean(axis=0)
    if n < LEAST_OCCASIONS:
        nothing = np.full(instants, np.nan)
        return bias, nothing, "not enough data", f"{n} occasions, at least {LEAST_OCCASIONS} are needed"
    t = float(stats.t.ppf(1.0 - LEVEL / instants, n - 1))
    half = np.hypot(t * residual.std(axis=0, ddof=1) / np.sqrt(n), guard)
    beyond = np.abs(bias) > limit
    if beyond.any():
        worst = int(np.argmax(np.abs(bias)))
        return bias, half, "fail", f"bias {bias[worst]:+.3g} beyond ±{limit:g} at {int(beyond.sum())} of {instants}"
    if (np.abs(bias) + half <= limit).all():
        return bias, half, "pass", f"the interval of the bias is inside ±{limit:g} at all {instants}"
    return bias, half, "not enough data", f"the bias is inside ±{limit:g} but its interval is not"


def judged_instants(held: HeldOut, limits: Limits, cutoff_V: float) -> NDArray[np.intp]:
    """Indices of the instants before the speed controller's limiter takes over."""
    mean_V = np.nanmean(held.measured_V, axis=(0, 1))
    return np.flatnonzero(mean_V > cutoff_V + limits.limiter_margin_V)


def guard_V(held: HeldOut, known: Uncertainty) -> Array:
    """Guard band of the voltage [V]: expanded (k = 1.645) calibration, resolution and reading instant.

    u² = u_cal² + res²/12 + (slope · dt)²/3: nothing says that all readings were not late together.
    """
    mean_V = np.nanmean(held.measured_V, axis=(0, 1))
    slope = np.abs(np.gradient(mean_V, held.time_s))
    slope[0] = 0.0  # the first reading is at rest: its instant does not matter
    u = np.sqrt(
        (known.voltage_calibration_V or 0.0) ** 2
        + (known.voltage_resolution_V or 0.0) ** 2 / 12.0
        + (slope * (known.reading_time_s or 0.0)) ** 2 / 3.0
    )
    return np.asarray(stats.norm.ppf(0.95) * u)


def voltage_claim(held: HeldOut, limits: Limits, cutoff_V: float, known: Uncertainty) -> Claim:
    """Bias of the voltage at fixed times, under intermediate precision."""
    at = judged_instants(held, limits, cutoff_V)
    guard = guard_V(held, known)[at]
    bias, half, verdict, reason = equivalence(held.residual_V()[:, at], guard, limits.voltage_V)
    return Claim(
        "voltage bias (intermediate precision)",
        held.ambient_C, verdict, reason, True, held.time_s[at], bias, half, guard, limits.voltage_V, "V",
    )  # fmt: skip


def corridor_claim(held: HeldOut, mean_V: Array, limit_V: Array, limits: Limits, cutoff_V: float) -> Claim:
    """The study's own criterion: the model's mean curve inside x̄ ± C at every instant before the limiter."""
    at = judged_instants(held, limits, cutoff_V)
    gap = (np.nanmean(held.model_V, axis=(0, 1)) - mean_V)[at]
    inside = np.abs(gap) <= limit_V[at] + 1e-9
    verdict: Verdict = "pass" if inside.all() else "fail"
    reason = f"{int(inside.sum())} of {at.size} instants inside x̄ ± C"
    zero = np.zeros(at.size)
    return Claim(
        "inside the corridor x̄ ± C",
        held.ambient_C, verdict, reason, True, held.time_s[at], gap, limit_V[at], zero, float(np.nan), "V",
    )  # fmt: skip


def crossing_claim(held: HeldOut, limits: Limits, known: Uncertainty) -> Claim:
    """Bias of the time at which the pack falls to the crossing voltage; model and data interpolated alike."""
    occasions = range(held.measured_V.shape[0])
    level = limits.crossing_V

    def times(curves: Array) -> Array:
        return np.array(
            [[crossing_time(held.time_s, c, level) for c in curves[k] if np.isfinite(c).all()] for k in occasions]
        ).mean(axis=1)

    name = f"time of {level:.4g} V"
    with np.errstate(invalid="ignore"):
        residual = (times(held.model_V) - times(held.measured_V))[:, None]
    guard = np.array([stats.norm.ppf(0.95) * (known.reading_time_s or 0.0) / np.sqrt(3.0)])
    if not np.isfinite(residual).all():
        missing = np.full(1, np.nan)
        measured = np.isfinite(times(held.measured_V)).all()
        verdict: Verdict = "fail" if measured else "not enough data"
        reason = f"the {'model' if measured else 'record'} does not fall to {level:g} V"
        return Claim(name, held.ambient_C, verdict, reason, True, np.array([level]), missing, missing, guard,
                     limits.time_s, "s")  # fmt: skip
    bias, half, verdict, reason = equivalence(residual, guard, limits.time_s)
    return Claim(name, held.ambient_C, verdict, reason, True, np.array([level]), bias, half, guard, limits.time_s, "s")


def surface_claim(held: HeldOut, limits: Limits, known: Uncertainty) -> Claim | None:
    """Bias of the surface temperature; informs, does not gate. None when it was not measured."""
    if held.measured_C is None or held.model_C is None:
        return None
    with np.errstate(invalid="ignore"):
        gap = held.model_C - held.measured_C
    kept = np.isfinite(gap).any(axis=(0, 1))
    residual = np.nanmean(gap[:, np.isfinite(gap).all(axis=(0, 2)) if kept.all() else slice(None)], axis=1)[:, kept]
    u = np.hypot(known.temperature_calibration_C or 0.0, (known.temperature_resolution_C or 0.0) / np.sqrt(12.0))
    guard = np.full(int(kept.sum()), stats.norm.ppf(0.95) * u)
    bias, half, verdict, reason = equivalence(residual, guard, limits.surface_K)
    worst = f"largest bias {np.abs(bias).max():.2f} K; {reason}"
    return Claim("surface temperature bias", held.ambient_C, verdict, worst, False, held.time_s[kept], bias, half,
                 guard, limits.surface_K, "K")  # fmt: skip


def overall(claims: list[Claim]) -> Verdict:
    """The verdict that decides: that of the worst claim that gates."""
    verdicts = [c.verdict for c in claims if c.gates]
    if not verdicts or "fail" in verdicts:
        return "fail" if verdicts else "not enough data"
    return "not enough data" if "not enough data" in verdicts else "pass"
