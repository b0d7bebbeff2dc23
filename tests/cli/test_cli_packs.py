"""`uavbatt packs`, and `--packs` of the commands that fly logs."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import time
from functools import partial

import pytest
from command import UAVBATT, called
from packs.made import flight

from uavbatt.packs.ledger import Ledger


@pytest.fixture
def run(tmp_path):
    """The command, called in the test's own folder."""
    return partial(called, folder=tmp_path)


@pytest.fixture
def ledger(tmp_path):
    path = tmp_path / "packs.sqlite"
    with Ledger(path) as opened:
        opened.save_all("A", [flight(k, 1.03**k, 0.98**k) for k in range(8)])
        opened.save_all("B", [flight(k) for k in range(4)])
    return path


def test_one_line_a_pack_with_its_outlook(run, ledger):
    said = run("packs", ledger)
    assert said.returncode == 0
    first, second = said.stdout.splitlines()
    assert first.startswith("A ")
    assert "retire in about" in first
    assert second.startswith("B ")
    assert "stays above 80%" in second


def test_json_and_page(run, ledger, tmp_path):
    said = run("packs", ledger, "--json", tmp_path / "p.json", "--report", tmp_path / "p.html")
    assert said.returncode == 0, said.stderr
    packs = json.loads((tmp_path / "p.json").read_text("utf-8"))
    assert [pack["name"] for pack in packs] == ["A", "B"]
    assert packs[0]["retire_lo_flights"] <= packs[0]["retire_flights"]
    assert packs[1]["retire_hi_flights"] is None  # beyond sight
    page = (tmp_path / "p.html").read_text("utf-8")
    assert "<script" not in page
    assert "retire in about" in page


def test_forget_export_and_import(run, ledger, tmp_path):
    assert run("packs", ledger, "--pack", "A", "--export", tmp_path / "A.json").returncode == 0
    assert run("packs", ledger, "--forget", "A").stdout.startswith("B ")
    again = run("packs", ledger, "--import", tmp_path / "A.json")
    assert [line.split()[0] for line in again.stdout.splitlines()] == ["A", "B"]


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["packs", "none.sqlite"], 1, "none.sqlite: expected a pack ledger, found no such file"),
        (["packs", "{ledger}", "--pack", "C"], 1, "expected a pack named C, found A, B"),
        (["packs", "{ledger}", "--forget", "C"], 1, "expected a pack named C to forget"),
        (["packs", "empty.sqlite"], 1, "empty.sqlite: expected a pack ledger, found an empty file"),
        (["packs", "."], 1, ".: expected a pack ledger, found a directory"),
        (["packs", "none.sqlite", "--forget", "A"], 1, "none.sqlite: expected a pack ledger, found no such file"),
        (["packs", "none.sqlite", "--import", "bad.json"], 1, "bad.json: expected a pack as"),
        (["packs", "{ledger}", "--export", "x.json"], 2, "expected --pack NAME as well"),
        (["replay", "x.tlog", "--pack", "A"], 2, "expected --packs FILE as well"),
        (
            ["plan", "--battery", "lpab-3s", "--power-w", "100", "--capacity-ah", "5", "--packs", "{ledger}"],
            2,
            "--pack",
        ),
    ],
)
def test_wrong_input_is_named_in_one_line(run, ledger, arguments, code, words):
    (ledger.parent / "empty.sqlite").touch()
    (ledger.parent / "bad.json").write_text("{}")
    said = run(*(argument.replace("{ledger}", str(ledger)) for argument in arguments))
    assert said.returncode == code
    assert not (ledger.parent / "none.sqlite").exists()  # a change that fails makes no ledger
    assert words in said.stderr
    assert "Traceback" not in said.stderr


def test_a_plan_takes_the_size_of_the_pack_from_its_flights(run, ledger):
    call = ("plan", "--power-w", "150", "--packs", ledger, "--pack", "B")
    known, size, *_ = run(*call).stdout.splitlines()
    assert known.startswith("pack B: ") and known.endswith("4 flights remembered")
    assert "4S from pack B in the ledger, 5 Ah from pack B in the ledger" in size
    _, size, *_ = run(*call, "--capacity-ah", "5.2", "--cells", "4").stdout.splitlines()
    assert "4S from --cells, 5.2 Ah from --capacity-ah" in size
    other = run(*call, "--cells", "3")
    assert (other.returncode, other.stdout) == (2, "")
    assert other.stderr == "uavbatt: --cells 3: pack B has 4 by the ledger\n"


def test_a_ledger_in_a_folder_that_nobody_may_write_is_read(ledger):
    """On a card that is write-protected, or in the folder of another user."""
    plain = [] if os.geteuid() else ["setpriv", "--bounding-set=-dac_override,-dac_read_search"]  # root writes anywhere
    if plain and shutil.which(plain[0]) is None:
        pytest.skip("root without setpriv")
    ledger.parent.chmod(0o555)
    try:
        said = [
            subprocess.run([*plain, UAVBATT, "packs", ledger, *more], capture_output=True, text=True)
            for more in ((), ("--forget", "A"))
        ]
    finally:
        ledger.parent.chmod(0o755)
    assert [done.returncode for done in said] == [0, 1]
    assert said[0].stdout.startswith("A ") and "readonly" in said[1].stderr and said[1].stderr.count("\n") == 1


def test_replay_remembers_a_flight_once(run, tmp_path):
    log, packs = tmp_path / "a.csv", tmp_path / "packs.sqlite"
    battery = ["--battery", "lpab-3s", "--cells", "3", "--capacity-ah", "5"]
    assert run("simulate", "-o", log, *battery, "--power-w", "400", "--rate-hz", "1").returncode == 0
    for _ in range(2):
        said = run("replay", log, *battery, "--packs", packs, "--pack", "left", "--json", tmp_path / "s.json")
        assert said.returncode == 0, said.stderr
        assert "1 flight remembered" in said.stdout
    assert json.loads((tmp_path / "s.json").read_text("utf-8"))["pack_flights"] == 1
    nameless = run("replay", log, *battery, "--packs", packs)
    assert "not remembered: no serial in the log" in nameless.stdout


def test_a_replay_takes_the_capacity_of_a_known_pack_from_the_ledger(run, ledger, tmp_path):
    """Where nobody else states one: a pack that the ledger does not know is still refused."""
    log = tmp_path / "a.csv"  # a CSV file states no capacity
    assert run("simulate", "-o", log, "--power-w", "600", "--rate-hz", "1").returncode == 0
    call = ("replay", log, "--packs", ledger, "--cells", "4")
    known = run(*call, "--pack", "B").stdout
    assert "5 Ah from pack B in the ledger" in known and "5 flights remembered" in known
    assert "5.2 Ah from --capacity-ah" in run(*call, "--pack", "B", "--capacity-ah", "5.2").stdout
    unknown = run(*call, "--pack", "C")
    assert unknown.returncode == 2 and "give --capacity-ah" in unknown.stderr
    assert "give --capacity-ah" in run(*call).stderr  # no name, no serial


def test_a_flight_dated_in_the_future_is_said(run, tmp_path):
    path = tmp_path / "packs.sqlite"
    with Ledger(path) as opened:
        opened.save_all("A", [flight(0), flight(1, start_utc_s=time.time() + 9e6)])
    said = run("packs", path, "--pack", "A").stdout.splitlines()
    assert "its last flight is dated" in said[1] and "in the future" in said[1]
    assert ["in the future" in line for line in said[2:]] == [False, True]
