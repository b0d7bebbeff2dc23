"""Can a replay of this log be trusted? Plain rules, each with its reason in words.

"no": the log is too short or too slow, or it lacks the current that the filter needs. "with care": something may make
the result wrong. Remarks do not change the judgement, but explain a wide interval.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from uavbatt.limits import (
    HIGHEST_CELL_V,
    LONGEST_ROW_S,
    LOWEST_CELL_V,
    capacity_doubt,
    cells_from_voltage,
    ending_doubt,
)
from uavbatt.records import PackFacts, Sample

_YES, _CARE, _NO = 0, 1, 2
_WORDS = {_YES: "yes", _CARE: "with care", _NO: "no"}
_MIN_ROWS, _MIN_DURATION_S, _MAX_STEP_S = 10, 30.0, 60.0
_LONG_GAP_S = 10.0
_CUT_RECORD_BYTES = 300
_MISMATCH, _MISMATCH_AH = 0.10, 0.05
_LOOSE_SAG = -0.3  # real logs with simultaneous readings lie between -0.5 and -1
# Notes of the readers that bear on the result, by their first words.
_GRAVE_NOTES = ("reboot", "clock leap", "battery records carry no time", "no BATTERY_STATUS", "the file is damaged")
_DEFAULT_CAPACITY = "3300 mAh"

Finding = tuple[int, str]  # severity, reason


@dataclass(frozen=True, slots=True)
class Findings:
    """Findings are what the judgement rests on; gaps are (start [s], length [s])."""

    samples: Sequence[Sample]
    step_s: float
    gaps: Sequence[tuple[float, float]]
    drawn_Ah: float
    counter_Ah: float
    facts: PackFacts
    temperature: str
    sag_correlation: float
    skipped_bytes: int
    notes: Sequence[str]


def verdict(found: Findings) -> tuple[str, tuple[str, ...]]:
    """Return the judgement ("yes", "with care" or "no") and its reasons, the most severe first."""
    findings = [*_rows(found), *_current(found), *_voltage(found), *_surroundings(found)]
    findings.sort(key=lambda finding: -finding[0])
    gravest = findings[0][0] if findings else _YES
    return _WORDS[gravest], tuple(reason for _, reason in findings)


def _rows(found: Findings) -> Iterator[Finding]:
    rows = len(found.samples)
    span_s = found.samples[-1].time_s - found.samples[0].time_s if rows else 0.0
    if rows < _MIN_ROWS or span_s < _MIN_DURATION_S:
        yield _NO, f"too short: {rows} rows in {span_s:.0f} s"
    if found.step_s > _MAX_STEP_S:
        slip = " (milliseconds?)" if found.step_s >= LONGEST_ROW_S else ""
        yield _NO, f"too slow: a row every {found.step_s:.0f} s{slip}"
    long_gaps = [(start_s, length_s) for start_s, length_s in found.gaps if length_s > _LONG_GAP_S]
    if long_gaps:
        start_s, length_s = max(long_gaps, key=lambda gap: gap[1])
        yield _CARE, f"{len(long_gaps)} gaps over 10 s, the longest {length_s:.0f} s at {start_s:.0f} s"
    if found.skipped_bytes:
        # the tail of a log is often cut inside its last record, which harms nothing
        severity = _CARE if found.skipped_bytes > _CUT_RECORD_BYTES else _YES
        yield severity, f"{found.skipped_bytes} bytes of the log could not be read"
    for note in found.notes:
        if note.startswith(_GRAVE_NOTES) or _DEFAULT_CAPACITY in note:
            yield _CARE, note


def _current(found: Findings) -> Iterator[Finding]:
    known = [s.current_A for s in found.samples if math.isfinite(s.current_A)]
    absent = 1 - len(known) / max(len(found.samples), 1)
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
    gap_Ah = abs(found.drawn_Ah - found.counter_Ah)
    if gap_Ah > max(_MISMATCH_AH, _MISMATCH * found.counter_Ah):
        yield _CARE, f"the current adds up to {found.drawn_Ah:.2f} Ah, the counter says {found.counter_Ah:.2f} Ah"


def _voltage(found: Findings) -> Iterator[Finding]:
    if found.facts.sag_compensated:
        yield _CARE, "the autopilot sends sag-compensated voltage (BATT_OPTIONS bit 6), not the measured one"
    elif found.sag_correlation > _LOOSE_SAG:
        yield (
            _CARE,
            (
                f"voltage hardly follows current (correlation {found.sag_correlation:.2f}):"
                " not simultaneous, or sag-compensated"
            ),
        )
    known_V = [s.voltage_V for s in found.samples if math.isfinite(s.voltage_V)]
    if known_V:
        yield from _statements(found.facts, known_V)


def _statements(facts: PackFacts, known_V: Sequence[float]) -> Iterator[Finding]:
    """Compare what the vehicle states of its pack with the voltages that were measured [V], at least one."""
    lowest_V, highest_V = min(known_V), max(known_V)
    cells = facts.cells_series
    if cells and (lowest_V < LOWEST_CELL_V * cells or highest_V > HIGHEST_CELL_V * cells):
        spoken = f"{lowest_V / cells:.2f} .. {highest_V / cells:.2f} V per cell"
        yield _CARE, f"{spoken} with {cells} cells: is the count right?"
        cells = None
    cells = cells or cells_from_voltage(known_V[0], endings_V=facts.endings_V)[0]
    for doubt in (
        capacity_doubt(facts.capacity_Ah),
        ending_doubt("critical voltage ", facts.critical_voltage_V, cells),
        ending_doubt("low-voltage warning ", facts.low_voltage_V, cells),
    ):
        if doubt is not None:
            yield _CARE, f"the vehicle states {doubt.words}"


def _surroundings(found: Findings) -> Iterator[Finding]:
    if found.temperature == "absent":
        yield _YES, "no temperature: the interval will be wider"
    elif found.facts.temperature_of_escs:
        yield _CARE, "temperature: of the motor controllers (BATT_MONITOR 9), not the pack's: not used"
    elif found.temperature != "plausible":
        yield _CARE, f"temperature: {found.temperature}"
    if not found.facts.capacity_Ah > 0:
        yield _YES, "the log does not state the capacity"
