"""Formulas of ISO 5725 against closed forms, and the few results with which each still tells something."""

import math

import numpy as np
import pytest
from scipy import stats

from uavbatt.errors import NotEnoughData
from uavbatt.validation import iso5725
from uavbatt.validation.iso5725 import cells, intermediate, intervals, outliers, trueness
from uavbatt.validation.judging import bands, drift

# Occasion x sample: mean 10, occasions -1, 0, 1, samples -2, 2, and a rest whose rows and columns sum to 0.
REST = np.array([[0.5, -0.5], [-0.5, 0.5], [0.0, 0.0]])
TABLE = 10.0 + np.array([[-1.0], [0.0], [1.0]]) + np.array([[-2.0, 2.0]]) + REST


def test_the_mean_squares_of_a_table_made_of_its_parts_are_those_of_the_parts():
    found = intermediate.crossed(TABLE)
    assert found.mean == pytest.approx(10.0)
    assert found.mean_squares == pytest.approx((2 * 2.0 / 2, 3 * 8.0 / 1, 1.0 / 2))
    assert (found.s_occasion, found.s_sample, found.s_r) == pytest.approx(
        (math.sqrt(0.75), math.sqrt(23.5 / 3), math.sqrt(0.5))
    )


def test_the_f_tests_of_a_table_have_the_closed_forms_of_two_degrees_of_freedom():
    found = intermediate.crossed(TABLE)
    assert found.p_occasion == pytest.approx(1 / (1 + 4.0))  # F = 4 with (2, 2)
    t = math.sqrt(48.0)  # F = 48 with (1, 2) is t² with 2
    assert found.p_sample == pytest.approx(1 - t / math.sqrt(t**2 + 2))
    ends = [math.sqrt(0.5 * 2 / (-2 * math.log(q))) for q in (0.025, 0.975)]  # chi² with 2 is exponential
    assert found.s_r_interval == pytest.approx(ends)


def test_samples_that_agree_at_each_occasion_have_no_test():
    found = intermediate.crossed([[1.0, 2.0], [2.0, 3.0], [3.0, 4.0]])
    assert found.s_r == 0.0
    assert math.isnan(found.p_occasion) and math.isnan(found.p_sample)


@pytest.mark.parametrize(("samples", "said"), [(1, "1 sample:"), (2, "2 samples:")])
def test_too_few_samples_are_counted_in_words(samples, said):
    found = intermediate.crossed(TABLE[:, :samples])
    assert any(note.startswith(said) for note in found.notes)


def test_the_bias_of_a_laboratory_is_that_of_the_t_interval():
    results = [10.1, 10.25, 10.3, 10.05]
    found = trueness.laboratory_bias(results, 10.0)
    interval = stats.ttest_1samp(results, 10.0).confidence_interval(0.95)
    assert found.interval == pytest.approx((interval.low - 10.0, interval.high - 10.0))
    assert found.significant == (interval.low > 10.0)


def test_a_precision_that_is_claimed_as_found_has_ratios_of_one():
    table = [[1.0, 1.2, 0.9], [1.1, 1.3, 1.0], [2.8, 2.1, 2.0]]
    estimate = iso5725.precision(table)
    found = trueness.precision_check(table, estimate.s_r, estimate.s_R)
    assert (found.C_r, found.C_R) == pytest.approx((1.0, 1.0))
    twice = trueness.precision_check(table, 2.0 * estimate.s_r, 2.0 * estimate.s_R)
    assert (twice.C_r, twice.C_R) == pytest.approx((0.25, 0.25))
    assert found.limit_r == pytest.approx(12.592 / 6, abs=1e-3)  # chi²(0.95) of tables
    assert found.limit_R == pytest.approx(5.991 / 2, abs=1e-3)


