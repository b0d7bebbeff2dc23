"""A file from one log of a worn pack that was flown to its end, as a crew has it after its first day."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command import called
from scoring.other_pack import FLAT, LIHV, LIPO, ORDINARY, SOC, Flown, Make, Pack, Power, flight

from uavbatt.fitting.battery import RecordedPack, fit_battery

SIZE = RecordedPack("mine", 4, 5.0, 13.2)
POWER_W = 222.0


def flown(make: Make, share: float, seed: int) -> Flown:
    """A flight to the cut-off of a pack that holds a share of what is stated."""
    return flight(Pack(5.0 * share, make=make, air_C=20.0), Power(POWER_W), ORDINARY, seed=seed, seconds=4000)


@pytest.mark.parametrize(("make", "share"), [(LIPO, 0.8), (LIHV, 0.9)], ids=["LiPo 80 %", "LiHV 90 %"])
def test_its_knee_is_that_of_the_charge_and_no_bump_of_the_resistance(make: Make, share: float) -> None:
    table = fit_battery(SIZE, [], [flown(make, share, 1).flight("worn")]).file.parameters
    empty_first = np.array(table.resistance_ohmAh)[np.array(table.resistance_soc) <= 0.3]
    assert np.diff(np.log(empty_first)).max() < 0.1, (
        "it was 2.5 times as large at a fifth of the charge, and less below"
    )
    seen = np.array([0.2, 0.3, 0.5, 0.7])
    error_V = np.interp(seen, table.ocv_soc, table.ocv_V) - np.interp(seen, SOC, make.ocv_V)
    assert np.abs(error_V).max() < 0.03


@pytest.mark.slow
@pytest.mark.parametrize("make", [LIPO, LIHV, FLAT], ids=["LiPo", "LiHV", "flat"])
@pytest.mark.parametrize("share", [0.8, 0.9, 1.0])
def test_the_same_flight_once_more_is_not_said_too_long(make: Make, share: float, tmp_path: Path) -> None:
    """It was told 148 s too many, and a minute before its end the 5 % point was 114 s too long."""
    for name, seed in (("log", 1), ("again", 2)):
        rows = flown(make, share, seed).rows
        lines = [f"{r.time_s:.1f},{r.voltage_V:.3f},{r.current_A:.3f},{r.temp_C:.1f},{int(r.armed)}" for r in rows]
        (tmp_path / f"{name}.csv").write_text("\n".join(["time_s,voltage_V,current_A,temp_C,armed", *lines, ""]))
    size = ("--cells", 4, "--capacity-ah", 5.0, "--cutoff-voltage", 13.2)
    called("fit", "log.csv", *size, "-o", "own.battery.toml", folder=tmp_path)
    said = ("--battery", "own.battery.toml", "--load", "log", "--json", "said.json")
    called("replay", "again.csv", *said, folder=tmp_path)
    scores = json.loads((tmp_path / "said.json").read_text())["scores"]
    assert all(score["lo_s"] <= score["before_end_s"] for score in scores)
    assert max(score["error_s"] for score in scores) < 50.0
