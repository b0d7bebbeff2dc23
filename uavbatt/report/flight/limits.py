"""Sentences under the answer of a flight page: charge, accuracy of the forecasts, alarm, and doubts."""

from __future__ import annotations

import math
from collections.abc import Sequence

from uavbatt.battery.battery_file import GENERIC, GENERIC_LITHIUM_ION
from uavbatt.battery.sizing.pack_size import FROM_BATTERY_FILE, PackSize
from uavbatt.log_replay.outcome import Checkpoint, Outcome
from uavbatt.log_replay.run import ReplayedRow
from uavbatt.notice import Kind, kind_of
from uavbatt.prediction.pending import ALARM_S
from uavbatt.records import ALARM_RISK, Z90, Status
from uavbatt.report.page import duration, number, sentence

# The load of the last minute, and how much flight the charge must promise, before low voltage is explained.
LAST_S, MUCH_LEFT_S = 60.0, 300.0
FLOWN_ON_S = 60.0  # longer than a landing takes
VOLTAGE_SHARE = 0.4  # of the time by the charge alone: below it the voltage is explained
OTHERWISE_SAID = (Kind.ALARM, Kind.UNCERTIFIED, Kind.TURN_BACK)  # warnings that stand on the page in other words


def limits_of(outcome: Outcome, resolved: PackSize, steps: Sequence[ReplayedRow]) -> list[str]:
    """Return the sentences under the answer, the most important first."""
    return [
        *(f"{sentence(words)}." for words in flown_on(outcome, resolved)),
        *_alarm(steps),
        _charge_words(outcome),
        *_ended_by_voltage(outcome, resolved, steps),
        *_doubts(outcome, steps),
        _accuracy_words(outcome, resolved),
    ]


def flown_on(outcome: Outcome, resolved: PackSize) -> list[str]:
    """Return in words that the flight went on long after its end, if nobody stated the cut-off: it is another one."""
    if resolved.cutoff_from != FROM_BATTERY_FILE or not outcome.flown_on_s > FLOWN_ON_S:
        return []
    other = f", and for lithium-ion cells --battery {GENERIC_LITHIUM_ION}" if resolved.battery == GENERIC else ""
    on = duration(outcome.flown_on_s)
    return [f"nobody stated the cut-off, and it flew on below it for {on}: give --cutoff-voltage{other}"]


def _charge_words(outcome: Outcome) -> str:
    if not math.isfinite(outcome.end_soc):
        return "No state of charge could be given for this log."
    low, high = charge_interval(outcome)
    percent, low_said, high_said = (number(100.0 * soc, 0) for soc in (outcome.end_soc, low, high))
    return f"{percent} % charge left at the end of the log ({low_said} to {high_said} %)."


def charge_interval(outcome: Outcome) -> tuple[float, float]:
    """Return the 90 % interval of the charge at the log's end, within 0 to 1."""
    low, high = (min(max(outcome.end_soc + k * outcome.end_soc_sd, 0.0), 1.0) for k in (-Z90, Z90))
    return low, high


def _ended_by_voltage(outcome: Outcome, resolved: PackSize, steps: Sequence[ReplayedRow]) -> list[str]:
    """Return in words why a flight ends long before its charge is used up; else the reader would doubt both numbers."""
    landing = outcome.landing
    if landing is None or not math.isfinite(landing.remaining_s) or math.isfinite(outcome.end_of_flight_s):
        return []
    last = [s.estimate for s in steps if 0.0 <= landing.time_s - s.estimate.time_s <= LAST_S]
    currents_A = [e.current_A for e in last if math.isfinite(e.current_A)]
    mean_A = sum(currents_A) / len(currents_A) if currents_A else math.nan
    by_charge_s = 3600.0 * last[-1].soc * resolved.capacity_Ah / mean_A if mean_A > 0.0 else math.nan
    if not (by_charge_s > MUCH_LEFT_S and landing.remaining_s < VOLTAGE_SHARE * by_charge_s):
        return []
    cutoff = number(resolved.cutoff_V, 2, "V")
    return [
        f"The voltage ends it, not the charge, which would last {duration(by_charge_s)} at the last minute's current: "
        f"under load it falls below {cutoff} ({resolved.cutoff_from})."
    ]


def _doubts(outcome: Outcome, steps: Sequence[ReplayedRow]) -> list[str]:
    """Return the warnings at the forecast that the answer uses."""
    if outcome.landing is None:
        return []
    step = next((s for s in steps if s.remaining.time_s >= outcome.landing.time_s), None)
    warnings = () if step is None else step.estimate.warnings
    return [f"{sentence(w)}." for w in warnings if kind_of(w) not in OTHERWISE_SAID]


def _alarm(steps: Sequence[ReplayedRow]) -> list[str]:
    """Return the alarm at the end, with the time since which it held."""
    forecasts = [s.remaining for s in steps if s.remaining.status is not Status.REFUSED]
    since_s = math.nan
    for forecast in forecasts:
        alarmed = forecast.remaining_alarm_s <= ALARM_S
        since_s = (since_s if math.isfinite(since_s) else forecast.time_s) if alarmed else math.nan
    if not math.isfinite(since_s):
        return []
    chance = f"about 1 in {round(1.0 / ALARM_RISK)} chance"
    return [f"The alarm stood from {duration(since_s)} on: {chance} that less than 2 minutes were left."]


def _accuracy_words(outcome: Outcome, resolved: PackSize) -> str:
    """Return in words how accurate the forecasts were, if the log shows the end of flight."""
    if outcome.reserve_soc > 0.0:
        return f"{sentence(against_a_reserve(outcome.reserve_soc))}."
    if outcome.checkpoints:
        return "; ".join(_error_words(c) for c in (*outcome.checkpoints[:1], *_late(outcome))) + "."
    if math.isfinite(outcome.end_of_flight_s):
        return "Too short before its end to check a forecast."
    cutoff = number(resolved.cutoff_V, 2, "V")
    return (
        "Not checked against the truth: the flight ended before its battery did, which ends below "
        f"{cutoff} under load ({resolved.cutoff_from})."
    )


def against_a_reserve(reserve_soc: float) -> str:
    """Return in words why forecasts with a reserve are not compared with the end in the log."""
    return f"the forecasts end at the reserve of {reserve_soc:.0%}, the log at the cut-off: they are not compared"


def _late(outcome: Outcome) -> Sequence[Checkpoint]:
    return [c for c in outcome.checkpoints[1:] if "120" in c.label] or outcome.checkpoints[-1:]


def _error_words(c: Checkpoint) -> str:
    when = "At half time" if c.label.startswith("half") else f"{c.label} the end"
    if not math.isfinite(c.remaining_s):
        return f"{when}: the forecast was refused"
    way = "too long" if c.error_s > 0 else "too short"
    side = "inside" if c.inside else "outside"
    return f"{when}: the forecast was {duration(abs(c.error_s))} {way}, truth {side} its 90 % interval"
