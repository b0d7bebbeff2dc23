"""The replay output: its keys, what unknown looks like, and that nothing half-written stays."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uavbatt.output import COLUMNS, Line, Sink, csv_table, json_lines, line
from uavbatt.records import NAN, Estimate, Remaining, Status

KEYS = [
    *("time_s", "soc", "soc_sd", "remaining_s", "remaining_lo_s", "remaining_hi_s", "remaining_to_low_s"),
    *("voltage_V", "current_A", "temp_C", "power_W", "innovation_V", "status", "reason", "warnings"),
]
ESTIMATE = Estimate(
    *(12.34567, 0.7654321, 0.0123456, 15.61238, 18.0, NAN, 281.02229, -0.0000049, 0.4),
    Status.OK,
    warnings=("no temperature sensor", "certificate is for another pack, 3S"),
)
REMAINING = Remaining(12.34567, 431.26, 377.0, math.inf, 301.04, Status.OK)


def test_keys_are_the_contract() -> None:
    assert list(COLUMNS) == KEYS
    assert list(line(ESTIMATE, REMAINING)) == KEYS


def test_values_are_rounded_and_unknown_is_none() -> None:
    made = line(ESTIMATE, REMAINING)
    assert made["time_s"] == 12.346 and made["soc"] == 0.76543 and made["voltage_V"] == 15.6124
    assert made["remaining_s"] == 431.3
    assert made["temp_C"] is None and made["remaining_hi_s"] is None
    assert math.copysign(1.0, float(str(made["innovation_V"]))) == 1.0  # no -0.0
    assert (made["status"], made["reason"]) == ("ok", "")


@pytest.mark.parametrize(
    ("estimate", "remaining", "expected"),
    [
        (Status.OK, Status.OK, "ok e"),
        (Status.CONVERGING, Status.OK, "converging e"),
        (Status.STALE, Status.OK, "stale e"),
        (Status.OK, Status.CONVERGING, "converging r"),
        (Status.OK, Status.REFUSED, "refused r"),
        (Status.OK, Status.STALE, "stale r"),
        (Status.CONVERGING, Status.REFUSED, "refused r"),
    ],
)
def test_status_and_reason_belong_together(estimate: Status, remaining: Status, expected: str) -> None:
    made = line(replace(ESTIMATE, status=estimate, reason="e"), replace(REMAINING, status=remaining, reason="r"))
    assert f"{made['status']} {made['reason']}" == expected


def test_a_refused_number_is_none_with_its_reason() -> None:
    made = line(ESTIMATE, replace(REMAINING, status=Status.REFUSED, reason="load unknown"))
    assert [made[key] for key in KEYS[3:7]] == [None] * 4
    assert made["soc"] == 0.76543 and made["reason"] == "load unknown"
    made = line(replace(ESTIMATE, status=Status.REFUSED, reason="no voltage"), REMAINING)
    assert [made[key] for key in KEYS[1:7]] == [None] * 6
    assert made["voltage_V"] == 15.6124


def test_both_formats_say_the_same(tmp_path: Path) -> None:
    lines = [line(ESTIMATE, REMAINING), line(replace(ESTIMATE, warnings=(), soc=np.float64(0.5)), REMAINING)]
    with json_lines(tmp_path / "a.jsonl") as a, csv_table(tmp_path / "a.csv") as b:
        for one in lines:
            a.write(one)
            b.write(one)
    back = [json.loads(text) for text in (tmp_path / "a.jsonl").read_text().splitlines()]
    assert back == lines and [list(one) for one in back] == [KEYS] * 2
    with (tmp_path / "a.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == KEYS
    assert rows[0]["warnings"] == "no temperature sensor; certificate is for another pack, 3S"
    assert rows[0]["temp_C"] == "" and rows[0]["remaining_hi_s"] == "" and rows[1]["warnings"] == ""
    for row, one in zip(rows, lines, strict=True):
        for key in KEYS[:12]:
            assert (float(row[key]) if row[key] else None) == one[key]


Opener = Callable[[Path], AbstractContextManager[Sink]]


@pytest.mark.parametrize("opened", [json_lines, csv_table])
def test_nothing_half_written_stays(tmp_path: Path, opened: Opener) -> None:
    path = tmp_path / "out"
    path.write_text("old")
    with pytest.raises(RuntimeError), opened(path) as sink:
        sink.write(line(ESTIMATE, REMAINING))
        raise RuntimeError
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]
    with opened(path) as sink:
        assert path.read_text() == "old"  # not before the end
        sink.write(line(ESTIMATE, REMAINING))
    assert path.read_text() != "old" and list(tmp_path.iterdir()) == [path]


def test_dash_is_standard_output(capsys: pytest.CaptureFixture[str]) -> None:
    with json_lines("-") as sink:
        sink.write(line(ESTIMATE, REMAINING))
    assert json.loads(capsys.readouterr().out)["time_s"] == 12.346


@pytest.mark.parametrize("opened", [json_lines, csv_table])
def test_a_line_with_other_keys_is_noticed(tmp_path: Path, opened: Opener) -> None:
    short: Line = {"time_s": 1.0}
    with pytest.raises(KeyError, match="soc"), opened(tmp_path / "x") as sink:
        sink.write(short)


@given(st.lists(st.floats(), min_size=9, max_size=9), st.lists(st.floats(), min_size=4, max_size=4))
def test_any_floats_make_strict_json(state: list[float], forecast: list[float]) -> None:
    estimate = Estimate(*state, status=Status.OK)
    made = line(estimate, Remaining(state[0], *forecast, status=Status.OK))
    assert json.loads(json.dumps(made, allow_nan=False)) == made
