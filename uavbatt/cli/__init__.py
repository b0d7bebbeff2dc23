"""The command line: one command a file. Data on stdout or in the named file, everything else on stderr."""

from __future__ import annotations

import gc
import io
import os
import sys
from collections.abc import Collection
from pathlib import Path


def _completed(words: list[str], commands: Collection[str | None]) -> list[str]:
    """Return the words of the command line; a log without a command gets `replay` before it."""
    if words and words[0] not in commands and Path(words[0]).is_file():
        return ["replay", *words]
    return words


def main() -> None:
    """Run `uavbatt`; an error ends it with one line and the exit code of that error."""
    # The matrices are small: a second thread of the linear algebra only slows the first one down.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    gc.set_threshold(50_000)  # rows have no reference cycles, and the search for some took a seventh of a replay
    if isinstance(sys.stdout, io.TextIOWrapper):  # an ASCII stream gets escapes instead of other letters
        sys.stdout.reconfigure(errors="backslashreplace")
    from uavbatt.cli.app import app
    from uavbatt.errors import UavbattError, terminal_line

    try:
        app(_completed(sys.argv[1:], {command.name for command in app.registered_commands}))
    except UavbattError as error:
        print(terminal_line(f"uavbatt: {error}"), file=sys.stderr)
        sys.exit(error.exit_code)
    except BrokenPipeError:  # `uavbatt ... | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except OSError as error:  # a full disk, a file without permission to read
        what = f"uavbatt: {error.filename or 'input or output'}: {error.strerror or error}"
        print(terminal_line(what), file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt:
        print("uavbatt: interrupted", file=sys.stderr)
        sys.exit(130)
