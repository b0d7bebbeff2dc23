"""The voltage of a pack when the voltages of some of its cells are missing."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from cases import first_quick
from daemon_bench import Bench

from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.live.config import RecordSection
from uavbatt.mavlink.fields import BatteryFields
from uavbatt.records import Sample
from uavbatt.simulate.tlog_writer import battery_status, heartbeat, sys_status
from uavbatt.telemetry import read_log
from uavbatt.telemetry.cleaning.pack_voltage import PackVoltages


def told(cells: tuple[float, ...]) -> BatteryFields:
    kept = tuple(volts for volts in cells if volts > 0.0)
    return BatteryFields(0, sum(kept), 10.0, cell_voltages_V=kept if len(kept) > 1 else ())


def after(
    *rows: tuple[float, ...], pack_V: float = math.nan, is_armed: bool = True, step_s: float = 0.2
) -> tuple[float, list[str]]:
    """The voltage after the last row, SYS_STATUS before each, and the notes."""
    voltages, found = PackVoltages(), math.nan
    for k, cells in enumerate(rows):
        voltages.hear(pack_V, k * step_s)
        found = voltages.of(told(cells), k * step_s, is_armed, True).voltage_V
    return found, voltages.notes


WHOLE, BROKEN = (3.8,) * 6, (3.8, 3.8, 0.0, 3.8, 3.8, 3.8)


def test_a_cell_that_is_lost_is_taken_from_sys_status_or_from_the_others() -> None:
    assert after(WHOLE, BROKEN, pack_V=22.7) == (
        22.7,
        ["battery 0: the voltages of 1 of 6 cells are missing or wrong: the pack's is taken from SYS_STATUS"],
    )
    volts, (note,) = after(WHOLE, BROKEN)
    assert volts == pytest.approx(22.8) and note.endswith("taken from the others")
    assert after(WHOLE, BROKEN, WHOLE) == (pytest.approx(22.8), [])
    assert after((3.8, 3.8), (3.8, 0.0))[0] == pytest.approx(7.6)


def test_a_cell_that_reads_nonsense_is_seen_by_the_difference() -> None:
    nonsense = (3.8, 3.8, 0.2, 3.8, 3.8, 3.8)
    assert after(WHOLE, nonsense, pack_V=22.8)[0] == 22.8
    assert after(WHOLE, *[nonsense] * 3)[0] == pytest.approx(19.2)  # nothing says otherwise
    sagged = (3.2,) * 6
    assert after(WHOLE, *[sagged] * 2, pack_V=22.4)[0] == pytest.approx(19.2)  # the load may have come since
    assert after(WHOLE, *[sagged] * 3, pack_V=22.4)[0] == 22.4


def test_cells_that_a_sender_has_no_room_for_are_counted_from_the_start() -> None:
    assert after((4.2,) * 10, pack_V=50.4)[0] == 50.4
    voltages = PackVoltages()
    voltages.hear(50.4, 0.0)
    volts = [voltages.of(told((4.2,) * 10), time_s, True, True).voltage_V for time_s in (0.0, 9.0)]
    assert volts == pytest.approx([50.4, 50.4])
    assert after((4.2,) * 10, pack_V=42.1)[0] == pytest.approx(42.0)
    assert after(WHOLE, pack_V=26.6)[0] == pytest.approx(22.8)  # a sensor that was never right


def test_another_pack_may_have_fewer_cells() -> None:
    assert after(WHOLE, BROKEN, is_armed=False, step_s=10.0)[0] == pytest.approx(19.0)


@pytest.mark.parametrize("has_sys_status", [True, False])
@pytest.mark.parametrize("reads_V", first_quick(1, [0.2, 0.0]))
def test_a_log_is_read_as_it_was_heard(tmp_path: Path, reads_V: float, has_sys_status: bool) -> None:
    bench = fly(has_sys_status, reads_V, record=RecordSection(folder=str(tmp_path), when="always"))
    bench.daemon.close()
    (path,) = tmp_path.glob("*.tlog")
    flown = [json.loads(line)["voltage_V"] for line in next(tmp_path.glob("*.jsonl")).read_text().splitlines()]
    assert [round(sample.voltage_V, 3) for sample in read_log(path).samples] == pytest.approx(flown, abs=0.0011)


@pytest.mark.parametrize("has_sys_status", [True, False])
def test_a_broken_sense_wire_is_no_end_of_flight(has_sys_status: bool) -> None:
    bench = fly(has_sys_status)
    shown = bench.daemon.board.reports[0]
    assert shown.remaining.remaining_s > 600.0
    assert shown.estimate.voltage_V == pytest.approx(6.0 * (4.0 - 0.1 * 12.0 * 299 / 5.0 / 3600.0), abs=0.02)
    assert any("1 of 6 cells" in note for note in bench.daemon.board.notes)
    assert not [m for m in bench.to_gcs() if m.get_type() == "STATUSTEXT"]


def fly(has_sys_status: bool, reads_V: float = 0.0, **sections: Any) -> Bench:
    """A minute at 12 A; after 40 s the third of six cells reads `reads_V`."""
    bench = Bench(PackOptions(capacity_Ah=5.0, cells=6), **sections)
    for k in range(300):
        if k % 5 == 0:
            bench.send(heartbeat(True))
        drawn_Ah = 12.0 * k / 5.0 / 3600.0
        cell_V = 4.0 - 0.1 * drawn_Ah
        cells_V = tuple(reads_V if k > 200 and n == 2 else cell_V for n in range(6))
        sample = Sample(0.0, 6.0 * cell_V, 12.0, 25.0, drawn_Ah, armed=True, cell_voltages_V=cells_V)
        bench.send(battery_status(sample, 0))
        if has_sys_status:
            bench.send(sys_status(sample))
        bench.daemon.turn()
        bench.now_s += 0.2
    return bench
