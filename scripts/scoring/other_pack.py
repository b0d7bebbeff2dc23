"""Packs of a model that is not ours, flown by a power: the readings as a vehicle sends them, and the truth beside them.

Two wells of charge per cell (Manwell and McGowan's kinetic model, 1993), so that no resistor and capacitor of ours can
be its copy; the voltage is that of the surface well, and what the bulk has not handed over at the end is left in it:

    h1' = -(i - k (h2 - h1)) / share     h2' = -k (h2 - h1) / (1 - share)     soc = share h1 + (1 - share) h2
    V   = OCV(h1) - I R(h1, T) - lag     R = R0 (1 + rise exp(-h1 / 0.08)) exp(0.012 (25 - T))
    C T' = I² R - h (T - T_air)

i is the current as a share of the capacity each second, h a filling of 0..1. A worn pack holds less of the same size:
its ohms go by `size_Ah`, its own growth by `resistance`. Ohms per cell and Ah, volts per cell, heat per cell and Ah.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from uavbatt.nan_equal import nan_equal
from uavbatt.records import NAN, Flight, Sample

CELLS, CUTOFF_V, FULL_AH, POWER_W, AIR_C = 4, 13.2, 5.0, 300.0, 25.0
PRIOR_OHMAH = 0.028  # at once, of the packaged generic battery: what `resistance` of the makes is told against
SOC = (-0.05, 0.0, 0.01, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 1.0)
RISE_SOC, PER_K = 0.08, 0.012
HEAT_JPKAH, COOLING_WPKAH = 42.0, 0.13
IDLE_W, ROW_S, END_MEAN_S = 5.0, 1.0, 5


@dataclass(frozen=True, slots=True)
class Make:
    """A Make describes one make of cells; its resistances are in ohms times Ah."""

    name: str
    ocv_V: tuple[float, ...]  # at SOC
    ohmAh: float = 0.016
    rise: float = 0.6  # of the ohms toward empty
    lag_ohmAh: float = 0.004
    lag_s: float = 18.0
    share: float = 0.75  # of the charge that is at the surface
    exchange_s: float = 45.0  # until the wells are level, to 1/e


LIPO = Make(
    "LiPo",
    (2.4, 3.0, 3.28, 3.48, 3.60, 3.675, 3.70, 3.72, 3.755, 3.785, 3.825, 3.88, 3.945, 4.02, 4.10, 4.145, 4.195),
)
LIHV = Make(
    "LiHV",
    (2.45, 3.05, 3.30, 3.50, 3.62, 3.68, 3.71, 3.735, 3.775, 3.815, 3.87, 3.94, 4.02, 4.11, 4.22, 4.28, 4.345),
    ohmAh=0.022, rise=0.9, lag_ohmAh=0.007, lag_s=30.0, share=0.65, exchange_s=60.0,
)  # fmt: skip
FLAT = Make(
    "flat LiPo",
    (2.6, 3.20, 3.40, 3.56, 3.66, 3.71, 3.735, 3.75, 3.775, 3.79, 3.805, 3.85, 3.92, 4.01, 4.12, 4.16, 4.20),
    ohmAh=0.012, rise=0.4, lag_ohmAh=0.003, lag_s=10.0, share=0.8, exchange_s=35.0,
)  # fmt: skip
MAKES = (LIPO, LIHV, FLAT)


@dataclass
class Pack:
    """A Pack knows what it holds now; `step` draws from it."""

    capacity_Ah: float = FULL_AH
    soc: float = 1.0
    size_Ah: float = FULL_AH  # what it held when it was new: small packs have more ohms, worn ones have not
    resistance: float = 1.0  # against the make's
    make: Make = LIPO
    cells: int = CELLS
    air_C: float = AIR_C
    lag_V: float = field(default=0.0, init=False)
    surface_less: float = field(default=0.0, init=False)  # h2 - h1
    temp_C: float = field(init=False)

    def __post_init__(self) -> None:
        self.temp_C = self.air_C

    def step(self, power_W: float, dt_s: float = ROW_S) -> tuple[float, float]:
        """Return the pack voltage [V] and current [A] of the next `dt_s` [s] under a power, and update what is left."""
        make = self.make
        surface = self.soc - (1.0 - make.share) * self.surface_less
        scale = self.resistance * math.exp(PER_K * (AIR_C - self.temp_C)) / self.size_Ah
        ohm = make.ohmAh * scale * (1.0 + make.rise * math.exp(-max(surface, 0.0) / RISE_SOC))
        open_V = self.cells * (float(np.interp(surface, SOC, make.ocv_V)) - self.lag_V)
        root = math.sqrt(max(open_V**2 - 4.0 * self.cells * ohm * power_W, 0.0))
        amps = (open_V - root) / (2.0 * self.cells * ohm)
        drawn = amps * dt_s / 3600.0 / self.capacity_Ah
        self.soc -= drawn
        share = math.exp(-dt_s / make.exchange_s)
        self.surface_less = share * self.surface_less + (1.0 - share) * drawn / dt_s * make.exchange_s / make.share
        share = math.exp(-dt_s / make.lag_s)
        self.lag_V = share * self.lag_V + (1.0 - share) * amps * make.lag_ohmAh * scale
        warming_W = amps**2 * (ohm + make.lag_ohmAh * scale) - COOLING_WPKAH * self.size_Ah * (self.temp_C - self.air_C)
        self.temp_C += warming_W * dt_s / (HEAT_JPKAH * self.size_Ah)
        return open_V - self.cells * ohm * amps, amps


@dataclass(frozen=True, slots=True)
class Turns:
    """Turns says how a motor runs by turns: `high` times the level power for some seconds, then `low` times."""

    high: float
    high_s: tuple[float, float]  # shortest and longest
    low: float
    low_s: tuple[float, float]

    def phase(self, dice: np.random.Generator, before: float) -> tuple[float, float]:
        """Return the next turn's power against the level, and how long it lasts [s]."""
        if before == self.high:
            return self.low, float(dice.uniform(*self.low_s))
        return self.high, float(dice.uniform(*self.high_s))


