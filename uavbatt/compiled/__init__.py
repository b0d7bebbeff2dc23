"""The engine compiled: the same recursions as in numpy, by numba (the extra `fast`), over arrays of rows.

    estimator = Estimator(battery, engine=compiled.engine())

The commands whose work is long hand it in (`log_replay.run.engine_for`); the live process never does. Nothing else
imports this package, so that it may be deleted. Loading compiled code takes half a second, making it ten to twenty.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

from uavbatt.compiled.cache import is_available

if TYPE_CHECKING:
    from uavbatt.engine import Engine

__all__ = ["engine", "is_available"]


@functools.cache
def engine() -> Engine:
    """Return the engine whose functions are compiled, one for the process. Raises ImportError without numba."""
    from uavbatt.compiled import filter, forecast, openloop
    from uavbatt.compiled.fallback import plain_where_it_fails
    from uavbatt.engine import PLAIN, Engine

    return Engine(
        plain_where_it_fails(filter.filter_window, PLAIN.filter_window),
        plain_where_it_fails(forecast.answers, PLAIN.answers),
        plain_where_it_fails(openloop.states, PLAIN.states),
    )
