"""Packs of cylindrical lithium-ion cells, of which nobody has a file of their make."""

from __future__ import annotations

from functools import cache

import pytest
from scoring import lithium_ion, wrong_judged
from scoring.other_pack import CELLS, FULL_AH, Pack, rested
from scoring.wrong_judged import Judged

from uavbatt.battery.battery_file import GENERIC, GENERIC_LITHIUM_ION, read_battery
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.estimator import Estimator

# Two flights of each make (NCA, NMC, NMC with silicon): packs of 72 to 102 %, full and not.
FLIGHTS = (2, 3, 10, 11, 25, 27)
QUICK = (3, 11, 25)  # one of each make, the witness for the others


@cache
def judged(number: int) -> Judged:
    return wrong_judged.judged(lithium_ion.case(GENERIC_LITHIUM_ION, number))


@pytest.mark.parametrize("number", [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in FLIGHTS])
def test_their_generic_file_warns_in_time(number: int) -> None:
    """Read as LiPo cells, the pack of flight 11 had no number in its last two minutes, and no alarm at all."""
    found = judged(number)
    assert found.lo_excess_s <= 25.0 and found.alarm_s >= 45.0
    assert found.refused < 0.02 and found.covered > 0.9


@pytest.mark.slow  # its witness: the test above
def test_it_is_nearer_than_that_of_lipo_cells() -> None:
    ours, lipo = (
        [abs(j.half.error_s) / j.flown_s for j in found]
        for found in (
            map(judged, FLIGHTS),
            (wrong_judged.judged(lithium_ion.case(GENERIC, number)) for number in FLIGHTS),
        )
    )
    assert sum(ours) < 0.75 * sum(lipo)


@pytest.mark.parametrize(
    ("battery", "cutoff_cell_V", "is_told"),
    [(GENERIC, 2.9, True), (GENERIC, 3.2, False), (GENERIC_LITHIUM_ION, 2.9, False)],
)
def test_a_cut_off_that_no_lipo_is_flown_to_names_the_other_file(
    battery: str, cutoff_cell_V: float, is_told: bool
) -> None:
    options = PackOptions(cells=CELLS, capacity_Ah=FULL_AH, cutoff_V=CELLS * cutoff_cell_V)
    estimator = Estimator(read_battery(battery), options)
    for sample in rested(Pack(), 20, 0.0):
        estimate, _ = estimator.step(sample)
    assert any(GENERIC_LITHIUM_ION in warning for warning in estimate.warnings) is is_told
