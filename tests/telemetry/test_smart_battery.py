"""A smart battery states its own size: logs that hold no parameter of it are sized by that."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from frames import battery_row, frame, hover, smart, write_log
from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.battery import battery_file
from uavbatt.battery.sizing.log_statements import size_from_rows
from uavbatt.battery.sizing.pack_size import PackOptions, PackSize
from uavbatt.errors import BadInput
from uavbatt.records import Flight
from uavbatt.telemetry import read_log


def parameter(name: bytes, value: float, time_s: float) -> tuple[float, bytes]:
    return time_s, frame(dialect.MAVLink_param_value_message(name, value, 9, 1, 0), time_s)


def sized(flight: Flight) -> PackSize:
    battery = battery_file.read_battery("lipo-generic")
    return size_from_rows(battery, PackOptions(), flight, flight.facts_at(math.inf))


def test_a_telemetry_log_without_parameters_is_sized_by_the_battery(tmp_path: Path) -> None:
    rows = [*hover(40, 16.5, 12.0), smart(5200, 4, 9.5)]
    flight = read_log(write_log(tmp_path / "a.tlog", rows))
    found = sized(flight)
    assert (found.cells, found.cells_from, found.capacity_Ah, found.capacity_from) == (4, "vehicle", 5.2, "vehicle")
    assert flight.identity.battery_serial == "A7"
    assert math.isnan(flight.facts_at(9.0).capacity_Ah)  # not before it was said
    assert flight.facts_at(10.0).capacity_Ah == 5.2


def test_a_parameter_counts_before_the_battery_unless_it_is_the_default(tmp_path: Path) -> None:
    rows = [*hover(40, 16.5, 12.0), smart(5200, 4, 3.0)]
    own = read_log(write_log(tmp_path / "a.tlog", [*rows, parameter(b"BATT_CAPACITY", 4000.0, 6.0)]))
    assert sized(own).capacity_Ah == 4.0
    assert any("the battery itself states 5200 mAh" in note for note in own.notes)
    untouched = read_log(write_log(tmp_path / "b.tlog", [*rows, parameter(b"BATT_CAPACITY", 3300.0, 6.0)]))
    assert sized(untouched).capacity_Ah == 5.2
    assert untouched.notes == ()


def test_a_change_in_flight_counts_when_it_is_said_twice(tmp_path: Path) -> None:
    rows = [*hover(40, 16.5, 12.0), smart(5200, 4, 3.0), smart(52_000, 4, 20.5)]
    assert sized(read_log(write_log(tmp_path / "once.tlog", rows))).capacity_Ah == 5.2


def test_each_battery_has_its_own_size(tmp_path: Path) -> None:
    rows = [*hover(40, 16.5, 12.0), *((t + 0.1, battery_row(t + 0.1, 24.0, 3.0, 1)) for t in range(40))]
    path = write_log(tmp_path / "a.tlog", [*rows, smart(5200, 4, 3.0), smart(1500, 6, 3.0, b"B1", 1)])
    first, second = read_log(path, instance=0), read_log(path, instance=1)
    assert (sized(first).cells, sized(first).capacity_Ah) == (4, 5.2)
    assert (sized(second).cells, sized(second).capacity_Ah) == (6, 1.5)


# --- PX4 -----------------------------------------------------------------------------------------------------------

STATUS = (
    "uint64_t timestamp;float voltage_v;float current_a;"
    "uint16_t capacity;uint16_t cycle_count;uint8_t cell_count;uint8_t id;"
)


def message(kind: bytes, content: bytes) -> bytes:
    return struct.pack("<HB", len(content), kind[0]) + content


def ulog(status: str, rows: Sequence[bytes], info: Sequence[bytes] = ()) -> bytes:
    """A PX4 log of one battery: `status` are the fields of battery_status; `info` rows of battery_info."""
    head = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + message(b"B", bytes(40))
    made = head + message(b"F", f"battery_status:{status}".encode())
    made += message(b"F", b"battery_info:uint64_t timestamp;uint8_t id;char[32] serial_number;")
    made += message(b"A", struct.pack("<BH", 0, 1) + b"battery_status")
    made += message(b"A", struct.pack("<BH", 0, 2) + b"battery_info")
    made += b"".join(message(b"D", struct.pack("<H", 2) + row) for row in info)
    return made + b"".join(message(b"D", struct.pack("<H", 1) + row) for row in rows)


def status_row(k: int, *more: Any, layout: str = "") -> bytes:
    return struct.pack("<QffHHBB" + layout, 200_000 * k, 24.6 - 0.001 * k, 20.0, 16_000, 41, 6, 1, *more)


def read_ulog(tmp_path: Path, data: bytes) -> Flight:
    pytest.importorskip("pyulog")
    path = tmp_path / "a.ulg"
    path.write_bytes(data)
    return read_log(path)


def test_a_px4_log_of_a_smart_battery(tmp_path: Path) -> None:
    """PX4 1.16 and later: the serial is a text in battery_info."""
    own, other = struct.pack("<QB32s", 0, 1, b"TB-0042"), struct.pack("<QB32s", 0, 2, b"other")
    found = read_ulog(tmp_path, ulog(STATUS, [status_row(k) for k in range(100)], [own]))
    assert (found.identity.battery_serial, found.identity.battery_cycles) == ("TB-0042", 41)
    assert (sized(found).cells, sized(found).capacity_Ah) == (6, 16.0)
    of_another = read_ulog(tmp_path, ulog(STATUS, [status_row(k) for k in range(100)], [other]))
    assert of_another.identity.battery_serial == ""


@pytest.mark.parametrize("name", [b"battery_status", b"battery_info"])
def test_a_px4_log_whose_definition_of_a_message_lost_its_time_is_damaged(name: bytes, tmp_path: Path) -> None:
    """One wrong letter: pyulog reads up to the first such message, and leaves its columns without a time."""
    sound = ulog(STATUS, [status_row(k) for k in range(100)], [struct.pack("<QB32s", 0, 1, b"TB-0042")])
    assert len(read_ulog(tmp_path, sound).samples) == 100
    with pytest.raises(BadInput, match="expected battery messages with a voltage, found none"):
        read_ulog(tmp_path, sound.replace(name + b":uint64_t timestamp", name + b":uint64_t timestxmp"))


def test_the_health_in_a_px4_log(tmp_path: Path) -> None:
    """PX4 tells it in per cent of the capacity; 0 is not known."""
    for health, capacity_Ah in ((84, 13.44), (0, 16.0), (100, 16.0), (65535, 16.0)):
        rows = [status_row(k, health, layout="H") for k in range(100)]
        found = read_ulog(tmp_path, ulog(STATUS + "uint16_t state_of_health;", rows))
        assert sized(found).capacity_Ah == pytest.approx(capacity_Ah)


def test_serials_of_older_px4_logs(tmp_path: Path) -> None:
    number = [status_row(k, 4711, layout="H") for k in range(100)]
    found = read_ulog(tmp_path, ulog(STATUS + "uint16_t serial_number;", number))
    assert found.identity.battery_serial == "4711"
    unknown = [status_row(k, 65535, layout="H") for k in range(100)]
    assert read_ulog(tmp_path, ulog(STATUS + "uint16_t serial_number;", unknown)).identity.battery_serial == ""
    text = [status_row(k, b"SN 9", layout="32s") for k in range(100)]
    assert read_ulog(tmp_path, ulog(STATUS + "char[32] serial_number;", text)).identity.battery_serial == "SN 9"
