"""One battery in flight: its estimator, and its state that is saved for the next process.

To resume, the saved belief and the memory of forecaster and cleaner are set to their own time, before the first row of
the new process. The charge drawn since then is the difference of the autopilot's counter if it has one; otherwise the
load is assumed to have continued. A state that cannot be resumed is not used, and `resumed` says why.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.remembered import PackHealth
from uavbatt.battery.sizing.pack_size import PackOptions, size_of_pack
from uavbatt.battery.state_space import Belief
from uavbatt.errors import CapacityNotStated, UavbattError
from uavbatt.estimator import Estimator
from uavbatt.limits import FirstVoltages
from uavbatt.live.memory.saved import SavedBattery, implausible
from uavbatt.live.report import UNKNOWN, EnduranceNow
from uavbatt.live.voltage_watch import VoltageWatch
from uavbatt.navigation import NOWHERE, Navigation
from uavbatt.notice import Kind, Notice
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.prediction.load.flight_so_far import FlightSoFar
from uavbatt.prediction.pending import ENDS_SOON, refused
from uavbatt.records import NAN, Estimate, PackFacts, Remaining, Sample
from uavbatt.telemetry.builder import MAX_CURRENT_A

COUNTER_SLACK_AH = 0.02
ENDURANCE_PERIOD_S = 10.0
RESUMED = "resumed from a state"


class TrackedBattery:
    """TrackedBattery runs the estimator of one battery; nothing that a vehicle sends makes it raise an error."""

    def __init__(
        self,
        battery: BatteryFile,
        options: PackOptions,
        settings: ForecastSettings,
        saved: SavedBattery | None = None,
        max_age_s: float = math.inf,
    ) -> None:
        self._battery, self._options, self._settings = battery, options, settings
        self._pack = ""  # name of the pack, once known
        self._remembered: PackHealth | None = None
        self._has_flown = False
        self.estimator = self._anew()
        self._saved, self._max_age_s = saved, max_age_s
        self._last: Sample | None = None
        self._watch: VoltageWatch | None = None  # while nobody states the capacity
        self._endurance, self._endurance_s = UNKNOWN, math.nan
        self.resumed = ""  # whether the saved state was resumed, in words; empty if there is none

    @property
    def flight_so_far(self) -> FlightSoFar:
        """Return energy and time of the flight so far, as its forecasts use them."""
        past = self.estimator.past
        return past.forecaster.flight if past is not None else FlightSoFar()

    def is_open_to_memory(self, armed: bool | None) -> bool:
        """Return True if the pack's health from the ledger may be used: on the ground, or before a state is resumed."""
        return armed is False or (armed is None and self._saved is None and not self.resumed.startswith(RESUMED))

    def remember(self, name: str, health: PackHealth | None) -> None:
        """Take in the name of the pack, and its health from the ledger; None for a pack that it does not know.

        The estimate begins anew with it for another pack, and for a pack that has not flown. A pack that has flown
        keeps its estimate, which knows its charge better: the health is used once the voltage shows a change of the
        pack.
        """
        is_another = self._pack not in ("", name)
        is_news = health is not None and health is not self._remembered
        self._pack = name
        if not (is_another or is_news):
            return
        self._remembered = health
        if self._has_flown and not is_another:
            self.estimator.remembered_next = health
        else:
            self._saved, self.resumed, self._has_flown = None, "", False
            self.estimator = self._anew()

    def _anew(self) -> Estimator:
        return Estimator(self._battery, self._options, self._settings, remembered=self._remembered)

    def step(
        self, sample: Sample, facts: PackFacts, gap_s: float = NAN, navigation: Navigation = NOWHERE
    ) -> tuple[Estimate, Remaining]:
        """Return estimate and remaining time after one row; refused, with the reason, if the row causes an error.

        gap_s : age of the saved state at this row [s]; navigation : position, mission and mode of the vehicle
        """
        was, self._saved = self._saved, None
        if was is not None:
            why_not = self._resume(was, sample, gap_s)
            self.resumed = f"not resumed: {why_not}" if why_not else f"{RESUMED} {gap_s:.0f} s old"
        self._last = sample
        try:
            self.estimator.update_facts(facts)
            found = self.estimator.step(sample, navigation)
        except Exception as error:  # in flight no row and no file may end the process
            self.estimator = self._anew()
            if was is not None:
                self.resumed = f"not resumed: the saved state is damaged: {type(error).__name__}"
            estimate, remaining = refused(sample, _notice_of(error))
            if isinstance(error, CapacityNotStated):
                estimate = replace(estimate, warnings=self._by_voltage(sample, facts))
            return estimate, remaining
        self._has_flown = self._has_flown or math.isfinite(self.estimator.flying_since_s)
        return found

    def _by_voltage(self, sample: Sample, facts: PackFacts) -> tuple[str, ...]:
        """Return the warning that the voltage alone gives after a row of a pack whose capacity nobody states."""
        try:
            self._watch = self._watch or VoltageWatch(self._battery, self._options)
            return (ENDS_SOON,) if self._watch.step(sample, facts) else ()
        except Exception:  # as in `step`: nothing may end the process
            self._watch = None
            return ()

    def endurance(self, time_s: float) -> EnduranceNow:
        """Return the flight time if it took off now, unknown if it cannot be worked out; updated every 10 s."""
        if not 0.0 <= time_s - self._endurance_s < ENDURANCE_PERIOD_S:
            try:
                found = self.estimator.before_take_off(time_s)
            except Exception:  # as in `step`: nothing may end the process
                found = None
            self._endurance_s = time_s
            self._endurance = EnduranceNow(found.median_s, found.lo_s, found.hi_s) if found is not None else UNKNOWN
        return self._endurance

    def saved(self, facts: PackFacts) -> SavedBattery | None:
        """Return the values worth saving; None before the first estimate."""
        belief, resolved, last = self.estimator.belief, self.estimator.pack_size, self._last
        past = self.estimator.past
        if belief is None or resolved is None or last is None or past is None:
            return None
        return SavedBattery(
            since_row_s=last.time_s - past.time_s,
            means=belief.means.tolist(),
            covariances=belief.covariances.tolist(),
            weights=belief.weights.tolist(),
            ambient_C=belief.ambient_C,
            cells=resolved.cells,
            capacity_Ah=resolved.capacity_Ah,
            facts=facts,
            consumed_Ah=last.consumed_Ah,
            current_A=last.current_A,
            past=past.moved(-past.time_s),
            fullest_cell_V=resolved.fullest_cell_V,
        )

    def _resume(self, was: SavedBattery, sample: Sample, gap_s: float) -> str:
        """Start from the saved belief; return the reason if that is not possible, else an empty text."""
        age_s = gap_s + was.since_row_s
        if not (gap_s > 0.0 and age_s <= self._max_age_s):
            return f"the saved state is {age_s:.0f} s old"
        try:
            if why_not := implausible(was):
                return f"the saved state holds {why_not}"
            voltages, rested_V = FirstVoltages(sample.voltage_V), was.cells * was.fullest_cell_V
            pack = size_of_pack(
                self._battery, self._options, was.facts, was.cells, voltages=voltages, rested_V=rested_V
            )
            if (pack.cells, pack.capacity_Ah) != (was.cells, was.capacity_Ah):
                return f"the saved state is of a pack of {was.cells}S {was.capacity_Ah:g} Ah"
            at_s = sample.time_s - age_s
            belief = Belief(np.array(was.means), np.array(was.covariances), np.log(was.weights), was.ambient_C)
            before_A = _current_at_belief(was.current_A, sample.current_A, sample.consumed_Ah - was.consumed_Ah, age_s)
            self.estimator.restore(belief, was.past.moved(at_s), pack, was.facts, before_A, was.consumed_Ah)
        except Exception as error:  # no content of a file may end the process
            self.estimator = self._anew()
            return f"the saved state is damaged: {type(error).__name__}"
        return ""


def _notice_of(error: Exception) -> Notice:
    """Return the reason why a row that has caused this error is refused."""
    words = " ".join(str(error).split())
    if isinstance(error, UavbattError):
        return Notice(words, Kind.CAPACITY_NOT_STATED if isinstance(error, CapacityNotStated) else Kind.OTHER)
    return Notice(f"{type(error).__name__} in uavbatt itself: {words}", Kind.FAULT)


def _current_at_belief(saved_A: float, now_A: float, drawn_Ah: float, gap_s: float) -> float:
    """Return the current [A] at the start of a gap that makes its trapezium equal to the charge drawn in the gap."""
    if math.isfinite(now_A) and math.isfinite(drawn_Ah) and drawn_Ah > -COUNTER_SLACK_AH:
        mean_A = max(drawn_Ah, 0.0) * 3600.0 / gap_s
        if mean_A <= MAX_CURRENT_A:  # else the counter is of another pack
            return 2.0 * mean_A - now_A
    return saved_A if math.isfinite(saved_A) else max(now_A, 0.0) if math.isfinite(now_A) else 0.0
