"""The findings are computed: they are there on the study, and gone when their cause is taken away."""

from dataclasses import replace

import numpy as np
import pytest

from uavbatt import dataset
from uavbatt.validation.judging.corridor import corridor
from uavbatt.validation.judging.findings import findings as findings_of
from uavbatt.validation.judging.readings import read_once


def findings(dataset, ambient_C=25.0):
    readings = read_once(dataset)
    return findings_of(readings, ambient_C, corridor(readings, ambient_C))


@pytest.fixture(scope="module")
def study():
    return dataset.load()


@pytest.fixture(scope="module")
def found(study):
    return findings(study)


def one(found, kind):
    (finding,) = [f for f in found if f.kind == kind]
    return finding


def changed(study, change):
    return replace(study, runs=tuple(replace(r, **change(r)) for r in study.runs))


def test_samples_are_not_independent(found):
    numbers = one(found, "dependent_samples").numbers
    assert (numbers["identical"], numbers["compared"]) == (49, 90)
    assert numbers["p_value"] <= 5.1e-5
    assert numbers["correlation"] == pytest.approx(0.938, abs=5e-4)


def test_voltage_steps_down_after_run_6(found):
    finding = one(found, "drift")
    assert finding.numbers["after_run"] == 6 and "steps down after run 6" in finding.title
    assert finding.numbers["step"] == pytest.approx(-0.09, abs=0.005)


def test_a_drift_of_one_sample_is_seen_although_the_other_was_tested_less_often(study):
    kept = tuple(r for r in study.runs if r.sample != "2" or r.run <= 5)
    assert one(findings(replace(study, runs=kept)), "drift").numbers["after_run"] == 6


def test_curve_at_25_is_outside_at_5_of_9(found):
    finding = one(found, "curve_outside_corridor")
    assert (finding.numbers["outside"], finding.numbers["instants"]) == (5, 9)
    assert "1, 5, 6, 7, 8 min" in finding.detail


def test_pooling_is_forbidden_for_temperature(found):
    assert "surface temperature" in one(found, "pooling_forbidden").title
    assert "0, 1, 4 min" in one(found, "pooling_forbidden").title


def test_two_s_holds_two_thirds(found):
    finding = one(found, "corridor_coverage")
    assert finding.numbers["share"] == pytest.approx(0.65) and "65%" in finding.title
    assert finding.severity == "note"  # true of every data set: no alarm


def test_F_emp_misprint_and_breaks(found):
    assert "2.83" in one(found, "F_emp_not_reproducible").title
    assert one(found, "likely_misprint").numbers["ambient_C"] == -1
    breaks = [(f.numbers["low_C"], f.numbers["high_C"]) for f in found if f.kind == "series_break"]
    assert breaks == [(4, 5), (35, 40)]


def test_serious_findings_come_first(found):
    order = [f.severity for f in found]
    assert order == sorted(order, key=["serious", "warning", "note"].index)
    assert order[0] == "serious"


def test_mending_the_misprint_takes_the_finding_away(study):
    def mend(run):
        at = (run.sample == "T1") & (run.ambient_C == -1.0) & (run.time_s == 60)
        return {"voltage_V": np.where(at, 10.75, run.voltage_V)}

    assert not [f for f in findings(changed(study, mend)) if f.kind == "likely_misprint"]


def test_shuffled_runs_of_sample_2_are_not_called_dependent(study):
    order = np.random.default_rng(12).permutation(10)
    second = [r for r in study.runs if r.sample == "2"]
    shuffled = {r.run: second[i].voltage_V for r, i in zip(second, order, strict=True)}
    other = changed(study, lambda r: {"voltage_V": shuffled[r.run]} if r.sample == "2" else {})
    assert not [f for f in findings(other) if f.kind == "dependent_samples"]


def test_runs_in_random_order_do_not_drift(study):
    order = np.random.default_rng(13).permutation(10) + 1
    other = changed(study, lambda r: {"run": int(order[r.run - 1])} if r.sample != "T1" else {})
    assert not [f for f in findings(other) if f.kind == "drift"]


def synthetic(study, samples, runs, seed=15):  # of 120 pairs in 20 seeds two are accused, as two tests at 1 % may
    rng = np.random.default_rng(seed)
    time = 5.0 * np.arange(100)
    nan = np.full(100, np.nan)
    made = [
        dataset.Run(str(s), r, 25.0, time, 16 - 0.006 * time + rng.normal(0, 0.02, 100), nan, nan)
        for s in range(1, samples + 1)
        for r in range(1, runs + 1)
    ]
    return replace(study, name="other", cells_series=4, cutoff_V=12.4, runs=tuple(made), flags=())


