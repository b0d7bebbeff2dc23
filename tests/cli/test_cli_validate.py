"""`uavbatt validate` as a user runs it: the study passes, and what ships is the packaged battery, number by number."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from command import Judged, run

from uavbatt.battery import battery_file


def test_every_output_is_there_and_nothing_else(judged_study: Judged) -> None:
    left = {p.name for p in judged_study.folder.rglob("*")}
    assert left == {"ship", "lpab-3s.battery.toml", "r.html", "r.json"}


def test_the_packaged_battery_can_be_reproduced(judged_study: Judged) -> None:
    """Otherwise: run scripts/package_batteries.py and commit what it writes.

    Numbers, not the hash: the fit ends within rounding errors of the processor, and the last of six digits shows them.
    """
    shipped, packaged = (
        dict(_leaves(msgspec.to_builtins(battery_file.read_battery(name))))
        for name in (judged_study.folder / "ship/lpab-3s.battery.toml", "lpab-3s")
    )
    for made in (shipped, packaged):
        del made[".certificate.date"], made[".certificate.content_sha256"]
    assert shipped.keys() == packaged.keys()
    for where, value in packaged.items():
        expected = pytest.approx(value, rel=1e-4) if isinstance(value, float) else value
        assert shipped[where] == expected, where


def _leaves(value: Any, where: str = "") -> Iterator[tuple[str, Any]]:
    """Yield each value of nested tables and lists, with its place."""
    if not isinstance(value, dict | list):
        yield where, value
        return
    for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
        yield from _leaves(inner, f"{where}.{key}")


def test_the_verdict_comes_first(judged_study: Judged) -> None:
    assert judged_study.stdout.startswith("lpab-3s: PASS at 25 °C")
    assert "not enough data  reproducibility" in judged_study.stdout


def test_pages_and_numbers(judged_study: Judged) -> None:
    numbers = json.loads((judged_study.folder / "r.json").read_text(encoding="utf-8"))
    assert numbers["verdict"] == "pass"
    page = (judged_study.folder / "ship/r.html").read_text(encoding="utf-8")
    assert page.lower().startswith("<!doctype html") and "lpab-3s" in page


def test_the_study_s_own_method(tmp_path: Path) -> None:
    done = run("validate", "--method", "paper", "--json", "p.json", folder=tmp_path)
    assert done.returncode == 0
    for agreement in ("45 of 45", "25 of 27", "26 of 27", "F_emp = 2.83 cannot be reproduced"):
        assert agreement in done.stdout
    assert done.stdout.splitlines()[-1].strip().startswith("this method judges the tests only")
    conclusion = done.stdout[done.stdout.index("conclusion by the study's own rules") :]
    assert "temperature: the samples may not be pooled at 0, 1, 4 min" in conclusion
    assert json.loads((tmp_path / "p.json").read_text(encoding="utf-8"))
