"""Draws of all uncertain quantities from the same fixed normals, so that a forecast moves only when the belief does.

The end of a flight can be bimodal (a surge grazes the cut-off or does not), which a mean and a variance cannot say:
so each draw flies to its own end and the quantiles are those of the ends. The normals come in antithetic pairs and
are whitened, so that the draws carry the belief's mean and covariance exactly, as sigma points do.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.battery.state_space import SIZE, Belief, X
from uavbatt.prediction.simulation.draws import Flying

DRAWS = 128
FEWEST, LONGEST = 64, 1024  # steps
_SEED = 5725


class Normals(NamedTuple):
    """Normals holds standard normals [steps, batch]: of the model's wandering error and of the rows' own noise."""

    bias: Array
    row: Array


@cache
def whitened(seed: int, rows: int, draws: int) -> Array:
    """Return standard normals [rows, draws] in antithetic pairs, with mean 0 and covariance 1, exactly."""
    half = np.random.default_rng(seed).standard_normal((rows, draws // 2))
    raw = np.concatenate([half, -half], axis=1)
    root = np.linalg.cholesky(raw @ raw.T / draws)
    return np.asarray(np.linalg.solve(root, raw))


def normals() -> Array:
    """Return the standard normals [9, DRAWS] of the belief's draws."""
    return whitened(_SEED, SIZE, DRAWS)


def wander(steps: int, by_rows: bool = False) -> Normals:
    """Return standard normals [steps, DRAWS] of the model's wandering error and, `by_rows`, of the rows' noise.

    Beyond LONGEST steps they repeat. A forecast with fewer steps keeps fewer in memory: 256 are enough for an hour of
    flight.
    """
    return Normals(_held_normals(0, steps), _held_normals(1, steps) if by_rows else np.empty((0, DRAWS)))


def wander_home(steps: int) -> Array:
    """Return standard normals [steps, DRAWS] of the model's error on a way home: others than on the way out."""
    return _held_normals(0, steps, backwards=True)


def _held_normals(process: int, steps: int, backwards: bool = False) -> Array:
    """Return the first normals of a process (0 the model's error, 1 the rows' noise); backwards: its last ones."""
    drawn = _normals(process, held_steps(steps), backwards)
    return drawn[:steps] if steps <= LONGEST else np.resize(drawn, (steps, DRAWS))


def held_steps(steps: int) -> int:
    """Return for how many steps normals are kept where `steps` are asked: the next power of two, at most LONGEST."""
    return min(max(FEWEST, 1 << (steps - 1).bit_length()), LONGEST)


@cache
def _normals(process: int, steps: int, backwards: bool) -> Array:
    half = np.random.default_rng(_SEED + 1).standard_normal((2, LONGEST, DRAWS // 2))[process]
    half = half[: -steps - 1 : -1] if backwards else half[:steps]
    return np.concatenate([half, -half], axis=1)


@cache
def shuffled(count: int) -> Array:
    """Return positions 0..1 [DRAWS] that spread draws evenly over load scenarios, unrelated to the battery's draws."""
    return np.random.default_rng(_SEED + 2 + count).permutation((np.arange(DRAWS) + 0.5) / DRAWS)


def least_soc(flying: Flying) -> Array:
    """Return the charge [draws] below which each draw ends: the reserve, else none that the pack may give.

    It holds along the route and on the way home. A curve goes on below its charge of 0, so that a cut-off far below it
    would be met long after a pack is empty. How much charge lies below that point of the curve is not known for a make
    that nobody tested, or whose tests ended under a large load.
    """
    if flying.reserve_soc > 0.0:
        return np.full(DRAWS, flying.reserve_soc)
    return -flying.pack.spread.empty_soc_sd * shuffled(DRAWS)


@cache
def within_step() -> Array:
    """Return places -0.5..0.5 [DRAWS] that spread draws over a step, which does not tell when a load begins in it."""
    return shuffled(DRAWS) - 0.5


def samples(belief: Belief) -> Array:
    """Return columns [9, DRAWS] of the belief, shared out to its members by their weights; soc kept within 0..1.02.

    They are made with the symmetric root of the covariance, which moves when the covariance does and not with the signs
    that a decomposition happens to give its vectors.
    """
    member = _shared_out(belief.weights)
    used, place = np.unique(member, return_inverse=True)
    values, vectors = np.linalg.eigh(belief.covariances[used])
    root = (vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    columns = belief.means[member].T + np.einsum("nij,jn->in", root[place], normals())
    columns[X.SOC] = np.clip(columns[X.SOC], 0.0, 1.02)
    return np.asarray(columns)


def _shared_out(weights: Array) -> Array:
    """Return the member of each draw [DRAWS], by fixed ranks, so that few draws change when the weights change."""
    found = np.searchsorted(np.cumsum(weights / weights.sum()), shuffled(weights.size) - 1e-12)
    return np.asarray(np.minimum(found, weights.size - 1))


def assigned(weight: Array) -> Array:
    """Return the index of the load scenario of each draw [DRAWS], in proportion to the weights."""
    return np.asarray(np.searchsorted(np.cumsum(weight / weight.sum()), shuffled(weight.size) - 1e-12))
