"""An aircraft that does not pass the places of a mission flies another one: no route is better than a wrong one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pytest
from route_rig import HOME, SETTINGS, mission, to

from uavbatt.navigation import METRES_PER_DEGREE, Mission, Mode, Navigation, Position
from uavbatt.prediction.route.ahead import Ahead, ahead
from uavbatt.prediction.route.progress import Progress

LEG_M = 400.0
ITEMS = range(1, 9)
TRUE = mission(*(to(k, LEG_M * k, 0.0, 30.0) for k in ITEMS))


def elsewhere(east_m: float, items: range = ITEMS) -> Mission:
    """The same line, with some of its items so far to the east."""
    return mission(*(to(k, LEG_M * k, east_m if k in items else 0.0, 30.0) for k in ITEMS))


def flown(
    told: Mission, speed_ms: float = 8.0, every_s: float = 1.0, late_s: float = 0.0, skipped: tuple[int, ...] = ()
) -> Iterator[Ahead | str]:
    """What is said of the way ahead, row by row, to an aircraft on the TRUE line that is told to be on another.

    late_s : the present item is reported so late; skipped : items that the pilot skips on the way to them
    """
    progress, item, since_s = Progress(), 1, 0.0
    for k in range(int(LEG_M * 7.5 / speed_ms / every_s)):
        time_s = k * every_s
        north_m = speed_ms * time_s
        due = 1 + int(speed_ms * max(time_s - late_s, 0.0) / LEG_M)
        due = next(seq for seq in range(due, 10) if seq not in skipped)
        item, since_s = (item, since_s) if due == item else (due, time_s)
        place = Position(time_s, HOME.lat_deg + north_m / METRES_PER_DEGREE, HOME.lon_deg, 30.0, speed_ms, 0.0, 0.0)
        now = Navigation(
            time_s=time_s, mode=Mode.MISSION, mission=told, current=item, current_since_s=since_s,
            current_heard_s=time_s, home=HOME, settings=replace(SETTINGS, cruise_ms=speed_ms), position=place,
        )  # fmt: skip
        progress = progress.after(time_s, now)
        yield ahead(progress, now, time_s)


def refused(said: Iterator[Ahead | str]) -> list[bool]:
    return [isinstance(one, str) and "flies another mission" in one for one in said]


def test_a_wrong_mission_is_refused_after_two_of_its_places() -> None:
    found = refused(flown(elsewhere(300.0)))
    assert found.index(True) == pytest.approx(2 * LEG_M / 8.0, abs=2.0)
    assert all(found[found.index(True) :])


@pytest.mark.parametrize(
    "how",
    [
        {},
        {"speed_ms": 15.0, "every_s": 10.0},
        {"late_s": 8.0},
        {"skipped": (3,)},
    ],
    ids=["as planned", "a place every ten seconds", "reported late", "an item skipped"],
)
def test_the_right_mission_is_not(how: dict[str, object]) -> None:
    assert not any(refused(flown(TRUE, **how)))  # type: ignore[arg-type]


def test_a_mission_that_is_a_little_beside_the_track_is_the_right_one() -> None:
    """The place of the receiver, the map of the planner and the wind move it by metres."""
    assert not any(refused(flown(elsewhere(25.0))))


def test_an_aircraft_that_is_back_on_its_mission_has_its_route_again() -> None:
    found = refused(flown(elsewhere(300.0, range(1, 4))))
    assert any(found) and not any(found[-60:])