@dataclass(frozen=True, slots=True)
class Power:
    """Power says what a flight asks: a level power with gusts and, where it manoeuvres, climbs and descents."""

    level_W: float = POWER_W
    gust: float = 0.04  # sd of ln power
    gust_s: float = 3.0
    climb: float = 0.0  # a climb asks so much more than level flight; a descent asks half of that less
    turns: Turns | None = None  # instead of climbs

    def rows_W(self, seed: int) -> Iterator[float]:
        """Yield the power of each second [W], without end."""
        dice, gust, share = np.random.default_rng(seed), 0.0, math.exp(-ROW_S / self.gust_s)
        factor, left_s = 1.0, 20.0
        while True:
            if self.turns is not None and left_s <= 0.0:
                factor, left_s = self.turns.phase(dice, factor)
            elif self.climb > 0.0 and left_s <= 0.0:
                factor, left_s = self._phase(dice, factor)
            left_s -= ROW_S
            gust = share * gust + math.sqrt(1.0 - share**2) * float(dice.standard_normal())
            yield self.level_W * factor * math.exp(self.gust * gust)

    def _phase(self, dice: np.random.Generator, before: float) -> tuple[float, float]:
        """Return the next phase's power against level flight, and how long it lasts [s]."""
        if before != 1.0:
            return 1.0, float(dice.uniform(40.0, 120.0))
        is_climb = dice.random() < 0.5
        return (1.0 + self.climb, 20.0) if is_climb else (1.0 - 0.5 * self.climb, 25.0)


@nan_equal
@dataclass(frozen=True, slots=True)
class Sensors:
    """Sensors says how the vehicle reads: noise and last digits, and what is wrong with it from some time on."""

    voltage_sd_V: float = 0.0
    current_sd_A: float = 0.0
    voltage_digit_V: float = 0.0
    current_digit_A: float = 0.0
    current_gain: float = 1.0
    voltage_stuck_s: float = math.inf
    current_stuck_s: float = math.inf
    stuck_A: float = NAN  # NaN: what it read last


ORDINARY = Sensors(voltage_sd_V=0.01, current_sd_A=0.15, voltage_digit_V=0.01, current_digit_A=0.05)


