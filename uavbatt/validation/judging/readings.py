"""A data set, read once: the value that all judgements and gates use, so that nothing is worked out twice.

DataSet -> Readings -> (findings | corridor | held-out predictions) -> claims -> verdict -> battery file
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from uavbatt.battery.equations import REFERENCE_TEMP_C
from uavbatt.dataset import DataSet, Levels, Run, whole_minutes
from uavbatt.validation.judging.fast_records import at_minutes
from uavbatt.validation.judging.series import Break, QuasiReplicates, breaks, quasi_replicates, single_series

VOLTAGE, SURFACE = "voltage_V", "surface_C"


@dataclass(frozen=True, slots=True)
class Readings:
    """Readings holds the runs of a data set and the tables that follow from them.

    `dataset` holds the runs as they were recorded, `tests` the same with fast records read at the whole minutes.
    `ambient_C` [°C] is the temperature with the most runs, the one that a gate can judge. `tables` has the repeated
    runs per (ambient temperature, quantity). `series` are the one-time tests over temperature, `broken` the breaks
    between them (None: too few tests to tell), `near_repeats` the groups of tests one degree apart.
    """

    dataset: DataSet
    tests: DataSet
    ambient_C: float
    tables: Mapping[tuple[float, str], Levels]
    series: tuple[Run, ...]
    broken: tuple[Break, ...] | None
    near_repeats: tuple[QuasiReplicates, ...]

    def levels(self, ambient_C: float, quantity: str = VOLTAGE) -> Levels | None:
        """Return the runs at `ambient_C` [°C], occasion x sample x time; None if `quantity` was not measured there."""
        return self.tables.get((ambient_C, quantity))

    def near_repeats_at(self, ambient_C: float) -> QuasiReplicates | None:
        """Return the group of near repeats that holds a test at `ambient_C` [°C]; None without one."""
        return next((g for g in self.near_repeats if np.any(np.abs(g.ambients_C - ambient_C) < 0.25)), None)


def read_once(dataset: DataSet) -> Readings:
    """Read fast records at the whole minutes and work out every table that judging and gating share."""
    tests = at_minutes(dataset)
    keys = [(t, q) for t in dataset.ambients_C for q in (VOLTAGE, SURFACE)]
    tables = ((key, whole_minutes(tests, *key)) for key in keys)
    series = single_series(tests)
    broken = breaks(tests, series)
    return Readings(
        dataset=dataset,
        tests=tests,
        ambient_C=repeated_ambient(dataset),
        tables={key: table for key, table in tables if table is not None},
        series=series,
        broken=broken,
        near_repeats=quasi_replicates(series, broken, tests.flags),
    )


def repeated_ambient(dataset: DataSet) -> float:
    """Return the ambient temperature [°C] that a gate judges: that with most runs, of several the nearest to 25 °C."""
    return max(dataset.ambients_C, key=lambda t: (len(dataset.at(t)), -abs(t - REFERENCE_TEMP_C)))
