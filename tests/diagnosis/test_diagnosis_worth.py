"""One unit of evidence: what healthy flights, small effects and effects of some flights only come to."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import msgspec
import numpy as np
import pytest
from planted_flights import CAPACITY_AH, CELLS, CUTOFF_V, FILE, fly

from uavbatt.battery.battery_file import Wander
from uavbatt.battery.sizing.pack_size import PackOptions, pack_from
from uavbatt.diagnosis.diagnosis import Diagnosis, candidate_probability, diagnose, options_of, problem_of
from uavbatt.diagnosis.refit.candidates import QUANTITIES, Candidate
from uavbatt.diagnosis.refit.misfit import LEFT, USUAL, MisfitPerNumber
from uavbatt.diagnosis.search.blocks import evidence_by_block
from uavbatt.diagnosis.search.effects import SUSPECT, no_chance
from uavbatt.diagnosis.search.rivals import FAMILIES, members_of_class
from uavbatt.diagnosis.search.trial import Trial
from uavbatt.diagnosis.search.worth import Worth
from uavbatt.fitting.observed import ObservedRecord
from uavbatt.log_replay.run import engine_for

# The planted flights are of this very model: what it leaves is the sensors' noise, and a little.
CLOSE = Wander(
    soc=[0.0, 1.0], voltage_sd_V=[0.004, 0.004], voltage_time_s=120.0, voltage_noise_V=0.002, rest_sd_V=0.002,
    temperature_sd_K=0.2, temperature_time_s=600.0, temperature_noise_K=0.05,
)  # fmt: skip
KNOWN = msgspec.structs.replace(FILE, discrepancy=msgspec.structs.replace(FILE.discrepancy, wander=CLOSE))
PACK = pack_from(KNOWN, PackOptions(CELLS, CAPACITY_AH, CUTOFF_V))


@cache
def flight(k: int, **effect: float) -> ObservedRecord:
    """The k-th of a row of flights with weather and loads of their own."""
    random = np.random.default_rng(100 + k)
    return fly(float(random.uniform(5.0, 35.0)), float(random.uniform(130.0, 190.0)), 100 + k, **effect)


def found(records: list[ObservedRecord]) -> Diagnosis:
    return diagnose(records, KNOWN, PACK, engine=engine_for(is_long=True))


@pytest.fixture(scope="module")
def healthy() -> Diagnosis:
    return found([flight(k) for k in range(3)])


@pytest.mark.parametrize(
    "places", [range(3), *(pytest.param(p, marks=pytest.mark.slow) for p in (range(3, 7), range(7, 15)))]
)
def test_a_healthy_set_of_three_four_or_eight_raises_no_alarm(places: range, healthy: Diagnosis) -> None:
    diagnosis = healthy if places == range(3) else found([flight(k) for k in places])
    assert diagnosis.verdict == "no_missing_effect"
    assert {h.name for h in diagnosis.hidden} >= {"current_gain", "voltage_offset", "capacity_fade"}


def test_a_pack_flown_deeper_than_its_capacity_is_known_bends_nothing() -> None:
    deep = [fly(25.0 + 4.0 * k, 70.0 + 8.0 * k, 100 + k, fade=-0.016) for k in range(2)]  # two sd of the stated error
    diagnosis = found(deep)
    assert diagnosis.verdict == "no_missing_effect"
    assert np.all(np.abs(diagnosis.before.v[:, 0]) < 1.0)  # sd of the start: the knee is not met by a fuller pack


def test_what_could_hide_holds_the_truth_of_healthy_flights(healthy: Diagnosis) -> None:
    hidden = {h.name: h for h in healthy.hidden}
    for name, off in (("current_gain", 1.0), ("voltage_offset", 0.0), ("temperature_offset", 0.0)):
        assert hidden[name].lo <= off <= hidden[name].hi


@pytest.mark.slow
@pytest.mark.parametrize(("quantity", "size", "off"), [("gain", 1.2, 1.0), ("offset_V", -0.4, 0.0)])
def test_an_effect_keeps_its_family_as_it_shrinks(quantity: str, size: float, off: float) -> None:
    truth = {"gain": "current_gain", "offset_V": "voltage_offset"}[quantity]
    kin = next(f for f in FAMILIES if truth in f)
    for share in (1.0, 0.5, 0.25):
        planted = {quantity: off + share * (size - off)}
        diagnosis = found([flight(k, **planted) for k in range(3)])
        assert diagnosis.verdict != "undeclared_effect"
        assert not diagnosis.classes or kin & set(diagnosis.classes[0].members)


@pytest.mark.slow
def test_an_effect_in_half_of_the_flights_is_said_to_be_inconstant() -> None:
    diagnosis = found([flight(0), flight(1, gain=1.3), flight(2), flight(3, gain=1.3)])
    assert diagnosis.verdict == "undeclared_effect"
    assert not diagnosis.after.candidate.names  # nothing of it enters the battery file


def test_the_blocks_share_out_what_is_saved() -> None:
    diagnosis = found([flight(k, offset_V=-0.4) for k in range(2)])
    blocks = evidence_by_block(diagnosis.problem, diagnosis.before, diagnosis.after)
    saved = np.sum(diagnosis.before.residual**2) - np.sum(diagnosis.after.residual**2)
    assert sum(b.saved for b in blocks) == pytest.approx(saved)
    assert next(b for b in blocks if b.name == "rest").saved > 0.0  # a constant shows before take-off


def test_a_pack_charged_in_part_is_a_finding_of_its_own() -> None:
    whole = [flight(k) for k in range(2)]
    late = [_from(r, 0.7) for r in whole]
    diagnosis = found(late)
    assert diagnosis.classes[0].members == ("initial_charge",)
    told = diagnosis.classes[0].parameters["start_soc_shift"]
    assert told.lo - 0.03 <= -0.3 <= told.hi + 0.03


def _from(record: ObservedRecord, soc: float) -> ObservedRecord:
    """The record from a charge on, with twenty seconds of rest at the cell's open-circuit voltage put before it."""
    drawn = np.cumsum(record.current_A * np.gradient(record.time_s)) / 3600.0 / record.capacity_Ah
    first = int(np.argmax(drawn > 1.0 - soc))
    table = KNOWN.parameters
    rested = CELLS * float(np.interp(soc, table.ocv_soc, table.ocv_V))
    rest_s = record.time_s[first] - np.arange(20.0, 0.0, -1.0)
    return ObservedRecord(
        record.name,
        np.concatenate([rest_s, record.time_s[first:]]),
        np.concatenate([np.full(20, rested), record.voltage_V[first:]]),
        np.concatenate([np.full(20, 0.2), record.current_A[first:]]),
        np.concatenate([np.full(20, record.temp_C[first]), record.temp_C[first:]]),
        record.ambient_C,
        record.cells,
        record.capacity_Ah,
    )


