"""Claims at temperatures that are not gated: a run alone, and repeats, which are one claim and not one a run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from uavbatt import dataset
from uavbatt.dataset import DataSet, Run
from uavbatt.validation.gating.ambient_claims import ambient_claims
from uavbatt.validation.gating.gate import Limits
from uavbatt.validation.gating.heldout import HeldOut, HeldOutRun
from uavbatt.validation.judging.readings import Readings, read_once

TIME_S = np.arange(0.0, 300.0, 60.0)
VOLTS = np.linspace(12.4, 10.9, TIME_S.size)


def repeated(*ambients_C: float) -> DataSet:
    """One sample, tested three times at each temperature."""
    study = dataset.load()
    runs = tuple(
        replace(study.runs[0], sample="A", run=k + 1, ambient_C=ambient_C, time_s=TIME_S, voltage_V=VOLTS + 0.01 * k,
                current_A=np.full(TIME_S.size, np.nan), surface_C=np.full(TIME_S.size, np.nan))
        for ambient_C in ambients_C for k in range(3)
    )  # fmt: skip
    return replace(study, runs=runs, flags=())


def held_out(readings: Readings) -> HeldOut:
    """A model that is 50 mV too high at every other temperature."""
    others: list[Run] = [r for r in readings.dataset.runs if r.ambient_C != readings.ambient_C]
    singles = tuple(HeldOutRun(r.ambient_C, r.sample, r.time_s, r.voltage_V, r.voltage_V + 0.05) for r in others)
    home = np.array([[r.voltage_V] for r in readings.dataset.at(readings.ambient_C)])
    return HeldOut("circuit", readings.ambient_C, 3, TIME_S, home, home, singles=singles)


@pytest.mark.parametrize(("ambients_C", "gated_C"), [((0.0, 25.0), 25.0), ((40.0, 20.0, -10.0), 20.0)])
def test_of_several_repeated_temperatures_the_nearest_to_25_degrees_is_gated(
    ambients_C: tuple[float, ...], gated_C: float
) -> None:
    assert read_once(repeated(*ambients_C)).ambient_C == gated_C


def test_the_most_repeated_temperature_goes_before_the_nearest() -> None:
    tests = repeated(0.0, 25.0)
    assert read_once(replace(tests, runs=tests.runs[:-1])).ambient_C == 0.0


def test_repeats_at_another_temperature_are_one_claim_without_a_verdict() -> None:
    readings = read_once(repeated(0.0, 25.0))
    (claim,) = ambient_claims(readings, held_out(readings), Limits())
    assert (claim.ambient_C, claim.verdict, claim.gates) == (0.0, "not enough data", False)
    assert claim.bias == pytest.approx(0.05) and claim.reason.startswith("3 runs; of the repeated temperatures one")


def test_a_run_alone_says_that_it_is_alone() -> None:
    tests = repeated(0.0, 25.0)
    readings = read_once(replace(tests, runs=tests.runs[2:]))
    (claim,) = ambient_claims(readings, held_out(readings), Limits())
    assert claim.reason.startswith("one run: nothing tells its dispersion")
