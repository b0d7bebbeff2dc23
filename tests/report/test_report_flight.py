"""The flight page on made-up replays: ordinary, refused throughout, without temperature, without anything."""

from __future__ import annotations

import base64
import hashlib
import json
import math
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from uavbatt.battery import battery_file
from uavbatt.battery.sizing.pack_size import PackSize
from uavbatt.log_replay.outcome import Checkpoint, Landing, Outcome
from uavbatt.log_replay.run import ReplayedRow
from uavbatt.navigation import Mode, Navigation
from uavbatt.prediction.forecaster import NOT_FLYING
from uavbatt.records import NAN, Estimate, Flight, Remaining, Sample, Status
from uavbatt.report.flight.axis import TimeAxis
from uavbatt.report.flight.events import apart, events
from uavbatt.report.flight.flight_page import flight_report
from uavbatt.report.flight.series import MOST_STRETCHES, innovation_sd, outer, rows, stretches, thinned, with_gaps
from uavbatt.report.flight.text import dated_warnings

RESOLVED = PackSize("lipo-generic", "generic", 3, "vehicle", 2.65, "vehicle", 9.6, "--cutoff-voltage", NAN, "nobody")
NO_OUTCOME = Outcome(0, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, ())
HOSTILE = "<script>alert(1)</script>\"'&\x00\u202e\ud800.BIN"
REFUSAL = "not flying"


def step(time_s: float, **changed: object) -> ReplayedRow:
    """One ordinary row, changed as asked; `refused` refuses the forecast with its value as the reason."""
    reason = changed.pop("refused", "")
    remaining = Remaining(time_s, 500.0 - time_s / 2, 300.0, 700.0, NAN, Status.OK)
    if reason:
        remaining = replace(remaining, status=Status.REFUSED, reason=reason)
    estimate = Estimate(
        time_s, 0.8, 0.02, 11.5, 20.0, 25.0, 230.0, 0.01, 0.8, Status.OK, predicted_voltage_V=11.49, core_temp_C=26.0
    )
    return ReplayedRow(replace(estimate, **changed), remaining)  # type: ignore[arg-type]


def render(
    steps: list[ReplayedRow], outcome: Outcome = NO_OUTCOME, source: str = "flight.BIN", notes: tuple[str, ...] = ()
) -> str:
    flight = Flight(source, "csv", tuple(Sample(s.estimate.time_s, 11.5) for s in steps), notes=notes, skipped_bytes=7)
    html = flight_report(flight, steps, RESOLVED, outcome, battery_file.read_battery("lipo-generic"))
    found = list(ElementTree.fromstring(html.partition("\n")[2].encode("utf-8")).iter())
    assert not any("src" in e.attrib for e in found)
    (own,) = (e.text or "" for e in found if e.tag == "script" and "type" not in e.attrib)
    allowed = base64.b64encode(hashlib.sha256(own.encode()).digest()).decode()
    assert f"script-src &#x27;sha256-{allowed}&#x27;" in html  # the one script, and no other
    assert all(e.attrib["href"].startswith("#") for e in found if "href" in e.attrib)
    return html


def test_an_ordinary_flight_shows_the_answer_the_figures_and_the_sources() -> None:
    points = (Checkpoint("half time", 250.0, 300.0, 200.0, 400.0), Checkpoint("120 s before", 120.0, NAN, NAN, NAN))
    outcome = Outcome(600, 599.0, 590.0, 9.5, 0.1, 0.02, 550.0, 0.25, 0.9, points)
    html = render([step(float(t), warnings=("mind the cold",)) for t in range(600)], outcome, notes=("a note",))
    assert "10 % charge left at the end of the log (7 to 13 %)" in html
    assert "50 s too long, truth inside" in html
    assert "the forecast was refused" in html
    assert "refused: a miss" in html
    assert html.count("<svg") == 7  # the pilot's chart twice, one of them shown; five for engineers
    assert "7 unreadable bytes" in html
    assert "mind the cold (all rows)" in html
    assert "a note" in html
    assert "2.65 Ah (from: vehicle)" in html
    assert "Generic: a prior" in html


