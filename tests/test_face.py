"""The public face: what a prompt shows, what a notebook gets, and how a wrong argument is answered."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch
from xml.etree import ElementTree

import pytest
from command import called
from packs.made import flight as recorded

import uavbatt
from uavbatt.battery import battery_file
from uavbatt.dataset import load
from uavbatt.log_replay import whole
from uavbatt.packs.ledger import Ledger

ROUTE = """QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t47.0\t8.0\t420\t1
1\t0\t3\t22\t0\t0\t0\t0\t0\t0\t20\t1
2\t0\t3\t16\t0\t0\t0\t0\t47.004\t8.0\t20\t1
"""


@pytest.fixture(scope="module")
def flown(short_log: Path) -> uavbatt.Replay:
    return uavbatt.replay(short_log, cells=4, capacity_Ah=2.1, cutoff_V=13.0)


def test_python_and_the_command_say_the_same(flown: uavbatt.Replay, short_log: Path, tmp_path: Path) -> None:
    pack = ("--cells", "4", "--capacity-ah", "2.1", "--cutoff-voltage", "13")
    assert called("replay", short_log, *pack, "--jsonl", "l.jsonl", folder=tmp_path).returncode == 0
    lines = [json.loads(line) for line in (tmp_path / "l.jsonl").read_text().splitlines()]
    assert flown.rows == lines and len(flown) == len(lines) > 100


def test_the_rows_are_a_table_of_numbers(flown: uavbatt.Replay) -> None:
    pytest.importorskip("pandas", reason="needs the extra pandas")
    table = flown.to_frame()
    assert list(table.columns) == list(max(flown.rows, key=len)) and len(table) == len(flown)
    assert table["remaining_s"].dtype == float and table["soc"].dtype == float
    refused = [row["remaining_s"] is None for row in flown.rows]
    assert any(refused) and table["remaining_s"].isna().tolist() == refused  # unknown is never zero


def test_without_pandas_the_extra_is_named(flown: uavbatt.Replay) -> None:
    with patch.dict(sys.modules, {"pandas": None}), pytest.raises(uavbatt.MissingExtra, match=r"uavbatt\[pandas\]"):
        flown.to_frame()


def test_what_was_read_serves_as_well_and_a_power_is_a_number_or_text(short_log: Path) -> None:
    by_name = uavbatt.replay(short_log, load="300", forecast_period_s=60.0)
    read = uavbatt.read_log(short_log), battery_file.read_battery("lipo-generic")
    assert uavbatt.replay(*read, load=300.0, forecast_period_s=60.0).rows == by_name.rows


def test_big_values_show_one_short_line(flown: uavbatt.Replay) -> None:
    for value in (flown, flown.flight, battery_file.read_battery("lpab-3s"), load()):
        assert len(repr(value)) < 250 and "\n" not in repr(value)
    assert "short.tlog" in repr(flown.flight) and f"{len(flown.flight.samples)} rows" in repr(flown.flight)


def test_a_notebook_shows_the_answer_and_the_time_left(flown: uavbatt.Replay) -> None:
    shown = flown._repr_html_()
    root, left = ElementTree.fromstring(shown), flown.outcome.landing
    assert left is not None and len(shown) < 30_000
    text = " ".join(root.itertext())
    minutes = f"{round(left.remaining_s) // 60}:{round(left.remaining_s) % 60:02d} min"
    assert minutes in text and "lipo-generic (generic)" in text and "4S" in text
    (svg,) = root.iter("svg")
    assert "Time left" in svg.attrib["aria-label"] and len(list(svg.iter("polyline"))) == 1


def test_the_drawing_of_a_notebook_has_a_gap_where_there_was_no_forecast(flown: uavbatt.Replay) -> None:
    """It was a straight line across a time in which nothing was known."""
    third = len(flown) // 3
    nothing = [replace(s, remaining=replace(s.remaining, remaining_s=math.nan)) for s in flown.steps[third : 2 * third]]
    shown = replace(flown, steps=(*flown.steps[:third], *nothing, *flown.steps[2 * third :]))._repr_html_()
    assert len(list(ElementTree.fromstring(shown).iter("polyline"))) == 2


def test_a_notebook_shows_a_replay_without_a_forecast(short_log: Path) -> None:
    flight = uavbatt.read_log(short_log)
    ground = uavbatt.replay(replace(flight, samples=flight.samples[:4]), cells=4, capacity_Ah=2.1)
    shown = ground._repr_html_()
    assert "<svg" not in shown and "none" in " ".join(ElementTree.fromstring(shown).itertext())


def test_a_prompt_completes_the_public_names_alone() -> None:
    assert dir(uavbatt) == sorted(uavbatt.__all__)


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"cells": 0}, "cells=0"),
        ({"cells": 4.5}, "cells=4.5"),
        ({"capacity_Ah": -5.0}, "capacity_Ah=-5"),
        ({"capacity_Ah": 5000.0}, "mAh"),
        ({"capacity_Ah": "5"}, "capacity_Ah='5'"),
        ({"cutoff_V": 3.3}, "cutoff_V=3.3"),
        ({"reserve_soc": 20}, "reserve_soc=20"),
        ({"load": "fast"}, "load=fast"),
        ({"load": -5.0}, "load=-5"),
        ({"instance": 3}, "instance 3"),
        ({"pack": "P1"}, "packs="),
        ({"forecast_period_s": -1.0}, "forecast_period_s=-1"),
        ({"forecast_period_s": "often"}, "forecast_period_s='often'"),
        ({"capacity_Ah": True}, "capacity_Ah=True"),
    ],
)
def test_an_argument_that_cannot_be_is_named(short_log: Path, given: dict[str, object], named: str) -> None:
    stated = {"cells": 4, "capacity_Ah": 2.0, "cutoff_V": 13.2, **given}
    with pytest.raises(uavbatt.UsageError) as error:
        uavbatt.replay(short_log, **stated)  # type: ignore[arg-type]
    assert named in str(error.value) and "\n" not in str(error.value)


def test_what_the_log_denies_is_named_in_python_s_words(short_log: Path) -> None:
    with pytest.raises(uavbatt.UsageError, match=r"short.tlog: cells: 9 cells in series: 16"):
        uavbatt.replay(short_log, cells=9)
    assert uavbatt.replay(short_log, capacity_Ah=2.1, forecast_period_s=600.0).pack.capacity_from == "capacity_Ah"


def test_a_mission_file_and_the_pack_ledger_are_taken_as_by_the_command(tmp_path: Path) -> None:
    """The flight of a route without its mission in the log, on a pack that the ledger meets for the first time."""
    log, route, ledger = tmp_path / "f.tlog", tmp_path / "f.waypoints", tmp_path / "packs.sqlite"
    route.write_text(ROUTE)
    assert called("simulate", "-o", log, "--mission", route, "--rate-hz", "1", folder=tmp_path).returncode == 0
    flown = uavbatt.replay(log, mission=route, packs=ledger, pack="P1", forecast_period_s=30.0)
    assert any(row.get("load") == "route" for row in flown.rows)
    assert called("packs", ledger, "--pack", "P1", folder=tmp_path).returncode == 0
    options = ("--mission", route, "--packs", ledger, "--pack", "P1", "--json", "s.json")
    assert called("replay", log, *options, folder=tmp_path).returncode == 0
    said = json.loads((tmp_path / "s.json").read_text())
    assert said["pack_flights"] == 1 and 0.5 < said["route_share"] <= 1.0 and said["pack"] == "P1"


def test_a_pack_of_another_size_is_refused_before_the_replay(
    short_log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(whole, "steps", lambda *_: pytest.fail("the replay has begun"))
    with Ledger(tmp_path / "packs.sqlite") as ledger:
        ledger.save("P1", replace(recorded(0), cells=6))
    with pytest.raises(uavbatt.BadInput, match="pack P1: expected flights of 6 cells as before, found 4"):
        uavbatt.replay(short_log, packs=tmp_path / "packs.sqlite", pack="P1")


def test_an_estimator_names_them_too() -> None:
    with pytest.raises(uavbatt.UsageError, match=r"states one: give capacity_Ah$"):
        uavbatt.Estimator.from_battery("lipo-generic").step(uavbatt.Sample(0.0, 15.6, 10.0))
    with pytest.raises(uavbatt.UsageError, match="reserve_soc=20"):
        uavbatt.Estimator.from_battery("lipo-generic", reserve_soc=20)
    with pytest.raises(uavbatt.BadInput, match="lpab-3s"):
        uavbatt.Estimator.from_battery("nothing")


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"log": 3}, "log=3: expected the path of a flight log, or a Flight"),
        ({"battery": 3}, "battery=3: expected the name or path of a battery file"),
        ({"vehicle": 3}, "vehicle=3: expected the path of a vehicle file"),
        ({"mission": 3}, "mission=3: expected the path of a file, or None"),
        ({"packs": 3}, "packs=3: expected the path of a file, or None"),
        ({"instance": "0"}, "instance='0': expected the number of a battery, or None"),
    ],
    ids=str,
)
def test_an_argument_of_another_type_is_named(wrong: dict[str, object], words: str, short_log: Path) -> None:
    with pytest.raises(uavbatt.UsageError, match=words):
        uavbatt.replay(**{"log": short_log, **wrong})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (None, "sample=None: expected a Sample"),
        ((0.0, 16.0, 1.0), "expected a Sample"),
        (uavbatt.Sample(0.0, "16"), "sample.voltage_V='16': expected a number"),  # type: ignore[arg-type]
        (uavbatt.Sample(0.0, 16.0, None), "sample.current_A=None: expected a number"),  # type: ignore[arg-type]
    ],
    ids=str,
)
def test_a_sample_that_is_none_is_named_and_changes_nothing(wrong: uavbatt.Sample, words: str) -> None:
    estimator = uavbatt.Estimator.from_battery("lpab-3s", cells=4, capacity_Ah=5.0, cutoff_V=13.2)
    for hand_in in (estimator.step, lambda sample: list(estimator.run([sample]))):
        with pytest.raises(uavbatt.UsageError, match=words):
            hand_in(wrong)
    assert repr(estimator) == "<Estimator on lpab-3s: no sample yet>"
    estimator.step(uavbatt.Sample(0.0, 16.4, 10.0))
    assert repr(estimator).startswith("<Estimator on lpab-3s: 4S from ")


def test_a_log_that_is_no_path_is_named() -> None:
    with pytest.raises(uavbatt.UsageError, match="path=3: expected the path of a flight log"):
        uavbatt.read_log(3)  # type: ignore[arg-type]
