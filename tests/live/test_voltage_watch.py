"""Nobody states the capacity: there is no time left, and the crew still hears of the end."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from scoring.live_flight import flown_live
from scoring.scenarios import ARDUPILOT, UNSTATED, part

from uavbatt.battery import battery_file
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.live.voltage_watch import VoltageWatch
from uavbatt.records import PackFacts, Sample

LAND = "Battery 0: voltage nears its cut-off: land"


@pytest.mark.parametrize("said", (0.0, -1.0))
def test_without_a_capacity_the_voltage_still_says_that_the_end_is_near(said: float) -> None:
    """Zero is what ArduPilot, -1 what PX4 has while nobody sets it."""
    rows = part()
    flown = flown_live(rows, UNSTATED, parameters={**ARDUPILOT, "BATT_CAPACITY": said})
    left_s = [rows[-1].time_s - text.time_s for text in flown.texts if text.text == LAND]
    assert left_s and 30.0 < max(left_s) < 200.0
    assert {row.status for row in flown.rows if row.status} == {"refused"}


def test_who_lands_in_time_is_not_told_to_land() -> None:
    rows = part()
    watch = VoltageWatch(battery_file.read_battery("lipo-generic"), UNSTATED)
    assert not any(watch.step(row, PackFacts(4)) for row in rows if row.time_s < rows[-1].time_s - 240.0)


def test_cells_that_cannot_be_leave_no_cut_off_to_fall_to() -> None:
    watch = VoltageWatch(battery_file.read_battery("lipo-generic"), PackOptions(cells=12))
    assert not any(watch.step(Sample(float(k), 16.0 - 0.1 * k, 20.0, armed=True), PackFacts()) for k in range(60))


def told_s(watch: VoltageWatch, rows: list[Sample], facts_at: Callable[[float], PackFacts]) -> float:
    """When the watch says first that the end is near [s]."""
    return next(row.time_s for row in rows if watch.step(row, facts_at(row.time_s)))


def test_a_cut_off_that_is_told_in_flight_counts_from_then_on() -> None:
    rows, low, high = part(), PackFacts(4, critical_voltage_V=12.8), PackFacts(4, critical_voltage_V=13.6)
    battery, late_s = battery_file.read_battery("lipo-generic"), rows[0].time_s + 60.0
    told = [
        told_s(VoltageWatch(battery, UNSTATED), rows, facts_at)
        for facts_at in (lambda t: high, lambda t: high if t > late_s else low, lambda t: low)
    ]
    assert told[0] == told[1] < told[2]


def test_a_first_row_on_usb_power_hides_no_end() -> None:
    """With four cells stated, 5 V are refused until the pack is there."""
    rows = part()
    watch = VoltageWatch(battery_file.read_battery("lipo-generic"), PackOptions(cells=4))
    assert not watch.step(Sample(rows[0].time_s - 1.0, 5.0, 0.1, armed=False), PackFacts())
    assert 30.0 < rows[-1].time_s - told_s(watch, rows, lambda t: PackFacts()) < 200.0
