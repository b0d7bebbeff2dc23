"""The slow filter: a Kalman filter over a pack's health from flight to flight.

    x = (ln ohm, ln Ah, their change a flight);  x' = F x + w,  z = (ln ohm, ln Ah) of one flight + v

w is the change by flights and by storage, v the error of one flight's evidence. A flight that does not fit is never
averaged in. A sudden rise of the resistance or loss of capacity is damage: the belief is widened there. A sudden fall
of the resistance or gain of capacity is impossible: it is another pack under the same name; its flight is set aside.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from uavbatt.battery.battery_file import is_generic
from uavbatt.battery.high_voltage import ORDINARY_FULL_V
from uavbatt.battery.model import Array
from uavbatt.battery.remembered import PackHealth
from uavbatt.battery.state_space import mixed_covariance
from uavbatt.packs import findings as odd
from uavbatt.packs.records import FlightRecord, LedgerFlight, PackBelief, PackFinding

# An unknown pack is either as new or used: shares, means and standard deviations of (ln ohm, ln Ah) against its type
# and its rating. LiPo packs lose a fifth of their capacity in 50 to 300 flights, and hard use can take 2 % a flight.
# When a fifth is lost, the resistance has risen by half or more: the trend of ln ohm is twice that of ln Ah.
NEW_SHARE = 0.6
NEW_MEAN, NEW_SD = np.array([0.0, 0.0]), np.array([0.10, 0.03])
USED_MEAN, USED_SD = np.array([0.10, -0.12]), np.array([0.25, 0.10])
TREND_MEAN, TREND_SD = np.array([0.003, -0.0015]), np.array([0.020, 0.010])
AGED_TOGETHER = (-0.5, -0.9)  # correlation of ln ohm and ln Ah, and of their trends: both worsen together
# The generic file does not know the make: ohms above its own are no evidence of age, the printed capacity is no
# measurement, and its curve hides how far a used pack has faded until a flight comes near the knee.
UNKNOWN_MAKE_NEW_SD, UNKNOWN_MAKE_USED_SD = np.array([0.4, 0.08]), np.array([0.4, 0.25])
FLIGHT_SD = np.array([0.006, 0.006, 0.0005, 0.0005])  # change in one flight
MONTH_SD = np.array([0.020, 0.010, 0.0, 0.0])  # change in one month of storage
DAYS_A_MONTH, SECONDS_A_DAY = 30.4, 86_400.0
LONGEST_DAYS = 3650.0
# The evidence of a flight is for its own temperature and load; those of the next flight differ.
OTHER_CONDITIONS_SD = np.array([0.15, 0.02])
OTHER_FILE_SD = np.array([0.10, 0.03])  # added if another battery file was used
UNKNOWN_COLD_SD = np.array([0.25, 0.10])  # added without a thermometer: the next flight may be in the cold
# A flight is odd if it is this many sds off; for two flights in a row, taken together, fewer are enough.
ODD_ALONE, ODD_TOGETHER, FITS_AGAIN = 3.2, 2.5, 2.5
DAMAGED_SHARE = 0.1  # of packs that look damaged after two flights; the others age faster
DAMAGE_SD = np.array([0.30, 0.15, 0.0, 0.0])

F = np.array([[1.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
H = np.eye(2, 4)
OHM, CHARGE = 0, 1


def _first(flight: FlightRecord, mean: Array, sd: Array) -> PackBelief:
    """Return the belief about a pack before its first flight, for one of the two kinds (new, used)."""
    type_log = np.log([flight.type_ohm, flight.rated_Ah])
    every_sd = np.concatenate([sd, TREND_SD])
    covariance = np.diag(every_sd**2)
    for k, correlation in zip((0, 2), AGED_TOGETHER, strict=True):
        covariance[k, k + 1] = covariance[k + 1, k] = correlation * every_sd[k] * every_sd[k + 1]
    if is_generic(flight.battery):
        covariance[:2, :2] += np.diag((UNKNOWN_MAKE_NEW_SD if mean is NEW_MEAN else UNKNOWN_MAKE_USED_SD) ** 2)
    return PackBelief(np.concatenate([type_log + mean, TREND_MEAN]), covariance)


def first_known(flight: FlightRecord) -> PackBelief:
    """Return the belief about a pack after its first flight: new and used packs, each weighed by its likelihood."""
    kinds = (_first(flight, NEW_MEAN, NEW_SD), _first(flight, USED_MEAN, USED_SD))
    likely = np.array([NEW_SHARE, 1.0 - NEW_SHARE]) * [_likelihood(kind, flight) for kind in kinds]
    return _together(_shares(likely), [_with_flight(kind, flight) for kind in kinds])


def _shares(likely: Array) -> Array:
    """Return likelihoods [2] as shares of 1; if both are zero, the second gets all."""
    return np.asarray(likely / likely.sum()) if likely.sum() > 0.0 else np.array([0.0, 1.0])


def _together(weight: Array, beliefs: Sequence[PackBelief]) -> PackBelief:
    """Return one belief with the mean and the covariance of a weighted mixture of beliefs."""
    means = np.array([belief.mean for belief in beliefs])
    covariance = mixed_covariance(means, np.array([belief.covariance for belief in beliefs]), weight)
    return PackBelief(weight @ means, covariance)


def _likelihood(known: PackBelief, flight: FlightRecord) -> float:
    """Return the likelihood of a flight's evidence under a belief, without its constant factor."""
    spread = H @ known.covariance @ H.T + flight.told.matrix
    apart = flight.told.mean - H @ known.mean
    return math.exp(-0.5 * float(apart @ np.linalg.solve(spread, apart))) / math.sqrt(float(np.linalg.det(spread)))


