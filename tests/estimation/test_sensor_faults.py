"""Sensors that fail silently: a reading that stands still, and a current that falls while the load does not."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from cases import first_quick
from factories import generic_estimator, generic_pack

from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.estimation.sensor_row import SensorRow
from uavbatt.estimation.still_sensors import STUCK_S, SensorChanges
from uavbatt.estimation.voltage_and_load import DEAD_S
from uavbatt.notice import Kind, kind_of
from uavbatt.records import Estimate, Remaining, Sample, Status
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight

CELLS, CAPACITY_AH = 4.0, 5.0


def after(current_A: list[float], row_s: float = 1.0, disarmed_from: float = math.nan) -> SensorChanges:
    """The readings of a voltage that falls steadily, beside these currents; NaN: nobody tells when it disarms."""
    readings = SensorChanges()
    for k, amps in enumerate(current_A):
        armed = None if math.isnan(disarmed_from) else k < disarmed_from
        readings = readings.after(SensorRow(k * row_s, 15.0 - 0.002 * k, amps, math.nan, CELLS, CAPACITY_AH, armed))
    return readings


def gusty(rows: int, digit_A: float = 0.05, seed: int = 1) -> list[float]:
    """A hover as a sensor with this last digit reads it."""
    amps = 18.0 + 0.6 * np.random.default_rng(seed).standard_normal(rows)
    return list((np.round(amps / digit_A) * digit_A).tolist())


def test_a_current_that_stops_moving_is_stuck() -> None:
    sound = gusty(120)
    assert after(sound).stuck_current_s(CAPACITY_AH) == 0.0
    stuck = after([*sound, *[2.0] * 40]).stuck_current_s(CAPACITY_AH)
    assert STUCK_S <= stuck <= 40.0


def test_it_is_forgiven_when_it_moves_again() -> None:
    assert after([*gusty(120), *[2.0] * 40, *gusty(3, seed=2)]).stuck_current_s(CAPACITY_AH) == 0.0


@pytest.mark.parametrize(
    "current_A",
    [
        [18.0] * 300,  # a load bench: it never moved
        [18.0] * 100 + [20.0] * 100 + [18.0] * 100,  # steps of a test
        [*gusty(120), *[0.3] * 120],  # landed, on its electronics
        gusty(300, digit_A=1.0),  # a coarse sensor
        [5.0 + k % 2 for k in range(60)] + [5.0] * 60,  # a very coarse one: the load no longer lies between two steps
    ],
)
def test_what_is_steady_by_nature_is_not_stuck(current_A: list[float]) -> None:
    assert after(current_A).stuck_current_s(CAPACITY_AH) == 0.0


def test_avionics_that_draw_steadily_after_a_landing_are_not_stuck() -> None:
    """A companion computer of 20 W: the charge at the end of such a log was not known any more, live it was a fault."""
    landed = [*gusty(120), *[1.3] * 120]
    assert after(landed, disarmed_from=120).stuck_current_s(CAPACITY_AH) == 0.0
    assert after(landed).stuck_current_s(CAPACITY_AH) >= STUCK_S
    assert after(landed, disarmed_from=160).stuck_current_s(CAPACITY_AH) >= STUCK_S, "it was stuck in the air"
    assert after([*gusty(120), *[8.0] * 120], disarmed_from=120).stuck_current_s(CAPACITY_AH) >= STUCK_S


def test_rows_sent_more_often_than_the_sensor_is_read_are_not_stuck() -> None:
    """Ten rows a second of a sensor that is read once a second."""
    repeated = [amps for amps in gusty(60) for _ in range(10)]
    assert after(repeated, row_s=0.1).stuck_current_s(CAPACITY_AH) == 0.0


@pytest.mark.parametrize(("digit_V", "swing_V", "is_stuck"), [(0.1, 0.1, False), (0.1, 0.2, True), (0.001, 0.1, True)])
def test_a_voltage_that_goes_up_and_down_by_its_last_digit_speaks_against_no_current(
    digit_V: float, swing_V: float, is_stuck: bool
) -> None:
    """A wait on the ground, as a radio's log shows it: 0.1 V and 0.1 A. More than a digit, and the load has changed."""
    readings = SensorChanges()
    for k in range(120):
        volts = (16.7, 16.7 - digit_V)[k % 2] if k < 20 else 16.7 - swing_V * (k // 5 % 2)
        readings = readings.after(SensorRow(float(k), volts, 0.5, math.nan, CELLS, 1.5))
    assert (readings.stuck_current_s(1.5) >= STUCK_S) is is_stuck


def flight(rate_Hz: float, seed: int) -> list[Sample]:
    """A flight of a 4S pack of 5 Ah at 320 W until its cut-off."""
    flown = SimulatedFlight(power_W=320.0, start_soc=0.5, rate_Hz=rate_Hz, seed=seed)
    return simulate_flight(generic_pack(4, 5.0, 13.2, math.nan), flown)


def said_after(rows: list[Sample], begin_s: float) -> list[tuple[Estimate, Remaining]]:
    stated = PackOptions(capacity_Ah=5.0, cells=4, cutoff_V=13.2)
    return [said for said in generic_estimator(stated, period_s=2.0).run(rows) if said[0].time_s > begin_s]


def doubted(said: list[tuple[Estimate, Remaining]], kind: Kind = Kind.DEAD_CURRENT) -> list[float]:
    return [e.time_s for e, _ in said if any(kind_of(warning) is kind for warning in e.warnings)]


@pytest.mark.parametrize("rate_Hz", first_quick(1, [1.0, 4.0]))
@pytest.mark.parametrize("gain", [0.0, 0.1, 0.33])
def test_a_current_that_falls_alone_never_lengthens_the_time(gain: float, rate_Hz: float) -> None:
    """It fell to a tenth with 106 s left: for some seconds the crew saw eight minutes too many."""
    sound = flight(rate_Hz, seed=5)
    end_s = sound[-1].time_s
    begin_s, drawn_Ah, rows = end_s - 106.0, 0.0, []
    for sample in sound:
        amps = sample.current_A * (gain if sample.time_s > begin_s else 1.0)
        drawn_Ah += amps / rate_Hz / 3600.0
        rows.append(replace(sample, current_A=amps, consumed_Ah=drawn_Ah))
    said = said_after(rows, begin_s)
    assert doubted(said)[0] <= begin_s + 4.0  # a leap of the current is held back for the first two seconds
    known = [(r.remaining_lo_s, end_s - e.time_s) for e, r in said if math.isfinite(r.remaining_s)]
    assert all(lo_s <= left_s for lo_s, left_s in known)
    later = [e.status for e, _ in said if begin_s + 3.5 + DEAD_S <= e.time_s < begin_s + 10.0]
    assert set(later) == {Status.REFUSED}


@pytest.mark.parametrize("smoothed_s", [0.0, 1.0])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.33])
def test_a_load_that_falls_is_not_a_failed_sensor(share: float, smoothed_s: float) -> None:
    """A landing, an idle or a glide: the voltage rises, in some autopilots only over a second."""
    hovers = flight(1.0, seed=6)[:150]
    ohm, begin_s, level_V, rows = 0.03, hovers[100].time_s, math.nan, []
    for sample in hovers:
        amps = sample.current_A * (share if sample.time_s > begin_s else 1.0)
        volts = sample.voltage_V + ohm * (sample.current_A - amps)
        keep = math.exp(-1.0 / smoothed_s) if smoothed_s and math.isfinite(level_V) else 0.0
        level_V = volts + keep * (level_V - volts) if keep else volts
        rows.append(replace(sample, voltage_V=level_V, current_A=amps, consumed_Ah=math.nan))
    assert not doubted(said_after(rows, begin_s))


