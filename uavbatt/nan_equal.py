"""Equality of records in which a number may be unknown: an unknown number (NaN) equals an unknown number.

Python up to 3.12 compares the fields of two dataclasses as tuples, in which NaN equals itself if it is the same object;
since 3.13 it compares them one by one, and no NaN equals another.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any, TypeVar

Record = TypeVar("Record")


def nan_equal(record: type[Record]) -> type[Record]:
    """Make two records of a frozen dataclass equal if all their fields are, where NaN equals NaN."""
    names = tuple(field.name for field in fields(record) if field.compare)  # type: ignore[arg-type]

    def is_equal(self: Record, other: object) -> Any:  # a bool, or NotImplemented
        if type(other) is not type(self):
            return NotImplemented
        return self is other or all(_are_equal(getattr(self, name), getattr(other, name)) for name in names)

    def hash_of(self: Record) -> int:
        values = (getattr(self, name) for name in names)
        return hash(tuple(None if value != value else value for value in values))

    record.__eq__ = is_equal  # type: ignore[assignment, method-assign]
    record.__hash__ = hash_of  # type: ignore[assignment, method-assign]
    return record


def _are_equal(one: Any, other: Any) -> bool:
    """Return True for equal values and for two NaNs."""
    return bool(one is other or one == other or (one != one and other != other))
