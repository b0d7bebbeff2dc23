"""`--mission` and `--wind`: a mission file that is flown from its home, and the wind on the way."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uavbatt.errors import UsageError
from uavbatt.records import NAN

if TYPE_CHECKING:
    from uavbatt.navigation import Home, Wind
    from uavbatt.telemetry.formats.mission_file import PlannedFlight

WindOption = Annotated[
    str | None,
    typer.Option("--wind", metavar="SPEED@FROM_DEG", help="With --mission: 6@270 is a wind of 6 m/s from west."),
]
FASTEST_WIND_MS = 100.0


def check_wind(wind: str | None, mission: Path | None) -> None:
    """Raise UsageError for a wind without a mission."""
    if wind is not None and mission is None:
        raise UsageError("--wind: expected --mission FILE as well: without a route there is no airspeed")


def stated_wind(text: str | None) -> Wind:
    """Return the wind of `SPEED@FROM_DEG` [m/s, degrees from north, where it comes from]; None is no wind.

    Raises UsageError for any other text.
    """
    from uavbatt.navigation import Wind

    if text is None:
        return Wind(0.0, 0.0)
    speed, at, bearing = text.partition("@")
    try:
        speed_ms, from_rad = float(speed), math.radians(float(bearing))
    except ValueError:
        speed_ms, from_rad = NAN, NAN
    if not (at and 0.0 <= speed_ms <= FASTEST_WIND_MS and math.isfinite(from_rad)):
        raise UsageError(f"--wind {text}: expected SPEED@FROM_DEG, as 6@270 (6 m/s from the west)")
    return Wind(-speed_ms * math.cos(from_rad), -speed_ms * math.sin(from_rad))


def mission_from_home(path: Path) -> tuple[PlannedFlight, Home]:
    """Return the content of a mission file, and its home. Raises UsageError if the file does not tell its home."""
    from uavbatt.telemetry.formats.mission_file import read_mission

    read = read_mission(path)
    if read.home is None:
        raise UsageError(f"--mission {path}: expected the place of home in it")
    return read, read.home
