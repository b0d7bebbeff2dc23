"""A flight and the pack ledger: the pack's name, its health before the flight, and the record of the flight.

The record comes from a run of its own over the flight, with a prior that knows nothing of the pack. So it does not
depend on what the ledger holds, on the order of the logs, or on the number of cores.
"""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.remembered import UNKNOWN, PackHealth, health_of, of_known_cells, type_ohm
from uavbatt.battery.scaling import Pack
from uavbatt.battery.sizing.log_statements import size_from_rows
from uavbatt.battery.sizing.pack_size import PackOptions, PackSize, sized
from uavbatt.battery.state_space import Belief
from uavbatt.estimator import Estimator
from uavbatt.notice import Kind, kind_of
from uavbatt.packs.dates import future_words, is_in_future
from uavbatt.packs.evidence import evidence_of_flight
from uavbatt.packs.ledger import AnotherSize, Ledger, prior
from uavbatt.packs.records import FlightEvidence, FlightRecord
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.records import NAN, Estimate, Flight, PackFacts, Sample, Status
from uavbatt.telemetry.discharges import with_its_pack
from uavbatt.telemetry.quality.drawn import DrawnCharge, drawn, loaded_A

SILENT = ForecastSettings(forecast_period_s=1e6)  # no forecasts are needed
KEY_ROWS = 200
LEAST_CHARGE, LEAST_LOADED_S = 0.04, 60.0  # a shorter flight shows nothing of the pack
LONGEST_STEP_S = 60.0
BEGUN_SOC = 0.92  # a log that begins under load with less charge begins in the air, or nobody knows its rest
# Readings that a failed sensor wrote show another pack: with 100 s without a current 4.9 Ah were remembered as 4.4 Ah.
FAILED_SENSORS = {Kind.STUCK_VOLTAGE, Kind.STUCK_CURRENT, Kind.DEAD_CURRENT, Kind.TWO_BATTERIES}
MOST_FAILED_S = 20.0
LOOKS = 5  # times that the belief under load is read; more of them show no more


@dataclass(frozen=True, slots=True)
class FlightForLedger:
    """FlightForLedger holds the record of a flight, or the reason why there is none."""

    record: FlightRecord | None
    why_not: str = ""


class SeenFlight(NamedTuple):
    """SeenFlight holds what one run over the rows of a flight has shown of its pack.

    loaded : belief at LOOKS places under load; last : after the last row; failed_s : how long a sensor failed [s].
    """

    loaded: list[Belief]
    last: Belief | None
    soc_start: float
    soc_end: float
    failed_s: float


def name_of(flight: Flight, stated: str = "") -> str:
    """Return the name of the flight's pack: the stated one, else its serial number; empty if there is neither."""
    return stated or flight.identity.battery_serial


def health_before(ledger: Ledger, name: str, flight: Flight, battery: BatteryFile) -> PackHealth | None:
    """Return the health of the flight's pack by its earlier flights; None for a pack without any."""
    if not name:
        return None
    last = ledger.before(name, flight.identity.start_utc_s, key_of(flight.samples))
    return prior(last, flight.identity.start_utc_s, battery.certificate.content_sha256) if last is not None else None


