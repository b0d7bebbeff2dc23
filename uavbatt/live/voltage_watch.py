"""The end of a flight by the measured voltage alone, for a battery whose capacity nobody states.

Without a capacity there is neither charge nor time. ArduPilot and PX4 leave the capacity open unless the crew sets it.
The measured voltage still shows that the end is near, and the crew is told so. A filter with an assumed capacity tells
the lagging overpotentials, without which each climb would look like the end; nothing else of it is used.
"""

from __future__ import annotations

from dataclasses import replace

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.capacity_prior import capacities
from uavbatt.battery.sizing.known_size import before_any_row
from uavbatt.battery.sizing.pack_size import PackOptions, sized
from uavbatt.estimation.filter import SocFilter
from uavbatt.estimation.recursion import flight_window
from uavbatt.prediction.pending import ends_soon
from uavbatt.prediction.voltage_bound import VoltageBound
from uavbatt.records import PackFacts, Sample
from uavbatt.telemetry.cleaning.cleaner import Cleaner

ASSUMED_AH = 20.0  # the members of the prior are packs of a tenth to five quarters of it


class VoltageWatch:
    """VoltageWatch follows the voltage of one battery; `step` takes its rows in."""

    def __init__(self, battery: BatteryFile, options: PackOptions) -> None:
        self._known = before_any_row(battery, replace(options, capacity_Ah=ASSUMED_AH), None)
        self._cleaner, self._bound, self._window = Cleaner(), VoltageBound(), flight_window()
        self._filter: SocFilter | None = None

    def step(self, raw: Sample, facts: PackFacts) -> bool:
        """Take one row in; return True if its voltage says that the flight ends within about two minutes.

        facts : what the vehicle says of the pack by then
        """
        known = self._known if facts == self._known.facts else self._known.with_facts(facts)
        cells = known.size.cells if known.size is not None else 0
        self._cleaner, sample = self._cleaner.clean(raw, capacity_Ah=ASSUMED_AH, cells=cells)
        before, self._known = self._known.size, known.after(raw, sample)
        size = self._known.size
        if size is None or self._known.refusal:  # the cut-off is not known either
            return False
        if self._filter is None or before is None or before.cell_kind != size.cell_kind:
            pack = sized(self._known.battery, size)
            self._filter, self._bound = SocFilter(pack, capacities=capacities(pack)), VoltageBound()
        elif before is not size:
            self._filter.pack = sized(self._known.battery, size)
        (row,) = self._filter.run([sample], self._window)
        self._bound = self._bound.after(sample, row.belief, self._filter.pack, self._cleaner.cells.spread_V)
        return ends_soon(sample, self._bound.left_s(sample.time_s))
