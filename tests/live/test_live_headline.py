"""Several batteries: which of them speaks for the vehicle, and that one which gives nothing is said."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
from daemon_bench import Bench
from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.live.carriers import Carriers
from uavbatt.live.feeds.announced import Announcer
from uavbatt.live.feeds.named import NamedFeed
from uavbatt.live.feeds.web import content
from uavbatt.live.headline import Headline
from uavbatt.live.report import Report
from uavbatt.mavlink.outgoing import Outgoing
from uavbatt.prediction.forecaster import NOT_FLYING, ForecastSettings
from uavbatt.records import NAN, Estimate, Remaining, Sample, Status
from uavbatt.simulate.tlog_writer import battery_status, heartbeat


def report(instance: int, left_s: float, amps: float = 12.0, at_s: float = 0.0, flying_s: float = 0.0) -> Report:
    estimate = Estimate(at_s, 0.5, 0.01, 15.0, amps, 25.0, 180.0, 0.0, 1.0, Status.OK, "")
    remaining = Remaining(at_s, left_s, left_s, left_s, NAN, Status.OK, "", left_s)
    return Report(instance, 1, 1, estimate, remaining, at_s, flying_since_s=flying_s)


def numbers(headline: Headline, now_s: float, *reports: Report) -> list[int]:
    return [r.instance for r in headline.in_order({r.instance: r for r in reports}, now_s)]


def test_fresh_goes_before_stale_and_the_least_time_first() -> None:
    assert numbers(Headline(), 5.0, report(0, 400.0), report(1, 500.0, at_s=4.0)) == [1, 0]
    assert numbers(Headline(), 0.0, report(0, 400.0), report(1, 300.0)) == [1, 0]
    assert numbers(Headline(), 0.0, report(0, NAN), report(1, 300.0)) == [1, 0]
    assert numbers(Headline(), 0.0, report(0, 100.0, NAN), report(1, 300.0)) == [1, 0]


def test_on_the_ground_the_number_decides() -> None:
    assert numbers(Headline(), 0.0, report(1, NAN, 0.5, flying_s=NAN), report(0, NAN, 0.0, flying_s=NAN)) == [0, 1]


def test_the_first_keeps_its_place_among_equals() -> None:
    """Two packs in parallel end together: the names of the values do not change with every forecast."""
    headline = Headline()
    assert numbers(headline, 0.0, report(0, 400.0), report(1, 405.0)) == [0, 1]
    assert numbers(headline, 1.0, report(0, 400.0), report(1, 380.0)) == [0, 1]
    assert numbers(headline, 1.5, report(0, NAN), report(1, 380.0)) == [0, 1]  # a row without a number
    assert numbers(headline, 1.6, report(0, 400.0), report(1, 380.0)) == [0, 1]
    assert numbers(headline, 2.0, report(0, 400.0), report(1, 300.0)) == [0, 1]
    assert numbers(headline, 3.0, report(0, 400.0), report(1, 300.0)) == [1, 0]
    assert numbers(headline, 3.0, report(0, 290.0), report(1, 300.0)) == [1, 0]
    both_stale = (report(0, 290.0), report(1, 300.0))
    assert numbers(headline, 9.0, *both_stale) == [1, 0]


def test_a_battery_that_gives_nothing_does_not_wait_for_take_off() -> None:
    """In flight, at rest for so long that the forecaster thinks it on the ground."""
    headline, announcer, heard = Headline(), Announcer(0, ()), []
    for k in range(40):
        one, other = report(0, 400.0, 0.0, float(k), NAN), report(1, 300.0, at_s=float(k))
        resting = replace(other.remaining, remaining_s=NAN, status=Status.REFUSED, reason=NOT_FLYING)
        found = headline.in_order({0: replace(one, remaining=resting), 1: other}, float(k))
        heard += [text for _, text in announcer.texts(float(k), found[-1], True, is_airborne=True)] if k > 3 else []
    assert not found[-1].is_waiting and "battery 1 carries the flight" in found[-1].at(39.0).reason
    assert heard == ["Battery 0: gives nothing, another has the load"]


def test_a_row_without_a_current_is_not_a_battery_that_gives_nothing() -> None:
    headline, since_s = Headline(), []
    for k in range(10):
        one, other = (
            report(0, 400.0, 0.0 if k in (2, *range(4, 10)) else 12.0, float(k)),
            report(1, 300.0, at_s=float(k)),
        )
        headline.in_order({0: one, 1: other}, float(k))
        since_s += [k] if headline.notes else []
    assert since_s == [7, 8, 9]  # for three seconds


def test_a_row_without_a_current_does_not_delay_a_pack_that_takes_the_load_over() -> None:
    carriers, carrying = Carriers(), list[frozenset[int]]()
    for k in range(6):
        lifted = replace(report(0, 400.0, at_s=float(k)), flown_J=36_000.0, flown_s=200.0)
        taking = report(1, 300.0, at_s=float(k))
        if k == 2:
            taking = replace(taking, estimate=replace(taking.estimate, current_A=NAN, power_W=NAN))
        carrying.append(carriers.after({0: lifted, 1: taking}, float(k), is_armed=True))
    assert carrying == [{0}, {0}, {0}, {0, 1}, {0, 1}, {0, 1}]


def test_a_battery_alone_that_is_charged_by_braking_motors_is_not_said_to_give_nothing() -> None:
    headline = Headline()
    for k in range(20):
        (found,) = headline.in_order({0: report(0, 400.0, -10.0, float(k))}, float(k))
        assert not headline.notes and not found.estimate.warnings


def two(bench: Bench, seconds: float, amps: tuple[float, float], drawn_Ah: float = 0.0) -> None:
    """Two packs in parallel, each with its own monitor; one that gives nothing rests."""
    for k in range(int(5 * seconds)):
        if k % 5 == 0:
            bench.send(heartbeat(True))
        drawn_Ah += 12.0 / 5.0 / 3600.0
        for instance, current_A in enumerate(amps):
            volts = 16.0 - 0.5 * drawn_Ah + (0.0 if current_A else 0.5) + 0.002 * (k % 3)
            bench.send(battery_status(Sample(0.0, volts, current_A, 25.0, drawn_Ah, armed=True), instance))
        bench.daemon.turn()
        bench.now_s += 0.2


def test_a_battery_that_drops_out_is_no_headline_and_is_said_once() -> None:
    bench = Bench()
    two(bench, 30.0, (12.0, 12.0))
    assert bench.daemon.board.reports[0].instance == 0 and not bench.daemon.board.notes
    two(bench, 40.0, (0.0, 24.0), 0.1)
    now = content(bench.daemon.board, bench.now_s)
    assert [line["instance"] for line in now["batteries"]] == [1, 0]
    assert "battery 0 gives nothing: battery 1 carries the flight" in now["notes"]
    said = [m.text for m in bench.to_gcs() if m.get_type() == "STATUSTEXT"]
    assert said.count("Battery 0: gives nothing, another has the load") == 1
    assert bench.named()["REM_S"] == bench.named()["REM_S"] and "REM_S_0" in bench.named()
    two(bench, 5.0, (12.0, 12.0), 0.2)
    assert not [note for note in bench.daemon.board.notes if "gives nothing" in note]


def test_an_id_that_changes_in_flight_takes_the_headline() -> None:
    bench = Bench()
    bench.fly(30.0)
    for k in range(50):
        drawn_Ah = 0.1 + k / 1500.0
        bench.send(battery_status(Sample(0.0, 15.9 - 0.5 * drawn_Ah, 12.0, 25.0, drawn_Ah, armed=True), 1))
        bench.daemon.turn()
        bench.now_s += 0.2
    first = bench.daemon.board.reports[0]
    assert first.instance == 1 and first.at(bench.now_s).status is not Status.STALE


def camera(bench: Bench, seconds: float, flight_pack: Callable[[Sample], Sample | None]) -> None:
    """The pack of the motors beside a camera's, which lasts for hours."""
    for k in range(int(5 * seconds)):
        if k % 5 == 0:
            bench.send(heartbeat(True))
        at_s, noise = bench.now_s - 1000.0, 0.002 * (k % 3)
        sample = Sample(0.0, 15.9 - 0.0015 * at_s + noise, 15.0 + 50.0 * noise, 25.0, at_s / 240.0, armed=True)
        said = flight_pack(sample)
        if said is not None:
            bench.send(battery_status(said, 0))
        other = Sample(0.0, 12.4 - 0.0003 * at_s + noise, 1.2 + 5.0 * noise, 25.0, at_s / 3000.0, armed=True)
        bench.send(battery_status(other, 1))
        bench.daemon.turn()
        bench.now_s += 0.2


