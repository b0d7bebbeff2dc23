"""`uavbatt.toml`, the configuration of the companion process. Every key has a default; scripts/uavbatt.toml has all.

It is read from --config, else $UAVBATT_CONFIG, else /etc/uavbatt/uavbatt.toml if that exists. Options of the command
line override it. An unknown key, a wrong type or an impossible value is an error that names the file and the key.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from uavbatt.errors import BadInput, UsageError
from uavbatt.files import read_bounded
from uavbatt.limits import AMBIENT_C, CAPACITY_AH, MOST_CELLS

SYSTEM_FILE = Path("/etc/uavbatt/uavbatt.toml")
MOST_BYTES = 1_000_000  # of a configuration or a key
LOOPBACK = ("127.0.0.1", "localhost", "::1")
FeedKind = Literal["proxy", "battery", "named"]

Byte = Annotated[int, msgspec.Meta(ge=0, le=255)]
Component = Annotated[int, msgspec.Meta(ge=1, le=255)]
MOST = sys.float_info.max  # infinity is not allowed: the process gets its configuration as JSON, which has none
Positive = Annotated[float, msgspec.Meta(gt=0, le=MOST)]
Rate = Annotated[float, msgspec.Meta(gt=0, le=50)]
Share = Annotated[float, msgspec.Meta(ge=0, le=0.99)]


class Section(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Section is a section of the file: immutable, and unknown keys are errors."""


class LinkSection(Section, frozen=True):
    """[link] says where the telemetry comes from and where the ground stations are."""

    endpoint: str = ""
    gcs: list[str] = []
    system: Byte | None = None
    component: Component | None = None
    own_component: Component = 193
    request: bool = False
    request_rate_Hz: Rate = 10.0
    request_mission: bool = False
    clock: bool = True  # measure the delay of frames by the vehicle's clock; off for a simulation that runs slowly
    signing_key_file: str = ""


class PackSection(Section, frozen=True):
    """[pack] describes the battery; an absent value comes from the vehicle, then from the battery file."""

    battery: str = "lipo-generic"
    instance: Byte | None = None
    cells: Annotated[int, msgspec.Meta(ge=1, le=MOST_CELLS)] | None = None
    capacity_Ah: Annotated[float, msgspec.Meta(ge=CAPACITY_AH[0], le=CAPACITY_AH[1])] | None = None
    cutoff_voltage_V: Positive | None = None
    reserve_soc: Share = 0.0
    ambient_C: Annotated[float, msgspec.Meta(ge=AMBIENT_C[0], le=AMBIENT_C[1])] | None = None
    vehicle: str = ""
    load: str = "learned"
    mission: str = ""
    forecast_period_s: Annotated[float, msgspec.Meta(ge=0.1, le=MOST)] = 1.0
    allow_uncertified: bool = False


class PacksSection(Section, frozen=True):
    """[packs] names the pack ledger; empty file: no ledger. Without a name the pack is known by its serial number."""

    file: str = ""
    name: str = ""


class FeedSection(Section, frozen=True):
    """[feed] says how the time left is sent to the ground station."""

    kinds: tuple[FeedKind, ...] = ("named",)
    named_rate_Hz: Rate = 4.0
    battery_rate_Hz: Rate = 4.0
    alarms_s: tuple[Positive, ...] = (300.0, 120.0, 60.0)
    proxy_soc: bool = False
    proxy_control: str = ""


class HttpSection(Section, frozen=True):
    """[http] says where the page for a browser is served; empty: none."""

    listen: str = ""
    token: str = ""


class RecordSection(Section, frozen=True):
    """[record] says where raw telemetry and estimates are recorded; empty folder: nowhere."""

    folder: str = ""
    when: Literal["always", "while-armed"] = "always"
    max_file_MB: Positive = 200.0
    max_files: Annotated[int, msgspec.Meta(ge=1)] = 50
    min_free_MB: Annotated[float, msgspec.Meta(ge=0, le=MOST)] = 500.0


class StateSection(Section, frozen=True):
    """[state] says where the state is saved, from which the process goes on after a crash; empty file: nowhere."""

    file: str = ""
    period_s: Positive = 5.0
    max_age_s: Annotated[float, msgspec.Meta(gt=0, le=86_400)] = 600.0


