"""Samples -> estimates -> remaining time: the one way that replay, live, fleet and other programs go.

    sample -> cleaning -> filter -> statements about the pack -> pack change -> monitor -> forecast -> voltage bound

    estimator = Estimator.from_battery("lpab-3s", cells=4, capacity_Ah=5.0, cutoff_V=13.2)
    estimate, remaining = estimator.step(sample)                # one row, in flight
    for estimate, remaining in estimator.run(samples): ...      # many rows, of a log

`run` works in windows: the filter goes over all rows, then forecasts are simulated side by side. `step` is a window of
one row; no result depends on a later row. What the caller does not say of the pack comes from the vehicle's parameters
(`update_facts`), then from voltage and battery file; `pack_size` says where each number came from.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from uavbatt.battery import battery_file
from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.high_voltage import ORDINARY_FULL_V
from uavbatt.battery.pack import typical_power_W
from uavbatt.battery.remembered import PackHealth, of_known_cells, prior_of, unlike, with_reaction
from uavbatt.battery.scaling import Pack
from uavbatt.battery.sizing.known_size import KnownSize, before_any_row
from uavbatt.battery.sizing.pack_size import PackOptions, PackSize, sized
from uavbatt.battery.state_space import Belief
from uavbatt.engine import PLAIN, Engine
from uavbatt.estimation.assumed_load import unmetered_estimate, unmetered_pack
from uavbatt.estimation.checked import checked_record, checked_samples
from uavbatt.estimation.filter import SocFilter, estimate_of, refused_start, unknown
from uavbatt.estimation.monitor import Monitor
from uavbatt.estimation.pack_change import SwapWatch
from uavbatt.estimation.recursion import NOT_BEGUN, FilteredRow, Window, flight_window
from uavbatt.estimation.remarks import remarks
from uavbatt.estimation.summary import BeliefSummary
from uavbatt.limits import Names, checked_number
from uavbatt.navigation import NOWHERE, Navigation
from uavbatt.prediction.batch import end_times
from uavbatt.prediction.forecast import Forecast
from uavbatt.prediction.forecaster import Forecaster, ForecasterMemory, ForecastSettings
from uavbatt.prediction.load.library import stated_power
from uavbatt.prediction.load.scenarios import ConstantLoad
from uavbatt.prediction.pending import Pending, finished
from uavbatt.prediction.voltage_bound import VoltageBound
from uavbatt.records import NAN, Estimate, PackFacts, Remaining, Sample, Status
from uavbatt.telemetry.cleaning.cleaner import Cleaner

LONGEST_WINDOW, NO_TIME = 4096, "no time in this row"


class EstimatorMemory(NamedTuple):
    """EstimatorMemory holds what is saved beside the belief: the past of flight and sensors, the belief's time [s]."""

    forecaster: ForecasterMemory
    cleaner: Cleaner
    time_s: float

    def moved(self, shift_s: float) -> EstimatorMemory:
        """Return the same past on a clock that shows `shift_s` [s] more."""
        return EstimatorMemory(self.forecaster.moved(shift_s), self.cleaner.moved(shift_s), self.time_s + shift_s)


class PackState(NamedTuple):
    """PackState holds the state of the pack that is estimated, from its first row on; another pack begins another."""

    filter: SocFilter
    forecaster: Forecaster
    is_guessed: bool  # its current is worked out from a power, not measured
    swap: SwapWatch = SwapWatch()
    monitor: Monitor = Monitor()
    bound: VoltageBound = VoltageBound()