def two_packs() -> Bench:
    bench = Bench(PackOptions(), settings=ForecastSettings(forecast_period_s=20.0))
    for name, mAh in ((b"BATT_CAPACITY", 5000.0), (b"BATT2_CAPACITY", 2200.0)):
        bench.send(dialect.MAVLink_param_value_message(name, mAh, 9, 2, 0))
    return bench


LOST: dict[str, Callable[[Sample], Sample | None]] = {
    "silent": lambda sample: None,
    "without a current": lambda sample: replace(sample, current_A=NAN),
    "with a current sensor that died": lambda sample: replace(sample, current_A=0.0),
    "stuck": lambda sample: replace(sample, voltage_V=15.7, current_A=15.0),
}


@pytest.mark.parametrize("how", [how if how == "silent" else pytest.param(how, marks=pytest.mark.slow) for how in LOST])
def test_a_camera_never_speaks_for_an_aircraft_whose_own_battery_is_lost(how: str) -> None:
    bench = two_packs()
    camera(bench, 90.0, lambda sample: sample)
    assert [report.instance for report in bench.daemon.board.reports] == [0, 1]
    assert bench.named()["REM_S"] < 1200.0 < bench.named()["REM_S_1"]
    bench.station.sent.clear()
    camera(bench, 150.0, LOST[how])
    first, other = content(bench.daemon.board, bench.now_s)["batteries"]
    assert (first["instance"], first["remaining_s"]) == (0, None) and other["remaining_s"] > 1200.0
    assert math.isnan(bench.named()["REM_S"])
    assert not [
        m for m in bench.to_gcs() if m.get_type() == "NAMED_VALUE_FLOAT" and m.name == "REM_S" and m.value > 1200.0
    ]
    assert not [note for note in bench.daemon.board.notes if "battery 1 carries" in note]


