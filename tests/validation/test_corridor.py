"""Corridors, crossing times, series of one-time tests."""

import math

import numpy as np
import pytest

from uavbatt import dataset
from uavbatt.validation.judging import bands, corridor, series
from uavbatt.validation.judging.crossing import crossing_time, downward_crossings
from uavbatt.validation.judging.readings import read_once


@pytest.fixture(scope="module")
def study():
    return dataset.load()


@pytest.fixture(scope="module")
def readings(study):
    return read_once(study)


@pytest.fixture(scope="module")
def band(readings):
    return corridor.corridor(readings, 25)


def run_at(study, ambient_C):
    return next(r for r in study.runs if r.sample == "T1" and r.ambient_C == ambient_C)


def test_study_corridor_is_table_8_unrounded(band):
    assert band.mean == pytest.approx([12.496, 11.045, 10.849, 10.717, 10.607, 10.472, 10.128, 9.3665, 9.357])
    assert [round(c, 4) for c in band.C] == [0.0271, 0.0948, 0.0977, 0.0963, 0.0974, 0.1019, 0.1855, 0.0208, 0.0226]
    assert (band.occasions, band.samples, band.basis, band.status) == (10, 2, "repeats", "ok")


def test_two_dependent_samples_count_as_ten_occasions(band):
    assert np.all((band.n_effective > 9.9) & (band.n_effective < 11))
    assert np.all((band.df > 8.9) & (band.df < 11))


def test_half_widths_are_in_order(band):
    assert np.all(band.tolerance > band.C)
    assert np.all(band.simultaneous > band.C)


def test_C_holds_two_curves_of_three_and_the_simultaneous_band_nearly_all(study, band):
    left = corridor.leave_one_out(dataset.levels(study, 25))
    assert (int(left.inside.sum()), left.inside.size) == (13, 20)
    out = {(o, s) for o, row in zip(left.occasions, left.inside, strict=True)
           for s, ok in zip(left.samples, row, strict=True) if not ok}  # fmt: skip
    assert out == {(o, s) for o in (4, 6, 8) for s in "12"} | {(9, "2")}
    assert band.covers_all == pytest.approx(0.65, abs=0.04)


def test_simultaneous_band_has_its_coverage():
    """New curves from the same process: 95 % inside at all levels, whatever the correlation."""
    rng = np.random.default_rng(9)
    root = np.array([[1.0, 0, 0], [0.8, 0.6, 0], [0.5, 0.2, 0.7]]).T
    inside = 0
    for _ in range(60):
        table = (rng.standard_normal((10, 1, 3)) @ root) + 0.3 * rng.standard_normal((10, 2, 3))
        found = corridor.from_table(25.0, "voltage_V", np.arange(3.0), table)
        new = rng.standard_normal((200, 3)) @ root + 0.3 * rng.standard_normal((200, 3))
        inside += found.inside(new, found.simultaneous).all(axis=1).sum()
    assert inside / 12_000 == pytest.approx(0.95, abs=0.02)


def test_the_seed_makes_the_band_repeatable(readings, band):
    again = corridor.corridor(readings, 25)
    assert np.array_equal(again.simultaneous, band.simultaneous)


def test_one_time_curve_at_25_is_outside_at_five_minutes(study, band):
    out = ~band.inside(run_at(study, 25).voltage_V)
    assert list(np.flatnonzero(out)) == [1, 5, 6, 7, 8]
    wide = ~band.inside(run_at(study, 25).voltage_V, bands.tolerance_factor(20, 19) * band.S)
    assert list(np.flatnonzero(wide)) == [6, 7, 8]


def test_crossing_times_of_the_study(readings):
    found = corridor.time_corridor(readings, 25)
    rows = [int(np.argmin(np.abs(found.at - level_V))) for level_V in (10.0, 9.5)]
    assert found.mean[rows] / 60 == pytest.approx([6.15, 6.82], abs=0.005)
    assert pytest.approx([0.12, 0.03], abs=0.005) == found.S[rows] / 60
    assert found.quantity == "crossing_s" and np.all(np.diff(found.mean) < 0)


