"""Precision against known answers. The data are facts, carried as numbers with their source:

- COAL: ISO 5725-2:1994 B.1, sulfur in coal, 8 laboratories, unequal numbers of results; 12 printed figures.
- GLUCOSE: ASTM E691, glucose in serum, 8 laboratories x 3, materials A, D, E as printed, C with the two cells of the
  R package ILS corrected (laboratory 4: 138.30, laboratory 8: 133.63) as E691 prints the result; B is unresolved.
- DYESTUFF: Davies & Goldsmith 1972 as in lme4, 6 batches x 5.
- SIRSTV, ATMWTAG: NIST StRD analysis of variance, certified.
- ZENER: GUM H.5, ten daily means of five results with their SDs; printed in volts and microvolts.
- EP05: CLSI EP05-A2 example as in the R package VCA, 20 days x 2 runs x 2.
"""

import math

import numpy as np
import pytest

from uavbatt.validation import iso5725
from uavbatt.validation.iso5725.intermediate import nested

# fmt: off
COAL = {
    1: [
        [0.71, 0.71, 0.7, 0.71],
        [0.69, 0.67, 0.68],
        [0.66, 0.65, 0.69],
        [0.67, 0.65, 0.66],
        [0.7, 0.69, 0.66, 0.71, 0.69],
        [0.73, 0.74, 0.73],
        [0.71, 0.71, 0.69],
        [0.7, 0.65, 0.68],
    ],
    2: [
        [1.2, 1.18, 1.23, 1.21],
        [1.22, 1.21, 1.22],
        [1.28, 1.31, 1.3],
        [1.23, 1.18, 1.2],
        [1.31, 1.22, 1.22, 1.24],
        [1.39, 1.36, 1.37],
        [1.2, 1.26, 1.26],
        [1.24, 1.22, 1.3],
    ],
    3: [
        [1.68, 1.7, 1.68, 1.69],
        [1.64, 1.64, 1.65],
        [1.61, 1.61, 1.62],
        [1.68, 1.66, 1.66],
        [1.64, 1.67, 1.6, 1.66, 1.68],
        [1.7, 1.73, 1.73],
        [1.69, 1.7, 1.68],
        [1.67, 1.68, 1.67],
    ],
    4: [
        [3.26, 3.26, 3.2, 3.24],
        [3.2, 3.2, 3.2],
        [3.37, 3.36, 3.38],
        [3.16, 3.22, 3.23],
        [3.2, 3.19, 3.18, 3.27, 3.24],
        [3.27, 3.31, 3.29],
        [3.27, 3.24, 3.23],
        [3.25, 3.26, 3.26],
    ],
}
GLUCOSE = {
    "A": [
        [41.03, 41.45, 41.37],
        [41.17, 42.0, 41.15],
        [41.01, 40.68, 42.66],
        [39.37, 42.37, 42.63],
        [41.88, 41.19, 41.32],
        [43.28, 40.5, 42.28],
        [41.08, 41.27, 39.02],
        [43.36, 42.65, 41.72],
    ],
    "C": [
        [132.66, 133.83, 133.1],
        [132.92, 136.9, 136.4],
        [132.61, 135.8, 135.36],
        [138.5, 138.3, 135.69],
        [131.9, 134.14, 133.76],
        [137.21, 135.14, 137.5],
        [130.97, 131.59, 134.92],
        [135.46, 135.14, 133.63],
    ],
    "D": [
        [193.71, 193.59, 193.65],
        [190.88, 200.14, 194.3],
        [192.71, 193.28, 190.28],
        [195.85, 196.36, 199.43],
        [192.59, 191.44, 195.12],
        [195.34, 198.26, 198.13],
        [194.66, 191.99, 187.13],
        [197.56, 195.99, 200.82],
    ],
    "E": [
        [292.78, 294.09, 292.89],
        [292.27, 309.4, 295.08],
        [295.53, 290.14, 292.34],
        [295.19, 295.44, 296.83],
        [293.93, 292.48, 294.28],
        [297.74, 296.8, 290.33],
        [287.29, 293.76, 289.36],
        [298.46, 295.28, 296.12],
    ],
}
DYESTUFF = [
    [1545.0, 1440.0, 1440.0, 1520.0, 1580.0],
    [1540.0, 1555.0, 1490.0, 1560.0, 1495.0],
    [1595.0, 1550.0, 1605.0, 1510.0, 1560.0],
    [1445.0, 1440.0, 1595.0, 1465.0, 1545.0],
    [1595.0, 1630.0, 1515.0, 1635.0, 1625.0],
    [1520.0, 1455.0, 1450.0, 1480.0, 1445.0],
]
EP05 = [
    [24.104212541, 26.678632616, 24.920532882, 25.127462083],
    [27.500818549, 28.661877186, 28.086420822, 26.775989662],
    [27.408809035, 24.062603372, 22.358360248, 23.845535519],
    [22.077621568, 19.990598055, 26.865343037, 23.304700304],
    [25.469348374, 22.666137509, 22.841177946, 23.94925578],
    [25.70122632, 25.540125523, 25.101825568, 24.280073944],
    [24.347585303, 26.277099566, 25.769744153, 28.509480044],
    [21.835503818, 21.686985686, 26.523147185, 24.774322886],
    [24.765023941, 27.835887834, 22.55961881, 26.05821151],
    [21.049963486, 23.330024637, 25.987850546, 25.901913886],
    [24.724446899, 23.125880911, 23.722386958, 28.007348671],
    [26.659720799, 25.980018386, 23.284993982, 25.991711168],
    [25.558768956, 23.116877445, 23.63866929, 24.304427503],
    [22.638411656, 24.781107493, 25.342609536, 25.91515469],
    [24.707269499, 24.956306334, 28.560728741, 26.518582587],
    [26.189686539, 26.091754085, 26.525038176, 23.801774716],
    [24.590102401, 25.844039736, 26.295620534, 25.70528695],
    [27.110215821, 24.926172719, 24.466505958, 25.260230386],
    [22.741583426, 22.316188213, 24.349622401, 26.482803497],
    [25.735606292, 26.111091253, 25.020162306, 23.906950304],
]
SIRSTV = [
    [196.3052, 196.124, 196.189, 196.2569, 196.3403],
    [196.3042, 196.3825, 196.1669, 196.3257, 196.0422],
    [196.1303, 196.2005, 196.2889, 196.0343, 196.1811],
    [196.2795, 196.1748, 196.1494, 196.1485, 195.9885],
    [196.2119, 196.1051, 196.185, 196.0052, 196.209],
]
ATMWTAG = [
    [
        107.8681568, 107.8681465, 107.8681572, 107.8681785, 107.8681446, 107.8681903, 107.8681526, 107.8681494,
        107.8681616, 107.8681587, 107.8681519, 107.8681486, 107.8681419, 107.8681569, 107.8681508, 107.8681672,
        107.8681385, 107.8681518, 107.8681662, 107.8681424, 107.868136, 107.8681333, 107.868161, 107.8681477,
    ],
    [
        107.8681079, 107.8681344, 107.8681513, 107.8681197, 107.8681604, 107.8681385, 107.8681642, 107.8681365,
        107.8681151, 107.8681082, 107.8681517, 107.8681448, 107.8681198, 107.8681482, 107.8681334, 107.8681609,
        107.8681101, 107.8681512, 107.8681469, 107.868136, 107.8681254, 107.8681261, 107.868145, 107.8681368,
    ],
]
ZENER_MEANS_V = [10.000172, 10.000116, 10.000013, 10.000144, 10.000106,
                 10.000031, 10.000060, 10.000125, 10.000163, 10.000041]
