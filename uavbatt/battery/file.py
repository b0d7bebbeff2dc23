"""The battery file `NAME.battery.toml`: what one type of battery can give, and why it may be believed.

Sections: [battery], [parameters], [[effects]], [discrepancy], [corridor], [certificate]. The certificate's
`content_sha256` is the hash of the canonical JSON of everything else but the date and the tool's version: an
integrity check, so that no edit goes unnoticed. It is not a signature.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator
from datetime import date
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import msgspec
import tomli_w

from uavbatt import __version__
from uavbatt.aside import written_aside
from uavbatt.battery.effects import EFFECTS
from uavbatt.errors import BadInput, Uncertified

SUFFIX = ".battery.toml"


class Record(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A section of the file: immutable, every key known."""


class Battery(Record, frozen=True):
    """[battery]: one type of pack."""

    name: str
    chemistry: str
    cells_series: int
    cutoff_V: float
    capacity_Ah: float | None = None
    low_V: float | None = None
    source: str = ""
    remarks: list[str] = []


class ParameterTable(Record, frozen=True):
    """[parameters]: the base model OCV + R0 per cell, and how far packs of the type scatter around it."""

    ocv_soc: list[float]
    ocv_V: list[float]
    resistance_soc: list[float]
    resistance_ohmAh: list[float]
    resistance_scale_sd: float
    capacity_scale_sd: float
    c_rate: float | None = None
    c_rate_sd: float | None = None
    standard_error: dict[str, float] = {}


class EffectEntry(Record, frozen=True):
    """[[effects]]: an effect that is on, with its parameters and their standard errors."""

    name: str
    parameters: dict[str, float]
    standard_error: dict[str, float] = {}


class Discrepancy(Record, frozen=True):
    """[discrepancy]: what the model leaves on effect-free data, per pack of `cells_series` cells."""

    voltage_bias_V: float
    voltage_rmse_V: float
    voltage_autocorrelation_s: float
    temperature_rmse_K: float
    held_out: bool
    source: str = ""


class Corridor(Record, frozen=True):
    """[corridor]: mean of repeated tests and its dispersion limit at one ambient temperature."""

    ambient_C: float
    time_s: list[float]
    mean_V: list[float]
    limit_V: list[float]
    runs: int
    occasions: int


class Verdict(Record, frozen=True):
    """One claim of the certificate."""

    claim: str
    verdict: Literal["pass", "fail", "not enough data"]
    ambient_C: float | None = None
    statistics: dict[str, float] = {}
    reason: str = ""


class Certificate(Record, frozen=True):
    """[certificate]: who says so, on which data."""

    status: Literal["certified", "fitted", "generic"]
    validated_ambient_C: list[float] = []
    verdicts: list[Verdict] = []
    statistics: dict[str, float] = {}
    data_sha256: str = ""
    content_sha256: str = ""
    date: str = ""
    tool_version: str = ""


class BatteryFile(Record, frozen=True):
    """The whole file."""

    battery: Battery
    parameters: ParameterTable
    effects: list[EffectEntry]
    discrepancy: Discrepancy
    certificate: Certificate
    corridor: Corridor | None = None

    @property
    def status(self) -> str:
        """`certified`, `fitted` or `generic`."""
        return self.certificate.status


def content_hash(file: BatteryFile) -> str:
    """SHA-256 of the canonical JSON of everything but the hash itself, the date and the tool's version."""
    content: dict[str, Any] = msgspec.to_builtins(file)
    for key in ("content_sha256", "date", "tool_version"):
        del content["certificate"][key]
    canonical = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(canonical.encode()).hexdigest()


def sealed(file: BatteryFile) -> BatteryFile:
    """The file with today's date, this version and the hash of its content."""
    dated = msgspec.structs.replace(file.certificate, date=date.today().isoformat(), tool_version=__version__)
    dated = msgspec.structs.replace(dated, content_sha256=content_hash(file))
    return msgspec.structs.replace(file, certificate=dated)


def write(file: BatteryFile, path: Path) -> Path:
    """Seal and write the file, whole or not at all; returns the path."""
    content = _without_none(msgspec.to_builtins(sealed(file)))
    path.parent.mkdir(parents=True, exist_ok=True)
    with written_aside(path, "wb") as stream:
        tomli_w.dump(content, stream)
    return path