class Config(Section, frozen=True):
    """Config holds all sections of the file."""

    link: LinkSection = LinkSection()
    pack: PackSection = PackSection()
    packs: PacksSection = PacksSection()
    feed: FeedSection = FeedSection()
    http: HttpSection = HttpSection()
    record: RecordSection = RecordSection()
    state: StateSection = StateSection()


def read_config(path: Path | None = None) -> Config:
    """Return the configuration in `path`, else in $UAVBATT_CONFIG, else in SYSTEM_FILE, else the defaults.

    Raises BadInput, which names the file and the key.
    """
    named = path if path is not None else _named()
    if named is None:
        return Config()
    text = read_bounded(named, MOST_BYTES, "a configuration file")
    try:
        return msgspec.toml.decode(text, type=Config)
    except msgspec.ValidationError as error:
        raise _misread(named, str(error)) from None
    except (msgspec.DecodeError, ValueError, RecursionError) as error:  # no UTF-8, too deeply nested
        raise BadInput(named, "", f"TOML: {error}") from None


def _misread(path: Path, said: str) -> BadInput:
    """Return the error for a key or a value that the configuration does not know, from a message of msgspec."""
    from difflib import get_close_matches

    what, _, place = said.partition(" - at `$.")
    key = place.rstrip("`")
    if "unknown field `" not in what:
        expected = what.removeprefix("Expected ") if what.startswith("Expected ") else what
        return BadInput(path, f"key {key}" if key else "", f"{expected}, as in scripts/uavbatt.toml")
    unknown = what.split("`")[1]
    section = next((f.type for f in msgspec.structs.fields(Config) if f.name == key), Config)
    near = get_close_matches(unknown, section.__struct_fields__, 1, 0.5)
    hint = f"a known key, did you mean {near[0]}?" if near else f"one of {', '.join(section.__struct_fields__)}"
    return BadInput(path, f"key {key}.{unknown}" if key else f"key {unknown}", hint)


def _named() -> Path | None:
    if "UAVBATT_CONFIG" in os.environ:
        return Path(os.environ["UAVBATT_CONFIG"])
    return SYSTEM_FILE if SYSTEM_FILE.exists() else None


def checked(config: Config) -> Config:
    """Return the configuration if its parts fit together. Raises UsageError, in words, if they do not."""
    if not config.link.endpoint:
        raise UsageError("no ENDPOINT: name one, or set link.endpoint in uavbatt.toml")
    for kind in ("proxy", "battery"):
        if kind in config.feed.kinds and not config.link.gcs:
            raise UsageError(f"feed {kind}: expected --gcs ENDPOINT, where the ground station is")
    if config.packs.name and not config.packs.file:
        raise UsageError(f"--pack {config.packs.name}: expected --packs FILE as well, the file of the pack ledger")
    if config.http.listen:
        host, _ = address(config.http.listen)
        if host not in LOOPBACK and len(config.http.token) < 8:
            raise UsageError(
                f"--http {config.http.listen}: an address that others can reach needs http.token "
                "(8 characters or more) in uavbatt.toml"
            )
    return config


def address(text: str) -> tuple[str, int]:
    """Return host and port of HOST:PORT; a bare :PORT or PORT is this host. Raises UsageError for anything else."""
    host, _, port = text.rpartition(":")
    if not port.isdigit() or not 0 <= int(port) < 65536:
        raise UsageError(f"--http {text}: expected HOST:PORT")
    return host.strip("[]") or "127.0.0.1", int(port)


def page_address(text: str) -> str:
    """Return the address of the page for a browser, from HOST:PORT, :PORT or PORT."""
    host, port = address(text)
    return f"http://[{host}]:{port}/" if ":" in host else f"http://{host}:{port}/"


def signing_key(path: str) -> bytes | None:
    """Return the 32-byte key in `path` (64 hexadecimal digits), None without a path; BadInput for any other file."""
    if not path:
        return None
    try:
        key = bytes.fromhex(read_bounded(Path(path), MOST_BYTES, "64 hexadecimal digits").decode("ascii").strip())
    except ValueError as error:
        raise BadInput(path, "", f"64 hexadecimal digits: {error}") from None
    if len(key) != 32:
        raise BadInput(path, "", f"64 hexadecimal digits, found {2 * len(key)}")
    return key
