"""The scripts that measure: each can be loaded with the package as it is (what it prints is for people)."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "scripts"
SCRIPTS = sorted(path.stem for path in FOLDER.glob("*.py"))


def test_the_list_of_scripts_names_each_of_them_and_no_other() -> None:
    first_cells = re.findall(r"^\| (`.*?) \|", (FOLDER / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
    listed = {name for cell in first_cells for name in re.findall(r"`([^`/]+)/?`", cell)}
    assert listed == {path.name for path in FOLDER.iterdir()} - {"README.md", "__pycache__"}


@pytest.mark.parametrize("name", SCRIPTS)
def test_it_finds_what_it_asks_of_the_package(name: str) -> None:
    try:
        importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.startswith("uavbatt"):
            raise
        pytest.skip(f"{error.name} is not installed")


def test_the_bench_of_the_engine_runs_what_it_times() -> None:
    """What it asks of the package by arguments and sizes, which loading does not show."""
    engine = importlib.import_module("bench.engine")
    rows = engine.flight(0.5)
    if engine.HAS_TWIN:
        engine.twin(rows, engine.capacities(engine.pack()))()
    engine.filterpy_step()()
    asked, belief, forecaster = engine.question()
    found = forecaster.forecast(belief, 0.0)
    ends_s = engine.reference_ends_s(belief, asked, draws=64)
    assert found.lo_s < found.median_s < found.hi_s and 0.0 < ends_s.min() <= ends_s.max()
