"""The gate for an extended battery file: do the bench tests agree with its cells?

The gate predicts each occasion of the tests from a fit to the others. The cells of the file may differ from that fit,
because diagnosis added an effect or because the file comes from another source; then the predictions are shifted by the
difference of two open-loop simulations and judged again. Effects of the aircraft (wiring, sensors) do not change bench
tests. Tests of a new pack say nothing about the aged pack: with an effect of ageing the verdict is that data are
missing.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from uavbatt.battery.battery_file import BatteryFile, Verdict
from uavbatt.battery.model import Array, rested
from uavbatt.battery.openloop import simulate
from uavbatt.battery.scaling import cell_parameters
from uavbatt.dataset import DataSet
from uavbatt.fitting import observed
from uavbatt.validation.gating.heldout import HeldOut
from uavbatt.validation.validate import model_claims, validate

AGEING = frozenset({"capacity_fade", "resistance_growth", "weak_cell"})


def verdicts(tests: DataSet, file: BatteryFile) -> list[Verdict]:
    """Return the verdicts of the tests on the cells of `file`. Raises NotEnoughData without repeated tests."""
    if aged := sorted(AGEING.intersection(e.name for e in file.effects)):
        return [_missing(None, f"the tests are of a pack that had not aged yet: {', '.join(aged)}")]
    result = validate(tests, close_loop=False)
    ambient_C, shipped = result.ambient_C, result.battery
    claims = [c for c in result.claims if c.gates]
    if shipped is not None and not _same_cells(shipped, file):
        if not tests.is_metered:
            return [_missing(ambient_C, "the tests have no measured current to try other cells than theirs on")]
        moved = _moved(result.held, *_difference(tests, ambient_C, shipped, file))
        again = {
            c.claim: c
            for c in model_claims(result.readings, moved, result.corridors[ambient_C], result.limits)
            if c.gates
        }
        claims = [again.get(c.claim, c) for c in claims]
    return [Verdict(claim=c.claim, verdict=c.verdict, ambient_C=c.ambient_C, reason=c.reason) for c in claims]


def _same_cells(one: BatteryFile, other: BatteryFile) -> bool:
    """Return True if two files hold the same cell."""
    pairs = zip(cell_parameters(one), cell_parameters(other), strict=True)
    return all(np.array_equal(a, b) for a, b in pairs)


def _missing(ambient_C: float | None, reason: str) -> Verdict:
    return Verdict(claim="the extended model", verdict="not enough data", ambient_C=ambient_C, reason=reason)


def _difference(tests: DataSet, ambient_C: float, old: BatteryFile, new: BatteryFile) -> tuple[Array, Array]:
    """Return times [s] and the pack voltage of the new cell minus that of the old [V], mean over the repeated tests."""
    stack = observed.stack(observed.from_dataset(replace(tests, runs=tests.at(ambient_C))))
    start = rested(np.ones(stack.cells.size), stack.start_temp_C)
    rate = stack.current_A / stack.capacity_Ah
    volts = [simulate(cell_parameters(f), start, rate, stack.dt_s, stack.ambient_C).voltage_V for f in (old, new)]
    change = (volts[1] - volts[0]) * stack.cells
    return stack.time_s.mean(axis=1), change.mean(axis=1)


def _moved(held_out: HeldOut, time_s: Array, change_V: Array) -> HeldOut:
    curves = [replace(c, model_V=c.model_V + np.interp(c.time_s, time_s, change_V)) for c in held_out.curves]
    return replace(
        held_out, model_V=held_out.model_V + np.interp(held_out.time_s, time_s, change_V), curves=tuple(curves)
    )
