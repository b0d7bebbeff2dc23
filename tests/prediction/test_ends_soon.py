"""F17: where no time can be said in flight, or none is left, the measured voltage says that the end is near."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import pytest
from cases import first_quick
from factories import generic_estimator
from scoring.other_pack import CELLS, CUTOFF_V, Pack, Power, drawn, flown, rested

from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.prediction.pending import ENDS_SOON
from uavbatt.records import NAN, Status


def test_a_capacity_that_cannot_be_takes_the_time_away_and_not_the_alarm() -> None:
    """ArduPilot's own 3.3 Ah stands in the parameters of a 16 Ah pack: the charge drawn denies it."""
    pack = Pack(capacity_Ah=16.0, size_Ah=16.0)
    rows = [*rested(pack, 20, 0.0), *flown(pack, 20.0)]
    options = PackOptions(cells=CELLS, capacity_Ah=3.3, cutoff_V=CUTOFF_V)
    run = list(generic_estimator(options).run(rows))
    end_s = rows[-1].time_s
    last = [(estimate, remaining) for estimate, remaining in run if end_s - 60.0 < estimate.time_s < end_s - 20.0]
    assert all(remaining.remaining_s != remaining.remaining_s for _, remaining in last)
    said_s = [end_s - estimate.time_s for estimate, _ in run if ENDS_SOON in estimate.warnings]
    assert said_s and 30.0 < max(said_s) < 400.0


@pytest.mark.parametrize("lost_s", [100.0, 400.0])
def test_a_current_that_is_lost_takes_the_time_away_and_not_the_alarm(lost_s: float) -> None:
    """The sensor's wire breaks in flight: what is left of the telemetry is the voltage."""
    pack = Pack()
    rows = [*rested(pack, 20, 0.0), *flown(pack, 20.0)]
    rows = [row if row.time_s < lost_s else replace(row, current_A=NAN) for row in rows]
    options = PackOptions(cells=CELLS, capacity_Ah=pack.size_Ah, cutoff_V=CUTOFF_V)
    run = list(generic_estimator(options).run(rows))
    end_s = rows[-1].time_s
    last = [remaining for _, remaining in run if remaining.time_s > lost_s + 10.0]
    assert all(remaining.remaining_s != remaining.remaining_s for remaining in last)
    said_s = [end_s - estimate.time_s for estimate, _ in run if ENDS_SOON in estimate.warnings]
    assert said_s and 30.0 < max(said_s) < 400.0


@pytest.mark.parametrize("below_V", first_quick(1, [0.5, 0.1, 1.5]))
def test_who_flies_on_below_the_cut_off_has_no_time_left(below_V: float) -> None:
    """Two minutes were said for twenty, without width: the horizon of the forecast stood as an end."""
    pack = Pack(soc=0.2)
    rows = [*rested(pack, 20, 0.0), *flown(pack, 20.0)]
    last = rows[-1]
    under = [
        replace(
            last,
            time_s=last.time_s + k,
            voltage_V=CUTOFF_V - below_V + 0.02 * (k % 5),
            current_A=last.current_A + 0.5 * (k % 3),
        )
        for k in range(1, 1201)
    ]
    options = PackOptions(cells=CELLS, capacity_Ah=pack.size_Ah, cutoff_V=CUTOFF_V)
    said = [remaining for _, remaining in generic_estimator(options).run([*rows, *under])][len(rows) + 5 :]
    assert {remaining.remaining_s for remaining in said} == {0.0}
    assert not any(remaining.status is Status.OK for remaining in said)


def test_the_time_by_the_voltage_is_not_lost_when_the_belief_changes_its_mind() -> None:
    """12S of 22 Ah, stated as 220 Ah, a row every 2 s: 44, 78 and 620 s were said in the last 23 s."""
    pack = Pack(capacity_Ah=22.0, soc=0.6, size_Ah=22.0, cells=12)
    ground = drawn(pack, [66.0] * 15, 0.0, armed=False).rows
    powers = (13.2 * watts for watts in Power().rows_W(3))
    rows = [*ground, *drawn(pack, powers, 15.0, ground[-1].consumed_Ah, cutoff_V=3.0 * CUTOFF_V).rows][::2]
    options = PackOptions(cells=12, capacity_Ah=220.0, cutoff_V=3.0 * CUTOFF_V)
    run = generic_estimator(options, period_s=1.0).run(rows)
    end_s = rows[-1].time_s
    said_s = [remaining.remaining_s for estimate, remaining in run if estimate.time_s >= end_s - 45.0]
    assert all(later < before + 5.0 for before, later in pairwise(said_s))
    assert said_s[-1] < 10.0
