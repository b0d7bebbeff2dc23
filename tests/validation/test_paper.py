"""The study's method against the tables it prints, and each of its slips."""

import math

import numpy as np
import pytest

from uavbatt import dataset
from uavbatt.validation.iso5725 import intermediate, outliers, trueness
from uavbatt.validation.judging import drift
from uavbatt.validation.study import paper
from uavbatt.validation.study import paper_equations as eq

COLUMN_0_MIN = np.array([12.52, 12.48, 12.49, 12.52, 12.48, 12.49, 12.51, 12.49, 12.49, 12.50])  # Table 4


@pytest.fixture(scope="module")
def study():
    return dataset.load()


@pytest.fixture(scope="module")
def replay(study):
    return paper.replay(study)


@pytest.fixture(scope="module")
def volts(study):
    return dataset.levels(study, 25)


def test_agreement_with_the_printed_tables(replay):
    assert [(a.table, a.agree, a.total) for a in replay.agreements] == [
        ("Table 5", 45, 45), ("Table 8", 25, 27), ("Table 9", 26, 27),
    ]  # fmt: skip


def test_each_slip_is_named(replay):
    slips = [s for a in replay.agreements for s in a.slips]
    assert slips == [
        "Table 8, S² at 1 min: 0.0023 printed, 0.002247 computed",
        "Table 8, C at 6 min: 0.190 printed, 0.1855 computed",
        "Table 9, C at 5 min: 0.199 printed, 0.1997 computed",
    ]


def test_one_changed_reading_is_noticed(study):
    run = study.runs[0]
    volts = run.voltage_V.copy()
    volts[0] += 0.01
    changed = type(run)(run.sample, run.run, run.ambient_C, run.time_s, volts, run.current_A, run.surface_C)
    fields = {f: getattr(study, f) for f in type(study).__dataclass_fields__}
    again = paper.replay(type(study)(**{**fields, "runs": (changed, *study.runs[1:])}))
    assert again.agreements[0].agree == 45 - 9


def test_F_emp_cannot_be_reproduced(replay):
    claim = replay.fisher
    assert not claim.reproducible
    assert claim.at_first_instant == pytest.approx((1.177, 1.386), abs=5e-4)
    assert claim.nearest == pytest.approx(1.796, abs=5e-4)
    assert claim.critical == pytest.approx(claim.critical_printed, abs=5e-3)


def test_the_drift_ratios_are_those_of_table_2(replay):
    assert not any(c.drifts for c in replay.columns if c.quantity == "voltage_V")
    ratios = [c.drift_ratio for c in replay.columns if c.quantity == "surface_C"]
    assert [i for i, r in enumerate(ratios) if r >= 0.2] == [2, 7]
    table_2 = [round(c.drift_ratio, 3) for c in replay.columns[:9]]
    assert table_2 == [0.149, 0.105, 0.065, 0.070, 0.022, 0.019, 0.023, 0.189, 0.096]


def test_pair_differences_of_table_5():
    a = eq.eq5_pair_differences(COLUMN_0_MIN)
    assert len(a) == 45
    assert a.mean() == pytest.approx(0.002889, abs=5e-7)
    assert eq.eq6_pair_sd(a) == pytest.approx(0.021173, abs=5e-7)
    assert eq.eq7_repeatability_limit(eq.eq6_pair_sd(a)) == pytest.approx(0.05928, abs=5e-6)


def test_root_two_is_counted_twice():
    iso_r = 2.8 * np.std(COLUMN_0_MIN, ddof=1)
    paper_r = eq.eq7_repeatability_limit(eq.eq6_pair_sd(eq.eq5_pair_differences(COLUMN_0_MIN)))
    assert iso_r == pytest.approx(0.0418, abs=5e-5)
    assert paper_r / iso_r == pytest.approx(math.sqrt(2), rel=0.02)


def test_the_sums_and_divisors_are_those_that_the_numbers_follow(volts, study):
    heat = dataset.levels(study, 25, "surface_C").values[:, 0, 2]
    assert eq.eq4_sd(heat) == pytest.approx(0.7913, abs=5e-5)
    cells = [np.array(c) for c in volts.cells(0)]
    means, variances = np.array([c.mean() for c in cells]), np.array([c.var(ddof=1) for c in cells])
    between = eq.eq15_between_variance(means)
    R = eq.eq16_reproducibility_limit(eq.eq14_sigma_R(between, eq.within_variance(variances)))
    assert pytest.approx(0.0390, abs=5e-5) == R


