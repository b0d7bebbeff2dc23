"""The cells of a pack that sends the voltage of each: their number is the pack's, whatever a full pack would show.

Part-charged packs of 7, 9 and 14 cells have the voltages of full packs of 6, 8 and 12 or 13.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from command import called
from daemon_bench import Bench
from frames import frame
from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt import Estimator
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.limits import told_cells
from uavbatt.records import NAN, Sample

NONE_MV = 65535
CELL_MV = 3740


def status(cells_mV: list[int]) -> Any:
    """Return a BATTERY_STATUS with the voltages of cells [mV], those beyond ten in the extended field."""
    first, more = cells_mV[:10], cells_mV[10:]
    return dialect.MAVLink_battery_status_message(
        0, 0, 0, 2500, first + [NONE_MV] * (10 - len(first)), 20, -1, -1, -1, voltages_ext=more + [0] * (4 - len(more))
    )


def beat() -> Any:
    return dialect.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3)


@pytest.mark.parametrize("cells", [2, 4, 7, 9, 12, 14])
def test_live_counts_the_cells_that_are_told(cells: int) -> None:
    bench = Bench(PackOptions(capacity_Ah=5.0))
    for _ in range(3):
        bench.send(beat())
        bench.send(status([CELL_MV] * cells))
        bench.daemon.turn()
        bench.now_s += 1.0
    report = bench.daemon.board.reports[0]
    assert report.cells == cells
    assert not any("cells" in words for words in report.estimate.warnings)


@pytest.mark.parametrize("cells", [7, 14])
def test_a_log_is_flown_with_the_cells_that_are_told(cells: int, tmp_path: Path) -> None:
    log = tmp_path / "f.tlog"
    log.write_bytes(b"".join(frame(beat(), k) + frame(status([CELL_MV] * cells), k) for k in range(5)))
    assert called("replay", "f.tlog", "--capacity-ah", "5", "--json", "s.json", folder=tmp_path).returncode == 0
    summary = json.loads((tmp_path / "s.json").read_text(encoding="utf-8"))
    assert (summary["cells"], summary["cells_from"]) == (cells, "cell voltages")
    assert summary["cutoff_V"] == pytest.approx(3.3 * cells)


def test_what_is_stated_goes_before_what_is_told() -> None:
    estimator = Estimator.from_battery("lipo-generic", cells=4, capacity_Ah=5.0)
    estimator.step(Sample(0.0, 15.0, 0.2, 25.0, cell_voltages_V=(3.75,) * 4))
    assert estimator.pack_size is not None and estimator.pack_size.cells_from == "cells"


def test_another_pack_is_counted_anew() -> None:
    """A pack of six cells, and after a rest on the ground one of seven."""
    estimator = Estimator.from_battery("lipo-generic", capacity_Ah=5.0)
    for time_s, cells in ((0.0, 6), (1.0, 6), (600.0, 7), (601.0, 7)):
        volts = (3.9,) * cells
        estimator.step(Sample(time_s, sum(volts), 0.2, 25.0, armed=False, cell_voltages_V=volts))
    assert estimator.pack_size is not None and estimator.pack_size.cells == 7


@pytest.mark.parametrize(
    ("cells_V", "pack_V"),
    [
        ((), 15.0),
        ((15.0,), 15.0),  # a pack, no cell
        ((3.75,) * 10, 37.5),  # every field of a sender that may have no more
        ((3.75, 3.75, 3.75, 0.4), 11.65),  # a broken wire
        ((3.75,) * 4, 22.5),  # a part of the pack
        ((3.75,) * 4, NAN),
    ],
)
def test_cells_that_are_not_all_told_are_not_counted(cells_V: tuple[float, ...], pack_V: float) -> None:
    assert told_cells(cells_V, pack_V) == 0
