#!/usr/bin/env python3
"""A further lag in the model of the battery: its error on records that the fit has not seen.

Run: .venv/bin/python scripts/second_lag.py [--only truth|m100|turnigy|enertech]
Three models are fitted to part of the data and run open loop on the rest: the model as it is (a polarisation and a slow
lag), the same with one more RC pair of 50 to 300 s, and the same with the charge that the surface of the particles
lacks (`surface_h`, which a fit leaves out). Printed is the RMSE of the voltage, slow part under load, as in a battery
file's `voltage_rmse_V`. A record that does not begin at rest starts with the charge that suits each model best.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import NamedTuple
from unittest import mock

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from diagnose_cases_measured import (
    DATA,
    M100_AH,
    M100_CELLS,
    enertech_records,
    m100_flights,
    turnigy_records,
)

from uavbatt import dataset
from uavbatt.battery import equations as eq
from uavbatt.battery import model
from uavbatt.battery.effects import EFFECTS, Effect, Quantity
from uavbatt.battery.model import Array
from uavbatt.battery.openloop import Trajectory
from uavbatt.fitting import observed, prior, solve
from uavbatt.fitting.observed import ObservedRecord, Stack, from_flight
from uavbatt.fitting.prior import Slot
from uavbatt.fitting.solve import BatteryFit, OwnPrior
from uavbatt.telemetry import read_log

TRUTH, TRUTH_CELLS, TRUTH_AH = DATA / "truth", 4, 5.016
HELD_OUT = ("practice/p1", "blind/b3", "cases/k01", "cases/k02")  # nothing is wrong there
STARTS = np.linspace(-0.08, 0.08, 17)
SECOND = Effect(
    "second_lag",
    "a further RC pair",
    "installation",  # it is worked out here, not in the cell
    (
        Quantity("second_ratio", "1", 0.0, 0.0, 20.0, 0.3, 1.0, log=True),
        Quantity("second_tau_s", "s", 150.0, 50.0, 300.0, 120.0, 0.4, log=True),
    ),
)


class Part(NamedTuple):
    """A Part holds records to fit, how free each is, the effects that are fitted, and the records kept back."""

    name: str
    fitted: list[ObservedRecord]
    own: list[OwnPrior]
    effects: tuple[str, ...]
    kept: list[ObservedRecord]


def run_with_second(
    stack: Stack, slots: tuple[Slot, ...], effects: tuple[str, ...], x: Array, own: Array
) -> Trajectory:
    """Run `solve.run` with a further RC pair on top: v' = (c R k - v)/tau."""
    shown = RUN(stack, slots, effects, x, own)
    at = {s.name: i for i, s in enumerate(slots)}
    each = np.repeat(x, own.shape[1], axis=0)
    cell = prior.cell(slots, each, effects)._replace(resistance_gain=np.exp(own[..., 1].ravel()))
    rate = np.tile(stack.current_A, len(x)) / (np.tile(stack.capacity_Ah, len(x)) * np.exp(own[..., 2].ravel()))
    lag_V, volts = np.zeros(rate.shape[1]), shown.voltage_V.copy()
    for k in range(1, len(rate)):
        drop_V = rate[k] * model.resistance(cell, shown.soc[k], shown.core_C[k]) * each[:, at["second_ratio"]]
        lag_V = eq.relax(lag_V, drop_V, np.tile(stack.dt_s[k], len(x)), each[:, at["second_tau_s"]])
        volts[k] -= lag_V
    return shown._replace(voltage_V=volts)


RUN = solve.run


@contextmanager
def second_lag() -> Iterator[tuple[str, ...]]:
    """Let fits in the block have a further RC pair; yield the effects that they need besides."""
    with mock.patch.dict(EFFECTS, {SECOND.name: SECOND}), mock.patch.object(solve, "run", run_with_second):
        yield (SECOND.name,)


@contextmanager
def surface_charge() -> Iterator[tuple[str, ...]]:
    """Let the surface of the particles lack charge in the fits of the block; no further effect is yielded."""
    old = EFFECTS["slow_diffusion"]
    free = tuple(replace(q, fitted=True) for q in old.quantities)
    with mock.patch.dict(EFFECTS, {old.name: replace(old, quantities=free)}):
        yield ()


@contextmanager
def as_it_is() -> Iterator[tuple[str, ...]]:
    """Change nothing: fits are as `uavbatt fit` makes them; no further effect is yielded."""
    yield ()


