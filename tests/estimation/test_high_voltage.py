"""Cells that charge to 4.35 V fly with the generic battery: the rested voltage tells them from ordinary ones."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from daemon_bench import Bench
from factories import generic_estimator
from scoring.other_pack import CELLS, CUTOFF_V, FULL_AH, LIHV, Pack, rested
from scoring.scenarios import STATED, another, flight

from uavbatt.battery.high_voltage import ORDINARY_FULL_V
from uavbatt.battery.remembered import PackHealth
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.live.config import StateSection
from uavbatt.records import Estimate, Remaining, Sample, Status

TAKEN_FOR, LIHV_FULL_V = "taken for LiHV", 4.35


@cache
def rows(soc: float, air_C: float, capacity_Ah: float = FULL_AH) -> tuple[Sample, ...]:
    return tuple(flight(Pack(capacity_Ah, soc, make=LIHV, air_C=air_C)))


@cache
def run(soc: float, air_C: float, capacity_Ah: float = FULL_AH) -> list[tuple[Estimate, Remaining]]:
    return list(generic_estimator(STATED).run(rows(soc, air_C, capacity_Ah)))


@pytest.mark.parametrize(("soc", "air_C"), [(1.0, 25.0), (1.0, 5.0), (0.97, 25.0)])
def test_a_healthy_pack_has_a_number_from_take_off_on(soc: float, air_C: float) -> None:
    """It was refused for two minutes as a pack of a fifth of its capacity, and alarmed at half time."""
    end_s = rows(soc, air_C)[-1].time_s
    said = [pair for pair in run(soc, air_C) if 30.0 < pair[0].time_s < end_s - 5.0]
    assert all(remaining.status is not Status.REFUSED for _, remaining in said)
    assert not [w for estimate, _ in said for w in estimate.warnings if "holds less" in w]
    alarm_s = next(r.time_s for _, r in said if r.remaining_alarm_s <= 120.0)
    assert 45.0 <= end_s - alarm_s <= 300.0
    assert all(TAKEN_FOR in " ".join(estimate.warnings) for estimate, _ in said)


def test_a_worn_pack_is_still_seen() -> None:
    end_s = rows(1.0, 25.0, 4.0)[-1].time_s
    late = [r for _, r in run(1.0, 25.0, 4.0) if end_s - 300.0 < r.time_s < end_s - 5.0]
    assert max(r.remaining_lo_s - (end_s - r.time_s) for r in late) < 25.0
    assert end_s - next(r.time_s for r in late if r.remaining_alarm_s <= 120.0) >= 45.0


@pytest.mark.parametrize("first_V", [17.4, 4.0])
def test_one_damaged_first_row_makes_no_other_cells(first_V: float) -> None:
    sound = rested(Pack(), 20, 0.0)
    judge = generic_estimator(STATED)
    for sample in [replace(sound[0], voltage_V=first_V), *sound[1:]]:
        judge.step(sample)
    assert judge.pack_size is not None and judge.pack_size.fullest_cell_V == ORDINARY_FULL_V


@pytest.mark.parametrize(("first", "second"), [("lihv", "lipo"), ("lipo", "lihv")])
def test_the_next_pack_may_be_of_other_cells(first: str, second: str) -> None:
    """A swap in a silence: the kind of the cells is told anew."""
    packs = {"lihv": Pack(make=LIHV), "lipo": Pack()}
    judge = generic_estimator(STATED)
    for _ in judge.run(another(packs[first], 300, 60.0, packs[second])[:-300]):
        pass
    assert judge.pack_size is not None
    assert (judge.pack_size.fullest_cell_V > ORDINARY_FULL_V) is (second == "lihv")


@pytest.mark.parametrize("second", ["lihv", "lipo"])
def test_the_ledger_s_word_about_a_pack_is_not_for_the_next_one(second: str) -> None:
    """Of a pack that begins charged to 4.1 V a cell, the voltage does not tell its kind: the ledger does."""
    of_lihv = PackHealth(math.log(0.0045), math.log(FULL_AH), np.diag([0.01, 0.0004]), CELLS, LIHV_FULL_V)
    judge = generic_estimator(STATED, remembered=of_lihv)
    judge.remembered_next = of_lihv if second == "lihv" else None
    for _ in judge.run(another(Pack(make=LIHV, soc=0.4), 100, 60.0, Pack(soc=0.85))[:-300]):
        pass
    assert judge.pack_size is not None
    assert (judge.pack_size.fullest_cell_V > ORDINARY_FULL_V) is (second == "lihv")


def test_it_is_still_known_after_a_restart_in_the_air(tmp_path: Path) -> None:
    """The voltage under load no longer tells it: the saved state does."""
    state = StateSection(file=str(tmp_path / "state.json"))
    options = PackOptions(cells=CELLS, capacity_Ah=FULL_AH, cutoff_V=CUTOFF_V)
    before = Bench(options, state=state)
    before.play(rows(1.0, 25.0)[:300])
    charge = before.daemon.board.reports[0].estimate.soc
    before.daemon.close()
    after = Bench(options, start_s=before.now_s + 1.0, state=state)
    after.play(rows(1.0, 25.0)[302:330])
    report = after.daemon.board.reports[0]
    assert report.estimate.soc == pytest.approx(charge - 0.035, abs=0.02)
    assert any(TAKEN_FOR in warning for warning in report.estimate.warnings)
