"""A simulated PX4: a plan that was made for one is flown and logged as a PX4 does it."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from command import called

from uavbatt.mavlink.fields import AUTOPILOT_PX4, HEARTBEAT
from uavbatt.navigation import Action, Mode
from uavbatt.records import Flight
from uavbatt.telemetry import read_log
from uavbatt.telemetry.formats.tlog_frames import frames
from uavbatt.telemetry.route.messages import WIND, WIND_COV

ARDUPILOT = 3


def item(command: int, jump_id: int, north_deg: float, alt_m: float) -> dict[str, Any]:
    return {
        "type": "SimpleItem",
        "command": command,
        "frame": 3,
        "doJumpId": jump_id,
        "params": [0, 0, 0, None, 47.0 + north_deg, 8.0, alt_m],
    }


PLAN = {
    "fileType": "Plan",
    "mission": {
        "firmwareType": AUTOPILOT_PX4,
        "plannedHomePosition": [47.0, 8.0, 420.0],
        "items": [item(22, 1, 0.0, 20.0), item(16, 2, 0.002, 30.0), item(16, 3, 0.001, 30.0)],
    },
}


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("px4")
    (folder / "route.plan").write_text(json.dumps(PLAN))
    done = called("simulate", "-o", "f.tlog", "--mission", "route.plan", "--wind", "4@0", folder=folder)
    assert done.returncode == 0, done.stderr
    return folder / "f.tlog"


@pytest.fixture(scope="module")
def flight(log: Path) -> Flight:
    return read_log(log)


def test_it_has_px4s_modes_numbers_and_parameters(flight: Flight) -> None:
    last = flight.navigation[-1]
    modes = dict.fromkeys(n.mode for n in flight.navigation)
    assert [m for m in modes if m is not Mode.UNKNOWN] == [Mode.HOLD, Mode.MISSION, Mode.RETURN]
    assert last.settings.is_px4 and last.settings.return_height_m == 60.0
    assert last.mission is not None and not last.mission.has_home_item
    assert [i.action for i in last.mission.items] == [Action.TAKEOFF, Action.WAYPOINT, Action.WAYPOINT]
    assert [i.seq for i in last.mission.items] == [0, 1, 2]
    assert max(n.position.height_m for n in flight.navigation if n.position is not None) == pytest.approx(60.0, abs=3.0)
    assert last.landed is True


def test_its_battery_is_stated_as_a_px4_does(flight: Flight) -> None:
    facts = flight.facts_at(1e9)
    assert facts.cells_series == 4
    assert (facts.capacity_Ah, facts.critical_voltage_V) == pytest.approx((5.0, 13.2), abs=0.01)


def test_its_messages_are_those_of_a_px4(log: Path, flight: Flight) -> None:
    found = frames(log.read_bytes())
    assert len(found.of(WIND_COV).start) > 100 and not len(found.of(WIND).start)
    assert set(found.of(HEARTBEAT).payloads(9)[:, 5].tolist()) == {AUTOPILOT_PX4}
    wind = flight.navigation[-1].wind
    assert wind is not None and wind.north_ms == pytest.approx(-4.0)


def test_it_writes_no_log_of_an_ardupilot(log: Path) -> None:
    done = called("simulate", "-o", "f.BIN", "--mission", "route.plan", folder=log.parent)
    assert done.returncode == 2
    assert "the mission is a PX4's" in done.stderr and done.stderr.count("\n") == 1
    assert not (log.parent / "f.BIN").exists()


@pytest.mark.parametrize("firmware", [ARDUPILOT, AUTOPILOT_PX4])
def test_it_flies_at_the_speed_of_the_plan(firmware: int, tmp_path: Path) -> None:
    mission = {**PLAN["mission"], "firmwareType": firmware, "hoverSpeed": 7.5}
    (tmp_path / "fast.plan").write_text(json.dumps({**PLAN, "mission": mission}))
    done = called("simulate", "-o", "f.tlog", "--mission", "fast.plan", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    told = read_log(tmp_path / "f.tlog").navigation
    assert told[-1].settings.cruise_ms == pytest.approx(7.5)
    fastest_ms = max(math.hypot(n.position.north_ms, n.position.east_ms) for n in told if n.position is not None)
    assert fastest_ms == pytest.approx(7.5, abs=0.1)
