"""The state-of-charge filter: the closed-form Kalman recursion, consistency, and bad or missing rows."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from factories import generic_pack as pack
from factories import with_spread
from hypothesis import given, settings
from hypothesis import strategies as st

from uavbatt.battery import state_space as b
from uavbatt.battery.initial_state import state_under_load
from uavbatt.battery.model import SOC_GRID, Array, Parameters
from uavbatt.battery.pack import Installation, grown, metered_voltage, terminal_voltage
from uavbatt.battery.scaling import Pack
from uavbatt.battery.state_space import SIZE, X
from uavbatt.estimation import noise, recursion
from uavbatt.estimation.filter import SocFilter, estimate_of
from uavbatt.records import NAN, Estimate, Sample, Status
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight

DT_S = 2.0
READING_SD_V = 0.012  # a cell
WALK = np.array([3e-5, 4e-4, 4e-4, 0.03, 0.03, 3e-4, 3e-4, 8e-4, 2e-4])  # sd of each component after a second


@pytest.fixture
def plain_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    """Noise that does not depend on the state: how much there is, is tuning; what is done with it, is not."""
    with_plain_noise(monkeypatch)


def with_plain_noise(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(noise, "process_variances", lambda made, mean, rate_c, dt_s: WALK**2 * dt_s)
    patch.setattr(noise, "reading_variance", lambda made, mean, *_: np.full(mean.shape[1:], (4 * READING_SD_V) ** 2))


def known_pack() -> Pack:
    """The generic cell in a pack that scatters little, so that the filter's linearisation is good."""
    return with_spread(
        pack(),
        resistance_scale_sd=0.06, capacity_scale_sd=0.02, bias_sd_V=0.005, bias_tau_s=120.0, reaction_sd_V=0.005,
        ocv_sd_V=np.zeros(SOC_GRID.size), ocv_drift_sd_V=np.zeros(SOC_GRID.size),
        temperature_sd_K=0.4, empty_soc_sd=0.0,
    )  # fmt: skip


def flat(time_s: float, current_A: float = 15.0, voltage_V: float = 15.6, temp_C: float = 25.0) -> Sample:
    return Sample(time_s, voltage_V, current_A, temp_C)


# --- the closed form ---------------------------------------------------------------------------------------------

SLOPE_V, FLOOR_V, R0 = 0.9, 3.3, 0.02


def linear_pack() -> Pack:
    """OCV = 3.3 + 0.9 soc V, R0 = 0.02 ohm·Ah at every temperature, no other effect: everything is linear but exp."""
    cell = Parameters(ocv_V=FLOOR_V + SLOPE_V * SOC_GRID, r0_ohmAh=np.full(SOC_GRID.size, R0))
    return known_pack()._replace(cell=cell, installation=Installation(4, 5.0))


