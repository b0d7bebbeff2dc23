"""Accuracy of a measurement method by ISO 5725: precision, consistency of the samples, trueness. Knows no battery.

    from uavbatt.validation import iso5725

    cells = [[4.1, 4.2, 4.1], [4.3, 4.2, 4.4], [4.0, 4.1, 4.2]]  # one sequence of results per sample
    iso5725.precision(cells).s_R                                 # reproducibility SD, in the unit of the results
    iso5725.cochran(cells).verdict                               # "ok", "straggler" or "outlier"

Precision and consistency, ISO 5725-2:
    precision(cells)       .mean .s_r .s_L .s_R .r .R with their intervals; lengths of the cells may differ
    precision_of(summary)  the same from means, SDs and numbers of results (`from_statistics`)
    cochran(cells)         the largest variance: .statistic .critical_5 .critical_1 .index .verdict
    grubbs(means)          the highest and the lowest: .statistic_high .statistic_low .verdict_high .verdict_low
    double_grubbs(means)   the two highest and the two lowest
    mandel(cells)          consistency of the samples: .h .k (arrays) with their critical values
    scrutinise(cells)      these tests in the order of the standard
Intermediate precision, ISO 5725-3:
    crossed(table), nested(results), staggered(results)
Trueness against a reference value, ISO 5725-4, and the use of precision limits, ISO 5725-6:
    laboratory_bias(results, reference), method_bias(cells, reference)
    precision_check(cells, sigma_r, sigma_R), range_check(results, s_r)

All results are in the unit of what goes in. A cell is a sequence of finite numbers; what is not raises `BadCells`, a
`ValueError` that names the cell. Too few results raise `NotEnoughData`.
"""

from __future__ import annotations

from uavbatt.validation.iso5725.cells import BadCells, Cells, Summary, from_statistics, summarise
from uavbatt.validation.iso5725.intermediate import Crossed, Nested, crossed, nested, staggered
from uavbatt.validation.iso5725.outliers import (
    Cochran,
    DoubleGrubbs,
    Grubbs,
    Mandel,
    Scrutiny,
    cochran,
    double_grubbs,
    grubbs,
    mandel,
    scrutinise,
)
from uavbatt.validation.iso5725.precision import (
    LIMIT_FACTOR,
    Precision,
    precision,
    precision_of,
    relative_uncertainty_R,
    relative_uncertainty_r,
)
from uavbatt.validation.iso5725.trueness import (
    Bias,
    PrecisionCheck,
    RangeCheck,
    laboratory_bias,
    method_bias,
    precision_check,
    range_check,
)

__all__ = [
    "LIMIT_FACTOR", "BadCells", "Bias", "Cells", "Cochran", "Crossed", "DoubleGrubbs", "Grubbs", "Mandel", "Nested",
    "Precision", "PrecisionCheck", "RangeCheck", "Scrutiny", "Summary", "cochran", "crossed", "double_grubbs",
    "from_statistics", "grubbs", "laboratory_bias", "mandel", "method_bias", "nested", "precision",
    "precision_check", "precision_of", "range_check", "relative_uncertainty_R", "relative_uncertainty_r", "scrutinise",
    "staggered", "summarise",
]  # fmt: skip
