"""Runs that are no repeats of one test: each kind is found on a sound set with one change, and not without it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from uavbatt import dataset
from uavbatt.dataset import DataSet, Run
from uavbatt.validation.judging.finding import Finding
from uavbatt.validation.judging.readings import read_once
from uavbatt.validation.judging.same_test import not_the_same_test

Change = Callable[[Run], Run]


def data_set(change: Change | None = None, copied: bool = False) -> DataSet:
    """Three samples, each with four runs at 25 °C and one at -5 °C; `change` is of run 2 of sample B."""
    runs = []
    for k, sample in enumerate("ABC"):
        for number, ambient_C in ((1, 25.0), (2, 25.0), (3, 25.0), (4, 25.0), (5, -5.0)):
            random = np.random.default_rng(10 * k + number)
            time_s = np.arange(0.0, 1260.0, 60.0)
            voltage_V = 16.0 - time_s / 500.0 + 0.02 * random.standard_normal(time_s.size)
            current_A = 10.0 + 0.1 * random.standard_normal(time_s.size)
            runs.append(Run(sample, number, ambient_C, time_s, voltage_V, current_A, ambient_C + time_s / 200.0))
    if change is not None:
        runs[6] = change(runs[6])
    if copied:
        runs[6] = replace(runs[5], run=2)
    return replace(dataset.load(), runs=tuple(runs))


def found(tests: DataSet) -> list[Finding]:
    return list(not_the_same_test(read_once(tests), 25.0))


def test_a_sound_set_has_no_such_run() -> None:
    assert found(data_set()) == []
    assert found(dataset.load()) == []  # the study


@pytest.mark.parametrize("number", [3, 4])
def test_a_copy_among_short_coarse_tests_is_named(number: int) -> None:
    """The study's form: nine voltages to 0.01 V and nine temperatures to 0.1 K; two runs share 9 of 18 at most."""
    study = dataset.load()
    run = next(r for r in study.runs if r.sample == "1" and r.run == number)
    (finding,) = found(replace(study, runs=(*study.runs, replace(run, run=99))))
    assert f"run 99 of sample 1 at 25 °C is run {number} of sample 1 at 25 °C" in finding.detail


def test_a_copy_is_named_where_there_is_no_other_run_to_compare_with() -> None:
    first, *_ = data_set().runs
    both = replace(dataset.load(), runs=(first, replace(first, run=2)))
    assert [finding.kind for finding in found(both)] == ["copied_run"]


def test_short_tests_read_to_a_volt_are_equal_by_chance() -> None:
    coarse = [
        replace(r, voltage_V=np.round(r.voltage_V), surface_C=np.full_like(r.surface_C, np.nan))
        for r in dataset.load().runs
    ]
    assert found(replace(dataset.load(), runs=tuple(coarse))) == []


def test_a_copied_run_is_named_with_its_original() -> None:
    (finding,) = found(data_set(copied=True))
    assert (finding.kind, finding.severity) == ("copied_run", "serious")
    assert "run 2 of sample B at 25 °C is run 1 of sample B at 25 °C" in finding.detail


@pytest.mark.parametrize(
    ("change", "kind", "words"),
    [
        (lambda r: replace(r, time_s=r.time_s / 60.0), "short_run", "run 2 of sample B at 25 °C lasts 0.333 min"),
        (lambda r: replace(r, current_A=1.5 * r.current_A), "other_load", "run 2 of sample B at 25 °C with 15 A"),
        (lambda r: replace(r, current_A=1.06 * r.current_A), "other_load", "run 2 of sample B at 25 °C with 10.6 A"),
        (lambda r: replace(r, current_A=0.0 * r.current_A), "other_load", "run 2 of sample B at 25 °C with 0 A"),
        (lambda r: replace(r, surface_C=1.8 * r.surface_C + 32.0), "surface_far_from_ambient", "degrees Fahrenheit?"),
        (lambda r: replace(r, surface_C=r.surface_C - 25.0), "surface_far_from_ambient", "another ambient temperature"),
    ],
)
def test_a_run_that_is_no_repeat_is_named(change: Change, kind: str, words: str) -> None:
    (finding,) = found(data_set(change))
    assert (finding.kind, finding.severity) == (kind, "warning")
    assert words in finding.detail


def test_a_load_that_scatters_a_little_more_is_no_other_load() -> None:
    assert found(data_set(lambda r: replace(r, current_A=1.03 * r.current_A))) == []


def test_a_run_without_a_current_is_named_unless_no_run_has_one() -> None:
    (finding,) = found(data_set(lambda r: replace(r, current_A=np.nan * r.current_A)))
    assert finding.title == "The current of 1 of 15 runs was not measured"
    assert "run 2 of sample B at 25 °C: the model is fitted to the others" in finding.detail


@pytest.mark.parametrize(("share", "words"), [(0.5, "reads low"), (1.0, ""), (1.3, "reads high")])
def test_whole_discharges_are_held_against_the_rated_capacity(share: float, words: str) -> None:
    """An ammeter off by a factor passed without a word: model and tests were wrong together."""
    tests = replace(data_set(), cutoff_V=13.7, capacity_Ah=3.33 / share)
    assert [(f.kind, words in f.detail) for f in found(tests)] == [("other_capacity", True)] * bool(words)


def test_repeats_of_packs_that_are_a_little_worn_are_repeats() -> None:
    assert (
        found(
            data_set(
                lambda r: Run(r.sample, 2, 25.0, *(c[:-4] for c in (r.time_s, r.voltage_V, r.current_A, r.surface_C)))
            )
        )
        == []
    )
