"""A pack that is changed: while the autopilot goes on, or unseen; the voltage at rest tells, or the counter."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from cases import first_quick
from factories import generic_estimator
from scoring.other_pack import Pack, Power, drawn, flown, rested
from scoring.scenarios import STATED, another, flight

from uavbatt.records import Sample


@pytest.mark.parametrize("second_soc", [0.65, 0.8])
def test_a_somewhat_fuller_pack_is_another_without_a_silence(second_soc: float) -> None:
    """It was taken for the old one with a quarter more capacity: a minute before the end it was told at least two."""
    rows = another(Pack(), 400, 0.0, Pack(soc=second_soc), restarts=False)
    said = list(generic_estimator(STATED).run(rows))
    begin_s = 20.0 + 400.0 + 20.0 + 5.0
    at_rest = next(estimate for estimate, _ in said if estimate.time_s >= begin_s)
    assert at_rest.soc == pytest.approx(second_soc, abs=0.05)
    assert at_rest.capacity_scale < 1.05
    end_s = rows[-1].time_s
    late = [r for _, r in said if end_s - 120.0 < r.time_s]
    assert max(r.remaining_lo_s - (end_s - r.time_s) for r in late) < 25.0


@pytest.mark.parametrize(
    ("cells", "air_C", "resistance", "rests_s"),
    [(2, 25.0, 1.0, 300), (4, -5.0, 2.0, 300), (12, 10.0, 1.0, 300), (4, -5.0, 2.0, 3600)],
)
def test_a_pack_that_rests_after_a_flight_is_the_same(
    cells: int, air_C: float, resistance: float, rests_s: int
) -> None:
    """It rises for minutes, in steps of a noisy sensor; what the flight told of it stays."""
    pack = Pack(cells=cells, air_C=air_C, resistance=resistance)
    before = rested(pack, 20, 0.0)
    powers_W = itertools.islice(Power(75.0 * cells).rows_W(3), 300)
    before += drawn(pack, powers_W, 20.0, before[-1].consumed_Ah, cutoff_V=3.0 * cells).rows
    after = rested(pack, rests_s, before[-1].time_s + 1.0, before[-1].consumed_Ah)
    dice = np.random.default_rng(cells)
    options = replace(STATED, cells=cells, cutoff_V=3.3 * cells)
    judge = generic_estimator(options)
    assert len(before) == 320
    told = [e for e, _ in judge.run([noisy(row, dice) for row in before])][-1]
    for estimate, _ in judge.run([noisy(row, dice) for row in after]):
        assert estimate.capacity_scale_sd < told.capacity_scale_sd + 0.05  # of a new pack it is 0.1 more


@pytest.mark.parametrize(("cells", "usb_V"), [(3, 5.2), (4, 4.9), (6, 5.0)])
def test_the_voltage_of_usb_power_is_no_pack(cells: int, usb_V: float) -> None:
    """The crew was told on the ground that the pack holds less than stated, and that its voltage is another make's."""
    pack = Pack(cells=cells)
    rows = rested(pack, 20, 0.0)
    powers_W = itertools.islice(Power(75.0 * cells).rows_W(3), 300)
    rows += drawn(pack, powers_W, 20.0, rows[-1].consumed_Ah, cutoff_V=3.0 * cells).rows
    rows += rested(pack, 20, rows[-1].time_s + 1.0, rows[-1].consumed_Ah)
    usb = [replace(rows[-1], time_s=rows[-1].time_s + k, voltage_V=usb_V, current_A=0.0) for k in range(1, 60)]
    judge = generic_estimator(replace(STATED, cells=cells, cutoff_V=3.3 * cells), period_s=60.0)
    (told, _), *out = list(judge.run([*rows, *usb]))[len(rows) - 1 :]
    for estimate, _ in out:
        assert estimate.reason == "no voltage in this row"
        assert set(estimate.warnings) <= set(told.warnings)
        assert math.isnan(estimate.voltage_V)


