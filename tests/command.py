"""`uavbatt` as a user calls it: as a process of its own, or within this one where starting Python anew is the cost."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from unittest.mock import patch

if TYPE_CHECKING:
    from uavbatt.validation.validate import Validation

UAVBATT = Path(sys.executable).parent / "uavbatt"
SURROUNDINGS = {"OMP_NUM_THREADS": "1", "COLUMNS": "200"}

Done = subprocess.CompletedProcess[str]


@dataclass(frozen=True)
class Judged:
    """What `uavbatt validate` on the study said, left in its folder, and found."""

    folder: Path
    stdout: str
    found: Validation
    shares: tuple[float, ...]  # of the work, as `validate` told them


def run(*call: str | Path, folder: Path, timeout_s: float = 300.0) -> Done:
    """The installed command in a process of its own, in `folder`."""
    words = [str(UAVBATT), *map(str, call)]
    surroundings = {**os.environ, **SURROUNDINGS}
    return subprocess.run(words, capture_output=True, text=True, cwd=folder, env=surroundings, timeout=timeout_s)


def refused_live(*call: str | Path, folder: Path) -> Done:
    """`uavbatt live` in this process, of a call that ends before anything is heard: what it would exec goes on here."""
    from uavbatt.cli import live_process
    from uavbatt.live.daemon import Daemon

    def go_on(*_: object) -> None:
        sys.exit(live_process.main())

    flies = AssertionError("expected a call that is refused, it waits for telemetry")
    with patch.object(os, "execv", go_on), patch.object(Daemon, "run", side_effect=flies):
        return called("live", *call, folder=folder)


def called(*call: str | Path, folder: Path) -> Done:
    """The same entry point in this process: what it leaves on both streams, and its exit code. A bug is raised."""
    from uavbatt.cli import main

    words, out, err = ["uavbatt", *map(str, call)], io.StringIO(), io.StringIO()
    with (
        chdir(folder), patch.dict(os.environ, SURROUNDINGS), patch.object(sys, "argv", words),
        redirect_stdout(out), redirect_stderr(err),
    ):  # fmt: skip
        try:
            main()
            code = 0
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 0
    return subprocess.CompletedProcess(words, code, out.getvalue(), err.getvalue())
