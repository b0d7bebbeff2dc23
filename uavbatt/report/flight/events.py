"""Events of a flight for the pilot's chart: take-off, flight modes, warnings, landing."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from uavbatt.log_replay.in_air import InAir, first_below_s, in_air
from uavbatt.log_replay.outcome import Outcome
from uavbatt.log_replay.run import ReplayedRow, route_forecasts
from uavbatt.navigation import Mode
from uavbatt.notice import Kind, kind_of
from uavbatt.prediction.pending import ALARM_S
from uavbatt.records import Flight, Status

MODES = {
    Mode.MISSION: "mission", Mode.RETURN: "return", Mode.RETURN_BY_TRACK: "return", Mode.LAND: "land",
    Mode.TAKEOFF: "take-off mode", Mode.HOLD: "hold", Mode.MANUAL: "manual",
}  # fmt: skip
MOST_MODES = 12  # a flight that changes more often shows none
LEAST_WAIT_S, MOST_WAITS = 20.0, 6  # of the waits on the ground that are shown


class Event(NamedTuple):
    """An Event happened `time_s` [s] after the log's start; `tells_danger` : the pilot must act."""

    time_s: float
    words: str
    tells_danger: bool = False


def events(flight: Flight, steps: Sequence[ReplayedRow], outcome: Outcome, low_V: float) -> list[Event]:
    """Return the events of the flight, in order of time.

    low_V : voltage of the vehicle's low-voltage warning [V]; NaN if none is stated
    """
    air = in_air(steps)
    moments = [*_air(steps, outcome), *_waits(steps, outcome, air), *_modes(flight), *_warnings(steps, air, low_V)]
    if math.isfinite(outcome.end_of_flight_s):
        moments.append(Event(outcome.end_of_flight_s, "battery at its end", True))
    return sorted(moments)


def _air(steps: Sequence[ReplayedRow], outcome: Outcome) -> Iterator[Event]:
    """Return take-off and landing, if the log includes the ground before and after them."""
    on_ground = [kind_of(s.remaining.reason) is Kind.NOT_FLYING for s in steps]
    if True in on_ground and False in on_ground[on_ground.index(True) :]:
        k = on_ground.index(False, on_ground.index(True))
        yield Event(steps[k].estimate.time_s, "take-off")
    if outcome.landing is not None and not outcome.landing.is_cut:
        after = (s.estimate.time_s for s, rests in zip(steps, on_ground, strict=True) if rests)
        landed_s = next((t for t in after if t >= outcome.landing.time_s), outcome.landing.time_s)
        yield Event(landed_s, "landed")


def _waits(steps: Sequence[ReplayedRow], outcome: Outcome, air: InAir) -> Iterator[Event]:
    """Return landing and take-off at each wait on the ground between two flights of a pack; none if there are many."""
    flown_s = [s.estimate.time_s for s, is_flying in zip(steps, air.flying, strict=True) if is_flying]
    long = [(begin_s, end_s) for begin_s, end_s in outcome.waits if end_s - begin_s >= LEAST_WAIT_S]
    between = [(begin_s, end_s) for begin_s, end_s in long if flown_s and flown_s[0] < begin_s and end_s <= flown_s[-1]]
    if len(between) <= MOST_WAITS:
        for begin_s, end_s in between:
            yield Event(begin_s, "landed")
            yield Event(end_s, "take-off")


def _modes(flight: Flight) -> list[Event]:
    """Return the changes of the flight mode."""
    changes = [n for n in flight.navigation if n.mode in MODES and math.isfinite(n.mode_since_s)]
    changed = [after for before, after in pairwise(changes) if after.mode is not before.mode]
    return [Event(n.mode_since_s, MODES[n.mode]) for n in changed] if len(changed) <= MOST_MODES else []


def _warnings(steps: Sequence[ReplayedRow], air: InAir, low_V: float) -> Iterator[Event]:
    """Return the first low voltage, the first alarm, and the first “turn back now”."""
    time_s, volts = (np.array([getattr(s.estimate, name) for s in steps]) for name in ("time_s", "voltage_V"))
    if math.isfinite(low_V) and np.isfinite(volts).any():
        low_s = first_below_s(time_s, volts, air, low_V)
        if math.isfinite(low_s):
            yield Event(low_s, "low voltage", True)
    forecasts = [s.remaining for s in steps if s.remaining.status is not Status.REFUSED]
    alarm_s = next((r.time_s for r in forecasts if r.remaining_alarm_s <= ALARM_S), math.nan)
    if math.isfinite(alarm_s):
        yield Event(alarm_s, "alarm", True)
    turn_s = route_forecasts(steps).turn_back_now_s
    if math.isfinite(turn_s):
        yield Event(turn_s, "turn back now", True)


def apart(moments: Sequence[Event], least_s: float) -> list[Event]:
    """Join the words of events that lie less than `least_s` [s] behind the one before."""
    out: list[Event] = []
    for event in moments:
        if out and event.time_s - out[-1].time_s < least_s:
            last = out[-1]
            words = last.words if event.words in last.words.split(", ") else f"{last.words}, {event.words}"
            out[-1] = Event(last.time_s, words, last.tells_danger or event.tells_danger)
        else:
            out.append(event)
    return out
