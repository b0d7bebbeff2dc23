"""One pack as JSON, to carry it from one ledger to another: its flights, out of which all else follows."""

from __future__ import annotations

import json
import math
from dataclasses import fields
from pathlib import Path
from typing import Any

import msgspec

from uavbatt.errors import BadInput, misread
from uavbatt.packs.ledger import Ledger
from uavbatt.packs.records import FlightRecord

FORMAT, VERSION = "uavbatt-pack", 1
KIND = "a pack as `uavbatt packs --export` writes it"


class PackFile(msgspec.Struct, frozen=True):
    """A pack with its flights."""

    format: str
    version: int
    name: str
    flights: list[dict[str, Any]]


def exported(ledger: Ledger, name: str) -> dict[str, Any]:
    """The pack of that name as plain values. Raises BadInput when there is none."""
    found = ledger.flights(name)
    if not found:
        raise BadInput(ledger.path, "", f"a pack named {name}, found {_names(ledger)}")
    flights = [plain_flight(after.flight) for after in found]
    return {"format": FORMAT, "version": VERSION, "name": name, "flights": flights}


def imported(ledger: Ledger, path: Path) -> str:
    """Save the flights of a pack's file; flights that are there already count once. Returns the pack's name."""
    try:
        content = msgspec.json.decode(path.read_bytes(), type=PackFile)
        flights = [flight_of(entry) for entry in content.flights]
    except OSError as error:
        raise BadInput(path, "", f"{KIND}, cannot be read: {error.strerror}") from None
    except (msgspec.DecodeError, RecursionError) as error:
        raise misread(path, error, KIND) from None
    if (content.format, content.version) != (FORMAT, VERSION) or not flights:
        raise BadInput(path, "", f"{KIND}, version {VERSION}, with at least one flight")
    for number, flight in enumerate(flights, 1):
        if why_not := _implausible(flight):
            raise BadInput(path, f"flight {number}", why_not)
    ledger.save_all(content.name, flights)
    return content.name


def plain_flight(flight: FlightRecord) -> dict[str, Any]:
    """A flight as plain values; what is not known is left out."""
    values = {f.name: getattr(flight, f.name) for f in fields(flight)}
    values["told"] = list(flight.told)
    return {k: v for k, v in values.items() if v is not None and not (isinstance(v, float) and math.isnan(v))}


def flight_of(entry: dict[str, Any]) -> FlightRecord:
    """The flight that `plain_flight` made plain; msgspec.ValidationError when it is none."""
    return msgspec.convert(entry, FlightRecord, strict=False)


def _implausible(flight: FlightRecord) -> str:
    """Return what of a flight cannot be; empty when it may be one."""
    told = flight.told
    if not (1e-5 < math.exp(min(told.log_ohm, 50.0)) < 10.0 and 0.01 < math.exp(min(told.log_Ah, 50.0)) < 1e4):
        return "ohms and ampere-hours of a pack"
    if not (told.variance_ohm > 0.0 and told.variance_Ah * told.variance_ohm > told.covariance**2):
        return "variances above zero, and a covariance that they allow"
    if not (flight.rated_Ah > 0.0 and flight.type_ohm > 0.0 and flight.cells > 0):
        return "cells, a rated capacity and a resistance above zero"
    return ""


def _names(ledger: Ledger) -> str:
    names = [pack.name for pack in ledger.packs()]
    shown = ", ".join(names[:10]) + (", ..." if len(names) > 10 else "")
    return shown or "no packs at all"


def text_of(pack: dict[str, Any]) -> str:
    """A pack's file as text."""
    return json.dumps(pack, indent=1, ensure_ascii=False) + "\n"
