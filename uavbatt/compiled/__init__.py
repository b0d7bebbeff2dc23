"""The engine compiled: the same recursions as in numpy, by numba (the extra `fast`), over arrays of rows.

    estimator = Estimator(battery, engine=compiled.engine())

The commands whose work is long hand it in (`log_replay.run.engine_for`); the live process never does. Nothing else
imports this package, so that it may be deleted. Loading compiled code takes half a second, making it ten to twenty.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from uavbatt.compiled.cache import is_available

if TYPE_CHECKING:
    from uavbatt.engine import Engine

__all__ = ["engine", "is_available"]


def engine() -> Engine:
    """Return the engine whose functions are compiled. Raises ImportError where numba is not installed."""
    from uavbatt.compiled import filter, forecast, openloop
    from uavbatt.engine import Engine

    return Engine(filter.filter_window, forecast.answers, openloop.states)
