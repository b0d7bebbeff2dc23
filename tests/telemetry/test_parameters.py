"""What ArduPilot's parameters say of a battery: whose monitor sums others, or is that of the motor controllers."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from scoring.other_pack import Pack, flown, rested
from scoring.scenarios import STATED

from uavbatt.battery import battery_file
from uavbatt.estimator import Estimator
from uavbatt.mavlink.fields import PackIdentity
from uavbatt.records import Estimate, PackFacts, Remaining, Sample
from uavbatt.telemetry.parameters import capacity_notes, facts_timeline, statements_of

PARTS = {"BATT_MONITOR": 4.0, "BATT_CAPACITY": 5000.0, "BATT2_MONITOR": 4.0, "BATT2_CAPACITY": 6000.0}


@pytest.mark.parametrize(
    ("more", "capacity_Ah"),
    [
        ({"BATT3_MONITOR": 10.0, "BATT3_CAPACITY": 3300.0, "BATT3_SUM_MASK": 0.0}, 11.0),  # nobody has touched it
        ({"BATT3_MONITOR": 10.0, "BATT3_SUM_MASK": 0.0}, 11.0),
        ({"BATT3_MONITOR": 10.0, "BATT3_SUM_MASK": 2.0}, 6.0),
        ({"BATT3_MONITOR": 10.0, "BATT3_CAPACITY": 3300.0}, math.nan),  # of which parts, nobody has said yet
        ({"BATT3_MONITOR": 10.0, "BATT3_SUM_MASK": math.inf}, math.nan),
        ({"BATT3_MONITOR": 10.0, "BATT3_CAPACITY": 10500.0}, 10.5),  # its own word goes before
        ({"BATT3_MONITOR": 4.0, "BATT3_CAPACITY": 3300.0}, 3.3),  # a pack may hold as much
        ({"BATT3_MONITOR": 10.0, "BATT3_SUM_MASK": 0.0, "BATT4_MONITOR": 4.0}, math.nan),  # a part's is not known
    ],
)
def test_a_sum_of_monitors_holds_what_its_parts_hold(more: dict[str, float], capacity_Ah: float) -> None:
    said = ((0.0, name, value) for name, value in (PARTS | more).items())
    facts = facts_timeline(said, 2, is_telemetry=True)
    assert (facts[-1][1].capacity_Ah if facts else math.nan) == pytest.approx(capacity_Ah, nan_ok=True)


@pytest.mark.parametrize(
    ("vehicle", "capacity_Ah", "notes"),
    [
        ({}, 16.0, ()),
        ({"BATT_CAPACITY": 3300.0}, 16.0, ()),  # the default of ArduPilot
        ({"BATT_CAPACITY": 0.0}, 16.0, ()),
        ({"BATT_CAPACITY": 15500.0}, 15.5, ()),
        (
            {"BATT_CAPACITY": 22000.0},
            22.0,
            ("BATT_CAPACITY is 22000 mAh, and counts; the battery itself states 16000",),
        ),
        ({"BAT1_CAPACITY": -1.0}, 16.0, ()),
        (
            {"BAT1_CAPACITY": 22000.0},
            22.0,
            ("BAT1_CAPACITY is 22000 mAh, and counts; the battery itself states 16000",),
        ),
    ],
)
def test_a_battery_that_states_its_size(vehicle: dict[str, float], capacity_Ah: float, notes: tuple[str, ...]) -> None:
    said = {**vehicle, **dict(statements_of(PackIdentity(0, cells=12, capacity_Ah=16.0)))}
    facts = facts_timeline(((0.0, name, value) for name, value in said.items()), 0, is_telemetry=True)[-1][1]
    assert (facts.cells_series, facts.capacity_Ah) == (12, capacity_Ah)
    found = capacity_notes(said, 0)
    assert len(found) == len(notes)
    assert all(note in words for note, words in zip(notes, found, strict=True))


def test_only_an_ardupilot_has_the_default_of_ardupilot() -> None:
    assert capacity_notes({"BATT_CAPACITY": 3300.0}, 0)[0].startswith(
        "BATT_CAPACITY is 3300 mAh, ArduPilot's untouched"
    )
    assert capacity_notes({"BAT1_CAPACITY": 3300.0}, 0) == []
    assert capacity_notes({}, 0) == []


CHARGES = {"BATT_CAPACITY": 5000.0, "BATT_LOW_MAH": 1500.0, "BATT_CRT_MAH": 750.0}
PX4 = {"BAT1_CAPACITY": 5000.0, "BAT_CRIT_THR": 0.07, "BAT_LOW_THR": 0.15}


@pytest.mark.parametrize(
    ("stated", "share"),
    [
        (CHARGES, math.nan),  # it only warns
        ({**CHARGES, "BATT_FS_LOW_ACT": 2.0}, 0.3),
        ({**CHARGES, "BATT_FS_CRT_ACT": 1.0}, 0.15),
        ({**CHARGES, "BATT_FS_LOW_ACT": 2.0, "BATT_FS_CRT_ACT": 1.0}, 0.3),
        ({**CHARGES, "BATT_LOW_MAH": 0.0, "BATT_FS_LOW_ACT": 2.0}, math.nan),
        ({"BATT_CAPACITY": 5200.0, "FS_BATT_MAH": 520.0, "FS_BATT_ENABLE": 1.0}, 0.1),
        ({"BATT_CAPACITY": 5200.0, "FS_BATT_MAH": 520.0, "FS_BATT_ENABLE": 0.0}, math.nan),
        ({"BATT_LOW_VOLT": 14.0, "BATT_CRT_MAH": 750.0, "BATT_FS_CRT_ACT": 1.0}, math.nan),  # of an unknown capacity
        (PX4, math.nan),
        ({**PX4, "COM_LOW_BAT_ACT": 0.0}, math.nan),
        ({**PX4, "COM_LOW_BAT_ACT": 3.0}, 0.07),
    ],
)
def test_the_charge_at_which_an_autopilot_acts_by_itself(stated: dict[str, float], share: float) -> None:
    facts = facts_timeline(((0.0, name, value) for name, value in stated.items()), 0, is_telemetry=True)[-1][1]
    assert facts.acts_below_soc == pytest.approx(share, nan_ok=True)


def test_the_temperature_of_motor_controllers_is_not_the_packs() -> None:
    """They warm by 40 K in two minutes: a healthy flight was told a third of its time."""
    pack = Pack()
    rows = rested(pack, 20, 0.0)
    rows += flown(pack, 20.0, 300, rows[-1].consumed_Ah)
    warm = [replace(row, temp_C=25.0 + 40.0 * (1.0 - math.exp(-max(row.time_s - 20.0, 0.0) / 120.0))) for row in rows]
    told = facts_timeline(((0.0, "BATT_MONITOR", 9.0),), 0, is_telemetry=True)[-1][1]
    believed, blind = said(warm, told), said([replace(row, temp_C=math.nan) for row in rows], told)
    assert believed[0].soc == pytest.approx(blind[0].soc, abs=1e-9)
    assert believed[1].remaining_s == pytest.approx(blind[1].remaining_s, abs=1e-6)
    assert any("motor controllers" in warning for warning in believed[0].warnings)


def said(rows: list[Sample], facts: PackFacts) -> tuple[Estimate, Remaining]:
    """What is said at the last of some rows."""
    estimator = Estimator(battery_file.read_battery("lipo-generic"), STATED)
    estimator.update_facts(facts)
    return list(estimator.run(rows))[-1]
