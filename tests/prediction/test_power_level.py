"""The power level of a flight: from the prior to what was flown, with its uncertainty; a payload begins it anew."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from route_rig import POWERS

from uavbatt.battery.powers import UNKNOWN
from uavbatt.prediction.load.rising import LONGEST_RISE, RISING_SD
from uavbatt.prediction.route.power_level import LEVEL_TAU_S, MODEL_SD, PowerLevel


def test_the_level_goes_from_the_prior_to_what_was_flown_and_forgets() -> None:
    fresh = PowerLevel()
    assert fresh.level(POWERS) == (1.0, POWERS.level_sd)
    long_flown, sds = fresh, []
    for _ in range(300):
        long_flown = long_flown.after(1.2, 1.0)
        sds.append(long_flown.level(POWERS)[1])
    assert 1.1 < long_flown.level(POWERS)[0] < 1.2  # the law of the powers may be off by as much
    assert all(after <= before for before, after in zip([POWERS.level_sd, *sds], sds, strict=False))
    changed = long_flown
    for _ in range(round(3.0 * LEVEL_TAU_S)):
        changed = changed.after(0.9, 1.0)
    assert 0.9 < changed.level(POWERS)[0] < 0.95


def test_the_power_before_a_payload_was_set_down_counts_for_little() -> None:
    level = PowerLevel()
    for _ in range(400):
        level = level.after(1.3, 1.0)
    lighter, unchanged = level.with_another_load(), level
    assert 1.0 < lighter.level(POWERS)[0] < level.level(POWERS)[0]
    for _ in range(60):
        lighter, unchanged = lighter.after(1.0, 1.0), unchanged.after(1.0, 1.0)
    assert lighter.level(POWERS)[0] < 1.08 < 1.15 < unchanged.level(POWERS)[0]
    assert PowerLevel().with_another_load() == PowerLevel()


@pytest.mark.parametrize("after", [1.35, 0.7])
def test_a_payload_changed_in_flight_is_known_after_two_minutes(after: float) -> None:
    """It was averaged away: eight minutes after 35 % more power the time left was a quarter too long."""
    level = PowerLevel()
    for second in range(500):
        level = level.after(1.0 + 0.02 * math.sin(second / 5.0), 1.0, 0.03)
    for _ in range(120):
        level = level.after(after, 1.0, 0.03)
    mean = level.sum_s / level.told_s
    assert mean == pytest.approx(after, abs=0.09)


def test_gusts_and_a_front_change_no_payload() -> None:
    """12 % for two minutes, and noisy rows: what was flown before still counts."""
    level, dice = PowerLevel(), np.random.default_rng(1)
    for second in range(620):
        ratio = (1.12 if second > 500 else 1.0) * math.exp(0.1 * dice.standard_normal())
        level = level.after(ratio, 1.0, 0.1)
    assert level.told_s > 300.0
    assert level.sum_s / level.told_s < 1.05


def test_an_unknown_aircraft_has_no_level_before_it_has_flown_a_while() -> None:
    level = PowerLevel()
    for second in range(40):
        assert math.isfinite(level.level(UNKNOWN)[0]) is (second > 20)
        level = level.after(1.3, 1.0)
    assert level.level(UNKNOWN)[0] == pytest.approx(1.3)


def test_what_was_flown_before_a_payload_was_taken_up_counts_less() -> None:
    """Half a flight of 1.0 and half of 1.2: the level is nearer to the later one, for all that is expected of 1.0."""
    level = PowerLevel()
    for ratio in (1.0, 1.2):
        for _ in range(900):
            level = level.after(ratio, 1.0)
    assert 1.12 < level.level(POWERS)[0] < 1.2


def test_a_long_flight_tells_its_level_as_well_as_its_rows_allow() -> None:
    """Older rows count less: the sd of the mean is that of independent rows with these weights."""
    level, noise = PowerLevel(), np.random.default_rng(3)
    seconds = 3600
    ages_s = np.arange(seconds)
    weights = np.exp(-ages_s / LEVEL_TAU_S)
    means = noise.normal(0.0, 1.0, (4000, seconds // 16)) @ weights[::16] / weights[::16].sum()  # alike for 16 s
    for _ in ages_s:
        level = level.after(1.0, 1.0)
    powers = msgspec.structs.replace(POWERS, level_sd=2.0, row_sd=0.1)
    assert level.level(powers)[1] == pytest.approx(math.hypot(MODEL_SD, 0.1 * means.std()), rel=0.05)


def test_while_the_power_rises_the_last_two_minutes_are_the_level() -> None:
    """Ice: 4 % more a minute for six minutes, rows of two a second."""
    level, ratios = PowerLevel(), [1.2 * math.exp(0.04 * k / 120.0) for k in range(720)]
    for ratio in ratios:
        level = level.after(ratio, 0.5)
    found, sd = level.level(POWERS)
    assert level.is_rising
    assert found == pytest.approx(np.mean(ratios[-240:]), rel=0.005)
    assert RISING_SD < sd < 0.1


@pytest.mark.parametrize(
    "damage",
    [
        {"told_s": -1.0}, {"sum_s": math.nan}, {"recent_s": math.inf}, {"open_sum_s": -0.1},
        {"blocks": (1.0, 0.0)}, {"blocks": (math.inf,)}, {"blocks": (1.0,) * (LONGEST_RISE + 1)},
    ],
)  # fmt: skip
def test_a_level_that_no_flight_leaves_is_told_from_one_that_a_flight_may_leave(damage: dict[str, object]) -> None:
    level = PowerLevel()
    for _ in range(400):
        level = level.after(1.1, 1.0)
    assert level.is_possible and not level._replace(**damage).is_possible
