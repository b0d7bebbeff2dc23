"""Fixtures for all tests, and how the processes share the work. The measured data are not part of the repository."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
from hypothesis import settings

os.environ.setdefault("OMP_NUM_THREADS", "1")  # as scripts/test and the command do, before anything loads numpy
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # else each of a hundred processes compiles the package anew

from browser import Browser, program
from command import Judged, called

sys.dont_write_bytecode = False

# The same examples on every machine: a run that fails can be run again. HYPOTHESIS_PROFILE=default looks for new ones.
settings.register_profile("same", derandomize=True, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "same"))

ASK_FOR_THE_STUDY = {
    "test_cli_validate", "test_diagnosis_gate", "test_gate", "test_temperature_loop", "test_validate",
}  # fmt: skip


# They come first: the live tests mostly wait, the second makes the compiled code, for which all replays would wait, the
# third is long and needs little of it.
FIRST = ("live", "test_compiled", "study")


def scope_of(nodeid: str) -> str:
    """Tests of one scope stay in one process."""
    name = Path(nodeid.partition("::")[0]).stem
    if name == "test_faults_flown":  # the longest file; what shares a flight is named by its scenario
        return nodeid.rpartition("[")[2]
    return "study" if name in ASK_FOR_THE_STUDY else "live" if name.startswith("test_live_") else name


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Where processes share the tests (scripts/test), a file stays in one, for its tests share results.

    So do the files that ask for `judged_study`, and the live tests: two of them at once would make each other late.
    (`--dist loadgroup` would say this with marks; pytest-xdist 3.8 does not find them under pytest 9.2.)
    """
    from xdist.scheduler import LoadScopeScheduling

    class ByFile(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return scope_of(nodeid)

    config.option.loadscopereorder = False  # the order of collection, not that of the number of tests
    return ByFile(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put what is FIRST first; mark a test by what it asks for: measured data, or the live process."""
    items.sort(key=lambda item: [*FIRST, scope_of(item.nodeid)].index(scope_of(item.nodeid)))
    for item in items:
        asked = getattr(item, "fixturenames", ())
        if "shared_data" in asked:
            item.add_marker(pytest.mark.data)
        if item.path.parent.name == "live":
            item.add_marker(pytest.mark.live)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of measured data: $UAVBATT_DATA, else `../shared/data` beside the checkout."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("UAVBATT_DATA", default))
    if not folder.is_dir():
        pytest.skip("the measured data are not here: set UAVBATT_DATA to their folder")
    return folder


@pytest.fixture(scope="session")
def short_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tlog of six minutes from full to the cut-off, its pack in its parameters, for tests that want any flight."""
    from factories import generic_pack

    from uavbatt.simulate.flight import SimulatedFlight, simulate_flight, write_log

    path, pack = tmp_path_factory.mktemp("short") / "short.tlog", generic_pack(capacity_Ah=2.0)
    write_log(path, simulate_flight(pack, SimulatedFlight(power_W=300.0, rate_Hz=1.0)), pack)
    return path


@pytest.fixture(scope="session", autouse=True)
def compiled_replays() -> Iterator[None]:
    """Replays in this process are compiled, however short: half the time, and the same to rounding (tests/compiled).

    Those of a process of its own, in flight and of an `Estimator` that is given no engine are not.
    """
    with patch("uavbatt.log_replay.run.MANY_ROWS", 0):
        yield


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages with empty drawings, for tests that ask about the words: drawings take most of a page's time."""
    from uavbatt.report import plot

    monkeypatch.setattr(plot, "drawing", lambda _, alt, *__, **___: plot._inline("<svg></svg>", alt))


@pytest.fixture
def vehicle() -> Iterator[Any]:
    """A quad that talks over UDP (`live_rig.Vehicle`) to a port that is free."""
    from live_rig import Vehicle, free_port

    made = Vehicle(free_port())
    made.start()
    yield made
    made.is_over = True
    made.join(2.0)


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """One Chromium for all pages."""
    path = program()
    if path is None:
        pytest.skip("no chromium here: apt-get install chromium")
    running = Browser(path, tmp_path_factory.mktemp("chromium"))
    yield running
    running.close()


@pytest.fixture(scope="session")
def judged_study(tmp_path_factory: pytest.TempPathFactory) -> Judged:
    """One run of the command on the study with every output, 15 s long, for every file that asks about it."""
    from uavbatt.validation import validate as stage

    judge, found, shares, folder = stage.validate, [], [], tmp_path_factory.mktemp("judged")

    def judged(tests: Any, limits: Any, progress: Any) -> Any:
        found.append(judge(tests, limits, shares.append))
        return found[-1]

    with patch.object(stage, "validate", side_effect=judged):
        done = called("validate", "--ship", "ship", "--report", "ship/r.html", "--json", "r.json", folder=folder)
    assert done.returncode == 0, done.stderr
    return Judged(folder, done.stdout, found[0], tuple(shares))
