"""Samples that do not agree with each other: an outlying scatter, an outlying mean, and what is neither."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from uavbatt import dataset
from uavbatt.battery.model import Array
from uavbatt.dataset import Levels
from uavbatt.validation.iso5725 import cochran
from uavbatt.validation.judging.consistency import inconsistencies
from uavbatt.validation.judging.findings import findings
from uavbatt.validation.judging.readings import read_once

SHAPE = (6, 4, 9)  # occasions, samples, instants


def levels(values: Array) -> Levels:
    """Tables of voltage at whole minutes; NaN for a reading that is missing."""
    occasions, samples, instants = values.shape
    names = tuple(str(k + 1) for k in range(samples))
    time_s = np.linspace(0.0, 60.0 * (instants - 1), instants)
    return Levels(25.0, "voltage_V", names, tuple(range(1, occasions + 1)), time_s, values)


def drawn(seed: int, shape: tuple[int, int, int] = SHAPE) -> Array:
    noise = np.random.default_rng(seed).normal(0.0, 0.03, shape)
    return np.asarray(15.0 + noise)


def test_a_slip_of_one_reading_makes_its_sample_an_outlier_by_cochran() -> None:
    values = drawn(1)
    values[2, 1, 4] -= 1.0
    (found,) = [f for f in inconsistencies(levels(values)) if f.is_certain]
    assert (found.kind, found.sample, found.instants) == ("scatter", "2", (4,))
    test = cochran(list(values[:, :, 4].T))
    assert found.statistic == pytest.approx(test.statistic) and found.critical == pytest.approx(test.critical_1)
    assert found.own == pytest.approx(np.std(values[:, 1, 4], ddof=1))


def test_a_sample_of_another_level_lies_apart() -> None:
    values = drawn(2)
    values[:, 2] += 0.5
    (found,) = inconsistencies(levels(values))
    assert (found.kind, found.sample, len(found.instants)) == ("mean", "3", 9)
    assert found.own - found.others == pytest.approx(0.5, abs=0.05)


def test_samples_of_unequal_numbers_are_no_outliers_for_that() -> None:
    """A variance of two results scatters more than one of ten: of 200 sets, each at one instant, about 1 % is found."""
    sets = 200
    values = drawn(3, (10, 4, sets))
    for sample, runs in enumerate((10, 4, 2, 6)):
        values[runs:, sample] = np.nan
    found = [f for f in inconsistencies(levels(values)) if f.kind == "scatter"]
    assert sum(len(f.instants) for f in found) <= 0.03 * sets


def test_a_sample_without_a_reading_at_an_instant_does_not_shift_the_names() -> None:
    values = drawn(4)
    values[:, 0, 3] = np.nan
    values[1, 3, 3] += 1.0
    assert ("scatter", "4") in {(f.kind, f.sample) for f in inconsistencies(levels(values)) if 3 in f.instants}


def test_where_only_one_sample_scatters_at_all_nothing_is_said() -> None:
    values = np.full(SHAPE, 15.0)
    values[0, 1] = 15.1
    assert not [f for f in inconsistencies(levels(values)) if f.kind == "scatter"]


def test_means_that_are_equal_by_the_resolution_of_the_meter_make_no_outlier_of_the_fourth() -> None:
    values = drawn(3)
    values[:, :, 4] = np.tile([15.0, 15.02, 15.0, 15.02, 15.0, 15.02], (4, 1)).T
    values[0, 1, 4] += 0.02
    assert not [f for f in inconsistencies(levels(values)) if f.kind == "mean" and 4 in f.instants]


def test_the_study_has_no_inconsistent_sample() -> None:
    found = findings(read_once(dataset.load()), 25.0, None)
    assert not [f for f in found if f.kind.startswith("inconsistent")]


def test_a_finding_names_sample_instant_and_both_sds() -> None:
    read = read_once(dataset.load())
    volts = read.levels(25.0)
    assert volts is not None
    values = volts.values.copy()
    values[3, 1, 2] += 1.0
    changed = replace(read, tables={**read.tables, (25.0, "voltage_V"): replace(volts, values=values)})
    (found,) = [f for f in findings(changed, 25.0, None) if f.kind == "inconsistent_scatter"]
    assert found.title == "The voltage of sample 2 scatters more than the others at 2 min"
    assert "Cochran" in found.detail and found.severity == "warning"