def on_the_ground(pack: Pack, idle_C: float, seconds: int, rows: list[Sample]) -> list[Sample]:
    """The rows, and a wait under avionics that draw so much of 5 Ah, disarmed."""
    from_s, drawn_Ah = (rows[-1].time_s + 1.0, rows[-1].consumed_Ah) if rows else (0.0, 0.0)
    idle_W = itertools.repeat(idle_C * 5.0 * 15.0, seconds)
    return [*rows, *drawn(pack, idle_W, from_s, drawn_Ah, armed=False).rows]


@pytest.mark.parametrize("idle_C", first_quick(1, [0.5, 0.25, 1.0]))
@pytest.mark.parametrize(("first_soc", "second_soc"), [(0.85, 0.45), (0.6, 0.25), (0.6, 0.95)])
def test_a_pack_changed_at_once_under_avionics_that_draw_much_is_another(
    idle_C: float, first_soc: float, second_soc: float
) -> None:
    """The new pack is connected before the old one is taken off. A full one had no number for its whole flight, and
    with one that was half empty more than five minutes too many were said."""
    rows = on_the_ground(Pack(soc=first_soc), idle_C, 60, [])
    second = Pack(soc=second_soc)
    rows = on_the_ground(second, idle_C, 30, rows)
    begin_s = rows[-1].time_s
    rows += flown(second, begin_s + 1.0, drawn_Ah=rows[-1].consumed_Ah)
    said = list(generic_estimator(STATED, period_s=2.0).run(rows))
    before = next(estimate for estimate, _ in said if estimate.time_s >= begin_s)
    assert before.soc == pytest.approx(second_soc, abs=0.1)
    late = [(rows[-1].time_s - r.time_s, r) for _, r in said if r.time_s > begin_s + 20.0]
    assert max(r.remaining_lo_s - left_s for left_s, r in late if left_s > 5.0) < 15.0


@pytest.mark.parametrize("idle_C", [0.15, 0.5])  # the first flickers between an idle load and rest
def test_a_full_pack_for_an_empty_one_beside_a_noisy_current_sensor_is_another(idle_C: float) -> None:
    """Behind a converter its current is a fifth less than the empty one's, too. It had no number for its flight."""
    dice = np.random.default_rng(1)
    second = Pack()
    rows = on_the_ground(second, idle_C, 30, on_the_ground(Pack(soc=0.03), idle_C, 60, []))
    rows = [replace(row, current_A=row.current_A + 0.25 * float(dice.standard_normal())) for row in rows]
    *_, (last, _) = generic_estimator(STATED, period_s=60.0).run(rows)
    assert last.soc > 0.9


def test_a_pack_changed_on_usb_power_is_another_in_an_aircraft_that_is_always_armed() -> None:
    """A plane without arming is so. The new pack was taken for the old one and had no number."""
    first, second = Pack(), Pack(soc=0.95)
    rows = on_the_ground(first, 0.3, 20, [])
    rows += flown(first, 20.0, 400, rows[-1].consumed_Ah)
    rows = on_the_ground(first, 0.3, 20, rows)
    rows += [replace(rows[-1], time_s=rows[-1].time_s + k, voltage_V=4.9, current_A=0.0) for k in range(1, 11)]
    rows = [replace(row, armed=True) for row in on_the_ground(second, 0.3, 20, rows)]
    *_, (last, _) = generic_estimator(STATED, period_s=60.0).run(rows)
    assert last.soc == pytest.approx(0.95, abs=0.05) and last.capacity_scale_sd > 0.1  # nothing is known of it yet


