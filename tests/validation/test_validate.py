"""The whole stage on both data sets: verdicts, claims, what ships, JSON; and what it must refuse."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from command import Judged

from uavbatt import dataset
from uavbatt.battery import battery_file
from uavbatt.dataset import DataSet
from uavbatt.errors import NotEnoughData
from uavbatt.validation import as_json, ship
from uavbatt.validation.gating import gate, heldout, precision_claims
from uavbatt.validation.gating.gate import Claim, Limits
from uavbatt.validation.judging.independence import dependence, independence
from uavbatt.validation.study import paper
from uavbatt.validation.validate import Validation, validate

COLUMNS = ("time_s", "voltage_V", "current_A", "surface_C")


@pytest.fixture(scope="module")
def study(judged_study: Judged) -> Validation:
    return judged_study.found


@pytest.fixture(scope="module")
def lab(shared_data: Path) -> Validation:
    return validate(dataset.load(shared_data / "truth" / "lab"))


@pytest.fixture(scope="module")
def four_runs() -> Validation:
    """The study's first four runs of both samples at 25 °C."""
    return validate(repeats_only(dataset.load(), 4), close_loop=False)


def judged_otherwise(before: Validation, *limits: Limits, **options: Any) -> Validation:
    """The same tests by other limits or another method: what the model predicts does not depend on them."""
    with patch.object(heldout, "circuit", return_value=before.held):
        return validate(before.dataset, *limits, close_loop=False, **options)


def claim(v: Validation, name: str, ambient_C: float = 25.0) -> Claim:
    return next(c for c in v.claims if c.claim.startswith(name) and c.ambient_C == ambient_C)


def repeats_only(data: DataSet, runs: int) -> DataSet:
    return replace(data, runs=tuple(r for r in data.at(25.0) if r.sample != "T1" and r.run <= runs))


def test_the_study_s_model_passes_at_25_degrees_and_ships(study: Validation) -> None:
    gating = {c.claim: c.verdict for c in study.claims if c.gates}
    assert gating == {
        "voltage bias (intermediate precision)": "pass",
        "time of 10 V": "pass",
        "time of the knee": "pass",
        "repeatability": "pass",
    }
    assert study.verdict == "pass"
    assert study.battery is not None
    assert study.battery.certificate.validated_ambient_C == [25.0]


def test_a_row_each_minute_is_judged_where_the_model_predicts_one(shared_data: Path) -> None:
    """The first row under load has no prediction. The command ended with a table of a wrong shape."""
    fine = dataset.load(shared_data / "truth" / "lab")
    slow = [replace(r, **{c: getattr(r, c)[::12] for c in COLUMNS}) for r in fine.at(25.0)[:8]]
    found = validate(replace(fine, runs=tuple(slow)), close_loop=False)
    assert 60.0 not in claim(found, "voltage bias").at and 120.0 in claim(found, "voltage bias").at
    assert np.abs(claim(found, "voltage bias").bias).max() < 0.05
    assert np.abs(claim(found, "surface temperature").bias).max() < 1.0


def test_a_run_without_a_current_does_not_take_it_from_the_others(shared_data: Path) -> None:
    fine = dataset.load(shared_data / "truth" / "lab")
    first, *others = fine.at(25.0)[:6]
    blind = replace(fine, runs=(replace(first, current_A=np.full_like(first.current_A, math.nan)), *others))
    found = validate(blind, close_loop=False)
    assert np.abs(claim(found, "voltage bias").bias).max() < 0.05
    assert "unmetered_run" in {f.kind for f in found.findings}


def test_the_progress_adds_up_to_the_whole_work(judged_study: Judged) -> None:
    assert sum(judged_study.shares) == pytest.approx(1.0)
    assert len(judged_study.shares) > 20 and max(judged_study.shares) < 0.15


def test_the_study_says_nothing_of_other_packs(study: Validation) -> None:
    found = claim(study, "reproducibility")
    assert found.verdict == "not enough data"
    assert not found.gates
    assert "depend on each other" in found.reason


def test_repeatability_counts_dependent_samples_once_and_warns_of_the_drift(study: Validation) -> None:
    found = claim(study, "repeatability")
    assert found.statistics["degrees_of_freedom"] == 9.0
    assert found.statistics["A_r"] == pytest.approx(1.96 / math.sqrt(18.0))
    assert "drifts from run to run" in found.reason


