"""A vehicle file from past flights: power and charge from take-off to landing, by the estimates of a battery file."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import groupby
from typing import NamedTuple

import msgspec
import numpy as np

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.model import Array
from uavbatt.battery.pack import true_power
from uavbatt.battery.scaling import installation_of
from uavbatt.battery.sizing.pack_size import PackOptions, capacity_since_s
from uavbatt.battery.vehicle_file import Phases, Speeds, Trace, VehicleFile
from uavbatt.engine import PLAIN, Engine
from uavbatt.errors import NotEnoughData
from uavbatt.estimation.still_sensors import STILL_C_RATE
from uavbatt.estimator import Estimator
from uavbatt.fitting.powers import SHORTEST_S, powers
from uavbatt.output import counted
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.records import Estimate, Flight, Sample

GRID_S = 10.0  # of a load trace: slower than the turns of an aircraft, faster than the pack's reactions
FLYING_SHARE = 0.3  # of the upper power (90 % point): less is the aircraft on the ground
LEAST_ROWS = 5
LANDING_SHARE = 0.6  # of the flight's median power: the last rows below it are the landing, not the flight

OTHER_FACTOR, LEAST_FLIGHTS = 1.6, 3  # payloads and winds of one aircraft differ by less; two flights tell nothing


class OtherPower(NamedTuple):
    """OtherPower is a flight whose power [W] is far from the median of the others [W]."""

    source: str
    power_W: float
    usual_W: float


def fit_vehicle(
    name: str,
    flights: list[Flight],
    battery: BatteryFile,
    options: PackOptions,
    engine: Engine = PLAIN,
    progress: Callable[[float], None] = lambda _: None,
) -> VehicleFile:
    """Return the vehicle file of the flights that are long enough. Raises NotEnoughData if none is.

    engine : estimates their charge; progress : is called with the share of the work that each flight was
    """
    traces = []
    for flight in flights:
        if (found := trace(flight, battery, options, engine)) is not None:
            traces.append(found)
        progress(1.0 / len(flights))
    if not traces:
        logs = counted(len(flights), "log")
        raise NotEnoughData(f"{name}: {logs}, none of which holds {SHORTEST_S:.0f} s of flight with a current")
    watts = [np.array(t.power_W) for t in traces]
    return VehicleFile(
        name=name,
        battery=battery.battery.name,
        phases=Phases(
            take_off_W=_rounded(np.mean([w[: int(60 / GRID_S)].mean() for w in watts])),
            flight_W=_rounded(np.mean([w.mean() for w in watts])),
            last_minute_W=_rounded(np.mean([w[-int(60 / GRID_S) :].mean() for w in watts])),
        ),
        traces=traces,
        source=counted(len(traces), "flight"),
        powers=powers(flights, installation_of(battery, 1, 1.0)),
        speeds=speeds(flights),
        batteries=flights[0].joined,
    )


def other_powers(flights: list[Flight]) -> Iterator[OtherPower]:
    """Yield the flights of another aircraft, or with another current sensor: their power is far from the others'."""
    known = [(flight.source, watts) for flight in flights if math.isfinite(watts := _flying_W(flight))]
    if len(known) < LEAST_FLIGHTS:
        return
    usual_W = float(np.median([watts for _, watts in known]))
    for source, watts in known:
        if not usual_W / OTHER_FACTOR <= watts <= usual_W * OTHER_FACTOR:
            yield OtherPower(source, watts, usual_W)


def _flying_W(flight: Flight) -> float:
    """Return the median power of a flight [W]; NaN without a current."""
    watts = np.array([s.voltage_V * s.current_A for s in flight.samples if s.voltage_V > 0.0 and s.current_A > 0.0])
    return float(np.median(watts[watts > FLYING_SHARE * np.percentile(watts, 90)])) if watts.size else math.nan