@pytest.mark.parametrize(("rate_Hz", "read_V"), [(1.0, 11.2), (4.0, 11.2), (1.0, 12.0)])
def test_a_voltage_that_falls_alone_is_doubted_before_the_time_is_nothing(rate_Hz: float, read_V: float) -> None:
    """A wire that reads 2.8 V a cell, or a cell that failed: the crew heard "0:00 min left" and no reason for it."""
    sound = flight(rate_Hz, seed=7)
    begin_s = sound[-1].time_s - 300.0
    rows = [
        replace(s, voltage_V=read_V + 0.05 * math.sin(s.time_s)) if s.time_s > begin_s else s
        for s in sound
        if s.time_s < begin_s + 60.0
    ]
    said = said_after(rows, begin_s)
    doubted_s = set(doubted(said, Kind.FELL_ALONE))
    assert min(doubted_s) <= begin_s + 3.0
    assert not [e.time_s for e, r in said if r.remaining_lo_s < 10.0 and e.time_s not in doubted_s]
    assert Status.OK not in {e.status for e, _ in said if e.time_s in doubted_s}


@pytest.mark.parametrize("ohms", [1.0, 3.0])
def test_a_full_throttle_is_no_fall_of_the_voltage_alone(ohms: float) -> None:
    """A worn pack in a climb at twice the load, whose current comes a second late; and the empty pack's knee."""
    sound = flight(1.0, seed=8)
    begin_s, before_A, rows = sound[-1].time_s - 150.0, 0.0, []
    for sample in sound:
        climbs = begin_s < sample.time_s and (sample.time_s - begin_s) % 40.0 < 15.0
        amps = sample.current_A * (2.0 if climbs else 1.0)
        volts = sample.voltage_V - 0.02 * (ohms * amps - sample.current_A)
        rows.append(replace(sample, voltage_V=volts, current_A=before_A, consumed_Ah=math.nan))
        before_A = amps
    assert not doubted(said_after(rows, 0.0), Kind.FELL_ALONE)