ZENER_SDS_uV = [60, 77, 111, 101, 67, 93, 80, 73, 88, 86]
# fmt: on


@pytest.mark.parametrize(
    ("level", "mean", "s_r", "s_R"),
    [(1, 0.690, 0.015, 0.026), (2, 1.252, 0.029, 0.061), (3, 1.667, 0.017, 0.035), (4, 3.250, 0.026, 0.058)],
)
def test_sulfur_in_coal_meets_every_printed_figure(level, mean, s_r, s_R):
    found = iso5725.precision(COAL[level])
    assert (round(found.mean, 3), round(found.s_r, 3), round(found.s_R, 3)) == (mean, s_r, s_R)


def test_coal_sums_of_the_standard_give_the_same_precision():
    """ISO's T1..T5 on small numbers, where they lose nothing: s_L² of 5725-2 7.4.5.4."""
    for cells in COAL.values():
        n = np.array([len(c) for c in cells])
        means, variances = np.array([np.mean(c) for c in cells]), np.array([np.var(c, ddof=1) for c in cells])
        T1, T2, T3, T4 = (n * means).sum(), (n * means**2).sum(), n.sum(), (n**2).sum()
        p, T5 = len(cells), ((n - 1) * variances).sum()
        s_r2 = T5 / (T3 - p)
        s_L2 = ((T2 * T3 - T1**2) / (T3 * (p - 1)) - s_r2) * T3 * (p - 1) / (T3**2 - T4)
        found = iso5725.precision(cells)
        assert found.s_L**2 == pytest.approx(s_L2, rel=1e-9)
        assert found.n_bar == pytest.approx((T3**2 - T4) / (T3 * (p - 1)))


def test_reml_on_unequal_numbers_differs_and_says_its_name():
    found = iso5725.precision(COAL[1], method="reml")
    assert found.method == "reml"
    assert found.s_R == pytest.approx(0.02707, abs=5e-6)
    assert iso5725.precision(COAL[1]).s_R == pytest.approx(0.02636, abs=5e-6)