def test_a_wire_that_breaks_in_flight_for_seconds_is_no_other_pack() -> None:
    pack = Pack()
    rows = on_the_ground(pack, 0.1, 20, [])
    rows += flown(pack, 20.0, 400, rows[-1].consumed_Ah)
    before = len(rows)
    rows += [replace(row, voltage_V=0.0, current_A=0.0) for row in flown(pack, rows[-1].time_s + 1.0, 10)]
    rows += flown(pack, rows[-1].time_s + 1.0, 60)
    said = [estimate for estimate, _ in generic_estimator(STATED, period_s=60.0).run(rows)]
    assert said[-1].capacity_scale_sd < said[before - 1].capacity_scale_sd + 0.05  # of a new pack it is 0.1 more


@pytest.mark.parametrize(("air_C", "resistance"), [(25.0, 1.0), (-5.0, 2.0)])
def test_landing_and_a_payload_that_is_switched_are_no_change_of_the_pack(air_C: float, resistance: float) -> None:
    pack = Pack(air_C=air_C, resistance=resistance)
    rows = on_the_ground(pack, 0.25, 30, [])
    rows += drawn(pack, itertools.islice(Power(300.0).rows_W(3), 240), 30.0, rows[-1].consumed_Ah, cutoff_V=12.0).rows
    flown_s = rows[-1].time_s
    for idle_C in (0.25, 0.8, 0.25, 1.2, 0.4, 0.05, 0.3):
        rows = on_the_ground(pack, idle_C, 40, rows)
    said = list(generic_estimator(STATED, period_s=60.0).run(rows))
    told, *waiting = [estimate for estimate, _ in said if estimate.time_s >= flown_s]
    for estimate in waiting:
        assert estimate.capacity_scale_sd < told.capacity_scale_sd + 0.05  # of a new pack it is 0.1 more


@pytest.mark.parametrize("usb_V", [4.8, 5.25])
@pytest.mark.parametrize("idle_A", [0.5, 2.5])
def test_two_cells_are_changed_on_usb_power(usb_V: float, idle_A: float) -> None:
    """Half of 5 V is a cell's: the old pack was thought to be empty, and the new one was taken for it."""
    first = Pack(cells=2)
    rows = rested(first, 20, 0.0)
    powers_W = itertools.islice(Power(150.0).rows_W(3), 300)
    rows += drawn(first, powers_W, 20.0, rows[-1].consumed_Ah, cutoff_V=6.0).rows
    rows += rested(first, 20, rows[-1].time_s + 1.0, rows[-1].consumed_Ah)
    rows += [replace(rows[-1], time_s=rows[-1].time_s + k, voltage_V=usb_V, current_A=0.0) for k in range(1, 16)]
    second = rested(Pack(cells=2), 30, rows[-1].time_s + 1.0)
    rows += [replace(row, current_A=idle_A, voltage_V=row.voltage_V - 0.02 * idle_A) for row in second]
    landed_s = rows[0].time_s + 320.0
    rows = [replace(row, armed=False) if row.time_s > landed_s else row for row in rows]
    judge = generic_estimator(replace(STATED, cells=2, cutoff_V=6.6), period_s=60.0)
    *_, (last, _) = judge.run(rows)
    assert last.soc > 0.9 and last.capacity_scale_sd > 0.1  # nothing is known of it yet


def test_an_open_input_before_the_pack_is_connected_is_no_pack() -> None:
    """At each start without a pack the crew was told that the count of cells does not fit it."""
    pack = rested(Pack(), 20, 30.0)
    bare = [replace(pack[0], time_s=float(k), voltage_V=0.05, current_A=0.0) for k in range(30)]
    judge = generic_estimator(replace(STATED, cells=None), period_s=60.0)
    for estimate, _ in judge.run(bare):
        assert (estimate.reason, estimate.warnings) == ("no voltage in this row", ())
    *_, (last, _) = judge.run(pack)
    assert judge.pack_size is not None and judge.pack_size.cells == 4
    assert last.soc > 0.95


