"""The size of a pack as far as it is known in flight, and the doubts about it; a value that is replaced at each row.

What the caller states counts first, then the vehicle's parameters, then the cells if their voltages are told one by
one, then the first voltage (`pack_size`). Each row of telemetry is compared with all of them (`statements`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.sizing.pack_size import PackOptions, PackSize, counts_of_cells, resting, size_of_pack
from uavbatt.battery.sizing.statements import NO_LOAD, PowerRange, Statements
from uavbatt.limits import GUESSED_FROM, TOLD_FROM, Doubt, FirstVoltages, Resting, told_cells
from uavbatt.notice import Kind, Notice
from uavbatt.records import NAN, PackFacts, Sample

SURE_ROWS = 2  # the first one alone may be damaged
OTHER_SUPPLY = 1.35  # no pack rises by so much without being charged: the rows before were of USB, or of a bench supply
GAUGE_STEP = 0.05  # of the rated capacity


class KnownSize(NamedTuple):
    """A pack's size is known by the statements of caller and vehicle; `after` compares one more row with them.

    size : None before the first voltage; stated_W : lowest and highest power [W] stated of this aircraft; counts : of
    cells that fit what was seen, the likeliest first, worked out when that or what the vehicle says has changed.
    """

    battery: BatteryFile
    options: PackOptions
    resting: Resting
    stated_W: PowerRange | None = None
    facts: PackFacts = PackFacts()
    statements: Statements = Statements()
    size: PackSize | None = None
    doubts: tuple[Doubt, ...] = ()
    first_A: float = NAN  # current at the first voltage [A]
    counts: tuple[int, ...] = ()
    rested_V: float = NAN  # of the first rows, which shows the kind of the cells [V of the pack]
    told: int = 0  # cells whose voltages were told one by one, at most in a row

    @property
    def refusal(self) -> str:
        """Return the words of a doubt that is certain; empty if there is none."""
        return self.doubts[0].words if self.doubts and self.doubts[0].is_certain else ""

    def with_facts(self, facts: PackFacts) -> KnownSize:
        """Return this with `facts`, what the vehicle says from now on; a size that was known is worked out anew.

        The gauge of a smart battery learns in flight: a small step of its capacity is no other pack.
        """
        is_flown, step = self.statements.current.load is not NO_LOAD, facts.full_share - self.facts.full_share
        if is_flown and abs(step) < GAUGE_STEP:
            facts = replace(facts, full_share=self.facts.full_share)
        updated = self._replace(facts=facts)
        return updated._with_counts()._with_size() if self.size is not None else updated

    def after(self, raw: Sample, sample: Sample) -> KnownSize:
        """Return the size and its doubts after one more row, `raw` as it came and `sample` after cleaning."""
        size = self.size or self.by_voltage([sample])
        if size is None:
            return self
        statements = self.statements.after(raw, sample, size)
        before, voltages = self.statements.voltages, statements.voltages
        if voltages.first_V > OTHER_SUPPLY * before.first_V:
            return self.anew(self.options).after(raw, sample)  # no row before this one was of a pack
        first_A = self.first_A if self.statements.rows else sample.current_A
        updated = self._replace(statements=statements, size=size, first_A=first_A)
        told = _told(sample) if len(sample.cell_voltages_V) > self.told else 0
        if told > self.told:
            updated = updated._replace(told=told)._with_counts()._with_size()
        if voltages is not before:
            updated = updated._with_counts()
            is_denied = self.options.cells is None and statements.denies(size.cells, self.resting)
            if is_denied or (math.isnan(before.rested_V) and math.isfinite(voltages.rested_V)):
                updated = updated._with_size()  # another count, or a cut-off that lies above the rested voltage
        is_first = statements.rows == 1 and math.isnan(updated.rested_V)
        if is_first or (statements.rows == SURE_ROWS and updated.rested_V == before.rested_V != voltages.rested_V):
            updated = updated._replace(rested_V=voltages.rested_V)._with_size()  # the cells may be of another kind
        sized = updated.size or size
        doubts = statements.doubts(sized, self.resting, self.stated_W)
        if sized.cells_from == GUESSED_FROM:
            doubts = (*doubts, *updated._count_doubts(sized))
        return updated if doubts == updated.doubts else updated._replace(doubts=doubts)

    def by_voltage(self, coming: Iterable[Sample]) -> PackSize | None:
        """Return the size by the first voltage of some samples; None without one."""
        first = next((s for s in coming if math.isfinite(s.voltage_V)), None)
        if first is None:
            return None
        updated = self._replace(first_A=first.current_A, told=max(self.told, _told(first)))
        guessed, *_ = updated._counts(first.voltage_V)
        voltages = FirstVoltages(first.voltage_V)
        return size_of_pack(self.battery, self.options, self.facts, guessed, updated.source_of_count, voltages=voltages)

    def anew(self, options: PackOptions) -> KnownSize:
        """Return the same size for a pack that has just been changed: no row of the new one was seen yet."""
        return self._replace(options=options, statements=Statements(), counts=(), rested_V=NAN, told=0)

    def _with_counts(self) -> KnownSize:
        """Return what is known with the cells counted by what was seen."""
        first_V = self.statements.voltages.first_V
        return self._replace(counts=self._counts(first_V) if math.isfinite(first_V) else ())

    def _with_size(self) -> KnownSize:
        """Return the size by what is known now; where nobody states the cells, by the likeliest count."""
        assert self.size is not None
        guessed, voltages = (*self.counts, self.size.cells)[0], self.statements.voltages
        stated, source = (self.battery, self.options, self.facts), self.source_of_count
        size = size_of_pack(*stated, guessed, source, voltages=voltages, rested_V=self.rested_V)
        return self._replace(size=size)

    @property
    def source_of_count(self) -> str:
        """Return the source of a count of cells that nobody states, in words."""
        return TOLD_FROM if self.told else GUESSED_FROM

    def _counts(self, first_V: float) -> tuple[int, ...]:
        """Return the counts of cells that fit the first voltage [V] and what the vehicle says, the likeliest first."""
        if self.told:
            return (self.told,)
        return counts_of_cells(self.battery, self.options, self.facts, first_V, self.first_A)

    def _count_doubts(self, size: PackSize) -> tuple[Doubt, ...]:
        """Return the doubt about a count that nobody states, where another one fits the first voltage as well."""
        others = [n for n in self.counts if n != size.cells]
        if not others:
            return ()
        words = f"nobody states the cells: {size.cells} in series by the first voltage, {others[0]} would fit as well"
        return (Doubt(Notice(words, Kind.CELLS_NOT_STATED), False),)


def _told(sample: Sample) -> int:
    """Return the count of cells that a row tells one by one; 0 if it does not."""
    return told_cells(sample.cell_voltages_V, sample.voltage_V)


def before_any_row(battery: BatteryFile, options: PackOptions, stated_W: PowerRange | None) -> KnownSize:
    """Return the knowledge of a pack's size before its first row, by the caller's statements alone."""
    return KnownSize(battery, options, resting(battery), stated_W)