class ClosedForm:
    """The Kalman recursion for `linear_pack`, with Jacobians written down by hand."""

    def __init__(self, mean: Array, covariance: Array, ambient_C: float) -> None:
        self.x, self.P, self.ambient_C = mean, covariance, ambient_C

    def predict(self, current_A: float, dt_s: float) -> None:
        made, x = linear_pack(), self.x
        rate = current_A / (5.0 * math.exp(x[X.LOG_CAPACITY]))
        keep = {
            X.POLARISATION: math.exp(-dt_s / made.cell.polarisation_tau_s),
            X.DIFFUSION: math.exp(-dt_s / made.cell.diffusion_tau_s),
            X.CORE: math.exp(-dt_s * made.cell.cooling_WpKAh / made.cell.heat_capacity_JpKAh),
            X.SENSOR: math.exp(-dt_s / made.cell.sensor_lag_s),
            X.BIAS: math.exp(-dt_s / made.spread.bias_tau_s),
        }
        F = np.eye(SIZE)
        for component, factor in keep.items():
            F[component, component] = factor
        F[X.SOC, X.LOG_CAPACITY] = rate * dt_s / 3600.0
        F[X.SENSOR, X.CORE] = (1.0 - keep[X.SENSOR]) * keep[X.CORE]
        core_C = self.ambient_C + (x[X.CORE] - self.ambient_C) * keep[X.CORE]
        self.x = F @ x
        self.x[X.SOC] = x[X.SOC] - rate * dt_s / 3600.0
        self.x[X.CORE] = core_C
        self.x[X.SENSOR] = core_C + (x[X.SENSOR] - core_C) * keep[X.SENSOR]
        self.P = F @ self.P @ F.T + np.diag(WALK**2 * dt_s)

    def update(self, sample: Sample) -> tuple[float, float]:
        x = self.x
        rate = sample.current_A / (5.0 * math.exp(x[X.LOG_CAPACITY]))
        drop_V = rate * R0 * math.exp(x[X.LOG_RESISTANCE])
        share = rate / (rate + linear_pack().cell.transfer_half_rate)  # of the reaction's drop at a large load
        cell_V = FLOOR_V + SLOPE_V * x[X.SOC] - x[X.POLARISATION] - x[X.DIFFUSION] - drop_V + x[X.BIAS]
        expected_V = 4 * (cell_V - share * x[X.REACTION])
        H = np.zeros((2, SIZE))
        H[0, [X.SOC, X.POLARISATION, X.DIFFUSION, X.BIAS]] = 4 * SLOPE_V, -4, -4, 4
        bent_V = share * (1.0 - share) * x[X.REACTION]  # that share falls with a larger capacity
        H[0, X.LOG_RESISTANCE], H[0, X.LOG_CAPACITY] = -4 * drop_V, 4 * (drop_V + bent_V)
        H[0, X.REACTION] = -4 * share
        H[1, X.SENSOR] = 1.0
        R = np.diag([(4 * READING_SD_V) ** 2, 0.4**2])
        innovation = np.array([sample.voltage_V - expected_V, sample.temp_C - x[X.SENSOR]])
        S = H @ self.P @ H.T + R
        gain = self.P @ H.T @ np.linalg.inv(S)
        self.x = x + gain @ innovation
        self.P = (np.eye(SIZE) - gain @ H) @ self.P
        return float(innovation[0]), float(innovation @ np.linalg.inv(S) @ innovation)


@pytest.mark.usefixtures("plain_noise")
def test_the_linear_case_is_the_closed_form() -> None:
    """Mean, covariance, innovation and NIS equal the recursion by hand over 200 rows of uneven spacing."""
    rng = np.random.default_rng(11)
    ours = SocFilter(linear_pack(), ambient_C=22.0)
    time_s, before_A, soc = 0.0, 12.0, 0.8
    ours.step(Sample(0.0, 4 * (FLOOR_V + SLOPE_V * soc - 12 / 5 * R0), before_A, 22.0))
    start = ours.belief
    assert start is not None
    theirs = ClosedForm(start.mean, start.covariance, start.ambient_C)
    for _ in range(200):
        dt_s, current_A = float(rng.uniform(2.0, 5.0)), float(rng.uniform(8.0, 25.0))
        time_s += dt_s
        soc -= 0.5 * (before_A + current_A) / 5.0 * dt_s / 3600.0
        true_V = 4 * (FLOOR_V + SLOPE_V * soc - current_A / 5.0 * R0)
        sample = Sample(time_s, true_V + rng.normal(0, 0.02), current_A, 22.0 + rng.normal(0, 0.3))
        estimate = ours.step(sample)
        theirs.predict(0.5 * (before_A + current_A), dt_s)
        innovation_V, nis = theirs.update(sample)
        before_A = current_A
        belief = ours.belief
        assert belief is not None
        assert belief.mean == pytest.approx(theirs.x, abs=1e-6)
        sd = np.sqrt(np.diag(theirs.P))
        assert belief.covariance / np.outer(sd, sd) == pytest.approx(theirs.P / np.outer(sd, sd), abs=1e-5)
        assert estimate.innovation_V == pytest.approx(innovation_V, abs=1e-6)
        assert estimate.nis == pytest.approx(nis, rel=1e-4, abs=1e-6)


# --- consistency -------------------------------------------------------------------------------------------------


