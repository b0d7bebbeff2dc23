"""Replay of a flight log through the estimator: the rows that come out, and how good they were."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from uavbatt import output
from uavbatt.battery import battery_file, statements, vehicle_file
from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.model import Array
from uavbatt.battery.sizing import PackOptions, PackSize
from uavbatt.battery.vehicle_file import VehicleFile
from uavbatt.errors import MissingExtra, UsageError
from uavbatt.estimator import PLAIN, Engine, Estimator
from uavbatt.limits import Names
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.prediction.load_options import stated_load
from uavbatt.records import NAN, Estimate, Flight, PackFacts, Remaining, Sample, Status
from uavbatt.scoring.end_of_flight import end_of_flight
from uavbatt.telemetry import read_log
from uavbatt.telemetry.formats import recording
from uavbatt.telemetry.formats.mission_file import PlannedFlight

if TYPE_CHECKING:
    from pandas import DataFrame

MANY_ROWS = 100_000  # plain numpy takes 14 s for them, compiled code 9 s, and 1 s to be loaded (15 s to be made, once)
AT_REST_S = 5.0  # a log whose load ends this soon before its end was cut in the air
FORGOTTEN_S = 30.0
FORECAST_PERIOD_S = 5.0
CHECKPOINTS_S = (360.0, 240.0, 120.0, 60.0)


@dataclass(frozen=True, slots=True)
class ReplayedRow:
    """One output line: the estimate and the forecast after one row."""

    estimate: Estimate
    remaining: Remaining


def engine_for(*, is_long: bool) -> Engine:
    """The engine for a work: compiled where that is long enough to repay it and the extra `fast` is installed."""
    if not is_long:
        return PLAIN
    try:
        from uavbatt import compiled
    except ImportError:  # an installation without it
        return PLAIN
    return compiled.engine() if compiled.is_available() else PLAIN


def with_mission(flight: Flight, planned: PlannedFlight) -> Flight:
    """Return the flight with the mission of a file in the place of whatever the log says of one."""
    return replace(
        flight,
        navigation=tuple(
            replace(known, mission=planned.mission, home=known.home or planned.home, transferring=False)
            for known in flight.navigation
        ),
    )


def steps(flight: Flight, estimator: Estimator) -> Iterator[ReplayedRow]:
    """Run the rows of a flight through an estimator; nothing of row k depends on a later row."""
    for facts, samples in _stretches(flight):
        estimator.update_facts(facts)
        for estimate, remaining in estimator.run(samples, flight.navigation_at):
            yield ReplayedRow(estimate, remaining)


def _stretches(flight: Flight) -> Iterator[tuple[PackFacts, Iterator[Sample]]]:
    """The rows in pieces in which the vehicle says the same all along."""
    since_s = [time_s for time_s, _ in flight.facts]
    for count, rows in groupby(flight.samples, key=lambda sample: bisect_right(since_s, sample.time_s)):
        yield flight.facts[count - 1][1] if count else PackFacts(), rows


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """The forecast at one instant before the known end: error = forecast - truth [s]; inside = in the interval."""

    label: str
    before_end_s: float
    remaining_s: float
    lo_s: float
    hi_s: float

    @property
    def error_s(self) -> float:
        """Positive is optimistic; NaN when refused."""
        return self.remaining_s - self.before_end_s

    @property
    def inside(self) -> bool:
        """True if the truth lies in the 90 % interval."""
        return self.lo_s <= self.before_end_s <= self.hi_s


@dataclass(frozen=True, slots=True)
class Landing:
    """The forecast at the last row in the air: how much longer the aircraft could have flown.

    time_s [s] is the row's; the forecasts [s] are NaN where none was given there. is_cut: the log ends in the air.
    """

    time_s: float
    remaining_s: float
    remaining_lo_s: float
    remaining_hi_s: float
    remaining_to_low_s: float
    reason: str = ""
    is_cut: bool = False


@dataclass(frozen=True, slots=True)
class Outcome:
    """One replay in figures."""

    rows: int
    duration_s: float
    end_voltage_V: float
    end_soc: float
    end_soc_sd: float
    end_of_flight_s: float
    refused_in_air: float
    mean_nis: float
    checkpoints: tuple[Checkpoint, ...]
    landing: Landing | None = None  # None: the log shows no flight


def outcome(run: list[ReplayedRow], cutoff_V: float) -> Outcome:
    """Figures of a finished replay; the truth is the end of flight that the log itself shows, if it does."""
    time_s = np.array([s.estimate.time_s for s in run])
    volts = np.array([s.estimate.voltage_V for s in run])
    amps = np.array([s.estimate.current_A for s in run])
    if np.isfinite(amps).any():
        end_s = end_of_flight(time_s, volts, amps, cutoff_V=cutoff_V, min_current_A=_loaded_A(amps))
    else:  # no current sensor: every row may be under load
        end_s = end_of_flight(time_s, volts, cutoff_V=cutoff_V)
    known = [s.estimate for s in run if math.isfinite(s.estimate.soc)]
    flying = np.nan_to_num(amps) > _loaded_A(amps)
    since_s = time_s[flying][0] + 60.0 if flying.any() else math.inf
    judged = [s for s, f in zip(run, flying, strict=True) if f and s.estimate.time_s > since_s]
    refused = sum(s.remaining.status is Status.REFUSED for s in judged)
    nis = np.array([s.estimate.nis for s in run])
    take_off_s = float(time_s[flying][0]) if flying.any() else float(time_s[0])
    return Outcome(
        rows=len(run),
        duration_s=float(time_s[-1] - time_s[0]),
        end_voltage_V=float(volts[np.isfinite(volts)][-1]) if np.isfinite(volts).any() else NAN,
        end_soc=known[-1].soc if known else NAN,
        end_soc_sd=known[-1].soc_sd if known else NAN,
        end_of_flight_s=end_s,
        refused_in_air=refused / len(judged) if judged else NAN,
        mean_nis=float(np.nanmean(nis)) if np.isfinite(nis).any() else NAN,
        checkpoints=_checkpoints(run, time_s, take_off_s, end_s) if math.isfinite(end_s) else (),
        landing=_landing(run, flying if np.isfinite(amps).any() else np.isfinite(volts)),
    )


def _landing(run: list[ReplayedRow], flying: NDArray[np.bool_]) -> Landing | None:
    """Return the forecast at the last row in the air, or at the last one before it that was given one.

    A refused number is not older than FORGOTTEN_S: an aircraft that comes down draws little, and a row there may have
    none.
    """
    in_air = np.flatnonzero(flying)
    if not in_air.size:
        return None
    last = int(in_air[-1])
    end_s = run[last].estimate.time_s
    is_cut = run[-1].estimate.time_s - end_s < AT_REST_S
    for k in in_air[::-1]:
        said = run[k].remaining
        if end_s - said.time_s > FORGOTTEN_S:
            break
        if math.isfinite(said.remaining_s):
            numbers = (said.remaining_s, said.remaining_lo_s, said.remaining_hi_s, said.remaining_to_low_s)
            return Landing(said.time_s, *numbers, is_cut=is_cut)
    return Landing(end_s, NAN, NAN, NAN, NAN, run[last].remaining.reason, is_cut)


def _loaded_A(amps: Array) -> float:
    """The current above which a row counts as under load: a third of the flight's upper current; ∞ without one."""
    return float(np.nanpercentile(amps, 90)) / 3.0 if np.isfinite(amps).any() else math.inf