def with_another(rows: list[Sample], begin_s: float, volts: float, amps: float) -> list[Sample]:
    """From then on every second row comes from another battery under the same id, read to 10 mV."""
    other = [replace(s, voltage_V=volts, current_A=amps, consumed_Ah=math.nan) for s in rows]
    mixed = zip(rows, other, strict=True)
    return [b if k % 2 and a.time_s > begin_s else replace(a, consumed_Ah=math.nan) for k, (a, b) in enumerate(mixed)]


@pytest.mark.parametrize("rate_Hz", first_quick(1, [1.0, 4.0]))
@pytest.mark.parametrize(("volts", "amps"), [(16.3, 0.0), (15.4, 0.3), (13.5, 0.3), (12.1, 20.0)])
def test_two_batteries_under_one_id_have_no_number(volts: float, amps: float, rate_Hz: float) -> None:
    """The filter saw 2,591 s at least where 120 s were left. The other's voltage may be that of the pack in flight."""
    sound = flight(rate_Hz, seed=9)
    begin_s = sound[-1].time_s - 300.0
    said = said_after(with_another(sound, begin_s, volts, amps), begin_s + 25.0)
    assert {e.status for e, _ in said} == {Status.REFUSED}
    assert {kind_of(e.reason) for e, _ in said} - {Kind.NO_VOLTAGE} == {Kind.TWO_BATTERIES}  # a leap is not used
    assert not any(math.isfinite(r.remaining_s) for _, r in said)


@pytest.mark.parametrize("off_s", first_quick(1, [3.0, 2.0, 5.0]))
def test_a_load_in_pulses_is_one_battery(off_s: float) -> None:
    """A motor that is on and off by turns, and a voltage whose last digit goes back and forth."""
    sound, rows = flight(1.0, seed=10), []
    for sample in sound:
        is_off = sample.time_s > 60.0 and sample.time_s % (2.0 * off_s) < off_s
        amps = 0.3 if is_off else sample.current_A
        volts = sample.voltage_V + 0.02 * (sample.current_A - amps)
        rows.append(replace(sample, current_A=amps, voltage_V=round(volts / 0.1) * 0.1, consumed_Ah=math.nan))
    assert not doubted(said_after(rows, 0.0), Kind.TWO_BATTERIES)


