"""The engine that replay, live and other programs share: prefix invariance, where the pack's numbers come from."""

from __future__ import annotations

import json
import math
import random
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import islice
from pathlib import Path
from types import FrameType

import numpy as np
import pytest
from cases import first_quick
from factories import generic_pack

import uavbatt
from uavbatt import output
from uavbatt.battery import battery_file
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.engine import PLAIN, Engine
from uavbatt.errors import UsageError
from uavbatt.estimator import Estimator
from uavbatt.log_replay.outcome import outcome
from uavbatt.log_replay.run import engine_for, steps
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.prediction.load.scenarios import RecentMean
from uavbatt.records import NAN, Flight, PackFacts, Sample, Status
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight, write_log
from uavbatt.telemetry import read_log

STATED = PackOptions(cells=4, capacity_Ah=5.0, cutoff_V=13.2)
EVERY_20_S = ForecastSettings(forecast_period_s=20.0)


GENERIC = battery_file.read_battery("lipo-generic")


@cache
def flown() -> tuple[Sample, ...]:
    pack = generic_pack()
    return tuple(simulate_flight(pack, SimulatedFlight(600.0, 12.0, rate_Hz=1.0, seed=4)))


def lines(
    flight: Flight, options: PackOptions | None = None, most: int | None = None, engine: Engine = PLAIN
) -> list[str]:
    """The JSON lines that `uavbatt replay --jsonl` writes, the first `most` of them."""
    estimator = Estimator(battery_file.read_battery("lipo-generic"), options, EVERY_20_S, engine)
    return [json.dumps(output.line(s.estimate, s.remaining)) for s in islice(steps(flight, estimator), most)]


def as_flight(samples: tuple[Sample, ...]) -> Flight:
    return Flight("simulated", "csv", samples)


# --- one law for every size --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("cells", "capacity_Ah"), first_quick(1, [(2, 0.5), (12, 5.0), (4, 30.0)]))
def test_a_pack_of_another_size_under_the_same_load_a_cell_is_said_to_last_as_long(
    cells: int, capacity_Ah: float
) -> None:
    """No threshold is in volts of a pack or in amperes: the flight in volts a cell and in C is the same."""
    more_V, more_A = cells / 4, capacity_Ah / 5.0
    scaled = [
        replace(s, voltage_V=more_V * s.voltage_V, current_A=more_A * s.current_A, consumed_Ah=more_A * s.consumed_Ah)
        for s in flown()
    ]
    size = PackOptions(cells=cells, capacity_Ah=capacity_Ah, cutoff_V=3.3 * cells)
    runs = (
        [(e.soc, e.soc_sd, e.temp_C, r.remaining_s, r.remaining_lo_s, e.status, e.warnings) for e, r in run]
        for run in (
            Estimator(GENERIC, STATED, EVERY_20_S).run(flown()),
            Estimator(GENERIC, size, EVERY_20_S).run(scaled),
        )
    )
    for said, said_of_scaled in zip(*runs, strict=True):
        assert said_of_scaled[:5] == pytest.approx(said[:5], rel=1e-6, nan_ok=True)
        assert said_of_scaled[5:] == said[5:]


# --- prefix invariance -------------------------------------------------------------------------------------------


def assert_prefix(cut: list[str], whole: list[str], at_least: int) -> None:
    assert at_least <= len(cut) < len(whole)
    assert cut == whole[: len(cut)]


def assert_same_so_far(cut_log: Path, whole_log: Path, options: PackOptions, at_least: int) -> None:
    """The cut log has the lines of the whole one, of which some beyond its end are worked out."""
    cut = lines(read_log(cut_log), options)
    assert_prefix(cut, lines(read_log(whole_log), options, len(cut) + 20), at_least)


@pytest.mark.parametrize("rows", [1, 37, 200, 300])
def test_a_flight_cut_by_rows_has_the_same_lines(rows: int) -> None:
    assert_prefix(lines(as_flight(flown()[:rows]), STATED), whole_simulated(), rows)


