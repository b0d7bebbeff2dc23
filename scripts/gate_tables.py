#!/usr/bin/env python3
"""The figures of the gate in docs/validation.md: both data sets through `validate`, claims and loop over temperature.

Run: .venv/bin/python scripts/gate_tables.py    (the second set needs the shared data: UAVBATT_DATA or ../shared/data)
"""

from __future__ import annotations

import os
import sys

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from scoring import data

from uavbatt import dataset
from uavbatt.validation.validate import Validation, validate

DATA = data.place()


def claims(result: Validation) -> None:
    """Print one line a claim at the gated temperature: verdict, largest bias and half width, limit."""
    print(f"\n{result.dataset.name}: {result.verdict} at {result.ambient_C:g} °C")
    for claim in result.claims:
        if claim.ambient_C != result.ambient_C:
            continue
        figures = ""
        if claim.bias.size and np.isfinite(claim.half_width).all():
            worst = int(np.argmax(np.abs(claim.bias)))
            widest = float(np.max(claim.half_width))
            figures = f"{claim.bias[worst]:+.3f} ± {widest:.3f} of {claim.limit:g} {claim.unit}"
        print(f"  {claim.verdict:>15}  {'gates  ' if claim.gates else 'informs'}  {claim.claim}: {figures}")
    others = [c for c in result.claims if c.ambient_C != result.ambient_C]
    for verdict in ("pass", "fail", "not enough data"):
        at = [f"{c.ambient_C:g}" for c in others if c.verdict == verdict]
        if at:
            print(f"  other temperatures, {verdict}: {', '.join(at)} °C")


def loop(result: Validation) -> None:
    """Print the error before and after each effect, over temperature."""
    if result.temperatures is None:
        return
    print("\nclosing the loop over temperature")
    for gain in result.temperatures.gains:
        print(
            f"  {gain.question}, {gain.group}: "
            f"fitted {1e3 * gain.fitted_before_V:.0f} -> {1e3 * gain.fitted_after_V:.0f} mV, "
            f"held out {1e3 * gain.before_V:.0f} -> {1e3 * gain.after_V:.0f} mV, p = {gain.p_value:.3g}, "
            f"{'holds' if gain.holds else 'does not hold'}"
        )


def main() -> None:
    """Print the study's tables, then those of the simulated laboratory when it is there."""
    study = validate(dataset.load())
    claims(study)
    loop(study)
    if (DATA / "truth" / "lab").is_dir():
        claims(validate(dataset.load(DATA / "truth" / "lab")))
    else:
        print(f"{DATA}: no shared data, the laboratory set is left out", file=sys.stderr)


if __name__ == "__main__":
    main()
