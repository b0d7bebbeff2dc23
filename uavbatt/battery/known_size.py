"""The size of a pack as far as it is known in flight, and the doubts about it; a value that is replaced at each row.

What the caller states counts first, then the vehicle's parameters, then the voltage (`sizing`). Each row of telemetry
is compared with all of them (`statements`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.sizing import PackOptions, PackSize, cells_from_voltage, resting, size_of_pack
from uavbatt.battery.statements import PowerRange, Statements
from uavbatt.limits import Doubt, Resting, Seen
from uavbatt.records import NAN, PackFacts, Sample


class KnownSize(NamedTuple):
    """A pack's size by the statements of caller and vehicle; `after` compares one more row with them.

    size : None before the first voltage; stated_W : lowest and highest power [W] stated of this aircraft.
    """

    battery: BatteryFile
    options: PackOptions
    resting: Resting
    stated_W: PowerRange | None = None
    facts: PackFacts = PackFacts()
    statements: Statements = Statements()
    size: PackSize | None = None
    doubts: tuple[Doubt, ...] = ()

    @property
    def refusal(self) -> str:
        """Return the words of a contradiction that is certain; empty if there is none."""
        return self.doubts[0].words if self.doubts and self.doubts[0].is_certain else ""

    def with_facts(self, facts: PackFacts) -> KnownSize:
        """Return the size by what the vehicle says from now on."""
        known = self._replace(facts=facts)
        return known._sized(self.size.cells) if self.size is not None else known

    def after(self, raw: Sample, sample: Sample) -> KnownSize:
        """Return what is known after one more row, `raw` as it came and `sample` after cleaning."""
        size = self.size or self.by_voltage([sample])
        if size is None:
            return self
        statements = self.statements.after(raw, sample, size)
        before, seen = self.statements.seen, statements.seen
        known = self._replace(statements=statements, size=size)
        if seen is not before:
            if self.options.cells is None and statements.denies(size.cells, self.resting):
                known = known._sized(cells_from_voltage(seen.first_V, self.battery.battery.cells_series))
            elif math.isnan(before.rested_V) and math.isfinite(seen.rested_V):
                known = known._sized(size.cells)  # a cut-off may lie above it
        return known._replace(doubts=statements.doubts(known.size or size, self.resting, self.stated_W))

    def by_voltage(self, coming: Iterable[Sample]) -> PackSize | None:
        """Return the size by the first voltage of some samples; None without one."""
        first_V = next((s.voltage_V for s in coming if math.isfinite(s.voltage_V)), NAN)
        if not math.isfinite(first_V):
            return None
        guessed = cells_from_voltage(first_V, self.battery.battery.cells_series)
        return size_of_pack(self.battery, self.options, self.facts, guessed, seen=Seen(first_V))

    def anew(self) -> KnownSize:
        """Return the same size for a pack that has just been changed, so that no row of it was seen yet."""
        return self._replace(statements=Statements())

    def _sized(self, guessed_cells: int) -> KnownSize:
        """Return the size by what is known now; guessed_cells counts where nobody states the cells."""
        seen = self.statements.seen
        return self._replace(size=size_of_pack(self.battery, self.options, self.facts, guessed_cells, seen=seen))


def nothing_seen(battery: BatteryFile, options: PackOptions, stated_W: PowerRange | None) -> KnownSize:
    """Return what is known of a pack before its first row."""
    return KnownSize(battery, options, resting(battery), stated_W)
