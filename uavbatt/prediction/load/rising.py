"""A power that rises for minutes against what was expected: ice, a wind that freshens.

Each rise is small beside the scatter of a flight, and the mean of the flight shows it minutes late. A straight line
through the ratios of the last four to ten minutes shows it. A front that passes, or a small payload, is a step: it
explains the ratios better than the line, and is not taken for a rise.
"""

from __future__ import annotations

import math

import numpy as np

from uavbatt.battery.model import Array

BLOCK_S = 30.0
NOW_BLOCKS = 4  # what shows the power of now while it rises
RISING_SD = 0.08  # relative, of the power to come: it may rise on
# So much from the first to the last of so many blocks, as ln, with a slope clear of the scatter.
LEAST_RISE, RISE_SDS, LEAST_SCATTER = 0.08, 4.0, 0.03
LEAST_RISING, LONGEST_RISE = 8, 20


def has_risen(ratio: Array) -> bool:
    """Return True if a ratio has risen steadily in its last four to ten minutes.

    ratio : of a flight's power to that expected, as ln, [blocks] of BLOCK_S.
    """
    return blocks_since_rise(ratio[-LONGEST_RISE:]) == NOW_BLOCKS


def blocks_since_rise(ratio: Array) -> int:
    """Return how many blocks show the power that the last steady rise has led to; 0 if there was none.

    They begin NOW_BLOCKS before its end: a power that rises no more does not fall back. ratio : as for `has_risen`.
    """
    sums, squares = (np.concatenate([[0.0], np.cumsum(each)]) for each in (ratio, ratio**2))
    ends = [_last_rise(ratio, sums, squares, n) for n in range(LEAST_RISING, min(ratio.size, LONGEST_RISE) + 1)]
    end = max(ends, default=0)
    return ratio.size - end + NOW_BLOCKS if end else 0


def _last_rise(ratio: Array, sums: Array, squares: Array, count: int) -> int:
    """Return the end of the last `count` blocks in turn that rise; 0 if none do.

    They do if the straight line through them rises clearly, and no step explains them better. sums, squares : of the
    ratios and of their squares before each block, and behind the last, [blocks + 1]
    """
    at = np.arange(count) - 0.5 * (count - 1)
    extent = math.sqrt(float(at @ at))
    risen = np.correlate(ratio, at, "valid") / extent  # of a line with slope b: b times the extent
    variance = (squares[count:] - squares[:-count]) / count - ((sums[count:] - sums[:-count]) / count) ** 2
    left = np.sqrt(np.maximum(variance - risen**2 / count, 0.0))
    is_clear = risen > RISE_SDS * np.hypot(LEAST_SCATTER, left)
    for first in np.flatnonzero(is_clear & (risen * (count - 1) > LEAST_RISE * extent))[::-1]:
        if left[first] < _left_by_a_step(ratio[first : first + count]):
            return int(first) + count
    return 0


def _left_by_a_step(ratio: Array) -> float:
    """Return the scatter that the step which explains these ratios best leaves."""
    counts = np.arange(1, ratio.size)
    before, after = np.cumsum(ratio)[:-1] / counts, np.cumsum(ratio[::-1])[-2::-1] / counts[::-1]
    explained = counts * counts[::-1] / ratio.size**2 * (after - before) ** 2
    return math.sqrt(max(float(np.var(ratio) - np.max(explained)), 0.0))