def own_flight(seed: int, rows: int, made: Pack) -> tuple[list[Estimate], list[float]]:
    """The filter on data drawn from its own model with its own noise, and the true soc of each row."""
    rng = np.random.default_rng(seed)
    ours, before_A = SocFilter(made), 12.0
    first_V = float(b.voltage(made, np.array([0.8, 0, 0, 20, 20, 0, 0, 0, 0.0]), before_A))
    ours.step(Sample(0.0, first_V, before_A, 20.0))
    belief = ours.belief
    assert belief is not None
    x = belief.mean + np.linalg.cholesky(belief.covariance) @ rng.standard_normal(SIZE)
    estimates, truth, gust_A = [], [], 0.0
    for k in range(1, rows + 1):
        gust_A = 0.9 * gust_A + rng.normal(0.0, 1.0)
        current_A = 12.0 + gust_A
        mean_A = 0.5 * (before_A + current_A)
        x = b.transition(made, x, mean_A, belief.ambient_C, DT_S) + WALK * math.sqrt(DT_S) * rng.standard_normal(SIZE)
        volts = float(b.voltage(made, x, current_A)) + 4 * READING_SD_V * rng.standard_normal()
        temp_C = float(x[X.SENSOR]) + made.spread.temperature_sd_K * rng.standard_normal()
        estimates.append(ours.step(Sample(k * DT_S, volts, current_A, temp_C)))
        truth.append(float(x[X.SOC]))
        before_A = current_A
    return estimates, truth


@pytest.fixture(scope="module")
def own_flights() -> list[tuple[list[Estimate], list[float]]]:
    with pytest.MonkeyPatch.context() as patch:
        with_plain_noise(patch)
        return [own_flight(seed, 300, known_pack()) for seed in range(12)]


def test_nis_is_inside_its_band(own_flights: list[tuple[list[Estimate], list[float]]]) -> None:
    """Mean normalised innovation squared of voltage and temperature: 2, within 99.9 % of chi-square / N."""
    nis = np.array([e.nis for estimates, _ in own_flights for e in estimates[20:]])
    assert np.isfinite(nis).all()
    half_width = 3.29 * math.sqrt(2.0 * 2.0 / nis.size)
    assert abs(nis.mean() - 2.0) < half_width + 0.05  # 0.05: the model is curved, the filter is straight


def test_innovations_are_white(own_flights: list[tuple[list[Estimate], list[float]]]) -> None:
    lagged = [
        np.corrcoef(v[:-1], v[1:])[0, 1]
        for v in (np.array([e.innovation_V for e in estimates[20:]]) for estimates, _ in own_flights)
    ]
    assert abs(float(np.mean(lagged))) < 3.29 / math.sqrt(280 * len(lagged))


def test_soc_error_is_what_the_filter_says(own_flights: list[tuple[list[Estimate], list[float]]]) -> None:
    """NEES of soc over flights: neither overconfident nor useless."""
    for row in (100, 299):
        z = [(es[row].soc - truth[row]) / es[row].soc_sd for es, truth in own_flights]
        nees = float(np.mean(np.square(z)))
        assert 0.15 < nees < 2.75, row  # 99.9 % of chi-square with 12 degrees of freedom, over 12


def test_covariance_stays_a_covariance() -> None:
    ours = SocFilter(pack())
    for sample in simulate_flight(pack(), SimulatedFlight(250.0, 5.0, seed=3))[::6]:
        ours.step(sample)
        belief = ours.belief
        assert belief is not None
        assert belief.covariance == pytest.approx(belief.covariance.T)
        assert np.linalg.eigvalsh(belief.covariance).min() > -1e-12
        assert np.isfinite(belief.mean).all()


# --- flights -----------------------------------------------------------------------------------------------------


@cache
def flight(ambient_C: float = 20.0, start_soc: float = 1.0) -> tuple[Sample, ...]:
    return tuple(simulate_flight(pack(), SimulatedFlight(250.0, ambient_C, start_soc, rate_Hz=1.0, seed=5)))


def true_soc(sample: Sample, start_soc: float = 1.0) -> float:
    return start_soc - sample.consumed_Ah / 5.0


def run(samples: list[Sample] | tuple[Sample, ...]) -> tuple[SocFilter, list[Estimate]]:
    ours = SocFilter(pack())
    return ours, [ours.step(s) for s in samples]


@pytest.mark.parametrize("start_soc", [1.0, 0.7])
def test_start_at_rest(start_soc: float) -> None:
    samples = flight(start_soc=start_soc)
    _, estimates = run(samples[:10])
    assert estimates[0].soc == pytest.approx(start_soc, abs=3 * estimates[0].soc_sd + 0.005)
    assert estimates[0].soc_sd < 0.15 and (start_soc < 1.0 or estimates[0].status is Status.OK)


