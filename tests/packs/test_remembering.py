"""What a flight teaches of its pack, and what the next one does with it: on flights of a pack that has aged."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from cases import first_quick
from scoring.other_pack import CELLS, CUTOFF_V, FULL_AH, LIHV, LIPO, ORDINARY, flown, read, rested
from scoring.other_pack import Pack as OtherPack

from uavbatt.battery import battery_file
from uavbatt.battery.high_voltage import ORDINARY_FULL_V
from uavbatt.battery.remembered import PackHealth, health_of, prior_of, scales_of, type_ohm, unlike, wear_of
from uavbatt.battery.scaling import pack_of
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.estimator import Estimator
from uavbatt.log_replay.run import engine_for
from uavbatt.packs import remembering
from uavbatt.packs.ageing import history
from uavbatt.packs.ledger import Ledger
from uavbatt.records import Flight, Identity, PackFacts
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight, with_effects

BATTERY = battery_file.read_battery("lpab-3s")
OPTIONS = PackOptions(cells=3, capacity_Ah=5.0, cutoff_V=10.0)
PACK = pack_of(BATTERY, 3, 5.0, 10.0, math.nan)
AGED = {"capacity_fade": 0.15, "resistance_growth": 0.2}
FADED, GROWN = 1.0 - AGED["capacity_fade"], 1.0 + AGED["resistance_growth"]
DAY_S = 86_400.0


def flight(
    number: int,
    effects: dict[str, float] | None = None,
    share: float = 1.0,
    serial: str = "A",
    ambient_C: float = 25.0,
) -> Flight:
    """A flight of a pack with some effects, of which the log holds a share."""
    pack = with_effects(PACK, AGED if effects is None else effects)
    samples = simulate_flight(pack, SimulatedFlight(power_W=160.0, ambient_C=ambient_C, rate_Hz=1.0, seed=number))
    kept = samples[: int(share * len(samples))]
    identity = Identity(battery_serial=serial, start_utc_s=1.79e9 + 3.0 * DAY_S * number)
    return Flight(f"logs/{number}.tlog", "tlog", tuple(kept), identity=identity, duration_s=kept[-1].time_s)


@pytest.fixture(scope="module")
def emptied() -> Flight:
    return flight(1)


@pytest.fixture(scope="module")
def record(emptied):
    return remembering.flight_for_ledger(BATTERY, OPTIONS, emptied).record


def test_a_flight_to_the_end_tells_capacity_and_ohms(record):
    assert math.exp(record.told.log_Ah) == pytest.approx(5.0 * FADED, rel=0.04)
    assert math.exp(record.told.log_ohm) == pytest.approx(type_ohm(PACK) * GROWN / FADED, rel=0.10)


@pytest.mark.parametrize("volts", first_quick(1, [4.9, 0.05, 5.2]))
def test_the_rows_after_a_pack_was_taken_out_teach_nothing_of_it(emptied, record, volts: float) -> None:
    """On USB power: a pack of 4.5 Ah was remembered with 3.1 Ah."""
    landed = [replace(emptied.samples[-1], current_A=0.0, armed=False)] * 30
    out = tuple(
        replace(sample, time_s=sample.time_s + k, voltage_V=volts if k > 10 else sample.voltage_V + 0.3)
        for k, sample in enumerate(landed, start=1)
    )
    found = remembering.flight_for_ledger(BATTERY, OPTIONS, replace(emptied, samples=(*emptied.samples, *out))).record
    assert found.told.log_Ah == pytest.approx(record.told.log_Ah, abs=0.02)
    assert found.duration_s == emptied.duration_s + 10.0


@pytest.mark.parametrize(("failed_s", "is_kept"), [(100.0, False), (5.0, True)])
def test_a_flight_with_a_failed_sensor_teaches_nothing(emptied, failed_s: float, is_kept: bool) -> None:
    """With 100 s without a current a pack of 4.9 Ah was remembered with 4.4 Ah."""
    samples = tuple(
        replace(sample, current_A=0.1 + 0.01 * (k % 7)) if 200.0 < sample.time_s <= 200.0 + failed_s else sample
        for k, sample in enumerate(emptied.samples)
    )
    found = remembering.flight_for_ledger(BATTERY, OPTIONS, replace(emptied, samples=samples))
    assert (found.record is not None) is is_kept
    assert is_kept or "a sensor failed in flight" in found.why_not


@pytest.mark.parametrize("weakest", [1, 3])
def test_the_weak_cell_of_a_flight_is_counted_from_one(weakest: int) -> None:
    """Of the last third of the rows, where a weak cell shows."""
    flown_rows = flight(1, share=0.4)
    below_V = [0.12 if number == weakest else 0.0 for number in (1, 2, 3)]
    early, late = (0.0, 0.3, 0.0), tuple(below_V)
    half = len(flown_rows.samples) // 2
    samples = tuple(
        replace(s, cell_voltages_V=tuple(s.voltage_V / 3.0 - below for below in (early if k < half else late)))
        for k, s in enumerate(flown_rows.samples)
    )
    found = remembering.flight_for_ledger(BATTERY, OPTIONS, replace(flown_rows, samples=samples)).record
    assert found.weak_cell == weakest
    assert found.weak_cell_V == pytest.approx(0.08, abs=1e-6)  # 0.12 V below the others, 0.08 V below the mean


def test_a_part_of_a_flight_tells_less_of_the_capacity(record):
    part = remembering.flight_for_ledger(BATTERY, OPTIONS, flight(1, share=0.5)).record
    assert part.told.variance_Ah > 4.0 * record.told.variance_Ah
    assert abs(part.told.log_Ah - math.log(5.0 * FADED)) < 2.0 * math.sqrt(part.told.variance_Ah)
    assert part.key == record.key


@pytest.mark.parametrize("growth", first_quick(1, [0.5, 0.0]))
def test_a_flight_to_the_end_tells_the_ohms_as_well_as_one_to_the_half(growth: float) -> None:
    """At the knee nobody knows how much of the drop is ohms; what was known before it must not be lost there."""
    true_ohm = type_ohm(PACK) * (1.0 + growth)
    whole, part = (
        remembering.flight_for_ledger(BATTERY, OPTIONS, flight(1, {"resistance_growth": growth}, share)).record.told
        for share in (1.0, 0.5)
    )
    assert math.exp(whole.log_ohm) == pytest.approx(true_ohm, rel=0.05)
    assert whole.variance_ohm < 1.3 * part.variance_ohm


def test_what_a_flight_drew_is_in_its_record(emptied, record):
    rows = emptied.samples
    assert record.charge_Ah == pytest.approx(5.0 * FADED * (record.soc_start - record.soc_end), rel=0.08)
    assert record.duration_s == rows[-1].time_s - rows[0].time_s
    assert record.source == "1.tlog"


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (lambda f: replace(f, samples=tuple(replace(s, current_A=math.nan) for s in f.samples)), "no current"),
        (lambda f: replace(f, samples=f.samples[:70]), "under load|of the charge"),
        (lambda f: replace(f, facts=((0.0, PackFacts(sag_compensated=True)),)), "sag-compensated"),
    ],
)
def test_a_flight_that_cannot_tell_says_why(emptied, changed, words):
    import re

    found = remembering.flight_for_ledger(BATTERY, OPTIONS, changed(emptied))
    assert found.record is None
    assert re.search(words, found.why_not)


def test_a_cold_morning_without_a_thermometer_is_no_damage() -> None:
    """A new pack at 6 °C had "24 % less charge at once: damaged?", and was then planned too short."""
    flights = [flight(k, {}, share=0.8, ambient_C=air_C) for k, air_C in enumerate((25.0, 20.0, 28.0, 6.0, 5.0))]
    bare = [replace(f, samples=tuple(replace(s, temp_C=math.nan) for s in f.samples)) for f in flights]
    told = [remembering.flight_for_ledger(BATTERY, OPTIONS, f).record for f in bare]
    known = history([record for record in told if record is not None])
    assert not any(after.findings for after in known)
    assert math.exp(known[-1].known.mean[1]) == pytest.approx(5.0, rel=0.1)


def test_a_log_that_begins_in_the_air_tells_little_of_the_resistance(emptied, record) -> None:
    """Logs from four minutes after take-off on had "43 % more resistance at once: damaged?"."""
    begun_s = emptied.samples[0].time_s + 240.0
    later = replace(emptied, samples=tuple(s for s in emptied.samples if s.time_s > begun_s))
    found = remembering.flight_for_ledger(BATTERY, OPTIONS, later).record
    assert math.sqrt(found.told.matrix[0, 0]) > 0.3 > 2.0 * math.sqrt(record.told.matrix[0, 0])
    assert abs(found.told.log_ohm - record.told.log_ohm) < 2.0 * math.sqrt(found.told.matrix[0, 0])


def test_the_second_flight_of_an_aged_pack_is_right_before_take_off(tmp_path, record):
    from uavbatt.plan.endurance import TakeOff, endurance, resolve
    from uavbatt.prediction.load.scenarios import ConstantLoad

    with Ledger(tmp_path / "packs.sqlite") as ledger:
        ledger.save("A", record)
        known = remembering.health_before(ledger, "A", flight(2, share=0.1), BATTERY)
    load, size = ConstantLoad(160.0, 0.01), resolve(BATTERY, OPTIONS)
    true_s = flight(2).samples[-1].time_s - 40.0  # idle before the take-off and after the end
    new, met = (endurance(BATTERY, size, load, TakeOff(25.0, remembered=health)).median_s for health in (None, known))
    assert abs(met - true_s) < 0.06 * true_s
    assert abs(met - true_s) < 0.5 * abs(new - true_s)


def test_nothing_changes_without_a_name_or_for_a_pack_that_nobody_met(tmp_path, emptied):
    with Ledger(tmp_path / "packs.sqlite") as ledger:
        assert remembering.health_before(ledger, "", emptied, BATTERY) is None
        assert remembering.health_before(ledger, "A", emptied, BATTERY) is None


def test_a_stated_name_goes_before_the_serial(emptied):
    assert remembering.name_of(emptied) == "A"
    assert remembering.name_of(emptied, "left") == "left"


def test_the_flights_own_evidence_overrules_what_is_remembered(record):
    """A pack remembered as aged is as good as new: at the end the flight believes its own readings."""
    aged = PackHealth(record.told.log_ohm, record.told.log_Ah, record.told.matrix)
    estimator = Estimator(BATTERY, OPTIONS, engine=engine_for(is_long=True), remembered=aged)
    *_, (estimate, _) = estimator.run(flight(3, effects={}).samples)
    assert estimate.capacity_scale == pytest.approx(1.0, abs=0.05)


def test_the_members_of_a_remembered_pack_sum_to_what_is_remembered(record):
    health = PackHealth(record.told.log_ohm, record.told.log_Ah, record.told.matrix)
    members = prior_of(PACK, health)
    assert members.weight.sum() == pytest.approx(1.0)
    likely = members.weight > 0.02
    mean = (members.weight[likely] @ members.log_scale[likely]) / members.weight[likely].sum()
    assert mean == pytest.approx(scales_of(PACK, health).mean[1], abs=0.01)


def test_ohms_and_ampere_hours_are_those_of_the_scales(record):
    health = PackHealth(record.told.log_ohm, record.told.log_Ah, record.told.matrix)
    again = health_of(PACK, scales_of(PACK, health))
    assert again[:2] == pytest.approx(health[:2])
    assert again.covariance == pytest.approx(health.covariance)


def test_a_pack_that_is_not_the_one_remembered_is_noticed_by_its_ohms():
    health = PackHealth(math.log(type_ohm(PACK)), math.log(5.0), np.diag([0.1**2, 0.05**2]))
    assert unlike(PACK, health, wear=0.05, wear_sd=0.02) == ""
    assert "50% more resistance than remembered" in unlike(PACK, health, wear=0.5, wear_sd=0.02)
    assert "50% more resistance than remembered" in unlike(PACK, health, wear=0.5, wear_sd=0.15)
    assert unlike(PACK, health, wear=0.5, wear_sd=0.3) == ""  # so rough a wear may be that of the same pack
    assert "less resistance" in unlike(PACK, health, wear=-0.4, wear_sd=0.02)
    assert "6 remembered of this pack" in unlike(PACK, health._replace(cells=6), wear=0.05, wear_sd=0.02)


@pytest.mark.parametrize("times", [2.0, 3.0])
def test_an_aged_pack_that_is_as_remembered_is_not_called_another(times):
    """What the ledger remembers is shared between a reaction and the resistance: the flight shows the latter alone."""
    health = PackHealth(math.log(times * type_ohm(PACK)), math.log(5.0), np.diag([0.05**2, 0.05**2]))
    core = prior_of(PACK, health)
    confirmed = math.expm1(float((core.log_resistance - core.log_scale)[core.weight.argmax()]))
    assert unlike(PACK, health, wear=confirmed, wear_sd=0.05) == ""
    assert "less resistance" in unlike(PACK, health, wear=confirmed / 3.0 - 0.2, wear_sd=0.05)


def test_what_is_remembered_as_effects_of_the_battery_file_is_the_same_pack(record):
    health = PackHealth(record.told.log_ohm, record.told.log_Ah, record.told.matrix)
    effects, (fade_sd, growth_sd) = wear_of(PACK, health)
    worn = with_effects(PACK, {"capacity_fade": effects["capacity_fade"]["fade"]}).installation
    assert worn.present_capacity_Ah == pytest.approx(math.exp(health.log_Ah))
    assert fade_sd == pytest.approx(math.sqrt(health.covariance[1, 1]) * FADED, rel=0.05)
    assert 0.0 < effects["resistance_growth"]["growth"] < math.exp(health.log_ohm) / type_ohm(PACK) - 1.0
    assert effects["charge_transfer"]["transfer_V"] > PACK.cell.transfer_V  # the other part of the ohms
    assert growth_sd > 0.0


def lihv(number: int, soc: float, seed: int) -> Flight:
    """A flight of one LiHV pack of another model, charged to `soc`."""
    pack = OtherPack(soc=soc, make=LIHV)
    ground = rested(pack, 15, 0.0)
    rows = (*ground, *flown(pack, 15.0, seed=seed))
    return Flight(f"{number}.csv", "csv", rows, identity=Identity(start_utc_s=1.79e9 + 3.0 * DAY_S * number))


def test_the_kind_of_a_packs_cells_is_remembered(tmp_path):
    """Charged to 4.14 V a cell it looks like an ordinary pack: two minutes before the end it was told four."""
    generic = battery_file.read_battery("lipo-generic")
    options = PackOptions(cells=CELLS, capacity_Ah=FULL_AH, cutoff_V=CUTOFF_V)
    with Ledger(tmp_path / "packs.sqlite") as ledger:
        for number, soc in enumerate((1.0, 1.0)):
            one = lihv(number, soc, number + 1)
            before = remembering.health_before(ledger, "A", one, generic)
            ledger.save("A", remembering.flight_for_ledger(generic, options, one, before).record)
        part = lihv(3, 0.83, 5)
        health = remembering.health_before(ledger, "A", part, generic)
        estimator = Estimator(generic, options, engine=engine_for(is_long=True), remembered=health)
        end_s = part.samples[-1].time_s
        late = [r for _, r in estimator.run(part.samples) if end_s - 240.0 < r.time_s < end_s - 20.0]
        assert max(r.remaining_lo_s - (end_s - r.time_s) for r in late) < 15.0
        assert estimator.pack_size is not None and estimator.pack_size.fullest_cell_V > ORDINARY_FULL_V
        ledger.save("A", remembering.flight_for_ledger(generic, options, part, health).record)
        assert ledger.last("A").fullest_cell_V > ORDINARY_FULL_V
        assert not ledger.last("A").findings


def test_what_was_read_by_the_curve_of_ordinary_cells_is_left_out_for_others(tmp_path):
    """Charged to 4.1 V a cell, then to 4.35 V: six minutes before the end it was told three and a half."""
    generic = battery_file.read_battery("lipo-generic")
    options = PackOptions(cells=CELLS, capacity_Ah=FULL_AH, cutoff_V=CUTOFF_V)
    with Ledger(tmp_path / "packs.sqlite") as ledger:
        for number in (1, 2):
            ledger.save("A", remembering.flight_for_ledger(generic, options, lihv(number, 0.81, number)).record)
        full = lihv(3, 1.0, 5)
        health = remembering.health_before(ledger, "A", full, generic)
        estimator = Estimator(generic, options, engine=engine_for(is_long=True), remembered=health)
        after = ledger.save("A", remembering.flight_for_ledger(generic, options, full, health).record)
        assert [finding.kind for finding in after.findings] == ["higher_charge"]
        own = ledger.pack("A").outlook
        assert own.capacity_Ah == pytest.approx(FULL_AH, rel=0.05)  # one flight: 4.8 Ah; a part of 0.6 before
    end_s = full.samples[-1].time_s
    said = [r for _, r in estimator.run(full.samples) if end_s - 360.0 < r.time_s < end_s - 350.0]
    assert said[0].remaining_lo_s < 360.0 < said[0].remaining_hi_s


def test_the_curve_of_another_make_is_no_resistance():
    """By a curve of 0.2 V less the ohms of a flight were told with an sd of 0.7, in ln; of Ecker's cell six times."""
    generic = battery_file.read_battery("lipo-generic")
    lower = (2.0, 2.6, 2.85, 3.05, 3.2, 3.32, 3.41, 3.47, 3.54, 3.60, 3.68, 3.78, 3.87, 3.97, 4.05, 4.10, 4.18)
    make = replace(LIPO, ocv_V=lower, ohmAh=0.03, lag_ohmAh=0.012)
    ground, air = rested(OtherPack(make=make), 15, 0.0), flown(OtherPack(make=make), 15.0, seconds=700)
    flight = Flight("x.csv", "csv", tuple(read([*ground, *air], ORDINARY, 1)))
    options = PackOptions(cells=CELLS, capacity_Ah=FULL_AH, cutoff_V=12.0)
    record = remembering.flight_for_ledger(generic, options, flight).record
    assert record.told.log_ohm == pytest.approx(math.log(make.ohmAh / FULL_AH), abs=0.2)
    assert math.sqrt(record.told.variance_ohm) < 0.2


def test_what_a_flight_tells_under_load_is_not_watered_down_by_the_ground() -> None:
    """Landed with 15 minutes left on the ground, cooling: at rest the cells are alike."""
    flown_rows = flight(1, share=0.4)
    weak = tuple(
        replace(s, cell_voltages_V=(s.voltage_V / 3.0, s.voltage_V / 3.0 - 0.12, s.voltage_V / 3.0))
        for s in flown_rows.samples
    )
    landed = replace(weak[-1], voltage_V=11.4, current_A=0.2, temp_C=12.0, armed=False, cell_voltages_V=(3.8,) * 3)
    ground = tuple(replace(landed, time_s=landed.time_s + k) for k in range(1, 900))
    alone, both = (
        remembering.flight_for_ledger(BATTERY, OPTIONS, replace(flown_rows, samples=samples)).record
        for samples in (weak, (*weak, *ground))
    )
    assert (both.weak_cell, both.weak_cell_V) == (2, pytest.approx(0.08, abs=1e-6))
    assert both.temp_mean_C == pytest.approx(alone.temp_mean_C, abs=0.01) and both.temp_mean_C > 24.0
