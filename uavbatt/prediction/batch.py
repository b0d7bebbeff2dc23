"""Questions: the simulations that forecasts need, one at a time in flight, many side by side in a replay.

The questions of a flight do not depend on each other's answers. A step of arithmetic on 2000 columns costs little more
than one on 128, so that a replay that works on many questions together is several times faster, with the same numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import groupby
from typing import NamedTuple

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.prediction.route.forecast import RouteQuestion, WaysState
from uavbatt.prediction.simulation import sampling
from uavbatt.prediction.simulation.draws import Flying
from uavbatt.prediction.simulation.time_to_end import COUNTED, EndTimes, counted, time_to_end
from uavbatt.prediction.take_off import AtTakeOff

SIDE_BY_SIDE = 16  # more questions do not fit into the cache


class Question(NamedTuple):
    """Question holds one forecast to simulate: the flying packs, from `time_s` [s] on, up to the horizon."""

    time_s: float
    horizon_s: float
    flying: Flying
    unresolved_s: float = 0.0  # length of a step within which the power may change
    at_take_off: AtTakeOff | None = None  # the expectation at take-off
    route: RouteQuestion | None = None  # the part about the route and the way home
    ways: WaysState = WaysState()  # when that part was worked out last


Answers = Callable[[Sequence[Question]], list[EndTimes]]


def end_times(flying: Flying, enough: float = COUNTED) -> EndTimes:
    """Simulate one forecast and return when each draw ends [s]; `enough` is that of `time_to_end.counted`."""
    drawn = sampling.wander(flying.dt_s.size, flying.by_rows)
    return counted(time_to_end(flying, drawn, sampling.least_soc(flying), enough=enough), enough)


def answers(questions: Sequence[Question]) -> list[EndTimes]:
    """Simulate many forecasts of one pack side by side and return the ends of each, as `end_times` gives them."""
    found: list[EndTimes] = []
    every = (question.flying for question in questions)
    for _, alike in groupby(every, key=lambda flying: (flying.by_rows, flying.reserve_soc)):
        queue = list(alike)
        for first in range(0, len(queue), SIDE_BY_SIDE):
            found += _together(queue[first : first + SIDE_BY_SIDE])
    return found


def _together(few: list[Flying]) -> list[EndTimes]:
    """Simulate several forecasts in one batch [forecasts, draws].

    A shorter one is padded with its last step, which has no effect.
    """
    if len(few) == 1:  # in flight: one dimension less
        return [end_times(few[0])]
    steps = max(q.dt_s.size for q in few)

    def on(values: Iterable[Array]) -> Array:
        """Return [steps, forecasts, ...]: shorter ones go on with their last step."""
        every = list(values)
        out = np.empty((steps, len(every), *every[0].shape[1:]))
        for n, value in enumerate(every):
            out[: value.shape[0], n], out[value.shape[0] :, n] = value, value[-1]
        return out

    def each(values: Iterable[float]) -> Array:
        return np.array([*values])[:, None]

    drawn = sampling.wander(steps, few[0].by_rows)
    together = few[0]._replace(
        pack=few[0].pack._replace(cutoff_V=each(q.pack.cutoff_V for q in few), low_V=each(q.pack.low_V for q in few)),
        x=np.stack([q.x for q in few], axis=1),
        power_W=on(q.power_W for q in few),
        ambient_C=each(q.ambient_C for q in few),
        dt_s=on(q.dt_s for q in few)[:, :, None],
    )
    beside = sampling.Normals(drawn.bias[:, None], drawn.row[:, None])
    ends = time_to_end(together, beside, sampling.least_soc(few[0]), each(q.dt_s.size for q in few), COUNTED)
    return [EndTimes(*pair) for pair in zip(*counted(ends), strict=True)]
