"""Changes of the power in flight: what is a payload, and what is a climb or the scatter of a flight."""

from __future__ import annotations

import numpy as np

from uavbatt.prediction.load.power_change import LEAST_SINCE, LEAST_SINCE_LESS, PowerChange, changed_blocks, last_change
from uavbatt.prediction.load.rising import NOW_BLOCKS


def told(step: float, since: int, scatter: float = 0.0, blocks: int = 20) -> int:
    """The blocks since a step that is found, in a flight of 300 W among past ones that swing alike."""
    dice = np.random.default_rng(2)
    swing = 300.0 * np.exp(0.15 * np.sin(np.arange(blocks)))
    own_W = swing * np.exp(scatter * dice.standard_normal(blocks))
    own_W[blocks - since :] *= step
    return changed_blocks(np.log(own_W / swing), LEAST_SINCE)


def test_a_lasting_step_of_the_power_is_found_where_it_began() -> None:
    assert [told(1.35, since) for since in (3, 5, 10, 16)] == [3, 5, 10, 16]
    assert told(1.35, 6, scatter=0.06) == 6


def test_a_step_is_remembered_for_the_rest_of_the_flight() -> None:
    """Eight minutes after it, it was forgotten: on a mission the number rose by 160 s again, the lower end by 190 s."""
    assert told(1.35, 30, blocks=50) == 30
    low = np.concatenate([np.zeros(10), np.full(30, 0.3)])
    low[[20, 33]] = -0.2  # a descent
    assert changed_blocks(low, LEAST_SINCE) == 30
    assert (
        changed_blocks(np.concatenate([np.zeros(10), np.full(3, 0.6), np.zeros(7)]), LEAST_SINCE) == 0
    )  # a climb that is over


def test_what_is_no_payload_taken_up_changes_nothing() -> None:
    assert told(1.35, 2) == 0  # a climb of a minute
    assert told(1.15, 10) == 0
    assert told(0.7, 10) == 0  # less power may be a long descent
    assert told(1.35, 5, scatter=0.3) == 0  # a flight unlike the past ones
    assert told(1.35, 3, blocks=6) == 0  # too little was flown before it
    assert changed_blocks(np.empty(0), LEAST_SINCE) == 0


def change(more: list[float] | np.ndarray) -> PowerChange:  # type: ignore[type-arg]
    """The last change of a flight whose power is this, as ln of the ratio, against steady past ones of 300 W."""
    steady = np.full(len(more), 300.0)
    return last_change(300.0 * np.exp(more), np.stack([0.95 * steady, steady, 1.05 * steady]))


def test_the_last_change_counts() -> None:
    """A payload taken up ten minutes ago and set down five minutes ago; ice that grows after a payload."""
    carried = np.concatenate([np.zeros(10), np.full(10, 0.3), np.zeros(10)])
    assert change(carried) == (10, False)
    assert change(carried[:-6]).since == 14  # so far it may be a descent
    icy = np.concatenate([np.zeros(10), np.full(10, 0.3), np.linspace(0.3, 0.6, 12)])
    assert change(icy) == (NOW_BLOCKS, True)
    assert change(np.zeros(40)) == change(np.empty(0)) == (0, False)
    assert LEAST_SINCE_LESS > LEAST_SINCE


def test_a_flight_that_has_not_begun_its_way_home_has_not_set_down_a_payload() -> None:
    """The past flights have climbed home for five minutes already; this one will need as much."""
    homewards = np.concatenate([np.full(10, 300.0), np.full(10, 400.0)])
    assert last_change(np.full(20, 300.0), np.stack([homewards] * 3)).since == 0
