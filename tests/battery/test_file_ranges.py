"""F9: a battery or vehicle file whose numbers no battery and no aircraft has is refused, file and key named."""

from __future__ import annotations

import copy
import math
import tomllib
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from command import called

from uavbatt.battery import battery_file

ROOT = Path(__file__).parents[2]
TLOG = ROOT / "logs/quad_4s.tlog"

BATTERY: list[tuple[tuple[Any, ...], Any, str]] = [
    (("battery", "cells_series"), 10**15, "battery.cells_series"),
    (("battery", "cells_series"), 0, "battery.cells_series"),
    (("battery", "capacity_Ah"), -5.0, "battery.capacity_Ah"),
    (("battery", "capacity_Ah"), 5000.0, "battery.capacity_Ah"),
    (("battery", "cutoff_V"), 9300.0, "battery.cutoff_V"),
    (("battery", "cutoff_V"), 1e-38, "battery.cutoff_V"),
    (("battery", "low_V"), -1.0, "battery.low_V"),
    (("parameters", "resistance_ohmAh", 2), 1e9, "parameters.resistance_ohmAh"),
    (("parameters", "resistance_ohmAh", 2), 1e-300, "parameters.resistance_ohmAh"),
    (("parameters", "resistance_ohmAh", 2), math.nan, "parameters.resistance_ohmAh"),
    (("parameters", "ocv_V", 14), 4194.18, "parameters.ocv_V"),
    (("parameters", "ocv_V", 3), 3.0, "parameters.ocv_V"),
    (("parameters", "ocv_soc", 0), -5.0, "parameters.ocv_soc"),
    (("parameters", "ocv_soc"), [k / 28 for k in range(15)], "parameters.ocv_soc"),
    (("parameters", "ocv_soc"), [k / 200_000 for k in range(200_001)], "parameters.ocv_soc"),
    (("parameters", "ocv_soc", 1), 1e-9, "parameters.ocv_V"),
    (("parameters", "resistance_soc", 0), -0.1, "parameters.resistance_soc"),
    (("parameters", "resistance_scale_sd"), -0.2, "parameters.resistance_scale_sd"),
    (("parameters", "capacity_scale_sd"), 0.0, "parameters.capacity_scale_sd"),
    (("parameters", "capacity_scale_sd"), math.inf, "parameters.capacity_scale_sd"),
    (("parameters", "standard_error"), {"x": -1.0}, "parameters.standard_error"),
    (("discrepancy", "voltage_rmse_V"), -0.1, "discrepancy.voltage_rmse_V"),
    (("discrepancy", "voltage_autocorrelation_s"), math.nan, "discrepancy.voltage_autocorrelation_s"),
    (("effects", 0, "parameters", "polarisation_tau_s"), 1e9, "polarisation_tau_s"),
    (("corridor", "time_s"), [0.0], "corridor"),
]


def edited(path: tuple[Any, ...], value: Any) -> dict[str, Any]:
    content: dict[str, Any] = copy.deepcopy(tomllib.loads(battery_file._text("lpab-3s")[0].decode()))
    inner: Any = content
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    return content


@pytest.mark.parametrize(("path", "value", "key"), BATTERY, ids=lambda part: str(part)[:40])
def test_an_impossible_battery_is_refused_in_one_line(
    path: tuple[Any, ...], value: Any, key: str, tmp_path: Path
) -> None:
    (tmp_path / "b.battery.toml").write_text(tomli_w.dumps(edited(path, value)))
    call = ("replay", TLOG, "--battery", "b.battery.toml", "--allow-uncertified", "--capacity-ah", "5")
    assert_one_line(called(*call, folder=tmp_path), "b.battery.toml", key)


@pytest.mark.parametrize(
    "text", ["x = " + "[" * 5000, "a" * 6_000_000, "cutoff_V = " + "9" * 5000, "[battery]\nname = 1979-05-27"]
)
def test_what_no_toml_should_hold(text: str, tmp_path: Path) -> None:
    for kind, option in (("battery", "--battery"), ("vehicle", "--vehicle")):
        (tmp_path / f"f.{kind}.toml").write_text(text)
        assert_one_line(called("replay", TLOG, option, f"f.{kind}.toml", folder=tmp_path), f"f.{kind}.toml", "expected")


VEHICLE: list[tuple[dict[str, Any], str]] = [
    ({"power_W": [300.0, math.inf, 300.0]}, "traces[0].power_W"),
    ({"power_W": [300.0, math.nan, 300.0]}, "traces[0].power_W"),
    ({"power_W": [300.0, 1e9, 300.0]}, "traces[0].power_W"),
    ({"soc": [1.0, math.nan, 0.8]}, "traces[0].soc"),
    ({"soc": [100.0, 95.0, 90.0]}, "traces[0].soc"),
    ({"time_s": [0.0, math.nan, 20.0]}, "traces[0].time_s"),
    ({"time_s": [-1e9, 0.0, 20.0]}, "traces[0].time_s"),
]


@pytest.mark.parametrize(("changed", "key"), VEHICLE)
def test_an_impossible_flight_is_refused_in_one_line(changed: dict[str, Any], key: str, tmp_path: Path) -> None:
    trace = {"time_s": [0.0, 10.0, 20.0], "power_W": [300.0] * 3, "soc": [1.0, 0.9, 0.8]}
    phases = {"take_off_W": 300.0, "flight_W": 300.0, "last_minute_W": 300.0}
    content = {"name": "v", "battery": "lpab-3s", "phases": phases, "traces": [{**trace, **changed}]}
    (tmp_path / "v.vehicle.toml").write_text(tomli_w.dumps(content))
    assert_one_line(called("replay", TLOG, "--vehicle", "v.vehicle.toml", folder=tmp_path), "v.vehicle.toml", key)
    phased = {**content, "traces": [trace], "phases": {**phases, "flight_W": math.nan}}
    (tmp_path / "v.vehicle.toml").write_text(tomli_w.dumps(phased))
    assert_one_line(called("replay", TLOG, "--vehicle", "v.vehicle.toml", folder=tmp_path), "phases.flight_W")


def assert_one_line(done: Any, *words: str) -> None:
    said = done.stderr.strip()
    assert done.returncode == 1 and done.stdout == ""
    assert said.startswith("uavbatt: ") and "\n" not in said and len(said) < 400
    assert all(word in said for word in words), said