class Estimator:
    """An estimator turns the samples of one battery into state of charge and remaining time.

    options : the size of the pack (cells, capacity [Ah], cut-off [V]) as far as the caller states it; settings : load
    to come, reserve and period of the forecasts; engine : the functions by which `run` works many rows at once (`step`
    always updates by filterpy); remembered : the pack's health by the ledger; `remembered_next`, of a pack after it.
    """

    def __init__(
        self,
        battery: BatteryFile,
        options: PackOptions | None = None,
        settings: ForecastSettings | None = None,
        engine: Engine = PLAIN,
        remembered: PackHealth | None = None,
    ) -> None:
        self.battery, self.remembered, self.remembered_next = battery, remembered, remembered
        self.options = options or PackOptions()
        self.settings = settings or ForecastSettings()
        self._state: PackState | None = None
        load = self.settings.load
        power_W = load.power_W if isinstance(load, ConstantLoad) else NAN
        self._cleaner, self._engine = Cleaner(stated_power_W=power_W), engine
        self._known = before_any_row(battery, of_known_cells(self.options, remembered), stated_power(load))
        self._in_flight = flight_window()

    def __repr__(self) -> str:
        return f"<Estimator on {self.battery.battery.name}: {getattr(self.pack_size, 'words', 'no sample yet')}>"

    @classmethod
    def from_battery(
        cls,
        battery: str | Path,
        *,
        cells: int | None = None,
        capacity_Ah: float = NAN,
        cutoff_V: float = NAN,
        reserve_soc: float = 0.0,
        allow_uncertified: bool = False,
    ) -> Estimator:
        """Make an estimator for a packaged battery by name or a battery file by path (`battery_file.read_battery`).

        cells in series, capacity_Ah [Ah], cutoff_V [V of the pack] and reserve_soc (0..1) are what the caller states.
        Raises UsageError for an impossible number, BadInput or Uncertified for a file that cannot be used.
        """
        options = PackOptions(cells=cells, capacity_Ah=capacity_Ah, cutoff_V=cutoff_V, names=Names())
        file = battery_file.read_battery(battery, allow_uncertified=allow_uncertified)
        return cls(file, options, ForecastSettings(reserve_soc=reserve_soc))

    @property
    def belief(self) -> Belief | None:
        """Return the filter's belief after the last sample; None before the first complete one."""
        return self._state.filter.belief if self._state is not None else None

    @property
    def pack_size(self) -> PackSize | None:
        """Return cells, capacity and cut-off, and where each came from; None before the first voltage."""
        return self._known.size

    def update_facts(self, facts: PackFacts) -> None:
        """Take in the vehicle's statements about its pack, known from now on.

        New voltages change the forecast; another size of pack starts the estimate anew. UsageError for other records.
        """
        if checked_record(PackFacts, "facts", facts) != self._known.facts:
            self._cleaner = self._cleaner.with_facts(facts)
            self._know(self._known.with_facts(facts))

    def _know(self, known: KnownSize) -> None:
        """Take in what is known of the pack's size from now on."""
        before, now, self._known = self._known.size, known.size, known
        if now is None or now is before:
            return
        if now.cell_kind[-1] > ORDINARY_FULL_V >= known.options.fullest_cell_V:
            self.remembered = None  # its flights were read with the curve of ordinary cells
        if before is not None and now.cell_kind != before.cell_kind:
            self._state = None
        elif self._state is not None:
            self._state.filter.pack = self._state.forecaster.pack = self._pack(now)

    @property
    def past(self) -> EstimatorMemory | None:
        """Return the memory that is saved with the belief; None before the first sample."""
        if self._state is None:
            return None
        return EstimatorMemory(self._state.forecaster.memory, self._cleaner, self._state.filter.time_s)

    def restore(
        self, belief: Belief, past: EstimatorMemory, size: PackSize, facts: PackFacts,
        current_A: float, consumed_Ah: float = NAN,
    ) -> None:  # fmt: skip
        """Go on from a saved belief; at its time `current_A` [A] was drawn, and the counter stood at `consumed_Ah`.

        Raises UsageError, which names the argument, for a value of another kind.
        """
        belief, past = checked_record(Belief, "belief", belief), checked_record(EstimatorMemory, "past", past)
        size, facts = checked_record(PackSize, "size", size), checked_record(PackFacts, "facts", facts)
        current_A, consumed_Ah = checked_number("current_A=", current_A), checked_number("consumed_Ah=", consumed_Ah)
        self._known = self._known._replace(facts=facts, size=size, rested_V=size.cells * size.fullest_cell_V)
        self._cleaner = past.cleaner.with_facts(facts)
        self._state = self._fresh_state()._replace(swap=SwapWatch(past.time_s, current_A, belief, 0.0, consumed_Ah))
        self._state.filter.restore(belief, past.time_s, current_A)
        self._state.forecaster.recall(past.forecaster)

    @property
    def flying_since_s(self) -> float:
        """Return the time of the row since which the pack carries the aircraft [s]; NaN on the ground."""
        return self._state.forecaster.flying_since_s if self._state is not None else NAN

    def before_take_off(self, time_s: float) -> Forecast | None:
        """Return the endurance of a flight that began now [s], from the charge believed; None while unknown."""
        if self.belief is None or self._state is None:
            return None
        return self._state.forecaster.before_take_off(self.belief, time_s)

    def step(self, sample: Sample, navigation: Navigation = NOWHERE) -> tuple[Estimate, Remaining]:
        """Take one sample in; returns the estimate and the remaining time after it.

        navigation : where the aircraft is and what it will fly. Raises UsageError when nobody states the pack's size,
        and for a value of another kind.
        """
        known = [checked_record(Navigation, "navigation", navigation)]
        (pending,) = self._pending([sample], known, self._in_flight)
        return pending.finish(end_times(pending.question.flying) if pending.question is not None else None)

    def run(
        self, samples: Iterable[Sample], navigation_at: Callable[[float], Navigation] | None = None
    ) -> Iterator[tuple[Estimate, Remaining]]:
        """Take samples in, with the facts as they are; yields the estimate and the remaining time after each.

        navigation_at : navigation as it was known at a time [s]. Raises as `step`. The estimator is some rows ahead of
        what was yielded until the generator ends: let it end before the next `run`.
        """
        rest = iter(samples)
        while window := list(islice(rest, LONGEST_WINDOW)):
            known = [NOWHERE] * len(window)
            if navigation_at is not None:
                known = [checked_record(Navigation, "navigation", navigation_at(s.time_s)) for s in window]
            yield from finished(self._pending(window, known, self._engine.filter_window), self._engine.answers)

    def _pending(
        self, samples: list[Sample], navigations: list[Navigation], filter_window: Window
    ) -> Iterator[Pending]:
        """Take the rows of one window in. The filter runs over all of them first, and again from a pack change on."""
        cleaners, clean = self._cleaned(checked_samples(samples))
        rows = [NOT_BEGUN] * len(clean) if self._state is None else self._state.filter.run(clean, filter_window)
        taken = zip(samples, cleaners, clean, navigations, strict=True)
        for k, (raw, self._cleaner, sample, navigation) in enumerate(taken):
            if math.isnan(sample.time_s):
                yield Pending(sample, unknown(sample, NO_TIME))
                continue
            self._know(self._known.after(raw, sample))
            state = self._state
            if state is None or self._cleaner.current.is_guessed != state.is_guessed:
                refused = refused_start(sample, self._known.refusal)
                if refused is not None:
                    yield Pending(sample, refused)
                    continue
                state = self._fresh_state()
                rows[k:] = state.filter.run(clean[k:], filter_window)
            swap = state.swap.after(sample, rows[k].innovation, rows[k].belief, state.filter.pack, raw.voltage_V)
            state = state._replace(swap=swap)
            if swap.is_another:  # enough rows by now have shown another pack than the one believed in
                self.remembered = self.remembered_next
                self._known = self._known.anew(of_known_cells(self.options, self.remembered))
                state = self._fresh_state()._replace(monitor=state.monitor.of_next_pack())
                rows[k:] = state.filter.run(clean[k:], filter_window)
            yield self._forecast_for(state, sample, rows[k], navigation)

    def _cleaned(self, samples: Sequence[Sample]) -> tuple[list[Cleaner], list[Sample]]:
        """Return the cleaner after each sample, and the samples after cleaning."""
        cleaner, size = self._cleaner, self._known.size or self._known.by_voltage(samples)
        # Without a current sensor a typical power is assumed.
        assumed_W = NAN if size is None or cleaner.current.is_metered else typical_power_W(size.cells, size.capacity_Ah)
        capacity_Ah, cells = (size.capacity_Ah, size.cells) if size is not None else (math.inf, 0)
        cleaners, clean = [], []
        for sample in samples:
            cleaner, sample = cleaner.clean(sample, assumed_W, capacity_Ah, cells)
            cleaners.append(cleaner)
            clean.append(sample)
        return cleaners, clean

    def _fresh_state(self) -> PackState:
        """Return the state of a pack before its first row; it keeps nothing of a pack before it."""
        assert self._known.size is not None
        pack = self._pack(self._known.size)
        soc_filter = SocFilter(pack, ambient_C=self.options.ambient_C, capacities=prior_of(pack, self.remembered))
        return PackState(soc_filter, Forecaster(pack, self.settings), self._cleaner.current.is_guessed)

    def _forecast_for(self, state: PackState, sample: Sample, row: FilteredRow, navigation: Navigation) -> Pending:
        """Return the row with its estimate, judged by the monitor, and the forecast that is to be simulated for it."""
        pack, forecaster, belief = state.filter.pack, state.forecaster, row.belief
        found = estimate_of(sample, row, self._warnings(pack, sample, row.summary))
        monitor = state.monitor.after(sample, found, belief, pack)
        found = monitor.judged(found)
        if self._known.refusal:
            found = replace(found, status=Status.REFUSED, reason=self._known.refusal)
        if state.is_guessed:
            found = unmetered_estimate(found)
        forecaster.cell_spread_V = self._cleaner.cells.spread_V
        refusal, question = forecaster.update(sample, found, belief, navigation)
        bound = state.bound.after(sample, belief, pack, self._cleaner.cells.spread_V)
        self._state = state._replace(monitor=monitor, bound=bound)
        return Pending(sample, found, forecaster, refusal, question, bound.left_s(sample.time_s))

    def _pack(self, size: PackSize) -> Pack:
        pack = sized(self.battery, size)
        if self._cleaner.current.is_guessed:
            pack = unmetered_pack(pack, is_stated=math.isfinite(self._cleaner.stated_power_W))
        pack = with_reaction(pack, self.remembered)
        return pack._replace(sag_compensated=bool(self._known.facts.sag_compensated))

    def _warnings(self, pack: Pack, sample: Sample, known: BeliefSummary) -> tuple[str, ...]:
        """Return the warnings that a reader of the number must see, each once."""
        size, facts, is_metered = self._known.size, self._known.facts, not self._cleaner.current.is_guessed
        assert size is not None
        found = remarks(self.battery, size, facts, sample, known, pack, is_metered=is_metered)
        if is_metered and self.remembered is not None:
            changed = unlike(pack, self.remembered, known.wear, known.wear_sd)
            found = (*found, changed) if changed else found
        doubted = [doubt.words for doubt in self._known.doubts] if self._known.doubts else []
        return (*found, *dict.fromkeys((*size.notices, *doubted)), *self._cleaner.notices)