def read(name_or_path: str | Path, *, allow_uncertified: bool = False) -> BatteryFile:
    """Read a packaged battery by name (`lpab-3s`) or a file by path.

    Raises BadInput when it is missing or malformed, Uncertified when its hash does not match its content or a
    verdict is `fail` (both let through by `allow_uncertified`).
    """
    text, origin = _text(str(name_or_path))
    try:
        file = msgspec.toml.decode(text, type=BatteryFile)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise BadInput(origin, _one_line(error), "a battery file (see README, `battery file`)") from None
    _check_values(file, origin)
    if allow_uncertified:
        return file
    if file.certificate.content_sha256 != content_hash(file):
        raise Uncertified(
            f"{origin}: certificate.content_sha256: expected the hash of the file's content, so the file was edited "
            "after it was written; --allow-uncertified reads it all the same"
        )
    for verdict in file.certificate.verdicts:
        if verdict.verdict == "fail":
            raise Uncertified(
                f"{origin}: certificate verdict `{verdict.claim}`: expected pass, it is fail; "
                "--allow-uncertified reads it all the same"
            )
    return file


def packaged() -> list[str]:
    """Names of the battery files that come with the package."""
    folder = resources.files("uavbatt") / "data" / "batteries"
    return sorted(entry.name.removesuffix(SUFFIX) for entry in folder.iterdir() if entry.name.endswith(SUFFIX))


def _text(name_or_path: str) -> tuple[bytes, str]:
    path = Path(name_or_path)
    if not path.exists() and "/" not in name_or_path and not name_or_path.endswith(".toml"):
        entry = resources.files("uavbatt") / "data" / "batteries" / f"{name_or_path}{SUFFIX}"
        if entry.is_file():
            return entry.read_bytes(), name_or_path
        raise BadInput(name_or_path, "", f"a battery file or one of the packaged: {', '.join(packaged())}")
    if not path.exists():
        raise BadInput(path, "", "a battery file that exists")
    if path.is_dir():
        raise BadInput(path, "", "a battery file, not a directory")
    return path.read_bytes(), str(path)


def _check_values(file: BatteryFile, origin: str) -> None:
    table = file.parameters
    for axis, values in (("ocv_soc", "ocv_V"), ("resistance_soc", "resistance_ohmAh")):
        soc, column = getattr(table, axis), getattr(table, values)
        if len(soc) != len(column) or len(soc) < 2 or sorted(set(soc)) != soc:
            raise BadInput(origin, f"parameters.{axis}", f"ascending knots, as many as in {values}")
    for place, numbers in _numbers(msgspec.to_builtins(file)):
        if not math.isfinite(numbers):
            raise BadInput(origin, place, f"a finite number, got {numbers}")
    if any(b <= a for a, b in pairwise(table.ocv_V)):
        raise BadInput(origin, "parameters.ocv_V", "a voltage that rises with the charge")
    if min(table.resistance_ohmAh) <= 0.0:
        raise BadInput(origin, "parameters.resistance_ohmAh", "positive resistances")
    if file.battery.cells_series < 1 or file.battery.cutoff_V <= 0.0:
        raise BadInput(origin, "battery", "at least one cell and a positive cutoff_V")
    for entry in file.effects:
        known = EFFECTS.get(entry.name)
        if known is None:
            raise BadInput(origin, f"effects: {entry.name}", f"one of {', '.join(EFFECTS)}")
        bounds = {q.name: (q.low, q.high) for q in known.quantities}
        for name, value in entry.parameters.items():
            if name not in bounds:
                raise BadInput(origin, f"effects: {entry.name}.{name}", f"one of {', '.join(bounds)}")
            if not bounds[name][0] <= value <= bounds[name][1]:
                raise BadInput(origin, f"effects: {entry.name}.{name}", f"a value in {bounds[name]}, got {value}")


def _numbers(value: Any, place: str = "") -> Iterator[tuple[str, float]]:
    """Every float of the content with the place it stands at."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _numbers(inner, f"{place}.{key}" if place else key)
    elif isinstance(value, list):
        for inner in value:
            yield from _numbers(inner, place)
    elif isinstance(value, float):
        yield place, value


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def _without_none(value: Any) -> Any:
    """TOML has no null: an absent key says the same."""
    if isinstance(value, dict):
        return {k: _without_none(v) for k, v in value.items() if v is not None}
    return [_without_none(v) for v in value] if isinstance(value, list) else value