def predicted(known: PackBelief, days: float) -> PackBelief:
    """Return the belief `days` [days] later, before the next flight; unknown days (NaN) count as none."""
    days = min(max(days, 0.0), LONGEST_DAYS) if math.isfinite(days) else 0.0
    walked = FLIGHT_SD**2 + MONTH_SD**2 * days / DAYS_A_MONTH
    return PackBelief(F @ known.mean, F @ known.covariance @ F.T + np.diag(walked))


def days_between(earlier: FlightRecord, start_utc_s: float) -> float:
    """Return the days from one flight to a time [s since 1970]; NaN where either is unknown."""
    return (start_utc_s - earlier.start_utc_s) / SECONDS_A_DAY


def updated(known: PackBelief, evidence_mean: Array, evidence_covariance: Array) -> PackBelief:
    """Return a belief after a Kalman update with the evidence of a flight: its mean [2] and covariance [2, 2].

    The Joseph form is not needed for two numbers of similar size.
    """
    spread = H @ known.covariance @ H.T + evidence_covariance
    gain = np.linalg.solve(spread, H @ known.covariance).T
    covariance = known.covariance - gain @ spread @ gain.T
    return PackBelief(known.mean + gain @ (evidence_mean - H @ known.mean), 0.5 * (covariance + covariance.T))


def oddness(known: PackBelief, flight: FlightRecord, doubt: Array) -> Array:
    """Return how many sd each of a flight's two numbers (ln ohm, ln Ah) lies from its expected value, [2]."""
    spread = np.diag(H @ known.covariance @ H.T + doubt)
    return np.asarray((flight.told.mean - H @ known.mean) / np.sqrt(spread))


def oddness_together(before: PackBelief, one: FlightRecord, next_one: FlightRecord) -> Array:
    """Return how many sd a common step of two flights in a row lies from the value expected before both, [2]."""
    after = predicted(before, 0.0)
    found = []
    for k in (OHM, CHARGE):
        shared, grown = float(before.covariance[k, k]), float(after.covariance[k, k])
        spread = np.array([[shared + one.told.matrix[k, k], shared], [shared, grown + next_one.told.matrix[k, k]]])
        step = np.array([one.told.mean[k] - before.mean[k], next_one.told.mean[k] - after.mean[k]])
        weight = np.linalg.solve(spread, np.ones(2))
        found.append(float(weight @ step) / math.sqrt(float(weight.sum())))
    return np.array(found)


class AgeingState(NamedTuple):
    """AgeingState holds the state of the slow filter: the belief about a pack, and the beliefs it may return to."""

    known: PackBelief
    expected: PackBelief  # belief before the last flight
    last: FlightRecord
    undamaged: PackBelief | None = None  # belief before the last damage, which may have been a change of the pack
    aside: FlightRecord | None = None  # the last flight, if it is believed to be of another pack
    is_settled: bool = True  # the last flight was not odd


def history(flights: Sequence[FlightRecord]) -> list[LedgerFlight]:
    """Return the belief after each flight of a pack; `flights` must be in order of time."""
    found: list[LedgerFlight] = []
    course: AgeingState | None = None
    fullest_V = ORDINARY_FULL_V
    for flight in flights:
        if course is None:
            course, findings = _first_state(flight)
        elif fullest_V == course.last.fullest_cell_V == ORDINARY_FULL_V < flight.fullest_cell_V:
            course, findings = _first_state(flight)[0], (odd.of_higher_charge(flight),)
        else:
            course, findings = _next(course, flight)
        fullest_V = max(fullest_V, flight.fullest_cell_V) if math.isfinite(flight.fullest_cell_V) else fullest_V
        found.append(LedgerFlight(flight, course.known, (*findings, *odd.by_itself(flight)), fullest_V))
    return found


