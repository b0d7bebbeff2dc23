"""The discharge data-set folder: how it is read into values, and a template of it.

A data set is a folder with `battery.toml` (what was tested) and `discharge.csv` (what was read), columns
`sample,run,ambient_c,time_s,voltage_v,current_a,surface_c`; an empty cell means not measured. `flags.toml`
may name suspect entries. Nothing is repaired: an impossible value is refused with its file and line.
A run is one (sample, run, ambient) triple; its occasion is its run number.
"""

from __future__ import annotations

import hashlib
import json
import math
import tomllib
from dataclasses import dataclass
from difflib import get_close_matches
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
import numpy as np

from uavbatt.dataset_checks import check_runs
from uavbatt.dataset_csv import MIN_POINTS, Array, read_runs
from uavbatt.dataset_csv import Run as Run
from uavbatt.errors import BadInput
from uavbatt.files import atomic_write
from uavbatt.limits import CAPACITY_AH, capacity_doubt, ending_doubt

TEMPLATE_FILES = ("battery.toml", "discharge.csv")
QUANTITIES = ("voltage_V", "surface_C", "current_A")
_T = TypeVar("_T", bound=msgspec.Struct)
_Positive = Annotated[float, msgspec.Meta(gt=0)]


class Uncertainty(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Uncertainty states the standard uncertainties and resolutions of the instruments; None = not stated."""

    voltage_resolution_V: _Positive | None = None
    voltage_calibration_V: _Positive | None = None
    current_resolution_A: _Positive | None = None
    current_calibration_A: _Positive | None = None
    reading_time_s: _Positive | None = None
    temperature_resolution_C: _Positive | None = None
    temperature_calibration_C: _Positive | None = None


class Flag(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Flag marks a suspect entry: where, what is printed, what it likely is, and why. It is never applied."""

    where: str
    kind: str
    reason: str
    printed: str = ""
    likely: str = ""
    sample: str | None = None
    run: int | None = None
    ambient_C: float | None = None
    time_s: float | None = None
    column: str | None = None


class _Battery(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    name: Annotated[str, msgspec.Meta(min_length=1)]
    chemistry: str
    cells_series: Annotated[int, msgspec.Meta(ge=1, le=100)]
    cutoff_V: _Positive
    load: str
    source: str
    capacity_Ah: _Positive | None = None
    uncertainty: Uncertainty = Uncertainty()


class _Flags(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    flag: list[Flag] = []


@dataclass(frozen=True, slots=True)
class DataSet:
    """DataSet holds repeated discharge tests of one type of battery; `sha256` is of the content of both files."""

    name: str
    chemistry: str
    cells_series: int
    capacity_Ah: float | None
    cutoff_V: float
    load: str
    source: str
    uncertainty: Uncertainty
    runs: tuple[Run, ...]
    sha256: str
    path: str
    flags: tuple[Flag, ...] = ()

    def __repr__(self) -> str:
        """Return one line, without the tables of the runs."""
        return f"<DataSet {self.name} of {self.path}: {len(self.runs)} runs, {len(self.ambients_C)} temperatures>"

    def at(self, ambient_C: float, tolerance_C: float = 0.25) -> tuple[Run, ...]:
        """Return the runs at one ambient temperature [°C], within `tolerance_C`."""
        return tuple(r for r in self.runs if abs(r.ambient_C - ambient_C) <= tolerance_C)

    @property
    def is_metered(self) -> bool:
        """Return True if the current of most runs was measured: a model is fitted to these, and predicts these."""
        return 2 * sum(run.is_metered for run in self.runs) > len(self.runs)

    @property
    def ambients_C(self) -> tuple[float, ...]:
        """Return every ambient temperature of the set, ascending [°C]."""
        return tuple(sorted({r.ambient_C for r in self.runs}))

    @property
    def first_V(self) -> float:
        """Return the highest voltage that a run begins with [V]; NaN without runs."""
        return max((float(run.voltage_V[0]) for run in self.runs), default=float("nan"))


@dataclass(frozen=True, slots=True)
class Levels:
    """Levels holds repeated runs on a common time grid: `values[occasion, sample, time]`, NaN where there is none."""

    ambient_C: float
    quantity: str
    samples: tuple[str, ...]
    occasions: tuple[int, ...]
    time_s: Array
    values: Array
    left_out: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def cells(self, level: int) -> list[list[float]]:
        """Return the results of each sample at time index `level`, as `iso5725.precision` takes them."""
        columns = (self.values[:, j, level] for j in range(len(self.samples)))
        cells = ([float(v) for v in c if not math.isnan(v)] for c in columns)
        return [c for c in cells if c]

    def curves(self, sample: int) -> Array:
        """Return the table [occasion, time] of one sample, without occasions that it lacks."""
        table = self.values[:, sample, :]
        kept: Array = table[~np.isnan(table).any(axis=1)]
        return kept


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


def levels(
    dataset: DataSet, ambient_C: float, quantity: str = "voltage_V", grid_s: Array | None = None
) -> Levels | None:
    """Return the samples repeated at `ambient_C` as a table [occasion, sample, time]; None if nothing was measured.

    Samples with a single run there are left out when others have more, and named in `left_out`. The grid is
    that of the shortest run (or `grid_s` [s] within it); runs on other times are interpolated linearly.
    """
    if quantity not in QUANTITIES:
        raise ValueError(f"quantity {quantity!r}: expected one of {', '.join(QUANTITIES)}")
    runs = [r for r in dataset.at(ambient_C) if np.sum(~np.isnan(getattr(r, quantity))) >= MIN_POINTS]
    counts = {s: sum(r.sample == s for r in runs) for s in dict.fromkeys(r.sample for r in runs)}
    samples = tuple(s for s, n in counts.items() if n > 1) or tuple(counts)
    used = [r for r in runs if r.sample in samples]
    if not used:
        return None
    spans = {id(r): r.time_s[~np.isnan(getattr(r, quantity))][[0, -1]] for r in used}
    shortest = min(used, key=lambda r: float(spans[id(r)][1]))
    begin, end = max(float(s[0]) for s in spans.values()), float(spans[id(shortest)][1])
    grid = shortest.time_s if grid_s is None else np.asarray(grid_s, dtype=float)
    grid = grid[(grid >= begin) & (grid <= end)]
    if not len(grid):
        return None
    occasions = tuple(sorted({r.run for r in used}))
    values = np.full((len(occasions), len(samples), len(grid)), math.nan)
    for run in used:
        y = getattr(run, quantity)
        known = ~np.isnan(y)
        where = (occasions.index(run.run), samples.index(run.sample))
        values[where] = np.interp(grid, run.time_s[known], y[known])
    longest = max(float(s[1]) for s in spans.values())
    uneven = f"runs end between {end:g} s and {longest:g} s; compared up to {end:g} s"
    notes = (uneven,) if longest > end else ()
    left_out = tuple(f"sample {s} (one run)" for s in counts if s not in samples)
    return Levels(ambient_C, quantity, samples, occasions, grid, values, left_out, notes)


def whole_minutes(dataset: DataSet, ambient_C: float, quantity: str = "voltage_V") -> Levels | None:
    """Return `levels` at the whole minutes when the runs were read more often than that, else as read."""
    table = levels(dataset, ambient_C, quantity)
    if table is None or len(table.time_s) < 2 or float(np.median(np.diff(table.time_s))) >= 60:
        return table
    first = math.ceil(float(table.time_s[0]) / 60)
    last = math.floor(float(table.time_s[-1]) / 60)
    minutes = np.array([60.0 * m for m in range(first, last + 1)])
    return levels(dataset, ambient_C, quantity, minutes) if len(minutes) >= MIN_POINTS else table
