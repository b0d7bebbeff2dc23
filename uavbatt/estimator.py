"""Samples -> estimates -> remaining: the one engine that replay, live, fleet and other programs run.

    estimator = Estimator.from_battery("lpab-3s", cells=4, capacity_Ah=5.0, cutoff_V=13.2)
    estimate, remaining = estimator.step(sample)

What the caller does not say of the pack (cells, capacity, cut-off) comes from the vehicle's own parameters
(`update_facts`), then from the voltage and the battery file; where each came from stays readable in `resolved`.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from uavbatt.asked import Asked, say, unknown
from uavbatt.battery import battery_file
from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.remembered import PackHealth, prior_of, unlike, with_reaction
from uavbatt.battery.scaling import Pack, pack_of
from uavbatt.battery.state_space import Belief, C
from uavbatt.estimation.filter import SocFilter
from uavbatt.estimation.monitor import Monitor
from uavbatt.estimation.pack_change import SwapWatch
from uavbatt.estimation.recursion import Summary
from uavbatt.limits import HIGHEST_C_RATE, Doubt, Seen
from uavbatt.prediction.batch import answer
from uavbatt.prediction.forecaster import Forecaster, Memory, Settings
from uavbatt.prediction.last_wall import Fall
from uavbatt.prediction.load import ConstantLoad
from uavbatt.records import NAN, Estimate, PackFacts, Remaining, Sample, Status
from uavbatt.resolved import PackOptions, Resolved, cells_from_voltage, certificate_remark, resolve, resting
from uavbatt.statements import Statements, stated_power
from uavbatt.telemetry.cleaning import Intake

__all__ = ["Estimator", "PackOptions", "Past", "Resolved"]

NOTICED_WEAR, WEAR_IS_SURE = 0.07, 3.0
SURE_LOOKS = 5  # of the last wall, a second apart
NO_FALL = (math.inf,) * SURE_LOOKS
# Without a current sensor: hovers of 12 to 30 minutes draw 2 to 4 C, so 2.5 C, give or take a factor of 1.6; a stated
# power is right to a fifth. Around its mean the load wanders by a fifth for a minute at a time: as independent errors
# of readings two seconds apart that is five times as much.
ASSUMED_C_RATE, ASSUMED_CELL_V, ASSUMED_SD, STATED_SD = 2.5, 3.8, (0.5, 1.2), (0.2, 0.4)


class Past(NamedTuple):
    """What an estimator remembers beside its belief: how the flight went, and what is known of the sensors."""

    forecaster: Memory
    intake: Intake

    def moved(self, shift_s: float) -> Past:
        """The same past on a clock that shows `shift_s` more."""
        return Past(self.forecaster.moved(shift_s), self.intake.moved(shift_s))


class Estimator:
    """State of charge and remaining time of one battery, sample by sample."""

    def __init__(
        self, battery: BatteryFile, options: PackOptions | None = None, remembered: PackHealth | None = None
    ) -> None:
        self.battery, self.remembered = battery, remembered
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
        self._monitor, self._fall, self._falls = Monitor(), Fall(), NO_FALL
        self._coming: deque[tuple[Intake, Sample]] = deque()

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
        self._begin(self._pack(resolved))
        assert self._filter is not None and self._forecaster is not None
        self._filter.restore(belief, current_A)
        self._swap = SwapWatch(belief.time_s, current_A, belief, row_s=0.0)  # what has passed since is a silence
        if past is not None:
            self._forecaster.recall(past.forecaster)

    def step(self, sample: Sample) -> tuple[Estimate, Remaining]:
        """One sample in, what is known after it out. Raises UsageError when the pack's size is nowhere stated."""
        asked = self.ask(sample)
        return say(asked, answer(asked.question) if asked.question is not None else None)

    def look_ahead(self, samples: Sequence[Sample]) -> None:
        """The next samples will be these, with the facts as they are now: the filter may take them in one go."""
        intake, assumed_W, most_A = self._intake, self._assumed_W(samples), self._most_A(samples)
        for sample in samples:
            intake, cleaned = intake.after(sample, assumed_W, most_A)
            self._coming.append((intake, cleaned))
        if self._filter is not None:
            self._filter.look_ahead([cleaned for _, cleaned in self._coming])

    def ask(self, sample: Sample) -> Asked:
        """One sample in; what there is to work out before more can be said. Depends on no answer: see `Forecaster`."""
        was_guessed, raw = self._intake.guessed, sample
        if self._coming:
            self._intake, sample = self._coming.popleft()
        else:
            self._intake, sample = self._intake.after(sample, self._assumed_W([sample]), self._most_A([sample]))
        self._hold_against(raw, sample)
        if self._filter is None or self._forecaster is None or self._intake.guessed != was_guessed:
            if not math.isfinite(sample.voltage_V):
                return Asked(sample, unknown(sample), None, "no voltage in this row", None)
            if self._doubts and self._doubts[0].is_certain:  # no filter begins at what no pack shows
                nothing = replace(unknown(sample), reason=self._doubts[0].words, warnings=(self._doubts[0].words,))
                return Asked(sample, nothing, None, nothing.reason, None)
            assert self.resolved is not None
            self._begin(self._pack(self.resolved), sample)
        assert self._filter is not None and self._forecaster is not None and self.resolved is not None
        estimate = self._filter.step(sample, self._warnings)
        belief = self._filter.belief
        if belief is not None:
            self._swap = self._swap.after(estimate, belief, self._filter.pack)
        if self._swap.is_another:
            self._begin(self._pack(self.resolved), sample)
            estimate = self._filter.step(sample, self._warnings)
            belief = self._filter.belief
            self._statements = Statements()
        self._monitor = self._monitor.after(sample, estimate, belief, self._filter.pack)
        estimate = self._monitor.judged(estimate)
        if self._doubts and self._doubts[0].is_certain:
            estimate = replace(estimate, status=Status.REFUSED, reason=self._doubts[0].words)
        self._forecaster.cell_spread_V = self._intake.cell_spread_V
        if self._intake.guessed:  # nobody measured these
            estimate = replace(estimate, current_A=NAN, power_W=NAN)
            if estimate.status is Status.OK:
                estimate = replace(estimate, status=Status.CONVERGING, reason="no current sensor: the load is assumed")
        refusal, question = self._forecaster.ask(sample, estimate, belief)
        return Asked(sample, estimate, self._forecaster, refusal, question, self._wall_s(sample, belief))

    def _wall_s(self, sample: Sample, belief: Belief | None) -> float:
        """How soon the measured voltage itself is at the cut-off [s]; infinite where it does not fall."""
        assert self._forecaster is not None
        cells = float(self._forecaster.pack.installation.cells)
        lag_V = 0.0
        if belief is not None and self._fall.begins(sample.time_s):
            lag_V = cells * float(belief.weights @ belief.means[:, [C.POLARISATION, C.DIFFUSION]].sum(axis=1))
        self._fall = self._fall.after(sample.time_s, sample.voltage_V, sample.current_A, lag_V)
        if self._fall.is_due:
            left_s = self._fall.time_left_s(cells, self._forecaster.cutoff_V)
            # Once is chance: the bound holds when the falls of SURE_LOOKS seconds on end agree that there is one.
            self._falls = (*self._falls[1 - SURE_LOOKS :], sample.time_s + left_s)
        return max(max(self._falls) - sample.time_s, 0.0)

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

    def _begin(self, pack: Pack, first: Sample | None = None) -> None:
        """A new battery: nothing that was believed of the last one holds."""
        self._filter = SocFilter(pack, ambient_C=self.options.ambient_C, capacities=prior_of(pack, self.remembered))
        if first is not None and self._coming:
            self._filter.look_ahead([first, *(cleaned for _, cleaned in self._coming)])
        self._forecaster = Forecaster(
            pack, Settings(self.options.load, self.options.reserve_soc, self.options.forecast_period_s)
        )
        self._swap = SwapWatch()
        self._monitor, self._fall, self._falls = Monitor(), Fall(), NO_FALL

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
        pack = with_reaction(pack, self.remembered)
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
        if self.remembered is not None and not self._intake.guessed:
            assert self._filter is not None
            changed = unlike(self._filter.pack, self.remembered, known.wear, known.wear_sd)
            found += [changed] if changed else []
        doubted = dict.fromkeys((*self.resolved.notices, *(doubt.words for doubt in self._doubts)))
        return (*found, *doubted, *self._intake.notices)

    def _is_worn(self, known: Summary) -> bool:
        """More resistance than the packs of this type are spread by, and surely so."""
        assert self._filter is not None
        unusual = max(NOTICED_WEAR, self._filter.pack.resistance_scale_sd)
        if self._intake.guessed or not self.battery.is_measured:
            return False  # nothing is known to compare with
        return known.wear > unusual and known.wear > WEAR_IS_SURE * known.wear_sd
