"""Flights that a fit leaves out: begun in the air or with a part of the charge, or fuller than the cells of the others.

Under load a voltage tells the charge only by the drop, which nobody knows before the fit: it may be three times as
large as usual, and on the flat part of the OCV any charge fits. One log of eight that began five minutes after take-off
bent the OCV of all by up to 0.3 V, and made lithium-ion cells of LiPo cells.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from uavbatt.battery.high_voltage import ORDINARY_FULL_V
from uavbatt.errors import NotEnoughData
from uavbatt.fitting import observed, solve
from uavbatt.fitting.observed import ObservedRecord, Stack
from uavbatt.output import counted
from uavbatt.records import Flight

LEAST_BEGUN_SOC = 0.55  # by a usual drop


def read(flights: Sequence[Flight], cells: int, capacity_Ah: float) -> tuple[list[ObservedRecord], list[str]]:
    """Return the flights that have enough rows with voltage and current, and for each other one what it lacks."""
    found, words = [], []
    for flight in flights:
        try:
            record = observed.from_flight(flight, cells, capacity_Ah)
            observed.binned(record)  # too few bins are refused here; the start is read from the rows themselves
            found.append(record)
        except NotEnoughData as error:
            words.append(str(error))
    return found, words


def from_take_off(flown: list[ObservedRecord]) -> tuple[list[ObservedRecord], list[str]]:
    """Return the flights that begin at rest or nearly full, and for each other one in words why it is left out.

    What half of the flights have in common is no fault of one: then all are kept, and one word of doubt is said.
    """
    if not flown:
        return [], []
    stack = observed.stack(flown)
    is_known = np.logical_or(stack.rested, solve.start_guess(stack) >= LEAST_BEGUN_SOC)
    kept, words = _without(flown, stack, ~is_known, "a part of a flight, or a pack that was not full")
    if not words and not is_known.all():
        begun_later = f"{int(np.sum(~is_known))} of {counted(len(flown), 'flight')}"
        said = f"{begun_later} begin under load with about half the charge or less"
        words = [f"{said}: their start is only guessed, record from before the take-off"]
    return kept, words


def alike_when_full(flown: list[ObservedRecord]) -> tuple[list[ObservedRecord], list[str]]:
    """Return the flights that begin no fuller than ordinary cells, and for each other one why it is left out.

    What half of the flights have in common is no fault of one: then all are kept. A flight that begins under load does
    not tell how full its pack was: three of five begun in the air made ordinary cells of those that charge to 4.35 V.
    """
    if not flown:
        return [], []
    stack = observed.stack(flown)
    is_fuller = stack.voltage_V[0] / stack.cells > ORDINARY_FULL_V  # a load would only lower it
    tells = stack.rested | is_fuller
    return _without(flown, stack, is_fuller, "another voltmeter or type of cell than in the other flights", tells)


def _without(
    flown: list[ObservedRecord],
    stack: Stack,
    marks: NDArray[np.bool_],
    why: str,
    among: NDArray[np.bool_] | None = None,
) -> tuple[list[ObservedRecord], list[str]]:
    """Return the flights without those that are marked, if these are less than half, and the words about each.

    among : the flights of which it is half; all if None
    """
    if 2 * int(np.sum(marks)) >= (len(flown) if among is None else int(np.sum(among))):
        return flown, []
    kept = [record for record, is_out in zip(flown, marks, strict=True) if not is_out]
    return kept, [_said(flown[k], bool(stack.rested[k]), why) for k in np.flatnonzero(marks)]


def _said(record: ObservedRecord, is_rested: bool, why: str) -> str:
    how = "at rest" if is_rested else "under load"
    return f"{record.name} begins {how} at {record.voltage_V[0] / record.cells:.2f} V a cell and is left out: {why}"
