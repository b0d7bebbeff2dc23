"""F6: what is said aloud: alarms that are never lost, a number that disappears, warnings that the estimate raises."""

from __future__ import annotations

import itertools
import math
import pickle
from dataclasses import replace
from types import ModuleType
from typing import Any

import pytest
from daemon_bench import OPTIONS, Bench
from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.battery.battery_file import read_battery
from uavbatt.battery.sizing import statements
from uavbatt.battery.sizing.pack_size import PackOptions, size_of_pack
from uavbatt.estimation import filter as soc_filter
from uavbatt.estimation import monitor, sensor_faults
from uavbatt.estimation.filter import NO_CURRENT, known_only_to
from uavbatt.limits import Doubt, FirstVoltages, Resting, cells_doubt, ending_doubt
from uavbatt.live.config import FeedSection
from uavbatt.live.feeds import announced
from uavbatt.live.feeds.announced import Announcer
from uavbatt.live.feeds.web import content
from uavbatt.live.report import Report
from uavbatt.live.tracked_battery import TrackedBattery
from uavbatt.mavlink.outgoing import SEVERITY_CRITICAL, SEVERITY_WARNING
from uavbatt.notice import Kind, Notice, kind_of
from uavbatt.prediction import forecaster, voltage_bound
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.prediction.pending import ENDS_SOON
from uavbatt.records import NAN, Estimate, PackFacts, Remaining, Sample, Status
from uavbatt.simulate.tlog_writer import battery_status, heartbeat

TWO_SENDERS = Notice("two senders speak for this battery", Kind.TWO_SENDERS)
SILENT = Notice("no telemetry for 4 s", Kind.NO_TELEMETRY)


def texts(bench: Bench) -> list[str]:
    return [m.text for m in bench.to_gcs() if m.get_type() == "STATUSTEXT"]


