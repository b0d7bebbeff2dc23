#!/usr/bin/env python3
"""Effects without a name, planted into effect-free flights of the simulated truth: are they said to have none?

Run: .venv/bin/python scripts/diagnose_cases_unnamed.py [BATTERY.battery.toml] [--only WORD]
Needs the shared data (UAVBATT_DATA or ../shared/data). Without a battery file it fits the one of the truth first.
Right is `undeclared_effect`, or no name with a probability of 0.4 and more. Prints what was told and the first reason.
"""

from __future__ import annotations

import os
import sys
from collections import Counter
from dataclasses import replace

os.environ.setdefault("OMP_NUM_THREADS", "1")

import diagnose_cases_inject as plant
import numpy as np
from diagnose_cases_inject import CAPACITY_AH, Array, Change, Flown
from diagnose_cases_kept import asked_for, pools, run

DOUBTFUL = 0.4


def course(f: Flown) -> Array:
    """Return the share of the record that has passed at each row."""
    out: Array = (f.time_s - f.time_s[0]) / (f.time_s[-1] - f.time_s[0])
    return out


def gain_grows(size: float) -> Change:
    """Return a change: the gain of the current sensor goes from 1 to 1 + `size`."""
    return lambda f: replace(f, current_A=f.current_A * (1.0 + size * course(f)))


def gain_steps(size: float) -> Change:
    """Return a change: the gain of the current sensor is 1 + `size` in the second half."""
    return lambda f: replace(f, current_A=f.current_A * (1.0 + size * (course(f) > 0.5)))


def gain_with_load(size: float) -> Change:
    """Return a change: the gain of the current sensor grows by `size` for each mean current above the mean."""
    return lambda f: replace(f, current_A=f.current_A * (1.0 + size * (f.current_A / np.mean(f.current_A) - 1.0)))


def offset_grows(size_A: float) -> Change:
    """Return a change: the offset of the current sensor goes from 0 to `size_A` [A]."""
    return lambda f: replace(f, current_A=np.maximum(f.current_A + size_A * course(f), 0.0))


def current_filtered(tau_s: float) -> Change:
    """Return a change: the current is read behind a filter of `tau_s` [s]."""
    return lambda f: replace(f, current_A=plant.follow(f.current_A, f.time_s, tau_s, float(f.current_A[0])))


def voltage_filtered(tau_s: float) -> Change:
    """Return a change: the voltage is read behind a filter of `tau_s` [s]."""
    return lambda f: replace(f, voltage_V=plant.follow(f.voltage_V, f.time_s, tau_s, float(f.voltage_V[0])))


def voltage_gain_grows(size: float) -> Change:
    """Return a change: the gain of the voltage sensor goes from 1 to 1 + `size`."""
    return lambda f: replace(f, voltage_V=f.voltage_V * (1.0 + size * course(f)))


def voltage_creeps(size_V: float) -> Change:
    """Return a change: the offset of the voltage sensor goes from 0 to `size_V` [V]."""
    return lambda f: replace(f, voltage_V=f.voltage_V + size_V * course(f))


def voltage_steps(size_V: float) -> Change:
    """Return a change: the offset of the voltage sensor is `size_V` [V] in the second half."""
    return lambda f: replace(f, voltage_V=f.voltage_V + size_V * (course(f) > 0.5))


def lead_grows(size_ohm: float) -> Change:
    """Return a change: the resistance of a lead goes from 0 to `size_ohm` [ohm]."""
    return lambda f: replace(f, voltage_V=f.voltage_V - f.true_A * size_ohm * course(f))


def contact_opens(size_ohm: float) -> Change:
    """Return a change: a contact has `size_ohm` [ohm] in the last third."""
    return lambda f: replace(f, voltage_V=f.voltage_V - f.true_A * size_ohm * (course(f) > 0.67))


def lead_warms(size_ohm: float) -> Change:
    """Return a change: a lead has `size_ohm` [ohm] once it is warm, in proportion to its heat of the last minutes."""

    def warmed(f: Flown) -> Flown:
        heat = plant.follow(f.true_A**2, f.time_s, 120.0, 0.0) / np.mean(f.true_A) ** 2
        return replace(f, voltage_V=f.voltage_V - f.true_A * size_ohm * heat)

    return warmed


def leaks(size_A: float) -> Change:
    """Return a change: the cells lose `size_A` [A] inside, which no sensor sees."""
    return plant.lower_charge(lambda f: f.true_soc - size_A * (f.time_s - f.time_s[0]) / 3600.0 / CAPACITY_AH)


def leaks_late(share: float) -> Change:
    """Return a change: the cells lose a `share` of their charge inside, more and more."""
    return plant.lower_charge(lambda f: f.true_soc - share * course(f) ** 2)


def temperature_creeps(size_K: float) -> Change:
    """Return a change: the offset of the temperature sensor goes from 0 to `size_K` [K]."""
    return lambda f: replace(f, temp_C=f.temp_C + size_K * course(f))


CASES = (
    (gain_grows, 0.15), (gain_grows, 0.06), (gain_grows, -0.06), (gain_steps, 0.15), (gain_with_load, 0.25),
    (offset_grows, 1.5), (current_filtered, 3.0), (voltage_filtered, 3.0), (voltage_gain_grows, 0.02),
    (voltage_creeps, -0.2), (voltage_steps, -0.25), (lead_grows, 0.012), (contact_opens, 0.015), (lead_warms, 0.008),
    (leaks, 1.5), (leaks_late, 0.08), (temperature_creeps, 8.0),
)  # fmt: skip


def main() -> int:
    """Print the table."""
    battery, only = asked_for(__doc__ or "")
    pool, verdicts, sure = pools(battery), Counter[str](), 0
    print("| planted | flights | diagnosis | first reason |\n|---|---|---|---|")
    for change, size in CASES:
        for name in ("p1", "r0") if only in change.__name__ else ():
            found = run(pool[name], change(size), battery)
            told = " + ".join(f"{'/'.join(c.members)} {c.probability:.2f}" for c in found.classes) or "–"
            print(
                f"| {change.__name__} {size:g} | {name} | {found.verdict}: {told} | {(*found.reasons, '–')[0]} |",
                flush=True,
            )
            verdicts[found.verdict] += 1
            sure += found.verdict == "effect_found" and max(c.probability for c in found.classes) >= DOUBTFUL
    print(f"\n{dict(verdicts)}; named with {DOUBTFUL:g} and more: {sure} of {verdicts.total()}.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