def test_slower_diffusion_is_news_to_a_file_that_has_a_slow_lag(healthy: Diagnosis) -> None:
    options = {c.name: c for c in options_of(healthy.problem, KNOWN, ())}
    diffusion, polarisation = options["slow_diffusion"], options["polarisation"]
    assert [QUANTITIES[f.index].name for f in diffusion.freed] == ["surface_h"] and not diffusion.resized
    assert [QUANTITIES[f.index].name for f in polarisation.freed] == ["polarisation_ratio"] and polarisation.resized


def names_seated(healthy: Diagnosis, leaves: dict[str, float], *likely: float, explains: float = 100.0) -> list[str]:
    """Names that are seated, of effects that each leave so much in every number; the model without them leaves more."""
    nothing = healthy.before
    fits = [replace(nothing, candidate=Candidate((n,), (), (0,)), residual=nothing.residual + d)
            for n, d in leaves.items()]  # fmt: skip
    without = replace(nothing, residual=nothing.residual - explains)
    return [list(leaves)[i] for i in members_of_class(fits, np.array(likely), without)]


def test_a_weak_cell_is_seated_beside_a_faded_pack(healthy: Diagnosis) -> None:
    leaves = {"capacity_fade": 0.0, "unmetered_load": 10.0, "voltage_offset": 20.0, "weak_cell": 30.0}
    assert names_seated(healthy, leaves, 0.3, 0.25, 0.2, 0.2) == ["capacity_fade", "unmetered_load", "weak_cell"]
    del leaves["capacity_fade"]
    assert names_seated(healthy, leaves, 0.4, 0.3, 0.3) == list(leaves)


def test_a_weak_cell_that_is_told_from_the_fade_takes_no_seat_from_what_is_likelier(healthy: Diagnosis) -> None:
    leaves = {"capacity_fade": 0.0, "current_gain": 0.0, "unmetered_load": 10.0, "weak_cell": 20.0}
    for weak, third in ((0.09, "unmetered_load"), (0.11, "weak_cell")):
        assert names_seated(healthy, leaves, 0.3, 0.3, 0.2, weak) == ["capacity_fade", "current_gain", third]


def test_a_weak_cell_takes_the_seat_of_a_second_name_of_the_fade(healthy: Diagnosis) -> None:
    leaves = {"resistance_growth": 0.0, "current_gain": 10.0, "capacity_fade": 10.0, "weak_cell": 20.0}
    assert names_seated(healthy, leaves, *[0.25] * 4) == ["resistance_growth", "capacity_fade", "weak_cell"]


