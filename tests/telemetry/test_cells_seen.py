"""How far the weakest cell lies below the others, from the voltages of the cells: smoothed over half a minute."""

from __future__ import annotations

import math

import pytest

from uavbatt.records import NAN
from uavbatt.telemetry.cleaning.readings import CELL_SPREAD_TAU_S, CellsSeen

WEAK = (3.80, 3.80, 3.80, 3.60)  # mean 3.75 V: the weakest is 0.15 V below
EVEN = (3.80, 3.80, 3.80, 3.80)


def test_the_first_row_counts_at_once_and_later_ones_in_time() -> None:
    first = CellsSeen().after(0.0, WEAK)
    assert first.spread_V == pytest.approx(0.15)
    later = first.after(CELL_SPREAD_TAU_S, EVEN)
    assert later.spread_V == pytest.approx(0.15 * math.exp(-1.0))
    assert later.after(CELL_SPREAD_TAU_S - 5.0, WEAK).spread_V == pytest.approx(later.spread_V)  # out of order: no time


@pytest.mark.parametrize("cells_V", [(), (3.8,), (3.8, 3.8, 3.8, 0.3), (3.8, 3.8, 3.8, 6.0), (NAN, 0.0, 3.8)])
def test_rows_without_two_possible_cells_change_nothing(cells_V: tuple[float, ...]) -> None:
    seen = CellsSeen().after(0.0, WEAK)
    assert seen.after(10.0, cells_V) == seen
