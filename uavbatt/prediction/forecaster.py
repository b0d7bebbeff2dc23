"""The forecaster: belief and load to come -> seconds until the end of flight, or a refusal with its reason.

It keeps what a forecast needs from the past (`flown`: the recent load, whether the aircraft flies) and the last
forecast, which counts down between two.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.battery.pack import c_rate, true_current, true_voltage
from uavbatt.battery.scaling import Pack
from uavbatt.battery.state_space import Belief, X
from uavbatt.errors import UsageError
from uavbatt.limits import check_stated
from uavbatt.navigation import NOWHERE, Navigation
from uavbatt.notice import Kind, Notice
from uavbatt.prediction.batch import Question, end_times
from uavbatt.prediction.forecast import LEVELS, Forecast, no_forecast, quantile
from uavbatt.prediction.load.flight_so_far import FlightSoFar
from uavbatt.prediction.load.library import UnknownAircraft
from uavbatt.prediction.load.scenarios import SLOW_ROW_S, ConstantLoad, FlightPoint, Load
from uavbatt.prediction.route import forecast as route_forecast
from uavbatt.prediction.route.ahead import homes_from, way_of
from uavbatt.prediction.route.flight_lessons import FlightLessons
from uavbatt.prediction.route.forecast import ToCome, WaysState
from uavbatt.prediction.route.progress import Progress
from uavbatt.prediction.simulation import sampling
from uavbatt.prediction.simulation.draws import Flying
from uavbatt.prediction.simulation.time_to_end import EndTimes
from uavbatt.prediction.take_off import AtTakeOff, is_open, load_before_take_off
from uavbatt.prediction.typical_end import longest_s, steady_s
from uavbatt.records import NAN, Estimate, Remaining, Sample, Status

NOT_FLYING = Notice("not flying: no forecast until the motors carry the aircraft", Kind.NOT_FLYING)
NO_LOAD_ALOFT = Notice(
    "in the air, but no load that carries the aircraft was seen: no forecast until the motors run", Kind.NO_LOAD_ALOFT
)
JUST_TAKEN_OFF = Notice("the load has just begun", Kind.JUST_TAKEN_OFF)
NO_BELIEF = Notice("no estimate of the pack yet", Kind.NO_BELIEF)
BEYOND_SIX_HOURS = Notice(
    "the end may be more than six hours away: this is not the load of a flight", Kind.BEYOND_SIX_HOURS
)
SETTLED_S = 4.0  # two blocks of the filter: it has then seen the effect of the load
# Steps to the typical end, shortest and longest step [s]. Gusts must be simulated one by one: with steps of 15 s
# worn packs get 5 s too much at half time. Under a steady power longer steps change the end by less than 0.3 %.
STEPS, SHORTEST_STEP_S, LONGEST_STEP_S = 100, 1.0, 10.0
STEADY_STEPS, LONGEST_STEADY_STEP_S = 60, 30.0
LONGEST_FLIGHT_S = 6 * 3600.0  # longest time at the typical power with all the charge that may be left
LONGEST_SHARE = 2.0  # horizon over the time at the typical power; the gentlest load is half


@dataclass(frozen=True, slots=True)
class ForecastSettings:
    """ForecastSettings holds what the operator asks of forecasts. Raises UsageError for a number that cannot be.

    load : how the load to come is known; reserve_soc : state of charge that ends the flight, 0..1;
    forecast_period_s : seconds between two forecasts.
    """

    load: Load = UnknownAircraft()
    reserve_soc: float = 0.0
    forecast_period_s: float = 5.0

    def __post_init__(self) -> None:
        check_stated(reserve_soc=self.reserve_soc)
        if not self.forecast_period_s >= 0.0:
            raise UsageError(f"forecast_period_s={self.forecast_period_s}: expected 0 s or more")


class ForecasterMemory(NamedTuple):
    """ForecasterMemory holds the past that forecasts need; it is saved with the belief, so that a restart goes on."""

    flight: FlightSoFar
    route: FlightLessons
    at_take_off: AtTakeOff | None = None

    def moved(self, shift_s: float) -> ForecasterMemory:
        """Return the same past on a clock that shows `shift_s` [s] more."""
        expected = self.at_take_off and self.at_take_off.moved(shift_s)
        return self._replace(flight=self.flight.moved(shift_s), at_take_off=expected)


class Forecaster:
    """A forecaster turns estimates into remaining time; one instance follows one flight."""

    def __init__(self, pack: Pack, settings: ForecastSettings | None = None) -> None:
        self.pack = pack
        self.settings = settings or ForecastSettings()
        self.cell_spread_V = 0.0  # how far the weakest cell is below the mean, where cells are measured
        self._flight = FlightSoFar()
        self._asked_s = NAN
        self._ways = WaysState()
        self._last: Forecast | None = None
        self._progress = Progress()  # progress on the route
        self._rested: Belief | None = None  # the last belief on the ground
        self._at_take_off: AtTakeOff | None = None

    @property
    def flying_since_s(self) -> float:
        """Return the time of the row since which the pack carries the aircraft [s]; NaN on the ground."""
        return self._flight.flying_since_s

    @property
    def memory(self) -> ForecasterMemory:
        """Return the past as far as forecasts need it."""
        return ForecasterMemory(self._flight, self._progress.lessons, self._at_take_off)

    def recall(self, memory: ForecasterMemory) -> None:
        """Go on from a past that was saved."""
        self._flight, self._at_take_off = memory.flight, memory.at_take_off
        self._progress = self._progress._replace(lessons=memory.route)

    def update(
        self, sample: Sample, estimate: Estimate, belief: Belief | None, navigation: Navigation = NOWHERE
    ) -> tuple[str, Question | None]:
        """Take a sample into the memory; return why there can be no forecast, and the forecast to simulate, if any.

        belief : after the sample; navigation : where the aircraft is and what it will fly, for the load to come. The
        reason is empty where there can be a forecast; the forecast is None between two of them. No simulated forecast
        is used, so that a replay can take many rows in and simulate their forecasts at once.
        """
        if navigation is not NOWHERE:
            navigation = route_forecast.with_usual(navigation, self.settings.load, self._progress)
        is_aloft = navigation.is_aloft(sample.time_s)
        self._remember(sample, navigation, is_aloft)
        flying_s = sample.time_s - self._flight.flying_since_s  # NaN on the ground
        if math.isnan(self._flight.took_off_s):
            self._at_take_off = None
        if math.isnan(flying_s):
            self._rested = belief
        elif self._at_take_off is None and belief is not None and is_open(self.settings.load):
            self._at_take_off = self._expected(self._rested or belief, self._flight.flying_since_s)
        refusal, question = self._refusal(estimate, flying_s, is_aloft), None
        if not refusal and belief is None:
            refusal = NO_BELIEF
        elif not refusal and not sample.time_s - self._asked_s < self.settings.forecast_period_s:
            assert belief is not None
            question = self.question(belief, sample.time_s, navigation)
            refusal = "" if question else BEYOND_SIX_HOURS
        if refusal:
            self._asked_s, self._ways = NAN, WaysState()
        elif question is not None:
            self._asked_s, self._ways = sample.time_s, question.ways
        return refusal, question

    def finish(self, estimate: Estimate, refusal: str, answered: tuple[Question, EndTimes] | None) -> Remaining:
        """Return the remaining time of an estimate, from the refusal of `update` or the answer to its question.

        answered : the question with its simulated ends, None where `update` had none. Estimates must be finished in the
        order in which they were taken in.
        """
        if answered is not None:
            self._last = self._forecast(*answered)
        if refusal or self._last is None:
            self._last = None
            return no_forecast(estimate.time_s, refusal)
        return self._last.counted_down(estimate)

    def question(self, belief: Belief, time_s: float, navigation: Navigation = NOWHERE) -> Question | None:
        """Return the forecast to simulate from the belief and the load to come; None when no end is in sight."""
        known = route_forecast.to_come(self.settings.load, self._progress, navigation, time_s)
        load, now = known.load, self._now(belief, time_s, navigation)
        typical_W = load.typical_W(now)
        typical_s = longest_s(self.pack, belief, typical_W)
        if not typical_s < LONGEST_FLIGHT_S:
            return None
        horizon_s, row_s = LONGEST_SHARE * typical_s, self._flight.row_s
        shortest_s = horizon_s / (sampling.LONGEST - 2)  # the steps must reach the horizon
        by_rows = row_s > max(SLOW_ROW_S, shortest_s)
        dt_s = row_s if by_rows else max(_step_s(load, typical_s), shortest_s)
        steps = math.ceil(horizon_s / dt_s - 1e-6) + 2
        left_s = steady_s(self.pack, belief, typical_W)
        scenarios = load.scenarios(now._replace(left_s=left_s), dt_s, steps)
        scenario = sampling.assigned(scenarios.weight)
        flying = Flying(
            pack=self.pack.at_weakest_cell(self.cell_spread_V),
            x=sampling.samples(belief),
            power_W=scenarios.power_W[:, scenario],
            ambient_C=belief.ambient_C,
            dt_s=scenarios.dt_s,
            reserve_soc=self.settings.reserve_soc,
            by_rows=by_rows,
        )
        question = Question(
            time_s=time_s,
            horizon_s=horizon_s,
            flying=flying,
            unresolved_s=0.0 if by_rows or isinstance(load, ConstantLoad) else dt_s,
            at_take_off=self._at_take_off and self._at_take_off.at_power(time_s, now.flight_W),
        )
        return self._with_ways(question, known, scenario, navigation, typical_s) if navigation.has_way else question

    def _with_ways(
        self, asked: Question, known: ToCome, scenario: Array, navigation: Navigation, typical_s: float
    ) -> Question:
        """Return what is asked with the way home and the rest of the route, if it is time to simulate them again.

        scenario : which scenario of the load each draw flies [draws]; typical_s : about the time to the end [s].
        """
        ways = route_forecast.ways_state(known, navigation, asked.time_s)
        if not self._ways.is_due(ways, typical_s):
            return asked._replace(ways=self._ways)
        home = route_forecast.homewards(self.settings.load, self._progress, navigation, asked.time_s)
        way, homewards = way_of(self._progress), homes_from(self._progress, navigation)
        route = route_forecast.fly_ways(known, home, asked.flying, scenario, way, homewards, typical_s)
        return asked._replace(route=route, ways=ways)

    def before_take_off(self, belief: Belief, time_s: float) -> Forecast | None:
        """Return the forecast of a take-off now, with the load as it is known on the ground; no memory changes.

        None when no end is in sight.
        """
        return self._before_any_flight().forecast(belief, time_s)

    def _before_any_flight(self) -> Forecaster:
        """Return a forecaster of the same pack without a past, whose load is as it is known on the ground."""
        settings = replace(self.settings, load=load_before_take_off(self.settings.load, self.pack))
        return Forecaster(self.pack.at_weakest_cell(self.cell_spread_V), settings)

    def _expected(self, belief: Belief, take_off_s: float) -> AtTakeOff | None:
        """Return the end that is expected at take-off from this belief; None where none is in sight."""
        on_ground = self._before_any_flight()
        question = on_ground.question(belief, take_off_s)
        if question is None:
            return None
        power_W = on_ground.settings.load.typical_W(self._now(belief, take_off_s, NOWHERE))
        ends = (np.sort(np.minimum(times_s, question.horizon_s)) for times_s in end_times(question.flying, enough=1.0))
        return AtTakeOff(take_off_s, power_W, *(tuple(times_s.tolist()) for times_s in ends))

    def forecast(self, belief: Belief, time_s: float) -> Forecast | None:
        """Simulate and return a fresh forecast; None when no end is in sight."""
        question = self.question(belief, time_s)
        return None if question is None else self._forecast(question, end_times(question.flying))

    def _forecast(self, question: Question, ends: EndTimes) -> Forecast:
        """Return the quantiles of the simulated ends."""
        time_s, horizon_s = question.time_s, question.horizon_s
        fresh = EndTimes(*(np.sort(np.minimum(_spread(question, times_s), horizon_s)) for times_s in ends))
        if question.at_take_off is not None:
            fresh = question.at_take_off.joined(time_s, fresh)
        ends_s = self._last.steadied(fresh.end_s, time_s) if self._last is not None else fresh.end_s
        lo_s, alarm_s, median_s, hi_s = (quantile(ends_s, level) for level in LEVELS)
        route = question.route and route_forecast.route_answer(question.route, ends.end_s)
        if route is None and question.ways.about and self._last is not None and self._last.route is not None:
            route = self._last.route.later(time_s - self._last.time_s)
        low_s = min(quantile(fresh.low_s, 0.5), median_s) if math.isfinite(self.pack.low_V) else NAN
        return Forecast(time_s, median_s, lo_s, hi_s, low_s, alarm_s, ends_s, route)

    def _now(self, belief: Belief, time_s: float, navigation: Navigation) -> FlightPoint:
        flown = self._flight
        since_s = time_s - flown.took_off_s if math.isfinite(flown.took_off_s) else 0.0
        return FlightPoint(time_s, since_s, float(belief.mean[X.SOC]), flown.mean_W, flown.load, navigation)

    def _remember(self, sample: Sample, navigation: Navigation, is_aloft: bool | None) -> None:
        """Take the load and the place of one row into the memory; a row without voltage or current changes nothing."""
        if not (math.isfinite(sample.voltage_V) and math.isfinite(sample.current_A)):
            return
        installation = self.pack.installation
        current_A = float(true_current(installation, sample.current_A, sample.voltage_V))
        power_W, before = float(true_voltage(installation, sample.voltage_V, current_A)) * current_A, self._flight
        rate = float(c_rate(installation, current_A))
        self._flight = before.after(sample, power_W, rate, is_aloft)
        was_spool_up = self._flight.took_off_s > before.took_off_s and not before.has_carried(power_W, rate)
        if self._at_take_off is not None and was_spool_up:
            self._at_take_off = self._at_take_off._replace(take_off_s=self._flight.took_off_s)
        if navigation is not NOWHERE:
            powers = route_forecast.powers_of(self.settings.load)
            self._progress = self._progress.after(sample.time_s, navigation, power_W, powers)

    def _refusal(self, estimate: Estimate, flying_s: float, is_aloft: bool | None) -> str:
        """Return why there can be no forecast, empty if there can.

        flying_s : time since take-off [s], NaN before it; is_aloft : True in the air by position or by the autopilot.
        """
        if estimate.status is Status.REFUSED:
            return estimate.reason
        if isinstance(self.settings.load, ConstantLoad) or flying_s >= SETTLED_S:
            return ""
        if math.isfinite(flying_s):
            return JUST_TAKEN_OFF
        return NO_LOAD_ALOFT if is_aloft else NOT_FLYING


def _step_s(load: Load, typical_s: float) -> float:
    """Return how long the steps of a simulation are whose end is about `typical_s` away [s]."""
    is_steady = isinstance(load, ConstantLoad)
    steps, longest_s = (STEADY_STEPS, LONGEST_STEADY_STEP_S) if is_steady else (STEPS, LONGEST_STEP_S)
    return min(max(typical_s / steps, SHORTEST_STEP_S), longest_s)


def _spread(question: Question, times_s: Array) -> Array:
    """Return the ends [s], each moved within its step, because a step does not tell when within it a load begins."""
    within_s = question.unresolved_s * sampling.within_step()
    return np.asarray(np.where(times_s > 0.0, np.maximum(times_s + within_s, 0.0), times_s))
