"""The figures of a finished replay, of rows whose answers are known: what is judged, and when it is not."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from uavbatt.estimation.sensor_faults import DEAD_CURRENT, STUCK_CURRENT, STUCK_VOLTAGE
from uavbatt.log_replay.in_air import in_air
from uavbatt.log_replay.outcome import Outcome, outcome
from uavbatt.log_replay.run import ReplayedRow
from uavbatt.notice import Notice
from uavbatt.records import NAN, Estimate, Remaining, Status

TAKE_OFF_S, LANDS_S, CUTOFF_V = 100.0, 700.0, 13.2
END_S = 665.0  # the voltage falls by 5 mV a second from 16.0 V; its mean over 5 s is below the cut-off a little later
ERROR_S = 7.0


def row(time_s: float, voltage_V: float, current_A: float, *, armed: bool | None = None) -> ReplayedRow:
    """A row whose forecast is ERROR_S too long, and whose charge falls by 0.1 % a second."""
    soc = 1.0 - 0.001 * time_s
    estimate = Estimate(
        time_s, soc, 0.001 * time_s, voltage_V, current_A, NAN, NAN, 0.01, 1.0 + time_s % 2.0, Status.OK
    )
    left_s = END_S - time_s + ERROR_S
    said = Remaining(time_s, left_s, left_s - 20.0, left_s + 30.0, left_s - 60.0, Status.OK)
    return ReplayedRow(estimate, said, armed)


def flight(*, until_s: float = 720.0) -> list[ReplayedRow]:
    """A row a second: on the ground, 600 s in the air, on the ground again."""
    rows = []
    for k in range(int(until_s) + 1):
        in_air = TAKE_OFF_S <= k < LANDS_S
        fallen_V = 0.005 * (min(max(k, TAKE_OFF_S), LANDS_S) - TAKE_OFF_S)
        rows.append(row(float(k), (16.0 if in_air else 16.6) - fallen_V, 15.0 if in_air else 0.2))
    return rows


def refused(one: ReplayedRow) -> ReplayedRow:
    said = Remaining(one.remaining.time_s, NAN, NAN, NAN, NAN, Status.REFUSED, "not known")
    return replace(one, remaining=said)


def judged(found: Outcome) -> dict[str, float]:
    return {c.label: c.before_end_s for c in found.checkpoints}


def test_the_end_is_found_and_the_checkpoints_count_back_from_it() -> None:
    found = outcome(flight(), CUTOFF_V)
    assert found.end_of_flight_s == pytest.approx(END_S, abs=3.0)
    half_s = (found.end_of_flight_s - TAKE_OFF_S) / 2.0  # of the flight, not of the log
    assert judged(found) == {
        "half time": pytest.approx(half_s, abs=1.0), "360 s before": 360.0, "240 s before": 240.0,
        "120 s before": 120.0, "60 s before": 60.0,
    }  # fmt: skip
    late_s = found.end_of_flight_s - END_S
    assert all(c.error_s == pytest.approx(ERROR_S - late_s) and c.inside for c in found.checkpoints)
    assert (found.rows, found.duration_s) == (721, 720.0)
    assert (found.end_soc, found.end_soc_sd) == (pytest.approx(0.28), pytest.approx(0.72))
    assert found.end_voltage_V == pytest.approx(13.6) and found.mean_nis == pytest.approx(1.5, abs=0.01)


def later(one: ReplayedRow, by_s: float, *, armed: bool) -> ReplayedRow:
    time_s = one.estimate.time_s + by_s
    estimate, said = replace(one.estimate, time_s=time_s), replace(one.remaining, time_s=time_s)
    return replace(one, estimate=estimate, remaining=said, armed=armed)


@pytest.mark.parametrize("landed_s", [300, 500])
def test_time_on_the_ground_between_two_flights_of_a_pack_is_in_no_truth(landed_s: int) -> None:
    """Landed, disarmed, taken off again after 200 s: a forecast says how long the aircraft can fly, not wait."""
    rows, wait_s = [later(one, 0.0, armed=True) for one in flight()], 200
    waiting = [refused(row(float(landed_s + k), 16.5, 0.2, armed=False)) for k in range(wait_s)]
    found = outcome(
        [*rows[:landed_s], *waiting, *(later(one, wait_s, armed=True) for one in rows[landed_s:])], CUTOFF_V
    )
    in_one = outcome(rows, CUTOFF_V)
    assert found.end_of_flight_s == in_one.end_of_flight_s + wait_s
    assert found.checkpoints == in_one.checkpoints and len(found.checkpoints) == 5


def test_no_checkpoint_lies_before_take_off_or_before_the_log() -> None:
    in_air = flight()[362:]
    waited = [replace(one, estimate=replace(one.estimate, current_A=0.2)) for one in flight()[:362]] + in_air
    for rows in (in_air, waited):
        assert set(judged(outcome(rows, CUTOFF_V))) == {"half time", "240 s before", "120 s before", "60 s before"}


def test_a_flight_with_a_reserve_is_not_judged_by_its_voltage() -> None:
    found = outcome(flight(), CUTOFF_V, reserve_soc=0.2)
    assert found.checkpoints == () and found.reserve_soc == 0.2 and math.isfinite(found.end_of_flight_s)


def test_refusals_count_after_the_first_minute_in_the_air() -> None:
    rows = [refused(one) if one.estimate.time_s < 160.0 or 300.0 <= one.estimate.time_s < 354.0 else one
            for one in flight()]  # fmt: skip
    assert outcome(rows, CUTOFF_V).refused_in_air == pytest.approx(54.0 / 539.0)


def test_rows_without_a_reading_at_the_end_hide_neither_voltage_nor_charge() -> None:
    rows = flight()
    rows[-1] = replace(rows[-1], estimate=replace(rows[-1].estimate, voltage_V=13.7))
    bare = replace(rows[-1].estimate, time_s=721.0, voltage_V=NAN, soc=NAN, innovation_V=NAN, nis=NAN)
    found = outcome([*rows, replace(rows[-1], estimate=bare)], CUTOFF_V)
    assert found.end_voltage_V == pytest.approx(13.7) and found.end_soc == pytest.approx(0.28)


def test_the_landing_is_the_last_row_in_the_air() -> None:
    found = outcome(flight(), CUTOFF_V).landing
    assert found is not None and not found.is_cut
    assert (found.time_s, found.remaining_s) == (699.0, pytest.approx(END_S - 699.0 + ERROR_S))


@pytest.mark.parametrize(("silent_s", "time_s"), [(20.0, 679.0), (40.0, 699.0)])
def test_a_descent_without_forecasts_has_that_of_some_seconds_before(silent_s: float, time_s: float) -> None:
    rows = [refused(one) if one.estimate.time_s >= LANDS_S - silent_s else one for one in flight()]
    found = outcome(rows, CUTOFF_V).landing
    assert found is not None and found.time_s == time_s
    assert math.isfinite(found.remaining_s) is (silent_s < 30.0)
    assert found.reason == ("" if silent_s < 30.0 else "not known")


@pytest.mark.parametrize(("until_s", "is_cut"), [(690.0, True), (703.0, True), (704.0, False), (720.0, False)])
def test_a_log_that_ends_within_seconds_of_its_load_was_cut(until_s: float, is_cut: bool) -> None:
    found = outcome(flight(until_s=until_s), CUTOFF_V).landing
    assert found is not None and found.is_cut is is_cut


def test_a_flight_whose_current_was_lost_for_half_a_minute_has_no_charge_at_its_end() -> None:
    def without_current(since_s: float) -> Outcome:
        rows = [
            replace(one, estimate=replace(one.estimate, current_A=NAN), armed=True)
            if since_s <= one.estimate.time_s < LANDS_S
            else one
            for one in flight()
        ]
        return outcome(rows, CUTOFF_V)

    assert math.isnan(without_current(660.0).end_soc) and math.isnan(without_current(660.0).end_soc_sd)
    assert without_current(680.0).end_soc == pytest.approx(0.28)


# --- which rows are in the air: a sensor that fails there does not end the flight ---------------------------------


def with_current(
    since_s: float, to_s: float, current_A: float, *, armed: bool | None = None, warnings: tuple[Notice, ...] = ()
) -> list[ReplayedRow]:
    """The flight with another current between two times; `armed` while it is in the air."""
    return [
        replace(
            one,
            estimate=replace(one.estimate, current_A=current_A, warnings=warnings)
            if since_s <= one.estimate.time_s < to_s
            else one.estimate,
            armed=armed and one.estimate.time_s < LANDS_S,
        )
        for one in flight()
    ]


def flown_s(rows: list[ReplayedRow]) -> tuple[float, float]:
    """First and last time in the air; all rows between them are."""
    times_s = np.flatnonzero(in_air(rows).flying).astype(float)
    assert times_s.size == times_s[-1] - times_s[0] + 1.0
    return float(times_s[0]), float(times_s[-1])


def test_rows_under_load_are_in_the_air() -> None:
    assert flown_s(flight()) == (TAKE_OFF_S, LANDS_S - 1.0)
    assert not in_air(flight()).lost.any() and not in_air(flight()).lost_at_end.size


@pytest.mark.parametrize(("armed", "since_s"), [(True, 200.0), (True, 660.0), (None, 660.0)])
def test_a_current_that_is_lost_for_good_leaves_the_flight_until_it_lands(armed: bool | None, since_s: float) -> None:
    """By its flag, or by its voltage, which recovers at the landing."""
    found = in_air(rows := with_current(since_s, math.inf, math.nan, armed=armed))
    assert flown_s(rows) == (TAKE_OFF_S, LANDS_S - 1.0)
    assert found.lost_at_end.tolist() == list(range(int(since_s), int(LANDS_S)))
    assert np.isinf(found.current_A[found.lost]).all() and np.isfinite(found.current_A[: int(since_s)]).all()
    assert outcome(rows, CUTOFF_V).end_of_flight_s == pytest.approx(END_S, abs=3.0)
    landing = outcome(rows, CUTOFF_V).landing
    assert landing is not None and landing.time_s == LANDS_S - 1.0
    silent = [refused(one) if one.estimate.time_s >= since_s else one for one in rows]
    landing = outcome(silent, CUTOFF_V).landing
    assert landing is not None and math.isnan(landing.remaining_s) and landing.current_lost_s == since_s


def test_a_current_that_comes_back_is_not_lost_at_the_end() -> None:
    found = in_air(with_current(300.0, 400.0, math.nan))
    assert found.lost.sum() == 100 and found.flying[300:400].all() and not found.lost_at_end.size


def test_one_low_voltage_under_the_last_load_does_not_end_the_flight_by_voltage() -> None:
    """Without a flag the voltage is compared with its mean of the last ten seconds under load."""
    rows = with_current(300.0, 400.0, math.nan)
    rows[299] = replace(rows[299], estimate=replace(rows[299].estimate, voltage_V=14.8))  # 15.0 V before and after
    assert in_air(rows).flying[300:400].all()


@pytest.mark.parametrize(("warning", "is_lost"), [(DEAD_CURRENT, True), (STUCK_CURRENT, True), (STUCK_VOLTAGE, False)])
def test_a_current_that_the_monitor_doubts_is_lost(warning: Notice, is_lost: bool) -> None:
    found = in_air(with_current(300.0, 400.0, 0.0, armed=True, warnings=(warning,)))
    assert found.lost[300:400].all() == is_lost and found.flying[300:400].all() == is_lost


def test_a_log_without_a_current_is_judged_by_its_voltage_alone() -> None:
    rows = with_current(0.0, math.inf, math.nan)
    assert not in_air(rows).flying.any()
    found = outcome(rows, CUTOFF_V)
    assert found.end_of_flight_s == pytest.approx(END_S, abs=3.0) and math.isnan(found.refused_in_air)
    assert found.checkpoints[0].before_end_s == pytest.approx(found.end_of_flight_s / 2.0, abs=1.0)
    assert found.landing is not None and found.landing.time_s == 720.0