@cache
def whole_simulated(engine: Engine = PLAIN) -> list[str]:
    return lines(as_flight(flown()), STATED, engine=engine)


@pytest.mark.parametrize("suffix", [".tlog", ".BIN", ".csv"])
@pytest.mark.parametrize("share", first_quick(1, [0.31, 0.77]))
def test_a_log_cut_by_bytes_has_the_same_lines(suffix: str, share: float, tmp_path: Path) -> None:
    """Through the file: parameters, arming and a torn last record included."""
    pack = generic_pack()
    whole_log, cut_log = tmp_path / f"whole{suffix}", tmp_path / f"cut{suffix}"
    write_log(whole_log, list(flown()), pack)
    data = whole_log.read_bytes()
    cut_log.write_bytes(data[: int(len(data) * share) + 3])
    options = PackOptions(capacity_Ah=5.0)
    assert_same_so_far(cut_log, whole_log, options, int(len(flown()) * (share - 0.1)))


@pytest.mark.slow  # logs cut by bytes, below and above, are its witness
def test_a_real_text_log_cut_by_rows(shared_data: Path, tmp_path: Path) -> None:
    path = shared_data / "flights/ardupilot/quad_3s_4000_underpowered.log"
    text = path.read_text(errors="replace").splitlines(keepends=True)
    cut_log = tmp_path / path.name
    cut_log.write_text("".join(text[: len(text) // 2]))
    options = PackOptions(cutoff_V=9.6)
    assert_same_so_far(cut_log, path, options, 100)


@pytest.mark.parametrize(
    ("name", "share", "rows"),
    [
        ("flights/ardupilot/quad_4s_3000_a.bin", 0.613, 500),
        ("flights/ardupilot/quad_3s_2650_emptied.BIN", 0.4142, 150),
        ("truth/reference/r0/flight_2.tlog", 0.2718, 300),
        ("flights/m100/m100_005_752.csv", 0.5772, 20),
    ],
)
def test_a_real_log_cut_by_bytes(shared_data: Path, tmp_path: Path, name: str, share: float, rows: int) -> None:
    data = (shared_data / name).read_bytes()
    cut_log = tmp_path / Path(name).name
    cut_log.write_bytes(data[: int(len(data) * share)])
    options = PackOptions(capacity_Ah=5.7 if "m100" in name else NAN)
    assert_same_so_far(cut_log, shared_data / name, options, rows)


# --- the autopilot's own words -----------------------------------------------------------------------------------


def nonsense(kind: str) -> Callable[[int, Sample], Sample]:
    rng = random.Random(9)
    made: dict[str, Callable[[int, Sample], Sample]] = {
        "nothing": lambda k, s: replace(s, consumed_Ah=NAN, reported_soc=NAN),
        "zeros": lambda k, s: replace(s, consumed_Ah=0.0, reported_soc=0.0),
        "noise": lambda k, s: replace(s, consumed_Ah=rng.uniform(-9, 9), reported_soc=rng.random()),
        "backwards": lambda k, s: replace(s, consumed_Ah=5.0 - s.consumed_Ah, reported_soc=1.0 - s.reported_soc),
        "from the middle on": lambda k, s: replace(s, consumed_Ah=1e6, reported_soc=1.0) if k > 150 else s,
    }
    return made[kind]


@pytest.mark.parametrize("kind", ["nothing", "zeros", "noise", "backwards", "from the middle on"])
def test_garbage_in_the_autopilots_charge_changes_nothing(kind: str) -> None:
    told, engine = nonsense(kind), engine_for(is_long=True)
    samples = tuple(told(k, s) for k, s in enumerate(flown()))
    assert lines(as_flight(samples), STATED, engine=engine) == whole_simulated(engine)


def test_garbage_in_a_tlog_changes_nothing(tmp_path: Path) -> None:
    pack = generic_pack()
    told = nonsense("backwards")
    for name, samples in (("a", flown()), ("b", [told(k, s) for k, s in enumerate(flown())])):
        write_log(tmp_path / f"{name}.tlog", list(samples), pack)
    options = PackOptions()
    assert lines(read_log(tmp_path / "a.tlog"), options) == lines(read_log(tmp_path / "b.tlog"), options)


# --- where the pack's numbers come from --------------------------------------------------------------------------


def resolved(options: PackOptions, facts: PackFacts | None, volts: float = 16.2, name: str = "lipo-generic") -> object:
    estimator = Estimator(battery_file.read_battery(name), options)
    if facts is not None:
        estimator.update_facts(facts)
    estimator.step(Sample(0.0, volts, 1.0))
    return estimator.pack_size


SAID = PackFacts(cells_series=6, capacity_Ah=8.0, low_voltage_V=21.0, critical_voltage_V=20.0)


@pytest.mark.parametrize(
    ("options", "facts", "volts", "expected"),
    [
        (
            PackOptions(cells=5, capacity_Ah=3.0, cutoff_V=15.0, low_V=16.0),
            SAID,
            20.3,
            (5, "--cells", 3.0, "--capacity-ah", 15.0, "--cutoff-voltage", 16.0, "--low-voltage"),
        ),
        (PackOptions(), SAID, 24.3, (6, "vehicle", 8.0, "vehicle", 20.0, "vehicle", 21.0, "vehicle")),
        (
            PackOptions(capacity_Ah=3.0),
            None,
            16.2,
            (4, "first voltage", 3.0, "--capacity-ah", 13.2, "battery file", 14.0, "battery file"),
        ),
    ],
)
def test_caller_before_vehicle_before_file(
    options: PackOptions,
    facts: PackFacts | None,
    volts: float,
    expected: tuple,  # type: ignore[type-arg]
) -> None:
    found = resolved(options, facts, volts)
    names = ("cells", "cells_from", "capacity_Ah", "capacity_from", "cutoff_V", "cutoff_from", "low_V", "low_from")
    assert tuple(getattr(found, n) for n in names) == pytest.approx(expected)


@pytest.mark.parametrize(("volts", "cells"), [(12.4, 3), (16.6, 4), (25.1, 6), (4.1, 1), (48.9, 12)])
def test_cells_from_the_first_voltage(volts: float, cells: int) -> None:
    assert resolved(PackOptions(capacity_Ah=5.0), None, volts).cells == cells  # type: ignore[attr-defined]


def test_a_file_of_three_cells_is_scaled() -> None:
    found = resolved(PackOptions(cells=6, capacity_Ah=5.0), None, 24.0, "lpab-3s")
    assert found.cutoff_V == pytest.approx(2 * battery_file.read_battery("lpab-3s").battery.cutoff_V)  # type: ignore[attr-defined]


def test_a_capacity_that_nobody_states() -> None:
    with pytest.raises(UsageError, match="--capacity-ah") as caught:
        Estimator(battery_file.read_battery("lipo-generic")).step(Sample(0.0, 16.2, 5.0))
    assert "\n" not in str(caught.value) and caught.value.exit_code == 2


def test_a_new_cutoff_changes_the_forecast_and_keeps_the_estimate() -> None:
    estimator, other = (
        Estimator(battery_file.read_battery("lipo-generic"), settings=ForecastSettings(forecast_period_s=1.0))
        for _ in range(2)
    )
    facts = PackFacts(4, 5.0, critical_voltage_V=13.2)
    for e in (estimator, other):
        e.update_facts(facts)
        list(e.run(flown()[:40]))
    estimator.update_facts(replace(facts, critical_voltage_V=14.4))
    changed, same = (e.step(flown()[40]) for e in (estimator, other))
    assert changed[0].soc == same[0].soc
    assert changed[1].remaining_s < same[1].remaining_s


def test_another_capacity_starts_anew() -> None:
    estimator = Estimator(battery_file.read_battery("lipo-generic"))
    estimator.update_facts(PackFacts(4, 5.0))
    list(estimator.run(flown()[:200]))
    estimator.update_facts(PackFacts(4, 3.0))
    assert estimator.belief is None
    estimate, _ = estimator.step(flown()[200])
    assert estimate.status is Status.CONVERGING and estimator.pack_size is not None
    assert estimator.pack_size.capacity_Ah == 3.0


def test_facts_of_another_kind_are_named() -> None:
    estimator = Estimator(battery_file.read_battery("lipo-generic"))
    with pytest.raises(UsageError, match="facts=None: expected PackFacts"):
        estimator.update_facts(None)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", first_quick(2, ["belief", "consumed_Ah", "past", "size", "facts", "current_A"]))
def test_a_saved_state_of_another_kind_is_named(name: str) -> None:
    was = Estimator(battery_file.read_battery("lipo-generic"), PackOptions(4, 5.0))
    list(was.run(flown()[:200]))
    saved = {"belief": was.belief, "past": was.past, "size": was.pack_size, "facts": PackFacts(),
             "current_A": 12.0, "consumed_Ah": 1.0}  # fmt: skip
    again = Estimator(battery_file.read_battery("lipo-generic"), PackOptions(4, 5.0))
    with pytest.raises(UsageError, match=f"^{name}=None: expected "):
        again.restore(**{**saved, name: None})  # type: ignore[arg-type]
    assert again.belief is None
    again.restore(**saved)  # type: ignore[arg-type]
    assert again.belief is was.belief


def test_navigation_of_another_kind_is_named() -> None:
    estimator = Estimator(battery_file.read_battery("lipo-generic"), PackOptions(4, 5.0))
    with pytest.raises(UsageError, match=r"^navigation=None: expected Navigation"):
        estimator.step(flown()[0], None)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match=r"^navigation=None: expected Navigation"):
        list(estimator.run(flown()[:2], lambda _: None))  # type: ignore[arg-type, return-value]


# --- what a reader must know beside the number -------------------------------------------------------------------


def warnings(name: str, options: PackOptions, facts: PackFacts | None = None, temp_C: float = 25.0) -> str:
    estimator = Estimator(battery_file.read_battery(name), options)
    if facts is not None:
        estimator.update_facts(facts)
    return "; ".join(estimator.step(Sample(0.0, 3.9 * (options.cells or 3), 1.0, temp_C))[0].warnings)


def test_every_output_names_the_status() -> None:
    assert "generic, not certified" in warnings("lipo-generic", PackOptions(cells=4, capacity_Ah=5.0))
    assert "the certificate is for a 3S pack" in warnings("lpab-3s", PackOptions(cells=4, capacity_Ah=5.0))


def test_a_missing_or_unusual_temperature_gives_a_warning() -> None:
    options = PackOptions(cells=3, capacity_Ah=5.0)
    assert "no usable pack temperature" in warnings("lpab-3s", options, temp_C=NAN)
    assert "no usable pack temperature" in warnings("lpab-3s", options, temp_C=250.0)
    assert "outside the validated range" in warnings("lpab-3s", options, temp_C=-10.0)
    assert "outside" not in warnings("lpab-3s", options, temp_C=25.0)
    assert "sag-compensated" in warnings("lpab-3s", options, PackFacts(3, 5.0, sag_compensated=True))


# --- rows --------------------------------------------------------------------------------------------------------


def test_rows_without_a_voltage_come_first() -> None:
    estimator = Estimator(battery_file.read_battery("lipo-generic"), STATED)
    estimate, remaining = estimator.step(Sample(0.0, NAN, 5.0))
    assert estimate.status is remaining.status is Status.REFUSED and estimate.reason == "no voltage in this row"
    assert estimator.pack_size is None and estimator.belief is None
    assert estimator.step(Sample(1.0, 16.4, 1.0))[0].soc > 0.5


@pytest.mark.parametrize("is_long", [False, True])
@pytest.mark.parametrize("time_s", [NAN, math.inf, -math.inf, 1e300])
def test_a_row_without_a_time_is_refused_and_moves_nothing(time_s: float, is_long: bool) -> None:
    sound = flown()[:60]
    odd = [Sample(time_s, 16.0, 20.0), *sound[:30], Sample(time_s, 12.0, 90.0), *sound[30:]]
    with_them = list(Estimator(GENERIC, STATED, engine=engine_for(is_long=is_long)).run(odd))
    assert [r.reason for _, r in with_them if "no time" in r.reason] == ["no time in this row"] * 2
    without = list(Estimator(GENERIC, STATED, engine=engine_for(is_long=is_long)).run(sound))
    assert [e.soc for e, r in with_them if "no time" not in r.reason] == [e.soc for e, _ in without]
    assert len(list(Estimator(GENERIC, STATED, engine=engine_for(is_long=is_long)).run(odd[:1]))) == 1


def test_the_engine_in_three_lines() -> None:
    """On each sample log of the repository."""
    logs = [p for p in (Path(__file__).parents[1] / "logs").iterdir() if p.suffix in (".tlog", ".BIN", ".csv")]
    assert {p.suffix for p in logs} == {".tlog", ".BIN", ".csv"}
    for log in logs:
        cells = round(uavbatt.read_log(log).samples[0].voltage_V / 4.19)
        estimator = uavbatt.Estimator.from_battery("lpab-3s", cells=cells, capacity_Ah=5.0, cutoff_V=3.3 * cells)
        for sample in uavbatt.read_log(log).samples[:60]:
            estimate, remaining = estimator.step(sample)
        assert 0.5 < estimate.soc <= 1.0 and remaining.remaining_s > 60.0, log.name


def test_the_outcome_of_a_flight_to_its_end() -> None:
    steady = ForecastSettings(RecentMean())  # as this flight is flown: an unknown aircraft may surge
    run = list(steps(as_flight(flown()), Estimator(GENERIC, STATED, steady, engine_for(is_long=True))))
    found = outcome(run, 13.2)
    volts = np.array([s.voltage_V for s in flown()])
    mean_V = np.convolve(volts, np.ones(5) / 5.0, mode="valid")
    assert found.end_of_flight_s == flown()[int(np.argmax(mean_V < 13.2)) + 4].time_s
    assert found.rows == len(flown()) and found.refused_in_air == 0.0
    labels = [c.label for c in found.checkpoints]
    assert labels[0] == "half time" and "120 s before" in labels
    for c in found.checkpoints:
        assert c.error_s == pytest.approx(c.remaining_s - c.before_end_s)
        assert abs(c.error_s) < 0.25 * c.before_end_s + 30.0


def test_the_outcome_of_a_flight_that_does_not_reach_its_end() -> None:
    found = outcome(
        list(steps(as_flight(flown()[:120]), Estimator(battery_file.read_battery("lipo-generic"), STATED))), 13.2
    )
    assert math.isnan(found.end_of_flight_s) and found.checkpoints == ()


# --- the cost of a row -------------------------------------------------------------------------------------------


def calls_of(step: Callable[[], object]) -> int:
    """How many functions of the package a step calls."""
    package, found = str(Path(uavbatt.__file__).parent), 0

    def count(frame: FrameType, event: str, _: object) -> None:
        nonlocal found
        found += event == "call" and frame.f_code.co_filename.startswith(package)

    sys.setprofile(count)
    try:
        step()
    finally:
        sys.setprofile(None)
    return found


def test_an_ordinary_row_calls_no_more_functions_than_it_did() -> None:
    """A row of a steady flight that closes no block and asks for no forecast."""
    estimator, calls = Estimator(battery_file.read_battery("lpab-3s"), STATED), []
    for k in range(600):
        sample = Sample(0.2 * k, 16.4 - 0.001 * k, 14.0 + 0.5 * (k % 3), 25.0 + 0.1 * (k // 100), armed=True)
        if k < 500:
            estimator.step(sample)
        else:
            calls.append(calls_of(lambda sample=sample: estimator.step(sample)))
    assert sorted(calls)[len(calls) // 2] <= 83
