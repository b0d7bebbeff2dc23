"""Rows -> Parquet and CSV, a thousand at a time: the tables may be bigger than the memory.

A spreadsheet executes a cell that begins with `=`, `+`, `-` or `@`. Names of folders and hardware come from strangers:
such a cell gets an apostrophe in front in the CSV, which tells the spreadsheet that it is text.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from datetime import datetime
from itertools import islice
from pathlib import Path
from typing import Any

from uavbatt.files import atomic_write
from uavbatt.fleet.logs import TABLE
from uavbatt.fleet.row import COLUMNS, FlightRow

PARQUET, CSV = "flights.parquet", TABLE
_BATCH = 1000  # rows in memory at one time
_TIME = "start_utc"
_TEXTS = tuple(name for name, kind in COLUMNS if kind == "str" and name != _TIME)
_RUN = ("=", "+", "-", "@", "\t", "\r", "\n")


def write_tables(folder: Path, rows: Iterable[FlightRow]) -> None:
    """Write both tables into `folder`, each whole or not at all; unknown is null, an empty cell in the CSV."""
    import pyarrow
    from pyarrow import csv, parquet

    schema = _schema(pyarrow)
    with ExitStack() as stack:
        files = [stack.enter_context(atomic_write(folder / name, "wb")) for name in (PARQUET, CSV)]
        writers = [
            stack.enter_context(parquet.ParquetWriter(files[0], schema)),
            stack.enter_context(csv.CSVWriter(files[1], schema)),
        ]
        for batch in _batches(rows):
            columns = {name: [_encodable(line[name]) for line in batch] for name, _ in COLUMNS}
            columns[_TIME] = [datetime.fromisoformat(text) if text else None for text in columns[_TIME]]
            writers[0].write_table(pyarrow.Table.from_pydict(columns, schema=schema))
            harmless = columns | {name: [_harmless(text) for text in columns[name]] for name in _TEXTS}
            writers[1].write_table(pyarrow.Table.from_pydict(harmless, schema=schema))


def _encodable(value: Any) -> Any:
    """Return text that can be encoded: a file name may hold bytes that are no text."""
    return value.encode("utf-8", "replace").decode() if isinstance(value, str) else value


def _harmless(text: str) -> str:
    """Return the cell in a form that no spreadsheet executes."""
    return f"'{text}" if text.startswith(_RUN) else text


def _schema(pyarrow: Any) -> Any:
    types = {"str": pyarrow.string(), "float": pyarrow.float64(), "int": pyarrow.int64(), "bool": pyarrow.bool_()}
    times = pyarrow.timestamp("s", tz="UTC")
    return pyarrow.schema(
        [(name, times if name == _TIME else types[kind.removesuffix(" | None")]) for name, kind in COLUMNS]
    )


def _batches(rows: Iterable[FlightRow]) -> Iterator[list[dict[str, Any]]]:
    unread = iter(rows)
    while batch := [row.plain() for row in islice(unread, _BATCH)]:
        yield batch
