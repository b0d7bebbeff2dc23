"""`--packs` and `--pack`: the pack ledger of a command that replays logs."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from uavbatt.errors import UsageError
from uavbatt.output import counted

if TYPE_CHECKING:
    from uavbatt.battery.battery_file import BatteryFile
    from uavbatt.battery.remembered import PackHealth
    from uavbatt.battery.sizing.pack_size import PackOptions
    from uavbatt.packs.ledger import Ledger
    from uavbatt.packs.records import PackFinding, PackRow
    from uavbatt.records import Flight


@dataclass(frozen=True, slots=True)
class LearnedFlight:
    """LearnedFlight says what a flight added to the ledger: lines for the user, fields for JSON."""

    lines: tuple[str, ...] = ()
    fields: dict[str, Any] = field(default_factory=dict)


class RecalledPack(NamedTuple):
    """RecalledPack holds today's health of a known pack, its size by its flights, and both in words."""

    name: str
    health: PackHealth
    cells: int
    rated_Ah: float
    words: str

    def completed(self, options: PackOptions) -> PackOptions:
        """Return the options with the size that the ledger knows, where the caller states none.

        Raises UsageError if the caller states other cells.
        """
        from uavbatt.battery.remembered import of_known_cells

        options = of_known_cells(options, self.health)
        if options.cells not in (None, self.cells):
            raise UsageError(f"--cells {options.cells}: pack {self.name} has {self.cells} by the ledger")
        if options.cells is None:
            names = options.names._replace(cells=_source(self.name))
            options = replace(options, cells=self.cells, names=names)
        return options if math.isfinite(options.capacity_Ah) else _with_capacity(options, self.name, self.rated_Ah)


@dataclass(frozen=True, slots=True)
class PackMemory:
    """PackMemory holds an open ledger, or None, and the pack name that the user stated."""

    ledger: Ledger | None
    stated: str = ""

    def health_before(self, flight: Flight, battery: BatteryFile) -> PackHealth | None:
        """Return the health of the flight's pack by its earlier flights; None if there are none."""
        from uavbatt.packs.remembering import health_before, name_of

        if self.ledger is None:
            return None
        return health_before(self.ledger, name_of(flight, self.stated), flight, battery)

    def known_size(self, flight: Flight, battery: BatteryFile, options: PackOptions) -> PackOptions:
        """Return the options with the capacity of the flight's pack by the ledger, where nobody else states one."""
        from uavbatt.battery.sizing.pack_size import why_no_capacity
        from uavbatt.packs.remembering import name_of

        name = name_of(flight, self.stated)
        if self.ledger is None or not name or not why_no_capacity(battery, options, flight.facts_at(math.inf)):
            return options
        pack = self.ledger.pack(name)
        return options if pack is None else _with_capacity(options, name, pack.rated_Ah)

    def recalled_now(self, battery: BatteryFile) -> RecalledPack | None:
        """Return the pack in --pack as it is today. Raises UsageError for a pack that is not in the ledger."""
        from uavbatt.packs.ledger import prior

        if self.ledger is None:
            return None
        if not self.stated:
            raise UsageError("--packs: expected --pack NAME as well, the pack that will fly")
        now_utc_s = time.time()
        last, pack = self.ledger.last(self.stated, now_utc_s), self.ledger.pack(self.stated)
        if last is None or pack is None:
            raise unknown_pack(self.ledger, self.stated)
        health = prior(last, now_utc_s, battery.certificate.content_sha256)
        return RecalledPack(pack.name, health, pack.cells, pack.rated_Ah, _known_words(pack))

    def learn(
        self, flight: Flight, battery: BatteryFile, options: PackOptions, health: PackHealth | None
    ) -> LearnedFlight:
        """Save the record of a flight, and say what it adds; `health` is the pack's health before the flight."""
        from uavbatt.packs.findings import ANOTHER
        from uavbatt.packs.ledger import AnotherSize
        from uavbatt.packs.remembering import flight_for_ledger, name_of

        if self.ledger is None:
            return LearnedFlight()
        name = name_of(flight, self.stated)
        if not name:
            words = "  pack       not remembered: no serial in the log; name it with --pack"
            return LearnedFlight((words,), {"pack": None})
        found = flight_for_ledger(battery, options, flight, health, time.time())
        if found.record is None:
            return LearnedFlight((f"  pack       {name}: nothing learned: {found.why_not}",), {"pack": name})
        try:
            after = self.ledger.save(name, found.record)
        except AnotherSize as error:  # another pack: its forecast did not use the ledger
            return LearnedFlight(
                (f"  pack       {name}: not remembered: {error}",), {"pack": name, "pack_findings": [ANOTHER]}
            )
        pack = self.ledger.pack(name)
        assert pack is not None
        return _learned(pack, after.findings)


def _with_capacity(options: PackOptions, name: str, rated_Ah: float) -> PackOptions:
    """Return the options with the rated capacity [Ah] that the ledger has of the pack `name`."""
    return replace(options, capacity_Ah=rated_Ah, names=options.names._replace(capacity=_source(name)))


def _source(name: str) -> str:
    """Return where a number of the pack came from, as what is said of it later spells it."""
    return f"pack {name} in the ledger "


def _learned(pack: PackRow, findings: Sequence[PackFinding]) -> LearnedFlight:
    """Return in words what is known of a pack after a flight that was saved, and the findings of that flight."""
    said = (_known_words(pack), *(finding.words for finding in findings))
    lines = tuple(f"  pack       {pack.name}: {words}" for words in said)
    kinds = [finding.kind for finding in findings]
    return LearnedFlight(lines, {"pack": pack.name, "pack_flights": pack.outlook.flights, "pack_findings": kinds})


def _known_words(pack: PackRow) -> str:
    """Return in words what the ledger knows of a pack."""
    seen = pack.outlook
    capacity = f"{seen.capacity_Ah:.2f} Ah ({seen.capacity_lo_Ah:.2f} to {seen.capacity_hi_Ah:.2f})"
    flights = counted(seen.flights, "flight")
    return f"{capacity}, {1000.0 * seen.resistance_ohm:.1f} mohm a cell; {flights} remembered"


def unknown_pack(ledger: Ledger, name: str) -> UsageError:
    """Return the error for a name that the ledger does not have."""
    return UsageError(f"--pack {name}: expected a pack of {ledger.path}, found none of that name")


@contextmanager
def open_memory(packs: Path | None, pack: str = "", *, only_read: bool = False) -> Iterator[PackMemory]:
    """Open the ledger that the options name, for a block. Raises UsageError for a name without a ledger."""
    if packs is None:
        if pack:
            raise UsageError(f"--pack {pack}: expected --packs FILE as well, the file of the pack ledger")
        yield PackMemory(None)
        return
    from uavbatt.packs.ledger import Ledger

    with Ledger(packs, only_read=only_read) as ledger:
        yield PackMemory(ledger, pack)
