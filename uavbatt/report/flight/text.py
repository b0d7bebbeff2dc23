"""The result of a replay: lines of text for the user, and a summary for JSON."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.sizing.pack_size import PackSize
from uavbatt.log_replay.outcome import Checkpoint, Landing, Outcome
from uavbatt.log_replay.run import ReplayedRow, route_forecasts
from uavbatt.records import Flight
from uavbatt.report.flight.answer import first_answer
from uavbatt.report.flight.limits import against_a_reserve, charge_interval, flown_on, limits_of
from uavbatt.report.flight.series import WarningSpan, warnings_of
from uavbatt.report.page import duration

# Times that differ by less need no words: of a span from the log's ends, of a row from the instant asked for.
JUST_S, NEAR_S = 30.0, 10.0


def _which(flight: Flight) -> str:
    """Return which battery it is, if the log has several."""
    others = ", ".join(str(number) for number in flight.instances if number != flight.instance)
    return f", battery {flight.instance} (--instance reads {others})" if others else ""


def lines(flight: Flight, resolved: PackSize, outcome: Outcome, run: list[ReplayedRow]) -> list[str]:
    """Return the result of a replay as lines of text."""
    status = resolved.status if resolved.status == "certified" else f"{resolved.status}, not certified"
    lines = [
        f"{flight.source}: {first_answer(outcome.landing, outcome.end_of_flight_s, resolved.cutoff_V)}",
        f"  log        {flight.kind}, {outcome.rows} rows, {outcome.duration_s:.0f} s{_which(flight)}",
        f"  battery    {resolved.battery} ({status}); {resolved.words}",
        f"  at the end {outcome.end_voltage_V:.2f} V, {_charge(outcome)}",
        f"  forecast   {_forecast_share_words(outcome.refused_in_air)}",
    ]
    lines += _route_lines(_route_summary(run))
    lines += [f"  warning    {w}" for w in [*dated_warnings(run), *flown_on(outcome, resolved), *flight.notes]]
    return lines + _checked_lines(outcome)


def _checked_lines(outcome: Outcome) -> list[str]:
    """Return the forecasts against the end of flight that the log shows, or why they are not compared."""
    if outcome.reserve_soc > 0.0:
        return [f"  {against_a_reserve(outcome.reserve_soc)}"]
    if not math.isfinite(outcome.end_of_flight_s):
        return ["  the log does not reach the end of flight: no forecast of it can be checked"]
    first = f"  end of flight at {outcome.end_of_flight_s:.0f} s; forecasts before it (positive = optimistic):"
    return [first, *(_checkpoint_line(c) for c in outcome.checkpoints)]


def _checkpoint_line(c: Checkpoint) -> str:
    if not math.isfinite(c.remaining_s):
        return f"    {c.label:>13}: refused, true {c.before_end_s:.0f} s"
    side = "inside" if c.inside else "outside"
    return (
        f"    {c.label:>13}: {_instant(c)}said {c.remaining_s:4.0f} s [{c.lo_s:.0f}, {c.hi_s:.0f}], true "
        f"{c.before_end_s:4.0f} s, error {round(c.error_s):+5d} s, {side} the 90 % interval"
    )


def plain_lines(flight: Flight, resolved: PackSize, outcome: Outcome, run: list[ReplayedRow]) -> list[str]:
    """Return only the answer for the pilot and its limits, as on the flight page."""
    answer = f"{flight.source}: {first_answer(outcome.landing, outcome.end_of_flight_s, resolved.cutoff_V)}"
    return [answer, *(f"  {words}" for words in limits_of(outcome, resolved, run))]


def dated_warnings(run: list[ReplayedRow]) -> list[str]:
    """Return every warning of a replay once, with its time if it did not hold from beginning to end."""
    first_s, last_s = run[0].estimate.time_s, run[-1].estimate.time_s
    return [words + _when(stood, first_s, last_s) for words, stood in warnings_of(run).items()]


def _when(stood: WarningSpan, first_s: float, last_s: float) -> str:
    """Return in words when a warning held, in times since the log's start; first_s and last_s : of its rows [s]."""
    since = duration(stood.since_s)
    if last_s - stood.until_s > JUST_S:
        return f" ({since} to {duration(stood.until_s)})"
    if stood.again_s - stood.since_s > JUST_S:
        return f" (since {duration(stood.again_s)}, first at {since})"
    return f" (since {since})" if stood.since_s - first_s > JUST_S else ""


