"""The vehicle file `NAME.vehicle.toml`: what one aircraft asks of its battery, learned from how it flew.

Small, numbers only: mean power by phase, and the power traces of past flights, each with its state of charge, so
that a forecast can ask "what did this aircraft do from here on?".
"""

from __future__ import annotations

from pathlib import Path

import msgspec
import tomli_w

from uavbatt.aside import written_aside
from uavbatt.errors import BadInput

SUFFIX = ".vehicle.toml"


class Trace(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One past flight from take-off to landing: time since take-off [s], power [W], state of charge."""

    time_s: list[float]
    power_W: list[float]
    soc: list[float]


class Phases(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Mean power [W] over the flights: the first minute, the whole, the last minute."""

    take_off_W: float
    flight_W: float
    last_minute_W: float


class VehicleFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The whole file."""

    name: str
    battery: str
    phases: Phases
    traces: list[Trace]
    source: str = ""


def write(file: VehicleFile, path: Path) -> Path:
    """Write the file, whole or not at all; returns the path."""
    with written_aside(path, "wb") as stream:
        tomli_w.dump(msgspec.to_builtins(file), stream)
    return path


def read(path: str | Path) -> VehicleFile:
    """Read and check a vehicle file; BadInput names the file and the place."""
    source = Path(path)
    if not source.is_file():
        raise BadInput(path, "", "a vehicle file that exists")
    try:
        file = msgspec.toml.decode(source.read_bytes(), type=VehicleFile)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise BadInput(path, " ".join(str(error).split()), "a vehicle file") from None
    if not file.traces:
        raise BadInput(path, "traces", "at least one past flight")
    for number, trace in enumerate(file.traces):
        if not len(trace.time_s) == len(trace.power_W) == len(trace.soc) >= 2:
            raise BadInput(path, f"traces[{number}]", "time_s, power_W and soc of one length, at least 2")
        if any(b <= a for a, b in zip(trace.time_s, trace.time_s[1:], strict=False)):
            raise BadInput(path, f"traces[{number}].time_s", "ascending times")
        if min(trace.power_W) < 0.0 or max(trace.power_W) <= 0.0:
            raise BadInput(path, f"traces[{number}].power_W", "powers of a flight, none negative")
    return file
