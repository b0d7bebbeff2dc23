"""Scores against closed forms, brute force and the properties their names promise."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate, stats

from uavbatt.scoring import metrics
from uavbatt.scoring.end_of_flight import end_of_flight
from uavbatt.scoring.scores import FlightScore, pool, score_flight

NAN = math.nan
Z90 = metrics.Z90


# --- the end of a flight ---------------------------------------------------------------------------------


def test_end_by_trailing_mean_ignores_a_dip() -> None:
    time = np.arange(0.0, 100.0, 0.5)
    volts = np.where(time < 60.0, 12.0, 9.0)
    volts[40] = 0.0  # half a second of nothing at 20 s: mean of ten rows 10.8 V
    # below 9.6 V when 9 of 10 rows in (t - 5, t] are at 9 V: the ninth such row is at 64 s
    assert end_of_flight(time, volts, cutoff_V=9.6) == pytest.approx(64.0)
    assert math.isnan(end_of_flight(time, volts, cutoff_V=8.0))


def test_end_is_not_judged_before_a_full_window() -> None:
    time, volts = np.arange(20.0), np.full(20, 9.0)
    assert end_of_flight(time, volts, cutoff_V=9.6) == 4.0
    assert math.isnan(end_of_flight([0.0, 1.0], [9.0, 9.0], cutoff_V=9.6))


def test_three_slow_rows_are_enough_for_one_median() -> None:
    assert end_of_flight([0.0, 12.0, 24.0], [9.0, 9.0, 9.0], cutoff_V=9.6) == 12.0


def test_end_of_slow_rows_by_centred_median_under_load() -> None:
    time = 12.0 * np.arange(10)
    volts = np.array([23.0, 22.0, 22.5, 22.0, 21.5, 21.4, 22.0, 21.3, 21.2, 21.1])
    amps = np.array([15.0] * 5 + [5.0] + [15.0] * 4)
    assert end_of_flight(time, volts, amps, cutoff_V=21.6, min_current_A=8.0) == 48.0
    amps[4] = 2.0  # medians are below from row 4 to 8; the first two carry no load now
    assert end_of_flight(time, volts, amps, cutoff_V=21.6, min_current_A=8.0) == 72.0
    amps[6] = NAN  # an unknown current proves no load
    assert end_of_flight(time, volts, amps, cutoff_V=21.6, min_current_A=8.0) == 84.0
    volts[9] = 20.0
    assert math.isnan(end_of_flight(time[7:], volts[7:], cutoff_V=21.15))  # the last row is not judged


def test_end_passes_over_rows_without_voltage() -> None:
    time = np.arange(40.0)
    volts = np.where(time < 20.0, 12.0, 9.0)
    volts[3:30:4] = NAN
    assert 20.0 < end_of_flight(time, volts, cutoff_V=9.6) <= 25.0


# --- formulas --------------------------------------------------------------------------------------------


def crps_gaussian(truth: float, mean: float, sd: float) -> float:
    """The closed form of Gneiting & Raftery (2007), eq. 21."""
    z = (truth - mean) / sd
    return sd * float(z * (2.0 * stats.norm.cdf(z) - 1.0) + 2.0 * stats.norm.pdf(z) - 1.0 / math.sqrt(math.pi))


@given(st.floats(-300, 300), st.floats(0.1, 80), st.floats(0.1, 80))
@settings(max_examples=40, deadline=None)
def test_crps_of_three_quantiles_is_the_integral(truth: float, s_lo: float, s_hi: float) -> None:
    def integrand(x: float) -> float:
        cdf = stats.norm.cdf(x / (s_lo if x < 0 else s_hi))
        return float((cdf - (x >= truth)) ** 2)

    got = float(metrics.crps_quantiles(truth, -Z90 * s_lo, 0.0, Z90 * s_hi))
    edges = sorted({-12 * s_lo - 1, 0.0, truth, 12 * s_hi + 1, truth - 1e3, truth + 1e3})
    parts = [integrate.quad(integrand, a, b, limit=200)[0] for a, b in itertools.pairwise(edges)]
    assert got == pytest.approx(sum(parts), rel=1e-5, abs=1e-5)


@given(st.floats(-50, 50), st.floats(0.1, 30))
def test_a_symmetric_interval_is_a_gaussian(truth: float, sd: float) -> None:
    three = metrics.crps_quantiles(truth, 100 - Z90 * sd, 100.0, 100 + Z90 * sd)
    assert three == pytest.approx(crps_gaussian(truth, 100.0, sd), rel=1e-9, abs=1e-9)


def test_a_point_forecast_has_the_absolute_error_as_crps() -> None:
    got = metrics.crps_quantiles([100.0, 40.0], [70.0, 70.0], [70.0, 70.0], [70.0, 70.0])
    assert got == pytest.approx([30.0, 30.0], abs=1e-6)
    assert math.isinf(float(metrics.crps_quantiles(100.0, 70.0, 90.0, math.inf)))


def test_binomial_interval_known_values() -> None:
    assert metrics.binomial_interval(27, 30) == pytest.approx((0.7347, 0.9789), abs=5e-5)  # Clopper-Pearson
    assert metrics.binomial_interval(0, 10) == pytest.approx((0.0, 1 - 0.025**0.1))
    assert metrics.binomial_interval(10, 10) == pytest.approx((0.025**0.1, 1.0))
    assert metrics.binomial_interval(0, 0) == (0.0, 1.0)


def test_mass_within_the_interval_is_ninety_percent() -> None:
    assert metrics.mass_within(80.0, 150.0, 80.0, 100.0, 150.0) == pytest.approx(0.9)
    assert metrics.mass_within(80.0, 100.0, 80.0, 100.0, 150.0) == pytest.approx(0.45)
    assert metrics.mass_within(90.0, 110.0, 100.0, 100.0, 100.0) == pytest.approx(1.0)


def test_percentage_interval_is_the_least_that_covers() -> None:
    share, width = metrics.percentage_interval([110.0, 80.0, 130.0, 50.0], [100.0, 100.0, 100.0, NAN], hits=3)
    assert share == pytest.approx(0.3)
    assert width == pytest.approx(2 * 0.3 * 75.0)
    assert math.isinf(metrics.percentage_interval([50.0], [NAN], hits=1)[0])


# --- one flight ------------------------------------------------------------------------------------------

END_S = 600.0
TIME_S = np.arange(0.0, 640.0, 10.0)
TRUE_S = END_S - TIME_S


def scored(error_s: float = 0.0, half_s: float = 20.0, **more: float) -> FlightScore:
    said = TRUE_S + error_s
    return score_flight("f", TIME_S, said, said - half_s, said + half_s, end_s=END_S, **more)  # type: ignore[arg-type]


def test_a_perfect_forecast() -> None:
    score = scored()
    assert list(score.at) == ["360 s", "240 s", "120 s", "60 s", "25%", "50%", "75%"]
    for instant in score.at.values():
        assert instant.error_s == pytest.approx(0.0, abs=1e-9) and instant.inside
        assert instant.width_s == pytest.approx(40.0)
    assert score.at["25%"].truth_s == 450.0
    assert score.cra == pytest.approx(1.0)
    assert score.horizon_s == 600.0 and score.coverage == 1.0 and score.refused == 0.0
    assert score.alarm_at_s == pytest.approx(120.0) and score.alarm_early_s == pytest.approx(0.0)
    assert score.crps_s == pytest.approx(20 / Z90 * (math.sqrt(2) - 1) / math.sqrt(math.pi))
    # alpha-lambda at half way: mass of N(300, 20/z) within 30 s
    assert score.alpha_lambda[0.1] == pytest.approx(2 * stats.norm.cdf(30 / (20 / Z90)) - 1)


def test_alpha_lambda_is_judged_half_way_to_the_end() -> None:
    half_way = TIME_S == 300.0
    assert score_flight("f", TIME_S, np.where(half_way, TRUE_S, 0.0), end_s=END_S).alpha_lambda[0.1] == 1.0
    assert score_flight("f", TIME_S, np.where(half_way, 0.0, TRUE_S), end_s=END_S).alpha_lambda[0.1] == 0.0


@pytest.mark.parametrize(("half_s", "horizon_s"), [(117.0, END_S), (188.5, 0.0)])  # 60 % and 40 % within 60 s
def test_the_horizon_needs_half_of_the_mass_within_its_band(half_s: float, horizon_s: float) -> None:
    assert scored(half_s=half_s).horizon_s == horizon_s


def test_an_instant_before_the_first_line_has_no_score() -> None:
    score = score_flight("f", TIME_S[36:], TRUE_S[36:], end_s=END_S)  # the first line comes 240 s before the end
    assert list(score.at) == ["240 s", "120 s", "60 s", "25%", "50%", "75%"]


def test_one_point_of_an_interval_is_no_interval() -> None:
    score = score_flight("f", TIME_S, TRUE_S, TRUE_S - 20.0, end_s=END_S)
    assert score.at["120 s"].inside is None and math.isnan(score.coverage)


def test_a_constant_error() -> None:
    score = scored(50.0)
    assert all(instant.error_s == pytest.approx(50.0) for instant in score.at.values())
    assert score.coverage == 0.0 and score.coverage_thirds == (0.0, 0.0, 0.0)
    assert score.alarm_at_s == pytest.approx(70.0) and score.alarm_early_s == pytest.approx(-50.0)
    kept = TRUE_S[(TRUE_S >= 30.0) & (TRUE_S > 0)]
    assert score.cra == pytest.approx(float(np.mean(1 - 50.0 / kept)))
    assert score.horizon_s == 600.0  # 50 s lies inside the band of 0.1 x 600 s
    assert scored(70.0).horizon_s == 0.0


def test_between_lines_the_last_one_less_its_age() -> None:
    score = score_flight("f", [0.0, 17.0, 34.0, 51.0], [105.0, 83.0, 66.0, 49.0], end_s=100.0)
    assert score.at["60 s"].forecast_s == pytest.approx(83.0 - 23.0 + 0.0)
    assert score.at["60 s"].inside is None and math.isnan(score.coverage)
    assert "120 s" not in score.at  # before the first line: not a miss, not a hit


@pytest.mark.parametrize(("last_s", "error_s"), [(301.0, 0.0), (299.0, -240.0)])
def test_a_line_is_in_force_for_a_minute(last_s: float, error_s: float) -> None:
    score = score_flight("f", [0.0, last_s, 500.0], [600.0, END_S - last_s, 100.0], end_s=END_S)
    assert score.at["240 s"].error_s == pytest.approx(error_s)


def test_silence_counts_as_refused() -> None:
    score = score_flight("f", [0.0, 500.0], [600.0, 100.0], end_s=END_S)
    assert math.isnan(score.at["240 s"].forecast_s) and score.at["240 s"].error_s == -240.0
    assert score.at["60 s"].error_s == pytest.approx(0.0)


def test_the_horizon_starts_after_the_last_miss() -> None:
    said = TRUE_S + np.where(TIME_S < 300.0, 200.0, 0.0)
    score = score_flight("f", TIME_S, said, said - 5, said + 5, end_s=END_S)
    assert score.horizon_s == 300.0
    said[40] = NAN  # at 400 s
    assert score_flight("f", TIME_S, said, said - 5, said + 5, end_s=END_S).horizon_s == 190.0


def test_a_refusal_misses_everywhere() -> None:
    nothing = np.full_like(TIME_S, NAN)
    score = score_flight("f", TIME_S, nothing, nothing, nothing, end_s=END_S)
    for instant in score.at.values():
        assert instant.error_s == -instant.truth_s and instant.inside is False
        assert instant.crps_s == pytest.approx(instant.truth_s) and math.isnan(instant.width_s)
    assert score.refused == 1.0 and score.coverage == 0.0 and score.horizon_s == 0.0
    assert score.cra == pytest.approx(0.0) and score.alarm_at_s == 0.0
    assert score.alpha_lambda == {0.1: pytest.approx(0.0), 0.2: pytest.approx(0.0)}


@given(st.lists(st.booleans(), min_size=TIME_S.size, max_size=TIME_S.size))
@settings(deadline=None)
def test_refusing_more_never_scores_better(refused: list[bool]) -> None:
    full, gaps = scored(10.0), np.where(refused, NAN, TRUE_S + 10.0)
    score = score_flight("f", TIME_S, gaps, gaps - 20, gaps + 20, end_s=END_S)
    assert score.coverage <= full.coverage and score.horizon_s <= full.horizon_s
    assert score.cra <= full.cra + 1e-12 and score.alarm_at_s <= full.alarm_at_s + 1e-9
    for label, instant in score.at.items():
        assert abs(instant.error_s) >= abs(full.at[label].error_s) - 1e-9
        assert instant.crps_s >= full.at[label].crps_s - 1e-9


def test_a_median_without_its_interval_misses_coverage_only() -> None:
    hi = np.where(TIME_S == 480.0, NAN, TRUE_S + 20)
    instant = score_flight("f", TIME_S, TRUE_S, TRUE_S - 20, hi, end_s=END_S).at["120 s"]
    assert instant.inside is False and instant.error_s == pytest.approx(0.0)
    unbounded = score_flight("f", TIME_S, TRUE_S, TRUE_S - 20, np.full_like(TRUE_S, math.inf), end_s=END_S)
    assert unbounded.coverage == 1.0 and math.isinf(unbounded.width_s)


def test_the_alarm_may_listen_to_another_number() -> None:
    score = score_flight("f", TIME_S, TRUE_S, end_s=END_S, alarm_remaining_s=TRUE_S - 40.0)
    assert score.alarm_early_s == pytest.approx(40.0)


def test_what_comes_after_the_end_changes_nothing() -> None:
    late = np.where(TIME_S >= END_S, 9999.0, TRUE_S)
    assert score_flight("f", TIME_S, late, end_s=END_S).crps_s == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("time", "end_s"), [([0.0, 1.0], NAN), ([0.0, 1.0], -5.0), ([1.0, 0.0], 5.0)])
def test_bad_input_is_named(time: list[float], end_s: float) -> None:
    with pytest.raises(ValueError, match="m100_001: expected"):
        score_flight("m100_001", time, [5.0, 4.0], end_s=end_s)


# --- many ------------------------------------------------------------------------------------------------


def test_pool_of_known_errors() -> None:
    pooled = pool([scored(-10.0), scored(10.0), scored(30.0)])
    row = pooled.rows[0]
    assert (row.label, row.flights, row.refused, row.inside) == ("360 s", 3, 0, 2)
    assert row.mae_s == pytest.approx(50 / 3) and row.bias_s == pytest.approx(10.0)
    assert row.bias_se_s == pytest.approx(20 / math.sqrt(3))
    assert row.mae_se_s == pytest.approx(np.std([10, 10, 30], ddof=1) / math.sqrt(3))
    assert row.width_s == pytest.approx(40.0)
    assert row.coverage_95 == metrics.binomial_interval(2, 3)
    assert pooled.alarm_early_s == pytest.approx(-10.0) and pooled.alarm_least_s == pytest.approx(90.0)
    assert pooled.coverage[0] == pytest.approx(2 / 3)


def test_pool_of_one_flight_and_of_a_peer_without_interval() -> None:
    peer = score_flight("p", TIME_S, TRUE_S, end_s=END_S)
    pooled = pool([peer])
    assert pooled.rows[0].inside is None and math.isnan(pooled.rows[0].mae_se_s)
    assert math.isnan(pooled.coverage[0]) and pooled.alpha_lambda == {0.1: 1, 0.2: 1}
    with pytest.raises(ValueError, match="at least one"):
        pool([])
