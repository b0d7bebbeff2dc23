"""The gate: what must fail fails, noise never helps, the budget is what it says."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from command import Judged
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy import stats

from uavbatt import dataset
from uavbatt.battery.model import Array
from uavbatt.dataset import DataSet, Uncertainty
from uavbatt.errors import NotEnoughData
from uavbatt.validation.gating import budget, gate, heldout
from uavbatt.validation.gating.gate import Limits
from uavbatt.validation.gating.heldout import HeldOut
from uavbatt.validation.judging import fast_records
from uavbatt.validation.judging.readings import read_once

RANK = {"fail": 0, "not enough data": 1, "pass": 2}
LIMITS = Limits()


@pytest.fixture(scope="module")
def study() -> DataSet:
    return dataset.load()


@pytest.fixture(scope="module")
def held(judged_study: Judged) -> HeldOut:
    return judged_study.found.held


def claims(study: DataSet, held: HeldOut) -> list[gate.Claim]:
    known, cutoff_V = study.uncertainty, study.cutoff_V
    return [
        gate.voltage_claim(held, LIMITS, cutoff_V, known),
        gate.crossing_claim(held, LIMITS, known),
        gate.knee_claim(held, LIMITS, cutoff_V, known),
    ]


def test_the_study_s_circuit_model_passes_on_occasions_it_has_not_seen(study: DataSet, held: HeldOut) -> None:
    assert [c.verdict for c in claims(study, held)] == ["pass", "pass", "pass"]
    assert np.sqrt(np.mean(held.residual_V() ** 2)) < 0.08


@pytest.mark.parametrize("shift_V", [0.2, -0.2])
def test_a_model_shifted_by_0_2_V_fails(study: DataSet, held: HeldOut, shift_V: float) -> None:
    shifted = claims(study, replace(held, model_V=held.model_V + shift_V))
    assert shifted[0].verdict == "fail"
    assert gate.overall(shifted) == "fail"
    assert "beyond ±0.15" in shifted[0].reason


def test_a_model_with_shuffled_time_fails(study: DataSet, held: HeldOut) -> None:
    for seed in range(5):
        order = np.random.default_rng(seed).permutation(held.time_s.size)
        assert claims(study, replace(held, model_V=held.model_V[:, :, order]))[0].verdict == "fail"


def test_a_straight_line_fails(study: DataSet, held: HeldOut) -> None:
    mean_V = held.measured_V.mean(axis=(0, 1))
    line = np.polyval(np.polyfit(held.time_s, mean_V, 1), held.time_s)
    verdicts = [c.verdict for c in claims(study, replace(held, model_V=np.broadcast_to(line, held.model_V.shape)))]
    assert verdicts[0] == "fail"
    assert "fail" in verdicts[1:]


def test_a_model_that_is_late_by_20_s_fails_in_time_but_one_late_by_3_s_does_not(study: DataSet, held: HeldOut) -> None:
    def late(by_s: float) -> HeldOut:
        model = np.array([np.interp(held.time_s - by_s, held.time_s, c) for c in held.model_V.reshape(-1, 9)])
        return replace(held, model_V=model.reshape(held.model_V.shape))

    assert gate.crossing_claim(late(20.0), LIMITS, study.uncertainty).verdict == "fail"
    assert gate.crossing_claim(late(1.0), LIMITS, study.uncertainty).bias[0] > 1.0


def test_a_model_that_never_falls_fails_although_its_error_cannot_be_timed(study: DataSet, held: HeldOut) -> None:
    flat = replace(held, model_V=np.full_like(held.model_V, 11.0))
    assert gate.crossing_claim(flat, LIMITS, study.uncertainty).verdict == "fail"


@pytest.mark.parametrize(("after_s", "verdict"), [(5.0, "not enough data"), (60.0, "fail")])
def test_a_record_that_ends_right_after_the_crossing_does_not_show_how_late_the_model_is(
    study: DataSet, held: HeldOut, after_s: float, verdict: str
) -> None:
    time_s = np.arange(0.0, 400.0 + after_s + 1.0, 5.0)
    measured_V = 10.0 + 0.01 * (400.0 - time_s)
    model_V = measured_V + 0.01 * (after_s + 10.0)
    curves = tuple(heldout.Curve(k, 0, time_s, measured_V, model_V) for k in range(10))
    claim = gate.crossing_claim(replace(held, curves=curves), LIMITS, study.uncertainty)
    assert claim.verdict == verdict


def test_wider_limits_are_an_option_and_narrow_ones_stop_the_model(study: DataSet, held: HeldOut) -> None:
    def verdict(limit_V: float) -> str:
        return gate.voltage_claim(held, Limits(voltage_V=limit_V), study.cutoff_V, study.uncertainty).verdict

    assert [verdict(v) for v in (0.005, 0.05, 0.15)] == ["fail", "not enough data", "pass"]
    assert Limits().for_cells(6).voltage_V == pytest.approx(0.3)
    assert Limits(time_s=7.0).for_cells(6).time_s == 7.0


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.floats(1.0, 20.0))
def test_noisier_tests_never_make_the_gate_easier(seed: int, factor: float) -> None:
    known = Uncertainty(voltage_calibration_V=0.01)
    base = _synthetic(np.random.default_rng(seed))
    mean_V = base.measured_V.mean(axis=0)
    noisy = replace(base, measured_V=mean_V + factor * (base.measured_V - mean_V))
    a, b = (gate.voltage_claim(h, LIMITS, 9.3, known) for h in (base, noisy))
    assert (b.half_width >= a.half_width - 1e-12).all()
    assert RANK[b.verdict] <= RANK[a.verdict]


def test_more_and_more_reading_noise_ends_the_pass_of_the_study_s_model(study: DataSet, held: HeldOut) -> None:
    noise = np.random.default_rng(5).normal(0.0, 1.0, held.measured_V.shape)
    noise -= noise.mean(axis=0)
    found = [
        claims(study, replace(held, measured_V=held.measured_V + sd_V * noise))[0] for sd_V in (0.0, 0.1, 0.2, 0.4)
    ]
    assert found[0].verdict == "pass"
    assert {c.verdict for c in found[2:]} == {"not enough data"}
    widths = [float(c.half_width.max()) for c in found]
    assert widths == sorted(widths)


def _synthetic(rng: np.random.Generator) -> HeldOut:
    time_s = 60.0 * np.arange(6)
    curve = 12.0 - 0.004 * time_s
    occasions = rng.normal(0.0, 0.03, (8, 1, 6))
    occasions -= occasions.mean(axis=0)
    model = np.broadcast_to(curve + rng.uniform(-0.2, 0.2), (8, 1, 6))
    return HeldOut("line", 25.0, 3, time_s, curve + occasions, model)


def judged(residual: Array, u_B: float, limit: float = 0.15) -> tuple[Array, gate.Verdict]:
    """Half width and verdict of residuals [occasion, instant], with what their scatter does not show beside it."""
    n, instants = residual.shape
    u_A = residual.std(axis=0, ddof=1) / math.sqrt(n)
    half = budget.expand(u_A, n - 1.0, np.full(instants, u_B), instants).half
    return half, gate.decide(residual.mean(axis=0), half, limit)[0]


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.floats(-0.3, 0.3), min_size=3, max_size=8),
    st.floats(1.0, 50.0),
    st.floats(0.0, 0.1),
    st.floats(0.0, 0.1),
)
@example([0.0, 0.0, 0.125], 1.0, 0.0, 0.03125)  # t(ν)·u alone would pass it: a doubt that narrows the interval
def test_equivalence_is_monotone_in_scatter_and_in_what_the_scatter_hides(
    values: list[float], factor: float, u_B: float, more: float
) -> None:
    residual = np.array(values)[:, None]
    mean = residual.mean(axis=0)

    def verdict(scale: float, hidden: float) -> int:
        return RANK[judged(mean + scale * (residual - mean), hidden)[1]]

    assert verdict(factor, u_B) <= verdict(1.0, u_B)
    assert verdict(1.0, u_B + more) <= verdict(1.0, u_B)


def pass_share(bias_V: float) -> float:
    """Share of 2000 sets of ten occasions, 20 mV of scatter, that pass at a limit of 0.15 V."""
    rng = np.random.default_rng(7)
    residuals = bias_V + rng.normal(0.0, 0.02, (2000, 10, 1))
    return float(np.mean([judged(r, 0.0)[1] == "pass" for r in residuals]))


def test_a_bias_at_the_limit_passes_in_5_percent_and_one_well_inside_always() -> None:
    assert pass_share(0.15) == pytest.approx(0.05, abs=0.015)  # three standard errors of a share of 2000
    assert pass_share(0.10) == 1.0  # the half width is 12 mV
    assert pass_share(0.17) < 0.001


def test_the_half_width_is_the_t_interval_without_type_B_and_welch_satterthwaite_with_it() -> None:
    residual = np.array([[0.01], [-0.02], [0.03], [0.0]])
    u_A = residual.std(ddof=1) / 2.0
    assert judged(residual, 0.0)[0][0] == pytest.approx(stats.t.ppf(0.95, 3) * u_A)
    with_B = judged(residual, u_A)[0][0]
    assert with_B == pytest.approx(stats.t.ppf(0.95, 12.0) * u_A * math.sqrt(2.0))  # 3·(√2)⁴ degrees of freedom


def test_a_pack_that_recovers_after_the_limiter_took_over_is_not_judged_again() -> None:
    curve = np.array([12.4, 11.0, 9.8, 9.3, 10.9])
    values = np.broadcast_to(curve, (3, 2, curve.size))
    held = HeldOut("line", 25.0, 3, 60.0 * np.arange(curve.size), values, values)
    assert gate.judged_instants(held, LIMITS, 9.3).tolist() == [0, 1, 2]


def test_two_occasions_are_not_enough(study: DataSet, held: HeldOut) -> None:
    two = replace(held, measured_V=held.measured_V[:2], model_V=held.model_V[:2])
    found = claims(study, two)
    assert {c.verdict for c in found} == {"not enough data"}
    assert gate.overall(found) == "not enough data"
    assert all(c.gates for c in found)


def test_the_budget_adds_up_and_names_every_source(study: DataSet, held: HeldOut) -> None:
    b = gate.voltage_claim(held, LIMITS, study.cutoff_V, study.uncertainty).budget
    assert b is not None
    sources = [r.source for r in b.rows]
    assert sources == [
        "scatter of the occasions", "drift over the runs", "calibration of the voltmeter",
        "resolution of the voltmeter", "instant of reading",
    ]  # fmt: skip
    assert b.combined == pytest.approx(np.sqrt(sum(r.u**2 for r in b.rows)))
    assert b.expanded == pytest.approx(b.factors * b.combined)
    at_6_min = float(b.rows[4].u[6])
    assert at_6_min == pytest.approx(abs(9.3665 - 10.472) / 120.0 * 5.0 / math.sqrt(3.0), rel=0.02)
    assert b.rows[3].u[0] == pytest.approx(0.01 / math.sqrt(12.0))
    assert (b.rows[1].u[1:4] > 0.02).all()  # the study's step after run 6


@pytest.mark.parametrize("occasions", [4, 8])
def test_with_a_perfect_thermometer_a_budget_has_one_degree_of_freedom_less_than_occasions(occasions: int) -> None:
    residual_K = np.resize([1.0, -1.0, -1.0, 1.0], (occasions, 1)) * np.ones((1, 2))  # the halves have equal means
    b = budget.surface_budget(np.array([0.0, 60.0]), residual_K, Uncertainty(temperature_calibration_C=0.0))
    assert b.df == pytest.approx(occasions - 1.0)
    assert b.combined == pytest.approx(residual_K.std(axis=0, ddof=1) / math.sqrt(occasions))


def test_the_slope_is_not_taken_across_the_start_of_the_load(held: HeldOut) -> None:
    slope = budget.loaded_slope(held)
    assert slope[0] == 0.0
    assert slope[1] < 0.006  # 12.50 -> 10.85 V over two minutes would be 0.014 V/s


def test_what_a_data_set_does_not_state_is_assumed_and_never_zero(held: HeldOut) -> None:
    unstated = Uncertainty()
    b = budget.voltage_budget(held, np.arange(7), held.residual_V()[:, :7], unstated)
    stated = {r.source: r for r in b.rows}
    assert (stated["calibration of the voltmeter"].u > 0.005).all()
    assert "assumed" in stated["calibration of the voltmeter"].how
    assert "assumed" in stated["instant of reading"].how
    assert (stated["resolution of the voltmeter"].u > 0.0).all()


def test_the_corridor_informs_by_iso_and_decides_by_the_paper(study: DataSet, held: HeldOut) -> None:
    mean_V, narrow = held.measured_V.mean(axis=(0, 1)), np.full(held.time_s.size, 1e-4)
    by_iso = gate.corridor_claim(held, mean_V, narrow, LIMITS, study.cutoff_V)
    by_paper = gate.corridor_claim(held, mean_V, narrow, LIMITS, study.cutoff_V, gates=True)
    assert by_iso.verdict == by_paper.verdict == "fail"
    assert gate.overall([by_iso]) == "not enough data"
    assert gate.overall([by_paper]) == "fail"


def test_changing_a_run_does_not_change_its_own_prediction(study: DataSet) -> None:
    short = replace(study, runs=tuple(r for r in study.at(25.0) if r.sample != "T1" and r.run <= 2))
    spoilt = tuple(replace(r, voltage_V=r.voltage_V - 0.3) if r.run == 1 else r for r in short.runs)
    before, after = heldout.circuit(read_once(short)), heldout.circuit(read_once(replace(short, runs=spoilt)))
    assert after.model_V[0] == pytest.approx(before.model_V[0], abs=1e-9)
    assert np.abs(after.model_V[1] - before.model_V[1]).max() > 0.01


def test_a_test_that_nobody_repeated_cannot_be_left_out(study: DataSet) -> None:
    once = replace(study, runs=tuple(r for r in study.at(25.0) if r.run == 1))
    for runs in (once.runs, tuple(r for r in once.runs if r.sample == "T1")):
        with pytest.raises(NotEnoughData, match="expected repeated runs at one ambient temperature"):
            heldout.circuit(read_once(replace(once, runs=runs)))


def test_instants_before_the_load_are_at_rest_by_the_current_or_by_the_clock(study: DataSet, held: HeldOut) -> None:
    """The study tells no current: its first row, at 0 s, is the one before the load."""
    assert held.at_rest.tolist() == [True] + [False] * (held.time_s.size - 1)
    late = [
        replace(r, current_A=np.where(r.time_s > 60.0, 15.0, 0.0), surface_C=np.full(r.time_s.size, np.nan))
        for r in study.at(25.0) if r.sample == "1" and r.run <= 2
    ]  # fmt: skip
    readings = read_once(replace(study, runs=tuple(late), capacity_Ah=2.1, flags=()))
    levels = heldout.repeats(readings)
    assert heldout.rest_at(readings.dataset, levels) == tuple((levels.time_s <= 60.0).tolist())


def test_a_fast_record_is_judged_at_every_row_and_a_hand_read_one_at_its_minutes(study: DataSet) -> None:
    found = [r for r in study.at(25.0) if r.sample == "1" and r.run <= 2]
    load_A = 15.0  # 2 Ah in the eight minutes
    every_s = np.arange(0.0, found[0].time_s[-1] + 1.0, 15.0)

    def read_every(time_s: Array) -> DataSet:
        runs = tuple(
            replace(r, time_s=time_s, voltage_V=np.interp(time_s, r.time_s, r.voltage_V),
                    surface_C=np.full(time_s.size, np.nan), current_A=np.where(time_s > 0.0, load_A, 0.0))
            for r in found
        )  # fmt: skip
        return replace(study, runs=runs, capacity_Ah=2.1, flags=())

    by_hand, logged = (heldout.circuit(read_once(read_every(at_s))) for at_s in (found[0].time_s, every_s))
    assert by_hand.curves == () and (by_hand.row_s, logged.row_s) == (60.0, 15.0)
    assert [(c.occasion, c.sample) for c in logged.curves] == [(0, 0), (1, 0)]
    for curve in logged.curves:
        at = np.isin(curve.time_s, logged.time_s)
        assert curve.time_s.size > 3 * logged.time_s.size
        assert curve.model_V[at] - curve.measured_V[at] == pytest.approx(
            logged.residual_V()[curve.occasion, : at.sum()], abs=0.02
        )


def test_a_straight_record_is_read_exactly_and_noise_goes_down() -> None:
    time_s = np.arange(0.0, 301.0, 5.0)
    phase = np.zeros(time_s.size, dtype=np.intp)
    w = fast_records.weights(time_s, phase, np.array([60.0, 120.0]))
    assert w @ (15.0 - 0.01 * time_s) == pytest.approx([14.4, 13.8])
    assert (np.sqrt((w**2).sum(axis=1)) < 0.5).all()


def test_a_window_never_reaches_across_a_load_step() -> None:
    time_s = np.arange(0.0, 121.0, 5.0)
    current = np.where(time_s >= 20.0, 12.0, 0.0)
    volts = np.where(time_s >= 20.0, 15.0, 16.8)
    w = fast_records.weights(time_s, fast_records.phases(current), np.array([0.0, 15.0, 20.0, 25.0]))
    assert w @ volts == pytest.approx([16.8, 16.8, 15.0, 15.0])


def test_hand_read_tables_stay_as_they_are(study: DataSet) -> None:
    assert fast_records.at_minutes(study).runs == study.runs
