"""Compiled code is kept in a folder of its sources' state: another one for all that it can feel, and for that alone."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

import uavbatt
from uavbatt.compiled.sources import digest

PACKAGE = Path(uavbatt.__file__).parent
NOT_COMPILED = shutil.ignore_patterns("__pycache__", "data", "report", "validation", "cli", "telemetry", "live")
FELT = {  # what compiled code is made of: file, what stands there, what stands there instead
    "an equation": ("battery/equations.py", "return soc - c_rate *", "return soc + c_rate *"),
    "a step of the model": ("battery/model.py", "drop_V = c_rate * r_ohmAh", "drop_V = 2.0 * c_rate * r_ohmAh"),
    "a constant of the model": ("battery/model.py", "TURN_CHARGE = 0.03", "TURN_CHARGE = 0.04"),
    "a default of a record": ("battery/pack.py", "gain_I: Number = 1.0", "gain_I: Number = 1.1"),
    "the order of a record's fields": (
        "battery/pack.py",
        "    gain_I: Number = 1.0\n    offset_A: Number = 0.0\n",
        "    offset_A: Number = 0.0\n    gain_I: Number = 1.0\n",
    ),
    "a noise": ("estimation/noise.py", "RESISTANCE_WALK_PER_S = ", "RESISTANCE_WALK_PER_S = 2.0 * "),
    "a constant of another module": ("estimation/block.py", "BLOCK_S = ", "BLOCK_S = 2.0 * "),
    "one behind an import within the room": ("estimation/kalman.py", "NUDGE = ", "NUDGE = 2.0 * "),
    "one of the forecast": ("prediction/time_to_end.py", "MEAN_LAG_S = 2.5", "MEAN_LAG_S = 2.6"),
    "a function behind two others": ("battery/initial_state.py", "def _read(", "def _read(_unused, "),
    "a compiled loop": ("compiled/forecast.py", "at_s += dt_s[k]", "at_s += 2.0 * dt_s[k]"),
    "a source made for numba": ("compiled/openloop.py", "if p.{name}.shape[0] > 1", "if p.{name}.shape[0] > 2"),
    "the options of the compiler": ("compiled/jit.py", 'error_model="numpy"', 'error_model="python"'),
    "a module told to numba": ("compiled/filter.py", "share(noise)\n", "share(noise)\nshare(b)\n"),
}
UNFELT = {
    "a docstring": ("battery/model.py", '"""One step', '"""Take one step'),
    "a docstring of a module": ("battery/equations.py", '"""The equations', '"""Some equations'),
    "a docstring of a record's property": ("battery/pack.py", '"""Capacity today', '"""Capacity now'),
    "a comment": ("compiled/filter.py", "share(noise)\n", "share(noise)  # all of it\n"),
    "an empty line": ("battery/equations.py", "KELVIN = ", "\nKELVIN = "),
    "what only numpy runs": ("prediction/time_to_end.py", "JUDGED_AT_ONCE = 16", "JUDGED_AT_ONCE = 8"),
    "a module that nothing compiled names": ("prediction/take_off.py", "SETTLED_S = ", "SETTLED_S = 2.0 * "),
}


def edited(folder: Path, *edits: tuple[str, str, str]) -> str:
    """The digest of the package with edits; what they leave alone is linked."""
    package = Path(shutil.copytree(PACKAGE, folder / PACKAGE.name, copy_function=os.symlink, ignore=NOT_COMPILED))
    for name, before, after in edits:
        text = (package / name).read_text(encoding="utf-8")
        assert text.count(before) == 1, f"{before!r} in {name}"
        (package / name).unlink()
        (package / name).write_text(text.replace(before, after), encoding="utf-8")
    return digest(package)


@pytest.mark.parametrize("edit", FELT.values(), ids=FELT)
def test_a_change_that_compiled_code_feels_is_another_folder(edit: tuple[str, str, str], tmp_path: Path) -> None:
    assert edited(tmp_path, edit) != digest(PACKAGE)


def test_a_change_that_it_cannot_feel_is_the_same_folder(tmp_path: Path) -> None:
    assert edited(tmp_path, *UNFELT.values()) == digest(PACKAGE)
