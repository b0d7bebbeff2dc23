"""Claims at temperatures that are not gated: a run alone, and repeats, which are one claim and not one a run."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import linregress

from uavbatt import dataset
from uavbatt.dataset import DataSet, Run
from uavbatt.validation.gating.ambient_claims import ambient_claims
from uavbatt.validation.gating.budget import ONE_SIDED, expand
from uavbatt.validation.gating.gate import Limits
from uavbatt.validation.gating.heldout import HeldOut, HeldOutRun
from uavbatt.validation.judging.readings import Readings, read_once

TIME_S = np.arange(0.0, 300.0, 60.0)
VOLTS = np.linspace(12.4, 10.9, TIME_S.size)
SCATTER_V = (0.0, 0.01, -0.01, 0.0, -0.01, 0.01)  # of six runs a degree apart


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
    assert claim.at.size == TIME_S.size  # no mean of the runs is near the limiter


def test_repeats_are_compared_until_their_mean_reaches_the_limiter() -> None:
    tests = repeated(0.0, 25.0)
    readings = read_once(replace(tests, cutoff_V=float(VOLTS[3]) - Limits().limiter_margin_V + 0.005))
    (claim,) = ambient_claims(readings, held_out(readings), Limits())
    assert claim.at.tolist() == TIME_S[:4].tolist()  # the lowest of three runs alone is there an instant before


def test_a_run_alone_says_that_it_is_alone() -> None:
    tests = repeated(0.0, 25.0)
    readings = read_once(replace(tests, runs=tests.runs[2:]))
    (claim,) = ambient_claims(readings, held_out(readings), Limits())
    assert claim.reason.startswith("one run: nothing tells its dispersion")


def near_repeats(*, home: tuple[int, ...]) -> Readings:
    """Six runs of sample B a degree apart, three of A at 25 °C, and the runs `home` of B there, 0.1 V lower."""
    tests = repeated(25.0)
    line = [replace(tests.runs[0], sample="B", run=1, ambient_C=float(t), voltage_V=VOLTS + SCATTER_V[t])
            for t in range(6)]  # fmt: skip
    own = [replace(tests.runs[0], sample="B", run=run, voltage_V=VOLTS - 0.1) for run in home]
    return read_once(replace(tests, runs=(*tests.runs, *line, *own)))


@pytest.mark.parametrize(("home", "offset_V"), [((1,), 0.11), ((1, 2, 3), 0.0)])
def test_the_distance_of_a_series_from_the_repeats_widens_its_guard_band(
    home: tuple[int, ...], offset_V: float
) -> None:
    """A sample that was itself repeated has no distance. Beside it stand the meter's 20 mV and its step of 10 mV."""
    readings = near_repeats(home=home)
    model = replace(held_out(readings), measured_V=np.array([[VOLTS + 0.01]]), model_V=np.array([[VOLTS]]))
    claim = next(c for c in ambient_claims(readings, model, Limits()) if c.ambient_C == 3.0)
    meters_V = np.sqrt(claim.guard**2 - (ONE_SIDED * offset_V) ** 2 / 3.0)
    assert claim.reason.startswith("6 one-time runs") and np.isfinite(claim.half_width).all()
    assert meters_V == pytest.approx(ONE_SIDED * math.hypot(0.02, 0.01 / math.sqrt(12.0)), rel=1e-6)


def test_the_scatter_about_the_line_is_that_of_a_regression() -> None:
    """At 0 °C, the end of the line, its mean is known less well than at 3 °C."""
    readings = near_repeats(home=(1, 2, 3))
    claims = {c.ambient_C: c for c in ambient_claims(readings, held_out(readings), Limits())}
    t, centre_C = np.arange(6.0), 2.5
    line = linregress(t, SCATTER_V)
    sd_V = float(np.sqrt(np.sum((np.array(SCATTER_V) - line.intercept - line.slope * t) ** 2) / 4))
    for ambient_C in (0.0, 3.0):
        claim = claims[ambient_C]
        mean_sd_V = sd_V * math.sqrt(1 / 6 + (ambient_C - centre_C) ** 2 / np.sum((t - centre_C) ** 2))
        expected_V = expand(np.full(TIME_S.size, mean_sd_V), 4.0, claim.guard / ONE_SIDED, TIME_S.size).half
        assert claim.half_width == pytest.approx(expected_V, rel=1e-6)
    assert (claims[0.0].half_width > claims[3.0].half_width).all()


def test_a_series_without_a_test_beside_the_repeats_has_no_interval() -> None:
    readings = near_repeats(home=())
    claim = next(c for c in ambient_claims(readings, held_out(readings), Limits()) if c.ambient_C == 3.0)
    assert claim.verdict == "not enough data" and np.isnan(claim.half_width).all()
