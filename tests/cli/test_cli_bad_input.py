"""Bad input through the real command: one line on stderr, the right exit code, nothing left behind.

The many slips are made within this process; `test_bad_input_is_refused_by_the_process_as_well` shows for some that a
process says the same.
"""

from __future__ import annotations

import os
import random
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from command import UAVBATT, Done, called, run

from uavbatt.battery import battery_file

ROOT = Path(__file__).parents[2]
TLOG, BIN = ROOT / "logs/quad_4s.tlog", ROOT / "logs/quad_3s.BIN"
Call = tuple[str | Path, ...]
Ask = Callable[..., Done]
HEAD = "time_s,voltage_V,current_A\n"
ROWS = "".join(f"{t},{16.0 - 0.01 * t:.2f},12\n" for t in range(30))


def files(folder: Path) -> set[str]:
    return {str(p.relative_to(folder)) for p in folder.rglob("*")}


def assert_refused(folder: Path, call: Call, code: int, words: tuple[str, ...], ask: Ask = called) -> None:
    """One line that holds the words, exit code, no traceback, nothing on stdout and no file more than before."""
    before = files(folder)
    done = ask(*call, folder=folder)
    said = done.stderr.strip()
    assert done.returncode == code, (done.returncode, said)
    assert said.startswith("uavbatt: ") and "\n" not in said and "Traceback" not in said
    assert all(word in said for word in words), said
    assert done.stdout == ""
    assert files(folder) == before


def replay(log: Path, *more: str | Path) -> Call:
    outputs = ("--jsonl", "out/a.jsonl", "--csv", "out/a.csv", "--json", "out/a.json", "--report", "out/a.html")
    return ("replay", log, "--capacity-ah", "5", *outputs, *more)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "out").mkdir()
    return tmp_path


BYTES: dict[str, tuple[str, bytes, tuple[str, ...]]] = {
    "empty": ("f.tlog", b"", ("empty file",)),
    "png": ("f.tlog", b"\x89PNG\r\n\x1a\n" + random.Random(1).randbytes(5000), ("another kind",)),
    "png named BIN": ("f.BIN", b"\x89PNG\r\n\x1a\n" + random.Random(2).randbytes(5000), ("another kind",)),
    "Unicode text of a spreadsheet": ("f.csv", "time_s,voltage_V\n0,16.8\n".encode("utf-16"), ("UTF-16", "UTF-8")),
    "letter": ("f.csv.txt", b"Dear all,\nthis is a letter.\n", ("another kind",)),
    "zeros": ("f.BIN", bytes(5000), ("another kind",)),
    "only the head of a tlog": ("f.tlog", TLOG.read_bytes()[:50], ("expected",)),
    "only the head of a BIN": ("f.BIN", BIN.read_bytes()[:400], ("battery messages", "found none")),
    "missing column": ("f.csv", b"time_s,current_A\n0,1\n1,1\n", ("header", "voltage_V")),
    "misspelt column": ("f.csv", b"time_s,voltge_V,current_A\n0,16,1\n", ("`voltge_V`", "`voltage_V`")),
    "misspelt current": ("f.csv", b"time_s,voltage_V,curent_A\n0,16,1\n", ("`curent_A`", "`current_A`")),
    "nan": ("f.csv", (HEAD + ROWS + "30,nan,12\n").encode(), ("row 31 (line 32)", "voltage_V", "a number")),
    "text": ("f.csv", (HEAD + ROWS + "30,15.7,many\n").encode(), ("row 31 (line 32)", "current_A", "`many`")),
    "backwards": ("f.csv", (HEAD + ROWS + "7,15.7,12\n").encode(), ("row 31 (line 32)", "time_s", "found 7")),
    "no time": ("f.csv", (HEAD + ROWS + "1e300,15.7,12\n").encode(), ("row 31 (line 32)", "time_s", "found 1e+300")),
    "header alone": ("f.csv", HEAD.encode(), ("battery messages",)),
    "semicolons": ("f.csv", b"time_s;voltage_V\n0;16\n", ("semicolons",)),
}


