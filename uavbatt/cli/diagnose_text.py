"""The result of `uavbatt diagnose` as lines of text and as JSON."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from uavbatt.diagnosis.close import ClosedLoop
    from uavbatt.diagnosis.diagnosis import Diagnosis


def lines(found: Diagnosis, closed: ClosedLoop) -> list[str]:
    """Return the diagnosis, and the errors before and after it, as lines of text."""
    from uavbatt.diagnosis.words import GUESS

    made = [_verdict_line(found)]
    if found.may_hide:
        made.append("  if a small effect is missing nevertheless, it is most likely this one:")
    made += _class_lines(found)
    made += [f"  doubt: {reason}" for reason in found.reasons]
    made += _evidence_lines(found)
    if not found.problem.evidence.has_temperature:
        made.append("  no temperature: only clear effects are told, and none that shows only in it")
    if found.guess_below_soc is not None:
        made.append(f"  {GUESS.format(found.guess_below_soc)}")
    return made + _held_out_lines(closed)


def _verdict_line(found: Diagnosis) -> str:
    several = len(found.classes) > 1
    said = {
        "no_missing_effect": "nothing is missing: the residual is no larger than this model's known error",
        "effect_found": f"{len(found.classes)} effects are missing together" if several else "an effect is missing",
        "undeclared_effect": "something is missing that no candidate explains",
    }
    return f"{found.verdict}: {said[found.verdict]}"


def _class_lines(found: Diagnosis) -> list[str]:
    """Return each class of effects that no record tells apart: its size, and the check that would."""
    from uavbatt.battery.effects import unit_words
    from uavbatt.diagnosis.words import MEANING

    made: list[str] = []
    for one in found.classes:
        made.append(f"  {' or '.join(one.members)} (probability {one.probability:.2f}): {MEANING[one.members[0]]}")
        for name, i in one.parameters.items():
            made.append(f"    {name} = {i.value:.4g} [{i.lo:.4g}, {i.hi:.4g}] {unit_words(i.unit)}".rstrip())
        made.append(f"    check: {one.would_separate}")
    return made


def _evidence_lines(found: Diagnosis) -> list[str]:
    """Return where the evidence comes from, and which sizes of effects could be hidden in the records."""
    from uavbatt.battery.effects import unit_words

    made: list[str] = []
    if found.blocks:
        told = ", ".join(f"{b.name} {b.saved:.0f}" for b in found.blocks)
        made.append(f"  evidence (chi-square saved): {told}")
    if found.hidden:
        made.append("  sizes that could be hidden in these records (95 %):")
    for h in found.hidden:
        made.append(f"    {h.name}: {h.quantity} {h.lo:.3g} to {h.hi:.3g} {unit_words(h.unit)}".rstrip())
    return made


def _held_out_lines(closed: ClosedLoop) -> list[str]:
    """Return the errors on held-out records before and after, and a warning if they are worse after."""
    b, a = closed.before, closed.after
    made = [
        f"  held out: voltage RMSE {1000 * b.voltage_rmse_V:.0f} -> {1000 * a.voltage_rmse_V:.0f} mV, remaining time "
        f"MAE {_number(b.remaining_mae_s)} -> {_number(a.remaining_mae_s)} s"
    ]
    if closed.worse:
        made.append(f"  held-out records are predicted worse with it ({closed.worse}): do the check before you use it")
    return made


def _number(value: float) -> str:
    return f"{value:.0f}" if math.isfinite(value) else "unknown"


def as_json(found: Diagnosis, closed: ClosedLoop, status: str, path: str | None) -> dict[str, Any]:
    """Return the diagnosis for JSON, in which NaN becomes null."""
    from dataclasses import asdict

    return {
        "verdict": found.verdict,
        "classes": [asdict(c) for c in found.classes],
        "reasons": list(found.reasons),
        "before": asdict(closed.before),
        "after": asdict(closed.after),
        "held_out": list(closed.held_out),
        "left": asdict(found.left),
        "evidence": {b.name: b.saved for b in found.blocks},
        "hidden": [asdict(h) for h in found.hidden],
        "certificate_status": status,
        "battery_file": path,
    }
