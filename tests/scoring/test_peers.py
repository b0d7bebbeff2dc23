"""The re-implemented peers against hand-computed answers, so that a comparison with them is fair."""

from __future__ import annotations

import math
from types import ModuleType

import numpy as np
import pytest
from peers import ardupilot, columns, inav, px4

from uavbatt.records import NAN, Sample


def steady(seconds: int, voltage_V: float, current_A: float, step_s: float = 1.0) -> list[Sample]:
    return [Sample(step_s * row, voltage_V, current_A) for row in range(int(seconds / step_s) + 1)]


def test_px4_regression_table() -> None:
    """The table of reference values: N = 4, theta = [16.0, 0.02], P = diag(6, 0.4)."""
    rls = px4.Rls(16.0, 0.02, 6.0, 0.0, 0.4)
    table = [
        (15.8, 10.0, True, 16.0, 0.02, 5.561321),
        (15.6, 20.0, True, 16.0, 0.02, 2.864645),
        (15.7, 15.0, False, 16.0, 0.02, 2.864645),
        (15.3, 30.0, True, 16.049513, 0.024279, 1.848011),
        (15.5, 20.0, False, 15.985587, 0.024279, 1.848011),
    ]
    for volts, amps, accepted, ocv_V, r, norm in table:
        assert rls.update(volts, amps) is accepted
        assert (rls.ocv_V, rls.r, rls.norm()) == pytest.approx((ocv_V, r, norm), abs=6e-7)
    assert rls.r / 4 == pytest.approx(0.006070, abs=6e-7)


def test_px4_of_a_full_pack_is_counted_charge_over_a_slow_mean() -> None:
    """V high: the line says 1, so the counter rules; the mean moves from 15 A by exp(-t/50 s)."""
    remaining_s = px4.predict(steady(300, 17.5, 10.0), 5.0, 4)
    assert np.all(np.isnan(remaining_s[:2])) and np.all(np.isfinite(remaining_s[3:]))
    for t in (10, 60, 300):
        mean_A = 10.0 + 5.0 * math.exp(-t / 50.0)
        left_Ah = 5.0 - 10.0 * t / 3600.0
        assert remaining_s[t] == pytest.approx(left_Ah / mean_A * 3600.0, rel=1e-3)


def test_px4_on_the_line_is_pulled_to_it() -> None:
    """Half-way between empty and charged, R known: SoC settles on 0.5 however little was counted."""
    cell_V = 0.5 * (3.6 + 4.05)
    parameters = px4.Parameters(r_internal=0.0)
    battery = px4.Battery(500.0, 4, parameters)  # so big that nothing is counted
    for _ in range(6000):
        battery.call(0.01, 4 * cell_V, 10.0, True)
    assert battery.soc == pytest.approx(0.5, abs=1e-3)


def test_px4_rate_rule() -> None:
    """Telemetry of 1 Hz and 0.1 s says the same once it is cut into 10 ms; called once a row it does not."""
    fine = px4.predict(steady(120, 15.4, 12.0, 0.1), 5.0, 4)
    coarse = px4.predict(steady(120, 15.4, 12.0), 5.0, 4)
    assert coarse[20:] == pytest.approx(fine[200::10], rel=5e-3)
    once = px4.predict(steady(120, 15.4, 12.0), 5.0, 4, step_s=math.inf)
    assert abs(once[20] - coarse[20]) > 20.0


def test_px4_mean_current_waits_for_arming() -> None:
    idle = [Sample(float(t), 17.5, 0.5, armed=False) for t in range(60)]
    assert px4.predict(idle, 5.0, 4)[-1] == pytest.approx((5.0 - 0.5 * 59 / 3600) / 15.0 * 3600.0, rel=1e-3)


def test_ardupilot_at_constant_current() -> None:
    remaining_s = ardupilot.predict(steady(600, 15.0, 12.0), 5.0, 4)
    assert remaining_s == pytest.approx(5.0 / 12.0 * 3600.0 - np.arange(601))
    calibrated = ardupilot.predict(steady(600, 15.0, 12.0), 5.0, 4, usable_Ah=4.0)
    assert calibrated == pytest.approx(1200.0 - np.arange(601))
    assert ardupilot.predict(steady(1800, 15.0, 12.0), 5.0, 4)[-1] == 0.0  # never negative


def test_ardupilot_filter_step_response() -> None:
    time_s = np.arange(0.0, 100.0, 0.1)
    smooth = ardupilot.low_pass(time_s, np.where(time_s < 0.05, 0.0, 10.0), 20.0)
    assert smooth[200] == pytest.approx(10.0 * (1 - math.exp(-1)), rel=5e-3)
    assert ardupilot.low_pass(time_s, 3.0 * time_s, 0.0) == pytest.approx(3.0 * time_s)


def test_inav_at_constant_power() -> None:
    """E = 5 Ah x 3.7 V x 4 = 74 Wh at 150 W: 1776 s from the start."""
    remaining_s = inav.predict(steady(600, 15.0, 10.0), 5.0, 4)
    assert math.isnan(remaining_s[0])
    assert remaining_s[1:] == pytest.approx(1776.0 - np.arange(1, 601))
    assert inav.predict(steady(60, 15.0, 10.0), 5.0, 4, usable_Wh=50.0)[60] == pytest.approx(1140.0)


def test_inav_impedance_from_steps() -> None:
    time_s = np.arange(0.0, 20.0, 0.2)
    current_A = np.where((time_s // 1.0) % 2 == 0, 5.0, 15.0)
    found = inav.impedance(time_s, 16.0 - 0.03 * current_A, current_A)
    assert found[0] == 0.0 and found[-1] == pytest.approx(0.03)
    assert np.all(inav.impedance(10 * time_s, 16.0 - 0.03 * current_A, current_A) == 0.0)  # rows too far apart


@pytest.mark.parametrize("module", [px4, ardupilot, inav])
def test_every_peer_sees_the_past_only(module: ModuleType) -> None:
    rng = np.random.default_rng(3)
    samples = [Sample(2.0 * t, 15.5 - 0.005 * t, float(rng.uniform(5, 20))) for t in range(60)]
    whole, part = module.predict(samples, 5.0, 4), module.predict(samples[:40], 5.0, 4)
    assert np.array_equal(whole[:40], part, equal_nan=True)
    assert len(module.predict([], 5.0, 4)) == 0


@pytest.mark.parametrize("module", [ardupilot, inav])
def test_no_current_no_time(module: ModuleType) -> None:
    assert np.all(np.isnan(module.predict(steady(10, 15.0, NAN), 5.0, 4)))


def test_what_a_pilot_learns_from_a_flight() -> None:
    samples = steady(3600, 15.0, 3.0)
    assert columns.drawn_Ah(samples, 1800.0) == pytest.approx(1.5)
    assert columns.drawn_Wh(samples, 1800.0) == pytest.approx(22.5)
    assert columns.drawn_Ah(samples, 9e9) == pytest.approx(3.0)