def _instant(c: Checkpoint) -> str:
    """Return a note if the log has no row at the instant of the label."""
    named_s = float(c.label.split()[0]) if c.label[0].isdigit() else c.before_end_s
    return "nearest forecast " if abs(named_s - c.before_end_s) > NEAR_S else ""


def _charge(outcome: Outcome) -> str:
    """Return the charge at the log's end, with its 90 % interval."""
    if not math.isfinite(outcome.end_soc):
        return "charge not known"
    low, high = charge_interval(outcome)
    return f"{outcome.end_soc:.0%} charge left ({low:.0%} to {high:.0%})"


def _forecast_share_words(refused_in_air: float) -> str:
    """Return in words the share of the flight with a forecast."""
    if not math.isfinite(refused_in_air):
        return "not judged: less than a minute in the air"
    return "at all times in the air" if refused_in_air == 0.0 else f"{1.0 - refused_in_air:.1%} of the time in the air"


def summary(
    flight: Flight, resolved: PackSize, outcome: Outcome, run: list[ReplayedRow], content: BatteryFile
) -> dict[str, Any]:
    """Return the summary of a replay for JSON."""
    scores = [
        {**asdict(c), "error_s": c.error_s, "inside": c.inside if math.isfinite(c.remaining_s) else False}
        for c in outcome.checkpoints
    ]
    return {
        "log": flight.source,
        "kind": flight.kind,
        "instance": flight.instance,
        "battery": resolved.battery,
        "certificate_status": resolved.status,
        "content_sha256": content.certificate.content_sha256,
        **resolved.numbers(),
        "skipped_bytes": flight.skipped_bytes,
        "notes": list(flight.notes),
        "warnings": list(warnings_of(run)),
        **_landing_summary(outcome.landing),
        **{k: v for k, v in asdict(outcome).items() if k not in ("checkpoints", "landing", "waits")},
        "scores": scores,
        **_route_summary(run),
    }


def _route_summary(run: list[ReplayedRow]) -> dict[str, Any]:
    """Return for JSON how much the route was used, and when "turn back now" came first; nulls without route or home."""
    forecasts = route_forecasts(run)
    turn_s = forecasts.turn_back_now_s
    return {
        "route_share": sum(route.load == "route" for _, route in forecasts.rows) / len(forecasts.rows)
        if forecasts.rows
        else None,
        "route_reason": forecasts.why_no_route,
        "route_assumed": forecasts.assumed,
        "turn_back_now_s": turn_s if math.isfinite(turn_s) else None,
    }


def _route_lines(route: dict[str, Any]) -> list[str]:
    """Return the same as lines of text."""
    share, turn_s = route["route_share"], route["turn_back_now_s"]
    if share is None:
        return []
    why = route["route_reason"]
    others = f" (not by the others: {why})" if why else ""
    used = f"used by {share:.0%} of the forecasts{others}" if share or not why else f"not used: {why}"
    text_lines = [f"  route      {used}"]
    if route["route_assumed"]:
        text_lines.append(f"  assumed    {route['route_assumed']}")
    if turn_s is not None:
        text_lines.append(f"  turn back  said first {duration(turn_s)} after the log's start")
    return text_lines


def _landing_summary(landing: Landing | None) -> dict[str, Any]:
    """Return for JSON the forecast at the last row in the air; nulls without one."""
    keys = ("remaining_s", "remaining_lo_s", "remaining_hi_s", "remaining_to_low_s")
    if landing is None:
        return {**dict.fromkeys(keys), "landing_s": None, "in_air_at_end": False, "reason": "no flight in this log"}
    values = {key: getattr(landing, key) for key in keys}
    return {**values, "landing_s": landing.time_s, "in_air_at_end": landing.is_cut, "reason": landing.reason}
