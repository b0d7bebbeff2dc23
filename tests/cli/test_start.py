"""A command starts quickly: it loads no library that it does not use."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

LOGS = Path(__file__).resolve().parents[2] / "logs"
HEAVY = ("numpy", "scipy", "matplotlib", "pymavlink", "filterpy", "numba", "dask")


@pytest.mark.parametrize(
    ("arguments", "used"),
    [
        (["--version"], set()),
        (["--help"], set()),
        (["replay", "--help"], set()),
        (["replay", str(LOGS / "quad_4s.tlog")], {"numpy"}),
        (["info", str(LOGS / "quad_3s.BIN")], {"numpy"}),
        (["plan", "--cells", "4", "--capacity-ah", "5", "--power-w", "250"], {"numpy"}),
    ],
)
def test_a_command_loads_only_what_it_uses(arguments: list[str], used: set[str]) -> None:
    code = (
        "import atexit, sys\n"
        f"atexit.register(lambda: print(*(name for name in {HEAVY} if name in sys.modules), file=sys.stderr))\n"
        "from uavbatt.cli import main\n"
        "main()\n"
    )
    done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=True)
    assert set(done.stderr.split()) == used


def test_the_module_is_the_command_and_names_itself_in_a_usage() -> None:
    """A machine whose scripts are not on the path has only the module; it said "cannot be directly executed"."""
    start = [sys.executable, "-m", "uavbatt"]
    assert subprocess.run([*start, "--version"], capture_output=True, text=True, check=True).stdout.startswith(
        "uavbatt "
    )
    wrong = subprocess.run([*start, "replay", "nofile"], capture_output=True, text=True, check=False)
    assert (wrong.returncode, wrong.stderr.startswith("uavbatt: nofile: ")) == (1, True)