# the words that follow `replay LOG ...`, and whole calls of other commands: exit code, words of the line
SLIPS: list[tuple[tuple[str, ...], int, tuple[str, ...]]] = [
    (("--load", "nonsense"), 2, ("--load nonsense", "recent", "watts")),
    (("--load", "-5"), 2, ("--load -5", "positive")),
    (("--battery", "lipo-genric"), 1, ("lipo-genric", "lipo-generic")),
    (("--battery", "no/such.battery.toml"), 1, ("no/such.battery.toml", "found no file")),
    (("--instance", "7"), 2, ("no battery instance 7", "0")),
    (("--cutoff-voltage", "-3"), 2, ("--cutoff-voltage", "positive")),
    (("--capacity-ah", "nan"), 2, ("--capacity-ah", "positive")),
    (("--jsonl", "no/such/folder/f.jsonl"), 2, ("no/such/folder/f.jsonl", "existing folder")),
    (("--report", "out"), 2, ("out", "directory")),
    (("--csv", "out/a.jsonl"), 2, ("out/a.jsonl", "a name of its own")),
    (("--jsonl", "-", "--csv", "-"), 2, ("-", "a name of its own")),
    (("--csv", str(TLOG)), 2, (TLOG.name, "is read and would be lost")),
    (("--vehicle", "out/v.toml", "--report", "out/../out/v.toml"), 2, ("out/v.toml", "is read and would be lost")),
]
OTHERS: list[tuple[Call, int, tuple[str, ...]]] = [
    (("simulate", "-o", "out/f.txt"), 2, ("out/f.txt", ".tlog")),
    (("simulate", "-o", "nowhere/f.tlog"), 2, ("nowhere/f.tlog", "existing folder")),
    (("simulate", "-o", "out/f.csv", "--effect", "gremlins=1"), 2, ("gremlins", "one of")),
    (("simulate", "-o", "out/f.csv", "--effect", "weak_cell=9"), 2, ("weak_cell", "deficit")),
    (("simulate", "-o", "out/f.csv", "--effect", "weak_cell"), 2, ("weak_cell", "NAME=VALUE")),
    (("diagnose", TLOG, "--battery", "lipo-generic", "--json", TLOG), 2, (TLOG.name, "would be lost")),
    (("fit", TLOG, "--vehicle", TLOG), 2, (TLOG.name, "would be lost")),
    (("fit", TLOG, "-o", "-"), 2, ("-: ", "a file name")),
    (("diagnose", TLOG, "--battery", "lipo-generic", "-o", "-"), 2, ("-: ", "a file name")),
    (("plan", "--like", TLOG, "--report", TLOG), 2, (TLOG.name, "ends in .html")),
    (("live", "udpin:127.0.0.1:1", "--record", TLOG), 2, ("--record", TLOG.name, "a folder")),
    (("live", "udpin:127.0.0.1:1", "--state", "out"), 2, ("--state out", "a file")),
    (("validate", "nowhere"), 1, ("nowhere", "expected")),
    (("validate", "out"), 1, ("out", "battery.toml")),
    (("validate", "--report", "no/such/f.html"), 2, ("no/such/f.html", "existing folder")),
    (("validate", "--method", "paper", "--ship", "out"), 2, ("--method",)),
]
CASES: dict[str, tuple[Call, int, tuple[str, ...]]] = {
    **{case: (replay(Path(name)), 1, (name, "expected", *words)) for case, (name, _, words) in BYTES.items()},
    **{" ".join(more): (replay(TLOG, *more), code, words) for more, code, words in SLIPS},
    **{" ".join(map(str, call)): (call, code, words) for call, code, words in OTHERS},
}


def made(case: str, folder: Path) -> tuple[Call, int, tuple[str, ...]]:
    """The case, its bad file written."""
    if case in BYTES:
        name, data, _ = BYTES[case]
        (folder / name).write_bytes(data)
    return CASES[case]


@pytest.mark.parametrize("case", CASES)
def test_bad_input_is_named_in_one_line(case: str, folder: Path) -> None:
    assert_refused(folder, *made(case, folder))


@pytest.mark.parametrize("case", ["png", "nan", "--load nonsense", "simulate -o out/f.txt", "validate out"])
def test_bad_input_is_refused_by_the_process_as_well(case: str, folder: Path) -> None:
    assert_refused(folder, *made(case, folder), ask=run)


@pytest.mark.parametrize("command", ["replay", "info"])
def test_a_missing_log_and_a_directory_without_logs_are_refused(command: str, folder: Path) -> None:
    call = replay if command == "replay" else lambda log: ("info", log)
    assert_refused(folder, call(Path("nowhere.tlog")), 1, ("nowhere.tlog", "expected", "no such file"))
    (folder / "empty").mkdir()
    code, words = (2, "found none in it") if command == "replay" else (1, "a directory")
    assert_refused(folder, call(Path("empty")), code, ("empty", "expected", words))


def test_a_log_without_battery_messages(folder: Path) -> None:
    """A whole tlog with its battery messages taken out."""
    from pymavlink.dialects.v20 import ardupilotmega as mavlink

    link = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    frames = []
    for k in range(50):
        beat = link.heartbeat_encode(2, 3, 0, 0, 4)
        frames.append((1_700_000_000_000_000 + k * 1_000_000).to_bytes(8, "big") + beat.pack(link))
    (folder / "f.tlog").write_bytes(b"".join(frames))
    assert_refused(folder, replay(Path("f.tlog")), 1, ("f.tlog", "battery messages", "found none"))


