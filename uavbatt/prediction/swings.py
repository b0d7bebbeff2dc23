"""The swings of the power around its mean: gusts, which last seconds, and manoeuvres, which last most of a minute.

Both are Ornstein-Uhlenbeck processes. A flight shows parts of them as averages over different times (`swings_shown`),
and flies on with what it has shown (`swung`).
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.prediction.sampling import LONGEST, held

MEAN_TAU_S, WINDOW_TAU_S, GUST_TAU_S = 60.0, 20.0, 5.0  # of the averages
# A manoeuvre is a climb or wind on the nose: these end a flight early, near empty the cut-off lies a climb away.
GUST_MEMORY_S, MANOEUVRE_MEMORY_S = 8.0, 40.0
LARGEST_SWING, LARGEST_MANOEUVRES = 0.6, 0.4  # of both together, and of these alone
SMALLEST_SPREAD = 0.03
STEPS_IN_BLOCK = 32


class Swings(NamedTuple):
    """Swings holds the relative sd of the power's two wandering parts: their own, not what an average shows of it."""

    manoeuvres: float
    gusts: float

    @property
    def mean_sd(self) -> float:
        """Return the relative sd of the mean of a coming flight around that of the last minute, at least 3 %."""
        left = MANOEUVRE_MEMORY_S / (MANOEUVRE_MEMORY_S + MEAN_TAU_S)
        return math.hypot(SMALLEST_SPREAD, min(self.manoeuvres, 1.0) * math.sqrt(left))


def shown_share(short_s: float, long_s: float, memory_s: float) -> float:
    """Return the share of its variance that a process shows as one exponential average around a longer one.

    The process is an Ornstein-Uhlenbeck process of this memory [s]; var(a) + var(b) - 2 cov(a, b) for averages over a
    and b [s].
    """

    def shared(a_s: float, b_s: float) -> float:
        """cov/σ² = (1/(1/a + 1/m) + 1/(1/b + 1/m))/(a + b)."""
        return (1.0 / (1.0 / a_s + 1.0 / memory_s) + 1.0 / (1.0 / b_s + 1.0 / memory_s)) / (a_s + b_s)

    return shared(short_s, short_s) + shared(long_s, long_s) - 2.0 * shared(short_s, long_s)


@cache
def shown_shares() -> tuple[Array, Array]:
    """Return the shares of variance that averages over (WINDOW_TAU_S, GUST_TAU_S) [2] show of each process.

    The processes are manoeuvres, and gusts.
    """
    slow, fast = (
        np.array([shown_share(tau_s, MEAN_TAU_S, memory_s) for tau_s in (WINDOW_TAU_S, GUST_TAU_S)])
        for memory_s in (MANOEUVRE_MEMORY_S, GUST_MEMORY_S)
    )
    return slow, fast


def swings_shown(variance: float, gust_variance: float) -> Swings:
    """Return the manoeuvres and gusts that two averages have shown parts of: least squares, none negative.

    variance, gust_variance : of the averages over WINDOW_TAU_S and GUST_TAU_S, relative to the mean.
    """
    seen, (slow, fast) = np.array([variance, gust_variance]), shown_shares()
    manoeuvres, gusts = np.linalg.solve(np.column_stack([slow, fast]), seen)
    if manoeuvres < 0.0:
        manoeuvres, gusts = 0.0, fast @ seen / (fast @ fast)
    elif gusts < 0.0:
        manoeuvres, gusts = slow @ seen / (slow @ slow), 0.0
    return Swings(math.sqrt(manoeuvres), math.sqrt(gusts))


def swung(dt_s: Array, count: int, swings: Swings) -> Array:
    """Return gusts and manoeuvres of `count` scenarios as factors on the power, of mean 1, [steps, count]."""
    manoeuvres = min(swings.manoeuvres, LARGEST_MANOEUVRES)
    gusts = min(swings.gusts, math.sqrt(LARGEST_SWING**2 - manoeuvres**2))
    exponent, processes = np.zeros((dt_s.size, count)), ((manoeuvres, MANOEUVRE_MEMORY_S), (gusts, GUST_MEMORY_S))
    for process, (sd, memory_s) in enumerate(processes):
        if sd > 0.0:
            variance = math.log1p(sd**2)  # of the logarithm of a factor that has mean 1 and this sd
            exponent += math.sqrt(variance) * _wandering(dt_s, count, memory_s, process) - 0.5 * variance
    return np.asarray(np.exp(exponent))


def _wandering(dt_s: Array, count: int, memory_s: float, process: int) -> Array:
    """A process of unit variance and this memory for each scenario, [steps, count]; always the same one."""
    normals, memory = _normals(held(dt_s.size + 1), count, process), np.exp(-dt_s / memory_s)
    fresh = np.sqrt(1.0 - memory**2)[:, None] * normals[np.arange(1, dt_s.size + 1) % LONGEST]
    return _remembering(memory, np.concatenate([normals[:1], fresh[:-1]]))


@cache
def _normals(steps: int, scenarios: int, process: int) -> Array:
    """Normals with mean 0 and variance 1 over the scenarios of every step, exactly: few of them must stand for all."""
    raw = np.random.default_rng([scenarios, process]).standard_normal((steps, scenarios))
    centred = raw - raw.mean(axis=1, keepdims=True)
    return np.asarray(centred / centred.std(axis=1, keepdims=True))


def _remembering(memory: Array, fresh: Array) -> Array:
    """x[k] = memory[k-1] x[k-1] + fresh[k], [steps, n]; with equal steps a block of them in one product."""
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
