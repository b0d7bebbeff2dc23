"""The flights of `wrong_packs.py`: packs that are not what is stated, drawn once and for all by fixed seeds.

A generic battery meets any make at 0.4 to 2.5 times its ohms; a fitted one meets packs of the make that it was fitted
to, healthy ones and worn ones, at 0.85 to 1.9 times the make's. A mixed one was fitted to packs of every age, a landed
one to the same flights if their crews land with a fifth to a third of the charge. A gauged one is a generic battery of
a smart pack, whose gauge says what it holds today.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from scoring.other_pack import (
    CELLS,
    CUTOFF_V,
    FULL_AH,
    LIPO,
    MAKES,
    ORDINARY,
    PRIOR_OHMAH,
    Flown,
    Make,
    Pack,
    Power,
    Sensors,
    Turns,
    flight,
)
from uavbatt.battery.battery_file import BatteryFile
from uavbatt.fitting.battery import RecordedPack, fit_battery

GENERIC, FITTED, MIXED, LANDED, GAUGED = "generic", "fitted", "mixed", "landed", "gauged"
FLEETS = (MIXED, LANDED)
GAUGE_SD = 0.05  # of what a gauge says, relative
GUSTY = Power()
CAPACITIES = (("65..80 %", 0.65, 0.80), ("80..92 %", 0.80, 0.92), ("92..105 %", 0.92, 1.05))
CHARGES = (("full", 0.97, 1.0), ("part", 0.60, 0.93))
GAINS = (("current reads 0.5..0.8", 0.5, 0.8), ("current reads 1.1..1.3", 1.1, 1.3))
# Motors that run by turns, and the level powers of such aircraft [W].
BY_TURNS = (
    ("glider", Turns(1.0, (15.0, 45.0), 0.05, (30.0, 85.0)), (450.0, 900.0)),
    ("VTOL", Turns(4.0, (15.0, 35.0), 1.0, (60.0, 240.0)), (80.0, 140.0)),
    ("hops", Turns(1.0, (50.0, 180.0), 0.03, (15.0, 70.0)), (220.0, 400.0)),
    ("racer", Turns(1.7, (1.0, 5.0), 0.6, (2.0, 8.0)), (450.0, 900.0)),
)
GENERIC_OHMS, FITTED_OHMS = (0.4, 2.5), (0.85, 1.9)
ISSUE_AH = (5.0, 4.5, 4.0, 3.5)
# Healthy packs that a battery is fitted to: capacity / stated, ohms / make's, air [°C], level power [W], climbs.
HEALTHY = (
    (1.00, 1.00, 22.0, 260.0, 0.3),
    (0.99, 1.04, 28.0, 330.0, 0.0),
    (1.01, 0.96, 15.0, 400.0, 0.2),
    (0.98, 1.05, 25.0, 220.0, 0.3),
    (1.00, 1.00, 30.0, 300.0, 0.3),
)
# Packs of one to fifty flights and more, as a crew's logs hold them: less capacity comes with more ohms.
MIXED_AGES = (
    (1.00, 1.00, 22.0, 260.0, 0.3),
    (0.97, 1.20, 28.0, 330.0, 0.0),
    (1.01, 0.96, 15.0, 400.0, 0.2),
    (0.93, 1.35, 25.0, 220.0, 0.3),
    (0.90, 1.50, 30.0, 300.0, 0.3),
    (1.00, 1.05, 18.0, 280.0, 0.1),
    (0.88, 1.60, 24.0, 350.0, 0.2),
    (0.95, 1.10, 20.0, 240.0, 0.3),
    (0.99, 0.90, 26.0, 310.0, 0.1),
    (0.92, 1.40, 21.0, 290.0, 0.2),
)
FLOWN_BY = {FITTED: HEALTHY, MIXED: MIXED_AGES, LANDED: MIXED_AGES}
LANDS_AT = (0.33, 0.21, 0.26, 0.3, 0.23)  # charge at which these crews land, one after the other


@dataclass(frozen=True, slots=True)
class Case:
    """A Case is one flight: what the pack is, of a stated 5 Ah, and how it is flown and read."""

    name: str
    battery: str
    capacity_class: str
    charge_class: str
    make: Make = LIPO
    capacity_Ah: float = FULL_AH
    start_soc: float = 1.0
    resistance: float = 1.0  # against the make's
    air_C: float = 25.0
    power: Power = GUSTY
    sensors: Sensors = ORDINARY
    seed: int = 3
    cutoff_V: float = CUTOFF_V
    full_share: float = 1.0  # of the stated capacity, what the pack itself says that it holds

    @property
    def group(self) -> tuple[str, str, str]:
        """Return the row of the table that the flight belongs to."""
        return (self.battery, self.capacity_class, self.charge_class)

    def flown(self) -> Flown:
        """Return the flight, to its end."""
        pack = Pack(self.capacity_Ah, self.start_soc, FULL_AH, self.resistance, self.make, CELLS, self.air_C)
        return flight(pack, self.power, self.sensors, seed=self.seed, cutoff_V=self.cutoff_V)

    @property
    def words(self) -> str:
        """Return in words what is flown, for whoever reruns it."""
        ohms = self.resistance * self.make.ohmAh / PRIOR_OHMAH
        return (
            f"{self.make.name}, {self.capacity_Ah:.2f} of {FULL_AH:g} Ah, charged to {self.start_soc:.0%}, ohms "
            f"{ohms:.2f} of the prior, {self.resistance:.2f} of the make, {self.power.level_W:.0f} W with climbs of "
            f"{self.power.climb:.0%}, {self.air_C:.0f} °C, current gain {self.sensors.current_gain:.2f}"
        )


def every(each: int) -> list[Case]:
    """Return the cases of the issue, and so many flights of every group."""
    return issue() + sampled(each) + by_turns(each)


def issue() -> list[Case]:
    """Return the cases of the issue's table: nothing else is wrong than the capacity."""
    return [
        Case(f"issue-{ah:.1f}Ah-{battery}", battery, "issue", "full", capacity_Ah=ah)
        for battery in (GENERIC, FITTED)
        for ah in ISSUE_AH
    ]