def test_a_truncated_log_is_replayed_as_far_as_it_goes(folder: Path) -> None:
    for log in (TLOG, BIN):
        cut = folder / f"cut{log.suffix}"
        cut.write_bytes(log.read_bytes()[: log.stat().st_size // 9 + 11])
        done = called("replay", cut.name, "--jsonl", f"out/{cut.name}.jsonl", folder=folder)
        assert done.returncode == 0 and "does not reach the end of flight" in done.stdout, done.stderr
        assert len((folder / f"out/{cut.name}.jsonl").read_text().splitlines()) > 200


def edited(folder: Path, old: str, new: str) -> Path:
    text = battery_file._text("lpab-3s")[0].decode()
    assert text.count(old) >= 1
    path = folder / f"edited{battery_file.SUFFIX}"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    return path.relative_to(folder)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("\ndiffusion_ratio = 0.", "\ndiffusion_ratio = 1.", ("content_sha256", "was edited", "--allow-uncertified")),
        ('verdict = "pass"', 'verdict = "fail"', ("content_sha256", "--allow-uncertified")),
        ("[discrepancy]", "[discrepency]", ("discrepency", "a battery file")),
        ("cells_series = 3", 'cells_series = "three"', ("cells_series", "a battery file")),
        ('name = "polarisation"', 'name = "gremlins"', ("gremlins", "one of")),
    ],
)
def test_edited_battery_files(old: str, new: str, words: tuple[str, ...], folder: Path) -> None:
    battery = edited(folder, old, new)
    assert_refused(folder, replay(TLOG, "--battery", battery), 1, (str(battery), *words))


def test_a_battery_file_whose_verdict_is_fail(folder: Path) -> None:
    import tomllib

    import msgspec

    content = tomllib.loads(battery_file._text("lpab-3s")[0].decode())
    content["certificate"]["verdicts"][0]["verdict"] = "fail"
    battery_file.write_battery(msgspec.convert(content, battery_file.BatteryFile), folder / "failed.battery.toml")
    words = ("failed.battery.toml", content["certificate"]["verdicts"][0]["claim"], "it is fail")
    assert_refused(folder, replay(TLOG, "--battery", "failed.battery.toml"), 1, words)
    out = ("-o", "out/f.csv")
    assert_refused(folder, ("simulate", "--battery", "failed.battery.toml", *out), 1, words)


def test_a_capacity_that_nobody_states(folder: Path) -> None:
    (folder / "f.csv").write_text(HEAD + ROWS)
    call = ("replay", "f.csv", "--jsonl", "out/a.jsonl", "--report", "out/a.html")
    assert_refused(folder, call, 2, ("--capacity-ah",))


def test_several_logs(folder: Path) -> None:
    for name in ("a", "b"):
        (folder / name).mkdir()
        (folder / name / "f.csv").write_text(HEAD + ROWS)
    assert_refused(folder, ("replay", "a/f.csv", "a/../a/f.csv", "--jsonl", "out"), 2, ("named twice", "expected"))
    (folder / "taken").write_text("")
    (folder / "b/f.csv").rename(folder / "b/g.csv")
    both = ("replay", "a/f.csv", "b/g.csv", "--capacity-ah", "5")
    assert_refused(folder, (*both, "--csv", "taken"), 2, ("taken", "a folder"))


def test_several_logs_never_overwrite_one_of_themselves(folder: Path) -> None:
    for name in ("f", "g"):
        (folder / f"{name}.csv").write_text(HEAD + ROWS)
    both = ("replay", "f.csv", "g.csv", "--capacity-ah", "5")
    assert_refused(folder, (*both, "--csv", "."), 2, ("f.csv", "would be lost"))
    assert_refused(folder, (*both, "--jsonl", "-"), 2, ("-", "a folder"))
    assert (folder / "f.csv").read_text() == HEAD + ROWS


def test_a_pipe_or_a_device_is_not_replaced_by_a_file(folder: Path) -> None:
    os.mkfifo(folder / "out/pipe")
    assert_refused(folder, replay(TLOG, "--report", "out/pipe"), 2, ("out/pipe", "a device or pipe", "`-`"))
    assert (folder / "out/pipe").is_fifo()


def test_a_folder_that_may_not_be_written(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda *_: False)  # who runs the tests may be allowed everything
    assert_refused(folder, ("simulate", "-o", "out/f.csv"), 2, ("out/f.csv", "can be written"))


def test_a_disk_that_is_full(folder: Path) -> None:
    """A limit on the size of files stands for it: one line, and no half-written log."""
    command = f"ulimit -f 8; exec '{UAVBATT}' simulate -o out/f.csv"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, cwd=folder, timeout=300)
    assert done.returncode == 1 and done.stderr.count("\n") == 1 and "File too large" in done.stderr
    assert files(folder) == {"out"}


def test_an_output_that_was_there_is_kept_when_the_replay_fails(folder: Path) -> None:
    (folder / "f.csv").write_text(HEAD + ROWS + "30,nan,12\n")
    (folder / "out/a.jsonl").write_text("old\n")
    assert_refused(folder, replay(Path("f.csv")), 1, ("row 31 (line 32)",))
    assert (folder / "out/a.jsonl").read_text() == "old\n"