def test_a_likelier_name_of_the_same_family_is_seated_before_a_less_likely_one_of_another(healthy: Diagnosis) -> None:
    leaves = {"resistance_growth": 0.0, "harness_resistance": 10.0, "slow_diffusion": 20.0, "initial_charge": 30.0}
    assert names_seated(healthy, leaves, *[0.25] * 4) == list(leaves)[:3]


def test_explanations_of_a_small_effect_are_no_names_of_one(healthy: Diagnosis) -> None:
    """A chi-square of 7 beside the best is nothing where 10,000 are explained, and a seventh of it where 49 are."""
    chi = 1.0 / math.sqrt(healthy.before.residual.size)  # of each number, for a chi-square of 1
    leaves = {"charge_transfer": 0.0, "voltage_gain": 4.0 * chi, "voltage_offset": 5.0 * chi, "hysteresis": 2.6 * chi}
    for explains, seats in (
        (100.0, ["charge_transfer", "hysteresis", "voltage_gain"]),
        (7.0, ["charge_transfer", "voltage_gain", "voltage_offset"]),
    ):
        assert names_seated(healthy, leaves, 0.3, 0.25, 0.25, 0.2, explains=explains * chi) == seats


def test_what_is_worth_less_than_is_asked_is_never_told_as_likely(healthy: Diagnosis) -> None:
    def told(value: float) -> float:
        its = Worth(np.full(3, value / 3.0), value, 1.0, None)
        return no_chance(healthy.problem, healthy.before, healthy.before, its, earned=12.0)

    assert told(11.9) <= SUSPECT < told(12.1) < told(36.0)


@pytest.mark.parametrize(
    ("warm", "is_sure"), [((1, 1, 1), True), ((0, 0, 1), True), ((1, 1, 0), False), ((0, 0, 0), False)]
)
def test_what_only_flights_colder_than_the_file_knows_show_is_a_suspect(
    healthy: Diagnosis, warm: tuple[int, ...], is_sure: bool
) -> None:
    problem = replace(healthy.problem, evidence=replace(healthy.problem.evidence, familiar=np.array(warm, dtype=bool)))
    its = Worth(np.array([2.0, 3.0, 30.0]), 35.0, 1.0, None)
    assert (no_chance(problem, healthy.before, healthy.before, its, earned=12.0) > SUSPECT) == is_sure


def test_a_flight_colder_than_the_file_knows_is_not_familiar() -> None:
    wander = msgspec.structs.replace(CLOSE, coldest_C=15.0)
    file = msgspec.structs.replace(KNOWN, discrepancy=msgspec.structs.replace(KNOWN.discrepancy, wander=wander))
    flown = [flight(k) for k in range(3)]
    evidence = problem_of(flown, file, PACK).evidence
    starts_C = dict(zip((r.name for r in flown), (float(r.temp_C[0]) for r in flown), strict=True))
    assert list(evidence.familiar) == [starts_C[name] > 15.0 for name in evidence.names]
    assert 0 < np.sum(evidence.familiar) < 3
    assert problem_of(flown, KNOWN, PACK).evidence.familiar.all()


@pytest.mark.parametrize(
    ("planted", "truth"), [({"gain": 1.03}, "current_gain"), ({"offset_V": -0.06}, "voltage_offset")]
)
def test_what_is_too_small_to_be_told_is_said_to_hide(planted: dict[str, float], truth: str) -> None:
    diagnosis = found([flight(k, **planted) for k in range(2)])
    assert diagnosis.verdict == "no_missing_effect"
    assert not diagnosis.after.candidate.names  # nothing of it enters the battery file
    (one,) = diagnosis.classes
    assert truth in one.members and one.probability <= SUSPECT
    interval = next(iter(one.parameters.values()))
    assert interval.lo <= next(iter(planted.values())) <= interval.hi


def test_an_effect_whose_model_is_nearly_doubted_is_told_with_less() -> None:
    shares = [
        candidate_probability(MisfitPerNumber(voltage, 1.0), ()) for voltage in (0.8, USUAL, 0.5 * (USUAL + LEFT), LEFT)
    ]
    assert (
        shares[0]
        == shares[1]
        > shares[2]
        > shares[3]
        == candidate_probability(MisfitPerNumber(0.8, 1.0), ("something is left",))
    )


@pytest.mark.parametrize(("apart", "rivals"), [(10.0, [0, 1]), (0.0, [0])])
def test_another_name_of_the_likeliest_is_a_rival_unless_it_leaves_what_nothing_leaves(
    healthy: Diagnosis, apart: float, rivals: list[int]
) -> None:
    before = healthy.before
    fits = tuple(replace(before, candidate=Candidate((n,), (), (0,)), residual=before.residual + apart)
                 for n in ("current_gain", "capacity_fade"))  # fmt: skip
    worths = tuple(Worth(np.array([value]), value, 1.0, None) for value in (36.0, 1.1))
    assert Trial(before, fits, worths).rivals == rivals
