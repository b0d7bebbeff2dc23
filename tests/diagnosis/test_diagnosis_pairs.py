"""When two effects are named, and when a residual is too large to have been explained."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import msgspec
import numpy as np
import pytest
from planted_flights import CAPACITY_AH, CELLS, CUTOFF_V, FILE, fly

from uavbatt.battery.battery_file import Wander
from uavbatt.battery.sizing.pack_size import PackOptions, pack_from
from uavbatt.diagnosis.classes import class_of
from uavbatt.diagnosis.diagnosis import options_of, problem_of
from uavbatt.diagnosis.refit.batch import at_best
from uavbatt.diagnosis.refit.candidates import NOTHING, Candidate
from uavbatt.diagnosis.refit.misfit import FAR, floor_V, times_expected
from uavbatt.diagnosis.refit.problem import Problem, Refit
from uavbatt.diagnosis.refit.residual import residuals
from uavbatt.diagnosis.refit.solver import refit
from uavbatt.diagnosis.search import pairs
from uavbatt.diagnosis.search.effects import FoundEffect
from uavbatt.diagnosis.search.trial import Trial
from uavbatt.diagnosis.search.worth import Worth

WANDER = Wander(
    soc=[0.0, 1.0], voltage_sd_V=[0.02, 0.02], voltage_time_s=120.0, voltage_noise_V=0.002, rest_sd_V=0.002,
    temperature_sd_K=0.2, temperature_time_s=600.0, temperature_noise_K=0.05, coldest_C=15.0,
)  # fmt: skip
KNOWN = msgspec.structs.replace(FILE, discrepancy=msgspec.structs.replace(FILE.discrepancy, wander=WANDER))
PACK = pack_from(KNOWN, PackOptions(CELLS, CAPACITY_AH, CUTOFF_V))


@cache
def problem(air_C: float) -> Problem:
    return problem_of([fly(air_C, 150.0 + 20.0 * k, 100 + k) for k in range(2)], KNOWN, PACK)


def worth_of(value: float) -> Worth:
    return Worth(np.array([value / 2.0] * 2), value, 1.0, None)


@pytest.mark.parametrize(
    ("lesser", "saves", "are_two"),
    [(12.5, 37.0, True), (11.0, 81.0, True), (5.0, 114.0, True), (11.0, 30.0, False), (3.6, 77.0, False)],
)
def test_the_less_one_of_two_is_worth_the_more_both_have_to_save(lesser: float, saves: float, are_two: bool) -> None:
    assert pairs.are_two(lesser, saves) == are_two


def test_what_saves_nothing_is_never_two() -> None:
    assert not pairs.are_two(-30.0, -30.0)


@pytest.mark.parametrize(("beside_them", "kept"), [(31.0, 0), (5.0, 1)])
def test_a_pair_that_lacks_the_worthiest_effect_is_no_pair(
    monkeypatch: pytest.MonkeyPatch, beside_them: float, kept: int
) -> None:
    def named(*names: str) -> Refit:
        sizes = (0,) * len(names)
        return replace(before, candidate=Candidate(names, (), sizes))

    before = refit(problem(25.0), [NOTHING])[0]
    singles = Trial(
        before,
        (named("temperature_offset"), named("capacity_fade"), named("current_delay")),
        tuple(map(worth_of, (1.0, 2.0, 30.0))),
    )
    monkeypatch.setattr(pairs, "refit", lambda *_, start, **__: start)
    monkeypatch.setattr(pairs, "worth", lambda *_: worth_of(beside_them))
    two = [named("temperature_offset", "capacity_fade"), named("current_delay", "capacity_fade")]
    left = pairs.complete(problem(25.0), two, singles)
    assert left == two[1 - kept :]


def test_a_residual_is_held_against_the_error_that_the_model_has_there() -> None:
    """What is too much in the warm may be right 12 K below the coldest flight that the error was learned on."""
    warm, cold = problem(25.0), problem(3.0)
    told = []
    for one in (warm, cold):
        after = residuals(one.evidence, at_best(one, refit(one, [NOTHING])[0]))
        off = [replace(r, voltage_V=np.full_like(r.voltage_V, 0.25)) for r in after]
        told.append(times_expected(one, KNOWN, off))
    assert told[0] > FAR > told[1]


def test_a_file_that_has_learned_no_more_states_one_error_for_all() -> None:
    one = problem(3.0)
    file = msgspec.structs.replace(KNOWN, discrepancy=msgspec.structs.replace(KNOWN.discrepancy, wander=None))
    after = residuals(one.evidence, at_best(one, refit(one, [NOTHING])[0]))
    off = [replace(r, voltage_V=np.full_like(r.voltage_V, 0.25), flatness=np.ones_like(r.voltage_V)) for r in after]
    assert times_expected(one, file, off) == pytest.approx(0.25 / floor_V(file, one))


def test_a_class_has_values_of_its_members_alone() -> None:
    one = problem(25.0)
    options = {o.name: o for o in options_of(one, KNOWN, ())}
    names = ("charge_transfer", "voltage_offset", "current_gain")  # with the second name of the first these are four
    fits = tuple(refit(one, [options[n] for n in names], iterations=2))
    told = class_of(one, FoundEffect(fits, worth_of(20.0), (), 0.8), 0.9)
    assert told.members == ("charge_transfer", "resistance_growth", "voltage_offset")
    assert list(told.parameters) == ["transfer_V", "offset_V"]
