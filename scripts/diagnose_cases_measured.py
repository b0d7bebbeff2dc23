#!/usr/bin/env python3
"""Closing the loop on measured data: what a plain model lacks, and the error before and after on records left out.

Run: .venv/bin/python scripts/diagnose_cases_measured.py [--only study|m100|enertech|turnigy]
Needs the shared data (UAVBATT_DATA or ../shared/data), but for the study, which is part of the package.
"""

from __future__ import annotations

import argparse
import csv
import os
import sys
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray
from scoring import data
from scoring.data import M100_CELLS, M100_CUTOFF_V

from uavbatt import dataset
from uavbatt.battery.battery_file import Battery, BatteryFile, Certificate, Discrepancy, ParameterTable
from uavbatt.battery.sizing.pack_size import PackOptions, pack_from
from uavbatt.diagnosis.diagnosis import Diagnosis, diagnose
from uavbatt.diagnosis.refit.heldout import open_loop
from uavbatt.diagnosis.search.worth import left_out_values
from uavbatt.errors import NotEnoughData
from uavbatt.fitting.battery import RecordedPack, fit_battery
from uavbatt.fitting.observed import ObservedRecord, from_flight
from uavbatt.log_replay.run import engine_for
from uavbatt.validation.gating import temperatures
from uavbatt.validation.gating.gate import Limits
from uavbatt.validation.judging.readings import read_once

Array = NDArray[np.float64]
DATA = data.place()
STUDY = Path(__file__).resolve().parents[1] / "uavbatt" / "data" / "study"
M100_AH = 5.7  # as printed on the packs
ENERTECH_AH, ENERTECH_AMBIENT_C, TURNIGY_AH, PIECES = 2.336, 25.0, 5.0, 4
HEAD = "| data | plain model | found | voltage, left out [mV] | left unexplained |\n|---|---|---|---|---|"


def columns(path: Path) -> dict[str, Array]:
    """Return the columns of a CSV file, NaN where empty."""
    with path.open() as stream:
        rows = list(csv.DictReader(stream))
    return {k: np.array([float(r[k] or "nan") for r in rows]) for k in rows[0]}


def plain(name: str, ocv: tuple[Array, Array], ohm_Ah: float, capacity_Ah: float, cutoff_V: float) -> BatteryFile:
    """Return a battery file of one cell with an open-circuit voltage, one resistance and no effect."""
    return BatteryFile(
        battery=Battery(
            name=name, chemistry="", cells_series=1, cutoff_V=cutoff_V, capacity_Ah=capacity_Ah, low_V=cutoff_V
        ),
        parameters=ParameterTable(
            ocv_soc=ocv[0].tolist(),
            ocv_V=ocv[1].tolist(),
            resistance_soc=[0.0, 1.0],
            resistance_ohmAh=[ohm_Ah, ohm_Ah],
            resistance_scale_sd=0.06,
            capacity_scale_sd=0.02,
        ),
        effects=[],
        discrepancy=Discrepancy(
            voltage_bias_V=0.0,
            voltage_rmse_V=0.007,
            voltage_autocorrelation_s=120.0,
            temperature_rmse_K=0.3,
            held_out=True,
        ),
        certificate=Certificate(status="fitted"),
    )


def row(name: str, model: str, records: list[ObservedRecord], file: BatteryFile, cutoff_V: float) -> str:
    """Return one line of the table: the diagnosis of the records, each left out in turn for the error."""
    pack = pack_from(file, PackOptions(records[0].cells, records[0].capacity_Ah, cutoff_V))
    try:
        found = diagnose(records, file, pack, engine=engine_for(is_long=True))
    except NotEnoughData as error:
        return f"| {name} | {model} | not enough data: {error} | – | – |"
    empty = [np.zeros(0)] * len(found.problem.evidence.names)
    before_V, _ = open_loop(found.problem, found.before, empty)
    after_V, _ = open_loop(found.problem, found.after, left_out_values(found.problem, found.after))
    left = "; ".join(found.reasons) or "nothing"
    return f"| {name} | {model} | {words(found)} | {1000 * before_V:.0f} → {1000 * after_V:.0f} | {left} |"


def words(found: Diagnosis) -> str:
    """Return verdict and classes, the first member with its values."""
    parts = []
    for one in found.classes:
        values = ", ".join(f"{k} {v.value:.3g} [{v.lo:.3g}, {v.hi:.3g}]" for k, v in one.parameters.items())
        parts.append(f"{' or '.join(one.members)} ({values})")
    return f"{found.verdict}: {' + '.join(parts) or '–'}"


def study() -> None:
    """Print the study's tables over temperature: isothermal, then self-heating and a steeper cold resistance."""
    loop = temperatures.close_loop(read_once(dataset.load(STUDY)), Limits())
    if loop is None:
        return
    print("\n| study: step | tests | RMSE before → after, left out [mV] | p | holds |\n|---|---|---|---|---|")
    for gain in loop.gains:
        change = f"{1000 * gain.before_V:.0f} → {1000 * gain.after_V:.0f}"
        holds = "yes" if gain.holds else "no"
        print(f"| {gain.question} | {gain.scope}, {gain.group} | {change} | {gain.p_value:.2g} | {holds} |")
    print("\n" + "\n".join(f"- {said}" for said in loop.conclusions))


