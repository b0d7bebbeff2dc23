"""One log -> one row. Whatever is wrong with a log ends as the reason in its row, never as the end of the run."""

from __future__ import annotations

import itertools
import json
import math
import re
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import PurePath

import numpy as np

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.sizing import PackOptions
from uavbatt.errors import UavbattError
from uavbatt.estimator import Estimator
from uavbatt.fleet.logs import LogFile, Unreadable
from uavbatt.fleet.row import BAD, CHECKPOINTS, LOST, START_FORMAT, FlightRow
from uavbatt.log_replay import Outcome, ReplayedRow, engine_for, outcome, steps
from uavbatt.packs.exchange import plain_flight
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.records import NAN, Flight
from uavbatt.remembering import taught
from uavbatt.telemetry.info import charges_Ah, describe, gap_limit_s, median_step_s
from uavbatt.telemetry.read import read_bytes

MUCH_REFUSED, HIGH_NIS = 0.2, 3.0
EMPTY_SOC = 0.05
OPTIMISTIC_S = 60.0
RESISTANCE_GROWN = 1.4
MANY_FLIGHTS = 20  # of 20 minutes: compiled code spares 0.2 s in each, and takes 1 s to be loaded


@dataclass(frozen=True, slots=True)
class Job:
    """One job: every log of a run is replayed with these settings."""

    battery: BatteryFile
    options: PackOptions
    settings: ForecastSettings = ForecastSettings()
    by: str = ""  # the column that names the aircraft
    aircraft_pattern: str = ""  # what it matches in a log's name is the aircraft; a group in it, only that
    flights_each: int = 1  # about how many logs a worker will fly
    teaches: bool = False  # what each flight says of its pack is worked out as well


def fly_log(log: LogFile, job: Job) -> FlightRow:
    """The row of one log; never raises for anything that a log can cause."""
    try:
        return _flown(read_bytes(log.name, log.read()), log, job)
    except Unreadable as error:
        return bad(log, job, str(error).removeprefix(f"{log.name}: "), LOST)
    except UavbattError as error:
        reason = str(error).removeprefix(f"{log.name}: ")
    except Exception as error:  # a row with its reason, whatever it is: one log must not end the others
        reason = f"{type(error).__name__} in uavbatt itself: {error}"
    return bad(log, job, reason)


def bad(log: LogFile, job: Job, reason: str, status: str = BAD) -> FlightRow:
    """The row of a log that could not be flown."""
    aircraft, reason = _aircraft(log, job, None), " ".join(reason.split())
    return FlightRow(file=log.name, status=status, reason=reason, look=reason, aircraft=aircraft, size_bytes=log.size)


def _flown(flight: Flight, log: LogFile, job: Job) -> FlightRow:
    engine = engine_for(is_long=job.flights_each >= MANY_FLIGHTS)
    estimator = Estimator(job.battery, job.options, job.settings, engine)
    run = list(steps(flight, estimator))
    pack = estimator.pack_size
    if pack is None or estimator.belief is None:
        return bad(log, job, "expected at least one row with a voltage")
    found = outcome(run, pack.cutoff_V)
    who, info = flight.identity, describe(flight)
    last = run[-1].estimate
    limit_s = gap_limit_s(median_step_s(flight.samples))
    charge_Ah, _ = charges_Ah(flight.samples, limit_s)
    energy_Wh, flown_s = _energy(flight, limit_s)
    temps = [s.estimate.temp_C for s in run if math.isfinite(s.estimate.temp_C)]
    row = FlightRow(
        file=log.name,
        kind=flight.kind,
        aircraft=_aircraft(log, job, who.system),
        system=who.system,
        hardware=who.hardware,
        firmware=who.firmware,
        battery_serial=who.battery_serial,
        instance=flight.instance,
        instances=" ".join(str(i) for i in flight.instances),
        start_utc=_utc(who.start_utc_s),
        duration_s=found.duration_s,
        rows=found.rows,
        battery=pack.battery,
        certificate=pack.status,
        cells=pack.cells,
        capacity_Ah=pack.capacity_Ah,
        cutoff_V=pack.cutoff_V,
        charge_Ah=charge_Ah,
        energy_Wh=energy_Wh,
        mean_power_W=energy_Wh * 3600.0 / flown_s if flown_s > 0.0 else NAN,
        temp_C=float(np.median(temps)) if temps else NAN,
        end_voltage_V=found.end_voltage_V,
        end_soc=found.end_soc,
        end_soc_sd=found.end_soc_sd,
        end_of_flight_s=found.end_of_flight_s,
        refused_share=found.refused_in_air,
        mean_nis=found.mean_nis,
        resistance_scale=last.resistance_scale,
        resistance_scale_sd=last.resistance_scale_sd,
        capacity_scale=last.capacity_scale,
        capacity_scale_sd=last.capacity_scale_sd,
        trust=info.trust,
        skipped_bytes=flight.skipped_bytes,
        warnings="; ".join(_warnings(flight, run)),
        taught=_taught(flight, job),
        size_bytes=log.size,
    )
    row = _scored(_identified(row, job), found)
    return replace(row, look="; ".join(_reasons(row, info.reasons)))


