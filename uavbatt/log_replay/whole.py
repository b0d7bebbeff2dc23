"""The function `uavbatt.replay`: replay of a whole flight log in one call, with the same files as the command."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from uavbatt import output
from uavbatt.battery import battery_file, vehicle_file
from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.remembered import PackHealth
from uavbatt.battery.sizing.pack_size import PackOptions, PackSize
from uavbatt.battery.vehicle_file import VehicleFile
from uavbatt.errors import MissingExtra, UsageError, check_path
from uavbatt.limits import Names
from uavbatt.log_replay.flights import ReplayedFlight, flights_of
from uavbatt.log_replay.load_options import stated_load
from uavbatt.log_replay.outcome import Outcome, outcome
from uavbatt.log_replay.run import ReplayedRow, estimator_for, recorded_period_s, size_of_replayed, steps, with_mission
from uavbatt.packs.ledger import Ledger
from uavbatt.packs.remembering import check_cells, flight_for_ledger, health_before, name_of
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.records import NAN, Flight
from uavbatt.small_chart import CHART, Span, captioned, small_chart, small_table
from uavbatt.telemetry import read_log
from uavbatt.telemetry.discharges import of_discharges
from uavbatt.telemetry.formats.mission_file import read_mission

if TYPE_CHECKING:
    from pandas import DataFrame


HEADROOM, SETTLED = 1.6, 0.8  # the chart's axis ends at 1.6 times the 80 % point of the forecasts


@dataclass(frozen=True, slots=True)
class Replay:
    """A replay holds a flight with its estimates: iterate for a `ReplayedRow` each, or take `rows` or `to_frame()`.

    flight: the log as it was read.
    pack: cells, capacity [Ah], cut-off [V] and where each came from.
    steps: the estimate and the forecast after each row.
    outcome: the flight in figures, and the error of the forecasts where the log reaches the end of flight.
    """

    flight: Flight
    pack: PackSize
    steps: tuple[ReplayedRow, ...]
    outcome: Outcome

    @property
    def flights(self) -> tuple[Replay, ...]:
        """Return each flight of the log as a replay of its own: a changed or charged pack begins another one."""
        whole = ReplayedFlight(self.flight, list(self.steps), self.outcome)
        parts = flights_of(whole, self.pack.cutoff_V)
        return tuple(Replay(part.flight, self.pack, tuple(part.run), part.outcome) for part in parts)

    def __len__(self) -> int:
        return len(self.steps)

    def __iter__(self) -> Iterator[ReplayedRow]:
        return iter(self.steps)

    def __repr__(self) -> str:
        """Return one line, because there are thousands of steps."""
        return f"<Replay of {self.flight.source} on {self.pack.battery}: {len(self)} steps, {self.pack.words}>"

    def _repr_html_(self) -> str:
        """Return what a notebook shows: a small table and the time left over the flight with its 90 % band."""
        left = self.outcome.landing
        said = "none"
        if left is not None and math.isfinite(left.remaining_s):
            said = (
                f"{_minutes(left.remaining_s)} min ({_minutes(left.remaining_lo_s)} to {_minutes(left.remaining_hi_s)})"
            )
        end_s = self.outcome.end_of_flight_s
        facts = (
            ("battery", f"{self.pack.battery} ({self.pack.status})"),
            ("pack", self.pack.words),
            ("rows", f"{len(self)} in {_minutes(self.outcome.duration_s)} min"),
            ("left at the last row in the air", said),
            ("end of flight in the log", f"at {_minutes(end_s)} min" if math.isfinite(end_s) else "none"),
        )
        return small_table(self.flight.source, facts, self._chart())

    def _chart(self) -> str:
        known = [k for k, step in enumerate(self.steps) if math.isfinite(step.remaining.remaining_s)]
        if not known:
            return ""
        shown = [step.remaining for step in self.steps[known[0] : known[-1] + 1]]  # NaN where there was no forecast
        known_s = sorted(self.steps[k].remaining.remaining_s for k in known)
        top_s = HEADROOM * known_s[int(SETTLED * (len(known_s) - 1))]
        drawn = small_chart(
            [said.time_s for said in shown],
            [said.remaining_s for said in shown],
            alt="Time left over the flight, with its 90 % interval",
            band=([said.remaining_lo_s for said in shown], [min(said.remaining_hi_s, 2.0 * top_s) for said in shown]),
            shown=Span(0.0, max(top_s, 1.0)),
            size=CHART,
        )
        over = f"{_minutes(shown[0].time_s)} to {_minutes(shown[-1].time_s)} min of the log"
        return captioned(drawn, f"Time left with its 90 % interval, 0 to {_minutes(top_s)} min, over {over}")

    @property
    def rows(self) -> list[output.Line]:
        """Return the lines that `uavbatt replay --jsonl` writes, one a step; None is what is not known."""
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
    mission: str | Path | None = None,
    packs: str | Path | None = None,
    pack: str = "",
    forecast_period_s: float | None = None,
    allow_uncertified: bool = False,
) -> Replay:
    """Replay a flight log: state of charge and remaining time at every row, the same as `uavbatt replay`.

    Args:
        log: path of a DataFlash, `.tlog`, `.ulg` or CSV log, or a `Flight` that was read before.
        battery: name of a packaged battery, a battery file by path, or its content.
        cells: cells in series. Values that are not given come from the vehicle, the voltage, or the battery file.
        capacity_Ah: capacity of the pack [Ah].
        cutoff_V: voltage of the pack that ends the flight [V].
        reserve_soc: state of charge (0 to 0.99) that ends the flight, too; 0 is off.
        instance: battery of the log, from 0; by default the one that carries the flight.
        vehicle: vehicle file by path, or its content: how this aircraft flew before.
        load: `learned`, `recent`, `log`, or the power to come [W].
        mission: the planned mission, a `.waypoints` or `.plan` file; it replaces the one in the log.
        packs: pack ledger, made if missing: the flight begins with its pack's health, and is added to the ledger.
        pack: name of the pack in the ledger; by default its serial number in the log.
        forecast_period_s: time between two forecasts [s]; between them the last one counts down. By default 5 s, and
            for a recording of `uavbatt live` what it was made with.
        allow_uncertified: read a battery file whose hash or verdict is broken.

    Returns:
        The estimates of every row, and the result in figures.

    Raises:
        BadInput: a file cannot be used; the message names it, the place and what was expected.
        UsageError: an argument is impossible; the message names it and its bounds.
    """
    if pack and packs is None:
        raise UsageError(f"pack={pack!r}: expected packs= as well, the file of the pack ledger")
    for argument, value in (("mission", mission), ("packs", packs)):
        if value is not None:
            check_path(argument, value, "the path of a file, or None")
    content, flown = _battery_content(battery, allow_uncertified), _vehicle_content(vehicle)
    flight = _flight(log, instance)
    if mission is not None:
        flight = with_mission(flight, read_mission(mission))
    options = PackOptions(cells, capacity_Ah, cutoff_V, names=Names())
    to_come = stated_load(str(load), flight, flown, content, name="load=")
    settings = ForecastSettings(to_come, reserve_soc, _period_s(flight, forecast_period_s))
    health = _health_before(packs, pack, flight, content, options)
    later = [_health_before(packs, pack, part, content, options) for part in of_discharges(flight)[1:]]
    estimator = estimator_for(flight, content, options, settings, health)
    run = list(steps(flight, estimator, later))
    size = size_of_replayed(estimator, flight)
    if packs is not None:
        _remember(packs, pack, flight, content, options)
    return Replay(flight, size, tuple(run), outcome(run, size.cutoff_V, reserve_soc))


def _minutes(seconds: float) -> str:
    return output.clock(seconds, "unbounded" if math.isinf(seconds) else "not known")


def _health_before(
    packs: str | Path | None, pack: str, flight: Flight, content: BatteryFile, options: PackOptions
) -> PackHealth | None:
    """Return the health of the flight's pack by its earlier flights in the ledger.

    Raises AnotherSize if the flight could not be saved there after its replay.
    """
    if packs is None:
        return None
    name = name_of(flight, pack)
    with Ledger(packs) as ledger:
        health = health_before(ledger, name, flight, content)
        check_cells(ledger, name, content, options, flight, health)
    return health


def _remember(packs: str | Path, pack: str, flight: Flight, content: BatteryFile, options: PackOptions) -> None:
    """Save the records of the log's flights in the ledger, if their packs have names, one after the other."""
    for part in of_discharges(flight):
        if name := name_of(part, pack):
            with Ledger(packs) as ledger:
                health = health_before(ledger, name, part, content)
                found = flight_for_ledger(content, options, part, health, time.time()).record
                if found is not None:
                    ledger.save(name, found)


