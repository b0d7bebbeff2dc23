"""The scenarios of faults through the live process, in one table: what the crew hears, and how long before the end."""

from __future__ import annotations

import math
from contextlib import redirect_stderr
from dataclasses import dataclass
from io import StringIO

from scoring.live_flight import Flown
from scoring.scenarios import LAST_S, TOO_LONG_S, is_heard, lo_excess_s, said
from scoring.table import DASH, Table, figure

NAN = math.nan


@dataclass(frozen=True, slots=True)
class Heard:
    """Heard holds what was shown and said on one flight; times are seconds before its end."""

    name: str
    flown_s: float
    median_excess_s: float  # of the last two minutes, the worst; NaN: all refused
    lo_excess_s: float
    refused: float  # share of the last two minutes
    alarm_s: float  # NaN: never
    text_s: float  # the first text that is no alarm; NaN: none
    text: str
    is_sound: bool  # the crew hears of the end in time, and no lower end is far too long
    warning: str  # the last row's, without what is said of every generic battery


def heard(name: str) -> Heard:
    """Fly one scenario, and return what was heard; what the process tells its journal is not shown."""
    with redirect_stderr(StringIO()):
        flown, end_s = said(name)
    last = [row for row in flown.rows if row.time_s > end_s - LAST_S]
    shown = [row for row in last if math.isfinite(row.remaining_s)]
    left = [end_s - row.time_s for row in shown]
    other = next((text for text in flown.texts if math.isnan(text.left_s)), None)
    return Heard(
        name,
        flown_s=end_s - flown.rows[0].time_s,
        median_excess_s=max((r.remaining_s - s for r, s in zip(shown, left, strict=True)), default=NAN),
        lo_excess_s=lo_excess_s(flown, end_s),
        refused=1.0 - len(shown) / len(last),
        alarm_s=end_s - flown.alarm_s(),
        text_s=end_s - other.time_s if other else NAN,
        text=other.text if other else "",
        is_sound=is_heard(name) and not lo_excess_s(flown, end_s) > TOO_LONG_S,
        warning=_warning(flown),
    )


def _warning(flown: Flown) -> str:
    row = flown.rows[-1]
    return next((w for w in (row.reason, *row.warnings) if w and "battery file is" not in w), "")


def table(every: list[Heard]) -> Table:
    """Return one row a scenario."""
    head = (
        "scenario", "median too long by [s]", "5 % point too long by [s]", "refused", "alarm with [s] left",
        "first other text with [s] left", "and it says", "at the end",
    )  # fmt: skip
    rows = [
        (
            h.name,
            figure(h.median_excess_s, sign=True),
            figure(h.lo_excess_s, sign=True),
            f"{h.refused:.0%}",
            figure(h.alarm_s),
            figure(h.text_s),
            h.text or DASH,
            h.warning or DASH,
        )
        for h in every
    ]
    note = (
        "Packs of another model through the companion process, generic battery, 300 W, cut-off 13.2 V. Too long by: "
        "the worst of the last two minutes; a dash: no number was shown."
    )
    return Table("Faults, as the ground station hears of them", head, tuple(rows), note)
