"""Reasons why a person should look at a flight, and how urgent they are."""

from __future__ import annotations

from uavbatt.fleet.row import FlightRow
from uavbatt.packs.dates import future_words, is_in_future
from uavbatt.records import NAN, Flight

MUCH_REFUSED = 0.2  # share of the forecasts in the air
HIGH_NIS = 3.0  # mean of the squared innovation over its variance: 1 if the model fits
MUCH_LOST = 0.01  # share of a log's bytes: more than a record that is cut
EMPTY_SOC = 0.05  # a landing with less has worn the cells
LANDING_S = 30.0  # a descent from 50 m, begun at the cut-off
OPTIMISTIC_S = 60.0  # half of the two minutes that were left
RESISTANCE_GROWN = 1.4  # times that of the battery file, and more than two sd away

EMPTY, FLEW_ON, TOO_LONG = "landed nearly empty", "flew on below", "too long"
RESISTANCE, UNTRUSTED, UNEXPLAINED, REFUSED = "resistance", "not to be trusted", "explains it badly", "refused"
# How much each of these words in the reasons adds to the urgency: a table of an earlier run holds nothing else.
URGENCY = {
    EMPTY: 5.0, RESISTANCE: 4.0, TOO_LONG: 4.0, UNTRUSTED: 3.0, UNEXPLAINED: 2.0, REFUSED: 2.0, FLEW_ON: 1.0,
}  # fmt: skip


def reasons(row: FlightRow, doubts: tuple[str, ...], flown_on_s: float = NAN) -> list[str]:
    """Return the reasons in the figures of a flight; empty if there are none.

    doubts : those of the log's quality; flown_on_s : time in the air after the end of flight [s], NaN without one
    """
    found = []
    if row.end_soc < EMPTY_SOC:
        found.append(f"{EMPTY}: state of charge {row.end_soc:.2f}")
    elif flown_on_s > LANDING_S:
        found.append(f"{FLEW_ON} the cut-off voltage")
    if row.refused_share > MUCH_REFUSED:
        found.append(f"{row.refused_share:.0%} of the forecasts in the air {REFUSED}")
    if row.mean_nis > HIGH_NIS:
        found.append(f"the battery file {UNEXPLAINED} (mean NIS {row.mean_nis:.1f})")
    # a generic or edited file tells nothing here: new packs differ by more than that
    is_measured = row.certificate not in ("generic", "edited")
    if is_measured and row.resistance_scale - 2.0 * row.resistance_scale_sd > RESISTANCE_GROWN:
        found.append(f"{RESISTANCE} {row.resistance_scale:.2f} times the battery file's")
    if row.error_120_s > OPTIMISTIC_S and row.inside_120 is False:
        found.append(f"two minutes before the end the forecast was {row.error_120_s:.0f} s {TOO_LONG}")
    if row.trust == "no":
        found.append(f"{UNTRUSTED}: {doubts[0] if doubts else 'see `uavbatt info`'}")
    return found


def doubts_of_log(flight: Flight, size_bytes: int, now_utc_s: float) -> list[str]:
    """Return what is wrong with a log itself: bytes that could not be read, a date in the future.

    size_bytes : of the log, unpacked; now_utc_s : the time now [s since 1970]
    """
    lost, start_utc_s = flight.skipped_bytes / size_bytes, flight.identity.start_utc_s
    found = [f"{lost:.0%} of the log could not be read"] if lost > MUCH_LOST else []
    return [*found, future_words(start_utc_s)] if is_in_future(start_utc_s, now_utc_s) else found


def urgency(row: FlightRow) -> float:
    """Return how urgently a flight needs a look; an emptied battery comes before an inaccurate forecast."""
    return sum(weight for words, weight in URGENCY.items() if words in row.look)