@pytest.mark.parametrize(
    ("material", "mean", "s_r", "s_R"),
    [
        ("A", 41.5183, 1.0632, 1.0632),
        ("C", 134.7263, 1.5434, 2.1482),
        ("D", 194.7171, 2.6251, 3.3657),
        ("E", 294.4921, 3.9350, 4.1923),
    ],
)
def test_e691_glucose(material, mean, s_r, s_R):
    found = iso5725.precision(GLUCOSE[material])
    assert found.mean == pytest.approx(mean, abs=6e-5)
    assert (round(found.s_r, 4), round(found.s_R, 4)) == (s_r, s_R)
    assert (found.r, found.R) == pytest.approx((2.8 * found.s_r, 2.8 * found.s_R))


def test_negative_between_variance_is_zero_and_said():
    found = iso5725.precision(GLUCOSE["A"])
    assert found.negative_between and found.s_L == 0 and found.s_L2_raw < 0
    assert found.s_R == found.s_r
    assert any("negative" in n for n in found.notes)


def test_glucose_C_outlier_statistics():
    assert iso5725.cochran(GLUCOSE["C"]).statistic == pytest.approx(0.24663121807878166, rel=1e-10)
    means = iso5725.summarise(GLUCOSE["C"]).means
    assert iso5725.grubbs(means).statistic_high == pytest.approx(1.592440264958081, rel=1e-9)
    assert iso5725.double_grubbs(means).statistic_low == pytest.approx(0.5428748146023721, rel=1e-8)
    assert np.std(means, ddof=1) == pytest.approx(1.7397, abs=5e-5)


def test_glucose_E_has_a_cochran_outlier():
    found = iso5725.cochran(GLUCOSE["E"])
    assert found.statistic == pytest.approx(0.6813413828503312, rel=1e-10)
    assert (found.verdict, found.index) == ("outlier", 1)


def test_coal_mandel_h_and_k():
    found = iso5725.mandel(COAL[1])
    assert found.h == pytest.approx([0.7375, -0.4011, -0.9532, -1.2292, 0.0129, 1.8071, 0.565, -0.5391], abs=6e-5)
    assert found.k == pytest.approx([0.3308, 0.6615, 1.3771, 0.6615, 1.2376, 0.3819, 0.7639, 1.6648], abs=6e-5)
    assert found.h_critical_5 == pytest.approx(1.749, abs=5e-4)


def test_dyestuff_variances():
    found = iso5725.precision(DYESTUFF)
    assert found.mean == pytest.approx(1527.5)
    assert found.s_L**2 == pytest.approx(1764.05, abs=5e-3)
    assert found.s_r**2 == pytest.approx(2451.25, abs=5e-3)
    reml = iso5725.precision(DYESTUFF, method="reml")  # equal for balanced data
    assert reml.s_L**2 == pytest.approx(1764.05, rel=1e-6)


def test_nist_silicon_resistivity():
    found = iso5725.precision(SIRSTV)
    assert pytest.approx(1.18046237440255, rel=1e-11) == found.F
    assert found.s_r == pytest.approx(1.04076068334656e-01, rel=1e-12)
    assert found.ms_between == pytest.approx(1.27865654000000e-02, rel=1e-11)


def test_nist_atomic_weight_of_silver():
    found = iso5725.precision(ATMWTAG)
    assert pytest.approx(15.9467335677930, rel=1e-7) == found.F  # ten digits are all that doubles hold of the data
    assert found.s_r == pytest.approx(1.51048314446410e-05, rel=1e-8)


def test_a_mean_of_1e12_loses_no_digit():
    """Quarters are exact in binary up to 1e12: the shifted set must give the very same variances."""
    small = [[0.25, 0.5, 1.0], [0.75, 1.5, 1.25], [2.0, 1.75, 2.5]]
    shifted = [[1e12 + v for v in cell] for cell in small]
    a, b = iso5725.precision(small), iso5725.precision(shifted)
    assert (a.s_r, a.s_L, a.F) == (b.s_r, b.s_L, b.F)
    assert b.mean == 1e12 + a.mean


def test_gum_h5_zener_meets_the_printed_figures():
    means, sds = np.array(ZENER_MEANS_V), np.array(ZENER_SDS_uV) * 1e-6
    found = iso5725.precision_of(iso5725.from_statistics(means, sds, [5] * 10))
    assert round(found.mean, 6) == 10.000097
    assert round(math.sqrt(found.ms_between) * 1e6) == 128
    assert round(found.s_r * 1e6) == 85
    assert pytest.approx(2.262, abs=5e-4) == found.F
    assert round(found.s_L * 1e6) == 43
    assert round(math.sqrt(found.ms_between / 50) * 1e6) == 18


def test_ep05_nested():
    found = nested(np.array(EP05).reshape(20, 2, 2))
    assert found.raw == pytest.approx((0.00109564, 1.34449242, 1.95339748), abs=6e-9)
    assert found.s_R**2 == pytest.approx(3.29898554, abs=6e-9)
    assert found.df_total == pytest.approx(67.0876, abs=5e-5)