def test_equation_17_is_the_variance_of_the_pooled_results(volts, replay):
    pooled = [np.concatenate(volts.cells(i)).var(ddof=1) for i in range(9)]
    assert [p.S2 for p in replay.pooled] == pytest.approx(pooled, rel=1e-9)


def test_student_and_fisher_of_every_column(replay):
    t = [round(p.t, 3) for p in replay.pooled]
    assert t == [0.323, 0.184, 0.268, 0.181, 0.089, 0.604, 0.282, 0.635, 0.000]
    assert [round(p.F, 3) for p in replay.pooled] == [1.386, 1.448, 1.077, 1.128, 1.127, 1.796, 1.011, 1.645, 1.000]
    assert all(p.may_pool for p in replay.pooled)
    assert replay.pooled[0].t_critical == pytest.approx(2.101, abs=5e-4)


def test_b_against_R_can_hardly_fail(replay):
    assert sum(p.share_beyond_R for p in replay.pooled) == 0


def test_sample_2_temperatures_are_rebuilt(replay):
    variances = [round(p.variances[1], 5) for p in replay.pooled_surface]
    assert variances == [0, 0, 0.32278, 0.00489, 0.00622, 0.009, 0.11433, 0.02222, 0.009]
    assert [round(p.means[1], 2) for p in replay.pooled_surface] == [
        22.60, 25.60, 31.25, 33.36, 35.48, 36.77, 36.01, 35.20, 34.67,
    ]  # fmt: skip


def test_pooling_of_temperature_breaks_the_study_s_own_rules(replay):
    broken = [int(p.time_s / 60) for p in replay.pooled_surface if not p.may_pool]
    assert broken == [0, 1, 4]
    assert replay.pooled_surface[4].t == pytest.approx(2.19, abs=5e-3)


def test_lattice_refuses_what_readings_of_a_tenth_cannot_give():
    assert paper.lattice_sum_of_squares(0.056, 1e-4, 35.48, 10) == pytest.approx(0.056)
    assert paper.lattice_sum_of_squares(0.065, 1e-4, 35.48, 10) is None


def test_repeatability_by_column_of_the_study(volts):
    s_r = [round(float(np.std(volts.cells(i)[0], ddof=1)), 4) for i in range(9)]
    assert s_r == [0.0149, 0.0529, 0.0510, 0.0479, 0.0515, 0.0587, 0.0948, 0.0118, 0.0116]
    ranges = [trueness.range_check(volts.cells(i)[0], s_r[i]) for i in range(9)]
    assert all(r.ok for r in ranges)
    assert [round(r.pair_share_beyond * 45) for r in ranges] == [0, 0, 1, 2, 3, 3, 2, 0, 0]


def test_abbe_and_mann_kendall_of_table_2(volts):
    columns = [volts.values[:, 0, i] for i in range(9)]
    abbe = [drift.abbe(c) for c in columns]
    assert [round(a.statistic, 3) for a in abbe] == [1.294, 0.252, 0.331, 0.337, 0.531, 0.778, 1.351, 0.160, 0.207]
    assert [a.p_value < 0.05 for a in abbe] == [False, True, True, True, True, False, False, True, True]
    assert [drift.mann_kendall(c).S for c in columns] == [1, -23, -26, -28, -18, -12, -10, -27, -25]
    assert drift.slope(columns[1]).per_run == pytest.approx(-0.0136, abs=5e-5)
    step = drift.drift(columns[1]).step
    assert (step.after, round(step.size, 3), round(step.p_at_place, 3)) == (6, -0.097, 0.003)


def test_outliers_that_the_study_did_not_test(volts):
    table_6 = outliers.grubbs(volts.values[:, 1, 5])
    assert (round(table_6.statistic_low, 3), table_6.verdict_low) == (2.487, "outlier")
    table_2 = outliers.grubbs(volts.values[:, 0, 5])
    assert (round(table_2.statistic_low, 3), table_2.verdict_low) == (2.298, "straggler")
    pair = outliers.double_grubbs(volts.values[:, 0, 4])
    assert (round(pair.statistic_low, 3), pair.verdict_low) == (0.149, "straggler")


def test_occasion_carries_the_spread_of_the_study(volts):
    found = [intermediate.crossed(volts.values[:, :, i]) for i in range(9)]
    assert [round(1e3 * f.s_r, 1) for f in found] == [4.5, 9.5, 14.6, 3.7, 5.6, 21.1, 23.5, 3.4, 3.3]
    assert [round(1e3 * f.s_occasion) for f in found] == [13, 48, 48, 49, 50, 47, 92, 10, 11]
    assert all(f.reproducibility == "not enough data" for f in found)
