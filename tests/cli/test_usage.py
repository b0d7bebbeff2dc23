"""A call that is written wrongly: one line that names the command and its help, exit code 2; other ends as ever."""

from __future__ import annotations

from pathlib import Path

import pytest
import typer
from command import called, run

from uavbatt.cli import usage

WRONG: dict[str, tuple[tuple[str, ...], str, str]] = {
    "an argument is missing": (("replay",), "uavbatt replay", "LOG"),
    "no such command": (("no-such-command",), "uavbatt", "no-such-command"),
    "no such option": (("replay", "f", "--no-such-option"), "uavbatt replay", "--no-such-option"),
    "no such option of the whole": (("--no-such-option",), "uavbatt", "--no-such-option"),
    "an option without its value": (("replay", "f", "--cells"), "uavbatt replay", "--cells"),
    "words for a number": (("replay", "f", "--cells", "many"), "uavbatt replay", "--cells"),
    "too many cells": (("live", "udpin:127.0.0.1:1", "--cells", "999"), "uavbatt live", "--cells"),
    "another choice": (("validate", "--method", "none"), "uavbatt validate", "--method"),
    "a break in the line": (("replay", "f", "--cells", "a\nb\x1b[2J"), "uavbatt replay", "--cells"),
}


@pytest.mark.parametrize("case", WRONG)
def test_it_is_one_line_that_names_the_command_and_its_help(case: str, tmp_path: Path) -> None:
    call, command, what = WRONG[case]
    done = called(*call, folder=tmp_path)
    said = done.stderr
    assert (done.returncode, done.stdout, said.count("\n")) == (2, "", 1), said
    assert said.startswith(f"{command}: ") and said.endswith(f" (see '{command} --help')\n")
    assert what in said and "\x1b" not in said


@pytest.mark.parametrize("number", ["nan", "-nan", "inf", "61", "warm"])
def test_a_number_out_of_its_range_is_told_the_range(number: str, tmp_path: Path) -> None:
    done = called("plan", f"--ambient-c={number}", folder=tmp_path)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert f"'--ambient-c': expected a number from -40 to 60, found {number} (see" in done.stderr


def test_a_number_without_an_upper_end_is_told_its_lower_one(tmp_path: Path) -> None:
    done = called("simulate", "-o", "f.csv", "--power-w", "nan", folder=tmp_path)
    assert done.returncode == 2 and "'--power-w': expected a number of at least 1, found nan" in done.stderr


@pytest.mark.parametrize(
    ("option", "said"),
    [
        (("--capacity-ah", "5Ah"), "'--capacity-ah': expected a number, found 5Ah (see"),
        (("--cells=4S",), "'--cells': expected a whole number, found 4S (see"),
        (("--system", "300"), "'--system': expected a number less than or equal to 255, found 300 (see"),
    ],
)
def test_a_value_that_is_no_such_number_is_told(option: tuple[str, ...], said: str, tmp_path: Path) -> None:
    done = called("replay", "f.csv", *option, folder=tmp_path)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and said in done.stderr


def test_without_words_the_help_is_shown(tmp_path: Path) -> None:
    done = called(folder=tmp_path)
    assert done.returncode == 2 and done.stderr == "" and "replay" in done.stdout and "diagnose" in done.stdout


@pytest.mark.parametrize("call", [("--version",), ("-h",), ("replay", "--help")])
def test_what_was_asked_for_is_no_error(call: tuple[str, ...], tmp_path: Path) -> None:
    done = called(*call, folder=tmp_path)
    assert done.returncode == 0 and done.stderr == "" and "uavbatt" in done.stdout


def test_the_shell_completes_a_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"_UAVBATT_COMPLETE": "complete_bash", "COMP_WORDS": "uavbatt repl", "COMP_CWORD": "1"}.items():
        monkeypatch.setenv(name, value)
    done = run(folder=tmp_path)
    assert done.returncode == 0 and done.stdout.split() == ["replay"]


def ending(error: BaseException) -> typer.Typer:
    """A program with two commands, one of which ends by this error."""
    app = typer.Typer()

    @app.command("end")
    def end() -> None:
        raise error

    app.command("other")(lambda: None)
    return app


@pytest.mark.parametrize(
    ("error", "code"), [(typer.Exit(4), 4), (typer.Exit(), 0), (typer.Abort(), 1), (KeyboardInterrupt(), 130)], ids=repr
)
def test_other_ends_keep_their_exit_codes(error: BaseException, code: int) -> None:
    assert usage.run(ending(error), ["end"]) == code