def left_V(part: Part, found: BatteryFit) -> float:
    """Return the size of what the model leaves on the records kept back [V]."""
    stack = observed.stack(part.kept)
    guess = np.where(stack.rested, 1.0, np.clip(solve.start_guess(stack), 0.1, 1.0))
    tried = [np.where(stack.rested, 1.0, np.minimum(guess + d, 1.0)) for d in STARTS]
    each = [[_size_V(stack, shown, j) for j in range(len(part.kept))] for shown in _shown(stack, found, tried)]
    return float(np.sqrt(np.mean(np.min(each, axis=0) ** 2)))


def _shown(stack: Stack, found: BatteryFit, starts: list[Array]) -> Iterator[Trajectory]:
    for start in starts:
        yield solve.replay_fit(stack, found, np.column_stack([start, np.zeros((len(start), 2))]))


def _size_V(stack: Stack, shown: Trajectory, j: int) -> float:
    rows = stack.compare[:, j] & (np.abs(stack.current_A[:, j]) > 0.3 * stack.capacity_Ah[j])
    flat = np.min(stack.sigma_V[rows, j]) / stack.sigma_V[rows, j]
    error = (shown.voltage_V[rows, j] * stack.cells[j] - stack.voltage_V[rows, j]) * flat
    return float(np.sqrt(max(float(np.mean(error[:-1] * error[1:])), 0.0)))


def truth() -> Iterator[Part]:
    """Yield one part: bench tests and four flights of the porous-electrode pack; healthy flights kept back."""
    bench = observed.from_dataset(dataset.load(TRUTH / "lab"), TRUTH_AH)

    def flights(name: str) -> list[ObservedRecord]:
        return [from_flight(read_log(p), TRUTH_CELLS, TRUTH_AH) for p in sorted((TRUTH / name).glob("*.tlog"))]

    own = [solve.SAMPLES] * len(bench) + [OwnPrior()] * 4
    effects = (*prior.BASE_EFFECTS, "charge_transfer")
    kept = [r for name in HELD_OUT for r in flights(name)]
    yield Part("truth: lab and r0; p1, b3, k01, k02 kept back", bench + flights("reference/r0"), own, effects, kept)


def m100() -> Iterator[Part]:
    """Yield three parts: two aircraft teach the battery, the third is kept back."""
    flights = {name: [from_flight(f, M100_CELLS, M100_AH) for f in flown] for name, flown in m100_flights().items()}
    for aircraft, mine in flights.items():
        others = [r for name, flown in flights.items() if name != aircraft for r in flown]
        own = [solve.ALIKE] * len(others)
        yield Part(f"M100: {aircraft} kept back", others, own, prior.BASE_EFFECTS, mine)


def turnigy() -> Iterator[Part]:
    """Yield one part: two pieces of the drive cycle to fit, the two others kept back."""
    one, two, three, four = turnigy_records()
    own = [solve.ALIKE] * 2
    yield Part("Turnigy: pieces 2 and 4 kept back", [one, three], own, prior.BASE_EFFECTS, [two, four])


def enertech() -> Iterator[Part]:
    """Yield one part: two discharges to fit, the fastest kept back."""
    slow, half, full = enertech_records(("0.1", "0.5", "1"))
    yield Part("Enertech: 1 C kept back", [slow, half], [OwnPrior()] * 2, prior.BASE_EFFECTS, [full])


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=("truth", "m100", "turnigy", "enertech"))
    only = parser.parse_args().only
    print("| data | as it is [mV] | one more RC pair | surface charge |\n|---|---|---|---|")
    for parts in (truth, m100, turnigy, enertech):
        for part in parts() if only in (None, parts.__name__) else ():
            cells = [f"{part.name}"]
            for variant in (as_it_is, second_lag, surface_charge):
                with variant() as more:
                    stack, effects = observed.stack(part.fitted), (*part.effects, *more)
                    found = solve.fit_battery(stack, effects, own_prior=part.own, evaluations=60)
                    told = ""
                    if variant is second_lag:
                        told = f" ({found.value('second_ratio'):.2f} of R0, {found.value('second_tau_s'):.0f} s)"
                    if variant is surface_charge:
                        told = f" ({found.value('surface_h'):.4f} h)"
                    cells.append(f"{1000.0 * left_V(part, found):.1f}{told}")
            print(f"| {' | '.join(cells)} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