def _checkpoints(run: list[ReplayedRow], time_s: Array, take_off_s: float, end_s: float) -> tuple[Checkpoint, ...]:
    wanted = [("half time", (end_s - take_off_s) / 2.0)] + [(f"{s:.0f} s before", s) for s in CHECKPOINTS_S]
    found = []
    for label, before_s in wanted:
        index = int(np.searchsorted(time_s, end_s - before_s + 1e-6, side="right")) - 1
        if end_s - before_s < take_off_s or index < 0:
            continue
        line = run[index].remaining
        true_s = end_s - line.time_s
        found.append(Checkpoint(label, true_s, line.remaining_s, line.remaining_lo_s, line.remaining_hi_s))
    return tuple(found)


@dataclass(frozen=True, slots=True)
class Replay:
    """A replayed flight: iterate over it for a `Step` a row, or take `rows` or `to_frame()` for a table.

    flight: the log as it was read.
    pack: cells, capacity [Ah], cut-off [V] and where each came from.
    steps: the estimate and the forecast after each row.
    outcome: the flight in figures, and the error of the forecasts where the log reaches the end of flight.
    """

    flight: Flight
    pack: PackSize
    steps: tuple[ReplayedRow, ...]
    outcome: Outcome

    def __len__(self) -> int:
        return len(self.steps)

    def __iter__(self) -> Iterator[ReplayedRow]:
        return iter(self.steps)

    def __repr__(self) -> str:
        """Return one line: the steps are thousands."""
        return f"<Replay of {self.flight.source} on {self.pack.battery}: {len(self)} steps, {self.pack.words}>"

    @property
    def rows(self) -> list[output.Line]:
        """The lines that `uavbatt replay --jsonl` writes, one a step; None is what is not known."""
        return [output.line(step.estimate, step.remaining) for step in self.steps]

    def to_frame(self) -> DataFrame:
        """Return the rows as a pandas DataFrame, NaN for what is not known.

        Its columns are `output.COLUMNS`, and `output.ROUTE_COLUMNS` where a route or home is known. Raises MissingExtra
        without pandas.
        """
        try:
            import pandas
        except ImportError:
            raise MissingExtra("pandas", "to_frame()") from None
        rows = self.rows
        has_route = any("load" in row for row in rows)
        columns = {**output.COLUMNS, **(output.ROUTE_COLUMNS if has_route else {})}
        table = pandas.DataFrame(rows, columns=list(columns))
        return table.astype({key: float for key, digits in columns.items() if digits is not None})