def key_of(samples: Sequence[Sample]) -> str:
    """Return the key of a log: a hash of its first rows. A renamed log, or one cut later, has the same key."""
    text = ";".join(f"{s.voltage_V:.3f},{s.current_A:.2f}" for s in samples[:KEY_ROWS])
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def flight_for_ledger(
    battery: BatteryFile,
    options: PackOptions,
    flight: Flight,
    before: PackHealth | None = None,
    now_utc_s: float = NAN,
) -> FlightForLedger:
    """Return the record of a flight for the ledger, or the reason why the flight shows nothing of its pack.

    before : health of the pack in the ledger. Only the kind of its cells is used: one flight may not show it.
    now_utc_s : the time now [s since 1970]: a flight of the future would stay the last one; NaN is unknown
    """
    if is_in_future(flight.identity.start_utc_s, now_utc_s):
        return FlightForLedger(None, future_words(flight.identity.start_utc_s))
    flight, options = with_its_pack(flight), of_known_cells(options, before)
    rows, facts = _metered(flight), _rated_facts(flight)
    if not rows:
        return FlightForLedger(None, "no current was measured")
    last_loaded = _last_loaded(rows)
    if last_loaded is None:
        return FlightForLedger(None, f"less than {LEAST_LOADED_S:.0f} s under load")
    if facts.sag_compensated:
        return FlightForLedger(None, "the autopilot reports sag-compensated voltage, which hides the ohms")
    size = _size(battery, options, flight, rows)
    pack, total = sized(battery, size), drawn(rows, LONGEST_STEP_S)
    if total.charge_Ah < LEAST_CHARGE * size.capacity_Ah:
        return FlightForLedger(None, f"less than {LEAST_CHARGE:.0%} of the charge was drawn")
    estimator = Estimator(battery, options, SILENT, remembered=health_of(pack, UNKNOWN))
    estimator.update_facts(facts)
    seen = _seen(estimator, rows, last_loaded)
    if seen.failed_s > MOST_FAILED_S:
        return FlightForLedger(None, "a sensor failed in flight: voltage or current were not true")
    if not seen.loaded or estimator.pack_size is None or estimator.pack_size.cells != size.cells:
        return FlightForLedger(None, "no estimate could be made")
    is_loaded = _is_loaded(rows)
    under_load = [row for row, loaded in zip(rows, is_loaded, strict=True) if loaded]
    is_begun_later = bool(is_loaded[0]) and seen.soc_start < BEGUN_SOC
    said = evidence_of_flight(
        pack, seen.loaded, seen.last or seen.loaded[-1], _mean_temp_C(under_load),
        is_generic=battery.certificate.status == "generic", is_begun_later=is_begun_later,
    )  # fmt: skip
    return FlightForLedger(_record(battery, size, pack, flight, rows, under_load, total, seen, said))


def check_cells(
    ledger: Ledger,
    name: str,
    battery: BatteryFile,
    options: PackOptions,
    flight: Flight,
    before: PackHealth | None,
) -> None:
    """Raise AnotherSize if the flight cannot be saved under a name whose pack has another number of cells.

    before : health of the pack in the ledger, as for `flight_for_ledger`.
    """
    pack, rows = ledger.pack(name) if name else None, _metered(flight)
    if pack is None or _last_loaded(rows) is None:
        return
    cells = _size(battery, of_known_cells(options, before), flight, rows).cells
    if cells != pack.cells:
        raise AnotherSize(ledger.path, name, pack.cells, cells, 0)


def _metered(flight: Flight) -> list[Sample]:
    """Return the rows with voltage and current."""
    return [s for s in flight.samples if math.isfinite(s.voltage_V) and math.isfinite(s.current_A)]


def _size(battery: BatteryFile, options: PackOptions, flight: Flight, rows: Sequence[Sample]) -> PackSize:
    """Return the size of the pack by these rows and by what the vehicle has stated at the end of the flight."""
    return size_from_rows(battery, options, replace(flight, samples=tuple(rows)), _rated_facts(flight))


def _rated_facts(flight: Flight) -> PackFacts:
    """Return what the vehicle states at the end, of a new pack: the ledger measures what is left of one by itself."""
    return replace(flight.facts_at(math.inf), full_share=1.0)


