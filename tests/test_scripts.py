"""The scripts that measure: each can be loaded with the package as it is (what it prints is for people)."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

SCRIPTS = sorted(path.stem for path in (Path(__file__).parents[1] / "scripts").glob("*.py"))


@pytest.mark.parametrize("name", SCRIPTS)
def test_it_finds_what_it_asks_of_the_package(name: str) -> None:
    try:
        importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.startswith("uavbatt"):
            raise
        pytest.skip(f"{error.name} is not installed")
