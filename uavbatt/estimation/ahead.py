"""Many rows in one go: what `SocFilter.step` gives row by row, worked out before it is asked.

Compiled (`estimation.compiled`) where that pays; else as ever, only without filterpy, and the voltages to expect within
the blocks, which nothing depends on, are worked out all at once at the end.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from uavbatt import fast
from uavbatt.battery import state_space as b
from uavbatt.estimation.recursion import (
    BLOCK_S,
    NOTHING,
    Begun,
    Block,
    Moments,
    Postponed,
    Shown,
    Standing,
    is_complete,
)
from uavbatt.records import Sample

if TYPE_CHECKING:
    from uavbatt.estimation.filter import SocFilter

PLAIN_ROW_S, PLAIN_BLOCK_S = 6e-6, 200e-6  # measured: a row, and a block closed


class Row(NamedTuple):
    """A row, and the filter after it."""

    sample: Sample
    moments: Moments | None
    time_s: float
    shown: Shown


def rows(filter: SocFilter, samples: Sequence[Sample]) -> list[Row]:
    """Take `samples` in; the filter stands after the last of them."""
    blocks = min(len(samples), (samples[-1].time_s - samples[0].time_s) / BLOCK_S) if samples else 0
    if fast.pays(PLAIN_ROW_S * len(samples) + PLAIN_BLOCK_S * blocks, "filter"):
        return by_twin(filter, samples)
    return by_numpy(filter, samples)


def by_numpy(filter: SocFilter, samples: Sequence[Sample]) -> list[Row]:
    """Row by row; the expected voltages of the rows within blocks afterwards."""
    postponed: list[Postponed] = []
    found: list[Row] = []
    places: list[int] = []
    filter.postponed = postponed
    moments, time_s = filter.standing.moments, filter.standing.time_s
    for sample in samples:
        shown = filter.take(sample)
        if len(places) < len(postponed):
            places.append(len(found))
        moments = filter.standing.moments
        if math.isfinite(shown.soc):
            time_s = sample.time_s
        found.append(Row(sample, moments, time_s, shown))
    filter.postponed = None
    if postponed:
        expected_V = _expected_V(filter, postponed)
        for k, volts, row in zip(places, expected_V, postponed, strict=True):
            shown = found[k].shown._replace(innovation_V=row.voltage_V - volts, expected_V=volts)
            found[k] = found[k]._replace(shown=shown)
    return found


def _expected_V(filter: SocFilter, postponed: list[Postponed]) -> list[float]:
    """Voltages that the rows should have shown, by the members' weights."""
    x = np.array([p.x for p in postponed])
    rows, members, _ = x.shape
    current_A = np.repeat([p.current_A for p in postponed], members)
    volts = b.voltage(filter.pack, x.reshape(rows * members, -1).T, current_A).reshape(rows, members)
    return [float(v) for v in np.sum(volts * np.array([p.weight for p in postponed]), axis=1)]


def by_twin(filter: SocFilter, samples: Sequence[Sample]) -> list[Row]:
    """All at once."""
    from uavbatt.battery.compiled import as_numbers
    from uavbatt.estimation import compiled

    before = filter.standing
    first = next((s for s in samples if is_complete(s)), None)
    if first is None:
        return [Row(s, before.moments, before.time_s, NOTHING) for s in samples]
    if before.moments is None:
        filter.start(first)
    now = filter.standing
    assert now.moments is not None
    table = np.array([[s.time_s, s.voltage_V, s.current_A, s.temp_C] for s in samples]).T.copy()
    begun = Begun(now.time_s, now.current_A, now.block_A, before.moments is None, np.array(now.block, dtype=float))
    *beliefs, in_force, shown, end = compiled.run(as_numbers(filter.pack), now.ambient_C, table, begun, *now.moments)
    fast.is_made("filter")
    every = [Moments(*belief) for belief in zip(*beliefs, strict=True)]
    held = [before.moments, *every[1:]]
    time_s, found = before.time_s, []
    for sample, k, row in zip(samples, in_force.tolist(), shown.tolist(), strict=True):
        time_s = sample.time_s if math.isfinite(row[3]) else time_s
        found.append(Row(sample, held[k], time_s, Shown(*row)))
    at_s, current_A, block_A, _, block = end
    filter.standing = Standing(every[-1], at_s, current_A, block_A, Block(*block.tolist()), now.ambient_C)
    return found
