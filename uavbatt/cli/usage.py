"""A run of the commands, where an error in how they are called is one line instead of Typer's box."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import typer

from uavbatt.errors import terminal_line

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
        said = error.format_message().rstrip(".")
        print(terminal_line(f"{command}: {said} (see '{command} --help')"), file=sys.stderr)
        return _USAGE
    except typer.Abort as error:
        if isinstance(error.__cause__, KeyboardInterrupt):  # older versions of Typer make Ctrl-C an Abort
            return _INTERRUPTED
        print("uavbatt: aborted", file=sys.stderr)
        return _ABORTED
    return code or 0 if words else _USAGE