def charged(charger_A: float) -> tuple[list[Sample], list[Sample]]:
    """Two flights of one pack, charged between them in a dock; and the second flight alone.

    charger_A : the current [A] that the aircraft's own sensor shows of it
    """
    first = Pack()
    before = rested(first, 15, 0.0)
    before += flown(first, 15.0, 400, before[-1].consumed_Ah)
    ground = rested(first, 120, before[-1].time_s + 1.0, before[-1].consumed_Ah)
    low_V, last = ground[-1].voltage_V, ground[-1]
    full = rested(Pack(), 1, 0.0)[0].voltage_V
    minutes = np.arange(0.0, 40.0, 0.05)
    risen_V = np.minimum(low_V + 0.2 + (full - low_V - 0.15) * minutes / 32.0, full + 0.05)
    charging = [
        replace(last, time_s=last.time_s + 1.0 + 60.0 * minute, voltage_V=volts, current_A=charger_A)
        for minute, volts in zip(minutes.tolist(), risen_V.tolist(), strict=True)
    ]
    settling = [
        replace(last, time_s=charging[-1].time_s + 3.0 + 3.0 * k, voltage_V=full + 0.05 * math.exp(-k / 20.0))
        for k in range(80)
    ]
    second = Pack()
    alone = rested(second, 15, 0.0)
    alone += flown(second, 15.0)
    shift_s = settling[-1].time_s + 1.0
    again = [replace(row, time_s=row.time_s + shift_s, consumed_Ah=row.consumed_Ah + last.consumed_Ah) for row in alone]
    landed = [replace(row, armed=False) for row in (*ground, *charging, *settling)]
    return [*before, *landed, *again], alone


@pytest.mark.parametrize("charger_A", [0.3, -5.0])
def test_a_pack_charged_in_a_dock_begins_anew(charger_A: float) -> None:
    """The autopilot stays on: half a charge was told for a full pack, or a minute too much at half time."""
    rows, alone = charged(charger_A)
    end_s = alone[-1].time_s
    shift_s = rows[-1].time_s - end_s
    docked = {e.time_s - shift_s: (e, r) for e, r in generic_estimator(STATED).run(rows) if e.time_s > shift_s}
    fresh = {e.time_s: (e, r) for e, r in generic_estimator(STATED).run(alone)}
    for before_s in (0.5 * end_s, 240.0, 120.0):
        (one, left), (other, true) = (
            min(said.items(), key=lambda at: abs(at[0] - (end_s - before_s)))[1] for said in (docked, fresh)
        )
        assert one.soc == pytest.approx(other.soc, abs=0.07)
        assert left.remaining_s == pytest.approx(true.remaining_s, abs=60.0)


def unseen(first: Pack, air_s: int, silent_s: float, second: Pack, restarts: bool = True) -> list[Sample]:
    """A flight that is lost from the air, and heard again when the next pack has been in the air for half a minute."""
    before = rested(first, 15, 0.0)
    before += flown(first, 15.0, air_s, before[-1].consumed_Ah)
    drawn_Ah = 0.0 if restarts else before[-1].consumed_Ah
    flown(second, 0.0, 30)
    return before + flown(second, before[-1].time_s + 1.0 + silent_s, drawn_Ah=drawn_Ah)


@pytest.mark.parametrize(("air_s", "silent_s", "soc"), [(60, 25.0, 0.35), (120, 60.0, 0.3), (120, 120.0, 0.6)])
def test_a_pack_changed_behind_a_lost_link_is_told_by_the_counter(air_s: int, silent_s: float, soc: float) -> None:
    """The link is back in the air: no rested voltage is seen. The time of the old pack was told for half a minute."""
    rows = unseen(Pack(), air_s, silent_s, Pack(soc=soc))
    said = list(generic_estimator(STATED, 3.0).run(rows))
    lost_s, end_s = 15.0 + air_s, rows[-1].time_s
    told = [e for e, _ in said if e.time_s < lost_s][-1]
    back = [(e, r) for e, r in said if e.time_s > lost_s + silent_s + 3.0]
    assert back[0][0].capacity_scale_sd > told.capacity_scale_sd + 0.02  # what the flight told of the old pack is gone
    excess_s = [r.remaining_lo_s - (end_s - r.time_s) for _, r in back if math.isfinite(r.remaining_lo_s)]
    assert max(excess_s) < 25.0


