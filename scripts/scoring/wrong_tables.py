"""Flights of packs that are not ours, as tables; the last one holds the targets against the figures."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from itertools import groupby
from typing import NamedTuple

import numpy as np

from scoring.other_pack import FULL_AH
from scoring.table import DASH, Table, figure, share
from scoring.wrong_cases import FITTED, GAUGED, GENERIC, LANDED, MIXED
from scoring.wrong_judged import Judged, Said
from scoring.wrong_live import Heard

AT_S = (120.0, 60.0, 20.0)
WORST, EARLY_S = 8, 240.0
IN_SERVICE = (0.70, 1.0)  # of the stated capacity: what the targets speak of


def issue(every: Sequence[Judged]) -> Table:
    """Return the table of the issue: one row a capacity and battery."""
    head = ("battery, true Ah of 5", "flown [s]", "120 s before", "20 s before", "5 s before", "alarm with [s] left")
    rows = [
        (
            f"{j.case.battery}, {j.case.capacity_Ah:.1f}",
            figure(j.flown_s),
            *(_interval(j.before[left_s]) for left_s in (120.0, 20.0, 5.0)),
            figure(j.alarm_s),
        )
        for j in every
        if j.case.capacity_class == "issue"
    ]
    note = "Said: median [5 %, 95 %], in seconds. 300 W with gusts, cut-off 13.2 V, charged full."
    return Table("A pack of another model that holds less than stated", head, tuple(rows), note)


def groups(every: Sequence[Judged]) -> Table:
    """Return one row a battery, capacity and start charge."""
    head = (
        "battery, capacity, charged", "flights", "half time", "120 s", "60 s", "20 s", "5 % point too long by at most",
        "inside 90 %", "alarm with [s] left", "with over 240 s", "NEES of soc", "soc RMSE", "refused",
    )  # fmt: skip
    drawn = [j for j in every if j.case.capacity_class != "issue"]
    rows = [_group(", ".join(name), list(some)) for name, some in groupby(drawn, key=lambda j: j.case.group)]
    for battery in (GENERIC, FITTED, MIXED, LANDED, GAUGED):
        if metered := [j for j in drawn if _is_metered(j, battery)]:
            rows.append(_group(f"{battery}, true current, all", metered))
    note = (
        "Mean |error| of the median (and bias, positive: too long), in seconds. 5 % point: the worst of the last two "
        "minutes. Alarm: true seconds left when it is raised, least / median / most. Inside, NEES: means over flights."
    )
    return Table("Packs of another model through the estimator", head, tuple(rows), note)


def worst(every: Sequence[Judged]) -> Table:
    """Return the flights whose lower end was too long by most, or whose alarm came last."""
    order = sorted(every, key=lambda j: (-_or_zero(j.lo_excess_s), j.alarm_s))[:WORST]
    order += [j for j in sorted(every, key=lambda j: j.alarm_s)[:WORST] if j not in order]
    head = ("flight (--flight NAME)", "5 % point too long by", "alarm with", "at 60 s", "words with", "what")
    rows = [
        (
            j.case.name,
            figure(j.lo_excess_s),
            figure(j.alarm_s),
            _interval(j.before[60.0]),
            figure(j.words_s),
            j.case.words,
        )
        for j in order
    ]
    return Table(
        "The worst flights", head, tuple(rows), "In seconds; words: a warning names a smaller pack or a sensor."
    )


class Target(NamedTuple):
    """A Target names one target of the issue and what is reached."""

    words: str
    reached: str
    is_met: bool


def targets(every: Sequence[Judged], faults: Sequence[Heard]) -> Table:
    """Return each target of the issue that these flights can tell."""
    found = [*_fitted([j for j in every if _is_in_service(j, FITTED)])]
    found += _generic([j for j in every if _is_in_service(j, GENERIC)])
    for battery in (GENERIC, FITTED):
        found += _consistency(battery, [j for j in every if _is_in_service(j, battery)])
    if faults:
        bad = [h.name for h in faults if not h.is_sound]
        found.append(Target("no fault fails, live", f"{len(bad)} of {len(faults)} {', '.join(bad)}".strip(), not bad))
    rows = tuple((t.words, t.reached, "pass" if t.is_met else "missed") for t in found)
    note = "Packs of 70 to 100 % of the stated capacity with a true current sensor, charged to 60 % and more."
    return Table("Targets", ("target", "reached", ""), rows, note)


def _fitted(every: Sequence[Judged]) -> list[Target]:
    if not every:
        return []
    lo_s = _at((120.0, 60.0), every, lambda said: said.lo_s - said.true_s)
    median_s = _at((120.0, 60.0), every, lambda said: abs(said.error_s))
    alarm_s = [j.alarm_s for j in every]
    return [
        _most("fitted: 5 % point at 120 and 60 s at most 15 s too long", lo_s, 15.0),
        _most("fitted: median at 120 and 60 s within 30 s", median_s, 30.0),
        Target(
            "fitted: alarm with 60 to 180 s left, always",
            f"{min(alarm_s):.0f} to {max(alarm_s):.0f} s, {sum(60 <= s <= 180 for s in alarm_s)} of {len(alarm_s)}",
            all(60.0 <= s <= 180.0 for s in alarm_s),
        ),
    ]


def _generic(every: Sequence[Judged]) -> list[Target]:
    if not every:
        return []
    alarm_s = [j.alarm_s for j in every]
    return [
        _most("generic: 5 % point in the last two minutes at most 25 s too long", [j.lo_excess_s for j in every], 25.0),
        Target(
            "generic: alarm never with less than 45 s left",
            f"{min(alarm_s):.0f} s at least, {sum(s >= 45.0 for s in alarm_s)} of {len(alarm_s)}",
            min(alarm_s) >= 45.0,
        ),
    ]


def _consistency(battery: str, every: Sequence[Judged]) -> list[Target]:
    if not every:
        return []
    covered, nees = _mean([j.covered for j in every]), _mean([j.nees for j in every])
    small = [j for j in every if j.case.capacity_Ah < 0.8 * FULL_AH]
    told = [j for j in small if math.isfinite(j.words_s)]
    return [
        Target(f"{battery}: 90 % interval holds 85 to 95 %", f"{covered:.1%}", 0.85 <= covered <= 0.95),
        Target(f"{battery}: NEES of soc 0.5 to 1.5", f"{nees:.2f}", 0.5 <= nees <= 1.5),
        Target(f"{battery}: below 80 % a warning names it", f"{len(told)} of {len(small)}", len(told) == len(small)),
    ]


def _most(words: str, values: Iterable[float], limit: float) -> Target:
    known = [v for v in values if math.isfinite(v)]
    met = sum(v <= limit for v in known)
    return Target(words, f"{max(known, default=math.nan):.0f} s, {met} of {len(known)}", met == len(known))


def _at(instants_s: Sequence[float], every: Sequence[Judged], of: Callable[[Said], float]) -> list[float]:
    return [of(j.before[left_s]) for j in every for left_s in instants_s]


def _is_metered(judged: Judged, battery: str) -> bool:
    case = judged.case
    return case.battery == battery and case.sensors.current_gain == 1.0 and case.power.turns is None


def _is_in_service(judged: Judged, battery: str) -> bool:
    low, high = (share * FULL_AH for share in IN_SERVICE)
    return _is_metered(judged, battery) and low <= judged.case.capacity_Ah <= high


def alarm_words(some: Sequence[Judged]) -> str:
    """Return the true time left at the alarm [s]: the least, the median and the most of some flights."""
    alarm_s = [j.alarm_s for j in some]
    alarms = (min(alarm_s), float(np.median(alarm_s)), max(alarm_s)) if alarm_s else (math.nan,) * 3
    return " / ".join(figure(s) for s in alarms)


def _group(name: str, some: Sequence[Judged]) -> tuple[str, ...]:
    return (
        name,
        str(len(some)),
        _errors([j.half for j in some]),
        *(_errors([j.before[left_s] for j in some]) for left_s in AT_S),
        figure(max((j.lo_excess_s for j in some if math.isfinite(j.lo_excess_s)), default=math.nan)),
        share(_mean([j.covered for j in some])),
        alarm_words(some),
        str(sum(j.alarm_s > EARLY_S for j in some)),
        figure(_mean([j.nees for j in some]), 2),
        figure(100.0 * _mean([j.soc_rmse for j in some]), 1) + " %",
        share(_mean([j.refused for j in some])),
    )


def _errors(said: Sequence[Said]) -> str:
    known = [s.error_s for s in said if math.isfinite(s.error_s)]
    if not known:
        return DASH
    return f"{np.mean(np.abs(known)):.0f} ({figure(float(np.mean(known)), sign=True)})"


def _interval(said: Said) -> str:
    return f"{figure(said.median_s)} [{figure(said.lo_s)}, {figure(said.hi_s)}]"


def _mean(values: Sequence[float]) -> float:
    known = [v for v in values if math.isfinite(v)]
    return float(np.mean(known)) if known else math.nan


def _or_zero(value: float) -> float:
    return value if math.isfinite(value) else 0.0