@pytest.mark.parametrize(
    ("ambient_C", "minutes_10", "minutes_9_5"),
    [(50, 6.40, 6.88), (40, 6.00, 6.81), (25, 5.38, 5.91), (5, 4.54, 5.73), (4, 5.02, 5.93), (0, 5.06, 6.15),
     (-10, 4.28, 5.96)],
)  # fmt: skip
def test_knee_times_of_table_1(study, ambient_C, minutes_10, minutes_9_5):
    run = run_at(study, ambient_C)
    times = [crossing_time(run.time_s, run.voltage_V, v) / 60 for v in (10.0, 9.5)]
    assert times == pytest.approx([minutes_10, minutes_9_5], abs=0.0051)


def test_a_cold_pack_crosses_twice(study):
    run = run_at(study, -17)
    falls = downward_crossings(run.time_s, run.voltage_V, 10.0) / 60
    assert falls == pytest.approx([0.94, 3.10], abs=0.005)
    first, last, held = (crossing_time(run.time_s, run.voltage_V, 10.0, w) / 60 for w in ("first", "last", "held"))
    assert (first, last, held) == pytest.approx((0.94, 3.10, 3.10), abs=0.005)
    assert math.isnan(crossing_time(run.time_s, run.voltage_V, 5.0))


def test_series_break_where_the_study_broke(readings):
    assert [(b.low_C, b.high_C) for b in readings.broken] == [(4, 5), (35, 40)]
    assert [b.jump_s > 0 for b in readings.broken] == [False, True]


def test_quasi_replicates_stop_at_the_break_and_name_what_is_left_out(readings):
    cold, hot = readings.near_repeats
    assert list(cold.ambients_C) == list(range(-5, 5))
    assert list(hot.ambients_C) == list(range(45, 51))
    assert [round(1e3 * s) for s in cold.sd] == [7, 46, 23, 30, 28, 37, 46, 16, 22]
    assert cold.left_out == ("Table 1, -1 °C, 1 min",)
    whole = series.quasi_replicates(readings.series, readings.broken)[0]
    assert round(1e3 * whole.sd[1]) == 93


def test_a_corridor_is_refused_where_nothing_was_repeated(readings):
    found = corridor.corridors(readings)
    known = {t for t, c in found.items() if c.status == "ok"}
    assert known == {25.0, *range(-5, 5), *range(45, 51)}
    assert found[10.0].status == "not enough data" and np.isnan(found[10.0].C).all()
    assert found[10.0].mean[6] == 9.39
    assert found[0.0].basis == "quasi-replicates"


def test_surface_temperature_has_a_corridor_of_one_sample(readings):
    found = corridor.corridor(readings, 25, "surface_C")
    assert (found.occasions, found.samples) == (10, 1)
    assert found.C[2] == pytest.approx(1.583, abs=5e-4)
    assert corridor.corridor(readings, 10, "surface_C") is None


def levels_of(values):
    o, k, n = values.shape
    names, runs = tuple("abcdef"[:k]), tuple(range(1, o + 1))
    return dataset.Levels(25.0, "voltage_V", names, runs, 60.0 * np.arange(n), values)


def test_a_sample_with_few_runs_is_left_out_by_name():
    values = np.random.default_rng(10).normal(10, 1, (6, 2, 3))
    values[2:, 1] = math.nan
    shared = corridor.shared_table(levels_of(values))
    assert shared.samples == ("a",) and shared.table.shape == (6, 1, 3)
    assert "sample b left out: 2 of 6" in shared.notes[0]


def test_samples_that_share_no_occasion_are_taken_in_order():
    values = np.random.default_rng(11).normal(10, 1, (6, 2, 3))
    values[3:, 0] = values[:3, 1] = math.nan
    shared = corridor.shared_table(levels_of(values))
    assert shared.table.shape == (3, 2, 3) and "share no occasions" in shared.notes[-1]