@pytest.mark.parametrize(("step_V", "is_told"), [(0.2, False), (0.5, True)])
def test_a_voltmeter_too_coarse_to_see_the_end_has_no_number(step_V: float, is_told: bool) -> None:
    """With steps of 0.5 V the 5 % point was up to 87 s too long: the knee lies within one step."""
    rows = [replace(s, voltage_V=round(s.voltage_V / step_V) * step_V) for s in flight(1.0, seed=11)]
    told = [e for e, _ in said_after(rows, 0.0) if kind_of(e.reason) is Kind.COARSE]
    assert bool(told) is is_told
    assert all(e.status is Status.REFUSED for e in told)


@pytest.mark.parametrize("rate_Hz", [1.0, 4.0])
@pytest.mark.parametrize("gain", [1.02, 1.04])
def test_a_voltage_that_rises_alone_has_no_number(gain: float, rate_Hz: float) -> None:
    """A voltmeter that reads 4 % more from then on made the 5 % point up to 119 s too long."""
    sound = flight(rate_Hz, seed=12)
    begin_s = sound[-1].time_s - 300.0
    rows = [replace(s, voltage_V=s.voltage_V * (gain if s.time_s > begin_s else 1.0)) for s in sound]
    said = said_after(rows, begin_s)
    assert doubted(said, Kind.ROSE_ALONE)[0] <= begin_s + 5.0
    assert {e.status for e, _ in said if e.time_s > begin_s + 13.0} == {Status.REFUSED}


@pytest.mark.parametrize("rate_Hz", first_quick(1, [1.0, 4.0]))
@pytest.mark.parametrize(("gain", "first_s"), [(1.03, -300.0), (1.1, -300.0), (1.1, 90.0)])
def test_a_voltage_that_rises_for_seconds_ends_no_number(gain: float, first_s: float, rate_Hz: float) -> None:
    """It was refused for the rest of the flight; and it may rise again, for longer."""
    sound = flight(rate_Hz, seed=12)
    begin_s = sound[0].time_s + first_s if first_s > 0.0 else sound[-1].time_s + first_s
    is_high = [0.0 < s.time_s - begin_s < 6.0 or s.time_s > begin_s + 60.0 for s in sound]
    rows = [replace(s, voltage_V=s.voltage_V * (gain if high else 1.0)) for s, high in zip(sound, is_high, strict=True)]
    said = said_after(rows, begin_s)
    assert Status.REFUSED not in {e.status for e, _ in said if e.time_s < begin_s + 60.0}
    assert {e.status for e, _ in said if e.time_s > begin_s + 73.0} == {Status.REFUSED}


@pytest.mark.parametrize("late_s", [0.0, 5.0])
def test_a_load_that_eases_is_no_voltage_that_rises_alone(late_s: float) -> None:
    """A climb ends; a current that is read every few seconds follows late."""
    sound, rows = flight(1.0, seed=13), []
    for sample in sound:
        climbs_for_s = sample.time_s % 60.0
        true_A = sample.current_A * (1.6 if climbs_for_s < 20.0 else 1.0)
        read_A = sample.current_A * (1.6 if late_s <= climbs_for_s < 20.0 + late_s else 1.0)
        volts = sample.voltage_V + 0.02 * (sample.current_A - true_A)
        rows.append(replace(sample, voltage_V=volts, current_A=read_A, consumed_Ah=math.nan))
    assert Status.REFUSED not in {e.status for e, _ in said_after(rows, 60.0) if kind_of(e.reason) is Kind.ROSE_ALONE}
