"""Samples -> estimates -> remaining time: the one way that replay, live, fleet and other programs go.

    sample -> cleaning -> statements held against it -> filter -> pack change, monitor -> forecast -> last wall

    estimator = Estimator.from_battery("lpab-3s", cells=4, capacity_Ah=5.0, cutoff_V=13.2)
    estimate, remaining = estimator.step(sample)                # one row, in flight
    for estimate, remaining in estimator.run(samples): ...      # many rows, of a log

`run` works in windows: the filter over all rows of one, the forecasts of some rows side by side. Nothing that it says
of a row depends on a later one, and `step` is a window of one row.

What the caller does not say of the pack (cells, capacity, cut-off) comes from the vehicle's own parameters
(`update_facts`), then from the voltage and the battery file; where each came from stays readable in `resolved`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from uavbatt.battery import battery_file
from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.capacity_prior import capacities
from uavbatt.battery.openloop import States, states
from uavbatt.battery.scaling import Pack, pack_of
from uavbatt.battery.state_space import Belief
from uavbatt.estimation.filter import Filtered, SocFilter, Summary, estimate_of
from uavbatt.estimation.kalman import filterpy_condition
from uavbatt.estimation.monitor import Monitor
from uavbatt.estimation.pack_change import SwapWatch
from uavbatt.estimation.recursion import Window, filter_window
from uavbatt.limits import HIGHEST_C_RATE, Doubt, Seen
from uavbatt.navigation import NOWHERE, Navigation
from uavbatt.prediction.batch import SIDE_BY_SIDE, Question, answers
from uavbatt.prediction.forecaster import Forecaster, Memory, Settings
from uavbatt.prediction.last_wall import FALLS_FASTER, LastWall, walled
from uavbatt.prediction.load import ConstantLoad
from uavbatt.prediction.time_to_end import EndTimes
from uavbatt.records import ALARM_RISK, NAN, Estimate, PackFacts, Remaining, Sample, Status
from uavbatt.resolved import PackOptions, Resolved, cells_from_voltage, certificate_remark, resolve, resting
from uavbatt.statements import Statements, stated_power
from uavbatt.telemetry.cleaning import Intake

__all__ = ["PLAIN", "Engine", "Estimator", "PackOptions", "Past", "Resolved"]

NOTICED_WEAR, WEAR_IS_SURE = 0.07, 3.0
ALARM_S = 120.0
LONGEST_WINDOW = 4096
# Without a current sensor: hovers of 12 to 30 minutes draw 2 to 4 C, so 2.5 C, give or take a factor of 1.6; a stated
# power is right to a fifth. Around its mean the load wanders by a fifth for a minute at a time: as independent errors
# of readings two seconds apart that is five times as much.
ASSUMED_C_RATE, ASSUMED_CELL_V, ASSUMED_SD, STATED_SD = 2.5, 3.8, (0.5, 1.2), (0.2, 0.4)


class Engine(NamedTuple):
    """The works that can be done at once for many rows or columns; an Estimator uses the first two.

    `PLAIN` does them in numpy, `compiled.engine()` in compiled code; live programs need neither.
    """

    filter_window: Window = filter_window  # the filter over the rows of a window
    answers: Callable[[Sequence[Question]], list[EndTimes]] = answers  # the ends of forecasts
    states: States = states  # the model without correction, for `diagnosis`


PLAIN = Engine()


class Pending(NamedTuple):
    """One row taken in: its estimate, and what is still to be worked out for its remaining time."""

    sample: Sample
    estimate: Estimate
    forecaster: Forecaster | None
    refusal: str
    question: Question | None = None
    wall_s: float = math.inf  # seconds until the measured voltage itself is at the cut-off


class Past(NamedTuple):
    """The memory of an estimator beside its belief: how the flight went, and what is known of the sensors."""

    forecaster: Memory
    intake: Intake

    def moved(self, shift_s: float) -> Past:
        """The same past on a clock that shows `shift_s` more."""
        return Past(self.forecaster.moved(shift_s), self.intake.moved(shift_s))


class Estimator:
    """State of charge and remaining time of one battery.

    battery : the battery file; options : what the caller states of the pack; engine : how `run` works its windows.
    `step` always takes measurements in by filterpy.
    """

    def __init__(self, battery: BatteryFile, options: PackOptions | None = None, engine: Engine = PLAIN) -> None:
        self.battery = battery
        self.options = options or PackOptions()
        self.resolved: Resolved | None = None
        self._facts = PackFacts()
        self._filter: SocFilter | None = None
        self._forecaster: Forecaster | None = None
        power_W = self.options.load.power_W if isinstance(self.options.load, ConstantLoad) else NAN
        self._intake = Intake(stated_power_W=power_W)
        self._swap = SwapWatch()
        self._statements, self._doubts = Statements(), tuple[Doubt, ...]()
        self._resting, self._stated_W = resting(battery), stated_power(self.options.load)
        self._monitor, self._wall = Monitor(), LastWall()
        self._is_guessed = False  # the filter was begun for a current that nobody measured
        self._engine = engine
        self._in_flight = Engine(partial(filter_window, condition=filterpy_condition()), answers)

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
        """An estimator for a packaged battery by name or a battery file by path; see `battery.file.read`."""
        options = PackOptions(cells=cells, capacity_Ah=capacity_Ah, cutoff_V=cutoff_V, reserve_soc=reserve_soc)
        return cls(battery_file.read(battery, allow_uncertified=allow_uncertified), options)

    @property
    def belief(self) -> Belief | None:
        """The filter's belief after the last sample."""
        return self._filter.belief if self._filter is not None else None

    def update_facts(self, facts: PackFacts) -> None:
        """What the vehicle says of its pack, known from now on.

        New voltages change the forecast; another size of pack means another battery: the estimate starts anew.
        """
        if facts == self._facts:
            return
        self._facts = facts
        if self.resolved is None:
            return
        self._resolve_again(self.resolved.cells)

    def _resolve_again(self, guessed_cells: int) -> None:
        """The pack's size by what is known now."""
        assert self.resolved is not None
        now = resolve(self.battery, self.options, self._facts, guessed_cells, seen=self._statements.seen)
        if (now.cells, now.capacity_Ah) != (self.resolved.cells, self.resolved.capacity_Ah):
            self._filter = self._forecaster = None
        self.resolved = now
        if self._filter is not None and self._forecaster is not None:
            self._filter.pack = self._forecaster.pack = self._pack(now)

    @property
    def past(self) -> Past | None:
        """What belongs to the belief when it is saved; None before the first sample."""
        return Past(self._forecaster.memory, self._intake) if self._forecaster is not None else None

    def restore(
        self, belief: Belief, resolved: Resolved, facts: PackFacts, current_A: float = 0.0, past: Past | None = None
    ) -> None:
        """Go on from a saved belief about the same pack; `current_A` [A] was drawn at the belief's time."""
        self._facts, self.resolved = facts, resolved
        if past is not None:
            self._intake = past.intake
        soc_filter, forecaster = self._begin(resolved)
        soc_filter.restore(belief, current_A)
        self._swap = SwapWatch(belief.time_s, current_A, belief, row_s=0.0)  # what has passed since is a silence
        if past is not None:
            forecaster.recall(past.forecaster)

    def step(self, sample: Sample, navigation: Navigation = NOWHERE) -> tuple[Estimate, Remaining]:
        """Take one sample in; returns the estimate and the remaining time after it.

        navigation : where the aircraft is and what it will fly. Raises UsageError when nobody states the pack's size.
        """
        ((estimate, remaining),) = self._window([sample], lambda _: navigation, self._in_flight)
        return estimate, remaining

    def run(
        self, samples: Iterable[Sample], navigation_at: Callable[[float], Navigation] | None = None
    ) -> Iterator[tuple[Estimate, Remaining]]:
        """Take samples in, with the facts as they are; yields the estimate and the remaining time after each.

        navigation_at : navigation as it was known at a time [s]. Raises as `step`. The estimator stands some rows
        ahead of what was yielded until the generator has come to its end, which it must before the next `run`.
        """
        rest = iter(samples)
        while window := list(islice(rest, LONGEST_WINDOW)):
            yield from self._window(window, navigation_at or (lambda _: NOWHERE), self._engine)

    def _window(
        self, samples: list[Sample], navigation_at: Callable[[float], Navigation], engine: Engine
    ) -> Iterator[tuple[Estimate, Remaining]]:
        """The rows of one window, the forecasts of some of them simulated side by side."""
        waiting: list[Pending] = []
        questions = 0
        for pending in self._pending(samples, navigation_at, engine.filter_window):
            waiting.append(pending)
            questions += pending.question is not None
            if questions == SIDE_BY_SIDE:
                yield from _finished(waiting, engine)
                waiting, questions = [], 0
        yield from _finished(waiting, engine)

    def _pending(
        self, samples: list[Sample], navigation_at: Callable[[float], Navigation], filter_window: Window
    ) -> Iterator[Pending]:
        """Take the rows of one window in. The filter works ahead; for another pack it works the rest anew."""
        cleaned = self._cleaned(samples)
        clean = [sample for _, sample in cleaned]
        rows, since = (self._filter.run(clean, filter_window) if self._filter is not None else []), 0
        for k, (raw, (self._intake, sample)) in enumerate(zip(samples, cleaned, strict=True)):
            self._hold_against(raw, sample)
            if self._filter is None or self._intake.guessed != self._is_guessed:
                refused = self._why_not_begin(sample)
                if refused is not None:
                    yield Pending(sample, refused, None, refused.reason)
                    continue
                rows, since = self._begun(clean[k:], filter_window), k
            row = rows[k - since]
            found = self._estimate(sample, row)
            if self._is_another_pack(found, row.belief):
                rows, since = self._begun(clean[k:], filter_window), k
                row, self._statements = rows[0], Statements()
                found = self._estimate(sample, row)
            yield self._forecast_for(sample, found, row.belief, navigation_at(sample.time_s))

    def _cleaned(self, samples: Sequence[Sample]) -> list[tuple[Intake, Sample]]:
        """The samples as the filter may have them, each with the memory of the cleaning after it."""
        intake, assumed_W, most_A = self._intake, self._assumed_W(samples), self._most_A(samples)
        found = []
        for sample in samples:
            intake, sample = intake.after(sample, assumed_W, most_A)
            found.append((intake, sample))
        return found

    def _why_not_begin(self, sample: Sample) -> Estimate | None:
        """The refused estimate of a row at which no filter may begin; None where one may."""
        if not math.isfinite(sample.voltage_V):
            return _unknown(sample, "no voltage in this row")
        if self._doubts and self._doubts[0].is_certain:  # no filter begins at what no pack shows
            words = self._doubts[0].words
            return replace(_unknown(sample, words), warnings=(words,))
        return None

    def _begun(self, coming: Sequence[Sample], filter_window: Window) -> list[Filtered]:
        """A new battery from the first of the coming samples on; returns the filter after each."""
        assert self.resolved is not None
        soc_filter, _ = self._begin(self.resolved)
        return soc_filter.run(coming, filter_window)

    def _begin(self, resolved: Resolved) -> tuple[SocFilter, Forecaster]:
        """Forget the last battery: nothing that was believed of it holds."""
        pack = self._pack(resolved)
        self._filter = SocFilter(pack, ambient_C=self.options.ambient_C, capacities=capacities(pack))
        self._forecaster = Forecaster(
            pack, Settings(self.options.load, self.options.reserve_soc, self.options.forecast_period_s)
        )
        self._is_guessed = self._intake.guessed
        self._swap, self._monitor, self._wall = SwapWatch(), Monitor(), LastWall()
        return self._filter, self._forecaster

    def _estimate(self, sample: Sample, row: Filtered) -> Estimate:
        return estimate_of(sample, row, self._warnings(sample, row.summary))

    def _is_another_pack(self, found: Estimate, belief: Belief | None) -> bool:
        """True if enough rows by now have shown another pack than the one that is believed in."""
        if belief is not None and self._filter is not None:
            self._swap = self._swap.after(found, belief, self._filter.pack)
        return self._swap.is_another

    def _forecast_for(self, sample: Sample, found: Estimate, belief: Belief | None, navigation: Navigation) -> Pending:
        """The estimate with what speaks against it, and the forecast that it leads to."""
        assert self._filter is not None and self._forecaster is not None
        self._monitor = self._monitor.after(sample, found, belief, self._filter.pack)
        found = self._monitor.judged(found)
        if self._doubts and self._doubts[0].is_certain:
            found = replace(found, status=Status.REFUSED, reason=self._doubts[0].words)
        if self._intake.guessed:  # nobody measured these
            found = replace(found, current_A=NAN, power_W=NAN)
            if found.status is Status.OK:
                found = replace(found, status=Status.CONVERGING, reason="no current sensor: the load is assumed")
        self._forecaster.cell_spread_V = self._intake.cell_spread_V
        refusal, question = self._forecaster.update(sample, found, belief, navigation)
        self._wall = self._wall.after(sample, belief, self._filter.pack, self._forecaster.cutoff_V)
        return Pending(sample, found, self._forecaster, refusal, question, self._wall.left_s(sample.time_s))

    def _hold_against(self, raw: Sample, sample: Sample) -> None:
        """What is stated of the pack, held against a row, as it came and as the filter has it; see `statements`."""
        self.resolved = self.resolved or self._resolved_by([sample])
        if self.resolved is None:
            return
        before, self._statements = self._statements, self._statements.after(raw, sample, self.resolved)
        seen, cells = self._statements.seen, self.resolved.cells
        if seen is not before.seen:
            if self.resolved.cells_from != "--cells" and self._statements.denies(cells, self._resting):
                self._resolve_again(cells_from_voltage(seen.first_V, self.battery.battery.cells_series))
            elif math.isnan(before.seen.rested_V) and math.isfinite(seen.rested_V):
                self._resolve_again(cells)  # a cut-off may lie above it
        self._doubts = self._statements.doubts(self.resolved, self._resting, self._stated_W)

    def _assumed_W(self, coming: Sequence[Sample]) -> float:
        """The power of a middling multirotor on this pack; NaN before a voltage tells the pack, or with a sensor."""
        if self._intake.metered:
            return NAN
        pack = self.resolved or self._resolved_by(coming)
        return ASSUMED_C_RATE * pack.capacity_Ah * pack.cells * ASSUMED_CELL_V if pack is not None else NAN

    def _most_A(self, coming: Sequence[Sample]) -> float:
        """More than this no pack of the size gives; no limit before a voltage tells the pack."""
        pack = self.resolved or self._resolved_by(coming)
        return HIGHEST_C_RATE * pack.capacity_Ah if pack is not None else math.inf

    def _resolved_by(self, coming: Sequence[Sample]) -> Resolved | None:
        """The pack by the first voltage that there is; None without one."""
        first_V = next((s.voltage_V for s in coming if math.isfinite(s.voltage_V)), NAN)
        if not math.isfinite(first_V):
            return None
        guessed = cells_from_voltage(first_V, self.battery.battery.cells_series)
        return resolve(self.battery, self.options, self._facts, guessed, seen=Seen(first_V))

    def _pack(self, resolved: Resolved) -> Pack:
        pack = pack_of(self.battery, resolved.cells, resolved.capacity_Ah, resolved.cutoff_V, resolved.low_V)
        if self._intake.guessed:
            # A current that is k times what we think is a capacity and an ohmic drop k times less: the filter doubts
            # the capacity scale, which scales both, and the voltage's fall tells k as the flight goes on.
            is_stated = math.isfinite(self._intake.stated_power_W)
            level_sd, about_it_sd = STATED_SD if is_stated else ASSUMED_SD
            pack = pack._replace(
                resistance_scale_sd=math.hypot(pack.resistance_scale_sd, level_sd),
                capacity_scale_sd=level_sd,
                guess_sd=about_it_sd,
            )
        return pack._replace(sag_compensated=bool(self._facts.sag_compensated))

    def _warnings(self, sample: Sample, known: Summary) -> tuple[str, ...]:
        """What a reader of the number must know beside it."""
        assert self.resolved is not None
        remark = certificate_remark(self.battery, self.resolved)
        found = [remark] if remark else []
        validated = self.battery.certificate.validated_ambient_C
        core_C = known.core_temp_C
        if validated and math.isfinite(core_C) and not min(validated) - 5.0 <= core_C <= max(validated) + 20.0:
            found.append(f"pack at {core_C:.0f} °C is outside the validated range")
        if not math.isfinite(sample.temp_C):
            found.append("no usable pack temperature")
        if self._facts.sag_compensated:
            found.append("the autopilot reports sag-compensated voltage (BATT_OPTIONS bit 6)")
        if self._is_worn(known):
            found.append("this pack has more ohms than its type: aged, or colder than it says; less charge is expected")
        doubted = dict.fromkeys((*self.resolved.notices, *(doubt.words for doubt in self._doubts)))
        return (*found, *doubted, *self._intake.notices)

    def _is_worn(self, known: Summary) -> bool:
        """More resistance than the packs of this type are spread by, and surely so."""
        assert self._filter is not None
        unusual = max(NOTICED_WEAR, self._filter.pack.resistance_scale_sd)
        if self._intake.guessed or not self.battery.is_measured:
            return False  # nothing is known to compare with
        return known.wear > unusual and known.wear > WEAR_IS_SURE * known.wear_sd


