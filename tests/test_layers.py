"""What is loaded when: importing the package costs nothing, flying needs no optimiser, no plots, no cluster."""

from __future__ import annotations

import ast
import subprocess
import sys
from importlib import resources, util
from importlib.metadata import version
from pathlib import Path

import pytest

HEAVY = ("matplotlib.pyplot", "dask", "distributed", "pyarrow", "numba", "pymavlink", "typer", "starlette", "uvicorn")
SCIPY = tuple(int(part) for part in version("scipy").split(".")[:2])


def loaded(code: str) -> set[str]:
    """Names of the modules that a fresh interpreter has after `code`."""
    probe = f"import sys\n{code}\nprint('\\n'.join(sys.modules))"
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_importing_the_package_is_light() -> None:
    modules = loaded("import uavbatt")
    assert not modules & {"numpy", "scipy", "filterpy", "msgspec", "pymavlink", "matplotlib", *HEAVY}
    assert {m for m in modules if m.startswith("uavbatt.")} == set()


def test_the_records_are_light() -> None:
    assert not loaded("from uavbatt import Sample, Estimate, Remaining, Flight") & {"numpy", "scipy", "msgspec"}


def test_the_estimator_flies_without_the_workshop() -> None:
    """What the drone loads: the model, the filter, the forecast."""
    modules = loaded("from uavbatt import Estimator, Sample\nEstimator.from_battery('lipo-generic', capacity_Ah=5.0)")
    assert not modules & set(HEAVY)
    for part in ("fitting", "validation", "diagnosis", "report", "cli", "fleet", "simulate"):
        assert f"uavbatt.{part}" not in modules, part


def imported_by(module: str) -> set[str]:
    """What the source of a module names in its imports, wherever they stand."""
    spec = util.find_spec(module)
    assert spec is not None and spec.origin is not None
    names: set[str] = set()
    for node in ast.walk(ast.parse(Path(spec.origin).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names


def test_no_part_of_the_estimator_asks_for_an_optimiser() -> None:
    """filterpy brings scipy.stats, and that scipy.optimize; our own modules in the closure name neither."""
    modules = loaded("from uavbatt import Estimator\nEstimator.from_battery('lipo-generic', capacity_Ah=5.0)")
    ours = {m for m in modules if m.startswith("uavbatt.")}
    assert "uavbatt.estimation.filter" in ours and len(ours) > 15
    for module in ours:
        named = imported_by(module)
        assert not {n for n in named if n.startswith(("scipy.optimize", "scipy.stats", "matplotlib", "dask"))}, module


def test_a_whole_step_loads_no_more() -> None:
    code = (
        "from uavbatt import Estimator, Sample\n"
        "e = Estimator.from_battery('lipo-generic', cells=4, capacity_Ah=5.0, cutoff_V=13.2)\n"
        "for k in range(40): found = e.step(Sample(2.0 * k, 15.6, 15.0, 25.0))\n"
        "assert found[1].remaining_s > 0.0"
    )
    assert not loaded(code) & set(HEAVY)


ONE_UPDATE = (
    "from uavbatt.cli import live_process\n"
    "{}"
    "live_process.load_filterpy()\n"
    "from uavbatt.estimation.kalman import Measurement, condition, filterpy_condition\n"
    "import numpy as np\n"
    "x, P, H = np.ones((1, 9)), np.eye(9)[None], np.ones((1, 1, 9))\n"
    "given = (x, P, Measurement(np.array([[0.5]]), H, np.array([[[0.1]]])))\n"
    "for found, expected in zip(filterpy_condition()(*given), condition(*given)):\n"
    "    assert np.allclose(found, expected, rtol=0.0, atol=1e-12)"
)


@pytest.mark.skipif(SCIPY < (1, 17), reason="an older scipy.linalg loads scipy.sparse and others itself: memory only")
def test_the_live_process_loads_the_filters_of_filterpy_alone() -> None:
    modules = loaded(ONE_UPDATE.format(""))
    assert "filterpy.kalman.EKF" in modules
    assert not modules & {"scipy.stats", "scipy.ndimage", "scipy.optimize", "scipy.sparse"}


def test_of_a_filterpy_that_needs_more_everything_is_loaded() -> None:
    modules = loaded(ONE_UPDATE.format("live_process.NOT_FLOWN = {'filterpy.stats': ()}\n"))
    assert {"filterpy.kalman.EKF", "filterpy.stats.stats", "scipy.stats"} <= modules


def test_reading_a_csv_needs_no_pymavlink() -> None:
    assert "pymavlink" not in loaded("from uavbatt import read_log\nimport uavbatt.telemetry.formats.csv_table")


def test_the_command_line_answers_before_it_loads() -> None:
    """`uavbatt --help` and a slip in the call cost no numerics."""
    modules = loaded("from uavbatt.cli.app import app")
    assert not modules & {"scipy.optimize", "filterpy", "matplotlib", "pymavlink", "dask"}


def test_names_of_the_public_face() -> None:
    import uavbatt

    for name in uavbatt.__all__:
        assert getattr(uavbatt, name) is not None
    with pytest.raises(AttributeError, match="nothing_like_it"):
        _ = uavbatt.nothing_like_it


def test_package_data_is_there() -> None:
    data = resources.files("uavbatt") / "data"
    assert (data / "study" / "discharge.csv").is_file() and (data / "batteries" / "lpab-3s.battery.toml").is_file()
    assert (resources.files("uavbatt") / "py.typed").is_file()
