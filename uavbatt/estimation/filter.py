"""The state-of-charge filter: an extended Kalman filter on the battery model, one member for each capacity.

    samples -> time alignment -> recursion (predict, condition, weigh) -> belief and innovation of each row -> Estimate

The class holds where the filter stands; the steps are the functions of `recursion` and `kalman`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from uavbatt.battery.capacity_prior import Capacities, known_capacity
from uavbatt.battery.scaling import Pack
from uavbatt.battery.state_space import Belief, X, mixed_covariance
from uavbatt.estimation.block import Block, is_complete
from uavbatt.estimation.kalman import Moments
from uavbatt.estimation.noise import first_air
from uavbatt.estimation.recursion import (
    NOTHING,
    FilteredRow,
    FilterState,
    Innovation,
    Window,
    filter_window,
    flight_window,
    start,
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


class BeliefSummary(NamedTuple):
    """BeliefSummary holds the means and sds of a belief that an estimate shows; they change when a block is closed."""

    soc: float = NAN
    soc_sd: float = NAN
    core_temp_C: float = NAN
    resistance_scale: float = NAN
    resistance_scale_sd: float = NAN
    capacity_scale: float = NAN
    capacity_scale_sd: float = NAN
    wear: float = NAN
    wear_sd: float = NAN


class FilterResult(NamedTuple):
    """FilterResult holds the filter after one row: its belief, the belief's summary, and the row against the model.

    The belief is None before the first complete row.
    """

    belief: Belief | None
    summary: BeliefSummary
    innovation: Innovation


NOT_BEGUN = FilterResult(None, BeliefSummary(), NOTHING)


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
        self._last = NOT_BEGUN
        self._window = flight_window()

    @property
    def belief(self) -> Belief | None:
        """Return the belief after the last sample; None before the first complete one."""
        return self._last.belief

    def restore(self, belief: Belief, current_A: float = 0.0) -> None:
        """Go on from a belief (a saved one, after a restart), at which the pack's current was `current_A` [A]."""
        at = Moments(belief.means, belief.covariances, np.log(belief.weights))
        air = first_air(belief.ambient_C, is_stated=math.isfinite(self._ambient_C))
        self._state = FilterState(at, belief.time_s, current_A, current_A, Block(), air)
        self._last = FilterResult(belief, summary(at, self.pack.empty_soc_sd), NOTHING)

    def step(self, sample: Sample) -> Estimate:
        """Take one sample in; one without voltage or current moves nothing, and its estimate says so."""
        (row,) = self.run([sample], self._window)
        return estimate_of(sample, row)

    def run(self, samples: Sequence[Sample], window: Window = filter_window) -> list[FilterResult]:
        """Take a window of samples in; the filter stands after the last of them.

        window : the recursion over rows (`recursion.filter_window`, or its compiled twin).
        Returns the filter after each sample.
        """
        paired = samples
        if self._skew.delay_s:
            paired = [self._skew.paired(sample) if is_complete(sample) else sample for sample in samples]
        rows: list[FilteredRow] = []
        if self._state is None:
            first = next((k for k, sample in enumerate(paired) if is_complete(sample)), None)
            if first is None:
                return [NOT_BEGUN] * len(paired)
            self._state, row = start(self.pack, paired[first], self._ambient_C, self._capacities)
            rows = [*[FilteredRow(None, NAN, NAN, NOTHING)] * first, row]
        more, self._state = window(self.pack, self._state, paired[len(rows) :])
        found = _results(self.pack, [*rows, *more], self._last)
        self._last = found[-1] if found else self._last
        return found


def _results(pack: Pack, rows: list[FilteredRow], last: FilterResult) -> list[FilterResult]:
    """Return the filter after each row; the summary of a belief is worked out once and shared by its rows."""
    found = []
    for row in rows:
        at, belief, known = row.moments, last.belief, last.summary
        if at is None:
            found.append(NOT_BEGUN)
            continue
        if belief is None or belief.means is not at.x:
            belief, known = Belief(row.time_s, at.x, at.P, at.weight, row.ambient_C), summary(at, pack.empty_soc_sd)
        else:
            belief = Belief(row.time_s, at.x, at.P, belief.weights, row.ambient_C)
        last = FilterResult(belief, known, row.innovation)
        found.append(last)
    return found


def summary(at: Moments, empty_soc_sd: float) -> BeliefSummary:
    """Return the means and standard deviations that an estimate shows of a belief.

    empty_soc_sd : uncertainty of the charge that a make leaves in its cells, as a share of the charge drawn. The filter
    counts down to the empty of the battery file; no voltage shows how far that of the pack differs from it.
    """
    weight = at.weight
    x, covariance = weight @ at.x, mixed_covariance(at.x, at.P, weight)
    sd = np.sqrt(np.diag(covariance))
    resistance, capacity = float(x[X.LOG_RESISTANCE]), float(x[X.LOG_CAPACITY])
    shared = covariance[X.LOG_RESISTANCE, X.LOG_CAPACITY]
    return BeliefSummary(
        soc=float(x[X.SOC]),
        soc_sd=math.hypot(sd[X.SOC], empty_soc_sd * min(max(1.0 - float(x[X.SOC]), 0.0), 1.0)),
        core_temp_C=float(x[X.CORE]),
        resistance_scale=math.exp(resistance),
        resistance_scale_sd=math.exp(resistance) * float(sd[X.LOG_RESISTANCE]),
        capacity_scale=math.exp(capacity),
        capacity_scale_sd=math.exp(capacity) * float(sd[X.LOG_CAPACITY]),
        wear=math.expm1(resistance - capacity),
        wear_sd=math.sqrt(max(sd[X.LOG_RESISTANCE] ** 2 + sd[X.LOG_CAPACITY] ** 2 - 2.0 * shared, 0.0)),
    )


def estimate_of(sample: Sample, row: FilterResult, warnings: tuple[str, ...] = ()) -> Estimate:
    """Return a sample's estimate from the filter after it; refused or converging while the charge is little known."""
    known, shown = row.summary, row.innovation
    status, reason = Status.OK, ""
    if row.belief is None or not math.isfinite(shown.soc):
        status, reason = Status.REFUSED, _why_nothing(sample)
    elif known.soc_sd > REFUSED_SOC_SD:
        status, reason = Status.REFUSED, known_only_to(known.soc_sd)
    elif known.soc_sd > CONVERGED_SOC_SD:
        status, reason = Status.CONVERGING, known_only_to(known.soc_sd)
    return Estimate(
        time_s=sample.time_s,
        soc=min(max(shown.soc if math.isfinite(shown.soc) else known.soc, 0.0), 1.0),
        soc_sd=known.soc_sd,
        voltage_V=sample.voltage_V,
        current_A=sample.current_A,
        temp_C=sample.temp_C,
        power_W=sample.voltage_V * sample.current_A,
        innovation_V=shown.innovation_V,
        nis=shown.nis,
        status=status,
        reason=reason,
        predicted_voltage_V=shown.expected_V,
        core_temp_C=known.core_temp_C,
        warnings=warnings,
        resistance_scale=known.resistance_scale,
        capacity_scale=known.capacity_scale,
        resistance_scale_sd=known.resistance_scale_sd,
        capacity_scale_sd=known.capacity_scale_sd,
        wear=known.wear,
        wear_sd=known.wear_sd,
    )


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