def _unknown(sample: Sample, reason: str) -> Estimate:
    """The estimate after a row at which there is no filter."""
    seen = (sample.current_A, sample.temp_C)
    return Estimate(sample.time_s, NAN, NAN, NAN, *seen, NAN, NAN, NAN, Status.REFUSED, reason)


def _finished(waiting: list[Pending], engine: Engine) -> Iterator[tuple[Estimate, Remaining]]:
    """What is known after some rows, whose questions are answered side by side."""
    ends = iter(engine.answers([row.question for row in waiting if row.question is not None]))
    for row in waiting:
        yield _finish(row, next(ends) if row.question is not None else None)


def _finish(row: Pending, ends: EndTimes | None) -> tuple[Estimate, Remaining]:
    """What is known after a row; `ends` answers its question, if it had one."""
    sample, found = row.sample, row.estimate
    if row.forecaster is None:
        return found, Remaining(sample.time_s, NAN, NAN, NAN, NAN, Status.REFUSED, row.refusal)
    answered = (row.question, ends) if row.question is not None and ends is not None else None
    remaining = walled(row.forecaster.finish(sample, found, row.refusal, answered), row.wall_s)
    if remaining.reason == FALLS_FASTER:
        found = replace(found, warnings=(*found.warnings, FALLS_FASTER))
    if remaining.remaining_alarm_s <= ALARM_S:
        alarm = f"two minutes left or less, at a risk of {ALARM_RISK:.1%}"
        found = replace(found, warnings=(*found.warnings, alarm))
    return found, remaining