def _battery_content(battery: str | Path | BatteryFile, allow_uncertified: bool) -> BatteryFile:
    """Return the content of a battery file that is named, or as it is given."""
    if isinstance(battery, BatteryFile):
        return battery
    check_path("battery", battery, "the name or path of a battery file, or its content")
    return battery_file.read_battery(battery, allow_uncertified=allow_uncertified)


def _vehicle_content(vehicle: str | Path | VehicleFile | None) -> VehicleFile | None:
    """Return the content of a vehicle file that is named, or as it is given."""
    if isinstance(vehicle, VehicleFile | None):
        return vehicle
    check_path("vehicle", vehicle, "the path of a vehicle file, its content, or None")
    return vehicle_file.read_vehicle(vehicle)


def _period_s(flight: Flight, stated_s: object) -> float:
    """Return the time between forecasts [s]: as stated, else a recording's own, else the usual one."""
    if stated_s is None:
        return recorded_period_s(flight)
    if isinstance(stated_s, int | float) and stated_s >= 0.0:
        return float(stated_s)
    raise UsageError(f"forecast_period_s={stated_s!r}: expected 0 s or more")


def _flight(log: str | Path | Flight, instance: int | None) -> Flight:
    """Return the flight, read from its log if it is given by path."""
    if not isinstance(log, Flight):
        check_path("log", log, "the path of a flight log, or a Flight")
        return read_log(log, instance)
    if instance is not None and instance != log.instance:
        raise UsageError(f"instance={instance}: the flight was read with battery {log.instance}; give the log's path")
    return log