@pytest.mark.usefixtures("undrawn")
def test_refused_stretches_are_said_with_their_reason_and_hidden_from_the_figures() -> None:
    run = [step(float(t), **({"refused": REFUSAL} if t < 30 else {})) for t in range(100)]
    html = render(run)
    assert REFUSAL in html
    assert "0 s to 30 s" in html
    assert "refused (hatched)" in html
    assert np.isnan(rows(run).remaining_s[:30]).all()
    assert np.isfinite(rows(run).remaining_s[30:]).all()


@pytest.mark.usefixtures("undrawn")
def test_a_flight_with_nothing_but_refusals_has_a_page() -> None:
    run = [step(float(t), refused="r", status=Status.REFUSED, reason="no current in this row") for t in range(50)]
    html = render(run)
    assert "The state of charge was refused throughout." in html
    assert "The remaining time was refused throughout." in html
    assert "No state of charge could be given" in html
    assert "no current in this row" in html


@pytest.mark.usefixtures("undrawn")
def test_a_flight_without_temperature_says_that_the_core_is_a_guess() -> None:
    assert "No pack temperature in the log" in render([step(float(t), temp_C=NAN) for t in range(50)])


@pytest.mark.parametrize("count", [1, 2, 40])
def test_nan_everywhere_is_a_page_without_figures(count: int) -> None:
    nothing = dict.fromkeys(
        ("soc", "soc_sd", "voltage_V", "current_A", "temp_C", "power_W", "innovation_V", "nis", "predicted_voltage_V",
         "core_temp_C"), NAN)  # fmt: skip
    blank = Remaining(0.0, NAN, NAN, NAN, NAN, Status.OK)
    html = render([ReplayedRow(step(float(t), **nothing).estimate, blank) for t in range(count)])
    assert "<svg" not in html
    assert "nan" not in html.lower()


def test_unbounded_intervals_and_a_single_row_draw() -> None:
    wide = [ReplayedRow(s.estimate, replace(s.remaining, remaining_hi_s=math.inf)) for s in (step(0.0), step(1.0))]
    assert "<svg" in render(wide)
    assert "<svg" in render(wide[:1])


def test_hostile_names_and_reasons_stay_text() -> None:
    html = render([step(0.0, warnings=(HOSTILE,)), step(1.0, refused=HOSTILE)], source=HOSTILE, notes=(HOSTILE,))
    assert "alert(1)</script>" not in html and "<script>alert" not in html


def test_a_long_flight_stays_small() -> None:
    rng = np.random.default_rng(1)
    volts, amps = 11.5 + rng.normal(0, 0.2, 20_000), 20 + rng.normal(0, 3, 20_000)
    run = [
        step(0.1 * i, voltage_V=float(v), current_A=float(a), predicted_voltage_V=float(v) + 0.02, **_odd(i))
        for i, (v, a) in enumerate(zip(volts, amps, strict=True))
    ]
    html = render(run)
    assert len(html.encode()) < 2_000_000
    assert html.count("<tr>") < 100


def _odd(i: int) -> dict[str, object]:
    return {"refused": f"spread {i} s too wide"} if i % 7 == 0 else {}


def test_events_are_told_in_order_and_those_that_lie_close_share_a_mark() -> None:
    ground = [step(float(t), refused=NOT_FLYING, current_A=0.1) for t in range(20)]
    air = [step(float(t), voltage_V=11.5 if t < 70 else 10.4) for t in range(20, 100)]
    alarmed = [replace(s, remaining=replace(s.remaining, remaining_alarm_s=150.0 - s.estimate.time_s)) for s in air]
    landed = [step(float(t), refused=NOT_FLYING, current_A=0.1) for t in range(100, 120)]
    outcome = replace(NO_OUTCOME, landing=Landing(99.0, 400.0, 300.0, 500.0, NAN))
    modes = (Navigation(mode=Mode.HOLD, mode_since_s=0.0), Navigation(mode=Mode.MISSION, mode_since_s=22.0),
             Navigation(mode=Mode.RETURN, mode_since_s=60.0))  # fmt: skip
    flight = Flight("f", "csv", (), navigation=modes)
    found = events(flight, [*ground, *alarmed, *landed], outcome, low_V=10.5)
    assert [(e.time_s, e.words) for e in found] == [
        (20.0, "take-off"), (22.0, "mission"), (30.0, "alarm"), (60.0, "return"), (74.0, "low voltage"),
        (100.0, "landed"),
    ]  # fmt: skip
    assert [e.words for e in found if e.tells_danger] == ["alarm", "low voltage"]
    assert [e.words for e in apart(found, 9.0)] == ["take-off, mission", "alarm", "return", "low voltage", "landed"]


