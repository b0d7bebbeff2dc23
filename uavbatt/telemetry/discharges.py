"""The discharges in one log: a ground station may go on recording while the pack is changed or charged.

Without its pack a vehicle is silent. After a silence another pack, or the same one charged, shows a higher voltage at
rest than the old one can reach by resting. A counter of charge that has begun again says that the autopilot had no
power, and then a smaller difference tells, upwards or downwards. So does another serial number of a smart battery. In a
dock the autopilot speaks on while the pack is charged, with a supply of its own while no pack is in. A pack that goes
on being discharged after a silence or a landing is the same discharge.

In flight the model of the battery tells the same sooner (`estimation.pack_change`); a fit has no model yet.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from uavbatt.records import NAN, Flight
from uavbatt.telemetry.columns import Columns
from uavbatt.telemetry.quality.drawn import loaded_A, with_pack
from uavbatt.telemetry.quality.last_digit import last_digit

SILENCE_S, BEFORE_S, AFTER_S = 9.9, 30.0, 15.0  # a reboot leaves a gap of 10 s in a DataFlash log
# Voltage after the silence over the highest one before it, from which on the pack is another or was charged: a pack at
# rest rises by 2 % at most, one that was under load by 7 %. With a counter that has begun again half of it is enough.
RESTED, LOADED, RESTARTED = 1.035, 1.1, 0.5
COUNTER_SLACK_AH = 0.02
# A pack that rests as high as before the take-off, but for a hundredth, although it has lost so much under load.
FULL_AGAIN, LOST = 0.99, 0.04
# The shortest charge between two flights, and the rest by which a voltage has settled.
DOCKED_S, SETTLED_S = 600.0, 60.0
LEAST_LOADED_S = 30.0  # a discharge with less load is no flight
# On the ground, so long after a load, the voltage does not leap by this share, nor by more than its last digit, while
# the current or the power stays within such a share of itself or of the least load.
QUIET_S, LEAPT, LEAPT_STEPS, SAME_SHARE, SAME_OF_LOAD = 15.0, 0.0125, 1.5, 0.2, 0.1


def later_discharges(
    rows: Columns, told: Sequence[tuple[float, str]], stated: Sequence[tuple[float, str]]
) -> tuple[tuple[float, str], ...]:
    """Return when each later discharge of a log begins [s], with the serial of its pack; empty if nothing tells it.

    told, stated : serials by the packs themselves, and by the parameters, which last; each with its time [s]
    """
    found = []
    for begin_s, end_s in pairwise([*begins_s(rows, told or stated), np.inf]):
        after_s, until_s = last_row_s(rows, begin_s), last_row_s(rows, end_s)
        of_pack = [serial for time_s, serial in told if after_s < time_s <= until_s]
        of_vehicle = [serial for time_s, serial in stated if time_s <= until_s]
        found.append((begin_s, (of_pack[:1] or of_vehicle[-1:] or [""])[0]))
    return tuple(found)


def last_row_s(rows: Columns, begin_s: float) -> float:
    """Return the time of the last row before a discharge that begins at `begin_s` [s]; infinite if that is infinite.

    What is stated after it is of the next pack: a vehicle that is switched on tells its parameters before its battery.
    """
    if begin_s == np.inf:
        return np.inf
    time_s = rows.time_s[with_pack(rows.voltage_V, rows.current_A)]
    return float(time_s[time_s < begin_s][-1])


def begins_s(rows: Columns, told: Sequence[tuple[float, str]] = ()) -> tuple[float, ...]:
    """Return the times [s] at which another discharge begins than that of the log's first rows.

    told : serials of the packs, each with the time at which it was told [s]
    """
    spoken_s, rows = rows.time_s, rows.at(with_pack(rows.voltage_V, rows.current_A))
    ends = np.flatnonzero(np.diff(rows.time_s) > SILENCE_S)
    least_A = loaded_A(rows.current_A)
    changed_s = [
        begin_s
        for k, silent_s, begin_s in zip(ends.tolist(), *rows.time_s[[ends, ends + 1]].tolist(), strict=True)
        if _has_other_serial(told, silent_s)
        or _is_another(rows, k, least_A)
        or (_rests(rows, k, least_A) and ((silent_s < spoken_s) & (spoken_s < begin_s)).any())  # no pack in it
    ]
    changed_s += _changed_at_once(rows, least_A)
    docked = _docked(rows, least_A)
    charged_s = [begin_s for landed_s, begin_s in docked if not any(landed_s < s <= begin_s for s in changed_s)]
    return tuple(sorted([*changed_s, *charged_s]))


def of_discharges(flight: Flight) -> tuple[Flight, ...]:
    """Return each discharge of a log with a flight in it, as a flight of its own; the whole log if it is one only.

    Times stay those of the log. Rows without a pack are left out at the beginning and at the end of each.
    """
    if not flight.discharges:
        return (with_its_pack(flight),)
    edges_s = [-np.inf, *(time_s for time_s, _ in flight.discharges), np.inf]
    serials = [flight.identity.battery_serial, *(serial for _, serial in flight.discharges)]
    found = [
        with_its_pack(_between(flight, begin_s, end_s, serial))
        for (begin_s, end_s), serial in zip(pairwise(edges_s), serials, strict=True)
    ]
    least_A = loaded_A(np.array([sample.current_A for sample in flight.samples]))
    flown = [part for part in found if _loaded_s(part, least_A) >= LEAST_LOADED_S]
    if len(flown) < 2:
        return (flight,) if not flown else (replace(flown[0], source=flight.source),)
    names = (f"{flight.source}, flight {k} of {len(flown)}" for k in range(1, len(flown) + 1))
    return tuple(replace(part, source=name) for part, name in zip(flown, names, strict=True))


def discharge_notes(discharges: Sequence[tuple[float, str]]) -> list[str]:
    """Return a note where a log holds later discharges, each with its beginning [s]."""
    if not discharges:
        return []
    times = " and ".join(f"{time_s:.0f} s" for time_s, _ in discharges)
    return [f"the pack was changed or charged before {times}: each flight is judged by itself"]


def with_its_pack(flight: Flight) -> Flight:
    """Return the flight without the rows before its pack was connected and after it was taken out.

    It is the same flight if there are none. On USB power, or with a supply of its own, an autopilot tells a voltage
    then as well: one of 5 V made lithium-ion cells of LiPo cells in a fit.
    """
    rows = np.array([(sample.voltage_V, sample.current_A) for sample in flight.samples]).reshape(-1, 2)
    volts, has_pack = rows[:, 0], with_pack(*rows.T)
    places, others = np.flatnonzero(has_pack), np.flatnonzero(np.isfinite(volts) & ~has_pack)
    if not places.size:
        return flight
    first = int(places[0]) if (others < places[0]).any() else 0
    last = int(places[-1]) if (others > places[-1]).any() else len(volts) - 1
    if (first, last) == (0, len(volts) - 1):
        return flight
    samples = flight.samples[first : last + 1]
    later_s = samples[0].time_s - flight.samples[0].time_s
    who = replace(flight.identity, start_utc_s=flight.identity.start_utc_s + later_s)
    return replace(flight, samples=samples, duration_s=samples[-1].time_s - samples[0].time_s, identity=who)


def _between(flight: Flight, begin_s: float, end_s: float, serial: str) -> Flight:
    """Return the rows of a flight from one time to another [s], with what was known then."""
    samples = tuple(sample for sample in flight.samples if begin_s <= sample.time_s < end_s)
    began_s = samples[0].time_s if samples else NAN
    until_s = samples[-1].time_s if samples and end_s < np.inf else end_s  # later statements are of the next pack
    who = flight.identity
    if begin_s > -np.inf:  # what was said of the first pack and its start does not hold
        start_utc_s = who.start_utc_s + began_s
        who = replace(who, battery_serial=serial, battery_cycles=None, start_utc_s=start_utc_s)
    begun = bisect_right(flight.navigation, begin_s, key=lambda known: known.time_s)
    navigation = flight.navigation[max(begun - 1, 0) :]  # what is known at the beginning, and nothing flown before
    return replace(
        flight,
        samples=samples,
        discharges=(),
        facts=tuple((time_s, facts) for time_s, facts in flight.facts if time_s <= until_s),
        navigation=tuple(known for known in navigation if known.time_s < end_s),
        duration_s=samples[-1].time_s - began_s if samples else 0.0,
        identity=who,
    )


def _loaded_s(flight: Flight, least_A: float) -> float:
    """Return how long a flight is under load [s]; infinite if no current tells."""
    if not np.isfinite(least_A):
        return np.inf
    steps = pairwise(flight.samples)
    return sum(min(b.time_s - a.time_s, SILENCE_S) for a, b in steps if a.current_A > least_A)


def _changed_at_once(rows: Columns, least_A: float) -> Iterator[float]:
    """Yield the time [s] of the first row of each pack that was connected before the one before it was taken off."""
    time_s, volts, amps = rows.time_s, rows.voltage_V, rows.current_A
    steps_V = np.abs(np.diff(volts))
    least_V = LEAPT_STEPS * last_digit(volts)
    is_quiet = (amps < least_A) & np.isfinite(least_A)  # a current that is not known is not quiet
    leaps = is_quiet[:-1] & is_quiet[1:] & (steps_V > LEAPT * volts[:-1]) & (np.diff(time_s) <= SILENCE_S)
    for k in np.flatnonzero(leaps).tolist():
        first, near, last = np.searchsorted(time_s, time_s[k] + QUIET_S * np.array([-1.0, -1.0 / 3.0, 1.0 / 3.0]))
        before, after = slice(near, k + 1), slice(k + 1, max(last, k + 2))
        if first == 0 or not is_quiet[first - 1 : after.stop].all():
            continue
        was_V, is_V = float(np.median(volts[before])), float(np.median(volts[after]))
        was_A, is_A = float(np.median(amps[before])), float(np.median(amps[after]))
        off_A = min(abs(is_A - was_A), abs(is_A * is_V / was_V - was_A))
        if abs(is_V - was_V) > max(LEAPT * was_V, least_V) and off_A < max(SAME_SHARE * was_A, SAME_OF_LOAD * least_A):
            yield float(time_s[k + 1])


def _docked(rows: Columns, least_A: float) -> Iterator[tuple[float, float]]:
    """Yield the landing of each pack that was charged in the aircraft [s], and when it had settled after that [s]."""
    loaded_s = rows.time_s[np.nan_to_num(rows.current_A) > least_A]
    ends = np.flatnonzero(np.diff(loaded_s) > DOCKED_S)
    for landed_s, again_s in zip(loaded_s[ends].tolist(), loaded_s[ends + 1].tolist(), strict=True):
        before = (rows.time_s > landed_s + SETTLED_S) & (rows.time_s < landed_s + 2.0 * SETTLED_S)
        after = (rows.time_s > again_s - SETTLED_S) & (rows.time_s < again_s)
        if before.any() and after.any():
            settled_V = float(np.median(rows.voltage_V[after]))
            if settled_V > RESTED * float(np.median(rows.voltage_V[before])):
                yield landed_s, float(rows.time_s[np.argmax(after)])


def _has_other_serial(told: Sequence[tuple[float, str]], silent_s: float) -> bool:
    """Return True if another serial was told after a time [s] than until then."""
    before = [serial for time_s, serial in told if time_s <= silent_s][-1:]
    after = [serial for time_s, serial in told if time_s > silent_s][:1]
    return bool(before and after) and before != after


def _rests(rows: Columns, end: int, least_A: float) -> bool:
    """Return True if the pack is not under load in the row `end` and in the next one; False if no current tells."""
    return bool((rows.current_A[end : end + 2] < least_A).all())


def _is_another(rows: Columns, end: int, least_A: float) -> bool:
    """Return True if the rows after `end`, the last one before a silence, are of another discharge."""
    time_s, amps = rows.time_s, np.nan_to_num(rows.current_A)
    before = np.flatnonzero((time_s <= time_s[end]) & (time_s > time_s[end] - BEFORE_S))
    after = np.flatnonzero((time_s > time_s[end]) & (time_s <= time_s[end + 1] + AFTER_S))
    resting = after[amps[after] < least_A]
    if not resting.size:
        return False
    rested_V, highest_V = float(np.median(rows.voltage_V[resting])), float(np.max(rows.voltage_V[before]))
    if _is_full_again(rows, amps > least_A, rested_V, highest_V):
        return True
    ratio = rested_V / highest_V
    has_rested = np.isfinite(least_A) and (amps[before] < least_A).any()
    most = RESTED if has_rested else LOADED
    if not rows.consumed_Ah[after[0]] < rows.consumed_Ah[end] - COUNTER_SLACK_AH:
        return ratio > most
    slack = 1.0 + RESTARTED * (most - 1.0)
    return not 1.0 / slack < ratio < slack


def _is_full_again(rows: Columns, loaded: NDArray[np.bool_], rested_V: float, highest_V: float) -> bool:
    """Return True if a voltage at rest is that before the take-off, although the pack was discharged since then.

    loaded : marks the rows under load; rested_V : the voltage at rest after a silence; highest_V : just before it
    """
    begins = int(np.argmax(loaded))
    if not begins or not loaded[begins]:
        return False
    begin_s = rows.time_s[begins]
    waited = (rows.time_s < begin_s) & (rows.time_s > begin_s - BEFORE_S)
    took_off = loaded & (rows.time_s < begin_s + BEFORE_S)
    has_lost = highest_V < (1.0 - LOST) * float(np.max(rows.voltage_V[took_off]))
    return has_lost and waited.any() and rested_V > FULL_AGAIN * float(np.median(rows.voltage_V[waited]))
