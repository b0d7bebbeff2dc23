"""The gate decides if the model is equivalent to the tests, within limits declared for flight safety.

Two one-sided tests per instant: the interval of the bias (model minus mean of the held-out occasions) must lie inside
±limit. It is simultaneous over the instants and holds both the scatter of the occasions and what that scatter cannot
show of instruments and drift (`budget`).

    pass             the whole interval is inside ±limit at every instant
    fail             the bias itself is beyond the limit somewhere
    not enough data  neither, or too few occasions

"Not significantly different" is never a pass: noisier tests must make the gate harder, not easier. So the study's
own criterion, the model inside x̄ ± C, decides only by the method `paper`: the wider the tests scatter the easier it
is, and with many instants few genuine tests meet it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from uavbatt.battery.model import Array
from uavbatt.dataset import Uncertainty
from uavbatt.validation.gating import budget as budgets
from uavbatt.validation.gating.budget import Budget
from uavbatt.validation.gating.heldout import Curve, HeldOut, known_mean
from uavbatt.validation.judging.corridor import LEAST_OCCASIONS
from uavbatt.validation.judging.crossing import crossing_time
from uavbatt.validation.judging.series import KNEE_CELL_V

Verdict = Literal["pass", "fail", "not enough data"]
Method = Literal["iso", "paper"]


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits holds the flight-safety limits, declared before any data are seen; volts for a 3S pack, scaled by cells.

    `precision_A_r`, `precision_A_R`: how well s_r and s_R must be known, relative, 95 % (A_r, A_R of ISO 5725-1).
    """

    voltage_V: float = 0.15
    time_s: float = 10.0
    surface_K: float = 2.0
    crossing_V: float = 10.0
    limiter_margin_V: float = 0.1
    precision_A_r: float = 0.5
    precision_A_R: float = 1.0

    def for_cells(self, cells: int) -> Limits:
        """Scale the limits in volts to a pack of `cells` in series."""
        share = cells / 3.0
        return Limits(
            voltage_V=self.voltage_V * share,
            time_s=self.time_s,
            surface_K=self.surface_K,
            crossing_V=self.crossing_V * share,
            limiter_margin_V=self.limiter_margin_V * share,
            precision_A_r=self.precision_A_r,
            precision_A_R=self.precision_A_R,
        )


@dataclass(frozen=True, slots=True)
class Claim:
    """A claim is one verdict with what it rests on. `gates`: without a pass here the model does not ship."""

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
    budget: Budget | None = None
    statistics: Mapping[str, float] = field(default_factory=dict)


def claim_without_bias(
    claim: str,
    ambient_C: float,
    reason: str,
    statistics: Mapping[str, float] | None = None,
    *,
    verdict: Verdict = "not enough data",
    gates: bool = False,
    limit: float = np.nan,
    unit: str = "",
) -> Claim:
    """Make a claim that rests on no bias, with the reason: unless said else, one that cannot be judged."""
    empty = np.empty(0)
    return Claim(claim, ambient_C, verdict, reason, gates, empty, empty, empty, empty, limit, unit,
                 statistics=statistics or {})  # fmt: skip


def decide(bias: Array, half: Array, limit: float) -> tuple[Verdict, str]:
    """Return verdict and reason for biases with the half widths of their intervals against ±`limit`.

    All three are in the unit of the claim; `bias` and `half` per instant.
    """
    instants = bias.size
    beyond = np.abs(bias) > limit
    if not instants:
        return "not enough data", "no instant can be judged"
    if beyond.any():
        worst = float(bias[np.argmax(np.abs(bias))])
        return "fail", f"bias {worst:+.3g} beyond ±{limit:g} at {int(beyond.sum())} of {instants}"
    if (np.abs(bias) + half <= limit).all():
        return "pass", f"the interval of the bias is inside ±{limit:g} at all {instants}"
    open_ = int(np.sum(~(np.abs(bias) + half <= limit)))
    return "not enough data", f"the bias is inside ±{limit:g} but its interval is not, at {open_} of {instants}"


def judged_instants(held_out: HeldOut, limits: Limits, cutoff_V: float) -> NDArray[np.intp]:
    """Return the indices of the instants at which the mean of the tests is judged.

    They come before the limiter (`before_limiter`), and the model predicts at least one run there.
    """
    before = before_limiter(held_out.mean_V, limits, cutoff_V)
    return before[np.isfinite(held_out.model_V[:, :, before]).any(axis=(0, 1))]


