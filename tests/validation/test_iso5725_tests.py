"""Outliers, critical values, intervals, limits, drift and independence: facts and refusals."""

import math
from itertools import pairwise

import numpy as np
import pytest

from uavbatt.errors import NotEnoughData, UavbattError
from uavbatt.validation import iso5725
from uavbatt.validation.iso5725 import intermediate, intervals, outliers, trueness
from uavbatt.validation.judging import bands, drift, independence

CELLS = [[1.0, 1.2, 0.9], [1.1, 1.3, 1.0], [0.8, 1.1, 1.0], [1.2, 1.0, 1.1]]


@pytest.mark.parametrize(
    ("p", "five", "one"),
    [(4, 1.481, 1.496), (5, 1.715, 1.764), (6, 1.887, 1.973), (8, 2.127, 2.274), (10, 2.290, 2.482),
     (12, 2.412, 2.636), (15, 2.548, 2.806), (20, 2.708, 3.001)],
)  # fmt: skip
def test_grubbs_critical_values_of_iso_table_5(p, five, one):
    assert outliers.grubbs_critical(p, 0.05) == pytest.approx(five, abs=6e-4)
    assert outliers.grubbs_critical(p, 0.01) == pytest.approx(one, abs=6e-4)


@pytest.mark.parametrize(
    ("p", "n", "five", "one"),
    [(8, 3, 0.516, 0.615), (10, 2, 0.602, 0.718), (2, 10, 0.801, 0.867), (20, 5, 0.192, 0.229)],
)
def test_cochran_critical_values(p, n, five, one):
    assert outliers.cochran_critical(p, n, 0.05) == pytest.approx(five, abs=3e-3)
    assert outliers.cochran_critical(p, n, 0.01) == pytest.approx(one, abs=6e-3)


def test_mandel_critical_values_of_wilrich_and_e691():
    assert outliers.h_critical(8, 0.05) == pytest.approx(1.749, abs=5e-4)
    assert outliers.h_critical(8, 0.01) == pytest.approx(2.065, abs=5e-4)
    assert outliers.k_critical(8, 3, 0.05) == pytest.approx(1.669, abs=5e-4)
    assert outliers.h_critical(8, 0.005) == pytest.approx(2.15, abs=5e-3)
    assert outliers.k_critical(8, 3, 0.005) == pytest.approx(2.06, abs=5e-3)


def test_double_grubbs_values_are_packaged_from_4_to_40():
    assert outliers.double_grubbs_critical(10, 0.05) == pytest.approx(0.1864, abs=5e-4)  # ISO 5725-2 Table 5
    assert outliers.double_grubbs_critical(10, 0.01) == pytest.approx(0.1150, abs=5e-4)
    values = [outliers.double_grubbs_critical(p, 0.05) for p in range(4, 41)]
    assert all(a < b for a, b in pairwise(values))
    assert math.isnan(outliers.double_grubbs_critical(41, 0.05))
    assert outliers.double_grubbs(np.arange(50.0)).verdict_high is None


def test_cochran_critical_value_has_its_size():
    rng = np.random.default_rng(1)
    s2 = rng.standard_normal((40_000, 8, 3)).var(axis=2, ddof=1)
    size = np.mean(s2.max(axis=1) / s2.sum(axis=1) > outliers.cochran_critical(8, 3, 0.05))
    assert size == pytest.approx(0.05, abs=0.005)


def test_grubbs_finds_the_one_and_double_grubbs_the_pair():
    one = iso5725.scrutinise([[v, v + 0.01] for v in (1.0, 1.1, 0.9, 1.05, 0.95, 1.02, 3.0)])
    assert one.grubbs.verdict_high == "outlier" and one.grubbs.index_high == 6
    assert one.double is None and one.retest is not None  # one was found: drop it, no pair test
    pair = iso5725.scrutinise([[v, v + 0.01] for v in (1.0, 1.1, 0.9, 1.05, 0.95, 1.02, 3.0, 3.01)])
    assert pair.grubbs.verdict_high == "ok"  # they hide each other
    assert pair.double.verdict_high == "outlier" and set(pair.double.indices_high) == {6, 7}