def sampled(each: int) -> list[Case]:
    """Return so many flights of every group."""
    spans = [(c, charge, (1.0, 1.0)) for c in CAPACITIES for charge in CHARGES]
    spans += [((name, 0.85, 1.0), CHARGES[0], (low, high)) for name, low, high in GAINS]
    return [
        _drawn(battery, capacity, charge, gain, number)
        for battery in (GENERIC, FITTED)
        for capacity, charge, gain in spans
        for number in range(each)
    ]


def metered(each: int, battery: str) -> list[Case]:
    """Return the flights of `sampled` for a battery whose current sensor reads right."""
    return [case for case in sampled(each) if case.battery == battery and case.sensors.current_gain == 1.0]


def by_turns(each: int) -> list[Case]:
    """Return so many flights of every kind of motor that runs by turns; their packs are those of `sampled`."""
    found = []
    for battery in (GENERIC, FITTED):
        for name, turns, (low_W, high_W) in BY_TURNS:
            for number in range(each):
                case = _drawn(battery, (name, 0.75, 1.05), CHARGES[0], (1.0, 1.0), number)
                share = (case.power.level_W - 200.0) / 180.0  # of the levels of `_drawn`
                power = Power(low_W + share * (high_W - low_W), gust=0.05, turns=turns)
                found.append(replace(case, power=power))
    return found


def of_fleet(each: int, battery: str) -> list[Case]:
    """Return the flights of `sampled` with a true current for a battery of FLEETS."""
    return [replace(case, name=case.name.replace(FITTED, battery), battery=battery) for case in metered(each, FITTED)]


def gauged(each: int) -> list[Case]:
    """Return the worn packs of `sampled` with a true current, generic, that say themselves what they hold."""
    dice = np.random.default_rng(31)
    return [
        replace(
            case,
            name=case.name.replace(GENERIC, GAUGED),
            battery=GAUGED,
            full_share=min(case.capacity_Ah / FULL_AH * math.exp(float(dice.normal(0.0, GAUGE_SD))), 1.0),
        )
        for case in metered(each, GENERIC)
        if case.capacity_class != CAPACITIES[-1][0]
    ]


def _drawn(
    battery: str,
    capacity: tuple[str, float, float],
    charge: tuple[str, float, float],
    gain: tuple[float, float],
    number: int,
) -> Case:
    name = f"{battery}-{capacity[0]}-{charge[0]}-{number}".replace(" ", "").replace("%", "").replace("..", "to")
    dice = np.random.default_rng(list(name.encode()))
    make = MAKES[number % len(MAKES)]
    low, high = (k * PRIOR_OHMAH / make.ohmAh for k in GENERIC_OHMS) if battery == GENERIC else FITTED_OHMS
    return Case(
        name,
        battery,
        *(capacity[0], charge[0]),
        make,
        capacity_Ah=FULL_AH * float(dice.uniform(*capacity[1:])),
        start_soc=float(dice.uniform(*charge[1:])),
        resistance=math.exp(float(dice.uniform(math.log(low), math.log(high)))),
        air_C=float(dice.uniform(10.0, 32.0)),
        power=Power(float(dice.uniform(200.0, 380.0)), gust=0.05, climb=float(dice.choice([0.0, 0.15, 0.3]))),
        sensors=Sensors(0.01, 0.15, 0.01, 0.05, current_gain=float(dice.uniform(*gain))),
        seed=int(dice.integers(1, 10_000)),
    )


def fitted(make: Make, battery: str) -> BatteryFile:
    """Fit a battery to flights of a make's packs, to the cut-off or, for LANDED, until their crews landed."""
    flights = [
        flight(Pack(FULL_AH * share, 1.0, FULL_AH, ohms, make, CELLS, air_C), Power(level_W, climb=climb), seed=100 + k)
        for k, (share, ohms, air_C, level_W, climb) in enumerate(FLOWN_BY[battery])
    ]
    if battery == LANDED:
        flights = [flown.until(LANDS_AT[k % len(LANDS_AT)]) for k, flown in enumerate(flights)]
    logs = [flown.flight(f"{make.name} {k}") for k, flown in enumerate(flights)]
    return fit_battery(RecordedPack(f"{make.name}, {battery}", CELLS, FULL_AH, CUTOFF_V), [], logs).file
