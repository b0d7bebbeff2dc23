"""A run of the commands, where an error in how they are called is one line instead of Typer's box."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import typer

from uavbatt.errors import terminal_line

_OPTION = re.compile(r"'(-[^']*)'")
# What the parser says of a value -> what was expected.
_EXPECTED = {
    "Input should be a valid number": "a number",
    "Input should be a valid integer": "a whole number",
    "Input should be": "a number",
}
# Typer has no public name for its usage error, and its home differs by version; `BadParameter` is public and is one.
_USAGE_ERROR: Any = typer.BadParameter.__bases__[0]
_USAGE, _ABORTED, _INTERRUPTED = 2, 1, 130


def run(app: typer.Typer, words: list[str]) -> int:
    """Run the command of a command line; return the exit code.

    Without words the help is shown; a log without a command is replayed.
    """
    commands = {command.name for command in app.registered_commands}
    if words and words[0] not in commands and Path(words[0]).is_file():
        words = ["replay", *words]
    try:
        code = app(words or ["--help"], standalone_mode=False)
    except _USAGE_ERROR as error:
        command = f"uavbatt {words[0]}" if words[0] in commands else "uavbatt"
        said = _with_value(error.format_message().rstrip("."), words)
        if words[0] not in commands and Path(words[0]).suffix and not words[0].startswith("-"):
            said = f"{words[0]}: expected a command or a flight log, found neither"
        print(terminal_line(f"{command}: {said} (see '{command} --help')"), file=sys.stderr)
        return _USAGE
    except typer.Abort as error:
        if isinstance(error.__cause__, KeyboardInterrupt):  # older versions of Typer make Ctrl-C an Abort
            return _INTERRUPTED
        print("uavbatt: aborted", file=sys.stderr)
        return _ABORTED
    return code or 0 if words else _USAGE


def _with_value(said: str, words: list[str]) -> str:
    """Return the parser's message about a value that is no number of the asked kind, with the value in it."""
    start = said.find("Input should be")
    option = _OPTION.search(said)
    if start < 0 or option is None:
        return said
    expected = next(plain for words_of_parser, plain in _EXPECTED.items() if said.startswith(words_of_parser, start))
    if "valid" not in said[start:]:
        expected += said[start:].removeprefix("Input should be")
    return f"{said[:start]}expected {expected}, found {_value_of(option[1], words)}"


def _value_of(option: str, words: list[str]) -> str:
    """Return the value of the last use of an option in a command line."""
    for place, word in reversed(list(enumerate(words))):
        if word.startswith(f"{option}="):
            return word.partition("=")[2]
        if word == option:
            return words[place + 1]
    return "another value"
