"""`--packs` and `--pack`: the pack ledger beside a command that flies logs."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uavbatt.errors import UsageError

if TYPE_CHECKING:
    from uavbatt.battery.battery_file import BatteryFile
    from uavbatt.battery.remembered import PackHealth
    from uavbatt.battery.sizing import PackOptions
    from uavbatt.packs.ledger import Ledger
    from uavbatt.records import Flight


@dataclass(frozen=True, slots=True)
class Learned:
    """Learned tells what became of a flight in the ledger: lines for a person, fields for a program."""

    lines: tuple[str, ...] = ()
    fields: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class PackMemory:
    """PackMemory holds an open ledger, or none at all, and the name that the caller gives the pack."""

    ledger: Ledger | None
    stated: str = ""

    def recalled(self, flight: Flight, battery: BatteryFile) -> PackHealth | None:
        """Return what is known of the flight's pack by the flights before it; None where nothing is."""
        from uavbatt.packs.remembering import name_of, recalled

        if self.ledger is None:
            return None
        return recalled(self.ledger, name_of(flight, self.stated), flight, battery)

    def recalled_now(self, battery: BatteryFile) -> PackHealth | None:
        """Return what is known today of the pack that --pack names. Raises UsageError for a pack it does not know."""
        from uavbatt.packs.ledger import prior

        if self.ledger is None:
            return None
        if not self.stated:
            raise UsageError("--packs: expected --pack NAME as well, the pack that will fly")
        last = self.ledger.last(self.stated)
        if last is None:
            raise UsageError(f"--pack {self.stated}: expected a pack of {self.ledger.path}, found none of that name")
        return prior(last, time.time(), battery.certificate.content_sha256)

    def learn(self, flight: Flight, battery: BatteryFile, options: PackOptions, health: PackHealth | None) -> Learned:
        """Save what the flight taught of its pack, and return the words about it; `health` was known before it."""
        from uavbatt.packs.findings import ANOTHER
        from uavbatt.packs.ledger import AnotherSize
        from uavbatt.packs.remembering import name_of, taught

        if self.ledger is None:
            return Learned()
        name = name_of(flight, self.stated)
        if not name:
            return Learned(("  pack       not remembered: no serial in the log; name it with --pack",), {"pack": None})
        found = taught(battery, options, flight, health)
        if found.record is None:
            return Learned((f"  pack       {name}: nothing learned: {found.why_not}",), {"pack": name})
        try:
            after = self.ledger.save(name, found.record)
        except AnotherSize as error:  # of another pack: the forecast was made without what is remembered
            return Learned(
                (f"  pack       {name}: not remembered: {error}",), {"pack": name, "pack_findings": [ANOTHER]}
            )
        pack = self.ledger.pack(name)
        assert pack is not None
        seen = pack.outlook
        words = (
            f"  pack       {name}: {seen.capacity_Ah:.2f} Ah ({seen.capacity_lo_Ah:.2f} to {seen.capacity_hi_Ah:.2f})"
        )
        flights = f"{seen.flights} flight{'s' * (seen.flights != 1)} remembered"
        lines = [f"{words}, {1000.0 * seen.resistance_ohm:.1f} mohm a cell; {flights}"]
        lines += [f"  pack       {name}: {finding.words}" for finding in after.findings]
        kinds = [finding.kind for finding in after.findings]
        return Learned(tuple(lines), {"pack": name, "pack_flights": seen.flights, "pack_findings": kinds})


@contextmanager
def open_memory(packs: Path | None, pack: str = "", *, only_read: bool = False) -> Iterator[PackMemory]:
    """Open the ledger that the options name, for a block. Raises UsageError for a name without a ledger."""
    if packs is None:
        if pack:
            raise UsageError(f"--pack {pack}: expected --packs FILE as well, the ledger that remembers it")
        yield PackMemory(None)
        return
    from uavbatt.packs.ledger import Ledger

    with Ledger(packs, only_read=only_read) as ledger:
        yield PackMemory(ledger, pack)