def test_start_under_load_is_wide_and_comes_right() -> None:
    """A log that starts in the air: converging at first, then as right as one that starts at rest."""
    samples = flight()
    loaded = samples[200:]
    _, estimates = run(loaded)
    assert estimates[0].status is Status.CONVERGING and estimates[0].soc_sd > 0.06
    assert "charge known to" in estimates[0].reason
    assert estimates[-1].status is Status.OK
    for sample, estimate in list(zip(loaded, estimates, strict=True))[::50]:
        assert abs(estimate.soc - true_soc(sample)) < 3.0 * estimate.soc_sd + 0.01


INSTALLED = {
    "nothing": {}, "harness": {"harness_ohm": 0.04}, "grown resistance": {"growth": 1.0}, "weak cell": {"deficit": 0.1},
    "fade": {"fade": 0.2}, "sensors": {"gain_V": 0.98, "offset_V": 0.1, "gain_I": 0.95, "unmetered_W": 10.0},
}  # fmt: skip


@pytest.mark.parametrize("installed", INSTALLED.values(), ids=INSTALLED.keys())
def test_a_start_under_load_knows_what_the_battery_file_says_of_the_installation(installed: dict[str, float]) -> None:
    """A log that begins in the air: the first charge is right, and the first row's voltage is what is expected."""
    there = pack()._replace(installation=pack().installation._replace(**installed))
    cell, rate, soc = grown(there.cell, there.installation), 5.0, 0.6
    state, true_A = state_under_load(cell, soc, 25.0, rate), rate * there.installation.present_capacity_Ah
    volts = float(metered_voltage(there.installation, terminal_voltage(there.installation, cell, state, true_A)))
    metered_A = (true_A - there.installation.unmetered_W / volts) * there.installation.gain_I
    first = SocFilter(there).step(Sample(0.0, volts, float(metered_A), 25.0))
    assert first.soc == pytest.approx(soc, abs=0.03)
    assert abs(first.innovation_V) < 0.05


@pytest.mark.parametrize("ambient_C", [-5.0, 20.0, 38.0])
def test_soc_of_a_whole_flight(ambient_C: float) -> None:
    samples = flight(ambient_C)
    _, estimates = run(samples)
    errors = [e.soc - true_soc(s) for s, e in zip(samples, estimates, strict=True)]
    assert max(abs(x) for x in errors) < 0.06
    assert all(abs(x) < 4.0 * e.soc_sd + 0.005 for x, e in zip(errors, estimates, strict=True))


def test_irregular_steps() -> None:
    """Rows from 1 s to 60 s apart, in one log: the same charge at the end as with all rows."""
    samples = list(flight())
    rng = np.random.default_rng(2)
    thinned, k = samples[:25], 25
    while k < len(samples):
        thinned.append(samples[k])
        k += int(rng.choice([1, 1, 1, 2, 5, 20, 60]))
    _, estimates = run(thinned)
    assert abs(estimates[-1].soc - true_soc(thinned[-1])) < 4.0 * estimates[-1].soc_sd + 0.01
    assert all(math.isfinite(e.soc) and 0.0 < e.soc_sd < 0.2 for e in estimates)


def test_fast_rows_equal_slow_rows() -> None:
    """10 rows a second or one in two seconds: one battery, one estimate."""
    steady = [flat(0.1 * k, voltage_V=15.8 - 0.0001 * k) for k in range(1201)]
    _, fast = run(steady)
    _, slow = run(steady[::20])
    assert fast[-1].soc == pytest.approx(slow[-1].soc, abs=0.5 * slow[-1].soc_sd)
    assert fast[-1].soc_sd == pytest.approx(slow[-1].soc_sd, rel=0.25)


def test_a_gap_widens_the_belief_the_more_the_longer_it_is() -> None:
    sds = []
    for gap_s in (2.0, 30.0, 120.0, 300.0):
        ours, _ = run([s for s in flight() if s.time_s <= 400.0])
        later = next(s for s in flight() if s.time_s >= 400.0 + gap_s)
        estimate = ours.step(later)
        sds.append(estimate.soc_sd)
        assert abs(estimate.soc - true_soc(later)) < 3.0 * estimate.soc_sd + 0.005
    assert sds == sorted(sds) and sds[-1] > 1.5 * sds[0]


