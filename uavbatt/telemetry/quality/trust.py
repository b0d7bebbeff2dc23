"""Can a replay of this log be trusted? Plain rules, each with its reason in words.

"no": the log is too short or too slow, or it lacks the current that the filter needs. "with care": something may make
the result wrong. Remarks do not change the judgement, but explain a wide interval.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from uavbatt.limits import (
    HIGHEST_CELL_V,
    LONGEST_ROW_S,
    LOWEST_CELL_V,
    capacity_doubt,
    cells_from_voltage,
    ending_doubt,
    told_cells,
)
from uavbatt.output import counted
from uavbatt.records import Flight, PackFacts
from uavbatt.telemetry.quality.drawn import DrawnCharge, with_pack

_YES, _CARE, _NO = 0, 1, 2
_WORDS = {_YES: "yes", _CARE: "with care", _NO: "no"}
_MIN_ROWS, _MIN_DURATION_S, _MAX_STEP_S = 10, 30.0, 60.0
_LONG_GAP_S = 10.0
_CUT_RECORD_BYTES = 300
_MISMATCH, _MISMATCH_AH = 0.10, 0.05
_LOOSE_SAG = -0.3  # real logs with simultaneous readings lie between -0.5 and -1
# Notes of the readers that matter for the result, by their first words.
_GRAVE_NOTES = ("reboot", "clock leap", "battery records carry no time", "no BATTERY_STATUS", "the file is damaged")
_DEFAULT_CAPACITY = "3300 mAh"

Finding = tuple[int, str]  # severity, reason


@dataclass(frozen=True, slots=True)
class LogFigures:
    """LogFigures holds the figures of a log by which it is judged.

    step_s : median time between rows [s], NaN with fewer than two; gaps : (start [s], length [s]); total : charge by
    the current and by the autopilot's counter, without the gaps; facts : all that the vehicle states of its pack
    """

    flight: Flight
    step_s: float
    gaps: Sequence[tuple[float, float]]
    total: DrawnCharge
    facts: PackFacts
    temperature: str
    sag_correlation: float


def verdict(found: LogFigures) -> tuple[str, tuple[str, ...]]:
    """Return the judgement ("yes", "with care" or "no") and its reasons, the most severe first."""
    findings = [*_rows(found), *_current(found), *_voltage(found), *_surroundings(found)]
    findings.sort(key=lambda finding: -finding[0])
    gravest = findings[0][0] if findings else _YES
    return _WORDS[gravest], tuple(reason for _, reason in findings)


def _rows(found: LogFigures) -> Iterator[Finding]:
    rows = len(found.flight.samples)
    span_s = found.flight.samples[-1].time_s - found.flight.samples[0].time_s if rows else 0.0
    if rows < _MIN_ROWS or span_s < _MIN_DURATION_S:
        yield _NO, f"too short: {rows} rows in {span_s:.0f} s"
    if found.step_s > _MAX_STEP_S:
        slip = " (milliseconds?)" if found.step_s >= LONGEST_ROW_S else ""
        yield _NO, f"too slow: a row every {found.step_s:.0f} s{slip}"
    long_gaps = [gap for gap in found.gaps if gap[1] > _LONG_GAP_S and not _is_change(*gap, found.flight)]
    if long_gaps:
        start_s, length_s = max(long_gaps, key=lambda gap: gap[1])
        yield _CARE, f"{counted(len(long_gaps), 'gap')} over 10 s, the longest {length_s:.0f} s at {start_s:.0f} s"
    if found.flight.skipped_bytes:
        # the tail of a log is often cut inside its last record, which harms nothing
        severity = _CARE if found.flight.skipped_bytes > _CUT_RECORD_BYTES else _YES
        yield severity, f"{found.flight.skipped_bytes} bytes of the log could not be read"
    for note in found.flight.notes:
        if note.startswith(_GRAVE_NOTES) or _DEFAULT_CAPACITY in note:
            yield _CARE, note


def _is_change(start_s: float, length_s: float, flight: Flight) -> bool:
    """Return True for a silence in which the pack was changed or charged: nothing of a flight is missing."""
    return any(0.0 < begin_s - start_s <= length_s for begin_s, _ in flight.discharges)


def _current(found: LogFigures) -> Iterator[Finding]:
    known = [s.current_A for s in found.flight.samples if math.isfinite(s.current_A)]
    absent = 1 - len(known) / max(len(found.flight.samples), 1)
    if not known:
        yield _NO, "no current: the charge drawn cannot be counted"
        return
    if len(known) >= _MIN_ROWS and len(set(known)) == 1:
        yield _NO, f"the current is {known[0]:g} A throughout: no live sensor"
    if max(known) <= 0.0 and min(known) < 0.0:
        yield _NO, "the current is negative throughout: is the sensor's sign reversed?"
    if absent > 0.5:
        yield _NO, f"no current in {absent:.0%} of the rows"
    elif absent > 0.05:
        yield _CARE, f"no current in {absent:.0%} of the rows"
    drawn_Ah, counter_Ah = found.total.charge_Ah, found.total.counter_Ah
    if abs(drawn_Ah - counter_Ah) > max(_MISMATCH_AH, _MISMATCH * counter_Ah):
        yield _CARE, f"the current adds up to {drawn_Ah:.2f} Ah, the counter says {counter_Ah:.2f} Ah"


def _voltage(found: LogFigures) -> Iterator[Finding]:
    if found.facts.sag_compensated:
        yield _CARE, "the autopilot sends sag-compensated voltage (BATT_OPTIONS bit 6), not the measured one"
    elif found.sag_correlation > _LOOSE_SAG:
        correlation = f"correlation {found.sag_correlation:.2f}"
        yield _CARE, f"voltage hardly follows current ({correlation}): not simultaneous, or sag-compensated"
    samples = found.flight.samples
    has_pack = with_pack(np.array([s.voltage_V for s in samples]), np.array([s.current_A for s in samples]))
    known = [sample for sample, has in zip(samples, has_pack.tolist(), strict=True) if has]
    if known:
        told = told_cells(known[0].cell_voltages_V, known[0].voltage_V)
        yield from _statements(found.facts, [s.voltage_V for s in known], told)


def _statements(facts: PackFacts, known_V: Sequence[float], told: int) -> Iterator[Finding]:
    """Compare what the vehicle states of its pack with the voltages that were measured [V], at least one.

    told : cells that the first row tells one by one; 0 if none.
    """
    lowest_V, highest_V = min(known_V), max(known_V)
    cells = facts.cells_series
    if cells and (lowest_V < LOWEST_CELL_V * cells or highest_V > HIGHEST_CELL_V * cells):
        spoken = f"{lowest_V / cells:.2f} .. {highest_V / cells:.2f} V per cell"
        yield _CARE, f"{spoken} with {cells} cells: is the count right?"
        cells = None
    cells = cells or told or cells_from_voltage(known_V[0], endings_V=facts.endings_V)[0]
    for doubt in (
        capacity_doubt(facts.capacity_Ah),
        ending_doubt("critical voltage ", facts.critical_voltage_V, cells),
        ending_doubt("low-voltage warning ", facts.low_voltage_V, cells),
    ):
        if doubt is not None:
            yield _CARE, f"the vehicle states {doubt.words}"


def _surroundings(found: LogFigures) -> Iterator[Finding]:
    if found.temperature == "absent":
        yield _YES, "no temperature: the interval will be wider"
    elif found.facts.temperature_of_escs:
        yield _CARE, "temperature: of the motor controllers (BATT_MONITOR 9), not the pack's: not used"
    elif found.temperature != "plausible":
        yield _CARE, f"temperature: {found.temperature}"
    if not found.facts.capacity_Ah > 0:
        yield _YES, "the log does not state the capacity"