def test_every_other_temperature_has_its_claim_and_none_passes(study: Validation) -> None:
    others = [c for c in study.claims if c.ambient_C != 25.0]
    assert [c.ambient_C for c in others] == [t for t in study.dataset.ambients_C if t != 25.0]
    assert "pass" not in {c.verdict for c in others}
    assert not any(c.gates for c in others)
    single = claim(study, "voltage bias", 10.0)
    assert single.verdict == "not enough data"
    assert np.isnan(single.half_width).all() and np.isfinite(single.bias).all()
    near = claim(study, "voltage bias", -5.0)
    assert near.verdict == "fail"  # a model fitted at 25 °C alone is 0.4 V low in the first minutes
    assert np.isfinite(near.half_width).all()


def test_the_rival_is_gated_on_the_same_readings(study: Validation) -> None:
    (rival,), (claims,) = study.rivals, study.rival_claims
    assert rival.model == "regression"
    assert np.array_equal(rival.measured_V, study.held.measured_V)
    names = [c.claim for c in claims if c.ambient_C == 25.0]
    assert names == [c.claim for c in study.claims if c.ambient_C == 25.0 and "abilit" not in c.claim][: len(names)]


def test_what_ships_can_be_read_and_names_what_it_does_not_vouch_for(study: Validation, tmp_path: Path) -> None:
    assert study.battery is not None
    path = battery_file.write_battery(study.battery, tmp_path / "x.battery.toml")
    read = battery_file.read_battery(path)  # a verdict `fail` would be refused
    assert read.certificate.data_sha256 == study.dataset.sha256
    assert any("not vouched for" in r and "-5" in r for r in read.battery.remarks)


def test_the_low_voltage_warning_is_that_of_the_cells_kind(study: Validation) -> None:
    """A lithium-ion pack was warned about at 3.5 V a cell, which it reaches at half its charge."""
    assert study.battery is not None and study.battery.battery.low_V == 10.5
    lower = replace(study.dataset, cutoff_V=8.4)
    shipped = ship.battery_file(lower, study.held, study.corridors[25.0], list(study.claims), study.limits, {})
    assert shipped.battery.low_V == 9.6


def test_a_limit_that_the_model_does_not_meet_ships_nothing(four_runs: Validation) -> None:
    found = judged_otherwise(four_runs, Limits(voltage_V=0.01))
    assert found.verdict == "fail"
    assert found.battery is None


def test_what_ships_tells_the_misfit_at_the_instants_that_the_declared_limits_judge(four_runs: Validation) -> None:
    found = judged_otherwise(four_runs, Limits(1.0, 100.0, limiter_margin_V=1.0, precision_A_r=2.0))
    at = gate.judged_instants(found.held, found.limits, found.dataset.cutoff_V)
    assert at.size < gate.judged_instants(found.held, Limits(), found.dataset.cutoff_V).size
    assert found.battery is not None
    gap_V = (found.held.model_V - found.held.measured_V)[:, :, at]
    assert found.battery.discrepancy.voltage_rmse_V == pytest.approx(math.sqrt(np.mean(gap_V**2)), rel=1e-5)


def test_by_the_paper_the_corridor_decides(four_runs: Validation) -> None:
    found = judged_otherwise(four_runs, method="paper")
    assert [c.claim for c in found.claims if c.gates] == ["inside the corridor x̄ ± C"]


def test_three_occasions_are_too_few_to_know_the_repeatability() -> None:
    found = validate(repeats_only(dataset.load(), 3), close_loop=False)
    assert claim(found, "repeatability").verdict == "not enough data"
    assert found.verdict != "pass"


def test_a_set_without_repeats_is_not_enough_data() -> None:
    data = dataset.load()
    for runs in (
        tuple(r for r in data.runs if r.sample == "T1"),
        tuple(r for r in data.at(25.0) if r.run <= 2 and r.sample != "T1"),
    ):
        with pytest.raises(NotEnoughData, match="repeated"):
            validate(replace(data, runs=runs))