@pytest.mark.parametrize(("s_r", "is_ok"), [(0.1, True), (0.09, False)])
def test_the_range_of_three_results_is_judged_by_3_3_s_r(s_r, is_ok):
    found = trueness.range_check([10.1, 10.4, 10.2], s_r)
    assert found.range == pytest.approx(0.3)
    assert found.critical_range == pytest.approx(3.3 * s_r)
    assert found.ok is is_ok
    assert found.pair_share_beyond == pytest.approx(1 / 3)  # 0.3 is beyond 2.8 s_r


@pytest.mark.parametrize(("sd", "df"), [(math.nan, 5), (1.0, 0.5)])
def test_an_interval_without_data_is_unknown(sd, df):
    assert all(math.isnan(end) for end in intervals.sd_interval(sd, df))


def test_reml_of_results_that_are_all_equal_is_their_mean():
    found = iso5725.precision([[3.0, 3.0], [3.0, 3.0, 3.0]], method="reml")
    assert (found.mean, found.s_r, found.s_L) == (3.0, 0.0, 0.0)
    assert iso5725.precision([[3.0, 3.0]], method="reml").mean == 3.0


@pytest.mark.parametrize(("p", "has_single", "has_double"), [(2, False, False), (3, True, False), (4, True, True)])
def test_each_test_for_outliers_has_the_number_of_samples_that_it_needs(p, has_single, has_double):
    found = iso5725.scrutinise([[v, v + 0.01] for v in (1.0, 1.1, 0.95, 1.06)[:p]])
    assert (found.grubbs is not None, found.double is not None) == (has_single, has_double)
    with pytest.raises(NotEnoughData):
        outliers.double_grubbs([1.0, 1.1, 1.2])


def test_of_three_values_a_tie_says_nothing_and_three_that_differ_do():
    assert outliers.grubbs([1.0, 1.0, 9.0]).verdict_high == "ok"
    assert outliers.grubbs([1.0, 1.0 + 1e-4, 9.0]).verdict_high != "ok"


def test_cells_of_one_result_have_an_h_and_no_k():
    found = iso5725.mandel([[1.0], [1.2], [1.7]])
    assert found.h == pytest.approx(np.array([-0.3, -0.1, 0.4]) / np.std([1.0, 1.2, 1.7], ddof=1))
    assert np.isnan(found.k).all()


def test_printed_statistics_may_have_an_sd_of_zero_and_a_single_result():
    found = cells.from_statistics([1.0, 1.1], [0.0, 0.0], [1, 3])
    assert math.isnan(found.variances[0]) and found.variances[1] == 0.0
    for sds, counts in (([-0.1, 0.0], [1, 3]), ([0.1, 0.1], [0, 3]), ([0.1, 0.1], [1.5, 3])):
        with pytest.raises(ValueError, match="expected SDs of at least 0"):
            cells.from_statistics([1.0, 1.1], sds, counts)


@pytest.mark.parametrize(
    ("gamma", "p", "printed"),
    [
        (1, 5, (0.46, 0.37, 0.32)), (1, 10, (0.32, 0.26, 0.22)), (1, 20, (0.22, 0.18, 0.16)),
        (2, 5, (0.61, 0.58, 0.57)), (2, 10, (0.41, 0.39, 0.38)), (2, 20, (0.28, 0.27, 0.26)),
        (5, 5, (0.68, 0.67, 0.67)), (5, 10, (0.45, 0.45, 0.45)), (5, 20, (0.31, 0.31, 0.31)),
    ],
)  # fmt: skip
def test_the_uncertainty_of_a_reproducibility_is_that_of_table_1_of_iso_5725_1(gamma, p, printed):
    """The only case that was tested had two laboratories, where a factor and a divisor of p - 1 are the same."""
    assert [iso5725.relative_uncertainty_R(p, n, gamma) for n in (2, 3, 4)] == pytest.approx(printed, abs=0.0065)


def test_two_samples_are_compared_as_by_the_t_test():
    one, other = [1.0, 1.2, 1.1, 1.3], [1.4, 1.25, 1.5, 1.35]
    found = iso5725.precision([one, other])
    assert found.p_value == pytest.approx(stats.ttest_ind(one, other).pvalue)


