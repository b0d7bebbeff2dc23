"""numba compiles the very functions of `equations`, `model`, `pack` and `state_space`, never a copy of them.

numba is told to compile each of them from its own source where compiled code calls it (`register_jitable`), for the
numbers of one column instead of arrays of them. What numba does not know of named tuples (`_replace`, properties) is
said here once, for all of them. So a function of the model may use what both numpy and numba understand of single
numbers: ufuncs, `np.minimum`, branches, `math`; what is told apart by type (`equations.is_on`) has its twin here.
"""

from __future__ import annotations

from collections.abc import Callable
from types import FunctionType, ModuleType
from typing import Any, TypeVar

import numba
import numpy as np
from numba import types
from numba.extending import overload, overload_attribute, overload_method, register_jitable

from uavbatt.battery import equations, model, pack, state_space
from uavbatt.battery.pack import Installation
from uavbatt.compiled.cache import cache_dir

Function = TypeVar("Function", bound=Callable[..., Any])
REPLACED = ("resistance_gain", "transfer_V", "capacity_Ah", "soc")  # the fields that the model replaces in its records
OWN_TWIN = (equations.is_on,)


def share(module: ModuleType) -> None:
    """Let compiled code call every function that a module defines."""
    for function in list(vars(module).values()):
        if isinstance(function, FunctionType) and function.__module__ == module.__name__ and function not in OWN_TWIN:
            laid_in(function)


def laid_in(function: Function) -> Function:
    """Return `function`, which compiled code may call from now on: it is compiled as a part of the caller."""
    made: Function = register_jitable(function)
    return made


def compiled(function: Function) -> Function:
    """Return `function` compiled at its first call and kept in the cache folder; it divides by zero as numpy does."""
    return _compiled(function)


def compiled_numbers(function: Function) -> Function:
    """Return `function`, which makes no array and returns none, compiled to run two to three times as fast.

    numba counts the references to the tables in a record at each call. Nobody has to count where no array is made: then
    the functions of the model are laid into each other, and what is not asked for is not worked out.
    """
    return _compiled(function, _nrt=False)


def _compiled(function: Function, **options: bool) -> Function:
    before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(cache_dir() or "")
    try:
        made: Function = numba.njit(cache=True, error_model="numpy", **options)(function)
    finally:
        numba.config.CACHE_DIR = before
    return made


def as_numbers(record: Any) -> Any:
    """Return a record with floats and arrays of floats only, so that one compiled form serves every pack."""
    if type(record) is float:  # nearly all of them
        return record
    if isinstance(record, bool | np.bool_):
        return bool(record)
    if isinstance(record, tuple):
        values = [as_numbers(value) for value in record]
        return type(record)(*values) if hasattr(record, "_fields") else tuple(values)
    if np.ndim(record):
        return np.ascontiguousarray(record, dtype=float)
    return float(record)


def _replace(record: Any, **given: Any) -> Any:
    """Return the source of `record._replace(...)` for the given fields: a call of the record's class."""
    stated = {name for name, value in given.items() if value is not None and not isinstance(value, types.Omitted)}
    values = ", ".join(name if name in stated else f"record.{name}" for name in record.instance_class._fields)
    return _defined(f"return made({values})", made=record.instance_class)


def _defined(body: str, **names: Any) -> Any:
    scope = dict(names)
    exec(f"def replaced(record, {', '.join(f'{name}=None' for name in REPLACED)}):\n    {body}", scope)
    return scope["replaced"]


overload_method(types.BaseNamedTuple, "_replace")(
    _defined(f"return generate(record, {', '.join(f'{name}={name}' for name in REPLACED)})", generate=_replace)
)
overload(equations.is_on)(lambda value: lambda value: value != 0.0)
_capacity: Any = Installation.present_capacity_Ah
overload_attribute(types.BaseNamedTuple, "present_capacity_Ah")(
    lambda self: _capacity.fget if self.instance_class is Installation else None  # its argument has no type either
)
for part in (equations, model, pack, state_space):
    share(part)
