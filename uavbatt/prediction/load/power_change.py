"""A change of the power in flight, against that of past flights at the same time since take-off.

A lasting step of 20 % and more is a payload that was taken up or set down: then only the power since counts. If the
power has risen for minutes (`rising`), only that of the last two minutes counts. The mean of the whole flight would
show both late. A change is remembered for the rest of the flight (`scripts/changing_power.py`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.prediction.load.power_history import LOWEST_POWER_W, PowerHistory
from uavbatt.prediction.load.rising import BLOCK_S, LEAST_SCATTER, NOW_BLOCKS, blocks_since_rise

# A step of the power in flight, as ln of the ratio: at least 20 %, for a minute and a half, and clear of the scatter.
LEAST_STEP, LEAST_SINCE, STEP_SDS, MOST_LOW = 0.18, 3, 5.0, 0.1
LEAST_BEFORE, LONGEST_BEFORE = 4, 10  # what it was before, of earlier changes too
LEAST_SINCE_LESS = 5  # for a payload that was set down: a descent is shorter
REMEMBERED_BLOCKS = 240  # two hours, in which a change is remembered


class PowerChange(NamedTuple):
    """PowerChange holds for how many blocks the power has been another one; 0 if it has not changed."""

    since: int
    is_rising: bool  # it rises still


def last_change(own_W: Array, past_W: Array) -> PowerChange:
    """Return the last change of the power of a flight against past ones.

    own_W : power of each block of this flight [W], [blocks]; past_W : of each past flight [W], [flights, blocks].
    """
    own, past = (np.log(np.maximum(watts, LOWEST_POWER_W)) for watts in (own_W, past_W))
    more = own - np.median(past, axis=0)
    since_rise = blocks_since_rise(more)
    changes = since_rise, _since_more(more), _since_less(more, own)
    return PowerChange(min(filter(None, changes), default=0), since_rise == NOW_BLOCKS)


def since_set_down(flown: PowerHistory) -> PowerHistory | None:
    """Return the powers since a payload was last set down, of an aircraft without past flights; None if none was.

    A load that is taken up shows in the last minute already, and a climb of minutes is none. If the flight has needed
    little before, and much again (a tank that is filled again), it may do so once more.
    """
    own = np.log(np.maximum(flown.blocks_W(BLOCK_S, REMEMBERED_BLOCKS), LOWEST_POWER_W))
    since = changed_blocks(-own, LEAST_SINCE_LESS)
    return flown.last(since * BLOCK_S) if since and not _has_risen_again(own[:-since]) else None


def _has_risen_again(own: Array) -> bool:
    """Return True if minutes of little power were followed by minutes of much; own : ln of the power, [blocks]."""
    if own.size < LEAST_SINCE_LESS:
        return False
    means = np.convolve(own, np.full(LEAST_SINCE_LESS, 1.0 / LEAST_SINCE_LESS), mode="valid")
    return bool((means - np.minimum.accumulate(means)).max() > LEAST_STEP)


def _since_more(more: Array) -> int:
    """Return for how many blocks more power has been needed; a descent does not end what has lasted longer."""
    for low in range(LEAST_SINCE_LESS):
        since = changed_blocks(more[: more.size - low], LEAST_SINCE_LESS if low else LEAST_SINCE)
        if since:
            return since + low
    return 0


def _since_less(more: Array, own: Array) -> int:
    """Return for how many blocks less power has been needed, against past flights and against this one's own before.

    If only the past flights have needed more, their way home may begin earlier than this one's. own : ln of the power
    """
    return min(changed_blocks(-more, LEAST_SINCE_LESS), changed_blocks(-own, LEAST_SINCE_LESS))


def changed_blocks(more: Array, least: int) -> int:
    """Return for how many blocks this flight has needed far more power than in the five minutes before them.

    It is 0 if there is no such step, or if it was fewer than `least` blocks ago.
    more : ln of the power, or of its ratio to that of past flights, [blocks]
    """
    since = np.arange(least, more.size - LEAST_BEFORE + 1)
    if since.size == 0:
        return 0
    edge = more.size - since
    before = np.minimum(edge, LONGEST_BEFORE)
    sums, squares = (np.concatenate([[0.0], np.cumsum(each)]) for each in (more, more**2))
    before_mean, mean = (sums[edge] - sums[edge - before]) / before, (sums[-1] - sums[edge]) / since
    left = squares[-1] - squares[edge - before] - before * before_mean**2 - since * mean**2
    scatter = np.hypot(LEAST_SCATTER, np.sqrt(np.maximum(left, 0.0) / (before + since)))
    step = mean - before_mean
    clear = step / (scatter * np.sqrt(1.0 / before + 1.0 / since))
    for k in np.argsort(-clear):
        if not clear[k] > STEP_SDS:
            break
        if step[k] > LEAST_STEP and _lasts(more[-since[k] :] - before_mean[k], step[k]):
            return int(since[k])
    return 0


def _lasts(more: Array, step: float) -> bool:
    """Return True if all but a tenth of the blocks need half of the step at least: a climb is over after some."""
    return bool(np.sort(more)[int(MOST_LOW * more.size)] > 0.5 * step)
