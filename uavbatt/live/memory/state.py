"""The file of the saved state: written atomically every few seconds, read once at the start.

    {"version", "boot_id", "monotonic_s", "wall_s", "is_clock_set", "battery_sha256", "link",
     "vehicle": {"system", "component", "hardware"}, "parameters": {...}, "told": "...", "batteries": {id: {...}}}

Within one boot its age comes from the boot's clock. Across boots it comes from the wall clock, if that was set both
times: a computer without a battery-backed clock goes on with the old time after hours without power. A state that is
damaged, too old, of another battery file or of another process (with another endpoint) is not resumed, and the reason
is given.
"""

from __future__ import annotations

import ctypes
import json
import sys
from pathlib import Path
from typing import Annotated, Any, Generic, NamedTuple, TypeVar

import msgspec

from uavbatt.files import atomic_write

VERSION = 16
MOST_BYTES = 1_000_000
BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
HARDWARE_CLOCKS = Path("/sys/class/rtc")
CLOCKS_AGREE_S = 5.0
RELEASED_S = 1.7e9  # 2023: a clock that shows an earlier time was never set
UNSYNCHRONISED = 5  # TIME_ERROR of adjtimex(2)
LARGEST_PARAMETER = 3.5e38  # of 32 bits

Byte = Annotated[int, msgspec.Meta(ge=0, le=255)]
Time = Annotated[float, msgspec.Meta(ge=0.0, le=1e11)]
Name = Annotated[str, msgspec.Meta(max_length=64)]
Parameter = Annotated[float, msgspec.Meta(ge=-LARGEST_PARAMETER, le=LARGEST_PARAMETER)]
Battery = TypeVar("Battery")


class SavedVehicle(msgspec.Struct, frozen=True, kw_only=True):
    """SavedVehicle identifies the vehicle of the saved batteries: the autopilot's address, its serial number if
    known."""

    system: Byte
    component: Byte
    hardware: Name = ""


class SavedState(msgspec.Struct, Generic[Battery], frozen=True, kw_only=True):
    """SavedState holds the file's content without its time; `battery_sha256` and `link` are those of the process.

    told : the frames in which the vehicle told parameters, home and mission (`Vehicle.told`)
    """

    battery_sha256: Name
    link: Annotated[str, msgspec.Meta(max_length=1000)]
    vehicle: SavedVehicle
    parameters: Annotated[dict[Name, Parameter], msgspec.Meta(max_length=1000)]
    told: Annotated[bytes, msgspec.Meta(max_length=MOST_BYTES)] = b""
    batteries: Annotated[dict[Annotated[str, msgspec.Meta(pattern="^[0-9]{1,3}$")], Battery],
                         msgspec.Meta(max_length=256)]  # fmt: skip


class Clock(msgspec.Struct, frozen=True, kw_only=True):
    """Clock holds one instant by all clocks of this computer; `boot_id` is empty if the computer has none."""

    boot_id: str
    monotonic_s: Time
    wall_s: Time
    is_clock_set: bool


class _Written(msgspec.Struct, frozen=True, kw_only=True):
    version: int


class FoundState(NamedTuple, Generic[Battery]):
    """FoundState holds the state and its age [s], or None and the reason; the reason is empty if there is no file."""

    state: SavedState[Battery] | None
    age_s: float
    why_not: str


def clock(monotonic_s: float, wall_s: float, is_clock_set: bool) -> Clock:
    """Return the instant by all clocks, with the identity of this boot."""
    return Clock(boot_id=boot_id(), monotonic_s=monotonic_s, wall_s=wall_s, is_clock_set=is_clock_set)


def boot_id() -> str:
    """Return the identity of this boot of the computer; empty if it has none."""
    try:
        return BOOT_ID.read_text(encoding="ascii").strip()
    except OSError:
        return ""


def is_clock_set(wall_s: float) -> bool:
    """Return True if the wall clock is set: the kernel says that it is synchronised, or a hardware clock agrees."""
    if not sys.platform.startswith("linux"):
        return wall_s > RELEASED_S  # computers without a battery-backed clock run Linux
    return wall_s > RELEASED_S and (_is_synchronised() or any(_agrees(clock, wall_s) for clock in _hardware_clocks()))


def _is_synchronised() -> bool:
    try:
        said = ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(1024))  # struct timex, modes = 0: only asks
    except (OSError, AttributeError):
        return False
    return 0 <= int(said) < UNSYNCHRONISED


def _hardware_clocks() -> list[Path]:
    try:
        return sorted(HARDWARE_CLOCKS.iterdir())
    except OSError:
        return []


def _agrees(hardware_clock: Path, wall_s: float) -> bool:
    try:
        shown_s = int((hardware_clock / "since_epoch").read_text(encoding="ascii"))
    except (OSError, ValueError):
        return False
    return abs(shown_s - wall_s) <= CLOCKS_AGREE_S


def write_state(path: Path, content: SavedState[Any], now: Clock) -> None:
    """Save the state atomically. Raises OSError or UavbattError if it cannot be written."""
    head = {"version": VERSION, **msgspec.to_builtins(now)}
    with atomic_write(path) as file:
        json.dump({**head, **msgspec.to_builtins(content)}, file, allow_nan=True)


def read_state(
    path: Path, kind: type[Battery], now: Clock, *, max_age_s: float, battery_sha256: str, link: str
) -> FoundState[Battery]:
    """Return the state in `path` if this process may resume it at `now`; `kind` is the type of a battery in it."""

    def none(why: str) -> FoundState[Battery]:
        return FoundState(None, 0.0, why)

    try:
        with path.open("rb") as file:
            raw = file.read(MOST_BYTES + 1)
    except FileNotFoundError:
        return none("")
    except OSError as error:
        return none(f"saved state cannot be read: {error.strerror}")
    if len(raw) > MOST_BYTES:
        return none(f"saved state is damaged: larger than {MOST_BYTES // 1_000_000} MB")
    try:
        content = json.loads(raw)
        if msgspec.convert(content, _Written).version != VERSION:
            return none("saved state is of another version")
        was, found = msgspec.convert(content, Clock), msgspec.convert(content, SavedState[kind])  # type: ignore[valid-type]
    except RecursionError:
        return none("saved state is damaged: too deeply nested")
    except Exception as error:  # no content of the file may end the process
        return none(f"saved state is damaged: {' '.join(str(error).split())[:200]}")
    if found.battery_sha256 != battery_sha256:
        return none("saved state is of another battery file")
    if found.link != link:
        return none(f"saved state is of another process, which listened on {found.link}")
    age_s, why_not = _age(was, now)
    if not why_not and not 0.0 <= age_s <= max_age_s:
        why_not = f"saved state is {age_s:.0f} s old"
    return none(why_not) if why_not else FoundState(found, age_s, "")


def _age(was: Clock, now: Clock) -> tuple[float, str]:
    """Return the age [s] and "", or 0 and the reason why the age is unknown."""
    if was.boot_id and was.boot_id == now.boot_id:
        return now.monotonic_s - was.monotonic_s, ""
    if was.is_clock_set and now.is_clock_set:
        return now.wall_s - was.wall_s, ""
    return 0.0, "the computer was started anew, and its clock is not set: the age of the saved state is unknown"
