"""A log that goes on after a reboot of the autopilot: with another pack, or in the air with the same."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
from factories import generic_estimator
from frames import battery_row, write_log
from scoring.other_pack import Pack, flown, rested
from scoring.scenarios import STATED

from uavbatt.records import Sample
from uavbatt.simulate.dataflash_writer import write_dataflash
from uavbatt.telemetry import read_log


def logged(path: Path, *boots: list[Sample]) -> tuple[Sample, ...]:
    """The rows of a DataFlash log whose clock and whose counter of the charge start anew with each boot."""
    data = b""
    for rows in boots:
        write_dataflash(path, [replace(row, time_s=row.time_s - rows[0].time_s) for row in rows], {})
        data += path.read_bytes()
    path.write_bytes(data)
    return read_log(path).samples


@pytest.mark.parametrize("soc", [0.5, 0.35])
def test_a_flight_after_a_reboot_has_another_pack(tmp_path: Path, soc: float) -> None:
    """It is under load from its first row. It was taken for the pack before: the lower end was minutes too long."""
    first = [*rested(Pack(), 15, 0.0), *flown(Pack(), 15.0, 100)]
    second = flown(Pack(soc=soc), 0.0)
    rows = logged(tmp_path / "two.BIN", first, second)
    said = list(generic_estimator(STATED, 3.0).run(rows))
    told, begin_s, end_s = said[len(first) - 1][0], rows[len(first)].time_s, rows[-1].time_s
    back = [(e, r) for e, r in said if e.time_s >= begin_s + 3.0]
    assert back[0][0].capacity_scale_sd > told.capacity_scale_sd + 0.02
    assert max(r.remaining_lo_s - (end_s - r.time_s) for _, r in back if math.isfinite(r.remaining_lo_s)) < 25.0


def test_a_reboot_in_the_air_changes_no_pack(tmp_path: Path) -> None:
    pack = Pack()
    first = [*rested(pack, 15, 0.0), *flown(pack, 15.0, 200)]
    flown(pack, 0.0, 4)  # the autopilot is away for 4 s
    rows = logged(tmp_path / "one.BIN", first, flown(pack, 0.0, 100))
    said = [e for e, _ in generic_estimator(STATED).run(rows)]
    told, after = said[len(first) - 1], said[len(first) :]
    assert len(after) == 100
    assert all(e.capacity_scale_sd < told.capacity_scale_sd + 0.02 for e in after)
    assert after[0].soc == pytest.approx(told.soc, abs=0.02)


def test_a_clock_of_the_ground_that_is_set_back_is_no_silence(tmp_path: Path) -> None:
    times_s = [*range(10), *(k - 3600 for k in range(10, 20))]
    frames = b"".join(battery_row(float(k), 16.0, 12.0) for k in times_s)
    rows = read_log(write_log(tmp_path / "f.tlog", [(0.0, frames)])).samples
    assert [b.time_s - a.time_s for a, b in pairwise(rows)] == [1.0] * 19
