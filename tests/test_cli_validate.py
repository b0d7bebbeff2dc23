"""`uavbatt validate` as a user runs it: the study passes, and what ships is the packaged battery, number by number."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from uavbatt.battery import file

UAVBATT = Path(sys.executable).parent / "uavbatt"


def run(*call: str | Path, folder: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    return subprocess.run(
        [str(UAVBATT), *map(str, call)], capture_output=True, text=True, cwd=folder, env=environment, timeout=300
    )


@pytest.fixture(scope="module")
def judged(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """One run on the study with every output; (folder, stdout)."""
    folder = tmp_path_factory.mktemp("judged")
    done = run("validate", "--ship", "ship", "--report", "r.html", "--json", "r.json", folder=folder)
    assert done.returncode == 0 and "Traceback" not in done.stderr
    assert {p.name for p in folder.rglob("*")} == {"ship", "lpab-3s.battery.toml", "r.html", "r.json"}
    return folder, done.stdout


def test_the_packaged_battery_can_be_reproduced(judged: tuple[Path, str]) -> None:
    """Otherwise: run scripts/package_batteries and commit what it writes."""
    shipped, packaged = file.read(judged[0] / "ship/lpab-3s.battery.toml"), file.read("lpab-3s")
    assert shipped.certificate.content_sha256 == packaged.certificate.content_sha256


def test_the_verdict_comes_first(judged: tuple[Path, str]) -> None:
    assert judged[1].startswith("lpab-3s: PASS at 25 °C")
    assert "not enough data  reproducibility" in judged[1]


def test_pages_and_numbers(judged: tuple[Path, str]) -> None:
    numbers = json.loads((judged[0] / "r.json").read_text(encoding="utf-8"))
    assert numbers["verdict"] == "pass"
    page = (judged[0] / "r.html").read_text(encoding="utf-8")
    assert page.lower().startswith("<!doctype html") and "lpab-3s" in page


def test_the_study_s_own_method(tmp_path: Path) -> None:
    done = run("validate", "--method", "paper", "--json", "p.json", folder=tmp_path)
    assert done.returncode == 0
    for agreement in ("45 of 45", "25 of 27", "26 of 27", "F_emp = 2.83 cannot be reproduced"):
        assert agreement in done.stdout
    assert json.loads((tmp_path / "p.json").read_text(encoding="utf-8"))