def test_h_never_passes_its_bound():
    h = iso5725.mandel([[0.0, 0.1], [0.0, 0.1], [0.0, 0.1], [9.0, 9.1]]).h
    assert abs(h).max() == pytest.approx(3 / math.sqrt(4))


def test_two_samples_have_no_critical_h_and_no_spread_is_handled():
    two = iso5725.mandel([[1.0, 2.0], [1.0, 3.0]])
    assert math.isnan(two.h_critical_5) and two.notes
    flat = iso5725.mandel([[1.0, 1.0]] * 4)
    assert not flat.h.any() and not flat.k.any()
    assert iso5725.cochran([[1.0, 1.0]] * 4).verdict == "ok"
    assert iso5725.grubbs([1.0, 1.0, 1.0]).verdict_low == "ok"


def test_equal_pooling_of_k_is_the_same_for_equal_numbers():
    assert iso5725.mandel(CELLS).k == pytest.approx(iso5725.mandel(CELLS, pooling="equal").k)


@pytest.mark.parametrize(
    "cells", [[], [[]], [[1.0, math.nan]], [["a", "b"]], [[[1.0, 2.0]]], 5, "12", [[1.0, math.inf]]]
)
def test_bad_cells_are_value_errors_in_one_line(cells):
    with pytest.raises(ValueError) as raised:
        iso5725.precision(cells)
    assert isinstance(raised.value, UavbattError)
    assert "\n" not in str(raised.value)


def test_what_too_few_results_cannot_tell():
    with pytest.raises(NotEnoughData):
        iso5725.precision([[1.0], [2.0], [3.0]])
    one = iso5725.precision([[1.0, 2.0, 3.0]])
    assert one.s_r == 1.0 and math.isnan(one.s_R) and one.reproducibility == "not enough data"
    assert iso5725.precision(CELLS[:2]).reproducibility == "not enough data"
    assert iso5725.precision(CELLS).reproducibility == "ok"
    with pytest.raises(NotEnoughData):
        iso5725.cochran([[1.0, 2.0]])
    with pytest.raises(NotEnoughData):
        iso5725.grubbs([1.0, 2.0])


def test_relative_uncertainties_of_iso_5725_1():
    """p = 2, n = 10: A_r 33 %; A_R 33, 56, 108, 134 % at γ = 1, 1.2, 2, 5."""
    assert iso5725.relative_uncertainty_r(18) == pytest.approx(0.33, abs=5e-3)
    found = [iso5725.relative_uncertainty_R(2, 10, g) for g in (1, 1.2, 2, 5)]
    assert found == pytest.approx([0.33, 0.56, 1.08, 1.34], abs=6e-3)


def test_interval_of_a_between_sample_sd():
    assert intervals.sd_interval(1.0, 1) == pytest.approx((0.446, 31.9), abs=0.05)
    assert intervals.sd_interval(1.0, 7) == pytest.approx((0.66, 2.04), abs=6e-3)


def test_intervals_cover_the_truth():
    rng = np.random.default_rng(2)
    hits = np.zeros(3)
    for _ in range(400):
        found = iso5725.precision(rng.normal(0, 1.5, (6, 1)) + rng.normal(0, 1, (6, 4)))
        truth = (1.0, 1.5, math.hypot(1, 1.5))
        ends = (found.s_r_interval, found.s_L_interval, found.s_R_interval)
        hits += [low <= t <= high for t, (low, high) in zip(truth, ends, strict=True)]
    assert np.all(hits / 400 > 0.92)


def test_crossed_model_recovers_what_was_put_in():
    rng = np.random.default_rng(3)
    y = 12 + rng.normal(0, 3, (400, 1)) + rng.normal(0, 2, (1, 400)) + rng.normal(0, 1, (400, 400))
    found = intermediate.crossed(y)
    assert (found.s_occasion, found.s_sample, found.s_r) == pytest.approx((3, 2, 1), rel=0.1)
    assert found.s_R == pytest.approx(math.sqrt(found.s_I**2 + found.s_sample**2))
    assert found.reproducibility == "ok"