@pytest.mark.parametrize(("samples", "runs"), [(1, 1), (1, 2), (1, 3), (2, 2), (3, 4), (4, 12), (1, 12)])
def test_other_data_sets_do_not_crash_and_sound_ones_are_not_accused(study, samples, runs):
    kinds = {f.kind for f in findings(synthetic(study, samples, runs))}
    assert not kinds & {"dependent_samples", "drift", "F_emp_not_reproducible", "likely_misprint", "series_break"}
    assert ("reproducibility_unknown" in kinds) == (samples < 3 and runs > 1)


def test_a_temperature_without_runs_has_only_the_findings_of_the_series(study):
    assert {f.kind for f in findings(study, 60.0)} == {"likely_misprint", "series_break"}


def three_samples(study, change, runs=7, columns=lambda run: {}):
    """Three sound samples of so many runs, 10 s apart and at rest in the first row.

    `change(sample, run, current)` is added to the voltage [V]; `columns(run)` replaces columns of a run.
    """
    rng, time = np.random.default_rng(4), 10.0 * np.arange(61)
    current = np.where(time > 0.0, 15.0, 0.0)
    made = [
        dataset.Run(
            name, r, 25.0, time, 16 - 0.004 * time + rng.normal(0, 0.01, 61) + change(name, r, current),
            current, np.full(61, np.nan),
        )
        for name in "ABC"
        for r in range(1, runs + 1)
    ]  # fmt: skip
    made = tuple(replace(run, **columns(run)) for run in made)
    return findings(replace(study, name="other", cells_series=4, cutoff_V=12.4, runs=made, flags=()))


def of_kind(found, kind):
    return [f for f in found if f.kind == kind]


def test_a_sample_with_a_bad_contact_is_named(study):
    """Grubbs' test of three means saw nothing in a sample that read 0.2 V less in all of its runs."""
    (finding,) = of_kind(three_samples(study, lambda s, r, amps: -0.013 * amps * (s == "B")), "sample_apart")
    assert "sample B" in finding.title and "lower" in finding.title and finding.severity == "warning"
    assert finding.numbers["off"] == pytest.approx(-0.195, abs=0.02)
    assert "contacts" in finding.detail and "voltmeters" not in finding.detail


def test_a_sample_under_another_voltmeter_is_told_to_differ_before_the_load(study):
    (finding,) = of_kind(three_samples(study, lambda s, r, amps: 0.2 * (s == "C")), "sample_apart")
    assert "sample C" in finding.title and "higher" in finding.title and "voltmeters" in finding.detail


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("columns", "told"),
    [
        (lambda run: {"current_A": np.full(61, np.nan)}, ""),
        (lambda run: {"voltage_V": np.append(16.5, run.voltage_V[1:])}, "contacts"),
    ],
    ids=["the current was not measured", "the same voltage at rest in every run"],
)
def test_a_sample_apart_is_told_in_numbers(study, columns, told):
    found = three_samples(study, lambda s, r, amps: -0.013 * amps * (s == "B"), columns=columns)
    (finding,) = of_kind(found, "sample_apart")
    assert finding.numbers["times_s_r"] > 10.0 and told in finding.detail and "nan" not in finding.detail
    assert ("Before the load" in finding.detail) == bool(told)


def test_samples_that_differ_as_little_as_their_runs_are_not_apart(study):
    assert not of_kind(three_samples(study, lambda s, r, amps: 0.015 * (s == "B")), "sample_apart")


def test_a_run_that_is_an_outlier_all_along_is_one_finding(study):
    outliers = of_kind(three_samples(study, lambda s, r, amps: -0.3 * (s == "B" and r == 5)), "outlier")
    (whole,) = [f for f in outliers if f.numbers["instants"] > 3]
    assert whole.title == "Run 5 of sample B is an outlier at 0 to 10 min (voltage)" and whole.severity == "warning"


def test_ageing_is_no_step(study):
    (finding,) = of_kind(three_samples(study, lambda s, r, amps: -0.03 * (r - 1) * (amps > 0)), "drift")
    assert "goes down from the first run to the last" in finding.title and "after_run" not in finding.numbers
    assert finding.numbers["step"] == pytest.approx(-0.18, abs=0.02) and finding.severity == "serious"


def test_samples_that_share_a_part_of_their_scatter_still_add_information(study):
    day_V = np.random.default_rng(9).normal(0, 0.008, 11)
    (finding,) = of_kind(
        three_samples(study, lambda s, r, amps: day_V[r] * (s in "AB" and amps > 0), runs=10), "dependent_samples"
    )
    assert 0.2 < finding.numbers["correlation"] < 0.8
    assert finding.severity == "warning" and "share a part of their scatter" in finding.title
