"""What nobody states of a pack is guessed as crews fly: full packs of usual counts, endings of 3.3 to 3.7 V a cell."""

from __future__ import annotations

import pytest

from uavbatt.limits import cells_from_voltage

FULL_V = 4.17


@pytest.mark.parametrize("cells", [1, 2, 3, 4, 5, 6, 8, 10, 12, 14])
def test_a_full_pack_of_a_usual_count_leaves_no_doubt(cells: int) -> None:
    assert cells_from_voltage(FULL_V * cells) == (cells,)


@pytest.mark.parametrize("cells", [2, 3, 4, 6, 8, 12])
@pytest.mark.parametrize("cell_V", [3.75, 3.85, 3.95])
def test_a_part_charged_pack_is_not_taken_for_a_full_one_of_an_odd_count(cells: int, cell_V: float) -> None:
    assert cells_from_voltage(cell_V * cells)[0] == cells


def test_two_counts_that_fit_are_both_said() -> None:
    """46 V: 12 cells at 3.83 V or 11 at 4.18 V."""
    assert cells_from_voltage(46.0) == (12, 11)


def test_a_voltage_under_load_is_not_that_of_a_full_pack() -> None:
    """21 V: at rest five full cells; under 3 C these would show less, and six that are nearly empty show that."""
    assert cells_from_voltage(21.0)[0] == 5
    assert cells_from_voltage(21.0, c_rate=3.0)[0] == 6


@pytest.mark.parametrize("cells", [2, 3, 4, 5, 6, 8, 10, 12, 14])
@pytest.mark.parametrize("cell_V", [4.30, 4.35])
def test_a_full_pack_that_charges_to_4_35_V_has_no_cell_more(cells: int, cell_V: float) -> None:
    assert cells_from_voltage(cells * cell_V)[0] == cells


@pytest.mark.parametrize("cell_V", [3.3, 3.5, 3.6])
def test_the_vehicles_critical_voltage_tells_the_count(cell_V: float) -> None:
    assert cells_from_voltage(21.0, endings_V=(6 * cell_V, 6 * cell_V + 0.6))[0] == 6
    assert cells_from_voltage(21.0, endings_V=(5 * cell_V, 5 * cell_V + 0.5))[0] == 5


def test_a_low_voltage_warning_that_nobody_set_tells_nothing() -> None:
    """ArduPilot's own 10.5 V is that of three cells, whatever flies."""
    assert cells_from_voltage(FULL_V * 6, endings_V=(0.0, 10.5)) == (6,)


def test_the_files_own_count_is_taken_where_it_fits() -> None:
    assert cells_from_voltage(21.0, typical=6) == (6,)
    assert cells_from_voltage(16.8, typical=6) == (4,)
