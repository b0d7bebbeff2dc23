"""F16: no control byte of a file name, a cell, a log or a battery file reaches the terminal."""

from __future__ import annotations

from pathlib import Path

import pytest
import tomli_w
from command import Done, called, run

from uavbatt.battery import battery_file
from uavbatt.errors import terminal_line
from uavbatt.estimation.filter import known_only_to

ROOT = Path(__file__).parents[2]
HOSTILE = "\x1b[2J\x1b]0;owned\x07\x9b31m\u202e\n"
HEAD = "time_s,voltage_V,current_A\n"
ROWS = "".join(f"{t},{16.0 - 0.01 * t:.2f},12\n" for t in range(300))


def assert_clean(done: Done) -> None:
    for text in (done.stdout, done.stderr):
        assert not [c for c in text if c != "\n" and terminal_line(c) != c], text


def test_control_characters_of_a_cell_do_not_reach_the_terminal(tmp_path: Path) -> None:
    (tmp_path / "f.csv").write_text(HEAD + ROWS + "300,15.7,\x1b[31mmany\x07\n")
    done = called("info", "f.csv", folder=tmp_path)
    assert done.returncode == 1 and "found `" in done.stderr
    assert_clean(done)


def test_control_characters_of_a_column_do_not_reach_the_terminal(tmp_path: Path) -> None:
    (tmp_path / "f.csv").write_text(HEAD.strip() + ",\x1b[31mred\x1b[0m\n" + ROWS.replace(",12\n", ",12,1\n"))
    for command in ("info", "replay"):
        done = called(command, "f.csv", *(["--capacity-ah", "5"] if command == "replay" else []), folder=tmp_path)
        assert done.returncode == 0 and "is not known, ignored" in done.stdout
        assert_clean(done)


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("content", [HEAD + ROWS, "junk"])
def test_of_a_file_name(content: str, tmp_path: Path) -> None:
    name = f"a{HOSTILE}\udcff.csv"
    try:
        (tmp_path / name).write_text(content)
    except OSError:
        pytest.skip("this file system takes no such name")
    info, fly = ("info", name), ("replay", name, "--capacity-ah", "5")
    told = [called(*call, folder=tmp_path) for call in (info, fly, (*fly, "--json", "-"), (*fly, "--report", "p.html"))]
    told.append(run(*(fly if content == "junk" else info), folder=tmp_path))  # on streams of its own
    for done in told:
        said = done.stderr + done.stdout
        assert "Traceback" not in said and (said.count("\ufffd") > 5 or "\\u001b" in said)
        assert_clean(done)


def test_of_a_battery_file(tmp_path: Path) -> None:
    content = battery_file.read_battery("lpab-3s")
    import msgspec

    hostile = msgspec.structs.replace(content, battery=msgspec.structs.replace(content.battery, name=f"x{HOSTILE}"))
    path = battery_file.write_battery(hostile, tmp_path / "b.battery.toml")
    done = called("plan", "--battery", path, "--power-w", "200", "--capacity-ah", "5", folder=tmp_path)
    assert done.returncode == 0 and "x\ufffd[2J" in done.stdout
    assert_clean(done)
    path.write_text(tomli_w.dumps({"battery": {HOSTILE: 1}}))
    done = called("plan", "--battery", path, "--power-w", "200", folder=tmp_path)
    assert done.returncode == 1
    assert_clean(done)


def test_control_characters_of_a_fleet_do_not_reach_the_terminal(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="the extra `fleet` is not installed")
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs/a.csv").write_text(HEAD + "0,\x1b[31mred,1\n")
    done = called("fleet", "logs", "-o", f"out{HOSTILE}", "--workers", "1", folder=tmp_path)
    assert done.returncode == 1
    assert_clean(done)


def test_an_uncertainty_beyond_the_charge_is_said_in_words() -> None:
    assert known_only_to(0.08) == "still settling: charge known to ±8%"
    assert known_only_to(7.0e19) == known_only_to(1.0) == "state of charge not known at all"


LATIN = "r\udce9c"  # as a terminal or a service in another encoding gives it


@pytest.mark.parametrize(
    "call",
    [
        ("live", "udpin:127.0.0.1:1", "--record", LATIN),
        ("live", "udpin:127.0.0.1:1", "--pack", LATIN, "--packs", "p.sqlite"),
        ("live", f"/dev/{LATIN}"),
        ("replay", "f.csv", "--capacity-ah", "5", "--packs", "p.sqlite", "--pack", LATIN),
    ],
)
def test_an_argument_in_another_encoding_is_one_line(call: tuple[str, ...], tmp_path: Path) -> None:
    (tmp_path / "f.csv").write_text(HEAD + ROWS)
    done = called(*call, folder=tmp_path)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert "r\ufffdc: expected text in UTF-8" in done.stderr


def test_a_log_whose_name_is_no_text_teaches_the_ledger(tmp_path: Path) -> None:
    log = f"{LATIN}.csv"
    flight = "".join(f"{t},{16.6 - 0.002 * t:.3f},{0.1 if t < 10 else 20}\n" for t in range(400))
    (tmp_path / log).write_text(HEAD + flight)
    done = called("replay", log, "--capacity-ah", "5", "--packs", "p.sqlite", "--pack", "A", folder=tmp_path)
    assert done.returncode == 0 and "1 flight remembered" in done.stdout
    assert "r\ufffdc.csv" in called("packs", "p.sqlite", "--pack", "A", folder=tmp_path).stdout
