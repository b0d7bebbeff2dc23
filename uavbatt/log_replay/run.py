"""Replay of a flight log: each row of the log gives one output line, the same as in flight."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby, tee
from typing import NamedTuple

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.remembered import PackHealth
from uavbatt.battery.sizing.log_statements import check_statements
from uavbatt.battery.sizing.pack_size import PackOptions, PackSize, why_no_capacity
from uavbatt.engine import PLAIN, Engine
from uavbatt.errors import UsageError
from uavbatt.estimator import Estimator
from uavbatt.navigation import NOWHERE
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.prediction.pending import refused
from uavbatt.records import NAN, Estimate, Flight, PackFacts, Remaining, Route, Sample
from uavbatt.telemetry.discharges import of_discharges, with_its_pack
from uavbatt.telemetry.formats.mission_file import PlannedFlight

OFTEN = 0.1  # share of the forecasts
MANY_ROWS = 100_000  # plain numpy takes 14 s for them, compiled code 9 s, and 1 s to be loaded (15 s to be made, once)


@dataclass(frozen=True, slots=True)
class ReplayedRow:
    """A ReplayedRow is one output line: the estimate and the forecast after a row of the log.

    armed: the row's own flag, None where the log does not tell.
    """

    estimate: Estimate
    remaining: Remaining
    armed: bool | None = None


def engine_for(*, is_long: bool) -> Engine:
    """Return the engine for a job: compiled if the job is long and the extra `fast` is installed, else numpy."""
    if not is_long:
        return PLAIN
    try:
        from uavbatt import compiled
    except ImportError:  # an installation without it
        return PLAIN
    return compiled.engine() if compiled.is_available() else PLAIN


def estimator_for(
    flight: Flight,
    battery: BatteryFile,
    options: PackOptions,
    settings: ForecastSettings,
    remembered: PackHealth | None,
    engine: Engine | None = None,
) -> Estimator:
    """Make the estimator of a flight, after a check of the stated pack against the first rows.

    engine : None: the one for a flight of so many rows. Raises UsageError for a statement that the rows contradict.
    """
    check_statements(battery, options, with_its_pack(flight))
    engine = engine or engine_for(is_long=len(flight.samples) >= MANY_ROWS)
    return Estimator(battery, options, settings, engine, remembered)


def size_of_replayed(estimator: Estimator, flight: Flight) -> PackSize:
    """Return cells, capacity [Ah] and cut-off [V] that a replay ran with; UsageError where no row had a voltage."""
    if estimator.pack_size is None:
        raise UsageError(f"{flight.source}: expected at least one row with the voltage of a pack")
    return estimator.pack_size


def recorded_period_s(flight: Flight) -> float:
    """Return the time between forecasts [s] that a recording of `uavbatt live` states, else the usual one."""
    recorded_s = flight.forecast_period_s
    return recorded_s if math.isfinite(recorded_s) else ForecastSettings().forecast_period_s


def with_mission(flight: Flight, planned: PlannedFlight) -> Flight:
    """Return the flight with the mission of a file instead of the log's own.

    A log that says nothing of place and mode has it, too, so that its rows say why the mission is not used.
    """
    said = flight.navigation or (replace(NOWHERE, time_s=flight.samples[0].time_s),)
    return replace(flight, navigation=tuple(planned.flown(known) for known in said))


def steps(flight: Flight, estimator: Estimator, later: Sequence[PackHealth | None] = ()) -> Iterator[ReplayedRow]:
    """Yield estimate and forecast after each row of a flight; nothing of row k depends on a later row.

    later : health, by the ledger, of the packs of the log's flights but the first (`of_discharges`); each is used if
    the rows show that the pack was changed. Rows before the capacity is known are refused, as in flight. Raises
    UsageError if it never becomes known.
    """
    why_not, is_stated = "", False
    begins_s = [part.samples[0].time_s for part in of_discharges(flight)[1:]] if later else []
    for facts, packs, stretch in _stretches(flight, begins_s):
        if packs:
            estimator.remembered_next = later[packs - 1]
        why_not = why_no_capacity(estimator.battery, estimator.options, facts)
        is_stated = is_stated or not why_not
        samples, again = tee(stretch)
        if why_not:
            found: Iterable[tuple[Estimate, Remaining]] = (refused(sample, why_not) for sample in samples)
        else:
            estimator.update_facts(facts)
            found = estimator.run(samples, flight.navigation_at)
        for sample, (estimate, remaining) in zip(again, found, strict=True):
            yield ReplayedRow(estimate, remaining, sample.armed)
    if not is_stated and why_not:
        raise UsageError(why_not)


def _stretches(flight: Flight, begins_s: Sequence[float]) -> Iterator[tuple[PackFacts, int, Iterator[Sample]]]:
    """Yield the rows in stretches of one pack in which the vehicle states the same facts.

    begins_s : of the log's later flights [s]. Each stretch comes with its facts, and with how many of them have begun.
    """
    facts_s = [time_s for time_s, _ in flight.facts]

    def begun(sample: Sample) -> tuple[int, int]:
        return bisect_right(facts_s, sample.time_s), bisect_right(begins_s, sample.time_s)

    for (count, packs), rows in groupby(flight.samples, key=begun):
        yield flight.facts[count - 1][1] if count else PackFacts(), packs, rows


class RouteForecasts(NamedTuple):
    """RouteForecasts holds the forecasts of a replay about a route or the way home, each with its time [s]."""

    rows: list[tuple[float, Route]]

    @property
    def turn_back_now_s(self) -> float:
        """Return the time of the first warning "turn back now" [s]; NaN if there was none."""
        now = (time_s for time_s, route in self.rows if route.must_turn_back_now and not route.is_returning)
        return next(now, NAN)

    @property
    def why_no_route(self) -> str:
        """Return the most frequent reason why the route was not the load to come; empty if there is none."""
        reasons = Counter(route.reason for _, route in self.rows if route.load != "route" and route.reason)
        return reasons.most_common(1)[0][0] if reasons else ""

    @property
    def assumed(self) -> str:
        """Return what was assumed most often where mission or vehicle do not say all; empty if hardly ever.

        The wind, for one, is not told in the first seconds of a flight.
        """
        assumed = Counter(route.assumed for _, route in self.rows if route.assumed).most_common(1)
        return next((words for words, times in assumed if times >= OFTEN * len(self.rows)), "")


def route_forecasts(run: Iterable[ReplayedRow]) -> RouteForecasts:
    """Return the forecasts of a replay about route and way home; empty where neither mission nor home was known."""
    return RouteForecasts(
        [(row.remaining.time_s, row.remaining.route) for row in run if row.remaining.route is not None]
    )
