"""`uavbatt simulate --mission`: a flight along a file's route, wrong inputs in one line, the mission beside its log."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command import called

from uavbatt.navigation import Mode
from uavbatt.telemetry import read_log

ROUTE = """QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t47.0\t8.0\t420\t1
1\t0\t3\t22\t0\t0\t0\t0\t0\t0\t20\t1
2\t0\t3\t16\t0\t0\t0\t0\t47.001\t8.0\t20\t1
"""


def test_a_flight_along_a_route_and_home(tmp_path: Path) -> None:
    (tmp_path / "route.waypoints").write_text(ROUTE)
    done = called("simulate", "-o", "f.tlog", "--mission", "route.waypoints", "--wind", "4@0", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    found = read_log(tmp_path / "f.tlog")
    modes = list(dict.fromkeys(n.mode for n in found.navigation))
    assert [m for m in modes if m is not Mode.UNKNOWN] == [Mode.HOLD, Mode.MISSION, Mode.RETURN]
    last = found.navigation[-1]
    assert last.landed is True
    assert last.wind is not None
    assert last.wind.north_ms == pytest.approx(-4.0)  # from the north


@pytest.mark.parametrize(
    ("arguments", "words", "code"),
    [
        (("--mission", "none.plan"), "No such file", 1),
        (("--mission", "route.waypoints", "--wind", "4"), "expected SPEED@FROM_DEG", 2),
        (("--mission", "route.waypoints", "--wind", "nan@0"), "expected SPEED@FROM_DEG", 2),
        (("--wind", "4@0"), "expected --mission FILE as well", 2),
        (("--mission", "endless.waypoints"), "waits somewhere without end", 2),
        (("--mission", "nowhere.waypoints"), "the place of home", 2),
    ],
)
def test_wrong_inputs(tmp_path: Path, arguments: tuple[str, ...], words: str, code: int) -> None:
    (tmp_path / "route.waypoints").write_text(ROUTE)
    (tmp_path / "endless.waypoints").write_text(ROUTE + "3\t0\t3\t17\t0\t0\t0\t0\t47.001\t8.0\t20\t1\n")
    (tmp_path / "nowhere.waypoints").write_text(ROUTE.replace("47.0\t8.0\t420", "0\t0\t0"))
    done = called("simulate", "-o", "f.tlog", *arguments, folder=tmp_path)
    assert (done.returncode, words in done.stderr) == (code, True), done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "f.tlog").exists()


def test_a_mission_beside_a_log_without_places_is_not_passed_over_in_silence(tmp_path: Path) -> None:
    (tmp_path / "route.waypoints").write_text(ROUTE)
    simulated = called("simulate", "-o", "f.csv", "--power-w", "700", "--rate-hz", "0.5", folder=tmp_path)
    assert simulated.returncode == 0, simulated.stderr
    call = ("replay", "f.csv", "--capacity-ah", "5", "--jsonl")
    alone = called(*call, "alone.jsonl", folder=tmp_path)
    planned = called(*call, "planned.jsonl", "--mission", "route.waypoints", folder=tmp_path)
    assert "  route " not in alone.stdout
    assert "  route      not used: the mode is unknown" in planned.stdout
    rows, same = (
        [json.loads(line) for line in (tmp_path / name).read_text(encoding="utf-8").splitlines()]
        for name in ("alone.jsonl", "planned.jsonl")
    )
    assert [row["remaining_s"] for row in same] == [row["remaining_s"] for row in rows]