def replay(
    log: str | Path | Flight,
    battery: str | Path | BatteryFile = "lipo-generic",
    *,
    cells: int | None = None,
    capacity_Ah: float = NAN,
    cutoff_V: float = NAN,
    reserve_soc: float = 0.0,
    instance: int | None = None,
    vehicle: str | Path | VehicleFile | None = None,
    load: str | float = "learned",
    forecast_period_s: float | None = None,
    allow_uncertified: bool = False,
) -> Replay:
    """Replay a flight log: state of charge and remaining time at every row, as `uavbatt replay` works them out.

    Args:
        log: path of a DataFlash, `.tlog`, `.ulg` or CSV log, or a `Flight` that was read before.
        battery: name of a packaged battery, a battery file by path, or its content.
        cells: cells in series. What is not stated of the pack comes from the vehicle, the voltage, the battery file.
        capacity_Ah: capacity of the pack [Ah].
        cutoff_V: voltage of the pack that ends the flight [V].
        reserve_soc: state of charge (0 to 0.99) that ends the flight, too; 0 is off.
        instance: battery of the log; by default the first that reports a current.
        vehicle: vehicle file by path, or its content: how this aircraft flew before.
        load: `learned`, `recent`, `log`, or the power to come [W].
        forecast_period_s: time between two forecasts [s]; between them the last one counts down. By default 5 s, and
            for a recording of `uavbatt live` what it was made with.
        allow_uncertified: read a battery file whose hash or verdict is broken.

    Returns:
        Every row and what came of it.

    Raises:
        BadInput: a file cannot be used; the message names it, the place and what was expected.
        UsageError: an argument cannot be; the message names it and its bounds.
    """
    flight = _flight(log, instance)
    content = _read(battery, allow_uncertified)
    flown = vehicle if isinstance(vehicle, VehicleFile | None) else vehicle_file.read_vehicle(vehicle)
    options = PackOptions(cells, capacity_Ah, cutoff_V, spelt=Names())
    statements.check_statements(content, options, flight)
    period_s = _recorded_period_s(log) if forecast_period_s is None else _period_s(forecast_period_s)
    to_come = stated_load(str(load), flight, flown, content, name="load=")
    engine = engine_for(is_long=len(flight.samples) >= MANY_ROWS)
    estimator = Estimator(content, options, ForecastSettings(to_come, reserve_soc, period_s), engine)
    run = list(steps(flight, estimator))
    if estimator.pack_size is None:
        raise UsageError(f"{flight.source}: expected at least one row with a voltage")
    return Replay(flight, estimator.pack_size, tuple(run), outcome(run, estimator.pack_size.cutoff_V))


def _read(battery: str | Path | BatteryFile, allow_uncertified: bool) -> BatteryFile:
    """Return the content of a battery file that is named, or as it is given."""
    if isinstance(battery, BatteryFile):
        return battery
    return battery_file.read_battery(battery, allow_uncertified=allow_uncertified)


def _recorded_period_s(log: str | Path | Flight) -> float:
    """Return the time between forecasts [s] that a recording of `uavbatt live` states, else the usual one."""
    recorded_s = NAN if isinstance(log, Flight) else recording.forecast_period_s(log)
    return recorded_s if math.isfinite(recorded_s) else FORECAST_PERIOD_S


def _period_s(stated_s: object) -> float:
    if isinstance(stated_s, int | float) and stated_s >= 0.0:
        return float(stated_s)
    raise UsageError(f"forecast_period_s={stated_s!r}: expected 0 s or more")


def _flight(log: str | Path | Flight, instance: int | None) -> Flight:
    """Return the flight that is asked for, read if it is not yet."""
    if not isinstance(log, Flight):
        return read_log(log, instance)
    if instance is not None and instance != log.instance:
        raise UsageError(f"instance={instance}: the flight was read with battery {log.instance}; give the log's path")
    return log