def _seen(estimator: Estimator, rows: Sequence[Sample], last_loaded: int) -> SeenFlight:
    """Run the estimator over some rows; return what it has seen. last_loaded : index of the last row under load."""
    cuts = np.linspace(0, last_loaded + 1, LOOKS + 1).astype(int).tolist()
    estimates, beliefs = list[Estimate](), list[Belief | None]()
    for begin, end in itertools.pairwise(cuts):
        estimates += (estimate for estimate, _ in estimator.run(rows[begin:end]))
        beliefs.append(estimator.belief)
    failed_s = _failed_s(estimates)
    estimates += (estimate for estimate, _ in estimator.run(rows[last_loaded + 1 :]))
    loaded = [belief for belief in beliefs if belief is not None]
    return SeenFlight(loaded, estimator.belief, estimates[0].soc, estimates[-1].soc, failed_s)


def _failed_s(estimates: Sequence[Estimate]) -> float:
    """Return for how long a sensor failed in the rows of some estimates [s]."""
    return sum(
        min(b.time_s - a.time_s, LONGEST_STEP_S)
        for a, b in itertools.pairwise(estimates)
        if b.status is Status.REFUSED and kind_of(b.reason) in FAILED_SENSORS
    )


def _last_loaded(rows: Sequence[Sample]) -> int | None:
    """Return the index of the last row under load; None without LEAST_LOADED_S of load."""
    if len(rows) < 2:
        return None
    is_loaded = _is_loaded(rows)
    time_s = np.array([row.time_s for row in rows])
    steps_s = np.minimum(np.diff(time_s, append=time_s[-1]), LONGEST_STEP_S)
    if float(steps_s[is_loaded].sum()) < LEAST_LOADED_S:
        return None
    return int(np.flatnonzero(is_loaded)[-1])


def _is_loaded(rows: Sequence[Sample]) -> NDArray[np.bool_]:
    """Return which rows are under load."""
    current_A = np.array([row.current_A for row in rows])
    return np.asarray(current_A > loaded_A(current_A))


def _mean_temp_C(rows: Sequence[Sample]) -> float:
    temps = [row.temp_C for row in rows if math.isfinite(row.temp_C)]
    return float(np.mean(temps)) if temps else NAN


def _record(
    battery: BatteryFile,
    size: PackSize,
    pack: Pack,
    flight: Flight,
    rows: Sequence[Sample],
    under_load: Sequence[Sample],
    total: DrawnCharge,
    seen: SeenFlight,
    said: FlightEvidence,
) -> FlightRecord:
    """Return the record of a flight from its metered rows, of which some are `under_load`, and what was `drawn`."""
    temps = [row.temp_C for row in rows if math.isfinite(row.temp_C)]
    weak_cell, weak_V = _weak_cell(under_load)
    return FlightRecord(
        key=key_of(flight.samples),
        told=said,
        cells=size.cells,
        rated_Ah=size.capacity_Ah,
        type_ohm=type_ohm(pack),
        battery=size.battery,
        battery_sha256=battery.certificate.content_sha256,
        start_utc_s=flight.identity.start_utc_s,
        duration_s=rows[-1].time_s - rows[0].time_s,
        source=flight.source.replace("\\", "/").rpartition("/")[2],
        soc_start=seen.soc_start,
        soc_end=seen.soc_end,
        charge_Ah=total.charge_Ah,
        energy_Wh=total.energy_Wh,
        temp_mean_C=_mean_temp_C(under_load),
        temp_max_C=max(temps, default=NAN),
        weak_cell=weak_cell,
        weak_cell_V=weak_V,
        cycles=flight.identity.battery_cycles,
        fullest_cell_V=size.fullest_cell_V,
    )


def _weak_cell(rows: Sequence[Sample]) -> tuple[int, float]:
    """Return the number of the lowest cell in the last third of some rows, from 1, and how far below the mean [V]."""
    late = [row.cell_voltages_V for row in rows[2 * len(rows) // 3 :] if len(row.cell_voltages_V) > 1]
    counts = {len(cells) for cells in late}
    if len(counts) != 1:
        return 0, NAN
    means = np.median(np.array(late), axis=0)
    return int(np.argmin(means)) + 1, float(np.mean(means) - np.min(means))