def test_crossed_with_one_sample_or_gaps():
    one = intermediate.crossed([[1.0], [2.0], [4.0]])
    assert math.isnan(one.s_r) and one.s_I == pytest.approx(np.std([1, 2, 4], ddof=1))
    gap = intermediate.crossed([[1.0, 1.1], [2.0, math.nan], [4.0, 4.2], [3.0, 3.1]])
    assert gap.occasions == 3 and "left out" in gap.notes[0]
    with pytest.raises(NotEnoughData):
        intermediate.crossed([[1.0, 2.0]])


def test_staggered_nested_recovers_what_was_put_in():
    rng = np.random.default_rng(4)
    p = 20_000
    lab, day, e = rng.normal(0, 2, p), rng.normal(0, 1, (p, 2)), rng.normal(0, 0.5, (p, 3))
    y = np.column_stack([lab + day[:, 0] + e[:, 0], lab + day[:, 0] + e[:, 1], lab + day[:, 1] + e[:, 2]])
    found = intermediate.staggered(y)
    assert (found.s_0, found.s_1, found.s_r) == pytest.approx((2, 1, 0.5), rel=0.03)


def test_the_degrees_of_freedom_of_a_staggered_design_follow_from_its_expected_mean_squares():
    """The expected mean squares, solved for s_0² + s_1² + s_r², give Satterthwaite's df without our formula."""
    rng = np.random.default_rng(5)
    lab, setting = rng.normal(30.0, 2.0, (12, 1)), rng.normal(0.0, 1.5, (12, 2))
    y = lab + setting[:, [0, 0, 1]] + rng.normal(0.0, 0.5, (12, 3))
    found = intermediate.staggered(y)
    assert min(found.raw) > 0.0 and found.mean == pytest.approx(y.mean())
    expected = np.array([[3.0, 5.0 / 3.0, 1.0], [0.0, 4.0 / 3.0, 1.0], [0.0, 0.0, 1.0]])
    parts = np.linalg.solve(expected.T, np.ones(3)) * found.mean_squares
    assert parts.sum() == pytest.approx(found.s_R**2)
    assert found.df_total == pytest.approx(parts.sum() ** 2 / np.sum(parts**2 / np.array(found.dfs)))


def test_the_mean_of_a_nested_design_is_that_of_its_results_wherever_they_lie():
    y = np.random.default_rng(6).normal(1000.0, 1.0, (5, 2, 2))
    assert intermediate.nested(y).mean == pytest.approx(y.mean(), abs=1e-9)


def test_the_uncertainty_of_a_crossed_mean_is_how_such_means_scatter():
    """Four occasions of three samples, the same ones each time: 3,000 such tables."""
    rng = np.random.default_rng(7)
    tables = rng.normal(0, 0.5, (3000, 4, 1)) + np.array([0.0, 1.0, -1.0]) + rng.normal(0, 1.5, (3000, 4, 3))
    found = [intermediate.crossed(table) for table in tables]
    stated = np.mean([one.mean_squares[0] / 12 for one in found])  # without the limit of a variance to 0
    assert np.var([one.mean for one in found]) == pytest.approx(stated, rel=0.06)
    held = [one for one in found if one.s_occasion > 0.0]
    assert [one.u_mean**2 for one in held] == pytest.approx([one.mean_squares[0] / 12 for one in held])


def test_range_factors_of_iso_5725_6():
    factors = [round(trueness.range_factor(n), 1) for n in range(2, 11)]
    assert factors == [2.8, 3.3, 3.6, 3.9, 4.0, 4.2, 4.3, 4.4, 4.5]


def test_bias_of_one_laboratory():
    found = trueness.laboratory_bias([10.1, 10.2, 10.3], 10.0)
    assert found.bias == pytest.approx(0.2)
    assert found.interval[1] - found.bias == pytest.approx(4.3027 * 0.1 / math.sqrt(3), rel=1e-4)
    assert not found.significant
    assert trueness.laboratory_bias([10.1, 10.2, 10.3], 9.0).significant