def enertech_records(rates: tuple[str, ...]) -> list[ObservedRecord]:
    """Read discharges of the pouch cell at these C-rates."""
    records = []
    for rate in rates:
        c = columns(DATA / "bench" / f"enertech_pouch_{rate}C.csv")
        kept = slice(None, None, 5)
        temp_C = ENERTECH_AMBIENT_C + c.get("surface_rise_k", np.full(c["time_s"].size, np.nan))
        time_s, volts, amps, temp_C = (x[kept] for x in (c["time_s"], c["voltage_v"], c["current_a"], temp_C))
        records.append(ObservedRecord(f"{rate}C", time_s, volts, amps, temp_C, ENERTECH_AMBIENT_C, 1, ENERTECH_AH))
    return records


def enertech() -> None:
    """Print the pouch cell: OCV from 0.1 C, one resistance from 0.5 C."""
    slow = columns(DATA / "bench" / "enertech_pouch_0.1C.csv")
    knots = np.array([0.0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 1.0])
    soc = 1.0 - slow["time_s"] * slow["current_a"] / 3600.0 / ENERTECH_AH
    ocv = (knots, np.interp(knots, soc[::-1], slow["voltage_v"][::-1]))
    records = enertech_records(("0.5", "1"))
    half = records[0]
    drawn = np.interp(1.0 - half.time_s * half.current_A / 3600.0 / ENERTECH_AH, *ocv)
    ohm_Ah = float(np.median((drawn - half.voltage_V) / half.current_A)) * ENERTECH_AH
    file = plain("enertech", ocv, ohm_Ah, ENERTECH_AH, 3.0)
    print(row("Enertech pouch, 0.5 C and 1 C", "OCV at 0.1 C, one resistance", records, file, 3.0))


def turnigy_records() -> list[ObservedRecord]:
    """Read the drive cycle in PIECES of equal charge."""
    c = columns(DATA / "bench" / "turnigy_la92_25c.csv")
    current_A = c["current_a"] if float(np.mean(c["current_a"])) > 0.0 else -c["current_a"]
    drawn = np.abs(c["ah"])
    edges = np.searchsorted(drawn, np.linspace(0.0, drawn[-1] * 0.999, PIECES + 1))
    records = []
    for i in range(PIECES):
        part = slice(edges[i], edges[i + 1])
        time_s, volts, amps, temp_C = (x[part] for x in (c["time_s"], c["voltage_v"], current_A, c["surface_c"]))
        records.append(ObservedRecord(f"piece {i + 1}", time_s, volts, amps, temp_C, 25.0, 1, TURNIGY_AH))
    return records


def turnigy() -> None:
    """Print the drive cycle in pieces: OCV as others derived it, one resistance from the first piece."""
    table = columns(DATA / "bench" / "turnigy_soc_ocv_derived.csv")
    at = table["T"] == 25.0
    ocv = (table["SOC"][at][::-1], table["OCV"][at][::-1])
    records = turnigy_records()
    first = records[0]
    drawn = np.cumsum(first.current_A * np.diff(first.time_s, prepend=first.time_s[0])) / 3600.0
    sag = np.interp(1.0 - drawn / TURNIGY_AH, *ocv) - first.voltage_V
    ohm_Ah = float(np.polyfit(first.current_A, sag, 1)[0]) * TURNIGY_AH
    file = plain("turnigy", ocv, ohm_Ah, TURNIGY_AH, 3.0)
    print(row("Turnigy LA92 cycle at 25 °C, 4 pieces", "derived OCV, one resistance", records, file, 3.0))


def m100() -> None:
    """Print each aircraft's diagnosis: two aircraft teach the battery, the third is diagnosed."""
    flights = data.m100(DATA)
    for aircraft in sorted({f.aircraft for f in flights}):
        others = [f.flight for f in flights if f.aircraft != aircraft]
        mine = [from_flight(f.flight, M100_CELLS, M100_AH) for f in flights if f.aircraft == aircraft]
        mine = [replace(r, name=Path(r.name).name) for r in mine]
        size = RecordedPack(f"without {aircraft}", M100_CELLS, M100_AH, M100_CUTOFF_V)
        file = fit_battery(size, [], others).file
        print(row(f"M100 {aircraft}, {len(mine)} flights", "fit to the two other aircraft", mine, file, M100_CUTOFF_V),
              flush=True)  # fmt: skip


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=("study", "m100", "enertech", "turnigy"))
    only = parser.parse_args().only
    print(HEAD)
    for job in (enertech, turnigy, m100):
        if only in (None, job.__name__):
            job()
    if only in (None, "study"):
        study()
    return 0


if __name__ == "__main__":
    sys.exit(main())
