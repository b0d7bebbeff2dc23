"""The engine compiled: the same recursions as in numpy, by numba (the extra `fast`), over arrays of rows.

    estimator = Estimator(battery, engine=compiled.engine())

The commands whose work is long hand it in (`log_replay.run.engine_for`); the live process never does. Nothing else
imports this package, so that it may be deleted. Loading compiled code takes half a second, making it ten to twenty.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar, cast

from uavbatt.compiled.cache import is_available

if TYPE_CHECKING:
    from uavbatt.engine import Engine

__all__ = ["engine", "is_available"]

Function = TypeVar("Function", bound=Callable[..., Any])


@functools.cache
def engine() -> Engine:
    """Return the engine whose functions are compiled, one for the process. Raises ImportError without numba."""
    from uavbatt.compiled import filter, forecast, openloop
    from uavbatt.engine import PLAIN, Engine

    fast = Engine(filter.filter_window, forecast.answers, openloop.states)
    return Engine(
        plain_where_it_fails(fast.filter_window, PLAIN.filter_window),
        plain_where_it_fails(fast.answers, PLAIN.answers),
        plain_where_it_fails(fast.states, PLAIN.states),
    )


def plain_where_it_fails(fast: Function, plain: Function) -> Function:
    """Return `fast`, which is replaced by `plain` for good at the first call that numba cannot compile.

    A version of numba that is newer than this code may not understand a part of it. Nothing is lost then but time.
    """
    from numba.core.errors import NumbaError, UnsupportedBytecodeError

    chosen: Callable[..., Any] = fast

    @functools.wraps(fast)
    def run(*given: Any) -> Any:
        nonlocal chosen
        try:
            return chosen(*given)
        except (NumbaError, UnsupportedBytecodeError):
            chosen = plain
            return plain(*given)

    return cast(Function, run)