def test_a_second_pack_that_takes_the_load_over_takes_the_headline() -> None:
    """It gave nothing for ten minutes: what it gave is little for long, and its load tells."""
    headline = Headline()
    main, reserve = replace(report(0, 400.0), flown_J=108_000.0, flown_s=600.0), report(1, 900.0, 0.0)
    assert numbers(headline, 0.0, main, reserve) == [0, 1]
    for k in range(6):
        now = replace(reserve, estimate=replace(reserve.estimate, current_A=12.0, power_W=180.0), received_s=float(k))
        order = numbers(headline, float(k), main, now)
    assert order == [1, 0]


def test_a_pack_that_lifted_the_aircraft_and_rests_does_not_speak_for_it() -> None:
    """A quadplane hovers on one pack and cruises on another, at a seventh of the power: the first for minutes."""
    headline = Headline()
    lift = replace(report(0, 300.0, 0.05), flown_J=190_000.0, flown_s=150.0)
    lift = replace(lift, estimate=replace(lift.estimate, power_W=0.8))
    cruise = replace(report(1, 1500.0, 12.0), flown_J=1_000.0, flown_s=150.0)
    cruise = replace(cruise, estimate=replace(cruise.estimate, power_W=190.0))
    for k in range(12):
        order = numbers(headline, float(k), *(replace(r, received_s=float(k)) for r in (lift, cruise)))
    assert order == [1, 0]


def test_what_was_given_is_forgotten_on_the_ground() -> None:
    """The next flight may be another pack's, under another number."""
    headline = Headline()
    main, camera = replace(report(0, 400.0), flown_J=108_000.0, flown_s=600.0), report(1, 9000.0, 1.0)
    camera = replace(camera, estimate=replace(camera.estimate, power_W=12.0))
    assert headline.in_order({0: main, 1: camera}, 0.0, True)[0].instance == 0
    assert headline.in_order({0: main, 1: replace(camera, received_s=9.0)}, 9.0, True)[0].instance == 0
    landed = replace(camera, received_s=20.0, flying_since_s=NAN)
    assert headline.in_order({0: main, 1: landed}, 20.0, False)[0].instance == 1


def test_a_name_that_falls_away_is_unknown_from_then_on() -> None:
    """Said once, a lost datagram would leave the old time on the ground station's screen for the rest of the flight."""
    feed, out = NamedFeed(1.0), Outgoing(1, 193)
    one, other = report(0, 400.0), report(1, 300.0)
    sent = [feed.frames(float(k), order, out) for k, order in enumerate(([one, other], [other, one], [other, one]))]
    assert [len(frames) for frames in sent] == [8, 12, 12]
    assert math.isfinite(replace(one, received_s=2.0).at(2.0).remaining_s)
