"""Electrodes that react more sluggishly than the tested ones are told from ohms and from lost charge."""

from __future__ import annotations

import math

import numpy as np
import pytest
from factories import generic_pack, with_spread

from uavbatt.battery.model import SOC_GRID, transfer_drop
from uavbatt.battery.pack import c_rate
from uavbatt.battery.state_space import Belief, X
from uavbatt.estimation import noise
from uavbatt.estimation.filter import SocFilter
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight, with_effects

REACTION_V, FADE = 0.06, 0.14
HALF_TIME_S = 420.0


def flown(until_s: float, effects: dict[str, float]) -> Belief:
    """What is believed `until_s` after the start of a flight of a pack with these effects, by a file of its make."""
    tested = with_spread(
        generic_pack(),
        resistance_scale_sd=0.2, capacity_scale_sd=0.1, bias_sd_V=0.015, bias_tau_s=2000.0, reaction_sd_V=0.05,
        ocv_drift_sd_V=np.zeros(SOC_GRID.size),
    )  # fmt: skip
    ours = SocFilter(tested)
    for sample in simulate_flight(with_effects(generic_pack(), effects), SimulatedFlight(250.0)):
        if sample.time_s > until_s:
            break
        ours.step(sample)
    assert ours.belief is not None
    return ours.belief


@pytest.mark.parametrize(
    ("effects", "true"),
    [
        ({}, {X.REACTION: 0.0, X.LOG_RESISTANCE: 0.0, X.LOG_CAPACITY: 0.0}),
        ({"charge_transfer": REACTION_V}, {X.REACTION: REACTION_V, X.LOG_RESISTANCE: 0.0, X.LOG_CAPACITY: 0.0}),
        ({"capacity_fade": FADE}, {X.REACTION: 0.0, X.LOG_RESISTANCE: 0.0, X.LOG_CAPACITY: math.log1p(-FADE)}),
    ],
)
def test_reaction_and_lost_charge_are_told_apart_by_half_time(
    effects: dict[str, float], true: dict[int, float]
) -> None:
    half = flown(HALF_TIME_S, effects)
    for component, value in true.items():
        assert abs(half.mean[component] - value) < 1.5 * math.sqrt(half.covariance[component, component]), component
    moved_V = float(half.mean[X.REACTION] - flown(HALF_TIME_S, {}).mean[X.REACTION])
    assert moved_V > 0.5 * REACTION_V if true[X.REACTION] else abs(moved_V) < 0.1 * REACTION_V


def test_the_block_in_which_the_motors_start_does_not_speak_against_a_reaction() -> None:
    """A reaction's drop saturates: at the mean current of idling and hovering it is not the mean of the two drops."""
    pack, idle_A, hover_A = with_spread(generic_pack(), reaction_sd_V=0.05), 0.3, 12.0
    sluggish = pack.cell._replace(transfer_V=pack.spread.reaction_sd_V)
    idle_V, mean_V, hover_V = (
        float(transfer_drop(sluggish, c_rate(pack.installation, amps)))
        for amps in (idle_A, 0.5 * (idle_A + hover_A), hover_A)
    )
    bent_V = mean_V - 0.5 * (idle_V + hover_V)
    assert bent_V > 0.01
    at = np.zeros(len(X))
    at[X.SOC], at[X.CORE] = 0.9, 20.0
    mean_A, step_A = 0.5 * (idle_A + hover_A), 0.5 * (hover_A - idle_A)
    assert math.sqrt(noise.reading_variance(pack, at, mean_A, step_A)) > pack.installation.cells * bent_V
