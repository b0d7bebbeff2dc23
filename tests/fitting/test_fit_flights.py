"""Battery files from flights alone: planted cells come back, and what flights cannot tell is said."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from factories import generic_pack
from scoring import other_pack
from scoring.other_pack import Make, Power, flight
from scoring.other_pack import Pack as OtherPack

from uavbatt.battery.model import SOC_GRID
from uavbatt.battery.scaling import Pack
from uavbatt.fitting import observed, prior, solve
from uavbatt.fitting.battery import FittedBattery, RecordedPack, fit_battery
from uavbatt.records import Flight, Sample
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight

STARTS = (1.0, 0.9, 0.8, 0.95, 1.0)  # what the fit is not told
POWERS_W = (250.0, 300.0, 350.0, 280.0, 320.0)
SIZE = RecordedPack("mine", 4, 5.0, 13.2)
COARSE = 6  # of rows 2 s apart


@cache
def planted() -> Pack:
    """The generic pack with 30 % more ohms, other lags, and an OCV that bulges by 20 mV in the middle."""
    pack = generic_pack()
    bulge_V = 0.02 * np.exp(-(((SOC_GRID - 0.5) / 0.15) ** 2))
    cell = pack.cell._replace(
        resistance_gain=1.3, polarisation_ratio=0.65, diffusion_ratio=0.56, ocv_V=pack.cell.ocv_V + bulge_V
    )
    return pack._replace(cell=cell)


@cache
def flown(number: int) -> tuple[Sample, ...]:
    """A flight to the cut-off from its own charge and ambient temperature, gusts and sensor noise included."""
    mission = SimulatedFlight(POWERS_W[number], 15.0 + 3.0 * number, STARTS[number], rate_Hz=0.5, seed=20 + number)
    return tuple(simulate_flight(planted(), mission))


def flights(every: int) -> list[Flight]:
    return [Flight(f"flight {k}", "csv", flown(k)[::every]) for k in range(len(STARTS))]


@cache
def found(every: int) -> solve.CellFit:
    return solve.fit_cell(
        observed.stack([observed.from_flight(f, 4, 5.0) for f in flights(every)]), own_prior=solve.ALIKE
    )


def true_values() -> dict[str, float]:
    cell = planted().cell
    names = ("polarisation_ratio", "diffusion_ratio", "activation_K", "heat_capacity_JpKAh", "cooling_WpKAh")
    ocv = {f"ocv_{z:g}": float(np.interp(z, SOC_GRID, cell.ocv_V)) for z in prior.OCV_SOC}
    return {**ocv, "r0_ohmAh": prior.RESISTANCE_OHMAH * 1.3, **{n: float(getattr(cell, n)) for n in names}}


@pytest.mark.parametrize("every", [1, COARSE], ids=["rows 2 s apart", "rows 12 s apart"])
def test_the_planted_cell_comes_back_within_its_stated_errors(every: int) -> None:
    strayed = {n: (found(every).value(n) - v) / found(every).standard_error(n) for n, v in true_values().items()}
    assert max(abs(z) for z in strayed.values()) < 3.0, strayed
    assert sum(abs(z) > 1.0 for z in strayed.values()) <= len(strayed) // 3


@pytest.mark.parametrize("every", [1, COARSE], ids=["rows 2 s apart", "rows 12 s apart"])
def test_the_unknown_start_comes_back(every: int) -> None:
    assert found(every).own[:, 0] == pytest.approx(STARTS, abs=0.015)


def test_the_ohms_that_matter_come_back() -> None:
    """All of the drop of a long load: better known than how it is shared among its lags."""
    fit, cell = found(1), planted().cell
    total = fit.value("r0_ohmAh") * (1.0 + fit.value("polarisation_ratio") + fit.value("diffusion_ratio"))
    true = prior.RESISTANCE_OHMAH * 1.3 * (1.0 + cell.polarisation_ratio + cell.diffusion_ratio)
    assert total == pytest.approx(true, rel=0.05)


def test_more_rows_tell_no_less() -> None:
    for name in ("ocv_0.5", "ocv_0.8", "heat_capacity_JpKAh", "cooling_WpKAh"):
        assert found(1).standard_error(name) < 1.25 * found(COARSE).standard_error(name)


# --- what flights cannot tell ------------------------------------------------------------------------------------


@cache
def fitted(kind: str) -> FittedBattery:
    """Files from two flights of a kind."""
    chosen = [Flight(f.source, f.kind, f.samples) for f in flights(COARSE)[:2]]
    if kind == "in mid-air":
        chosen = [Flight(f.source, f.kind, tuple(s for s in f.samples if s.time_s > 60.0)) for f in chosen]
    if kind == "half used":
        chosen = [Flight(f.source, f.kind, f.samples[: len(f.samples) // 2]) for f in chosen]
    if kind == "no thermometer":
        chosen = [Flight(f.source, f.kind, tuple(Sample(*_without(s)) for s in f.samples)) for f in chosen]
    return fit_battery(SIZE, [], chosen)


def _without(sample: Sample) -> tuple[float, float, float]:
    return sample.time_s, sample.voltage_V, sample.current_A


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("whole", "no cold data"),
        ("whole", "cannot tell capacity from state of charge"),
        ("in mid-air", "no record starts at rest"),
        ("half used", "no deep discharge"),
        ("half used", "no warm data"),
        ("no thermometer", "no temperature was measured"),
    ],
)
def test_what_flights_do_not_tell_is_said(kind: str, words: str) -> None:
    assert any(words in line for line in fitted(kind).unknown), fitted(kind).unknown


@pytest.mark.parametrize(
    ("kind", "untold", "told"),
    [
        ("whole", {"diffusion_activation_K"}, {"r0_0.1", "r0_0.3", "ocv_0.5", "heat_capacity_JpKAh"}),
        ("half used", {"r0_0.05", "r0_0.1", "r0_0.2"}, {"ocv_0.8", "heat_capacity_JpKAh"}),
        ("no thermometer", {"heat_capacity_JpKAh", "cooling_WpKAh", "sensor_lag_s"}, {"r0_0.1", "ocv_0.5"}),
    ],
)
def test_the_quantities_that_flights_say_little_about_are_named(kind: str, untold: set[str], told: set[str]) -> None:
    line = next(line for line in fitted(kind).unknown if line.startswith("your data say little about "))
    named = set(line.removeprefix("your data say little about ").split(" (typical")[0].split(", "))
    assert untold <= named and not told & named


def test_nothing_is_said_that_is_known() -> None:
    said = " ".join(fitted("whole").unknown)
    assert "at rest" not in said and "no deep discharge" not in said and "no temperature" not in said


def test_what_is_not_told_stands_in_the_file() -> None:
    for kind in ("whole", "half used"):
        assert tuple(fitted(kind).file.battery.remarks) == fitted(kind).unknown
        assert fitted(kind).file.certificate.status == "fitted"
    lines = fitted("whole").known
    assert all("±" in line for line in lines) and any(line.startswith("activation_K") for line in lines)


def test_what_is_said_of_the_curve_is_what_the_file_holds() -> None:
    """Below the charge that flights reached, the file is less sure than the fit."""
    made = fitted("half used")
    table = made.file.parameters
    for soc, volts in zip(table.ocv_soc, table.ocv_V, strict=True):
        name = f"ocv_{soc:g}"
        assert f"{name} = {volts:.4g} ± {table.standard_error[name]:.2g}" in made.known


NMC_V = (2.0, 2.6, 2.78, 2.98, 3.13, 3.26, 3.36, 3.43, 3.53, 3.61, 3.69, 3.78, 3.89, 3.985, 4.06, 4.10, 4.18)
LFP_V = (2.0, 2.3, 2.6, 2.85, 3.0, 3.1, 3.17, 3.2, 3.24, 3.26, 3.27, 3.28, 3.29, 3.31, 3.32, 3.33, 3.5)


@cache
def of_make(
    volts: tuple[float, ...], ground_s: int = 15, powers_W: tuple[float, ...] = (150.0, 280.0, 330.0)
) -> FittedBattery:
    """The file from flights of a pack of 6 cells with this curve; 0 s on the ground: they begin in the air."""
    make = Make("another", volts, 0.06, 0.7, 0.025, 40.0, 0.7, 90.0)
    made = [
        flight(OtherPack(8.4, size_Ah=8.4, make=make, cells=6), Power(watts, climb=0.3), cutoff_V=18.0)
        for watts in powers_W
    ]
    logs = [m.flight(f"{number}") for number, m in enumerate(made)]
    airborne = [Flight(f.source, f.kind, tuple(s for s in f.samples if s.armed)) for f in logs]
    cutoff_V = 18.0 if ground_s else math.nan  # nobody states one
    return fit_battery(RecordedPack("mine", 6, 8.4, cutoff_V), [], logs if ground_s else airborne)


@pytest.mark.parametrize("ground_s", [15, pytest.param(0, marks=pytest.mark.slow)], ids=["from rest", "from the air"])
def test_flights_of_lithium_ion_cells_tell_their_curve(ground_s: int) -> None:
    """It was up to 0.6 V too high with the prior of a LiPo cell, and ohms twice as large explained the voltage."""
    made = of_make(NMC_V, ground_s)
    assert made.file.battery.chemistry == "Li-ion" and not made.doubtful
    assert (made.file.battery.cutoff_V, made.file.battery.low_V) == (18.0, 19.2)  # usual for such cells
    error_V = np.array(made.file.parameters.ocv_V) - np.interp(prior.OCV_SOC, other_pack.SOC, NMC_V)
    assert np.abs(error_V[prior.OCV_SOC >= 0.05]).max() < 0.05
    se_V = np.array([made.file.parameters.standard_error[f"ocv_{z:g}"] for z in prior.OCV_SOC])
    assert np.abs(error_V / se_V).max() < 3.0


def test_cells_of_neither_kind_are_doubted_and_no_others_are() -> None:
    doubted = of_make(LFP_V, powers_W=(280.0,))
    assert "ocv_0" in doubted.doubtful[0] and "another chemistry" in doubted.doubtful[0]
    assert doubted.doubtful[0] in doubted.file.battery.remarks
    assert not fitted("whole").doubtful


def test_lipo_cells_are_not_taken_for_lithium_ion() -> None:
    for kind in ("whole", "half used", "in mid-air", "no thermometer"):
        assert fitted(kind).file.battery.chemistry == "LiPo"


def test_the_file_says_over_how_many_flights_the_scatter_was_measured() -> None:
    three = fit_battery(SIZE, [], [Flight(f.source, f.kind, f.samples) for f in flights(COARSE)[:3]])
    assert three.file.parameters.spread_flights == 3
    assert fitted("whole").file.parameters.spread_flights is None  # two differ by chance