def test_the_same_pack_after_five_silent_minutes_keeps_what_the_flight_told() -> None:
    pack = Pack()
    rows = rested(pack, 15, 0.0)
    rows += flown(pack, 15.0, 300, rows[-1].consumed_Ah)
    silent_from_s = rows[-1].time_s
    rows += flown(pack, silent_from_s + 300.0, drawn_Ah=rows[-1].consumed_Ah)
    said = [e for e, _ in generic_estimator(STATED).run(rows)]
    told = [e for e in said if e.time_s <= silent_from_s][-1]
    back = next(e for e in said if e.time_s > silent_from_s + 10.0)
    assert back.capacity_scale_sd < told.capacity_scale_sd + 0.01


def test_an_autopilot_that_starts_anew_in_the_air_changes_no_pack() -> None:
    """Its counter falls as well; load and voltage go on as they were."""
    pack = Pack()
    before = [*rested(pack, 15, 0.0), *flown(pack, 15.0, 200)]
    flown(pack, 0.0, 12)
    after = flown(pack, before[-1].time_s + 13.0, 60)
    judge = generic_estimator(STATED)
    told = [e for e, _ in judge.run(before)][-1]
    for estimate, _ in judge.run(after):
        assert estimate.soc_sd < told.soc_sd + 0.02 and estimate.capacity_scale_sd < told.capacity_scale_sd + 0.02


def test_one_row_with_another_counter_changes_no_pack() -> None:
    pack = Pack()
    before = [*rested(pack, 15, 0.0), *flown(pack, 15.0, 200)]
    flown(pack, 0.0, 90)
    after = flown(pack, before[-1].time_s + 91.0, 60, before[-1].consumed_Ah + 0.4)
    after[0] = replace(after[0], consumed_Ah=0.0)
    judge = generic_estimator(STATED)
    told = [e for e, _ in judge.run(before)][-1]
    assert all(e.capacity_scale_sd < told.capacity_scale_sd + 0.02 for e, _ in judge.run(after))


@pytest.mark.parametrize(("first_soc", "air_s", "soc"), [(1.0, 400, 0.9), (1.0, 100, 0.6), (0.6, 150, 0.95)])
@pytest.mark.parametrize("idle_W", first_quick(1, [28.0, 6.0, 15.0]))
def test_a_pack_changed_under_an_idle_load_is_another(idle_W: float, first_soc: float, air_s: int, soc: float) -> None:
    """A payload or a companion draws up to 0.37 C on the ground; from 0.15 C on no change was seen."""
    first = Pack(soc=first_soc)
    rows = [*idle(first, idle_W, 0.0), *flown(first, 20.0, air_s)]
    rows += idle(first, idle_W, rows[-1].time_s + 1.0)
    rows = [replace(row, consumed_Ah=math.nan) for row in rows]
    told = [e for e, _ in generic_estimator(STATED).run(rows)][-1]
    second = [replace(r, consumed_Ah=math.nan) for r in idle(Pack(soc=soc), idle_W, rows[-1].time_s + 61.0)]
    said = [e for e, _ in generic_estimator(STATED).run([*rows, *second])][len(rows) :]
    assert abs(told.soc - soc) > 0.08 > abs(said[-1].soc - soc)
    assert not any("the stated" in words for e in said for words in e.warnings)