def test_json_holds_every_number_and_no_nan(study: Validation) -> None:
    values = as_json.to_builtins(study, paper.replay(study.dataset, 25.0))
    text = json.dumps(values, allow_nan=False)
    again = json.loads(text)
    assert {"claims", "precision", "corridors", "findings", "drifts", "rivals", "temperatures", "paper"} <= set(again)
    assert len(again["claims"]) == len(study.claims)
    assert again["precision"][0]["precision"]["s_r"] == study.precision[0].precision.s_r
    assert again["precision"][0]["precision"]["A_r"] > 0.0
    assert again["claims"][0]["budget"]["rows"][0]["source"] == "scatter of the occasions"
    assert again["corridors"]["10"]["C"][0] is None
    assert again["paper"]["agreements"][0]["agree"] == 45
    assert again["dataset"]["sha256"] == study.dataset.sha256


def test_samples_that_are_copies_are_dependent_and_independent_ones_are_not() -> None:
    rng = np.random.default_rng(3)
    fresh = rng.normal(0.0, 1.0, (8, 3, 6))
    copied = np.repeat(rng.normal(0.0, 1.0, (8, 1, 6)), 3, axis=1) + 0.1 * fresh
    assert dependence(fresh).dependent is False
    assert dependence(copied).dependent is True
    assert dependence(fresh[:3, :2]).dependent is None


def test_independent_samples_are_called_dependent_as_rarely_as_declared() -> None:
    rng = np.random.default_rng(4)
    called = [dependence(rng.normal(size=(5, 3, 4))).dependent for _ in range(60)]
    assert sum(bool(c) for c in called) <= 3


def test_readings_of_one_step_of_the_meter_are_identical_to_the_claim_as_to_the_finding(four_runs: Validation) -> None:
    rng, base = np.random.default_rng(8), four_runs
    alike = np.arange(9) < 4  # the samples agree in part of the readings, but for the offset of a meter
    values = np.where(alike, 0.1 * rng.integers(-3, 4, (8, 1, 9)), rng.normal(0.0, 5.0, (8, 2, 9)))
    values += 11.0 + np.array([0.0, 0.01])[:, None]
    held = replace(base.held, measured_V=values, model_V=values)
    levels = dataset.Levels(25.0, "voltage_V", ("a", "b"), tuple(range(8)), base.held.time_s, values)
    known = dataset.Uncertainty(voltage_resolution_V=0.1)
    said = precision_claims.reproducibility_claim(held, levels, Limits(), 9.3, known).reason
    assert independence(values[:, 0], values[:, 1], resolution=0.1).dependent and "depend on each other" in said


def test_reproducibility_is_judged_with_three_independent_samples_and_a_bad_one_stops_it(
    four_runs: Validation,
) -> None:
    rng, base = np.random.default_rng(6), four_runs
    time_s, curve = base.held.time_s, base.held.measured_V.mean(axis=(0, 1))
    known = base.dataset.uncertainty

    def judged(between_V: float) -> str:
        offset = between_V * np.array([-1.0, 0.0, 1.0])[None, :, None]
        values = curve + offset + rng.normal(0.0, 0.01, (8, 3, time_s.size))
        held = replace(base.held, measured_V=values, model_V=np.broadcast_to(curve, values.shape))
        levels = dataset.Levels(25.0, "voltage_V", ("a", "b", "c"), tuple(range(8)), time_s, values)
        wide = Limits(precision_A_R=10.0)
        return precision_claims.reproducibility_claim(held, levels, wide, 9.3, known).verdict

    assert judged(0.0) == "pass"
    assert judged(0.1) == "not enough data"


@pytest.mark.slow  # a second data set; the study and samples made up above are its witness
def test_the_lab_set_is_judged_under_load_and_at_rest_apart(lab: Validation) -> None:
    assert lab.held.at_rest.tolist() == [True] + [False] * (lab.held.time_s.size - 1)
    assert claim(lab, "voltage bias").verdict == "pass"
    assert np.abs(claim(lab, "voltage bias").bias[0]) < 0.05  # at rest, where a window across the step was 0.2 V off
    assert claim(lab, "repeatability").verdict == "pass"
    assert claim(lab, "reproducibility").verdict == "pass"
    assert abs(claim(lab, "time of 13.33 V").bias[0]) < 6.0
    assert lab.temperatures is None


@pytest.mark.slow
def test_the_lab_set_ships_if_and_only_if_every_gating_claim_passes(lab: Validation) -> None:
    assert lab.verdict == gate.overall(lab.claims) == "pass"
    assert lab.battery is not None
    assert lab.battery.battery.capacity_Ah == 5.0
    assert json.dumps(as_json.to_builtins(lab), allow_nan=False)
