"""Samples and records that a program hands in, checked before any equation sees them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeVar

from uavbatt.errors import UsageError
from uavbatt.limits import checked_number
from uavbatt.records import Sample

Record = TypeVar("Record")
NUMBERS = ("time_s", "voltage_V", "current_A", "temp_C", "consumed_Ah", "reported_soc")


def checked_samples(samples: Iterable[Sample]) -> list[Sample]:
    """Return the samples as a list.

    Raises UsageError, which names the field, for a value that is no Sample, or whose fields are no numbers.
    """
    found = list(samples)
    for sample in found:
        if not isinstance(sample, Sample):
            raise UsageError(f"sample={sample!r:.60}: expected a Sample(time_s, voltage_V, current_A)")
        for name in NUMBERS:
            value = getattr(sample, name)
            if type(value) is not float:  # the usual case, and much quicker than a check of what can become one
                checked_number(f"sample.{name}=", value)
    return found


def checked_record(kind: type[Record], name: str, value: object) -> Record:
    """Return a record. Raises UsageError, which begins with `name`, for a value of another kind."""
    if not isinstance(value, kind):
        raise UsageError(f"{name}={value!r:.60}: expected {kind.__name__}(...)")
    return value
