"""The battery file `NAME.battery.toml`: the model of one type of battery, and the evidence for it.

Sections: [battery], [parameters], [[effects]], [discrepancy], [corridor], [certificate]. The certificate's
`content_sha256` is the hash of the canonical JSON of everything else except the date and the tool's version: an
integrity check that detects every edit. It is not a signature.

A file whose hash does not match, or whose gate failed, is refused. If the user allows it all the same, its status is
`edited` from then on, and every output names the status.
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
from typing import Any

import msgspec
import tomli_w

from uavbatt import __version__
from uavbatt.battery.effects import EFFECTS
from uavbatt.battery.sections import (
    HIGHEST_CELL_V,
    LOWEST_CELL_V,
    Battery,
    BatteryFile,
    Certificate,
    CorridorSection,
    Discrepancy,
    EffectEntry,
    ParameterTable,
    Verdict,
    Wander,
)
from uavbatt.errors import BadInput, Uncertified, misread
from uavbatt.files import atomic_write, read_bounded, without_none

__all__ = [
    "Battery",
    "BatteryFile",
    "Certificate",
    "CorridorSection",
    "Discrepancy",
    "EffectEntry",
    "ParameterTable",
    "Verdict",
    "Wander",
    "content_hash",
    "packaged",
    "read_battery",
    "sealed",
    "write_battery",
]

SUFFIX = ".battery.toml"
GENERIC, GENERIC_LITHIUM_ION = "lipo-generic", "liion-generic"  # the packaged files of typical cells
MOST_BYTES = 5_000_000
EMPTY_KNOT, FULL_KNOT = 0.2, 0.8  # beyond its outer knots the open-circuit voltage goes on straight
STEEPEST_V = 300.0  # volts per unit of charge: an emptied cell falls by 10 to 100


def is_generic(name: str) -> bool:
    """Return True if a battery file of this name is a packaged one of typical cells, of no one make."""
    return name in (GENERIC, GENERIC_LITHIUM_ION)


def content_hash(file: BatteryFile) -> str:
    """Return the SHA-256 of the canonical JSON of everything but the hash itself, the date and the tool's version."""
    content: dict[str, Any] = msgspec.to_builtins(file)
    for key in ("content_sha256", "date", "tool_version"):
        del content["certificate"][key]
    # Keys that older files do not know are left out where they are empty, so that the hashes of those files stand.
    if file.parameters.spread_flights is None:
        del content["parameters"]["spread_flights"]
    wander = file.discrepancy.wander
    if wander is None:
        del content["discrepancy"]["wander"]
    else:
        for key in ("coldest_C", "start_soc"):
            if content["discrepancy"]["wander"][key] is None:
                del content["discrepancy"]["wander"][key]
    canonical = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(canonical.encode()).hexdigest()


def sealed(file: BatteryFile) -> BatteryFile:
    """Return the file with today's date, this version and the hash of its content."""
    dated = msgspec.structs.replace(file.certificate, date=date.today().isoformat(), tool_version=__version__)
    dated = msgspec.structs.replace(dated, content_sha256=content_hash(file))
    return msgspec.structs.replace(file, certificate=dated)


def write_battery(file: BatteryFile, path: Path) -> Path:
    """Seal and write the file, whole or not at all; returns the path.

    Raises BadInput, and writes nothing, when `read_battery` would refuse what is in it.
    """
    content = without_none(msgspec.to_builtins(sealed(file)))
    _check_values(_decoded(tomli_w.dumps(content).encode(), str(path)), str(path))
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path, "wb") as stream:
        tomli_w.dump(content, stream)
    return path


def read_battery(name_or_path: str | Path, *, allow_uncertified: bool = False) -> BatteryFile:
    """Read a packaged battery by name (`lpab-3s`) or a file by path.

    Raises BadInput when it is missing or malformed, Uncertified when its hash does not match its content, a verdict is
    `fail` or its status is `edited`; `allow_uncertified` lets it through, and its status is `edited` then.
    """
    text, origin = _text(str(name_or_path))
    file = _decoded(text, origin)
    _check_values(file, origin)
    problem = _why_uncertified(file)
    if problem and not allow_uncertified:
        raise Uncertified(f"{origin}: {problem}; give --allow-uncertified to use it anyway")
    return _let_through(file) if problem else file


def _decoded(text: bytes, origin: str) -> BatteryFile:
    try:
        return msgspec.toml.decode(text, type=BatteryFile)
    except (msgspec.MsgspecError, ValueError, OverflowError, RecursionError) as error:
        raise misread(origin, error, "a battery file (see docs/formats.md)") from None


