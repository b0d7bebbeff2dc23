"""The power of the flight so far: none of its energy is lost, and its minutes tell how much the next may differ."""

from __future__ import annotations

import numpy as np
import pytest

from uavbatt.prediction.load.power_history import PRIOR_MINUTE_SD, PowerHistory


def flown(*parts: tuple[float, float], row_s: float = 1.0) -> PowerHistory:
    """The history of a flight of parts: seconds, power [W]."""
    history = PowerHistory()
    for seconds, power_W in parts:
        for _ in range(round(seconds / row_s)):
            history = history.after(power_W, row_s)
    return history


@pytest.mark.parametrize("row_s", [0.1, 1.0, 7.0])
@pytest.mark.parametrize("seconds", [70.0, 700.0, 7000.0])
def test_the_energy_of_a_flight_is_in_its_history(seconds: float, row_s: float) -> None:
    history = flown((seconds, 120.0), (seconds, 240.0), row_s=row_s)
    rows = 2 * round(seconds / row_s)
    kept_J = history.piece_s * sum(history.pieces_W) + history.open_J
    assert kept_J == pytest.approx(rows / 2 * row_s * (120.0 + 240.0), rel=1e-9)
    assert history.length_s + history.open_s == pytest.approx(rows * row_s)


def test_the_last_blocks_hold_the_mean_powers_of_their_times() -> None:
    history = flown((300.0, 100.0), (120.0, 300.0))
    assert history.blocks_W(60.0, 4) == pytest.approx([100.0, 100.0, 300.0, 300.0], rel=0.05)
    assert history.blocks_W(60.0, 2) == pytest.approx([300.0, 300.0], rel=0.05)


def test_what_was_not_flown_yet_is_the_mean() -> None:
    assert (PowerHistory().again(np.array([0.0, 10.0, 30.0]), 5) == 1.0).all()


def test_minutes_that_differ_widen_the_spread_of_a_minute_and_steady_ones_narrow_it() -> None:
    assert flown((60.0, 100.0)).minute_sd == PRIOR_MINUTE_SD
    steady, uneven = flown((1200.0, 200.0)), flown(*((60.0, 100.0), (60.0, 300.0)) * 10)
    assert steady.minute_sd < 0.6 * PRIOR_MINUTE_SD
    assert uneven.minute_sd > PRIOR_MINUTE_SD
