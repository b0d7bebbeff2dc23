"""The way back along the own track: without loops and detours, as long as the track otherwise, and unknown if it is."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import pytest
from route_rig import HOME, SETTINGS

from uavbatt.estimator import Estimator
from uavbatt.navigation import METRES_PER_DEGREE, Mode, Navigation, Position
from uavbatt.prediction.route.ahead import Ahead, home_now, why_no_home
from uavbatt.prediction.route.legs import Point
from uavbatt.prediction.route.progress import Progress
from uavbatt.prediction.route.track import way_back
from uavbatt.records import Route, Sample

SPEED_MS = 5.0
UP = (0.0, 0.0, 40.0)
Place = tuple[float, float, float]


def position(time_s: float, place: Place, before: Place) -> Position:
    """Where an aircraft is, a second after it was at the place before."""
    north_m, east_m, height_m = place
    moved_m = [now - then for now, then in zip(place, before, strict=True)]
    lon_deg = HOME.lon_deg + east_m / METRES_PER_DEGREE / math.cos(math.radians(HOME.lat_deg))
    return Position(time_s, HOME.lat_deg + north_m / METRES_PER_DEGREE, lon_deg, height_m, *moved_m)


def along(*corners: Place) -> list[Place]:
    """The places of each second on straight lines through the corners."""
    places = [corners[0]]
    for end in corners[1:]:
        begin, seconds = places[-1], max(round(math.dist(places[-1], end) / SPEED_MS), 1)
        places += [
            (
                begin[0] + (end[0] - begin[0]) * k / seconds,
                begin[1] + (end[1] - begin[1]) * k / seconds,
                begin[2] + (end[2] - begin[2]) * k / seconds,
            )
            for k in range(1, seconds + 1)
        ]
    return places


class Flight:
    """A flight by hand, one place a second."""

    def __init__(self) -> None:
        self.progress, self.time_s, self.place = Progress(), 0.0, (0.0, 0.0, 0.0)
        self.heard: dict[float, Navigation] = {}
        self.now = Navigation(mode=Mode.MANUAL, home=HOME, settings=SETTINGS)

    def flies(self, *corners: Place, mode: Mode = Mode.MANUAL) -> Flight:
        for place in along(*corners):
            self.time_s += 1.0
            self.now = replace(self.now, mode=mode, position=position(self.time_s, place, self.place))
            self.place = place
            self.heard[self.time_s] = self.now
            self.progress = self.progress.after(self.time_s, self.now)
        return self

    @property
    def why_not(self) -> str:
        return why_no_home(self.progress, self.now, self.time_s)

    @property
    def said(self) -> Route:
        """What is said at the last row of this flight under 180 W."""
        estimator = Estimator.from_battery("lipo-generic", cells=4, capacity_Ah=5.0, cutoff_V=13.2)
        samples = [Sample(time_s, 15.0, 12.0, temp_C=25.0) for time_s in self.heard]
        (*_, (_, remaining)) = estimator.run(samples, self.heard.__getitem__)
        assert remaining.route is not None
        return remaining.route

    @property
    def home_m(self) -> float:
        """The horizontal length of the way home; a return in progress begins at once."""
        way = home_now(self.progress, self.now, self.time_s)
        assert isinstance(way, Ahead), way
        places = [way.begin, *way.points(way.pieces.ends_s)]
        return sum(math.dist(a[:2], b[:2]) for a, b in pairwise(places))


def test_the_way_back_is_the_track_and_not_the_line_home() -> None:
    corner, end = (300.0, 0.0, 40.0), (300.0, 400.0, 40.0)
    flight = Flight().flies((0.0, 0.0, 0.0), UP, corner, end)
    assert flight.flies(end, mode=Mode.RETURN).home_m == pytest.approx(500.0, abs=2.0)
    assert flight.flies(end, mode=Mode.RETURN_BY_TRACK).home_m == pytest.approx(700.0, abs=5.0)


def test_time_and_charge_at_home_are_those_of_the_track() -> None:
    """Both were unknown, or those of the straight line: here a third of the way."""
    far = (600.0, 0.0, 40.0), (600.0, 600.0, 40.0), (0.0, 600.0, 40.0)
    by_track, straight = (
        Flight().flies((0.0, 0.0, 0.0), UP, *far).flies(*far[-1:] * 10, mode=mode).said
        for mode in (Mode.RETURN_BY_TRACK, Mode.RETURN)
    )
    assert by_track.load == straight.load == "route"
    assert by_track.left_s - straight.left_s == pytest.approx(1800.0 / SPEED_MS - 600.0 / SETTINGS.return_ms, abs=60.0)
    assert by_track.home_soc == pytest.approx(by_track.soc, abs=0.02)
    assert by_track.home_soc < straight.home_soc - 0.1


def test_it_gets_shorter_as_it_is_flown() -> None:
    corner, end = (300.0, 0.0, 40.0), (300.0, 400.0, 40.0)
    flight = Flight().flies((0.0, 0.0, 0.0), UP, corner, end)
    flight.flies(end, (300.0, 100.0, 40.0), mode=Mode.RETURN_BY_TRACK)
    assert flight.home_m == pytest.approx(400.0, abs=5.0)
    flight.flies((302.0, 100.0, 41.0), (303.0, -1.0, 41.0), (150.0, 1.0, 40.0), mode=Mode.RETURN_BY_TRACK)
    assert flight.home_m == pytest.approx(150.0, abs=5.0)


def test_loops_and_ways_out_and_back_are_left_out() -> None:
    square = ((300.0, 0.0, 40.0), (300.0, 200.0, 40.0), (100.0, 200.0, 40.0), (100.0, -100.0, 40.0))
    flight = Flight().flies((0.0, 0.0, 0.0), UP, *square)  # crosses its own way out 100 m north of home
    assert flight.flies(square[-1], mode=Mode.RETURN_BY_TRACK).home_m == pytest.approx(200.0, abs=8.0)
    spur = ((200.0, 0.0, 40.0), (200.0, 500.0, 40.0), (200.0, 0.0, 40.0), (400.0, 0.0, 40.0))
    flight = Flight().flies((0.0, 0.0, 0.0), UP, *spur)
    assert flight.flies(spur[-1], mode=Mode.RETURN_BY_TRACK).home_m == pytest.approx(400.0, abs=8.0)


def test_a_crossing_at_another_height_is_no_loop() -> None:
    high = ((300.0, 0.0, 40.0), (300.0, 200.0, 80.0), (100.0, 200.0, 80.0), (100.0, -100.0, 80.0))
    flight = Flight().flies((0.0, 0.0, 0.0), UP, *high)
    assert flight.flies(high[-1], mode=Mode.RETURN_BY_TRACK).home_m == pytest.approx(1000.0, abs=10.0)


def test_it_lands_from_two_metres_above_its_beginning() -> None:
    flight = (
        Flight().flies((0.0, 0.0, 0.0), UP, (100.0, 0.0, 40.0)).flies((100.0, 0.0, 40.0), mode=Mode.RETURN_BY_TRACK)
    )
    way = home_now(flight.progress, flight.now, flight.time_s)
    assert isinstance(way, Ahead)
    planned_s = 100.0 / SPEED_MS + 38.0 / 1.5 + 2.0 / 0.5
    assert way.touchdown_s == pytest.approx(planned_s, abs=8.0)
    assert way.pieces.length_s[way.pieces.landing].sum() == pytest.approx(2.0 / 0.5, rel=0.1)


def test_a_curve_is_flown_through_and_takes_no_longer_than_a_straight_line() -> None:
    """Each corner of the track was a stop: the way back along a curve was told a third too long."""
    radius_m = 60.0
    curve = [
        (radius_m * math.sin(0.1 * k), radius_m * (1.0 - math.cos(0.1 * k)), 40.0) for k in range(32)
    ]  # half a circle
    line = [(6.0 * k, 0.0, 40.0) for k in range(32)]
    curved, straight = (
        home_now(flight.progress, flight.now, flight.time_s)
        for flight in (
            Flight().flies((0.0, 0.0, 0.0), UP, *way).flies(way[-1], mode=Mode.RETURN_BY_TRACK) for way in (curve, line)
        )
    )
    assert isinstance(curved, Ahead) and isinstance(straight, Ahead)
    assert curved.touchdown_s == pytest.approx(straight.touchdown_s, abs=3.0)


def test_a_flight_that_went_on_after_a_return_goes_back_from_where_it_left_it() -> None:
    far, near = (300.0, 0.0, 40.0), (100.0, 0.0, 40.0)
    flight = Flight().flies((0.0, 0.0, 0.0), UP, far).flies(far, near, mode=Mode.RETURN_BY_TRACK)
    flight.flies(near, (100.0, 150.0, 40.0)).flies((100.0, 150.0, 40.0), mode=Mode.RETURN_BY_TRACK)
    assert flight.home_m == pytest.approx(250.0, abs=8.0)


def test_a_track_whose_beginning_was_not_seen_is_not_known() -> None:
    end = (300.0, 400.0, 40.0)
    began_in_the_air = Flight().flies((300.0, 0.0, 40.0), end).flies(end, mode=Mode.RETURN_BY_TRACK)
    assert "own track" in began_in_the_air.why_not
    has_gap = Flight().flies((0.0, 0.0, 0.0), UP, (300.0, 0.0, 40.0))
    has_gap.time_s += 30.0
    assert "own track" in has_gap.flies((300.0, 300.0, 40.0), end).flies(end, mode=Mode.RETURN_BY_TRACK).why_not


@pytest.mark.parametrize(("north_m", "is_known"), [(12.0, True), (18.0, False)])
def test_a_track_that_begins_away_from_home_does_not_lead_home(north_m: float, is_known: bool) -> None:
    end = (300.0, 0.0, 40.0)
    flight = Flight().flies((north_m, 0.0, 0.0), (north_m, 0.0, 40.0), end).flies(end, mode=Mode.RETURN_BY_TRACK)
    assert (flight.why_not == "") is is_known


@pytest.mark.parametrize(("moved_m", "is_known"), [(15.0, True), (25.0, False)])
def test_a_silence_ends_the_track_if_the_aircraft_moved_far(moved_m: float, is_known: bool) -> None:
    far, end = (300.0, 0.0, 40.0), (300.0, 200.0, 40.0)
    flight = Flight().flies((0.0, 0.0, 0.0), UP, far)
    flight.time_s += 30.0
    flight.flies((300.0, moved_m, 40.0), end).flies(end, mode=Mode.RETURN_BY_TRACK)
    assert (flight.why_not == "") is is_known


def test_a_jump_of_the_position_ends_the_track() -> None:
    """Ten million places would be laid on a line from here to the other side of the Earth."""
    flight = Flight().flies((0.0, 0.0, 0.0), UP)
    flight.flies((5e6, 0.0, 40.0)).flies((300.0, 0.0, 40.0), (400.0, 0.0, 40.0))
    assert "own track" in flight.flies((400.0, 0.0, 40.0), mode=Mode.RETURN_BY_TRACK).why_not


def test_a_long_return_may_be_left_far_from_where_it_began() -> None:
    far, near = (3000.0, 0.0, 40.0), (100.0, 0.0, 40.0)
    flight = Flight().flies((0.0, 0.0, 0.0), UP, far).flies(far, near, mode=Mode.RETURN_BY_TRACK)
    flight.flies(near, (100.0, 50.0, 40.0)).flies((100.0, 50.0, 40.0), mode=Mode.RETURN_BY_TRACK)
    assert flight.home_m == pytest.approx(150.0, abs=8.0)


def test_a_silence_during_the_return_keeps_the_track() -> None:
    far, near = (300.0, 0.0, 40.0), (100.0, 0.0, 40.0)
    flight = Flight().flies((0.0, 0.0, 0.0), UP, far).flies(far, mode=Mode.RETURN_BY_TRACK)
    flight.time_s += 30.0
    assert flight.flies(near, mode=Mode.RETURN_BY_TRACK).home_m == pytest.approx(100.0, abs=3.0)


def test_the_legs_join_from_the_aircraft_to_its_start_and_a_climb_begins_another_one() -> None:
    corners = ((0.0, 100.0, 40.0), (0.0, 200.0, 60.0), (0.0, 300.0, 80.0), (0.0, 400.0, 80.0))
    flight = Flight().flies((0.0, 0.0, 0.0), UP, *corners)
    found = way_back(flight.progress.track.places)
    assert found is not None
    legs = found.legs(Point(*corners[-1]), SETTINGS)
    ends = [[round(v) for v in legs[0].begin], *([round(v) for v in leg.end] for leg in legs)]
    assert ends == [[0, 400, 80], [0, 300, 80], [0, 100, 40], [0, 0, 40], [0, 0, 2], [0, 0, 0]]
    assert [round(leg.run_m) for leg in legs] == [100, 200, 100, 0, 0]
    assert all(first.end == second.begin for first, second in pairwise(legs))


def test_a_flight_after_a_landing_begins_a_new_track() -> None:
    far, end = (0.0, 900.0, 40.0), (200.0, 0.0, 40.0)
    flight = Flight().flies((0.0, 0.0, 0.0), UP, far, UP, (0.0, 0.0, 0.0), UP, end)
    assert len(flight.progress.track.places) < 60
    assert flight.flies(end, mode=Mode.RETURN_BY_TRACK).home_m == pytest.approx(200.0, abs=5.0)


def test_a_long_track_is_kept_by_its_corners_and_one_with_too_many_is_given_up() -> None:
    lanes: list[Place] = [UP]
    for k in range(30):
        lanes += [(20.0, 10.0 * k, 40.0), (520.0, 10.0 * k, 40.0), (520.0, 10.0 * k + 5.0, 40.0)]
        lanes += [(20.0, 10.0 * k + 5.0, 40.0)]
    survey = Flight().flies((0.0, 0.0, 0.0), *lanes)
    assert len(survey.progress.track.places) <= 1000
    length_m = sum(math.dist(a, b) for a, b in pairwise(lanes))
    assert survey.flies(lanes[-1], mode=Mode.RETURN_BY_TRACK).home_m == pytest.approx(length_m, rel=0.01)
    zigzag: list[Place] = [(10.0 * (k % 2), 8.0 * k, 40.0) for k in range(1500)]
    given_up = Flight().flies((0.0, 0.0, 0.0), UP, *zigzag).flies(zigzag[-1], mode=Mode.RETURN_BY_TRACK)
    assert "own track" in given_up.why_not
