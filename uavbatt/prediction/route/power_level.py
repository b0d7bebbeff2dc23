"""The power level of a flight: its flown power over that of the vehicle's `[powers]`, which shows a payload.

Older parts of the flight count less. None of them counts where the last 45 s differ from the level by more than flights
ever do (a payload was taken up or set down), and only the last two minutes count where the ratio has risen for minutes
(ice).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uavbatt.battery.powers import Powers
from uavbatt.prediction.load.rising import BLOCK_S, LONGEST_RISE, NOW_BLOCKS, RISING_SD, has_risen
from uavbatt.records import NAN

POWER_MEMORY_S, MODEL_SD = 8.0, 0.02
LEAST_FLOWN_S, LEVEL_TAU_S = 20.0, 600.0
# A payload changed in flight: the power of the last 45 s against the level before, relatively. In 12 simulated missions
# without a change, with gusts and a front, they were 6 % apart at most, in 40 real ones 25 %: their rows are noisy, so
# that the noise of such a mean counts, too. With 6 sd some of those flights were taken for changed ones.
RECENT_TAU_S, CHANGED, CHANGED_SDS = 45.0, 0.18, 7.0
LEAST_RATIO = 0.01  # of a half minute


class PowerLevel(NamedTuple):
    """PowerLevel holds a flight's ratio of flown to modelled power, in means that forget; a restart keeps it."""

    told_s: float = 0.0  # seconds of flight that told the level, older ones counted less
    sum_s: float = 0.0  # the ratio, summed over them
    recent_s: float = 0.0  # as `told_s`, of the last 45 s
    recent_sum_s: float = 0.0  # as `sum_s`, of the last 45 s
    blocks: tuple[float, ...] = ()  # mean ratio of each half minute, the oldest first
    open_s: float = 0.0  # of the half minute that has begun
    open_sum_s: float = 0.0
    is_rising: bool = False

    @property
    def is_possible(self) -> bool:
        """Return True if a flight can have left this: a saved file may hold anything."""
        sums = (self.told_s, self.sum_s, self.recent_s, self.recent_sum_s, self.open_s, self.open_sum_s)
        is_known = len(self.blocks) <= LONGEST_RISE and all(LEAST_RATIO <= ratio < math.inf for ratio in self.blocks)
        return is_known and all(0.0 <= value < math.inf for value in sums)

    def after(self, ratio: float, told_s: float, row_sd: float = 0.0) -> PowerLevel:
        """Return the level after `told_s` [s] in which the flown power was `ratio` times the modelled power.

        row_sd : relative sd of the power from row to row
        """
        kept, kept_recent = math.exp(-told_s / LEVEL_TAU_S), math.exp(-told_s / RECENT_TAU_S)
        recent_s, recent_sum_s = kept_recent * self.recent_s + told_s, kept_recent * self.recent_sum_s + told_s * ratio
        level_s, level_sum_s = kept * self.told_s + told_s, kept * self.sum_s + told_s * ratio
        before_s, before_sum_s = level_s - recent_s, level_sum_s - recent_sum_s
        usual = max(CHANGED, CHANGED_SDS * row_sd * math.sqrt(mean_of_rows(recent_s, RECENT_TAU_S)))
        apart = abs(recent_sum_s * before_s - before_sum_s * recent_s)  # of the two means, times both times
        if before_s > RECENT_TAU_S and apart > usual * before_sum_s * recent_s:
            level_s, level_sum_s = recent_s, recent_sum_s
        open_s, open_sum_s = self.open_s + told_s, self.open_sum_s + told_s * ratio
        now = PowerLevel(level_s, level_sum_s, recent_s, recent_sum_s, self.blocks, open_s, open_sum_s, self.is_rising)
        return now._with_block() if open_s >= BLOCK_S else now

    def with_another_load(self) -> PowerLevel:
        """Return the level after a payload was taken up or set down: what was flown before counts for little."""
        told_s = min(self.told_s, LEAST_FLOWN_S)
        return PowerLevel(told_s, self.sum_s / self.told_s * told_s) if told_s > 0.0 else self

    def _with_block(self) -> PowerLevel:
        """Return the level after a half minute; while it rises, only the last two minutes count."""
        blocks = (*self.blocks, max(self.open_sum_s / self.open_s, LEAST_RATIO))[-LONGEST_RISE:]
        closed = self._replace(blocks=blocks, open_s=0.0, open_sum_s=0.0, is_rising=has_risen(np.log(blocks)))
        if not closed.is_rising:
            return closed
        return closed._replace(told_s=NOW_BLOCKS * BLOCK_S, sum_s=BLOCK_S * sum(blocks[-NOW_BLOCKS:]))

    def level(self, powers: Powers) -> tuple[float, float]:
        """Return the ratio of the flight's power to that of `powers`, and its sd: the prior and what was flown so far.

        For an unknown aircraft it is NaN until enough was flown. A power that rises is no chance: the prior is silent.
        """
        if not self.told_s > (0.0 if powers.flights else LEAST_FLOWN_S):
            return (1.0, powers.level_sd) if powers.flights else (NAN, NAN)
        flown, noise = self.sum_s / self.told_s, powers.row_sd**2 * mean_of_rows(self.told_s) + MODEL_SD**2
        if self.is_rising:
            return flown, math.hypot(math.sqrt(noise), RISING_SD)
        share = 1.0 / (1.0 + noise / powers.level_sd**2) if powers.flights else 1.0
        return 1.0 + share * (flown - 1.0), math.sqrt(share * noise)


def mean_of_rows(told_s: float, tau_s: float = LEVEL_TAU_S) -> float:
    """Return the variance of a mean of rows over that of one row; the weights exp(-age / tau_s) sum to `told_s`.

    The squares of these weights sum to told_s - told_s² / (2 tau_s), and rows of POWER_MEMORY_S are alike.
    """
    return min(2.0 * POWER_MEMORY_S * (1.0 / told_s - 0.5 / tau_s), 1.0)