def test_rows_without_a_temperature() -> None:
    """No sensor at all: right charge, less sure of the core. One that falls out: goes on."""
    samples = flight(5.0)
    ours, with_temp = run(samples)
    bare, without = run([replace(s, temp_C=NAN) for s in samples])
    assert ours.belief is not None and bare.belief is not None
    assert bare.belief.covariance[X.CORE, X.CORE] > ours.belief.covariance[X.CORE, X.CORE]
    assert abs(without[-1].soc - true_soc(samples[-1])) < 4.0 * without[-1].soc_sd + 0.01
    half, _ = run([s if s.time_s < 300.0 else replace(s, temp_C=NAN) for s in samples])
    assert half.belief is not None
    assert half.belief.mean[X.SOC] == pytest.approx(with_temp[-1].soc, abs=0.03)


@pytest.mark.parametrize(("field", "word"), [("voltage_V", "voltage"), ("current_A", "current")])
def test_a_row_without_voltage_or_current_moves_nothing(field: str, word: str) -> None:
    rows = [flat(2.0 * k) for k in range(20)]
    holed = [replace(s, **{field: NAN}) if k == 10 else s for k, s in enumerate(rows)]
    ours, estimates = run(holed)
    skipped, _ = run(rows[:10] + rows[11:])
    assert estimates[10].status is Status.REFUSED and word in estimates[10].reason
    assert ours.belief is not None and skipped.belief is not None
    assert (ours.belief.mean == skipped.belief.mean).all()
    assert (ours.belief.covariance == skipped.belief.covariance).all()


def test_a_first_row_that_is_empty() -> None:
    ours = SocFilter(pack())
    refused = ours.step(Sample(0.0, NAN, NAN))
    assert refused.status is Status.REFUSED and math.isnan(refused.soc) and ours.belief is None
    assert ours.step(flat(1.0)).soc > 0.0


def test_time_that_goes_backwards_moves_nothing() -> None:
    rows = [flat(2.0 * k) for k in range(20)]
    ours, estimates = run([*rows[:10], flat(3.0, 40.0, 12.0), *rows[10:]])
    clean, _ = run(rows)
    assert estimates[10].status is Status.REFUSED and estimates[10].reason == "time went backwards"
    assert ours.belief is not None and clean.belief is not None
    assert (ours.belief.mean == clean.belief.mean).all()