def test_bias_of_a_method_with_known_precision_uses_A():
    cells, p, n, gamma = [[1.0, 1.2], [1.1, 1.3], [0.9, 1.1]], 3, 2, 2.0
    found = trueness.method_bias(cells, 1.0, sigma_r=0.1, sigma_R=0.1 * gamma)
    A = 1.96 * math.sqrt((n * (gamma**2 - 1) + 1) / (gamma**2 * p * n))  # ISO 5725-4
    assert found.interval[1] - found.bias == pytest.approx(A * 0.1 * gamma)


def test_precision_check_fails_a_method_that_scatters_more_than_claimed():
    rng = np.random.default_rng(5)
    cells = rng.normal(0, 0.1, (6, 5))
    assert trueness.precision_check(cells, 0.1, 0.1 * 1.2).ok
    assert not trueness.precision_check(cells, 0.05, 0.06).ok


def test_mann_kendall_is_exact_with_and_without_ties():
    rising = drift.mann_kendall(np.arange(5.0))
    assert (rising.S, rising.p_value) == (10, pytest.approx(2 / 120))
    tied = drift.mann_kendall([1.0, 1.0, 2.0, 2.0])  # 6 orders of two pairs, one of them this, one its mirror
    assert (tied.S, tied.p_value) == (4, pytest.approx(2 / 6))
    assert drift.mann_kendall([1.0] * 6).p_value == 1.0


def test_abbe_limits_of_the_tables():
    """Critical values for n = 10: 0.531 at 5 %, 0.376 at 1 %."""
    x = np.random.default_rng(6).standard_normal((100_000, 10))
    assert np.quantile(drift.abbe_ratio(x), [0.05, 0.01]) == pytest.approx([0.531, 0.376], abs=6e-3)


def test_paper_drift_rule_is_blind_to_a_step_that_returns():
    values = [0.0, 0.1, -0.1, 0.05, 5.0, 5.1, 4.9, 5.05, 5.0, 0.0]
    assert not drift.paper_rule(values).significant
    found = drift.drift(values[:-1]).step
    assert found.after == 4 and found.p_value < 0.05
    assert drift.abbe(values).p_value < 0.05


def test_paper_drift_rule_raises_a_fifth_of_false_alarms():
    rng = np.random.default_rng(7)
    alarms = [drift.paper_rule(rng.standard_normal(10)).significant for _ in range(4000)]
    assert np.mean(alarms) == pytest.approx(0.22, abs=0.02)


def test_slope_is_per_run():
    found = drift.slope([1.0, 3.0, 5.0, 7.1])
    assert found.per_run == pytest.approx(2.03) and found.theil_sen == pytest.approx(2.0, abs=0.05)


def test_independent_samples_pass_and_copies_do_not():
    rng = np.random.default_rng(8)
    a, b = rng.normal(0, 1, (10, 9)).round(1), rng.normal(0, 1, (10, 9)).round(1)
    assert independence.independence(a, b).dependent is False
    assert independence.independence(a, a + 0.001).dependent is True
    assert independence.independence(a[:4], b[:4]).dependent is None  # 24 orders cannot reach p < 0.01


def test_two_groups_are_seen_and_coarse_readings_alone_are_not():
    assert independence.bimodality([1.0, 1.1, 1.0, 1.1, 5.0, 5.1, 5.0], 0.1).bimodal
    assert not independence.bimodality([1.0, 1.0, 1.1, 1.1, 1.0, 1.1, 1.0], 0.1).bimodal
    assert independence.resolution([1.0, 1.1, 1.0, 1.1]).coarse
    assert not independence.resolution(np.linspace(0, 1, 50)).coarse


def test_tolerance_factors_95_95():
    assert bands.tolerance_factor(10, 9) == pytest.approx(3.38, abs=0.005)
    assert bands.tolerance_factor(20, 19) == pytest.approx(2.752, abs=0.005)
