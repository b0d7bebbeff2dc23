"""Motors that run by turns (gliders, lift of a VTOL): the flight ends while the motor runs, often within seconds."""

from __future__ import annotations

import math

import numpy as np
import pytest
from factories import flown

from uavbatt import Estimator, Sample
from uavbatt.prediction.forecast import Forecast
from uavbatt.prediction.load.power_history import PowerHistory
from uavbatt.records import NAN, Remaining

MOTOR_W, GLIDE_W = 500.0, 25.0
EDGES_S = np.arange(0.0, 200.0, 5.0)


def running(past: PowerHistory) -> np.ndarray:
    """The share of the scenarios whose motor runs, from now on, [steps]."""
    again = past.again(EDGES_S, 45)
    return np.asarray((again > 1.0).mean(axis=1))


TURN = [MOTOR_W] * 4 + [GLIDE_W] * 16  # 20 s of motor, 80 s of glide


def test_a_motor_that_runs_now_runs_on_in_most_scenarios() -> None:
    """One scenario in five began with the motor on, whatever it did now."""
    share = running(flown(*TURN * 5, MOTOR_W))
    assert share[0] > 0.7 and share[5] < 0.3
    assert running(flown(*TURN * 5))[0] < 0.3


def test_a_long_glide_ends_sooner_than_one_that_has_just_begun() -> None:
    late, early = running(flown(*TURN * 5)), running(flown(*TURN * 5, *TURN[:6]))
    assert late[:8].mean() > early[:8].mean() + 0.2


def test_a_steady_flight_is_flown_again_from_every_place() -> None:
    """Its swings of a tenth look alike: what comes is as even as before."""
    power_W = 300.0 * (1.0 + 0.1 * np.sin(np.arange(120) / 4.0))
    ahead = flown(*power_W.tolist()).again(EDGES_S, 45)
    assert ahead.mean(axis=1) == pytest.approx(np.ones(EDGES_S.size - 1), abs=0.05)


def test_a_flight_without_a_place_like_now_begins_anywhere() -> None:
    ahead = flown(*[GLIDE_W] * 60, *[1e6] * 6).again(EDGES_S, 45)
    assert np.isfinite(ahead).all() and np.ptp(ahead[0]) > 0.0


@pytest.mark.filterwarnings("error")
def test_a_motor_that_charges_the_pack_for_a_while_stands_still() -> None:
    share = running(flown(*([MOTOR_W] * 4 + [-50.0] * 16) * 5, MOTOR_W))
    assert share[0] > 0.7


def test_an_early_end_is_shown_at_once_although_most_ends_stay() -> None:
    """The lift of a VTOL starts: it may take a weak pack to its cut-off, and a sound one flies on for minutes."""
    before_s = np.linspace(150.0, 900.0, 129)
    last = Forecast(0.0, NAN, NAN, NAN, NAN, NAN, before_s)
    lifting_s = np.concatenate([np.full(20, 12.0), before_s[20:]])
    assert last.steadied(lifting_s, 5.0)[6] == pytest.approx(12.0)
    assert last.steadied(before_s - 25.0, 5.0)[6] > 130.0  # a small change is still averaged


def gliding(armed: bool | None) -> list[Remaining]:
    """What is said of a glider whose second glide lasts for two and a half minutes."""
    estimator = Estimator.from_battery("lipo-generic", cells=4, capacity_Ah=5.0, cutoff_V=13.2)
    amps = [0.1] * 20 + ([30.0] * 30 + [0.3] * 60) * 2 + [30.0] * 30 + [0.3] * 150 + [30.0] * 20
    rows = [
        Sample(float(k), 16.6 - 0.03 * a - 0.001 * k, a, 25.0, armed=None if armed is None else k >= 15)
        for k, a in enumerate(amps)
    ]
    return [said for _, said in estimator.run(rows)]


def test_an_armed_glider_has_not_landed() -> None:
    assert all(math.isfinite(said.remaining_s) for said in gliding(armed=True)[60:])


def test_the_end_of_a_glide_is_no_take_off() -> None:
    """Without a flag it is taken for landed; then the time of a fresh pack was blended in for four minutes."""
    said = gliding(armed=None)
    before_s, after_s = (next(r for r in rows if math.isfinite(r.remaining_s)) for rows in (said[309::-1], said[390:]))
    passed_s = after_s.time_s - before_s.time_s
    assert after_s.remaining_hi_s < 1.1 * (before_s.remaining_hi_s + passed_s)
