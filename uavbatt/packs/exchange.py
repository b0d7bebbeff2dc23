"""One pack as JSON, to move it from one ledger to another: its flights, from which everything else is worked out."""

from __future__ import annotations

import json
import math
from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from uavbatt.errors import BadInput, misread
from uavbatt.files import read_bounded
from uavbatt.packs.bounds import doubt_of
from uavbatt.packs.ledger import Ledger, check_name
from uavbatt.packs.records import FlightRecord

FORMAT, VERSION = "uavbatt-pack", 1
MOST_BYTES = 50_000_000  # of a pack: a flight takes about a thousand
KIND = "a pack as `uavbatt packs --export` writes it"


class PackFile(msgspec.Struct, frozen=True):
    """A PackFile holds a pack with its flights, as its JSON file has them."""

    format: str
    version: int
    name: str
    flights: list[dict[str, Any]]


def plain_pack(ledger: Ledger, name: str) -> dict[str, Any]:
    """Return the pack of that name as plain values. Raises BadInput when there is none."""
    found = ledger.flights(name)
    if not found:
        raise BadInput(ledger.path, "", f"a pack named {name}, found {_names(ledger)}")
    flights = [plain_flight(after.flight) for after in found]
    return {"format": FORMAT, "version": VERSION, "name": name, "flights": flights}


class ImportedPack(NamedTuple):
    """An ImportedPack holds a pack that was read from its file and checked."""

    name: str
    flights: tuple[FlightRecord, ...]


def read_pack(path: Path) -> ImportedPack:
    """Read a pack's file. Raises BadInput that names the value that no ledger can hold."""
    try:
        content = msgspec.json.decode(read_bounded(path, MOST_BYTES, KIND), type=PackFile)
        flights = tuple(flight_of(entry) for entry in content.flights)
    except (msgspec.DecodeError, RecursionError) as error:
        raise misread(path, error, KIND) from None
    if (content.format, content.version) != (FORMAT, VERSION) or not flights:
        raise BadInput(path, "", f"{KIND}, version {VERSION}, with at least one flight")
    check_name(content.name, path, "key name")
    for number, flight in enumerate(flights, 1):
        if doubt := doubt_of(flight):
            raise BadInput(path, f"flight {number}, key {doubt[0]}", doubt[1])
        if flight.cells != flights[0].cells:
            said = f"{flights[0].cells} as in the first flight, found {flight.cells}"
            raise BadInput(path, f"flight {number}, key cells", said)
    return ImportedPack(content.name, flights)


def import_pack(ledger: Ledger, pack: ImportedPack) -> str:
    """Save the flights of a pack, and return its name; flights that are there already count once."""
    ledger.save_all(pack.name, pack.flights)
    return pack.name


def plain_flight(flight: FlightRecord) -> dict[str, Any]:
    """Return a flight as plain values; what is not known is left out."""
    values = {f.name: getattr(flight, f.name) for f in fields(flight)}
    values["told"] = list(flight.told)
    return {k: v for k, v in values.items() if v is not None and not (isinstance(v, float) and math.isnan(v))}


def flight_of(entry: dict[str, Any]) -> FlightRecord:
    """Return the flight that `plain_flight` made plain. Raises msgspec.ValidationError when it is none."""
    return msgspec.convert(entry, FlightRecord, strict=False)


def _names(ledger: Ledger) -> str:
    names = [pack.name for pack in ledger.packs()]
    shown = ", ".join(names[:10]) + (", ..." if len(names) > 10 else "")
    return shown or "no packs at all"


def text_of(pack: dict[str, Any]) -> str:
    """Return the text of a pack's file."""
    return json.dumps(pack, indent=1, ensure_ascii=False) + "\n"
