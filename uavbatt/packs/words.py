"""The outlook of a pack in words that its owner understands."""

from __future__ import annotations

import math
from datetime import UTC, datetime

from uavbatt.output import counted
from uavbatt.packs.bounds import LATEST_UTC_S
from uavbatt.packs.dates import future_words, is_in_future
from uavbatt.packs.outlook import INTERVAL_SD, RETIRED_AT
from uavbatt.packs.records import LedgerFlight, Outlook, PackRow

STEADY = 0.002  # change per flight; slower ageing is no reason to look


def retire_words(seen: Outlook) -> str:
    """Return when to retire the pack, in words: `retire in about 12 flights (5 to 40) at 80 %`."""
    at = f"at {RETIRED_AT:.0%}"
    median, soonest, latest = seen.retire_flights, seen.retire_lo_flights, seen.retire_hi_flights
    if median == 0.0 == latest:
        return f"retire now: below {RETIRED_AT:.0%} already"
    if median == 0.0:
        return f"probably below {RETIRED_AT:.0%} already, but not certain: measure its charge"
    if is_not_known(seen):
        return "not known when to retire it"
    if math.isfinite(median):
        until = f"to {latest:.0f}" if math.isfinite(latest) else "or many more"
        return f"retire in about {counted(round(median), 'flight')} ({soonest:.0f} {until}) {at}"
    if math.isfinite(soonest):
        return f"stays above {RETIRED_AT:.0%} for {soonest:.0f} flights or more"
    return "no reason to retire it"


def is_not_known(seen: Outlook) -> bool:
    """Return True if nothing is known of when to retire the pack: perhaps now, perhaps never."""
    return seen.retire_flights > 0.0 == seen.retire_lo_flights and math.isinf(seen.retire_hi_flights)


def trend_words(trend: float, sd: float) -> str:
    """Return how a number changes, in words: `−1.6 % a flight`, `steady`, `trend not known yet`."""
    if abs(trend) > INTERVAL_SD * sd:
        return f"{100.0 * trend:+.1f} % a flight".replace("-", "\N{MINUS SIGN}")
    return "steady" if INTERVAL_SD * sd < STEADY else "trend not known yet"


def pack_lines(pack: PackRow, now_utc_s: float) -> list[str]:
    """Return one line about a pack, and one for each finding; now_utc_s : the time now [s since 1970]."""
    seen = pack.outlook
    charge = f"{seen.capacity_Ah:.2f} Ah ({seen.capacity_lo_Ah:.2f} to {seen.capacity_hi_Ah:.2f})"
    ohm = f"{1000.0 * seen.resistance_ohm:.1f} mohm a cell ({seen.resistance_ohm / pack.type_ohm:.0%} of its type)"
    trend = trend_words(seen.capacity_trend, seen.capacity_trend_sd)
    line = (
        f"{pack.name:<16}  {seen.capacity_Ah / pack.rated_Ah:4.0%} of {pack.rated_Ah:g} Ah: {charge}; {ohm}; "
        f"{counted(seen.flights, 'flight')}; charge {trend}; {retire_words(seen)}"
    )
    said = [finding.words for finding in pack.findings]
    if is_in_future(pack.last_utc_s, now_utc_s):
        said.append(f"its last flight is {future_words(pack.last_utc_s)}: it counts from that date on")
    return [line, *(f"{'':<16}  {words}" for words in said)]


def flight_line(after: LedgerFlight, now_utc_s: float) -> str:
    """Return one line about a flight: its own evidence, and the belief after it; now_utc_s : the time now [s]."""
    flight, mean = after.flight, after.known.mean
    said = [finding.words for finding in after.findings]
    has_date = 0.0 < flight.start_utc_s <= LATEST_UTC_S
    if has_date and is_in_future(flight.start_utc_s, now_utc_s):
        said.append(future_words(flight.start_utc_s))
    when = datetime.fromtimestamp(flight.start_utc_s, UTC).strftime("%Y-%m-%d %H:%M") if has_date else ""
    told = f"this flight {math.exp(flight.told.log_Ah):.2f} Ah, {1000.0 * math.exp(flight.told.log_ohm):.1f} mohm"
    known = f"all so far {math.exp(mean[1]):.2f} Ah, {1000.0 * math.exp(mean[0]):.1f} mohm"
    words = "; ".join(said)
    temp = f"{flight.temp_mean_C:.0f} °C" if math.isfinite(flight.temp_mean_C) else "no temperature"
    soc_start, soc_end = (f"{x:.2f}" if math.isfinite(x) else "unknown" for x in (flight.soc_start, flight.soc_end))
    line = f"  {when or 'no date':<16}  {flight.source}: charge {soc_start} to {soc_end}, {temp}; {told}; {known}"
    return f"{line}; {words}" if words else line