def test_rows_at_one_instant() -> None:
    ours, estimates = run([flat(2.0 * (k // 3)) for k in range(60)])
    clean, _ = run([flat(2.0 * k) for k in range(20)])
    assert all(math.isfinite(e.soc) for e in estimates)
    assert ours.belief is not None and clean.belief is not None
    assert ours.belief.mean[X.SOC] == pytest.approx(clean.belief.mean[X.SOC], abs=1e-3)
    assert ours.time_s == clean.time_s


@pytest.mark.parametrize("spike_V", [-6.0, 4.0])
def test_an_outlier_does_not_throw_it_off(spike_V: float) -> None:
    samples = [s for s in flight() if s.time_s <= 600.0]
    struck = [replace(s, voltage_V=s.voltage_V + spike_V) if s.time_s == 300.0 else s for s in samples]
    _, clean = run(samples)
    _, hit = run(struck)
    at = next(k for k, s in enumerate(samples) if s.time_s == 300.0)
    worst = max(abs(h.soc - c.soc) for h, c in zip(hit[at:], clean[at:], strict=True))
    assert worst < 3.0 * clean[at].soc_sd
    assert abs(hit[-1].soc - clean[-1].soc) < clean[-1].soc_sd


def test_what_the_autopilot_says_of_its_charge_is_not_read() -> None:
    samples = flight()[:300]
    lying = [replace(s, consumed_Ah=99.0 * k, reported_soc=0.01) for k, s in enumerate(samples)]
    assert [e.soc for e in run(samples)[1]] == [e.soc for e in run(lying)[1]]


ROWS = st.lists(
    st.tuples(
        st.one_of(st.sampled_from([0.0, 0.05, 1.0, 2.0, 60.0, 300.0]), st.floats(0.0, 600.0)),
        st.floats(8.0, 17.6),
        st.floats(-20.0, 150.0),
        st.one_of(st.just(NAN), st.floats(-20.0, 70.0)),
    ),
    min_size=1,
    max_size=25,
)


@settings(deadline=None, max_examples=60)
@given(ROWS)
def test_no_rows_break_it(rows: list[tuple[float, float, float, float]]) -> None:
    """Whatever the sensors say: a number inside 0..1 with a finite sd, or a refusal."""
    ours, time_s = SocFilter(pack()), 0.0
    for dt_s, volts, amps, temp_C in rows:
        time_s += dt_s
        estimate = ours.step(Sample(time_s, volts, amps, temp_C))
        assert 0.0 <= estimate.soc <= 1.0 and 0.0 < estimate.soc_sd < math.inf
        belief = ours.belief
        assert belief is not None and np.isfinite(belief.mean).all() and np.isfinite(belief.covariance).all()


def test_a_restored_filter_goes_on_as_if_nothing_had_been() -> None:
    samples = [s for s in flight() if s.time_s <= 400.0][::2]  # a row every two seconds: no block is torn
    whole, estimates = run(samples)
    first, _ = run(samples[:100])
    assert first.belief is not None
    again = SocFilter(pack())
    again.restore(first.belief, first.time_s, samples[99].current_A)
    later = [again.step(s) for s in samples[100:]]
    for ours, theirs in zip(later, estimates[100:], strict=True):
        assert ours.soc == pytest.approx(theirs.soc, abs=1e-9)
        assert ours.nis == pytest.approx(theirs.nis, rel=1e-6)
    assert whole.belief is not None and again.belief is not None
    assert again.belief.covariance == pytest.approx(whole.belief.covariance, abs=1e-12)


def test_rows_worked_out_ahead_are_those_of_filterpy() -> None:
    """Looking ahead conditions without filterpy: the same numbers, on a flight that starts fuller than full."""
    flown = [
        replace(s, voltage_V=s.voltage_V + 0.2)
        for s in simulate_flight(pack(), SimulatedFlight(260.0, 12.0, rate_Hz=4.0, seed=9))
    ]
    rows = [replace(s, temp_C=NAN) if 300 < k < 400 else s for k, s in enumerate(flown[:2000])]
    alone, ahead = SocFilter(pack()), SocFilter(pack())
    for row, found in zip(rows, ahead.run(rows), strict=True):
        one, other = alone.step(row), estimate_of(row, found)
        assert (one.status, one.soc, one.innovation_V, one.nis) == pytest.approx(
            (other.status, other.soc, other.innovation_V, other.nis), abs=1e-9, nan_ok=True
        )
        assert alone.belief is not None and found.belief is not None
        sd = np.sqrt(np.diag(alone.belief.covariance))
        apart = (found.belief.covariance - alone.belief.covariance) / np.outer(sd, sd)
        assert np.abs(apart).max() < 1e-9


@pytest.mark.parametrize("share", [1.0, 0.1])
def test_within_the_noise_a_reading_weighs_by_its_share_and_beyond_it_whole(share: float) -> None:
    """Two capacities, equally likely before; a share of 0.1 is that of a make that nobody tested."""
    even, variance_V2 = np.log([0.5, 0.5]), np.array([0.01, 0.01])
    within = recursion.weighed(even, np.array([0.0, 0.08]), variance_V2, share)
    beyond = recursion.weighed(even, np.array([0.2, 0.4]), variance_V2, share)
    assert within[0] - within[1] == pytest.approx(0.5 * share * 0.64, rel=1e-3)
    assert beyond[0] - beyond[1] == pytest.approx(0.5 * 12.0, rel=2e-2)


def test_noise_makes_a_make_that_nobody_tested_no_surer_of_a_capacity() -> None:
    """Readings as noisy as the filter expects, either way; the second capacity is off by a tenth of the noise."""
    noise_V, variance_V2 = 0.1 * np.random.default_rng(5).standard_normal(200), np.array([0.01, 0.01])
    odds = []
    for share in (1.0, 0.1):
        log_weight = np.log([0.5, 0.5])
        for volts in np.stack([noise_V, -noise_V]).T.ravel():
            log_weight = recursion.weighed(log_weight, volts + np.array([0.0, 0.01]), variance_V2, share)
        odds.append(log_weight[0] - log_weight[1])
    assert odds[1] < 0.5 * odds[0] and odds[1] > 0.0