def before_limiter(voltage_V: Array, limits: Limits, cutoff_V: float) -> NDArray[np.intp]:
    """Return the indices of the instants before the speed controller's limiter takes over.

    voltage_V : [instant]; a pack that recovers after it fell so far, unloaded, is not judged again.
    """
    reached = np.logical_or.accumulate(voltage_V <= cutoff_V + limits.limiter_margin_V)
    return np.flatnonzero(~reached & np.isfinite(voltage_V))


def complete(residual: Array) -> Array:
    """Keep the occasions whose residual is known at every instant."""
    rows: Array = residual[np.isfinite(residual).all(axis=1)]
    return rows


def _too_few(occasions: int, which: str = "") -> str:
    return f"{occasions} occasions{which}, at least {LEAST_OCCASIONS} are needed"


def voltage_claim(held_out: HeldOut, limits: Limits, cutoff_V: float, instruments: Uncertainty) -> Claim:
    """Judge the bias of the voltage at fixed times, under intermediate precision."""
    name = "voltage bias (intermediate precision)"
    at = judged_instants(held_out, limits, cutoff_V)
    residual = complete(held_out.residual_V()[:, at])
    if len(residual) < LEAST_OCCASIONS:
        return claim_without_bias(name, held_out.ambient_C, _too_few(len(residual)), gates=True)
    b = budgets.voltage_budget(held_out, at, residual, instruments)
    bias, half = residual.mean(axis=0), b.expanded
    verdict, reason = decide(bias, half, limits.voltage_V)
    return Claim(name, held_out.ambient_C, verdict, reason, True, b.at, bias, half, b.guard, limits.voltage_V, "V", b)


def corridor_claim(
    held_out: HeldOut, mean_V: Array, limit_V: Array, limits: Limits, cutoff_V: float, gates: bool = False
) -> Claim:
    """Judge by the study's own criterion: the model's mean curve inside x̄ ± C at every instant before the limiter."""
    at = judged_instants(held_out, limits, cutoff_V)
    gap = (known_mean(held_out.model_V, axis=(0, 1)) - mean_V)[at]
    inside = np.abs(gap) <= limit_V[at] + 1e-9
    verdict: Verdict = "pass" if inside.all() else "fail"
    reason = f"{int(inside.sum())} of {at.size} instants inside x̄ ± C"
    zero = np.zeros(at.size)
    return Claim(
        "inside the corridor x̄ ± C",
        held_out.ambient_C, verdict, reason, gates, held_out.time_s[at], gap, limit_V[at], zero, float(np.nan), "V",
    )  # fmt: skip


def crossing_claim(held_out: HeldOut, limits: Limits, instruments: Uncertainty) -> Claim:
    """Judge the bias of the time at which the pack falls to the crossing voltage; model and data read alike."""
    level = limits.crossing_V
    return _timed(f"time of {level:.4g} V", held_out, np.array([level]), limits, instruments)


def knee_claim(held_out: HeldOut, limits: Limits, cutoff_V: float, instruments: Uncertainty) -> Claim:
    """Judge the bias of the time of the knee: the mean crossing of eight voltages just above the cut-off (`series`)."""
    return _timed("time of the knee", held_out, cutoff_V + held_out.cells * KNEE_CELL_V, limits, instruments)


def _crossings(time_s: Array, voltage_V: Array, levels_V: Array) -> Array:
    return np.array([crossing_time(time_s, voltage_V, float(v), "held") for v in levels_V])


