"""Evidence of a flight: what is taken out of a belief, and what a rest adds, are those of Gaussians that are joined."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uavbatt.battery import battery_file
from uavbatt.battery.model import Array
from uavbatt.battery.remembered import Scales, hover_drop_V
from uavbatt.battery.scaling import Pack, pack_of
from uavbatt.battery.state_space import SIZE, Belief, X
from uavbatt.packs.evidence import evidence_of_flight, with_rest, without_prior

SAID = Scales(np.array([0.1, -0.05]), np.array([[0.01, 0.004], [0.004, 0.006]]))


def joined(belief: Scales, evidence: Scales) -> Scales:
    """The product of two Gaussians."""
    first, second = np.linalg.inv(belief.covariance), np.linalg.inv(evidence.covariance)
    covariance = np.linalg.inv(first + second)
    return Scales(covariance @ (first @ belief.mean + second @ evidence.mean), covariance)


def of_capacity(mean: float, variance: float) -> Belief:
    means, covariance = np.zeros(SIZE), np.eye(SIZE)
    means[X.LOG_CAPACITY], covariance[X.LOG_CAPACITY, X.LOG_CAPACITY] = mean, variance
    return Belief.gaussian(means, covariance, 25.0)


def updated(said: Scales, value: float, variance: float) -> Scales:
    """What a measurement of the capacity makes of it: the Kalman update."""
    read: Array = np.array([0.0, 1.0])
    gain = said.covariance @ read / (read @ said.covariance @ read + variance)
    return Scales(said.mean + gain * (value - said.mean[1]), said.covariance - np.outer(gain, read @ said.covariance))


def test_a_rest_after_the_flight_counts_as_a_measurement_of_the_capacity() -> None:
    """The rested voltage took the belief from `before` to `after`; the same measurement is laid on the evidence."""
    before_mean, before, value, noise = -0.02, 0.005, -0.12, 0.003
    after = 1.0 / (1.0 / before + 1.0 / noise)
    after_mean = after * (before_mean / before + value / noise)
    found = with_rest(SAID, of_capacity(before_mean, before), of_capacity(after_mean, after))
    expected = updated(SAID, value, noise)
    assert found.mean == pytest.approx(expected.mean)
    assert found.covariance == pytest.approx(expected.covariance)
    assert found.mean[1] < SAID.mean[1] and found.mean[0] < SAID.mean[0]  # they hang together


def test_a_rest_that_tells_nothing_changes_nothing() -> None:
    assert with_rest(SAID, of_capacity(-0.02, 0.005), of_capacity(0.4, 0.005)) is SAID


def test_the_prior_is_taken_out_of_a_belief_that_knows_more() -> None:
    prior = Scales(np.array([0.0, -0.1]), np.diag([0.36, 0.09]))
    evidence = Scales(np.array([0.2, -0.15]), np.array([[0.01, -0.003], [-0.003, 0.004]]))
    found = without_prior(joined(prior, evidence), prior)
    assert found.mean == pytest.approx(evidence.mean, abs=1e-9)
    assert found.covariance == pytest.approx(evidence.covariance, abs=1e-9)


def test_a_belief_that_is_the_prior_is_no_evidence() -> None:
    """Its distance from the prior is chance: it is magnified by a factor of two at most."""
    prior = Scales(np.zeros(2), np.diag([0.36, 0.09]))
    found = without_prior(Scales(np.array([0.01, 0.01]), prior.covariance), prior)
    assert found.mean == pytest.approx([0.02, 0.02])
    assert np.diag(found.covariance) == pytest.approx(49.0 * np.diag(prior.covariance))  # 0.98 / 0.02


# --- what a flight says ------------------------------------------------------------------------------------------


def fitted_pack() -> Pack:
    return pack_of(battery_file.read_battery("lpab-3s"), 3, 5.0, 9.9, math.nan)


def seen(soc: float, *, log_ohm: float = 0.0, bias_V: float = 0.0, ohm_sd: float = 0.05) -> Belief:
    """A belief under load that knows its capacity well, and its resistance to `ohm_sd`."""
    means, variances = np.zeros(SIZE), np.full(SIZE, 1e-6)
    means[[X.SOC, X.CORE, X.SENSOR]] = soc, 25.0, 25.0
    means[X.LOG_RESISTANCE], means[X.BIAS] = log_ohm, bias_V
    variances[X.LOG_RESISTANCE], variances[X.LOG_CAPACITY] = ohm_sd**2, 0.02**2
    return Belief.gaussian(means, np.diag(variances), 25.0)


def told_ohm(made: Pack, *loaded: Belief, is_generic: bool = False) -> float:
    found = evidence_of_flight(made, loaded, loaded[-1], 25.0, is_generic=is_generic, is_begun_later=False)
    return found.log_ohm


def test_a_discrepancy_of_a_fitted_file_is_resistance_and_one_of_another_make_is_not() -> None:
    """10 mV below the model at the hover current are so many ohms: the same as if the resistance had been larger."""
    made = fitted_pack()
    as_ohms = 0.010 / hover_drop_V(made)
    lower, larger = told_ohm(made, seen(0.6, bias_V=-0.010)), told_ohm(made, seen(0.6, log_ohm=as_ohms))
    assert lower == pytest.approx(larger, rel=0.02) and lower - told_ohm(made, seen(0.6)) > 0.5 * as_ohms
    plain, biased = (told_ohm(made, seen(0.6, bias_V=volts), is_generic=True) for volts in (0.0, -0.010))
    assert biased == pytest.approx(plain)


def test_the_resistance_is_that_of_the_row_that_knows_it_best_and_not_of_the_knee() -> None:
    made = fitted_pack()
    known, vague, knee = (
        seen(0.7, log_ohm=0.2, ohm_sd=0.03), seen(0.5, log_ohm=0.6, ohm_sd=0.10), seen(0.1, log_ohm=0.9, ohm_sd=0.01),
    )  # fmt: skip
    assert told_ohm(made, known, vague, knee) == pytest.approx(told_ohm(made, known), abs=0.02)
    assert told_ohm(made, vague, known, knee) == pytest.approx(told_ohm(made, known), abs=0.02)
