"""A battery file from flights of packs that are alike, and of packs of every age: the flights tell which they are."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scoring.other_pack import LIPO, SOC, Pack, Power, flight

from uavbatt.fitting import observed, solve
from uavbatt.fitting.battery import RecordedPack, fit_battery
from uavbatt.records import Flight

SIZE = RecordedPack("mine", 4, 5.0, 13.2)
# What the packs hold of 5 Ah, and their ohms against those of a new one.
NEARLY_NEW = ((1.0, 1.0), (0.99, 1.03), (1.01, 0.97), (1.0, 1.02), (0.99, 0.99), (1.0, 1.0))
EVERY_AGE = ((1.0, 1.0), (0.80, 1.9), (0.97, 1.1), (0.85, 1.6), (0.92, 1.3), (0.76, 2.1))
POWERS_W = (260.0, 330.0, 400.0, 220.0, 300.0, 280.0)


@cache
def logs(packs: tuple[tuple[float, float], ...]) -> list[Flight]:
    """One flight of each pack to its cut-off, of a simulator that is not our model."""
    return [
        flight(Pack(5.0 * share, resistance=ohms), Power(watts, climb=0.2), seed=50 + k).flight(f"log {k}")
        for k, ((share, ohms), watts) in enumerate(zip(packs, POWERS_W, strict=True))
    ]


def evidence(packs: tuple[tuple[float, float], ...], own_prior: solve.OwnPrior) -> float:
    stack = observed.stack([observed.from_flight(f, SIZE.cells, SIZE.capacity_Ah) for f in logs(packs)])
    return solve.fit_cell(stack, own_prior=own_prior, evaluations=60).log_evidence


def test_the_flights_tell_packs_that_are_alike_from_packs_of_every_age() -> None:
    assert evidence(NEARLY_NEW, solve.ALIKE) > evidence(NEARLY_NEW, solve.IN_SERVICE)
    assert evidence(EVERY_AGE, solve.IN_SERVICE) > evidence(EVERY_AGE, solve.ALIKE)


@pytest.mark.parametrize(
    "packs", [EVERY_AGE, pytest.param(NEARLY_NEW, marks=pytest.mark.slow)], ids=["every age", "nearly new"]
)
def test_the_curve_of_the_type_is_not_bent(packs: tuple[tuple[float, float], ...]) -> None:
    """Worn packs among packs that are said to be alike would bend the open-circuit voltage by 34 mV."""
    table = fit_battery(SIZE, [], logs(packs)).file.parameters
    between = np.array([0.15, 0.3, 0.5, 0.7])
    error_V = np.interp(between, table.ocv_soc, table.ocv_V) - np.interp(between, SOC, LIPO.ocv_V)
    assert np.max(np.abs(error_V)) < 0.03
    assert np.ptp(error_V) < 0.015


def test_how_much_the_packs_differ_is_said() -> None:
    assert "packs of the flights differ by" in fit_battery(SIZE, [], logs(EVERY_AGE)).known[-1]