@pytest.mark.parametrize("idle_W", [6.0, 15.0, 28.0])
def test_the_same_pack_under_an_idle_load_is_no_other_after_a_silence(idle_W: float) -> None:
    pack = Pack()
    rows = [*idle(pack, idle_W, 0.0), *flown(pack, 20.0, 300)]
    rows += idle(pack, idle_W, rows[-1].time_s + 1.0)
    judge = generic_estimator(STATED)
    told = [e for e, _ in judge.run(rows)][-1]
    idle(pack, idle_W, 0.0, 60)
    for estimate, _ in judge.run(idle(pack, idle_W, rows[-1].time_s + 61.0, 300, rows[-1].consumed_Ah)):
        assert estimate.capacity_scale_sd < told.capacity_scale_sd + 0.02


def idle(pack: Pack, idle_W: float, from_s: float, seconds: int = 20, drawn_Ah: float = 0.0) -> list[Sample]:
    """Rows on the ground, disarmed, with a load of its own."""
    return list(drawn(pack, [idle_W] * seconds, from_s, drawn_Ah, armed=False).rows)


def noisy(row: Sample, dice: np.random.Generator) -> Sample:
    """Return the row as a sensor with 10 mV of noise and a last digit of 20 mV shows it."""
    return replace(row, voltage_V=round((row.voltage_V + 0.01 * float(dice.standard_normal())) / 0.02) * 0.02)


@pytest.mark.parametrize("late_rows", [3, 6])
def test_a_current_that_comes_late_at_take_off_is_no_other_pack(late_rows: int) -> None:
    """At 10 Hz three rows are 0.3 s: the voltage fell under a load that the sensor had not yet shown."""
    rows: list[Sample] = []
    drawn_Ah = 0.0
    for second, row in enumerate(flight(Pack(resistance=2.5))[:120]):
        before_A = rows[-1].current_A if rows else row.current_A
        for tenth in range(10):
            current_A = before_A if tenth < late_rows else row.current_A
            drawn_Ah += current_A / 36_000.0
            rows.append(replace(row, time_s=second + 0.1 * tenth, current_A=current_A, consumed_Ah=drawn_Ah))
    said = [estimate for estimate, _ in generic_estimator(STATED).run(rows)]
    falls = [before.soc - after.soc for before, after in itertools.pairwise(said)]
    assert max(map(abs, falls)) < 0.01  # an estimate that begins anew under load falls by 0.05
    assert said[-1].soc == pytest.approx(1.0 - drawn_Ah / 5.0, abs=0.03)


@pytest.mark.parametrize("open_V", [0.0, 0.36, 4.7])
def test_a_pack_that_was_taken_out_is_no_longer_believed(open_V: float) -> None:
    """The autopilot has another supply, and its open input floats; the next pack rests only a little lower."""
    first, second = Pack(), Pack(soc=0.6)
    before = [*rested(first, 15, 0.0), *flown(first, 15.0, 300)]
    before += rested(first, 30, before[-1].time_s + 1.0, before[-1].consumed_Ah)
    row = before[-1]
    out = [replace(row, time_s=row.time_s + k, voltage_V=open_V, current_A=0.0) for k in range(1, 21)]
    rows = [*before, *out, *rested(second, 15, out[-1].time_s + 1.0, row.consumed_Ah)]
    said = list(generic_estimator(STATED).run(rows))
    assert all(math.isnan(remaining.remaining_s) for _, remaining in said[-35:])
    fresh = next(estimate for estimate, _ in generic_estimator(STATED).run(rows[-1:]))
    assert said[-1][0].soc == pytest.approx(fresh.soc, abs=0.01)
    assert said[-1][0].capacity_scale_sd == pytest.approx(fresh.capacity_scale_sd, rel=0.1)


@pytest.mark.parametrize("broken_V", [0.2, 3.9, 4.4, 7.0, 9.9])
def test_a_voltage_wire_that_breaks_in_flight_gives_no_number(broken_V: float) -> None:
    """Its input floats: the page said that no time was left, for half a minute, and then that the pack was small."""
    rows = flight(Pack())
    broken = [replace(row, voltage_V=broken_V) if row.time_s >= 200.0 else row for row in rows]
    late = [(e, r) for e, r in generic_estimator(STATED).run(broken) if e.time_s >= 205.0]
    assert all(math.isnan(remaining.remaining_s) and remaining.reason for _, remaining in late)
    assert not any("less than stated" in warning for estimate, _ in late for warning in estimate.warnings)


