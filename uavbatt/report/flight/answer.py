"""The first answer of a replay, in a pilot's words: how much longer the aircraft could have flown."""

from __future__ import annotations

import math

from uavbatt.log_replay.outcome import Landing
from uavbatt.report.page import duration

# Nobody acts on the last seconds of many minutes: the shorter the time, the finer the words.
SECONDS_BELOW_S, MINUTES_FROM_S, TENS_BELOW_S = 120.0, 300.0, 600.0


def first_answer(landing: Landing | None, end_of_flight_s: float, cutoff_V: float) -> str:
    """Return in words the time that was left at landing, or that the battery ended the flight.

    landing : the forecast at the last row in the air; None for a log without a flight
    end_of_flight_s : when the voltage under load fell below the cut-off [s since the log's start]; NaN if it never did
    cutoff_V : the pack's cut-off [V]
    """
    if landing is None:
        return "No flight in this log: its current never shows that motors carried the aircraft."
    if math.isfinite(end_of_flight_s):
        when = f"{duration(end_of_flight_s)} after the log's start"
        return f"The battery was at its end before you landed: below {cutoff_V:.2f} V under load {when}."
    opening = "The log ends in the air with" if landing.is_cut else "You landed with"
    if not math.isfinite(landing.remaining_s):
        why = _why_not_known(landing)
        return f"How much longer you could have flown is not known: {why}" + ("" if why.endswith("?") else ".")
    sentence = (
        f"{opening} {rounded(landing.remaining_s)} left ({between(landing.remaining_lo_s, landing.remaining_hi_s)})"
    )
    if not 0.0 < landing.remaining_to_low_s < landing.remaining_s:
        return f"{sentence}."
    return f"{sentence}, {rounded(landing.remaining_to_low_s)} to the low-voltage warning."


def _why_not_known(landing: Landing) -> str:
    """Return in words why there is no number at the landing: a current lost long before, else the last row's reason."""
    if math.isfinite(landing.current_lost_s):
        return f"the current was lost {duration(landing.current_lost_s)} after the log's start"
    return landing.reason or "no forecast near the landing"


def rounded(seconds: float) -> str:
    """Return a time in words, rounded to the precision of a forecast: `95 s`, `6 min 30 s`, `16 min`."""
    if seconds < SECONDS_BELOW_S:
        return f"{seconds:.0f} s"
    if seconds < TENS_BELOW_S:
        return duration(10.0 * round(seconds / 10.0)).replace(" 00 s", "")
    return f"{seconds / 60.0:.0f} min"


def between(lo_s: float, hi_s: float) -> str:
    """Return an interval of times in words: `8 to 23 min`; in seconds if the lower end is short."""
    if lo_s >= MINUTES_FROM_S:
        return f"{lo_s / 60.0:.0f} to {hi_s / 60.0:.0f} min"
    return f"{rounded(lo_s)} to {rounded(hi_s)}"
