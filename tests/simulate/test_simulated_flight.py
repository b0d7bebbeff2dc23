"""Simulated flights: physics of what was asked, the same flight from the same seed, readable logs."""

from __future__ import annotations

import re
import shlex
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from factories import generic_pack as pack
from typer.testing import CliRunner

from uavbatt.battery.effects import EFFECTS
from uavbatt.cli.app import app
from uavbatt.errors import UsageError
from uavbatt.records import Sample
from uavbatt.simulate.flight import AFTER_END_S, IDLE_S, SimulatedFlight, simulate_flight, with_effects, write_log
from uavbatt.telemetry import read_log
from uavbatt.telemetry.quality.info import describe

LOGS = Path(__file__).parents[2] / "logs"


@cache
def flown(ambient_C: float = 20.0, power_W: float = 300.0, seed: int = 1) -> tuple[Sample, ...]:
    return tuple(simulate_flight(pack(), SimulatedFlight(power_W, ambient_C, rate_Hz=1.0, seed=seed)))


def column(samples: tuple[Sample, ...], name: str) -> np.ndarray:
    return np.array([getattr(s, name) for s in samples], dtype=float)


def test_power_charge_and_arming() -> None:
    samples = flown()
    time_s, amps = column(samples, "time_s"), column(samples, "current_A")
    power_W = column(samples, "voltage_V") * amps
    flying = (time_s >= IDLE_S) & (time_s < time_s[-1] - AFTER_END_S)
    assert float(np.mean(power_W[flying])) == pytest.approx(300.0, rel=0.05)
    assert float(np.mean(power_W[time_s < IDLE_S])) < 15.0
    assert [s.armed for s in samples] == [bool(t >= IDLE_S) for t in time_s]
    drawn_Ah = np.cumsum(amps) / 3600.0
    assert column(samples, "consumed_Ah") == pytest.approx(drawn_Ah, rel=0.03, abs=0.02)


def test_it_ends_soon_after_the_cut_off() -> None:
    volts, time_s = column(flown(), "voltage_V"), column(flown(), "time_s")
    above = time_s[volts > 13.2 + 0.1]
    assert time_s[-1] - above[-1] == pytest.approx(AFTER_END_S, abs=8.0)  # gusts
    assert volts[0] == pytest.approx(4 * 4.2, abs=0.1)


def test_one_seed_one_flight() -> None:
    again = tuple(simulate_flight(pack(), SimulatedFlight(300.0, rate_Hz=1.0, seed=1)))
    assert again == flown()
    assert column(flown(seed=2), "current_A")[:100] != pytest.approx(column(flown(), "current_A")[:100])


def test_cold_and_power_shorten() -> None:
    assert flown(-5.0)[-1].time_s < flown(20.0)[-1].time_s < flown(35.0)[-1].time_s
    assert flown(20.0, 450.0)[-1].time_s < flown(20.0, 300.0)[-1].time_s


@pytest.mark.parametrize(
    ("effect", "value"),
    [
        ("resistance_growth", 1.0),
        ("capacity_fade", 0.2),
        ("weak_cell", 0.2),
        ("harness_resistance", 0.03),
    ],
)
def test_a_planted_effect_shortens_the_flight(effect: str, value: float) -> None:
    struck = simulate_flight(with_effects(pack(), {effect: value}), SimulatedFlight(300.0, rate_Hz=1.0, seed=1))
    assert struck[-1].time_s < 0.97 * flown()[-1].time_s


@pytest.mark.parametrize(
    ("effect", "value", "field", "change"),
    [
        ("voltage_offset", -0.3, "voltage_V", -0.3),
        ("temperature_offset", 6.0, "temp_C", 6.0),
        ("current_offset", 2.0, "current_A", 2.0),
    ],
)
def test_effects_of_sensors_are_read_and_no_more(effect: str, value: float, field: str, change: float) -> None:
    struck = simulate_flight(with_effects(pack(), {effect: value}), SimulatedFlight(300.0, rate_Hz=1.0, seed=1))
    rows = min(len(struck), len(flown()))
    assert abs(struck[-1].time_s - flown()[-1].time_s) < 1.0  # the battery does not know of its sensors
    assert column(tuple(struck[30:rows]), field) - column(flown()[30:rows], field) == pytest.approx(change, abs=1e-9)


