"""Who a pack is: serials and cycle counts of smart batteries, in a log and on the link, and the values for none."""

from __future__ import annotations

import math
import struct

import pytest

from uavbatt.mavlink import fields
from uavbatt.records import Identity
from uavbatt.telemetry import read_log
from uavbatt.telemetry.identity import completed
from uavbatt.telemetry.link.reader import is_sound


def smart_battery_info(serial: bytes, cycles: int = 65535, number: int = 0) -> bytes:
    """A payload as on the wire: trailing zeros trimmed."""
    head = struct.pack("<iiHHHHHBBB", 5000, -1, cycles, 65535, 12000, 13200, 14800, number, 1, 1)
    return (head + serial.ljust(16, b"\0") + b"maker".ljust(50, b"\0")).rstrip(b"\0")


def battery_info(serial: bytes, cycles: int, number: int = 0, capacity_Ah: float = 0.0, cells: int = 0) -> bytes:
    head = struct.pack("<10f2H5B", *[0.0] * 8, capacity_Ah, 0.0, cycles, 0, number, 0, 0, 255, cells)
    return (head + b"\0" * 9 + serial.ljust(32, b"\0")).rstrip(b"\0")


def test_a_smart_battery_says_who_it_is():
    said = fields.pack_identity(fields.SMART_BATTERY_INFO, smart_battery_info(b"UAVB0123456789AB", 41, 2))
    assert said == fields.PackIdentity(2, "UAVB0123456789AB", 41, None, 5.0)


def test_battery_info_is_read_although_no_dialect_holds_it():
    assert len(battery_info(b"", 7)) <= fields.IDENTITY_LENGTH[fields.BATTERY_INFO]
    said = fields.pack_identity(fields.BATTERY_INFO, battery_info(b"SN-7", 7, 1))
    assert said == fields.PackIdentity(1, "SN-7", 7)
    said = fields.pack_identity(fields.BATTERY_INFO, battery_info(b"", 0, 0, 16.0, 12))
    assert said == fields.PackIdentity(0, "", None, 12, 16.0)


@pytest.mark.parametrize("capacity_Ah", [math.nan, math.inf, -1.0])
def test_a_capacity_that_is_no_number_is_not_stated(capacity_Ah):
    assert math.isnan(fields.pack_identity(fields.BATTERY_INFO, battery_info(b"", 0, 0, capacity_Ah)).capacity_Ah)


@pytest.mark.parametrize("none", [b"", b"0", b"-1", b"65535", b"  ", b"\x01\x02"])
def test_values_that_say_that_there_is_no_serial(none):
    said = fields.pack_identity(fields.SMART_BATTERY_INFO, smart_battery_info(none))
    assert (said.serial, said.cycles) == ("", None)


@pytest.mark.parametrize(("stated", "serial"), [(77.0, "77"), (-1.0, ""), (0.0, ""), (65535.0, "")])
def test_the_parameter_that_holds_a_serial(stated, serial):
    assert completed(Identity(), [(0.0, "BATT_SERIAL_NUM", stated)], 0).battery_serial == serial


def test_a_pack_goes_before_the_parameter():
    pack = fields.PackIdentity(0, "A", 3)
    found = completed(Identity(), [(0.0, "BATT_SERIAL_NUM", 77.0)], 0, pack)
    assert (found.battery_serial, found.battery_cycles) == ("A", 3)


def test_the_seeds_are_those_of_the_dialect():
    from pymavlink.dialects.v20 import ardupilotmega

    known = ardupilotmega.mavlink_map[fields.SMART_BATTERY_INFO]
    assert known.crc_extra == fields.IDENTITY_EXTRA[fields.SMART_BATTERY_INFO]
    link = ardupilotmega.MAVLink(None, 1, 1)
    message = ardupilotmega.MAVLink_smart_battery_info_message(
        0, 0, 0, 5000, -1, 3, b"A", b"m", 65535, 0, 0, 0, 0, 4, 0, 0, b""
    )
    frame = message.pack(link)
    end = 10 + frame[1]
    assert is_sound(frame, end, fields.IDENTITY_EXTRA[fields.SMART_BATTERY_INFO])
    assert fields.pack_identity(fields.SMART_BATTERY_INFO, frame[10:end]).serial == "A"


def test_the_serial_of_a_log(shared_data):
    found = read_log(shared_data / "packs/practice/A1/flight_01.tlog").identity
    assert found.battery_serial == "UAVBA1"
