"""Fallback from compiled functions to their numpy form, for a numba that cannot compile them."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba.core import errors

Function = TypeVar("Function", bound=Callable[..., Any])
# The second is no NumbaError, and numba 0.60 does not have it.
CANNOT_COMPILE = (errors.NumbaError, getattr(errors, "UnsupportedBytecodeError", errors.NumbaError))


def plain_where_it_fails(fast: Function, plain: Function) -> Function:
    """Return `fast`, which is replaced by `plain` for good at the first call that numba cannot compile.

    A version of numba that is newer than this code may not understand a part of it. Nothing is lost then but time.
    """
    chosen: Callable[..., Any] = fast

    @functools.wraps(fast)
    def run(*given: Any) -> Any:
        nonlocal chosen
        try:
            return chosen(*given)
        except CANNOT_COMPILE:
            chosen = plain
            return plain(*given)

    return cast(Function, run)
