"""The ledger that a fleet's rows fill: the same as by replaying the logs one by one, in whatever order."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable

from uavbatt.errors import UavbattError
from uavbatt.fleet.row import FlightRow
from uavbatt.packs.exchange import flight_of
from uavbatt.packs.ledger import Ledger
from uavbatt.packs.records import FlightRecord


def fill(ledger: Ledger, rows: Iterable[FlightRow]) -> tuple[int, list[str]]:
    """Save what the rows' flights taught of their packs; how many flights, and why packs were left out."""
    taught: dict[str, list[FlightRecord]] = defaultdict(list)
    for row in rows:
        if row.taught:
            taught[row.battery_serial].append(flight_of(json.loads(row.taught)))
    saved, left_out = 0, []
    for name, flights in sorted(taught.items()):
        try:
            saved += len(ledger.save_all(name, flights))
        except UavbattError as error:
            left_out.append(str(error))
    return saved, left_out
