"""Records that all packages use: frozen values in SI units, with the unit in the name.

Sign convention: positive current discharges the battery. State of charge is 0..1, never percent.
Unknown is NaN (`None` for flags); the package `telemetry` has replaced the sentinels of the wire.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum

from uavbatt.nan_equal import nan_equal
from uavbatt.navigation import NOWHERE, Navigation

NAN = math.nan

# An alarm by the median is late in half of the flights. At 17.5 % it was never late on the measured flights, and a
# minute early at the median; a smaller value is safer and earlier.
ALARM_RISK = 0.175
Z90 = 1.6448536269514722  # half width of the central 90 % interval of a normal distribution, in standard deviations
IN_TIME = 0.05  # a route with a smaller risk to end before its touchdown needs no turn-back


class Status(StrEnum):
    """A status says whether a number may be shown.

    Attributes:
        OK: the number holds.
        CONVERGING: the number is shown, and doubted for the reason that is given.
        REFUSED: there is no number, for the reason that is given.
        STALE: there is no number, because telemetry has been missing for 3 s.
    """

    OK = "ok"
    CONVERGING = "converging"
    REFUSED = "refused"
    STALE = "stale"


@nan_equal
@dataclass(frozen=True, slots=True)
class Sample:
    """Sample holds one telemetry row of one battery; NaN is not measured.

    Attributes:
        time_s: since the first record of the log [s]; live, a monotonic clock.
        voltage_V: of the pack [V].
        current_A: positive discharges [A].
        temp_C: of the pack [°C].
        consumed_Ah: charge drawn by the autopilot's counter [Ah]: at most a starting hint, never a measurement.
        reported_soc: the autopilot's own state of charge, 0 to 1: at most a starting hint.
        armed: motors armed, None where it is not known.
        cell_voltages_V: of each cell [V], where the vehicle tells them.
    """

    time_s: float
    voltage_V: float
    current_A: float = NAN
    temp_C: float = NAN
    consumed_Ah: float = NAN
    reported_soc: float = NAN
    armed: bool | None = None
    cell_voltages_V: tuple[float, ...] = ()


@nan_equal
@dataclass(frozen=True, slots=True)
class PackFacts:
    """PackFacts holds the parameters in which the vehicle states its pack; NaN or None where it states nothing.

    Voltages [V] are of the pack, the capacity is in Ah; sag_compensated: the autopilot adds the sag to its voltage;
    temperature_of_escs: its temperature is that of the motor controllers; full_share: of the capacity, what the battery
    says that it holds today when full; acts_below_soc: of it, what is left when the autopilot returns or lands.
    """

    cells_series: int | None = None
    capacity_Ah: float = NAN
    low_voltage_V: float = NAN
    critical_voltage_V: float = NAN
    sag_compensated: bool | None = None
    temperature_of_escs: bool = False
    full_share: float = 1.0
    acts_below_soc: float = NAN

    @property
    def endings_V(self) -> tuple[float, ...]:
        """Return critical voltage and low-voltage warning [V], by which cells are counted.

        There are none if the cells are stated: the vehicle has worked out these voltages from them.
        """
        return () if self.cells_series is not None else (self.critical_voltage_V, self.low_voltage_V)


@nan_equal
@dataclass(frozen=True, slots=True)
class Identity:
    """Identity holds what a log tells of aircraft, pack and date; empty, None or NaN if it does not tell."""

    system: int | None = None  # MAVLink's number of the vehicle; most are 1
    hardware: str = ""  # serial of the flight controller
    firmware: str = ""
    battery_serial: str = ""
    battery_cycles: int | None = None  # counted by the pack itself
    start_utc_s: float = NAN  # time of the first record [s since 1970]


@nan_equal
@dataclass(frozen=True, slots=True)
class Flight:
    """Flight holds a flight log as it was read: the rows of one battery, and what the vehicle stated meanwhile.

    Attributes:
        source: path or name of the log.
        kind: format of the log.
        samples: the rows, ascending in time.
        instance: number of this battery.
        instances: numbers of all batteries of the log, of which `joined` are read as one pack.
        facts: what the vehicle states of the pack, each with the time [s] from which on it holds, ascending.
        duration_s, skipped_bytes: from the log's first record to its last [s]; what could not be read of it.
        notes: what a reader of the log should know.
        identity: aircraft, pack and date, as far as the log tells them.
        navigation: route and position whenever they change, ascending in time.
        forecast_period_s: between forecasts in the `uavbatt live` that recorded the log [s]; NaN for other logs.
        discharges: when a pack that was changed or charged begins [s], and its serial; not the first of the log.
    """

    source: str
    kind: str  # dataflash-binary, dataflash-text, tlog, ulog, csv, airdata, dji-record, edgetx or blackbox
    samples: tuple[Sample, ...]
    instance: int = 0
    instances: tuple[int, ...] = (0,)
    facts: tuple[tuple[float, PackFacts], ...] = ()
    duration_s: float = NAN
    skipped_bytes: int = 0
    notes: tuple[str, ...] = ()
    identity: Identity = Identity()
    navigation: tuple[Navigation, ...] = ()
    forecast_period_s: float = NAN
    joined: int = 1
    discharges: tuple[tuple[float, str], ...] = ()

    def __iter__(self) -> Iterator[Sample]:
        return iter(self.samples)

    def __repr__(self) -> str:
        """Return one line, without the thousands of rows."""
        number, rows, last_s = self.instance, len(self.samples), self.duration_s
        return f"<Flight {self.source}: {self.kind}, battery {number}, {rows} rows, {last_s:.0f} s>"

    def _repr_html_(self) -> str:
        """Return what a notebook shows: a small table and the voltage over the flight."""
        from uavbatt.small_chart import voltage_table

        battery = f"{self.instance} of {', '.join(map(str, self.instances))}"
        rows, notes = f"{len(self.samples)} in {self.duration_s:.0f} s", "; ".join(self.notes) or "none"
        facts = (("log", self.kind), ("battery", battery), ("rows", rows), ("notes", notes))
        return voltage_table(self.source, facts, [(s.time_s, s.voltage_V) for s in self.samples])

    def facts_at(self, time_s: float) -> PackFacts:
        """Return the facts known at `time_s` [s]; an empty `PackFacts` before the first."""
        count = bisect_right(self.facts, time_s, key=lambda known: known[0])
        return self.facts[count - 1][1] if count else PackFacts()

    @property
    def has_way(self) -> bool:
        """Return True if a mission or a home becomes known in the flight."""
        return any(known.has_way for known in self.navigation)

    def navigation_at(self, time_s: float) -> Navigation:
        """Return the route and place known at `time_s` [s]; `NOWHERE` before the first."""
        count = bisect_right(self.navigation, time_s, key=lambda known: known.time_s)
        return self.navigation[count - 1] if count else NOWHERE


@nan_equal
@dataclass(frozen=True, slots=True)
class Estimate:
    """Estimate holds the filter's belief after one sample; NaN is not known.

    Attributes:
        time_s: of the sample [s].
        soc: state of charge, 0 to 1 of the pack's present capacity.
        soc_sd: its standard deviation.
        voltage_V: of the pack, as measured [V].
        current_A: as measured [A]; NaN without a sensor.
        temp_C: of the pack, as the filter used it [°C].
        power_W: voltage times current [W].
        innovation_V: measured voltage less its prediction, of the pack [V].
        nis: the innovation squared over its variance; 1 is what the filter expects.
        status: may the number be shown.
        reason: why it is not `ok`, in words.
        warnings: what a user of the number must know.
        predicted_voltage_V: of the pack, before the sample was used [V].
        core_temp_C: of the cells' core [°C].
        resistance_scale: this pack's ohm·Ah against its type's.
        capacity_scale: this pack's capacity against what is stated.
        resistance_scale_sd: standard deviation.
        capacity_scale_sd: standard deviation.
        wear: ohms above the type's, relative: what age, cold and bad contacts have in common.
        wear_sd: standard deviation of ln(1 + wear).
    """

    time_s: float
    soc: float
    soc_sd: float
    voltage_V: float
    current_A: float
    temp_C: float
    power_W: float
    innovation_V: float
    nis: float
    status: Status
    reason: str = ""
    warnings: tuple[str, ...] = ()
    predicted_voltage_V: float = NAN
    core_temp_C: float = NAN
    resistance_scale: float = NAN
    capacity_scale: float = NAN
    resistance_scale_sd: float = NAN
    capacity_scale_sd: float = NAN
    wear: float = NAN
    wear_sd: float = NAN


@nan_equal
@dataclass(frozen=True, slots=True)
class Route:
    """Route holds the part of a forecast about the route, the way home and the turn-back.

    Times are seconds from now, charges 0 to 1 at touchdown; lo and hi are the 5 % and 95 % points; NaN is unknown.

    Attributes:
        load: the load to come that was used: `route`, `learned`, `unknown`, `recent`, `log` or `stated`.
        left_s: until touchdown at the route's end.
        soc, soc_lo, soc_hi: charge at that touchdown, median, 5 % and 95 % point.
        risk: probability that the end of flight comes before that touchdown.
        home_soc, home_soc_lo: charge at touchdown if the aircraft turned back now, median and 5 % point.
        turn_back_s: until the latest instant to turn back, median; 0 is now.
        turn_back_lo_s: 5 % point.
        turn_back_hi_s: 95 % point.
        reason: why the route was not used, or why there is no turn-back.
        is_returning: the aircraft flies home or lands already.
        assumed: what the mission does not say and the forecast assumes, in words.
    """

    load: str
    left_s: float = NAN
    soc: float = NAN
    soc_lo: float = NAN
    soc_hi: float = NAN
    risk: float = NAN
    home_soc: float = NAN
    home_soc_lo: float = NAN
    turn_back_s: float = NAN
    turn_back_lo_s: float = NAN
    turn_back_hi_s: float = NAN
    reason: str = ""
    is_returning: bool = False
    assumed: str = ""

    def later(self, age_s: float) -> Route:
        """Return the same as it stands `age_s` [s] later."""
        times_s = {key: getattr(self, key) for key in ("left_s", "turn_back_s", "turn_back_lo_s", "turn_back_hi_s")}
        return replace(self, **{key: max(at_s - age_s, 0.0) for key, at_s in times_s.items() if math.isfinite(at_s)})

    @property
    def must_turn_back_now(self) -> bool:
        """Return True if turning back later may be too late, at a risk of 5 %; False where that is not known."""
        return self.turn_back_lo_s <= 0.0


@nan_equal
@dataclass(frozen=True, slots=True)
class Remaining:
    """Remaining holds the time until the end of flight; NaN with a reason when it is refused.

    Attributes:
        time_s: of the sample [s].
        remaining_s: until the end of flight [s], median.
        remaining_lo_s: 5 % point [s]: 19 of 20 such flights last longer.
        remaining_hi_s: 95 % point [s].
        remaining_to_low_s: until the low-voltage warning [s], median; NaN where nobody states one.
        status: may the number be shown.
        reason: why it is not `ok`, in words.
        remaining_alarm_s: the time left is shorter than this with the probability ALARM_RISK [s]; alarms use it.
        route: the same about route and way home; None where neither a route nor home is known.
    """

    time_s: float
    remaining_s: float
    remaining_lo_s: float
    remaining_hi_s: float
    remaining_to_low_s: float
    status: Status
    reason: str = ""
    remaining_alarm_s: float = NAN
    route: Route | None = None