@dataclass(frozen=True, slots=True)
class Flown:
    """Flown holds the rows as the vehicle sends them, and of each row the true charge, voltage [V] and current [A]."""

    rows: tuple[Sample, ...]
    soc: tuple[float, ...]
    voltage_V: tuple[float, ...]
    current_A: tuple[float, ...]

    @property
    def start_s(self) -> float:
        """Return the time of take-off [s]."""
        return next(row.time_s for row in self.rows if row.armed)

    @property
    def end_s(self) -> float:
        """Return the end of flight [s]: the last row, of a flight flown to its end."""
        return self.rows[-1].time_s

    def until(self, soc: float) -> Flown:
        """Return the flight until its charge is below `soc`: the crew lands."""
        rows = next((k for k, left in enumerate(self.soc) if left < soc), len(self.rows))
        return Flown(self.rows[:rows], self.soc[:rows], self.voltage_V[:rows], self.current_A[:rows])

    def flight(self, name: str = "another pack") -> Flight:
        """Return the rows as a log."""
        return Flight(name, "csv", self.rows, duration_s=self.end_s - self.rows[0].time_s)


def rested(pack: Pack, seconds: int, from_s: float, drawn_Ah: float = 0.0) -> list[Sample]:
    """Return rows on the ground, the electronics on."""
    return list(drawn(pack, [IDLE_W] * seconds, from_s, drawn_Ah, armed=False).rows)


def flown(pack: Pack, from_s: float, seconds: int = 3600, drawn_Ah: float = 0.0, seed: int = 3) -> list[Sample]:
    """Return rows in the air until the end of flight or for so long, as an exact sensor reads it."""
    powers = (watts for _, watts in zip(range(seconds), Power().rows_W(seed), strict=False))
    return list(drawn(pack, powers, from_s, drawn_Ah).rows)


def drawn(
    pack: Pack,
    powers_W: Iterable[float],
    from_s: float,
    drawn_Ah: float = 0.0,
    *,
    armed: bool = True,
    cutoff_V: float = CUTOFF_V,
) -> Flown:
    """Draw one power after the other from the pack; armed, stop once a mean of 5 s is below the cut-off."""
    rows, soc, volts, currents = [], [], [], []
    for k, power_W in enumerate(powers_W):
        temp_C = pack.temp_C
        true_V, amps = pack.step(power_W)
        drawn_Ah += amps / 3600.0
        rows.append(Sample(from_s + k, true_V, amps, round(temp_C, 1), drawn_Ah, armed=armed))
        soc.append(pack.soc)
        volts.append(true_V)
        currents.append(amps)
        if armed and k + 1 >= END_MEAN_S and sum(volts[-END_MEAN_S:]) / END_MEAN_S < cutoff_V:
            break
    return Flown(tuple(rows), tuple(soc), tuple(volts), tuple(currents))


def flight(
    pack: Pack,
    power: Power,
    sensors: Sensors = ORDINARY,
    *,
    seed: int = 0,
    ground_s: int = 15,
    seconds: int = 3600,
    cutoff_V: float = CUTOFF_V,
) -> Flown:
    """Return a flight on the ground, then in the air to the end, as the sensors read it."""
    ground = drawn(pack, [IDLE_W] * ground_s, 0.0, armed=False)
    powers = (watts for _, watts in zip(range(seconds), power.rows_W(seed), strict=False))
    air = drawn(pack, powers, float(ground_s), ground.rows[-1].consumed_Ah, cutoff_V=cutoff_V)
    both = Flown(
        ground.rows + air.rows,
        ground.soc + air.soc,
        ground.voltage_V + air.voltage_V,
        ground.current_A + air.current_A,
    )
    return replace(both, rows=tuple(read(both.rows, sensors, seed)))


def read(rows: Iterable[Sample], sensors: Sensors, seed: int = 0) -> list[Sample]:
    """Return exact rows as the sensors show them; charge is counted from the shown currents, as an autopilot does."""
    dice, made, drawn_Ah = np.random.default_rng(seed + 10_000), [], 0.0
    volts, amps = NAN, NAN
    for row in rows:
        noise = dice.standard_normal(2)
        if row.time_s < sensors.voltage_stuck_s:
            volts = _digits(row.voltage_V + sensors.voltage_sd_V * float(noise[0]), sensors.voltage_digit_V)
        if row.time_s < sensors.current_stuck_s:
            seen_A = sensors.current_gain * row.current_A + sensors.current_sd_A * float(noise[1])
            amps = max(_digits(seen_A, sensors.current_digit_A), 0.0)
        elif math.isfinite(sensors.stuck_A):
            amps = sensors.stuck_A
        drawn_Ah += amps / 3600.0
        made.append(replace(row, voltage_V=volts, current_A=amps, consumed_Ah=drawn_Ah))
    return made


def _digits(value: float, digit: float) -> float:
    return digit * round(value / digit) if digit > 0.0 else value
