"""Declared limits are of the user's own pack, in its volts."""

from __future__ import annotations

import pytest

from uavbatt.cli.validate import _limits


def test_what_is_stated_of_a_pack_gates_as_it_was_stated() -> None:
    for cells in (3, 4, 6):
        declared = _limits(cells, 0.2, 8.0, 13.5).for_cells(cells)
        assert (declared.voltage_V, declared.time_s, declared.crossing_V) == pytest.approx((0.2, 8.0, 13.5))


def test_what_is_not_stated_grows_with_the_cells() -> None:
    declared = _limits(4, None, 10.0, None).for_cells(4)
    assert (declared.voltage_V, declared.crossing_V) == pytest.approx((0.2, 40.0 / 3.0))
