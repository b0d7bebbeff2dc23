"""Swings of the power that no flight has shown yet: gusts, which last seconds, and manoeuvres, most of a minute.

Both are Ornstein-Uhlenbeck processes around the mean.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.prediction.simulation.sampling import LONGEST, held_steps

# Manoeuvres (climbs, head wind) end a flight early: near empty one climb takes the voltage to the cut-off.
GUST_MEMORY_S, MANOEUVRE_MEMORY_S = 8.0, 40.0
LARGEST_GUSTS = 0.6  # larger swings would not be normal around the mean
STEPS_IN_BLOCK = 32


class Swings(NamedTuple):
    """Swings holds the relative sd of the power's two wandering parts."""

    manoeuvres: float
    gusts: float

    def times(self, factor: float) -> Swings:
        """Return swings that are `factor` times as large."""
        return Swings(self.manoeuvres * factor, self.gusts * factor)


def swung(dt_s: Array, count: int, swings: Swings) -> Array:
    """Return gusts and manoeuvres of `count` scenarios as factors on the power, of mean 1, [steps, count]."""
    gusts = min(swings.gusts, LARGEST_GUSTS)
    exponent = np.zeros((dt_s.size, count))
    for process, (sd, memory_s) in enumerate(((swings.manoeuvres, MANOEUVRE_MEMORY_S), (gusts, GUST_MEMORY_S))):
        if sd > 0.0:
            variance = math.log1p(sd**2)  # of the logarithm of a factor with mean 1 and this sd
            exponent += math.sqrt(variance) * _wandering(dt_s, count, memory_s, process) - 0.5 * variance
    return np.asarray(np.exp(exponent))


def _wandering(dt_s: Array, count: int, memory_s: float, process: int) -> Array:
    """Return a process of unit variance and this memory for each scenario, [steps, count]; always the same one."""
    normals, memory = _normals(held_steps(dt_s.size + 1), count, process), np.exp(-dt_s / memory_s)
    fresh = np.sqrt(1.0 - memory**2)[:, None] * normals[np.arange(1, dt_s.size + 1) % LONGEST]
    return _remembering(memory, np.concatenate([normals[:1], fresh[:-1]]))


@cache
def _normals(steps: int, scenarios: int, process: int) -> Array:
    """Return normals with mean 0 and variance 1, exactly, over the scenarios of every step, as they are few."""
    raw = np.random.default_rng([scenarios, process]).standard_normal((steps, scenarios))
    centred = raw - raw.mean(axis=1, keepdims=True)
    return np.asarray(centred / centred.std(axis=1, keepdims=True))


def _remembering(memory: Array, fresh: Array) -> Array:
    """Return x[k] = memory[k-1] x[k-1] + fresh[k], [steps, n]; equal steps are worked out in blocks."""
    out = fresh.copy()
    if np.any(memory != memory[0]):
        for k in range(1, out.shape[0]):
            out[k] += memory[k - 1] * out[k - 1]
        return out
    powers = memory[0] ** np.arange(STEPS_IN_BLOCK + 1)
    lag = np.subtract.outer(np.arange(STEPS_IN_BLOCK), np.arange(STEPS_IN_BLOCK))
    within = np.where(lag >= 0, powers[np.maximum(lag, 0)], 0.0)
    for first in range(0, out.shape[0], STEPS_IN_BLOCK):
        block = out[first : first + STEPS_IN_BLOCK]
        n = block.shape[0]
        before = powers[1 : n + 1, None] * out[first - 1] if first else 0.0
        block[:] = within[:n, :n] @ block + before
    return out