@pytest.mark.parametrize("waits", [1, 6, 7])
def test_each_flight_of_a_pack_has_its_landing_and_take_off_unless_there_are_many(waits: int) -> None:
    """Waits before the first take-off, after the last landing, and of seconds are none between two flights."""
    air = [step(float(t)) for t in range(20, 60 * waits + 100)]
    ground = [step(float(t), refused=NOT_FLYING, current_A=0.1) for t in range(20)]
    between = [(60.0 * k, 60.0 * k + 30.0) for k in range(1, waits + 1)]
    last_s = air[-1].estimate.time_s
    outcome = replace(
        NO_OUTCOME,
        landing=Landing(last_s, 400.0, 300.0, 500.0, NAN),
        waits=((0.0, 20.0), (30.0, 35.0), *between, (last_s, last_s + 60.0)),
    )
    found = [(e.time_s, e.words) for e in events(Flight("f", "csv", ()), [*ground, *air], outcome, low_V=NAN)]
    hops = [moment for begin_s, end_s in between for moment in ((begin_s, "landed"), (end_s, "take-off"))]
    assert found == [(20.0, "take-off"), *(hops if waits <= 6 else []), (last_s, "landed")]


@pytest.mark.usefixtures("undrawn")
def test_the_true_time_left_stands_still_in_a_wait() -> None:
    outcome = replace(NO_OUTCOME, end_of_flight_s=90.0, waits=((0.0, 10.0), (40.0, 60.0)))
    axis = TimeAxis(rows([step(float(t)) for t in range(100)]), (), outcome)
    times_s, left_s = axis.truth()
    assert times_s.tolist() == [0.0, 10.0, 40.0, 60.0, 90.0] and left_s.tolist() == [60.0, 60.0, 30.0, 30.0, 0.0]


@pytest.mark.usefixtures("undrawn")
def test_the_end_of_the_battery_is_said_once() -> None:
    points = (Checkpoint("half time", 250.0, 300.0, 200.0, 400.0),)
    landing = Landing(599.0, 0.0, 0.0, 0.0, NAN)
    outcome = Outcome(600, 599.0, 590.0, 9.5, 0.1, 0.02, 550.0, 0.0, 0.9, points, landing)
    html = render([step(float(t)) for t in range(600)], outcome)
    assert html.count("9 min 10 s after the log") == 1
    assert "Not checked against the truth" not in html


@pytest.mark.usefixtures("undrawn")
def test_the_cursor_knows_no_number_that_was_refused() -> None:
    run = [step(float(t), **({"refused": REFUSAL} if t < 30 else {})) for t in range(100)]
    html = render(run)
    data = json.loads(html.partition('id="rows">')[2].partition("</script>")[0])
    assert data["remaining_s"][:30] == [None] * 30 and None not in data["remaining_s"][30:]
    assert len(data["time_s"]) == 100 and data["time_s"][-1] == 99.0


def test_thinning_keeps_every_extreme_and_bands_never_get_narrower() -> None:
    time_s = np.arange(50_000.0)
    values = np.sin(time_s / 300.0)
    values[31_234], values[7_777], values[40_000:40_100] = 9.0, -9.0, np.nan
    t, y = thinned(time_s, values)
    assert t.size < 6_000
    assert (np.diff(t) > 0).all()
    assert (np.nanmax(y), np.nanmin(y)) == (9.0, -9.0)
    assert np.isnan(y).any()
    at, low, high = outer(time_s, values - 1.0, values + 1.0)
    assert np.nanmax(high) == 10.0
    assert np.nanmin(low) == -10.0
    assert at.size < 2_000
    dense = np.interp(time_s[:30_000], at, high)
    assert (dense >= np.interp(time_s[:30_000], time_s, values)).all()


