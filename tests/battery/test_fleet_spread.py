"""A file that was fitted to a fleet's flights has measured how far packs in service scatter; others assume it."""

from __future__ import annotations

import msgspec
import pytest

from uavbatt.battery.battery_file import BatteryFile, Certificate
from uavbatt.battery.spreads import SERVICE_RESISTANCE_SD, Spread, spread_of
from uavbatt.fitting.generic import generic_lipo


def spread(flights: int | None, scatter: float, status: str = "fitted") -> Spread:
    generic = generic_lipo()
    table = msgspec.structs.replace(generic.parameters, resistance_scale_sd=scatter, spread_flights=flights)
    file: BatteryFile = msgspec.structs.replace(generic, parameters=table, certificate=Certificate(status=status))
    return spread_of(file)


def test_the_scatter_of_a_fleet_is_taken_as_it_was_measured() -> None:
    assert spread(20, 0.18).resistance_scale_sd == pytest.approx(0.18)
    assert spread(20, 0.18).reaction_sd_V < spread(None, 0.18).reaction_sd_V


@pytest.mark.parametrize(
    ("flights", "scatter", "status"),
    [
        (None, 0.18, "fitted"),
        (3, 0.18, "fitted"),
        (20, 0.06, "fitted"),
        (20, 0.18, "edited"),
        (None, 0.06, "certified"),
    ],
    ids=["bench tests", "few flights", "one pack, often flown", "edited", "certified"],
)
def test_elsewhere_packs_in_service_scatter_beside_it(flights: int | None, scatter: float, status: str) -> None:
    found = spread(flights, scatter, status)
    assert found.resistance_scale_sd > max(SERVICE_RESISTANCE_SD, scatter)
    assert found.reaction_sd_V == spread(None, 0.06).reaction_sd_V
