"""ISO 5725 on awkward results: ties, zeros, single results, gaps, huge numbers, claims that contradict each other."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from uavbatt.validation import iso5725
from uavbatt.validation.iso5725 import BadCells


@pytest.mark.parametrize("n", [3, 7, 11, 13])
def test_equal_results_have_no_variance_whatever_their_binary_rounding(n: int) -> None:
    """Seven times 0.1 has a mean that is not 0.1 in binary; no cell is an outlier by that rounding."""
    cells = [[value] * n for value in (12.5, 0.1, 0.3, 9.35, 10.17)]
    tested = iso5725.cochran(cells)
    assert tested.verdict == "ok" and math.isnan(tested.statistic)
    assert iso5725.precision(cells).s_r == 0.0


def test_means_that_are_equal_in_decimals_are_no_outliers() -> None:
    """The cells all have the mean 5.9; in binary one mean is 9e-16 off."""
    cells = [[5.6, 6.2], [5.4, 6.4], [5.6, 6.2], [5.6, 6.2]]
    found = iso5725.scrutinise(cells)
    assert found.grubbs is not None and (found.grubbs.verdict_high, found.grubbs.verdict_low) == ("ok", "ok")
    assert (found.mandel.h == 0.0).all()
    assert iso5725.grubbs([1.2, 1.2000000000000002, 1.2, 1.2]).statistic_high == 0.0


def test_rounding_is_not_taken_for_a_tie_where_digits_count() -> None:
    """Certified sets have means of 1e12 with a spread of 0.1: that is far above the rounding."""
    cells = [[1e12 + 0.2, 1e12 + 0.4], [1e12 + 0.3, 1e12 + 0.5]]
    assert iso5725.precision(cells).s_r == pytest.approx(0.1414, rel=2e-3)


@pytest.mark.parametrize("third", [1.0001, 2.0, 1e6])
def test_the_third_of_three_values_is_no_outlier_beside_a_tie(third: float) -> None:
    """G is 1.155 at any distance, which is the standard's critical value of both levels."""
    tested = iso5725.grubbs([1.0, 1.0, third])
    assert tested.statistic_high == pytest.approx(2.0 / math.sqrt(3.0))
    assert (tested.verdict_high, tested.verdict_low) == ("ok", "ok")
    assert iso5725.grubbs([1.0] * 9 + [third]).verdict_high == "outlier"


def test_two_of_four_values_are_no_outliers_beside_a_tie() -> None:
    tested = iso5725.double_grubbs([1.0, 1.0, 1.01, 1.02])
    assert tested.statistic_high == 0.0 and tested.verdict_high == "ok"
    assert iso5725.double_grubbs([1.0, 1.0, 1.0, 5.01, 5.02]).verdict_high == "outlier"


def test_the_farther_end_is_dropped_first() -> None:
    """Both ends are found; the low one is farther off, and without it the high one is an outlier as well."""
    means = [-6.0, 5.7, *np.linspace(-0.1, 0.1, 18)]
    found = iso5725.scrutinise([[m, m + 0.01] for m in means])
    assert found.grubbs is not None and found.retest is not None
    assert found.grubbs.verdict_low == "outlier" and found.grubbs.verdict_high == "outlier"
    rest = iso5725.grubbs(np.array(means[1:]) + 0.005)
    assert found.retest.statistic_high == pytest.approx(rest.statistic_high, rel=1e-9)


def test_cells_without_spread_that_differ() -> None:
    """s_r is 0, so that the ratio of mean squares is infinite; only the number of cells limits what s_R is worth."""
    found = iso5725.precision([[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]])
    assert (found.s_r, found.s_R, found.F, found.p_value) == (0.0, 1.0, math.inf, 0.0)
    assert found.A_R / iso5725.relative_uncertainty_R(3, 2.0, 1e6) == pytest.approx(1.0, rel=1e-6)


def test_one_cell_with_a_spread_is_said_to_be_a_matter_of_resolution() -> None:
    tested = iso5725.cochran([[1.0, 1.0], [2.0, 2.0], [3.0, 3.1]])
    assert tested.statistic == 1.0 and tested.index == 2
    assert any("resolution" in note for note in tested.notes)


def test_unequal_numbers_of_results_by_hand() -> None:
    """Counts 3, 2, 1: s_r² = (2·1 + 1·2)/3, n̄ = (6 - 14/6)/2, s_L² = (s_d² - s_r²)/n̄."""
    cells = [[9.0, 10.0, 11.0], [13.0, 15.0], [20.0]]
    found = iso5725.precision(cells)
    within = (2.0 * 1.0 + 1.0 * 2.0) / 3.0
    mean = (3 * 10.0 + 2 * 14.0 + 20.0) / 6.0
    between = (3 * (10.0 - mean) ** 2 + 2 * (14.0 - mean) ** 2 + (20.0 - mean) ** 2) / 2.0
    n_bar = (6.0 - 14.0 / 6.0) / 2.0
    assert [found.mean, found.n_bar] == pytest.approx([mean, n_bar])
    assert found.s_r == pytest.approx(math.sqrt(within))
    assert found.s_R == pytest.approx(math.sqrt(within + (between - within) / n_bar))


def test_one_laboratory_has_no_reproducibility() -> None:
    found = iso5725.precision([[1.0, 2.0, 3.0]])
    assert found.s_r == 1.0 and found.reproducibility == "not enough data"
    assert math.isnan(found.s_R) and math.isnan(found.R)


REFUSED: list[tuple[Callable[[], object], str]] = [
    (lambda: iso5725.precision([[1.0, 2.0], [], [3.0]]), "cell 2: expected at least one result"),
    (lambda: iso5725.precision([[1.0, 2.0], [3.0, math.nan]]), "cell 2, result 2: expected a finite number"),
    (lambda: iso5725.precision([[1e200, 2e200], [1.0, 2.0]]), "expected results below"),
    (lambda: iso5725.from_statistics([1.0, 2.0], [0.1, 0.1], [2.5, 3.0]), "whole counts"),
    (lambda: iso5725.crossed([[1.0, 2.0], [3.0]]), "expected a table occasion x sample"),
    (lambda: iso5725.laboratory_bias([1.0, 2.0], math.nan), "finite reference"),
    (lambda: iso5725.laboratory_bias([1.0, 2.0], 1.0, math.nan), "uncertainty of at least 0"),
    (lambda: iso5725.method_bias([[1.0, 2.0], [2.0, 3.0]], 2.0, sigma_r=0.5), "both sigma_r and sigma_R"),
    (lambda: iso5725.precision_check([[1.0, 2.0], [2.0, 3.0]], 1.0, 0.1), "0 < sigma_r <= sigma_R"),
    (lambda: iso5725.precision_check([[1.0, 2.0], [2.0, 3.0]], 0.0, 0.1), "0 < sigma_r <= sigma_R"),
    (lambda: iso5725.range_check([1.0, 2.0], -1.0), "s_r of at least 0"),
]


@pytest.mark.parametrize(("ask", "words"), REFUSED)
def test_what_cannot_be_computed_is_refused_in_one_line(ask: Callable[[], object], words: str) -> None:
    with pytest.raises(BadCells, match=words) as told:
        ask()
    assert "\n" not in str(told.value)
