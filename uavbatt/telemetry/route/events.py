"""Route and place of a log as events in order of time, fed to a `NavigationBuilder`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from heapq import merge
from typing import Any

from uavbatt.telemetry.columns import Column
from uavbatt.telemetry.route.builder import NavigationBuilder
from uavbatt.telemetry.route.settings import NAMES

Event = tuple[float, Callable[..., None], tuple[Any, ...]]  # (time [s], what takes it, its arguments)


def play(events: Iterable[Event], parameters: Iterable[tuple[float, str, float]], builder: NavigationBuilder) -> None:
    """Feed events and parameters (time [s], name, value) to the builder, merged by their times."""
    said: list[Event] = [(at_s, builder.parameter, (name, value)) for at_s, name, value in parameters if name in NAMES]
    for time_s, take, arguments in merge(said, events, key=lambda event: event[0]):
        take(time_s, *arguments)


def one_each(time_s: Column, step_s: float) -> list[int]:
    """Return the places of the first reading, and of each that comes `step_s` [s] or more after the last one taken."""
    taken, next_s = [], -math.inf
    for place, at_s in enumerate(time_s.tolist()):
        if at_s >= next_s:
            taken.append(place)
            next_s = at_s + step_s
    return taken