def test_an_input_that_discharges_within_a_second_gives_no_number() -> None:
    """At 10 Hz a condenser takes some rows to empty; none of them was deep by itself."""
    rows = [replace(r, time_s=r.time_s + 0.1 * k) for r in flight(Pack())[:260] for k in range(10)]
    broken = [
        replace(r, voltage_V=5.2 + (r.voltage_V - 5.2) * math.exp((200.0 - r.time_s) / 0.3)) if r.time_s > 200.0 else r
        for r in rows
    ]
    late = [(e, r) for e, r in generic_estimator(STATED).run(broken) if e.time_s >= 205.0]
    assert all(math.isnan(remaining.remaining_s) for _, remaining in late)


def test_a_voltage_wire_that_is_loose_in_flight_begins_no_other_pack() -> None:
    rows = flight(Pack())
    loose = [replace(row, voltage_V=0.3) if 200.0 <= row.time_s < 220.0 else row for row in rows]
    sound, back = (list(generic_estimator(STATED).run(some)) for some in (rows[:300], loose[:300]))
    assert back[-1][0].soc == pytest.approx(sound[-1][0].soc, abs=0.03)
    assert back[-1][0].capacity_scale_sd == pytest.approx(sound[-1][0].capacity_scale_sd, rel=0.2)


def seen_as(volts: float, amps: float) -> list[Sample]:
    """The begin of a flight; from 200 s on, the sensors show these."""
    return [replace(r, voltage_V=volts, current_A=amps) if r.time_s >= 200.0 else r for r in flight(Pack())[:300]]


def test_a_voltage_that_falls_at_once_under_a_leap_of_the_current_is_believed() -> None:
    """A short circuit, or a pack that breaks down at full throttle: no time is left within the 5 s of a cut-off."""
    said = [remaining for _, remaining in generic_estimator(STATED).run(seen_as(9.0, 120.0)[:225])]
    assert [remaining.remaining_s for remaining in said if remaining.time_s > 205.0] == [0.0] * 19


@pytest.mark.parametrize("cells", [2, 3, 4])
def test_a_cell_that_fails_is_believed(cells: int) -> None:
    """The motors slow down with the voltage, so that the current does not rise: that is no broken wire either."""
    pack = Pack(cells=cells)
    rows = [*rested(pack, 15, 0.0), *drawn(pack, [75.0 * cells] * 300, 15.0, cutoff_V=3.3 * cells).rows]
    share = 1.0 - 1.0 / cells
    failed = [
        replace(r, voltage_V=share * r.voltage_V, current_A=share * r.current_A) if r.time_s >= 200.0 else r
        for r in rows
    ]
    options = replace(STATED, cells=cells, cutoff_V=3.3 * cells)
    said = [remaining for _, remaining in generic_estimator(options).run(failed[:225])]
    assert [remaining.remaining_s for remaining in said if remaining.time_s > 207.0] == [0.0] * 17


@pytest.mark.parametrize("row_s", [1.0, 0.1])
def test_a_pack_that_is_emptied_below_its_cells_is_believed(row_s: float) -> None:
    """Within six seconds it falls from its cut-off to half of it."""
    rows = list(flight(Pack()))
    last = rows[-1]
    fall = [last.voltage_V * (1.0 - 0.5 * k * row_s / 6.0) for k in range(1, round(6.0 / row_s) + 1)]
    rows += [replace(last, time_s=last.time_s + row_s * k, voltage_V=volts) for k, volts in enumerate(fall, 1)]
    said = [remaining for _, remaining in generic_estimator(STATED).run(rows)]
    assert all(remaining.remaining_lo_s == 0.0 for remaining in said[-len(fall) :])