def _taught(flight: Flight, job: Job) -> str:
    """Return what a flight of a known pack says of it, as JSON; empty where it says nothing."""
    if not (job.teaches and flight.identity.battery_serial):
        return ""
    found = taught(job.battery, job.options, flight).record
    return json.dumps(plain_flight(found)) if found is not None else ""


def _identified(row: FlightRow, job: Job) -> FlightRow:
    """The row with the name of its aircraft, and who gave it."""
    named = str(getattr(row, job.by) or "") if job.by else ""
    if named:
        return replace(row, aircraft=named, aircraft_from="--by")
    return replace(row, aircraft_from="--aircraft" if job.aircraft_pattern else "folder")


def _energy(flight: Flight, limit_s: float) -> tuple[float, float]:
    """Energy drawn [Wh] over all steps that are no gap, and their time [s]; NaN without a current."""
    joules, flown_s = 0.0, 0.0
    for a, b in itertools.pairwise(flight.samples):
        step_s = b.time_s - a.time_s
        step_J = 0.5 * (a.voltage_V * a.current_A + b.voltage_V * b.current_A) * step_s
        if step_s <= limit_s and math.isfinite(step_J):
            joules, flown_s = joules + step_J, flown_s + step_s
    return (joules / 3600.0, flown_s) if flown_s > 0.0 else (NAN, 0.0)


def _scored(row: FlightRow, found: Outcome) -> FlightRow:
    """The row with the errors of the forecasts before the end that the log shows."""
    scored: dict[str, float | bool] = {}
    for checkpoint in found.checkpoints:
        key = next(k for k in CHECKPOINTS if checkpoint.label.startswith(k))
        scored[f"inside_{key}"] = checkpoint.inside and math.isfinite(checkpoint.remaining_s)
        scored[f"error_{key}_s"] = checkpoint.error_s
    return replace(row, **scored)  # type: ignore[arg-type]  # names and types are those of CHECKPOINTS


def _warnings(flight: Flight, run: list[ReplayedRow]) -> list[str]:
    return list(dict.fromkeys([w for s in run for w in s.estimate.warnings] + list(flight.notes)))


def _reasons(row: FlightRow, doubts: tuple[str, ...]) -> list[str]:
    """Return the reasons why a person should look at this flight; empty when it is like any other."""
    found = []
    if row.end_soc < EMPTY_SOC:
        found.append(f"landed nearly empty: state of charge {row.end_soc:.2f}")
    elif math.isfinite(row.end_of_flight_s) and row.duration_s - row.end_of_flight_s > 30.0:
        found.append("flew on below the cut-off voltage")
    if row.refused_share > MUCH_REFUSED:
        found.append(f"{row.refused_share:.0%} of the forecasts in the air refused")
    if row.mean_nis > HIGH_NIS:
        found.append(f"the battery file explains it badly (mean NIS {row.mean_nis:.1f})")
    # a generic or edited file is no measure: packs differ by more than that when new
    is_measured = row.certificate not in ("generic", "edited")
    if is_measured and row.resistance_scale - 2.0 * row.resistance_scale_sd > RESISTANCE_GROWN:
        found.append(f"resistance {row.resistance_scale:.2f} times the battery file's")
    if row.error_120_s > OPTIMISTIC_S and row.inside_120 is False:
        found.append(f"two minutes before the end the forecast was {row.error_120_s:.0f} s too long")
    if row.trust == "no":
        found.append("not to be trusted: " + (doubts[0] if doubts else "see `uavbatt info`"))
    return found


def _aircraft(log: LogFile, job: Job, system: int | None) -> str:
    """Which aircraft flew: by the caller's pattern, else the log's folder, with MAVLink's number where it says more."""
    if job.aircraft_pattern:
        match = re.search(job.aircraft_pattern, log.name)
        return (match[1] if match.re.groups and match[1] else match[0]) if match else ""
    folder = PurePath(log.name).parent.name
    return f"{folder} / {system}" if system is not None and system != 1 else folder


def _utc(start_s: float) -> str:
    if not math.isfinite(start_s):
        return ""
    return datetime.fromtimestamp(round(start_s), UTC).strftime(START_FORMAT)
