"""The plan of a mission as text: nothing of it is left out without a word."""

from __future__ import annotations

import json
from pathlib import Path

from command import called
from route_rig import planned, to

from uavbatt.cli.plan_mission import MOST_LEGS, _lines


def test_a_long_mission_says_how_many_of_its_legs_are_not_shown() -> None:
    """The items went from 20 to 45 in the next line, as if the mission had no others."""
    found = planned(*(to(k, 20.0 * (k % 2), 10.0 * k, 40.0) for k in range(1, 61)))
    lines = _lines(found, "long.waypoints")
    left_out = [line for line in lines if " more, in --json and --report" in line]
    assert len(left_out) == 1
    assert int(left_out[0].split()[1]) == len(found.legs) - MOST_LEGS


def test_the_plan_says_in_which_wind_and_how_fast_it_flies() -> None:
    lines = _lines(planned(to(1, 0.0, 300.0, 40.0)), "short.waypoints")
    assert "  wind       none stated: still air" in lines
    assert "  speeds     route 5 m/s, way home 8 m/s, climb 2.5 m/s, descent 1.5 m/s" in lines


def test_a_mission_is_planned_for_an_aircraft_of_which_only_the_hover_is_known(tmp_path: Path) -> None:
    home, up, there = "16 0 0 0 0 47.0 8.0 400 1", "22 0 0 0 0 0 0 40 1", "16 0 0 0 0 47.009 8.0 40 1"
    lines = ("QGC WPL 110", f"0 1 0 {home}", f"1 0 3 {up}", f"2 0 3 {there}", "3 0 3 20 0 0 0 0 0 0 0 1")
    mission = tmp_path / "there.waypoints"
    mission.write_text("\n".join(lines))
    left = []
    for power_W in ("180", "250"):
        pack = ("--cells", "4", "--capacity-ah", "5", "--power-w", power_W)
        done = called("plan", "--mission", mission, *pack, "--json", "told.json", folder=tmp_path)
        assert done.returncode == 0, done.stderr
        assert f"only the hover of {power_W} W is stated" in done.stdout
        left.append(json.loads((tmp_path / "told.json").read_text())["planned"]["soc"])
    assert left[0] > left[1] + 0.05
