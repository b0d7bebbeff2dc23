"""A power that rises for minutes against what was expected: ice, a wind that freshens.

Each rise is small beside the scatter of a flight, and the mean of the flight shows it minutes late. A straight line
through the ratios of the last four to ten minutes shows it. A front that passes, or a small payload, is a step: it
explains the ratios better than the line, and is not taken for a rise.
"""

from __future__ import annotations

import math

import numpy as np

from uavbatt.battery.model import Array

BLOCK_S, MOST_BLOCKS = 30.0, 20
NOW_BLOCKS = 4  # what shows the power of now while it rises
RISING_SD = 0.08  # relative, of the power to come: it may rise on
# So much from the first to the last of so many blocks at least, as ln, with a slope clear of the scatter.
LEAST_RISE, LEAST_RISING, RISE_SDS, LEAST_SCATTER = 0.08, 8, 4.0, 0.03


def has_risen(ratio: Array) -> bool:
    """Return True if a ratio has risen steadily in its last four to ten minutes.

    ratio : of a flight's power to that expected, as ln, [blocks] of BLOCK_S, the last MOST_BLOCKS at most.
    """
    return any(_is_rising(ratio[-count:]) for count in range(LEAST_RISING, ratio.size + 1))


def _is_rising(ratio: Array) -> bool:
    """Return True if the straight line through all of these ratios rises clearly, and no step explains them better."""
    at = np.arange(ratio.size) - 0.5 * (ratio.size - 1)
    extent = math.sqrt(float(at @ at))
    slope = float(at @ ratio) / extent**2
    left = float(np.std(ratio - slope * at))
    is_clear = slope * extent > RISE_SDS * math.hypot(LEAST_SCATTER, left)
    return slope * (ratio.size - 1) > LEAST_RISE and is_clear and left < _left_by_a_step(ratio)


def _left_by_a_step(ratio: Array) -> float:
    """Return the scatter that the step which explains these ratios best leaves."""
    counts = np.arange(1, ratio.size)
    before, after = np.cumsum(ratio)[:-1] / counts, np.cumsum(ratio[::-1])[-2::-1] / counts[::-1]
    explained = counts * counts[::-1] / ratio.size**2 * (after - before) ** 2
    return math.sqrt(max(float(np.var(ratio) - explained.max()), 0.0))
