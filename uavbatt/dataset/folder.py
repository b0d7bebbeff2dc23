"""The discharge data-set folder: how it is read into values, and a template of it.

A data set is a folder with `battery.toml` (what was tested) and `discharge.csv` (what was read), columns
`sample,run,ambient_c,time_s,voltage_v,current_a,surface_c`; an empty cell means not measured. `flags.toml`
may name suspect entries. Nothing is repaired: an impossible value is refused with its file and line.
"""

from __future__ import annotations

import hashlib
import json
import math
import tomllib
from difflib import get_close_matches
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec

from uavbatt.dataset.checks import check_runs
from uavbatt.dataset.discharge_csv import read_runs
from uavbatt.dataset.records import Array, DataSet, Flag, Positive, Run, Uncertainty
from uavbatt.errors import BadInput
from uavbatt.files import atomic_write
from uavbatt.limits import CAPACITY_AH, capacity_doubt, ending_doubt

TEMPLATE_FILES = ("battery.toml", "discharge.csv")
_T = TypeVar("_T", bound=msgspec.Struct)


class _Battery(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    name: Annotated[str, msgspec.Meta(min_length=1)]
    chemistry: str
    cells_series: Annotated[int, msgspec.Meta(ge=1, le=100)]
    cutoff_V: Positive
    load: str
    source: str
    capacity_Ah: Positive | None = None
    uncertainty: Uncertainty = Uncertainty()


class _Flags(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    flag: list[Flag] = []


def load(path: str | Path | None = None) -> DataSet:
    """Read the data-set folder `path`; None = the packaged study. Raises BadInput for what cannot be right in it."""
    root: Traversable = resources.files("uavbatt") / "data" / "study" if path is None else Path(path)
    shown = "packaged study" if path is None else str(path)
    if not root.is_dir():
        found = "a file" if root.is_file() else "nothing"
        raise BadInput(shown, "", f"a folder with battery.toml and discharge.csv, found {found}")
    missing = " and ".join(n for n in ("battery.toml", "discharge.csv") if not (root / n).is_file())
    if missing:
        raise BadInput(shown, "", f"a folder with battery.toml and discharge.csv; {missing} missing")
    battery = _decode(root / "battery.toml", f"{shown}/battery.toml", _Battery)
    _check_name(battery.name, f"{shown}/battery.toml")
    _check_numbers(battery, f"{shown}/battery.toml")
    shown_csv = f"{shown}/discharge.csv"
    runs = read_runs(_text(root / "discharge.csv", shown_csv), shown_csv, battery.cells_series)
    check_runs(runs, math.nan if battery.capacity_Ah is None else battery.capacity_Ah, battery.cutoff_V, shown_csv)
    has_flags = (root / "flags.toml").is_file()
    flags = _decode(root / "flags.toml", f"{shown}/flags.toml", _Flags).flag if has_flags else []
    facts = {f: getattr(battery, f) for f in battery.__struct_fields__}
    return DataSet(**facts, runs=runs, sha256=_digest(battery, runs), path=shown, flags=tuple(flags))


def _check_numbers(battery: _Battery, shown: str) -> None:
    """Raise BadInput for a capacity, or a cut-off of so many cells, that no pack has."""
    if battery.capacity_Ah is not None and capacity_doubt(battery.capacity_Ah) is not None:
        slip = " (mAh?)" if battery.capacity_Ah > CAPACITY_AH[1] else ""
        raise BadInput(shown, "key capacity_Ah", f"ampere-hours, found {battery.capacity_Ah:g}{slip}")
    doubt = ending_doubt("", battery.cutoff_V, battery.cells_series)
    if doubt is not None and doubt.is_certain:
        raise BadInput(shown, "key cutoff_V", f"the voltage of the whole pack: {doubt.words}")


def _check_name(name: str, shown: str) -> None:
    """Raise BadInput for a name that would take the battery file that it names to another folder."""
    if name.startswith(".") or not name.isprintable() or any(mark in name for mark in "/\\"):
        said = "the name of a file: printable, without / and \\, and without a point in front"
        raise BadInput(shown, "key name", f"{said}, found {name!r}")


def write_template(folder: Path) -> None:
    """Write a template of a data set: `battery.toml` with every key explained, and a `discharge.csv` of a few rows.

    Raises BadInput if one of the two files exists.
    """
    root = resources.files("uavbatt") / "data" / "template"
    for name in TEMPLATE_FILES:
        if (folder / name).exists():
            raise BadInput(folder / name, "", "a folder without it: a template overwrites nothing")
    folder.mkdir(parents=True, exist_ok=True)
    for name in TEMPLATE_FILES:
        with atomic_write(folder / name) as file:
            file.write((root / name).read_text("utf-8"))


def _text(file: Traversable, shown: str) -> str:
    try:
        return file.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise BadInput(shown, f"byte {error.start}", "text in UTF-8") from None


def _decode(file: Traversable, shown: str, kind: type[_T]) -> _T:
    try:
        table = tomllib.loads(_text(file, shown))
        absent = [f.name for f in msgspec.structs.fields(kind) if f.required and f.name not in table]
        if absent:
            keys = "keys" if len(absent) > 1 else "key"
            said = "them to be there, they are missing" if len(absent) > 1 else "it to be there, it is missing"
            raise BadInput(
                shown, f"{keys} {', '.join(absent)}", f"{said} (`uavbatt validate --template DIR` shows all)"
            )
        return msgspec.convert(table, kind)
    except tomllib.TOMLDecodeError as error:
        raise BadInput(shown, "", f"TOML: {error}") from None
    except msgspec.ValidationError as error:
        place, expected = _explain(str(error), kind)
        raise BadInput(shown, place, expected) from None


def _explain(message: str, kind: type[Any]) -> tuple[str, str]:
    """Return the key and what was expected of it, from a message of msgspec."""
    text, _, where = message.partition(" - at `$")
    section = where.strip("`.")
    key = text.split("`")[1] if text.count("`") >= 2 else ""
    if "missing required field" in text:
        return f"key {key}", "it to be there, it is missing"
    if "unknown field" in text:
        inner = Flag if kind is _Flags else Uncertainty
        known = inner.__struct_fields__ if section else kind.__struct_fields__
        near = get_close_matches(key, known, 1)
        hint = f"a known key, did you mean {near[0]}?" if near else f"one of {', '.join(known)}"
        return f"key {section + '.' if section else ''}{key}", hint
    return f"key {section}", text.removeprefix("Expected ")


def _digest(battery: _Battery, runs: tuple[Run, ...]) -> str:
    """Return the SHA-256 of the content; line ends, order of columns, comments and number formats do not change it."""

    def plain(values: Array) -> list[float | None]:
        return [None if math.isnan(v) else float(v) for v in values]

    columns = ("time_s", "voltage_V", "current_A", "surface_C")
    table = [[r.sample, r.run, r.ambient_C, *(plain(getattr(r, c)) for c in columns)] for r in runs]
    content = {"battery": msgspec.to_builtins(battery), "runs": table}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()
