"""The state-of-charge filter: an extended Kalman filter on the battery model, one member for each capacity.

    samples -> time alignment -> recursion (predict, condition, weigh) -> belief and innovation of each row -> Estimate

The class holds where the filter stands; the steps are the functions of `recursion` and `kalman`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from uavbatt.battery.capacity_prior import Capacities, known_capacity
from uavbatt.battery.scaling import Pack
from uavbatt.battery.state_space import Belief
from uavbatt.estimation.block import is_complete
from uavbatt.estimation.noise import first_air
from uavbatt.estimation.recursion import (
    NOT_BEGUN,
    FilteredRow,
    FilterState,
    Window,
    filter_window,
    flight_window,
    start,
    state_at,
)
from uavbatt.estimation.time_alignment import Skew
from uavbatt.notice import Kind, Notice
from uavbatt.records import NAN, Estimate, Sample, Status

CONVERGED_SOC_SD = 0.10
REFUSED_SOC_SD = 0.25
NO_VOLTAGE = Notice("no voltage in this row", Kind.NO_VOLTAGE)
NO_CURRENT = Notice("no current in this row", Kind.NO_CURRENT)
TIME_BACKWARDS = Notice("time went backwards", Kind.TIME_BACKWARDS)
NO_CHARGE = Notice("state of charge not known at all", Kind.NO_CHARGE)


class SocFilter:
    """SocFilter takes in the samples of one battery and holds the belief about it.

    The belief is a sum of Gaussians, one for each capacity that the pack may have (`battery.capacity_prior`): each is
    an extended Kalman filter of its own, and the readings weigh them.

    pack : the battery file scaled to this pack; ambient_C : ambient temperature [°C], NaN where nobody gives one;
    capacities : the members; without them there is one, around the stated capacity.
    """

    def __init__(self, pack: Pack, *, ambient_C: float = NAN, capacities: Capacities | None = None) -> None:
        self.pack = pack
        self._ambient_C = ambient_C
        self._capacities = capacities or known_capacity(pack)
        self._state: FilterState | None = None
        self._skew = Skew(float(pack.installation.delay_s))
        self._window = flight_window()

    @property
    def belief(self) -> Belief | None:
        """Return the belief after the last sample; None before the first complete one."""
        return self._state.belief if self._state is not None else None

    @property
    def time_s(self) -> float:
        """Return the time of the last sample that was taken in [s]; NaN before the first complete one."""
        return self._state.time_s if self._state is not None else NAN

    def restore(self, belief: Belief, time_s: float, current_A: float) -> None:
        """Go on from a saved belief at `time_s` [s], when the pack's current was `current_A` [A]."""
        air = first_air(belief.ambient_C, is_stated=math.isfinite(self._ambient_C))
        self._state = state_at(self.pack, belief, time_s, current_A, air)

    def step(self, sample: Sample) -> Estimate:
        """Take one sample in; one without voltage or current moves nothing, and its estimate says so."""
        (row,) = self.run([sample], self._window)
        return estimate_of(sample, row)

    def run(self, samples: Sequence[Sample], window: Window = filter_window) -> list[FilteredRow]:
        """Take a window of samples in; the filter stands after the last of them.

        window : the recursion over rows (`recursion.filter_window`, or its compiled twin).
        Returns the filter after each sample.
        """
        paired = samples
        if self._skew.delay_s:
            paired = [self._skew.paired(sample) if is_complete(sample) else sample for sample in samples]
        before: list[FilteredRow] = []
        if self._state is None:
            first = next((k for k, sample in enumerate(paired) if is_complete(sample)), None)
            if first is None:
                return [NOT_BEGUN] * len(paired)
            self._state, row = start(self.pack, paired[first], self._ambient_C, self._capacities)
            before = [*[NOT_BEGUN] * first, row]
        rows, self._state = window(self.pack, self._state, paired[len(before) :])
        return [*before, *rows]


def estimate_of(sample: Sample, row: FilteredRow, warnings: tuple[str, ...] = ()) -> Estimate:
    """Return a sample's estimate from the filter after it; refused or converging while the charge is little known."""
    known, shown = row.summary, row.innovation
    soc = shown.soc if math.isfinite(shown.soc) else known.soc
    status, reason = _standing(sample, row)
    return Estimate(
        time_s=sample.time_s,
        voltage_V=sample.voltage_V,
        current_A=sample.current_A,
        temp_C=sample.temp_C,
        power_W=sample.voltage_V * sample.current_A,
        innovation_V=shown.innovation_V,
        nis=shown.nis,
        status=status,
        reason=reason,
        warnings=warnings,
        predicted_voltage_V=shown.expected_V,
        **known._replace(soc=min(max(soc, 0.0), 1.0))._asdict(),
    )


def _standing(sample: Sample, row: FilteredRow) -> tuple[Status, str]:
    """Return the status of a sample's estimate, and its reason; empty while it is `ok`."""
    if row.belief is None or not math.isfinite(row.innovation.soc):
        return Status.REFUSED, _why_nothing(sample)
    soc_sd = row.summary.soc_sd
    if soc_sd > CONVERGED_SOC_SD:
        return Status.REFUSED if soc_sd > REFUSED_SOC_SD else Status.CONVERGING, known_only_to(soc_sd)
    return Status.OK, ""


def unknown(sample: Sample, reason: str) -> Estimate:
    """Return the refused estimate of a row at which there is no filter."""
    seen = (sample.current_A, sample.temp_C)
    return Estimate(sample.time_s, NAN, NAN, NAN, *seen, NAN, NAN, NAN, Status.REFUSED, reason)


def known_only_to(soc_sd: float) -> Notice:
    """Say in words how well the charge is known, without a number where the standard deviation is 1 or more."""
    if soc_sd < 1.0:
        return Notice(f"still settling: charge known to ±{soc_sd:.0%}", Kind.SETTLING)
    return NO_CHARGE


def _why_nothing(sample: Sample) -> Notice:
    """Return why a row moved nothing."""
    if is_complete(sample):
        return TIME_BACKWARDS
    return NO_CURRENT if math.isfinite(sample.voltage_V) else NO_VOLTAGE


def refused_start(sample: Sample, refusal: str) -> Estimate | None:
    """Return the refused estimate of a row at which no filter may begin; None if one may.

    refusal : why the voltages cannot be those of the pack that is stated; empty if they can
    """
    if not math.isfinite(sample.voltage_V):
        return unknown(sample, NO_VOLTAGE)
    return replace(unknown(sample, refusal), warnings=(refusal,)) if refusal else None