@pytest.mark.usefixtures("undrawn")
def test_nothing_is_drawn_across_a_gap_and_the_gap_is_named() -> None:
    run = [step(float(t)) for t in (*range(50), *range(200, 250))]
    (gap,) = stretches(run)
    assert (gap.begin_s, gap.end_s, gap.rows) == (49.0, 200.0, 0)
    columns = with_gaps(rows(run))
    assert np.isnan(columns.voltage_V[50])
    assert columns.time_s.size == 101
    assert "no row in the log" in render(run)


def test_a_gap_is_longer_than_the_usual_step_of_the_log() -> None:
    for pause_s, gaps in ((14.0, 0), (18.0, 1)):
        times_s = [*np.arange(0.0, 60.0, 2.0), *np.arange(58.0 + pause_s, 120.0, 2.0)]
        assert sum(s.status is Status.STALE for s in stretches([step(float(t)) for t in times_s])) == gaps


def test_reasons_that_differ_in_numbers_are_one_stretch_and_many_stretches_run_together() -> None:
    (only,) = stretches([step(float(t), refused=f"known to ±{t} %") for t in range(20)])
    assert (only.rows, only.reason, only.last_reason) == (20, "known to ±0 %", "known to ±19 %")
    flicker = [step(float(t), **({"refused": REFUSAL} if t % 2 else {})) for t in range(1000)]
    found = stretches(flicker)
    assert len(found) <= MOST_STRETCHES
    assert sum(s.rows for s in found) == 500


def test_the_expected_innovation_comes_back_from_the_nis() -> None:
    innovation, sd = np.array([0.02, -0.05, 0.01]), np.array([0.03, 0.04, 0.02])
    nis = (innovation / sd) ** 2
    alone = innovation_sd(innovation, nis, np.full(3, np.nan))
    assert alone == pytest.approx(sd)


def test_beside_a_temperature_the_expected_innovation_is_the_greatest_lower_bound_nearby() -> None:
    """NIS then holds the temperature's part too, so that |innovation|/sqrt(NIS) is below the SD of the voltage."""
    innovation, sd = np.full(60, 0.02), np.r_[np.full(30, 0.02), np.full(30, 0.04)]
    nis_V, nis_temp = (innovation / sd) ** 2, np.tile([0.0, 1.5, 3.0], 20)
    found = innovation_sd(innovation, nis_V + nis_temp, np.full(60, 25.0), reach=5)
    assert found[:20] == pytest.approx(0.02)  # met by a row with no surprise in the temperature, raised elsewhere
    assert found[-20:] == pytest.approx(0.04)
    assert (found <= 0.04 + 1e-12).all()
    unknown = innovation_sd(np.where(np.arange(60) % 2, np.nan, innovation), nis_V, np.full(60, 25.0))
    assert np.isnan(unknown[1::2]).all() and np.isfinite(unknown[::2]).all()


def test_a_warning_is_dated_by_its_last_stretch_and_by_its_first_time() -> None:
    def warned(*spans: tuple[int, int], first_s: float = 0.0) -> list[str]:
        run = [step(first_s + t) for t in range(600)]
        for begin, end in spans:
            run[begin:end] = [step(first_s + t, warnings=("low",)) for t in range(begin, end)]
        return dated_warnings(run)

    assert warned((0, 600)) == ["low"]
    assert warned((300, 600)) == ["low (since 5 min 00 s)"]
    assert warned((300, 400), (405, 600)) == ["low (since 5 min 00 s)"]
    assert warned((60, 70), (300, 600)) == ["low (since 5 min 00 s, first at 1 min 00 s)"]
    assert warned((60, 70), (300, 400)) == ["low (1 min 00 s to 6 min 39 s)"]
    assert warned((0, 600), first_s=900.0) == ["low"]  # a later flight of the log: times are those of the log
    assert warned((60, 70), (300, 400), first_s=900.0) == ["low (16 min 00 s to 21 min 39 s)"]