def rows(bench: Bench, seconds: float, amps: float, volts: float = 15.9, armed: bool = True) -> None:
    for k in range(int(5 * seconds)):
        if k % 5 == 0:
            bench.send(heartbeat(armed))
        shown_V = volts - 0.001 * (k // 25) + (0.4 if abs(amps) < 1.0 and not armed else 0.0)  # sinks; rises at rest
        bench.send(battery_status(Sample(0.0, shown_V, amps, 25.0, 0.1, armed=armed), 0))
        bench.daemon.turn()
        bench.now_s += 0.2


def test_current_dies_minus_1() -> None:
    """The current sensor dies in flight: said, with the reason, once; when it lives again nothing is said."""
    bench = Bench()
    bench.fly(30.0)
    assert bench.named()["REM_S"] > 0.0
    for _ in range(2):
        rows(bench, 15.0, NAN)
        rows(bench, 47.0, 12.0)
    said = texts(bench)
    assert said == ["Battery 0: time unknown, no current reading"] * 2
    now = content(bench.daemon.board, bench.now_s)
    assert [line["text"] for line in now["said"]] == said and 50.0 < now["said"][-1]["age_s"] < 65.0


def test_current_dies_0A() -> None:
    bench = Bench()
    bench.fly(30.0)
    rows(bench, 100.0, 0.0)
    said = texts(bench)
    assert [text for text in said if "unknown" in text] == ["Battery 0: time unknown, current does not fit"]
    assert "Battery 0: current fell, voltage did not rise" in said


def test_stale_after_converging_is_said() -> None:
    """Without a current sensor the number converges for long; the link breaks meanwhile."""
    bench = Bench(PackOptions(capacity_Ah=5.0, cells=4), settings=ForecastSettings(forecast_period_s=1.0))
    rows(bench, 30.0, NAN)
    shown = bench.daemon.board.reports[0].at(bench.now_s)
    assert shown.status == "converging" and shown.remaining_s > 0.0
    bench.now_s += 4.0
    bench.daemon.turn()
    assert texts(bench) == ["Battery 0: time unknown, no telemetry"]


def test_the_end_of_a_flight_is_no_loss() -> None:
    bench = Bench()
    bench.fly(30.0)
    rows(bench, 60.0, 0.1, armed=False)
    assert texts(bench) == [] and bench.daemon.board.reports[0].at(bench.now_s).status == "refused"


def test_every_reason_fits_into_a_text() -> None:
    """The longest number of a battery, the longest reason."""
    lost = [kind for kind in announced.REASONS if kind not in (Kind.NOT_FLYING, Kind.JUST_TAKEN_OFF)]
    known = (Notice("why it is so", kind) for kind in lost)
    for reason in (*known, "a reason that nobody has shortened: it goes on and on and on"):
        for status in (Status.REFUSED, Status.STALE):
            announcer = Announcer(255, ())
            announcer.texts(0.0, report(100.0, instance=255))
            said = announcer.texts(2.0, report(NAN, status, reason, instance=255, at_s=2.0), True)
            said += announcer.texts(3.5, report(NAN, status, reason, instance=255, at_s=3.5), True)
            ((_, text),) = said
            assert len(text) <= 50 and text.startswith("Battery 255: time unknown, ")
    for short in announced.REASONS.values():
        assert len(f"Battery 255: time unknown, {short}") <= 50
    for short in announced.WARNINGS.values():
        assert len(f"Battery 255: {short}") <= 50


CAPACITY_AH, MEASURED = 5.0, FirstVoltages(16.0, 16.0)


def notices_of(module: ModuleType) -> list[Notice]:
    return [value for value in vars(module).values() if isinstance(value, Notice)]


def doubted(doubt: Doubt | None) -> Notice:
    assert doubt is not None
    return doubt.words


REFUSALS = [
    *notices_of(monitor),
    *notices_of(sensor_faults),
    *notices_of(soc_filter),
    *notices_of(forecaster),
    voltage_bound.NO_END,
    statements.SLOW_ROWS.words,
    statements.CHARGING.words,
    known_only_to(0.3),
    known_only_to(2.0),
    doubted(cells_doubt(12, MEASURED, Resting())),
    doubted(cells_doubt(5, MEASURED, Resting(), drawn_Ah=2.0, capacity_Ah=CAPACITY_AH)),
    doubted(ending_doubt("cut-off ", 3.3, 4, kind=Kind.CUTOFF)),
    doubted(ending_doubt("low-voltage warning at ", 25.0, 4, kind=Kind.LOW_VOLTAGE)),
]


@pytest.mark.parametrize("reason", REFUSALS)
def test_every_refusal_has_words_of_its_own(reason: Notice) -> None:
    assert reason.kind in announced.REASONS, reason


def test_a_refusal_without_a_size_a_fault_and_a_silent_link_have_their_kinds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tracked = TrackedBattery(read_battery("lipo-generic"), PackOptions(), ForecastSettings())
    sample = Sample(0.0, 16.0, 1.0, 25.0)
    assert kind_of(tracked.step(sample, PackFacts())[1].reason) is Kind.CAPACITY_NOT_STATED
    monkeypatch.setattr(tracked.estimator, "step", lambda *_: 1 / 0)
    assert kind_of(tracked.step(sample, PackFacts())[1].reason) is Kind.FAULT
    assert kind_of(report(400.0).at(4.0).reason) is Kind.NO_TELEMETRY
    assert kind_of(report(400.0).late_by(14.0).at(1.0).reason) is Kind.LATE


def test_a_notice_keeps_its_kind_in_another_process() -> None:
    """The rows of a fleet are worked out in workers."""
    sent = pickle.loads(pickle.dumps((ENDS_SOON, ENDS_SOON.kind)))
    assert sent == (ENDS_SOON, Kind.ENDS_SOON) and kind_of(sent[0]) is Kind.ENDS_SOON


@pytest.mark.parametrize("words", ["no current sensor: current worked out from the stated power", "cut-off"])
def test_the_words_of_a_warning_decide_nothing(words: str) -> None:
    """A power that the crew states was once announced as "capacity does not fit": both sentences hold "the stated"."""
    warned = report(100.0, warnings=(words,))
    assert Announcer(0, ()).texts(0.0, warned, True) == []


def test_cells_of_the_vehicle_that_are_not_used_are_one_text() -> None:
    """The sentence holds the doubt about the count as well, which is announced only where it is a doubt of its own."""
    options = PackOptions(capacity_Ah=CAPACITY_AH)
    size = size_of_pack(read_battery("lipo-generic"), options, PackFacts(cells_series=12), 4, voltages=MEASURED)
    warned = report(100.0, warnings=size.notices)
    assert [text for _, text in Announcer(0, ()).texts(0.0, warned, True)] == [
        "Battery 0: cells of the vehicle not used"
    ]


def test_without_a_current_the_voltage_says_that_the_end_is_near() -> None:
    bench = Bench()
    bench.fly(30.0)
    for k in range(1200):
        if k % 5 == 0:
            bench.send(heartbeat(True))
        volts = 14.6 - 0.005 * k / 5.0 + 0.002 * (k % 3)
        bench.send(battery_status(Sample(0.0, volts, NAN, 25.0, NAN, armed=True), 0))
        bench.daemon.turn()
        bench.now_s += 0.2
    land = "Battery 0: voltage nears its cut-off: land"
    assert texts(bench) == ["Battery 0: time unknown, no current reading", land, land, land]
    assert [text for _, text in bench.daemon.board.announcements].count(land) == 1  # the page keeps all of them


def heard(announcer: Announcer, left_s: list[float], *, is_first: bool = True) -> list[tuple[int, str]]:
    """What the ground station is sent and when [s], of the time left in each second."""
    found = []
    for k, left in enumerate(left_s):
        now = report(left, at_s=float(k))
        said = announcer.texts(float(k), now, True, speaks_first=is_first)
        found += [(k, text) for _, text in said + announcer.repeats(float(k), now, is_first)]
    return found


def test_an_alarm_is_sent_three_times_with_the_time_as_it_is_then() -> None:
    """A radio loses some texts; of five minutes there is time to hear the next one."""
    said = heard(Announcer(0, (300.0, 120.0)), [310.0 - k for k in range(230)])
    left = [(10, "5:00"), (190, "2:00"), (195, "1:55"), (205, "1:45")]
    assert said == [(k, f"Battery 0: {words} min left at worst") for k, words in left]


def test_the_last_minute_and_a_half_is_critical() -> None:
    """Stations read a critical text aloud."""
    announcer = Announcer(0, (300.0, 120.0, 60.0))
    said = []
    for k, left_s in enumerate((310.0, 299.0, 119.0, 59.0)):
        said += announcer.texts(20.0 * k, report(left_s, at_s=20.0 * k), True)
    assert [severity for severity, _ in said] == [SEVERITY_WARNING, SEVERITY_WARNING, SEVERITY_CRITICAL]


def test_an_alarm_that_holds_no_more_is_not_sent_again() -> None:
    assert len(heard(Announcer(0, (120.0,)), [121.0, 119.0, *[400.0] * 30])) == 1
    assert len(heard(Announcer(0, (120.0,)), [121.0, 119.0, *[NAN] * 30])) == 2  # and the loss
    closer = heard(Announcer(0, (120.0, 60.0)), [119.0, 119.0, *[59.0] * 20])  # the next alarm takes its place
    assert [k for k, _ in closer] == [0, 2, 7, 17]


def test_a_text_that_does_not_fit_ends_with_a_whole_word() -> None:
    """Somebody adds a reason and forgets its short form."""
    announcer = Announcer(0, ())
    announcer.texts(0.0, report(100.0))
    why = "the voltage is far enough off to be somebody else's battery"
    announcer.texts(1.0, report(NAN, Status.REFUSED, "unheard of: " + why, at_s=1.0), True)
    ((_, text),) = announcer.texts(2.0, report(NAN, Status.REFUSED, "unheard of: " + why, at_s=2.0), True)
    assert text == "Battery 0: time unknown, unheard of: the voltage"


def waiting(why: str, at_s: float, amps: float = 0.5) -> Report:
    return replace(report(NAN, Status.REFUSED, why, at_s), estimate=replace(report(1.0).estimate, current_A=amps))


def flight(announcer: Announcer, *parts: tuple[int, bool, str], airborne_s: float = math.inf) -> list[tuple[int, str]]:
    """What is said and when [s]; parts: seconds, armed, why there is no number (empty: there is one)."""
    found, k = [], 0
    for seconds, is_armed, why in parts:
        for _ in range(seconds):
            at_s = float(k)
            now = waiting(why, at_s) if why else report(400.0, at_s=at_s)
            found += [(k, text) for _, text in announcer.texts(at_s, now, is_armed, at_s >= airborne_s)]
            k += 1
    return found


@pytest.mark.parametrize("ground_s", [10, 60])
def test_a_take_off_is_no_loss_and_a_dead_sensor_is_said_in_the_air(ground_s: int) -> None:
    ground = ((ground_s, False, forecaster.NOT_FLYING), (30, True, forecaster.NOT_FLYING))
    assert flight(Announcer(0, ()), *ground, (3, True, forecaster.JUST_TAKEN_OFF), (30, True, "")) == []
    said = flight(Announcer(0, ()), *ground, (60, True, NO_CURRENT))
    assert said == [(ground_s + 50, "Battery 0: time unknown, no current reading")]


def test_a_load_that_never_comes_is_said_where_the_autopilot_says_that_it_flies() -> None:
    """The current sensor shows nothing from take-off on: for the battery alone that is an aircraft on the ground."""
    parts = ((30, False, forecaster.NOT_FLYING), (60, True, forecaster.NOT_FLYING))
    assert flight(Announcer(0, ()), *parts) == []
    assert flight(Announcer(0, ()), *parts, airborne_s=40) == [(60, "Battery 0: time unknown, no load seen")]


@pytest.mark.parametrize("start_s", [0.0, 1000.0])
def test_the_load_that_never_comes_is_said_whenever_the_companion_was_started(start_s: float) -> None:
    """Positions carry the vehicle's time, which is not the companion's: half an hour of uptime silenced the text."""
    bench = Bench(start_s=start_s)
    for k in range(5 * 60):
        if k % 5 == 0:
            bench.send(heartbeat(True))
        home = (470000000, 80000000, 400000, 0.0, 0.0, 0.0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0)
        bench.send(dialect.MAVLink_home_position_message(*home))
        bench.send(dialect.MAVLink_global_position_int_message(0, 470000000, 80000000, 430000, 30000, 0, 0, 0, 0))
        bench.send(battery_status(Sample(0.0, 16.0, 0.0, 25.0, 0.0, armed=True), 0))
        bench.daemon.turn()
        bench.now_s += 0.2
    assert "Battery 0: time unknown, no load seen" in [text for _, text in bench.daemon.board.announcements]


@pytest.mark.parametrize(
    ("armed", "airborne", "heard"), [(True, None, 1), (True, True, 1), (True, False, 0), (False, None, 0)]
)
def test_a_load_that_is_not_seen_any_more_is_a_loss_until_the_landing(
    armed: bool, airborne: bool | None, heard: int
) -> None:
    """The capacity is stated anew in flight, and the current sensor dies before the estimate sees the load again."""
    announcer, said = Announcer(0, ()), []
    announcer.texts(0.0, report(400.0), True, airborne)
    for k in range(1, 30):
        said += announcer.texts(float(k), waiting(forecaster.NOT_FLYING, float(k)), armed, airborne)
    assert [text for _, text in said] == ["Battery 0: time unknown, no load seen"] * heard
    later = [announcer.texts(float(k), waiting(forecaster.NOT_FLYING, float(k)), True) for k in range(30, 50)]
    assert armed or not any(later)  # armed before the next flight


def test_every_flight_has_a_warning_of_its_own() -> None:
    one = ((10, False, forecaster.NOT_FLYING), (60, True, NO_CURRENT))
    assert [k for k, _ in flight(Announcer(0, ()), *one, *one)] == [30, 100]


def test_a_healthy_take_off_after_a_minute_on_the_ground_is_quiet() -> None:
    bench = Bench()
    rows(bench, 60.0, 0.3, 16.4, armed=False)
    rows(bench, 5.0, 0.5, 16.4)
    bench.fly(30.0)
    assert bench.named()["REM_S"] > 0.0 and texts(bench) == []


def report(
    left_s: float, status: Status = Status.OK, reason: str = "", at_s: float = 0.0, instance: int = 0,
    warnings: tuple[str, ...] = (),
) -> Report:  # fmt: skip
    estimate = Estimate(at_s, 0.5, 0.01, 15.0, 12.0, 25.0, 180.0, 0.0, 1.0, status, reason, warnings)
    remaining = Remaining(at_s, left_s, left_s, left_s, NAN, status, reason, left_s)
    return Report(instance, 1, 1, estimate, remaining, at_s)


def said(announcer: Announcer, at_s: float, left_s: float, **what: Any) -> list[str]:
    status = Status.OK if math.isfinite(left_s) else Status.REFUSED
    return [text for _, text in announcer.texts(at_s, report(left_s, status, NO_CURRENT, at_s, **what), True)]


def test_no_text_is_lost_because_another_was_said() -> None:
    """Three thresholds, a warning and a loss within eight seconds: five texts."""
    announcer = Announcer(0, (300.0, 120.0, 60.0))
    assert said(announcer, 0.0, 400.0) == []
    assert said(announcer, 1.0, 299.0) == ["Battery 0: 4:59 min left at worst"]
    assert said(announcer, 3.0, 119.0) == ["Battery 0: 1:59 min left at worst"]
    assert said(announcer, 5.0, 59.0) == ["Battery 0: 0:59 min left at worst"]
    assert said(announcer, 6.0, NAN) == []  # one bad row is no loss
    assert said(announcer, 7.0, NAN) == ["Battery 0: time unknown, no current reading"]
    assert said(announcer, 8.0, 58.0) == []  # back, quietly


def test_of_several_batteries_the_first_alone_tells_how_time_runs_out() -> None:
    """The others still say what is wrong with them, and that their time is lost."""
    other, told = Announcer(1, (300.0, 120.0, 60.0)), list[str]()
    for k, left_s in enumerate((400.0, 119.0, 59.0, NAN, NAN, NAN)):
        shown = report(left_s, Status.OK if k < 3 else Status.REFUSED, NO_CURRENT, float(k), instance=1)
        told += [text for _, text in other.texts(float(k), shown, True, speaks_first=False)]
    assert told == ["Battery 1: time unknown, no current reading"]


def test_an_alarm_that_repeats_itself_within_the_pause_is_said_behind_it() -> None:
    announcer = Announcer(0, (120.0,))
    assert said(announcer, 0.0, 119.0) == ["Battery 0: 1:59 min left at worst"]
    assert said(announcer, 2.0, 150.0) == []
    assert [text for k in range(3, 15) for text in said(announcer, float(k), 118.0)] == [
        "Battery 0: 1:58 min left at worst"
    ]


def test_a_second_loss_within_the_pause_is_said_behind_it() -> None:
    announcer = Announcer(0, ())
    heard = [said(announcer, float(k), NAN if k in (2, 3) or k > 5 else 400.0) for k in range(80)]
    assert [k for k, texts in enumerate(heard) if texts] == [3, 63]


def test_a_second_loss_for_another_reason_waits_ten_seconds_only() -> None:
    announcer = Announcer(0, ())
    heard = []
    for k in range(20):
        status, why = (Status.REFUSED, TWO_SENDERS) if k > 5 else (Status.STALE, SILENT)
        is_lost = k in (2, 3) or k > 5
        told = report(NAN if is_lost else 400.0, status if is_lost else Status.OK, why, float(k))
        heard.append(announcer.texts(float(k), told, True))
    assert [k for k, texts in enumerate(heard) if texts] == [2, 12]


def test_a_number_that_comes_and_goes_is_said_once_a_minute() -> None:
    """A row every six seconds: known for three of them and stale for three."""
    announcer = Announcer(0, ())
    heard = [announcer.texts(float(k), report(400.0, at_s=6.0 * (k // 6)), True) for k in range(600)]
    times_s = [k for k, texts in enumerate(heard) if texts]
    assert len(times_s) == 10 and min(b - a for a, b in itertools.pairwise(times_s)) >= 60


def test_a_new_warning_is_said_once_an_occurrence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(announced.WARNINGS, Kind.OTHER, "the moon is full")
    announcer = Announcer(2, ())
    warned = ("the moon pulls at the pack: by 12 N", "another warning")
    assert said(announcer, 0.0, 400.0, instance=2) == []
    assert said(announcer, 1.0, 400.0, instance=2, warnings=warned) == ["Battery 2: the moon is full"]
    flicker = [said(announcer, 2.0 + k, 400.0, instance=2, warnings=warned if k % 9 == 0 else ()) for k in range(60)]
    assert not any(flicker)
    assert said(announcer, 200.0, 400.0, instance=2, warnings=warned) == ["Battery 2: the moon is full"]


def test_a_warning_of_the_estimate_reaches_station_and_page(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(announced.WARNINGS, Kind.NO_TEMPERATURE, "no temperature")
    bench = Bench(OPTIONS, feed=FeedSection(kinds=("battery", "named")))
    bench.fly(10.0)
    for k in range(50):
        bench.send(battery_status(Sample(0.0, 15.9, 12.0, NAN, 0.1 + k / 1500, armed=True), 0))
        bench.daemon.turn()
        bench.now_s += 0.2
    messages = [m for m in bench.to_gcs() if m.get_type() == "STATUSTEXT"]
    assert [(m.text, m.severity) for m in messages] == [("Battery 0: no temperature", dialect.MAV_SEVERITY_WARNING)]
    assert [line["text"] for line in content(bench.daemon.board, bench.now_s)["said"]] == ["Battery 0: no temperature"]


def test_a_number_that_never_comes_is_said_once() -> None:
    """Twelve cells are stated of a pack of four: refused from the first row on, and the crew hears of it."""
    bench = Bench(PackOptions(cells=12, capacity_Ah=5.0), settings=ForecastSettings(forecast_period_s=1.0))
    rows(bench, 60.0, 12.0)
    assert len([text for text in texts(bench) if "time unknown" in text]) == 1
