"""Dates of flights by the clocks of their logs, which may be wrong."""

from __future__ import annotations

from datetime import UTC, datetime

CLOCKS_APART_S = 86_400.0  # a log may tell local time, and clocks are never the same


def date_text(utc_s: float) -> str:
    """Return a time [s since 1970] as a date of the calendar, in UTC: `2026-11-25`."""
    return datetime.fromtimestamp(utc_s, UTC).strftime("%Y-%m-%d")


def is_in_future(start_utc_s: float, now_utc_s: float) -> bool:
    """Return True if a flight begins more than a day after now [s since 1970]; False where either is NaN."""
    return start_utc_s > now_utc_s + CLOCKS_APART_S


def future_words(start_utc_s: float) -> str:
    """Return in words that the date of a flight [s since 1970] is in the future."""
    return f"dated {date_text(start_utc_s)}, in the future: the clock of the log is wrong"