def test_a_compensation_of_sag_is_read_and_does_not_lengthen_the_flight() -> None:
    struck = simulate_flight(
        with_effects(pack(), {"sag_compensation": 0.02}), SimulatedFlight(300.0, rate_Hz=1.0, seed=1)
    )
    rows = min(len(struck), len(flown()))
    assert abs(struck[-1].time_s - flown()[-1].time_s) < 1.0
    lift_V = column(tuple(struck[30:rows]), "voltage_V") - column(flown()[30:rows], "voltage_V")
    assert lift_V == pytest.approx(0.02 * column(flown()[30:rows], "current_A"), abs=0.02)  # 1 A of noise


def test_current_gain_is_read() -> None:
    struck = simulate_flight(with_effects(pack(), {"current_gain": 1.2}), SimulatedFlight(300.0, rate_Hz=1.0, seed=1))
    ratio = column(tuple(struck[30:400]), "current_A") / column(flown()[30:400], "current_A")
    assert float(np.mean(ratio)) == pytest.approx(1.2, abs=0.005)


def test_every_effect_can_be_set() -> None:
    for name, effect in EFFECTS.items():
        quantity = effect.quantities[0]
        changed = with_effects(pack(), {name: quantity.low + 0.3 * (quantity.high - quantity.low)})
        assert changed != pack(), name


@pytest.mark.parametrize(("effects", "word"), [({"gremlins": 1.0}, "polarisation"), ({"weak_cell": 0.9}, "0..0.5")])
def test_effects_that_are_none(effects: dict[str, float], word: str) -> None:
    with pytest.raises(UsageError, match=re.escape(word)):
        with_effects(pack(), effects)


@pytest.mark.parametrize(("suffix", "kind"), [(".tlog", "tlog"), (".BIN", "dataflash-binary"), (".csv", "csv")])
def test_written_logs_read_back(suffix: str, kind: str, tmp_path: Path) -> None:
    path = tmp_path / f"flight{suffix}"
    samples = list(flown()[:200])
    write_log(path, samples, pack())
    flight = read_log(path)
    assert flight.kind == kind and len(flight.samples) == len(samples)
    for name, step in (("time_s", 1e-3), ("voltage_V", 1e-3), ("current_A", 0.011), ("temp_C", 0.011)):
        assert column(flight.samples, name) == pytest.approx(column(tuple(samples), name), abs=step)
    if suffix != ".csv":
        facts = flight.facts_at(1e9)
        assert (facts.capacity_Ah, facts.critical_voltage_V) == pytest.approx((5.0, 13.2))
        assert facts.low_voltage_V == pytest.approx(14.0)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_another_suffix_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"\.tlog, \.BIN or \.csv"):
        write_log(tmp_path / "flight.txt", list(flown()[:3]), pack())
    assert list(tmp_path.iterdir()) == []


def documented() -> list[list[str]]:
    text = (LOGS / "README.md").read_text(encoding="utf-8")
    return [shlex.split(line)[1:] for line in text.splitlines() if line.startswith("uavbatt simulate")]


def test_the_sample_logs_are_those_of_the_readme(tmp_path: Path) -> None:
    """Each log in logs/ is small, sound, and comes again from the command that is written beside it."""
    names = {p.name for p in LOGS.iterdir() if p.suffix != ".md"}
    assert {Path(call[call.index("-o") + 1]).name for call in documented()} == names
    assert {Path(n).suffix for n in names} == {".tlog", ".BIN", ".csv"}
    for call in documented():
        log = LOGS / Path(call[call.index("-o") + 1]).name
        assert log.stat().st_size <= 400_000
        call[call.index("-o") + 1] = str(tmp_path / log.name)
        assert CliRunner().invoke(app, call).exit_code == 0
        ours, again = read_log(log), read_log(tmp_path / log.name)
        assert again.duration_s == pytest.approx(ours.duration_s, rel=0.1), "made with another model: make it anew"
        assert describe(ours).trust == "yes", log.name