def _first_state(flight: FlightRecord) -> tuple[AgeingState, tuple[PackFinding, ...]]:
    return AgeingState(first_known(flight), _first(flight, USED_MEAN, USED_SD), flight), ()


def _with_flight(expected: PackBelief, flight: FlightRecord) -> PackBelief:
    return updated(expected, flight.told.mean, flight.told.matrix)


def _next(course: AgeingState, flight: FlightRecord) -> tuple[AgeingState, tuple[PackFinding, ...]]:
    """Take in one more flight: as expected, after damage, or of another pack."""
    beside = odd.between(course.last, flight)
    expected = predicted(course.known, days_between(course.last, flight.start_utc_s))
    z = oddness(expected, flight, flight.told.matrix)
    change = flight.told.mean - H @ expected.mean
    if max(-z[OHM], z[CHARGE]) > ODD_ALONE:
        course, said = _improved(course, expected, flight, odd.another(z, change))
    elif max(z[OHM], -z[CHARGE]) > ODD_ALONE:
        said = odd.sudden(z, change, has_thermometer=flight.has_thermometer)
        known = _with_flight(_shaken(expected, z), flight)
        course = AgeingState(known, expected, flight, undamaged=expected, is_settled=False)
    elif course.is_settled and (both := _odd_together(course, flight)) is not None:
        course, said = both
    else:
        return AgeingState(_with_flight(expected, flight), expected, flight, course.undamaged), beside
    return course, (said, *beside)


def _shaken(expected: PackBelief, z: Array) -> PackBelief:
    """Return the belief about a damaged pack: its resistance is less certain, its capacity too if that has changed."""
    sd = DAMAGE_SD * np.array([1.0, float(-z[CHARGE] > FITS_AGAIN), 0.0, 0.0])
    return PackBelief(expected.mean, expected.covariance + np.diag(sd**2))


def _improved(
    course: AgeingState, expected: PackBelief, flight: FlightRecord, said: PackFinding
) -> tuple[AgeingState, PackFinding]:
    """Take in a flight that is better than the pack can be.

    The flight is set aside, unless it fits the pack before its damage, or is the second such flight in a row.
    """
    old = course.undamaged
    if old is not None and np.abs(oddness(predicted(old, 0.0), flight, flight.told.matrix)).max() < FITS_AGAIN:
        again = "as before the damage: the flights in between were another pack's"
        return AgeingState(_with_flight(predicted(old, 0.0), flight), old, flight, is_settled=False), PackFinding(
            said.kind, again
        )
    if course.aside is not None:
        anew = first_known(course.aside)
        said = PackFinding(said.kind, "again another pack: remembered anew under this name")
        return AgeingState(_with_flight(predicted(anew, 0.0), flight), anew, flight, is_settled=False), said
    return AgeingState(expected, expected, course.last, aside=flight, is_settled=False), said


def _odd_together(course: AgeingState, flight: FlightRecord) -> tuple[AgeingState, PackFinding] | None:
    """Take in the second of two odd flights that agree: damage that one flight could not prove, or faster ageing.

    The new belief is a mixture of both, weighted by the likelihood of the two flights, so that later flights decide.
    """
    z = oddness_together(course.expected, course.last, flight)
    if max(z[OHM], -z[CHARGE]) <= ODD_TOGETHER:
        return None
    change = 0.5 * (course.last.told.mean + flight.told.mean) - H @ course.expected.mean
    begun = (_shaken(course.expected, z), course.expected)
    between = [predicted(_with_flight(one, course.last), 0.0) for one in begun]
    likely = np.array([DAMAGED_SHARE, 1.0 - DAMAGED_SHARE])
    likely *= [_likelihood(a, course.last) * _likelihood(b, flight) for a, b in zip(begun, between, strict=True)]
    known = _together(_shares(likely), [_with_flight(one, flight) for one in between])
    has_thermometer = flight.has_thermometer and course.last.has_thermometer
    causes = ("damaged", "ageing fast")
    said = odd.sudden(z, change, " since the flight before", causes, has_thermometer=has_thermometer)
    return AgeingState(known, between[0], flight, undamaged=course.expected, is_settled=False), said


def prior(known: PackBelief, days: float, *, other_file: bool = False, has_thermometer: bool = True) -> PackHealth:
    """Return the prior of the next flight, `days` [days] after the last.

    other_file : it uses another battery file; has_thermometer : the last flight had one, so that this one will.
    """
    expected = predicted(known, days)
    doubt = OTHER_CONDITIONS_SD**2
    if other_file:
        doubt = doubt + OTHER_FILE_SD**2
    if not has_thermometer:
        doubt = doubt + UNKNOWN_COLD_SD**2
    log_ohm, log_Ah = (float(value) for value in expected.mean[:2])
    return PackHealth(log_ohm, log_Ah, expected.covariance[:2, :2] + np.diag(doubt))
