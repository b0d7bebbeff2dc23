"""The plan of a mission as text: nothing of it is left out without a word."""

from __future__ import annotations

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
