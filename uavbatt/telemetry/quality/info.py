"""Description of a log, and a judgement if a replay of it can be trusted: `describe(flight)`, `lines(info)`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise
from statistics import median

from uavbatt.limits import KELVIN
from uavbatt.navigation import NOWHERE, Navigation
from uavbatt.records import NAN, Flight, Identity, PackFacts, Sample
from uavbatt.telemetry.cleaning.readings import BOARD_START_C, MAX_CELL_C, MAX_SLOPE_K_PER_S, MIN_CELL_C, SLACK_K
from uavbatt.telemetry.quality.drawn import drawn
from uavbatt.telemetry.quality.trust import LogFigures, verdict

SHOWN_GAPS = 5
_LIVE_AFTER_S = 120.0  # in a shorter record a sound sensor may be constant
_MIN_STEPS = 20
_MIN_STEP_A = 1.0
_MAX_STEP_S = 5.0
_OPTIONAL = ("current_A", "temp_C", "consumed_Ah", "reported_soc")


@dataclass(frozen=True, slots=True)
class LogInfo:
    """LogInfo holds a log, its figures, and the judgement: `trust` is "yes", "with care" or "no"."""

    flight: Flight
    figures: LogFigures
    trust: str
    reasons: tuple[str, ...]


def describe(flight: Flight) -> LogInfo:
    """Measure a log and judge whether a replay of it can be trusted."""
    samples = flight.samples
    step_s = median_step_s(samples)
    limit_s = gap_limit_s(step_s)
    figures = LogFigures(
        flight=flight,
        step_s=step_s,
        gaps=tuple((a.time_s, b.time_s - a.time_s) for a, b in pairwise(samples) if b.time_s - a.time_s > limit_s),
        total=drawn(samples, limit_s),
        facts=flight.facts_at(math.inf),
        temperature=temperature_verdict(samples),
        sag_correlation=sag_correlation(samples),
    )
    return LogInfo(flight, figures, *verdict(figures))


def median_step_s(samples: Sequence[Sample]) -> float:
    """Return the median time between rows [s]; NaN with fewer than two rows."""
    steps_s = [b.time_s - a.time_s for a, b in pairwise(samples)]
    return median(steps_s) if steps_s else NAN


def gap_limit_s(step_s: float) -> float:
    """Return the step [s] above which a step is a gap: 5 median steps or 10 s, but never under 2 median steps.

    The floor keeps a log with a row every 12 s from being all gaps.
    """
    return max(2 * step_s, min(5 * step_s, 10.0))


def missing(samples: Sequence[Sample]) -> tuple[str, ...]:
    """Return the names of the columns that no row fills."""
    empty = [name for name in _OPTIONAL if all(math.isnan(getattr(s, name)) for s in samples)]
    return tuple(empty + (["armed"] if all(s.armed is None for s in samples) else []))


def lines(info: LogInfo) -> list[str]:
    """Return the description as lines of text."""
    flight, found, samples = info.flight, info.figures, info.flight.samples
    others = ", ".join(str(i) for i in flight.instances)
    rate_Hz = 1.0 / found.step_s if found.step_s > 0.0 else NAN
    text = [
        f"log          {flight.source} ({flight.kind})",
        f"vehicle      {_vehicle(flight.identity)}",
        f"battery      instance {flight.instance}; the log has {others}",
        f"rows         {len(samples)} in {flight.duration_s:.0f} s, median rate {_number(rate_Hz, 'Hz')}",
        f"voltage      {_span((s.voltage_V for s in samples), 'V')}",
        f"current      {_span((s.current_A for s in samples), 'A')}",
        f"temperature  {_temperature(samples, found.temperature)}",
        f"charge       {_number(found.total.charge_Ah, 'Ah')} from the current,"
        f" {_number(found.total.counter_Ah, 'Ah')} by the autopilot's counter",
        f"pack         {_facts(found.facts)}",
        f"route        {_route(flight.navigation)}",
        f"missing      {', '.join(missing(samples)) or 'nothing'}",
        f"gaps         {_gaps(found.gaps)}",
    ]
    text += [f"note         {note}" for note in flight.notes]
    text.append(f"trust        {info.trust}")
    return text + [f"             - {reason}" for reason in info.reasons]


def _vehicle(who: Identity) -> str:
    started = datetime.fromtimestamp(who.start_utc_s, UTC) if math.isfinite(who.start_utc_s) else None
    said = [
        f"system {who.system}" if who.system is not None else "",
        f"hardware {who.hardware}" if who.hardware else "",
        who.firmware,
        f"battery serial {who.battery_serial}" if who.battery_serial else "",
        started.strftime("started %Y-%m-%d %H:%M:%S UTC") if started else "",
    ]
    return ", ".join(s for s in said if s) or "not named in the log"


def _number(value: float, unit: str) -> str:
    return f"{value:.3g} {unit}" if math.isfinite(value) else "unknown"


def _span(values: Iterable[float], unit: str) -> str:
    finite = [value for value in values if math.isfinite(value)]
    return f"{min(finite):.2f} .. {max(finite):.2f} {unit}" if finite else "not measured"


def _temperature(samples: Sequence[Sample], verdict: str) -> str:
    span = _span((s.temp_C for s in samples), "°C")
    return span if verdict == "absent" else f"{span}, {verdict}"


def _route(navigation: Sequence[Navigation]) -> str:
    """Return what a log tells of route and place, in words."""
    last = navigation[-1] if navigation else NOWHERE
    mission = last.mission
    said = [
        "" if mission is None else f"mission of {len(mission.items)} items" if not mission.reason else mission.reason,
        "home" if last.home is not None else "",
        "positions" if last.position is not None else "",
        "progress" if last.current is not None else "",
        "wind" if last.wind is not None else "",
    ]
    return ", ".join(s for s in said if s) or "not in the log"


def _facts(facts: PackFacts) -> str:
    said = [
        f"{facts.cells_series} cells" if facts.cells_series else "",
        f"{facts.capacity_Ah:g} Ah" if facts.capacity_Ah > 0 else "",
        f"low {facts.low_voltage_V:.4g} V" if facts.low_voltage_V > 0 else "",
        f"critical {facts.critical_voltage_V:.4g} V" if facts.critical_voltage_V > 0 else "",
        f"autopilot acts at {facts.acts_below_soc:.0%} left by its own count" if facts.acts_below_soc > 0 else "",
        "sag-compensated voltage" if facts.sag_compensated else "",
    ]
    return ", ".join(s for s in said if s) or "not described in the log"


def _gaps(gaps: Sequence[tuple[float, float]]) -> str:
    if not gaps:
        return "none"
    listed = ", ".join(f"{length_s:.1f} s at {start_s:.0f} s" for start_s, length_s in gaps[:SHOWN_GAPS])
    return f"{len(gaps)}: {listed}" + (", ..." if len(gaps) > SHOWN_GAPS else "")


def temperature_verdict(samples: Sequence[Sample]) -> str:
    """Judge the temperature of a log: `absent`, `plausible`, or the reason why it is doubtful."""
    rows = [(s.time_s, s.temp_C) for s in samples if math.isfinite(s.temp_C)]
    if not rows:
        return "absent"
    if all(KELVIN[0] <= temp_C <= KELVIN[1] for _, temp_C in rows):
        return "impossible values (kelvin?)"
    if any(not MIN_CELL_C <= temp_C <= MAX_CELL_C for _, temp_C in rows):
        return "impossible values (unit?)"
    if len({temp_C for _, temp_C in rows}) == 1 and rows[-1][0] - rows[0][0] >= _LIVE_AFTER_S:
        return "constant (no live sensor?)"
    if rows[0][1] > BOARD_START_C:
        return "hot from the start (board sensor?)"
    jumps = sum(abs(c1 - c0) > SLACK_K + MAX_SLOPE_K_PER_S * (t1 - t0) for (t0, c0), (t1, c1) in pairwise(rows))
    return "jumps (not a cell's temperature?)" if jumps > len(rows) // 100 else "plausible"


def sag_correlation(samples: Sequence[Sample]) -> float:
    """Return the correlation of voltage steps with current steps; NaN with fewer than 20 steps above 1 A.

    Near -1 both were measured at the same instant. Near 0 they were not (smart packs), or the autopilot has removed the
    sag from the voltage.
    """
    steps = [
        (b.voltage_V - a.voltage_V, b.current_A - a.current_A)
        for a, b in pairwise(samples)
        if 0 < b.time_s - a.time_s <= _MAX_STEP_S
    ]
    steps = [(dv, di) for dv, di in steps if math.isfinite(dv) and abs(di) > _MIN_STEP_A]
    if len(steps) < _MIN_STEPS:
        return NAN
    cross = sum(dv * di for dv, di in steps)
    scale = math.sqrt(sum(dv * dv for dv, _ in steps) * sum(di * di for _, di in steps))
    return cross / scale if scale > 0 else 0.0