def test_without_spread_within_two_samples_the_interval_between_them_is_that_of_one_degree_of_freedom():
    found = iso5725.precision([[1.0, 1.0], [2.0, 2.0]])
    assert found.s_L == pytest.approx(math.sqrt(0.5))
    assert found.s_L_interval == pytest.approx((0.446 * found.s_L, 31.9 * found.s_L), rel=2e-3)


def test_one_sample_on_several_occasions_has_their_mean():
    assert intermediate.crossed([[1.0], [2.0], [4.0]]).mean == pytest.approx(7.0 / 3.0)


def test_the_mean_squares_of_a_staggered_design_of_two_laboratories():
    found = intermediate.staggered([[1.0, 2.0, 4.0], [5.0, 6.0, 8.0]])
    assert found.mean == pytest.approx(13.0 / 3.0)
    assert found.mean_squares == pytest.approx((3 * (4.0 + 4.0), 2 * (2.5**2 + 2.5**2) / 6, (1.0 + 1.0) / 4))
    assert found.dfs == (1.0, 2.0, 2.0)


def test_the_components_of_curves_are_those_of_each_level_alone():
    """The covariances over the levels have on their diagonal what the crossed model says of one level."""
    rng = np.random.default_rng(12)
    y = 12 + rng.normal(0, 3, (9, 1, 2)) + rng.normal(0, 2, (1, 4, 2)) + rng.normal(0, 1, (9, 4, 2))
    found, levels = bands.components(y), [intermediate.crossed(y[:, :, level]) for level in range(2)]
    assert np.diag(found.residual) == pytest.approx([one.s_r**2 for one in levels])
    assert np.diag(found.occasion) == pytest.approx([one.s_occasion**2 for one in levels])
    assert np.diag(found.sample) == pytest.approx([one.s_sample**2 for one in levels])
    alone = bands.components(y[:, :1])
    assert np.diag(alone.occasion) == pytest.approx([intermediate.crossed(y[:, :1, k]).s_I ** 2 for k in range(2)])


def test_the_variance_of_simulated_tables_is_that_of_the_crossed_model():
    rng = np.random.default_rng(13)
    y = rng.normal(0, 3, (5, 6, 1, 1)) + rng.normal(0, 2, (5, 1, 3, 1)) + rng.normal(0, 1, (5, 6, 3, 1))
    stated = [intermediate.crossed(table[:, :, 0]).s_R ** 2 for table in y]
    assert bands.crossed_variance(y)[:, 0] == pytest.approx(stated)
    pairs = y[:, :, :2]
    assert bands.crossed_variance(pairs)[:, 0] == pytest.approx(
        [intermediate.crossed(table[:, :, 0]).s_I ** 2 for table in pairs]
    )


def test_the_slope_over_runs_and_its_p_value_are_those_of_a_regression():
    values = [1.0, 3.0, 4.5, 7.1, 7.9, 11.2]
    found, line = drift.slope(values), stats.linregress(np.arange(6.0), values)
    assert (found.per_run, found.standard_error, found.p_value) == pytest.approx((line.slope, line.stderr, line.pvalue))


def test_a_table_that_does_not_vary_has_no_trend():
    assert drift.trend_share(np.ones((5, 3))) == 0.0
    assert drift.trend_share(np.column_stack([np.arange(5.0), np.ones(5)])) == pytest.approx(1.0)


def test_the_trend_test_of_many_runs_has_the_variance_of_random_orders():
    """Above 60 runs S is taken for normal: here with ties of two and three."""
    rng = np.random.default_rng(14)
    values = np.concatenate([np.arange(60.0), np.arange(15.0), np.arange(5.0)])
    shuffled = [drift.mann_kendall_S(rng.permutation(values)) for _ in range(4000)]
    found = drift.mann_kendall(np.sort(values)[rng.permutation(80)])
    z = stats.norm.isf(found.p_value / 2)
    assert not found.exact
    assert (abs(found.S) - 1) / z == pytest.approx(np.std(shuffled), rel=0.04)