def speeds(flights: list[Flight]) -> Speeds | None:
    """Return speeds and way home by the vehicle's last parameters; None if no log has them.

    Values out of the bounds of a vehicle file are left out.
    """
    for flight in reversed(flights):
        settings = flight.navigation_at(math.inf).settings
        stated = {name: getattr(settings, name) for name in Speeds.__struct_fields__}
        plausible = {name: round(value, 3) for name, value in stated.items() if _may_be(name, value)}
        if plausible:
            return Speeds(**plausible)
    return None


def _may_be(name: str, value: float) -> bool:
    """Return True if a value is within the bounds of the field `name` of `Speeds`."""
    try:
        msgspec.convert({name: value}, Speeds)
    except msgspec.ValidationError:
        return False
    return value >= (0.0 if name.endswith("_m") else 0.01)


def trace(flight: Flight, battery: BatteryFile, options: PackOptions, engine: Engine = PLAIN) -> Trace | None:
    """Return one flight on a grid of GRID_S from take-off; None when it is too short or the pack was at rest."""
    sensors = installation_of(battery, 1, 1.0)
    estimator = Estimator(battery, options, ForecastSettings(forecast_period_s=math.inf), engine)
    rows, ground_s, before_s = [], 0.0, math.inf
    for sample, estimate in _estimates(flight, estimator):
        if sample.armed is False:  # the time between two flights of a log does not count
            ground_s += max(estimate.time_s - before_s, 0.0)
        elif math.isfinite(estimate.power_W) and math.isfinite(estimate.soc):
            power_W = float(true_power(sensors, estimate.voltage_V, estimate.current_A))
            rows.append((estimate.time_s - ground_s, max(power_W, 0.0), estimate.soc, estimate.current_A))
        before_s = estimate.time_s
    size, table = estimator.pack_size, np.array(rows)
    if size is None or len(table) < LEAST_ROWS:
        return None
    time_s, watts, soc, current_A = table.T
    if np.percentile(current_A, 90) < STILL_C_RATE * size.capacity_Ah:
        return None
    first, last = _airborne(watts)
    if time_s[last] - time_s[first] < SHORTEST_S:
        return None
    end_s = float(time_s[last] - time_s[first])
    grid_s = np.arange(0.0, end_s, GRID_S)
    return Trace(
        time_s=[float(t) for t in grid_s],
        power_W=[_rounded(w) for w in _means(time_s - time_s[first], watts, grid_s, end_s)],
        soc=[round(float(z), 4) for z in np.interp(grid_s, time_s - time_s[first], soc)],
    )


def _estimates(flight: Flight, estimator: Estimator) -> Iterator[tuple[Sample, Estimate]]:
    """Yield each row of a flight with its estimate. A capacity that is stated late holds from the start."""
    stated_s = capacity_since_s(estimator.battery, estimator.options, flight.facts)
    for facts, rows in groupby(flight.samples, key=lambda row: flight.facts_at(max(row.time_s, stated_s))):
        stretch = list(rows)
        estimator.update_facts(facts)
        for sample, (estimate, _) in zip(stretch, estimator.run(stretch), strict=True):
            yield sample, estimate


def _airborne(watts: Array) -> tuple[int, int]:
    """Return the first and the last row with more than `LANDING_SHARE` of the power that is usual in the air."""
    usual_W = float(np.median(watts[watts > FLYING_SHARE * np.percentile(watts, 90)]))
    high = np.flatnonzero(watts > LANDING_SHARE * usual_W)
    return int(high[0]), int(high[-1])


def _means(time_s: Array, watts: Array, grid_s: Array, end_s: float) -> Array:
    """Return the mean power [W] from each grid point to the next and at last to `end_s`, by the energy of the rows."""
    energy_J = np.concatenate([[0.0], np.cumsum(0.5 * (watts[1:] + watts[:-1]) * np.diff(time_s))])
    edges_s = np.append(grid_s, end_s)  # the last block lasts to the landing
    return np.asarray(np.diff(np.interp(edges_s, time_s, energy_J)) / np.diff(edges_s)).clip(min=0.0)


def _rounded(value: float) -> float:
    return round(float(value), 1)
