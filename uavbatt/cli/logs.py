"""The log that a command is asked to read: one battery of it, or all of them as one pack."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uavbatt.errors import UsageError

if TYPE_CHECKING:
    from uavbatt.records import Flight

InstanceOption = Annotated[int | None, typer.Option("--instance", min=0, help="Battery instance.")]
JoinOption = Annotated[str, typer.Option("--join", help="parallel or series: all batteries of the log as one pack.")]


def asked_flight(log: Path, instance: int | None, join: str) -> Flight:
    """The flight as the options ask for it; UsageError when they contradict each other or the log."""
    from uavbatt.telemetry import read_log
    from uavbatt.telemetry.join import Wiring, read_joined

    if not join:
        return read_log(log, instance)
    if join not in tuple(Wiring):
        raise UsageError(f"--join {join}: expected parallel or series")
    if instance is not None:
        raise UsageError("--instance names one battery and --join takes them all: expected one of the two")
    return read_joined(log, Wiring(join))
