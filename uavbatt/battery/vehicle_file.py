"""The vehicle file `NAME.vehicle.toml`: the power that one aircraft draws, learned from its past flights.

It holds the mean power by phase, and the power traces of past flights with their state of charge, so that a forecast
can use how this aircraft went on from the same point.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Annotated

import msgspec
import tomli_w
from msgspec.structs import replace

from uavbatt.battery.powers import Powers
from uavbatt.errors import BadInput, misread
from uavbatt.files import atomic_write, read_bounded, without_none
from uavbatt.navigation import STATED_MS, UNSTATED, ReturnSettings

SUFFIX = ".vehicle.toml"
MOST_BYTES, MOST_POINTS, MOST_TRACES = 50_000_000, 100_000, 10_000

Watts = Annotated[float, msgspec.Meta(ge=0.0, le=1e6)]
Seconds = Annotated[float, msgspec.Meta(ge=0.0, le=1e6)]
Share = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
Speed = Annotated[float, msgspec.Meta(ge=STATED_MS[0], le=STATED_MS[1])]
Height = Annotated[float, msgspec.Meta(ge=0.0, le=10_000.0)]
Points = msgspec.Meta(min_length=2, max_length=MOST_POINTS)


class Trace(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Trace holds one past flight from take-off to landing: time since take-off [s], power [W], state of charge."""

    time_s: Annotated[list[Seconds], Points]
    power_W: Annotated[list[Watts], Points]
    soc: Annotated[list[Share], Points]


class Phases(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Phases holds the mean power [W] over the flights: of the first minute, the whole, the last minute."""

    take_off_W: Watts
    flight_W: Watts
    last_minute_W: Watts


class Speeds(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """Speeds holds the speeds of routes and of the way home by the vehicle's parameters; None if not known.

    The names are those of `navigation.ReturnSettings`.
    """

    cruise_ms: Speed | None = None
    climb_ms: Speed | None = None
    descent_ms: Speed | None = None
    return_height_m: Height | None = None
    return_ms: Speed | None = None
    return_hold_s: Seconds | None = None
    land_ms: Speed | None = None
    land_fast_ms: Speed | None = None
    land_slow_below_m: Height | None = None


class VehicleFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """VehicleFile holds the whole vehicle file; its powers are those of `batteries` batteries together."""

    name: str
    battery: str
    phases: Phases
    traces: Annotated[list[Trace], msgspec.Meta(max_length=MOST_TRACES)]
    source: str = ""
    powers: Powers | None = None  # over airspeed and climb; None where no flight told them
    speeds: Speeds | None = None
    batteries: Annotated[int, msgspec.Meta(ge=1, le=100)] = 1

    def of_batteries(self, count: int) -> VehicleFile:
        """Return the file with the powers of `count` batteries together, of which each gives the same."""
        share = count / self.batteries
        if share == 1.0:
            return self
        watts = {name: share * value for name, value in msgspec.to_builtins(self.phases).items()}
        return replace(
            self,
            batteries=count,
            phases=Phases(**watts),
            traces=[replace(trace, power_W=[share * value for value in trace.power_W]) for trace in self.traces],
            powers=self.powers and replace(self.powers, hover_W=share * self.powers.hover_W),
        )

    @property
    def usual(self) -> ReturnSettings:
        """Return its speeds and heights, for a vehicle that does not state them itself."""
        return ReturnSettings(**msgspec.to_builtins(self.speeds)) if self.speeds is not None else UNSTATED

    def __repr__(self) -> str:
        """Return one line, without the thousands of points of past flights."""
        return f"<VehicleFile {self.name}: {len(self.traces)} flights, {self.phases.flight_W:.0f} W>"


def write_vehicle(file: VehicleFile, path: Path) -> Path:
    """Write the file, whole or not at all; returns the path.

    Raises BadInput, and writes nothing, when `read_vehicle` would refuse what is in it.
    """
    content = without_none(msgspec.to_builtins(file))
    _checked(tomli_w.dumps(content).encode(), path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path, "wb") as stream:
        tomli_w.dump(content, stream)
    return path


def read_vehicle(path: str | Path) -> VehicleFile:
    """Read and check a vehicle file; raises BadInput with the file and the place."""
    source = Path(path)
    if not source.exists():
        raise BadInput(path, "", "a vehicle file, found no file of this name")
    return _checked(read_bounded(source, MOST_BYTES, "a vehicle file"), path)


def _checked(text: bytes, path: str | Path) -> VehicleFile:
    try:
        file = msgspec.toml.decode(text, type=VehicleFile)
    except (msgspec.MsgspecError, ValueError, OverflowError, RecursionError) as error:
        raise misread(path, error, "a vehicle file") from None
    if not file.traces:
        raise BadInput(path, "traces", "at least one past flight")
    for number, trace in enumerate(file.traces):
        if not len(trace.time_s) == len(trace.power_W) == len(trace.soc):
            raise BadInput(path, f"traces[{number}]", "time_s, power_W and soc of one length")
        if any(b <= a for a, b in pairwise(trace.time_s)):
            raise BadInput(path, f"traces[{number}].time_s", "ascending times")
        if max(trace.power_W) <= 0.0:
            raise BadInput(path, f"traces[{number}].power_W", "the powers of a flight, found none above 0 W")
    return file
