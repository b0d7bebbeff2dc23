"""The bound by the voltage: what a fall of the measured voltage shows, and what it does not."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest
from factories import generic_pack

from uavbatt.prediction import voltage_bound
from uavbatt.prediction.voltage_bound import SURE_LOOKS, FallBin, LaggingCurrents, VoltageBound, fall_left_s
from uavbatt.records import Sample


def left_s(volts: Sequence[float], row_s: float = 1.0) -> list[float]:
    """The time left by the voltage, row by row, at a steady current."""
    pack, bound, found = generic_pack(), VoltageBound(), []
    for k, voltage_V in enumerate(volts):
        bound = bound.after(Sample(k * row_s, voltage_V, 20.0), None, pack, 0.0)
        found.append(bound.left_s(k * row_s))
    return found


def in_steps(volts: Sequence[float], step_V: float) -> list[float]:
    return [math.floor(voltage_V / step_V + 1e-9) * step_V for voltage_V in volts]


def cutoff_V() -> float:
    pack = generic_pack()
    return float(pack.cutoff_V)


@pytest.mark.parametrize("row_s", [0.1, 1.0])
@pytest.mark.parametrize("step_V", [0.001, 0.25, 0.5])
def test_a_slow_fall_shows_no_end_however_coarse_its_steps_are(step_V: float, row_s: float) -> None:
    """0.6 V in ten minutes; "0:07 min left" was once said after one step of half a volt."""
    rows = round(600.0 / row_s)
    slow = [cutoff_V() + 1.3 - 0.6 * k / rows for k in range(rows)]
    assert all(left == math.inf for left in left_s(in_steps(slow, step_V), row_s))


@pytest.mark.parametrize("step_V", [0.001, 0.05, 0.1])
def test_the_end_of_a_pack_shows_in_tenths_of_a_volt(step_V: float) -> None:
    """It falls by 1.2 V in its last two minutes, faster and faster."""
    falls = [cutoff_V() + 1.2 * (1.0 - (k / 120.0) ** 2) for k in range(120)]
    for k, left in enumerate(left_s(in_steps(falls, step_V))):
        assert k < 85 or 0.5 * (120 - k) - 3.0 <= left <= 2.0 * (120 - k)


@pytest.mark.parametrize(("ahead_s", "said_s"), [(50.0, 50.0), (150.0, math.inf)])
def test_only_a_near_end_stands_where_a_look_cannot_tell(
    ahead_s: float, said_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a climb at 6 °C an end 150 s ahead was counted down to 35 s, with 680 s left."""
    monkeypatch.setattr(voltage_bound, "fall_left_s", lambda *_: math.nan)
    before = VoltageBound(ends_s=(100.0 + ahead_s,) * SURE_LOOKS)
    assert before.after(Sample(100.0, 14.0, 20.0), None, generic_pack(), 0.0).left_s(100.0) == said_s


@pytest.mark.parametrize(("ahead_s", "said_s"), [(60.0, 60.0), (150.0, 150.0), (250.0, math.inf)])
def test_a_straight_fall_leads_to_the_cut_off_as_far_as_one_can_see(ahead_s: float, said_s: float) -> None:
    slope = 0.3 / ahead_s  # within reach: 0.3 V above the cut-off of four cells
    falls = [cutoff_V() + slope * (ahead_s + 70.0 - k) for k in range(71)]
    assert left_s(falls)[-1] == pytest.approx(said_s, abs=2.0 + SURE_LOOKS)


@pytest.mark.parametrize(("ahead_s", "is_in_sight"), [(100.0, True), (400.0, False)])
def test_a_fall_within_its_scatter_tells_only_if_it_leads_to_the_cut_off_in_sight(
    ahead_s: float, is_in_sight: bool
) -> None:
    volts = [0.3 + 0.3 / ahead_s * (60.0 - k) + 0.1 * (-1.0) ** k for k in range(61)]
    bins = tuple(
        FallBin(float(k), cutoff_V() + v, 20.0, LaggingCurrents(k, 20.0, 20.0), step_V=0.01)
        for k, v in enumerate(volts)
    )
    assert math.isnan(fall_left_s(bins, 4.0, cutoff_V())) is is_in_sight


def test_a_single_look_is_chance_and_several_in_a_row_are_not(monkeypatch: pytest.MonkeyPatch) -> None:
    bound, found = VoltageBound(), []
    looks = [math.inf] * 8 + [40.0] + [math.inf] * 8 + [40.0] * 6
    for k, look_s in enumerate(looks):
        monkeypatch.setattr(voltage_bound, "fall_left_s", lambda *_, look_s=look_s: look_s)
        bound = bound.after(Sample(float(k), 14.0, 20.0), None, generic_pack(), 0.0)
        found.append(bound.left_s(float(k)))
    assert found == [math.inf] * (17 + SURE_LOOKS - 1) + [40.0] * (7 - SURE_LOOKS)


def test_the_lagging_currents_follow_a_step_with_their_time_constants() -> None:
    cell = generic_pack().cell
    fast_s, slow_s = float(cell.polarisation_tau_s), float(cell.diffusion_tau_s)
    at_rest = LaggingCurrents().after(0.0, 0.0, cell)
    assert at_rest.after(fast_s, 10.0, cell).fast_A == pytest.approx(10.0 * (1.0 - math.exp(-1.0)))
    assert at_rest.after(2.0 * slow_s, 10.0, cell).slow_A == pytest.approx(10.0 * (1.0 - math.exp(-2.0)))
    assert at_rest.after(1.0, math.nan, cell) is at_rest