def _why_uncertified(file: BatteryFile) -> str:
    """Return the reason why the certificate is not valid; empty if it is valid."""
    if file.certificate.content_sha256 != content_hash(file):
        return (
            "certificate.content_sha256: expected the hash of the file's content, so the file was edited after it was "
            "written"
        )
    for verdict in file.certificate.verdicts:
        if verdict.verdict == "fail":
            return f"certificate verdict `{verdict.claim}`: expected pass, it is fail"
    return "certificate.status: expected certified, fitted or generic, it is edited" if file.status == "edited" else ""


def _let_through(file: BatteryFile) -> BatteryFile:
    """Return the file with the status `edited`; claims about other content are removed, failed claims stay."""
    actual = content_hash(file)
    if file.certificate.content_sha256 != actual:
        certificate = msgspec.structs.replace(file.certificate, verdicts=[], statistics={}, validated_ambient_C=[])
    else:
        certificate = file.certificate
    edited = msgspec.structs.replace(certificate, status="edited", content_sha256=actual)
    return msgspec.structs.replace(file, certificate=edited)


def packaged() -> list[str]:
    """Return the names of the battery files that come with the package."""
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
        raise BadInput(path, "", "a battery file, found no file of this name")
    return read_bounded(path, MOST_BYTES, "a battery file"), str(path)


def _check_values(file: BatteryFile, origin: str) -> None:
    """Raise BadInput unless the numbers are finite and possible, and the arrays ascend and fit each other."""
    for place, number in _numbers(msgspec.to_builtins(file)):
        if not math.isfinite(number):
            raise BadInput(origin, place, f"a finite number, found {number}")
    _check_tables(file.parameters, origin)
    for name in ("cutoff_V", "low_V"):
        volts = getattr(file.battery, name)
        if volts is not None and not LOWEST_CELL_V <= volts / file.battery.cells_series <= HIGHEST_CELL_V:
            limits = f"{LOWEST_CELL_V:g} to {HIGHEST_CELL_V:g} V for each of {file.battery.cells_series} cells"
            raise BadInput(origin, f"battery.{name}", f"{limits}, found {volts:g} V for the pack")
    wander = file.discrepancy.wander
    if wander is not None and not _is_table(wander.soc, wander.voltage_sd_V):
        raise BadInput(origin, "discrepancy.wander.soc", "ascending knots, as many as in voltage_sd_V")
    corridor = file.corridor
    if corridor is not None and not len(corridor.time_s) == len(corridor.mean_V) == len(corridor.limit_V):
        raise BadInput(origin, "corridor", "time_s, mean_V and limit_V of one length")
    for entry in file.effects:
        _check_effect(entry, origin)


def _is_table(knots: list[float], values: list[float]) -> bool:
    """Return True if the knots ascend and each has a value."""
    return len(knots) == len(values) and all(a < b for a, b in pairwise(knots))


def _check_tables(table: ParameterTable, origin: str) -> None:
    """Raise BadInput unless the tables over the charge ascend, fit each other, and have an OCV that a cell can have."""
    for axis, values in (("ocv_soc", "ocv_V"), ("resistance_soc", "resistance_ohmAh")):
        if not _is_table(getattr(table, axis), getattr(table, values)):
            raise BadInput(origin, f"parameters.{axis}", f"ascending knots, as many as in {values}")
    if table.ocv_soc[0] > EMPTY_KNOT or table.ocv_soc[-1] < FULL_KNOT:
        raise BadInput(origin, "parameters.ocv_soc", f"knots from {EMPTY_KNOT} or below to {FULL_KNOT} or above")
    if any(b <= a for a, b in pairwise(table.ocv_V)):
        raise BadInput(origin, "parameters.ocv_V", "a voltage that rises with the charge")
    knots = zip(pairwise(table.ocv_soc), pairwise(table.ocv_V), strict=True)
    if any((d - c) > STEEPEST_V * (b - a) for (a, b), (c, d) in knots):
        expected = f"no step steeper than {STEEPEST_V:g} V per unit of charge"
        raise BadInput(origin, "parameters.ocv_V", expected)


def _check_effect(entry: EffectEntry, origin: str) -> None:
    effect = EFFECTS.get(entry.name)
    if effect is None:
        raise BadInput(origin, f"effects: {entry.name}", f"one of {', '.join(EFFECTS)}")
    bounds = {q.name: (q.low, q.high) for q in effect.quantities}
    for name, value in entry.parameters.items():
        if name not in bounds:
            raise BadInput(origin, f"effects: {entry.name}.{name}", f"one of {', '.join(bounds)}")
        if not bounds[name][0] <= value <= bounds[name][1]:
            raise BadInput(origin, f"effects: {entry.name}.{name}", f"a value in {bounds[name]}, found {value}")


def _numbers(value: Any, place: str = "") -> Iterator[tuple[str, float]]:
    """Yield every float of the content with its place in the file."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _numbers(inner, f"{place}.{key}" if place else key)
    elif isinstance(value, list):
        for inner in value:
            yield from _numbers(inner, place)
    elif isinstance(value, float):
        yield place, value
