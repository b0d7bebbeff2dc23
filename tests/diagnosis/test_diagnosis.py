"""Diagnosis of planted effects."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from cases import first_quick
from msgspec.structs import replace as replaced
from planted_flights import FILE, MISSIONS, PACK, fly, found

from uavbatt.diagnosis import close
from uavbatt.diagnosis.diagnosis import Diagnosis, diagnose
from uavbatt.errors import NotEnoughData
from uavbatt.fitting.observed import ObservedRecord
from uavbatt.log_replay.run import engine_for

LAG_S = 20.0  # of the sensor, in the file
LEAST = 2  # flights that a diagnosis takes: its work grows with their rows


def flights(count: int = LEAST, **effect: float) -> list[ObservedRecord]:
    return [fly(*mission, **effect) for mission in MISSIONS[:count]]


@cache
def diagnosed(count: int = LEAST, **effect: float) -> Diagnosis:
    return found(flights(count, **effect))


@pytest.fixture(scope="module")
def clean() -> list[ObservedRecord]:
    return flights()


def test_an_effect_of_no_size_is_not_found() -> None:
    diagnosis = diagnosed(len(MISSIONS))
    assert diagnosis.verdict == "no_missing_effect"
    assert diagnosis.classes == ()


@pytest.mark.parametrize(
    ("planted", "name", "quantity", "truth"),
    [  # half of it is harder
        pytest.param({"gain": 1.24}, "current_gain", "gain_I", 1.24, marks=pytest.mark.slow),
        ({"gain": 1.12}, "current_gain", "gain_I", 1.12),
        pytest.param({"unmetered_W": 50.0}, "unmetered_load", "unmetered_W", 50.0, marks=pytest.mark.slow),
        ({"unmetered_W": 25.0}, "unmetered_load", "unmetered_W", 25.0),
        pytest.param({"fade": 0.24}, "capacity_fade", "fade", 0.24, marks=pytest.mark.slow),
        ({"fade": 0.12}, "capacity_fade", "fade", 0.12),
        pytest.param({"offset_V": -0.8}, "voltage_offset", "offset_V", -0.8, marks=pytest.mark.slow),
        ({"offset_V": -0.4}, "voltage_offset", "offset_V", -0.4),
    ],
)
def test_a_planted_effect_is_in_the_first_class_at_full_and_at_half_size(
    planted: dict[str, float], name: str, quantity: str, truth: float
) -> None:
    diagnosis = diagnosed(**planted)
    assert diagnosis.verdict in ("effect_found", "undeclared_effect")
    assert name in diagnosis.classes[0].members
    assert len(diagnosis.classes[0].members) <= 3
    interval = diagnosis.classes[0].parameters[quantity]
    assert interval.lo <= truth <= interval.hi


def test_two_planted_effects_are_two_classes() -> None:
    diagnosis = diagnosed(gain=1.2, offset_V=-0.5)
    told = [set(c.members) for c in diagnosis.classes]
    assert len(told) == 2
    assert any("current_gain" in a and "voltage_offset" in b for a, b in (told, told[::-1]))


def test_a_late_current_is_told_from_a_resistance() -> None:
    records = [replace(r, current_A=np.interp(r.time_s - 4.0, r.time_s, r.current_A)) for r in flights()]
    diagnosis = found(records)
    assert diagnosis.classes[0].members[0] == "current_delay"
    interval = diagnosis.classes[0].parameters["delay_s"]
    assert interval.lo <= 4.0 <= interval.hi


def test_a_voltage_corrected_for_the_load_is_named_with_its_resistance() -> None:
    records = [replace(r, voltage_V=r.voltage_V + 0.02 * r.current_A) for r in flights()]
    diagnosis = found(records)
    assert diagnosis.verdict == "effect_found" and diagnosis.classes[0].members[0] == "sag_compensation"
    interval = diagnosis.classes[0].parameters["compensation_ohm"]
    assert interval.lo <= 0.02 <= interval.hi


@pytest.mark.slow
def test_order_and_names_of_the_files_do_not_matter() -> None:
    records = flights(len(MISSIONS), gain=1.15)
    shuffled = [replace(records[i], name=f"other {i}") for i in (2, 0, 3, 1)]
    first, second = found(records), found(shuffled)
    assert first.verdict == second.verdict
    assert first.classes == second.classes


def test_a_withheld_effect_never_becomes_a_confident_wrong_name() -> None:
    diagnosis = found(flights(gain=1.2), "current_gain", "capacity_fade", "rate_capacity")
    kin = {"current_offset", "unmetered_load"}
    if diagnosis.verdict == "effect_found":
        assert len(diagnosis.classes[0].members) > 1 or set(diagnosis.classes[0].members) <= kin
    else:
        assert diagnosis.verdict == "undeclared_effect" and diagnosis.reasons


def test_the_extended_file_holds_the_effect_and_predicts_better_what_was_left_out() -> None:
    diagnosis = diagnosed(gain=1.12)
    new = close.extended(FILE, diagnosis)
    entry = next(e for e in new.effects if e.name in diagnosis.classes[0].members)
    assert entry.parameters
    assert new.certificate.status == "fitted"
    left = close.left_out_values(diagnosis.problem, diagnosis.after)
    empty = [np.zeros(0)] * LEAST
    before_V, _ = close.open_loop(diagnosis.problem, diagnosis.before, empty)
    after_V, _ = close.open_loop(diagnosis.problem, diagnosis.after, left)
    assert after_V < 0.5 * before_V


@pytest.mark.parametrize(
    ("after", "said"),
    [
        ((0.114, 60.0), "voltage 101 -> 114 mV"),
        ((0.090, 75.0), "remaining time 60 -> 75 s"),
        ((0.090, 20.0), ""),
        ((0.101, math.nan), ""),
    ],
)
def test_what_predicts_held_out_records_worse_is_said_and_stands_in_the_new_file(
    after: tuple[float, float], said: str
) -> None:
    before = close.HeldOutErrors(0.101, 0.5, 60.0, 0.9)
    closed = close.ClosedLoop(before, close.HeldOutErrors(after[0], 0.5, after[1], 0.9), ("flight 1",))
    assert closed.worse == said
    remarks = close.extended(FILE, diagnosed(gain=1.12), closed.worse).battery.remarks
    assert any("worse" in remark for remark in remarks) == bool(said)


def _without_current(r: ObservedRecord) -> ObservedRecord:
    return replace(r, current_A=np.zeros_like(r.current_A))


def _steady(r: ObservedRecord) -> ObservedRecord:
    amps = np.where(r.time_s < 20.0, 0.3, 10.0)
    return replace(r, current_A=amps)


def _short(r: ObservedRecord) -> ObservedRecord:
    keep = r.time_s < 150.0
    columns = (r.time_s, r.voltage_V, r.current_A, r.temp_C)
    return ObservedRecord(r.name, *(c[keep] for c in columns), r.ambient_C, r.cells, r.capacity_Ah)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda rs: [_short(rs[0])], "last"),
        (lambda rs: [_steady(r) for r in rs], "constant"),
        (lambda rs: [_without_current(r) for r in rs], "current is zero"),
        (lambda rs: [rs[0], replace(rs[1], cells=6)], "different packs"),
        (lambda rs: [], "no record"),
    ],
)
def test_too_little_is_said_with_its_reason(
    clean: list[ObservedRecord], spoil: Callable[[list[ObservedRecord]], list[ObservedRecord]], reason: str
) -> None:
    with pytest.raises(NotEnoughData, match=reason):
        found(spoil(clean))


def test_without_temperature_its_effects_are_no_candidates(clean: list[ObservedRecord]) -> None:
    blind = [replace(r, temp_C=np.full_like(r.temp_C, np.nan)) for r in clean]
    diagnosis = found(blind)
    assert not diagnosis.problem.evidence.has_temperature
    assert "temperature_offset" not in {m for c in diagnosis.classes for m in c.members}


@pytest.mark.parametrize("entropy_VpK", first_quick(1, [-0.0002, 0.0]))
def test_a_lag_of_the_sensor_is_in_its_interval_whatever_heat_the_reactions_give(entropy_VpK: float) -> None:
    left = replaced(FILE.discrepancy, wander=replaced(FILE.discrepancy.wander, temperature_sd_K=0.05))
    entries = [replaced(entry, standard_error={}) for entry in FILE.effects]
    sure = replaced(FILE, effects=entries, discrepancy=left)
    flown = [fly(*mission, lag_s=4.5 * LAG_S, entropy_VpK=entropy_VpK) for mission in MISSIONS[:3]]
    diagnosis = diagnose(flown, sure, PACK, engine=engine_for(is_long=True))
    (told,) = (c.parameters["sensor_lag_s"] for c in diagnosis.classes if "temperature_lag" in c.members)
    assert LAG_S < told.lo < 4.5 * LAG_S < told.hi < 300.0


@pytest.mark.parametrize(("gain", "verdict"), [(1.0, "no_missing_effect"), (1.12, "effect_found")])
def test_coarse_sensors_are_no_undeclared_effect_and_hide_no_other(gain: float, verdict: str) -> None:
    """A voltmeter of 0.1 V, a current in whole amperes and a thermometer of whole degrees, as radios and BMS send them.

    Nothing could be found in such logs, and sound packs had an undeclared effect.
    """
    flights = [fly(*mission, gain=gain) for mission in MISSIONS]
    seen = [
        replace(r, voltage_V=np.round(r.voltage_V, 1), current_A=np.round(r.current_A), temp_C=np.round(r.temp_C))
        for r in flights
    ]
    diagnosis = found(seen)
    assert diagnosis.verdict == verdict, diagnosis.reasons
    if gain > 1.0:
        assert diagnosis.classes[0].members == ("current_gain",)


def test_a_thermometer_that_follows_at_once_is_no_effect() -> None:
    """The lag that the refit finds is hardly any, and the interval around it was beyond the largest number."""
    diagnosis = diagnosed(lag_s=1.0)
    assert not any(c.probability > 0.4 for c in diagnosis.classes)
    assert all(math.isfinite(hidden.hi) for hidden in diagnosis.hidden)