def _timed(name: str, held_out: HeldOut, levels_V: Array, limits: Limits, instruments: Uncertainty) -> Claim:
    """Make the claim about a crossing time.

    Where a model never falls through, it is late by the rest of that record at least: with that bias the claim may
    fail, but never pass.
    """
    at = np.array([float(np.mean(levels_V))])
    runs = [c for c in held_out.runs() if np.isfinite(c.measured_V).all()]
    measured = np.array([_crossings(c.time_s, c.measured_V, levels_V) for c in runs]).reshape(-1, levels_V.size)
    ends = np.array([c.time_s[-1] for c in runs])
    model = np.array([_crossings(c.time_s, c.model_V, levels_V) for c in runs]).reshape(measured.shape)
    late = np.isnan(model) & np.isfinite(measured)
    model = np.where(np.isnan(model), ends[:, None], model)
    reached = np.isfinite(measured).all(axis=1)
    residual = _by_occasion(runs, (model - measured).mean(axis=1), reached)
    if len(residual) < LEAST_OCCASIONS:
        reason = _too_few(len(residual), f" fall to {at[0]:.4g} V")
        return claim_without_bias(name, held_out.ambient_C, reason, gates=True, limit=limits.time_s, unit="s")
    b = budgets.time_budget(held_out, levels_V, residual, _slope(runs, levels_V), instruments)
    bias, half = residual.mean(axis=0), b.expanded
    verdict, reason = decide(bias, half, limits.time_s)
    if late.any() and verdict != "fail":
        verdict = "not enough data"
        reason = (
            f"the records end before the model falls that far in {late.sum()} of {model.size} crossings: discharge "
            f"further, or read more often"
        )
    return Claim(name, held_out.ambient_C, verdict, reason, True, at, bias, half, b.guard, limits.time_s, "s", b)


def _by_occasion(runs: list[Curve], values: Array, usable: NDArray[np.bool_]) -> Array:
    """Return means over the samples of each occasion, [occasion, 1], in run order."""
    occasions = sorted({c.occasion for c, k in zip(runs, usable, strict=True) if k})
    of = np.array([c.occasion for c in runs])
    return np.array([[float(np.mean(values[usable & (of == o)]))] for o in occasions]).reshape(-1, 1)


def _slope(runs: list[Curve], levels_V: Array) -> float:
    """Return the median fall of the records at the middle of `levels_V` [V/s], which turns volts into seconds."""
    middle = float(np.mean(levels_V))
    half = max(float(np.ptp(levels_V)) / 2.0, 0.02 * middle)  # for one level ±2 %, some steps of any meter
    falls = []
    for c in runs:
        high, low = _crossings(c.time_s, c.measured_V, np.array([middle + half, middle - half]))
        if low > high:
            falls.append(2.0 * half / (low - high))
        else:
            i = int(np.argmin(np.abs(c.measured_V - middle)))
            falls.append(float(np.abs(np.gradient(c.measured_V, c.time_s))[i]))
    return max(float(np.median(falls)), 1e-6)


def surface_claim(held_out: HeldOut, limits: Limits, instruments: Uncertainty) -> Claim | None:
    """Judge the bias of the surface temperature; it informs, does not gate. Returns None when it was not measured."""
    if held_out.measured_C is None or held_out.model_C is None:
        return None
    name = "surface temperature bias"
    gap = held_out.model_C - held_out.measured_C
    instants = np.isfinite(gap).any(axis=(0, 1))
    samples = np.isfinite(gap[:, :, instants]).any(axis=(0, 2))
    residual = complete(gap[:, samples][:, :, instants].mean(axis=1))
    if len(residual) < LEAST_OCCASIONS or not instants.any():
        return claim_without_bias(name, held_out.ambient_C, _too_few(len(residual)))
    b = budgets.surface_budget(held_out.time_s[instants], residual, instruments)
    bias, half = residual.mean(axis=0), b.expanded
    verdict, reason = decide(bias, half, limits.surface_K)
    worst = f"largest bias {np.abs(bias).max():.2f} K; {reason}"
    return Claim(name, held_out.ambient_C, verdict, worst, False, b.at, bias, half, b.guard, limits.surface_K, "K", b)


def equivalence_claims(held_out: HeldOut, limits: Limits, cutoff_V: float, instruments: Uncertainty) -> list[Claim]:
    """List the claims of equivalence: the voltage, the times, and the surface temperature if it was measured."""
    surface = surface_claim(held_out, limits, instruments)
    return [
        voltage_claim(held_out, limits, cutoff_V, instruments),
        crossing_claim(held_out, limits, instruments),
        knee_claim(held_out, limits, cutoff_V, instruments),
        *([] if surface is None else [surface]),
    ]


def overall(claims: Sequence[Claim]) -> Verdict:
    """Return the verdict that decides: that of the worst claim that gates."""
    verdicts = [c.verdict for c in claims if c.gates]
    if not verdicts or "fail" in verdicts:
        return "fail" if verdicts else "not enough data"
    return "not enough data" if "not enough data" in verdicts else "pass"
