"""One log -> a row for each of its flights. An error in a log becomes the reason in its row, and never ends the run."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import PurePath

import numpy as np

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.remembered import PackHealth
from uavbatt.battery.sizing.pack_size import PackOptions, PackSize
from uavbatt.battery.vehicle_file import VehicleFile
from uavbatt.errors import UavbattError
from uavbatt.fleet.logs import LogFile, Unreadable
from uavbatt.fleet.look import doubts_of_log, reasons
from uavbatt.fleet.row import BAD, CHECKPOINTS, LOST, START_FORMAT, FlightRow
from uavbatt.log_replay.flights import ReplayedFlight, flights_of
from uavbatt.log_replay.load_options import stated_load
from uavbatt.log_replay.outcome import Outcome, outcome
from uavbatt.log_replay.run import ReplayedRow, engine_for, estimator_for, steps
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.records import NAN, Flight, Sample
from uavbatt.telemetry.formats.packed import Content, as_log
from uavbatt.telemetry.join import Wiring, bytes_joined
from uavbatt.telemetry.quality.drawn import drawn, loaded_A
from uavbatt.telemetry.quality.info import describe, gap_limit_s, median_step_s
from uavbatt.telemetry.read import read_bytes

MANY_FLIGHTS = 20  # flights of 20 minutes: compiled code saves 0.2 s in each, and takes 1 s to load


@dataclass(frozen=True, slots=True)
class Job:
    """A Job holds the settings with which every log of a run is replayed."""

    battery: BatteryFile
    options: PackOptions
    settings: ForecastSettings = ForecastSettings()
    load: str = "learned"  # the load to come, as in `replay --load`
    vehicle: VehicleFile | None = None
    instance: int | None = None
    join: str = ""  # wiring of the batteries, if all of a log are one pack
    by: str = ""  # the column that names the aircraft
    aircraft_pattern: str = ""  # its match in a log's name, or its group, names the aircraft
    flights_each: int = 1  # number of logs that a worker will replay, about


@dataclass(frozen=True, slots=True)
class RememberedPack:
    """RememberedPack holds what the ledger knows of a flight's pack: its health before, and this flight's findings."""

    health: PackHealth | None = None
    findings: tuple[str, ...] = ()


NOT_MET = RememberedPack()


def fly_log(log: LogFile, job: Job, met: Sequence[RememberedPack] = ()) -> tuple[FlightRow, ...]:
    """Return the row of each flight of a log; no content of the log makes it raise an error.

    met : the pack of each flight, where a ledger knows it
    """
    try:
        name, data = as_log(log.name, log.read())
        return _flown(read_data(name, data, job), len(data), log, job, met)
    except Unreadable as error:
        return (bad_row(log, job, _reason(error, log), LOST),)
    except UavbattError as error:
        reason = _reason(error, log)
    except Exception as error:  # the reason goes into the row: one log must not end the run
        reason = f"{type(error).__name__} in uavbatt itself: {error}"
    return (bad_row(log, job, reason),)


def _reason(error: UavbattError, log: LogFile) -> str:
    """Return the text of the error without the name of the log, which the row has already."""
    message = str(error)
    for name in (f"{log.name}: ", f"{log.name.removesuffix('.gz')}: ", f"{log.name}/"):
        message = message.removeprefix(name)
    return message


def read(log: LogFile, job: Job) -> Flight:
    """Read the flight of a log, as the job asks for it.

    Raises BadInput if it is no log, Unreadable if its bytes cannot be read.
    """
    return read_data(*as_log(log.name, log.read()), job)


def read_data(name: str, data: Content, job: Job) -> Flight:
    """Read the flight of a log's bytes, as the job asks for it. Raises BadInput if it is no log."""
    return bytes_joined(name, data, Wiring(job.join)) if job.join else read_bytes(name, data, job.instance)


def bad_row(log: LogFile, job: Job, reason: str, status: str = BAD) -> FlightRow:
    """Return the row of a log that could not be replayed."""
    aircraft, reason = _aircraft(log, job, None), " ".join(reason.split())
    return FlightRow(file=log.name, status=status, reason=reason, look=reason, aircraft=aircraft, size_bytes=log.size)


def lost_rows(log: LogFile, reason: str, job: Job) -> tuple[FlightRow]:
    """Return the row of a log whose worker died, which the next run flies again."""
    return (bad_row(log, job, reason, LOST),)


def _flown(
    flight: Flight, size_bytes: int, log: LogFile, job: Job, met: Sequence[RememberedPack]
) -> tuple[FlightRow, ...]:
    """Return the row of each flight of a log, which has `size_bytes` unpacked.

    Raises UsageError for a statement that the first rows contradict.
    """
    engine = engine_for(is_long=job.flights_each >= MANY_FLIGHTS)
    load = stated_load(job.load, flight, job.vehicle, job.battery)
    packs = tuple(met) or (NOT_MET,)
    settings = replace(job.settings, load=load)
    estimator = estimator_for(flight, job.battery, job.options, settings, packs[0].health, engine)
    run = list(steps(flight, estimator, [one.health for one in packs[1:]]))
    pack = estimator.pack_size
    if pack is None or estimator.belief is None:
        return (bad_row(log, job, "expected at least one row with the voltage of a pack"),)
    whole = ReplayedFlight(flight, run, outcome(run, pack.cutoff_V, job.settings.reserve_soc))
    flights = flights_of(whole, pack.cutoff_V)
    packs += (NOT_MET,) * (len(flights) - len(packs))  # no ledger knows these
    return tuple(
        _row(part, pack, number, size_bytes, log, job, one.findings)
        for number, (part, one) in enumerate(zip(flights, packs, strict=True), start=1)
    )


def _row(
    part: ReplayedFlight, pack: PackSize, number: int, size_bytes: int, log: LogFile, job: Job, findings: Sequence[str]
) -> FlightRow:
    """Return the row of a replayed flight, the one with this number in its log; `findings`: those of the ledger."""
    flight, run, ending = part
    info = describe(flight)
    row = replace(
        _figures(flight, run, pack, ending),
        file=log.name,
        flight=number,
        aircraft=_aircraft(log, job, flight.identity.system),
        trust=info.trust,
        size_bytes=log.size,
    )
    row = _scored(_identified(row, job), ending)
    doubts = doubts_of_log(flight, size_bytes, time.time())
    return replace(row, look="; ".join([*findings, *reasons(row, info.reasons, ending.flown_on_s), *doubts]))


def _figures(flight: Flight, run: list[ReplayedRow], pack: PackSize, ending: Outcome) -> FlightRow:
    """Return the row of a replayed flight, without its aircraft and scores."""
    who, last = flight.identity, run[-1].estimate
    limit_s = gap_limit_s(median_step_s(flight.samples))
    total = drawn(flight.samples, limit_s)
    temps = [s.estimate.temp_C for s in run if math.isfinite(s.estimate.temp_C)]
    return FlightRow(
        file=flight.source,
        kind=flight.kind,
        system=who.system,
        hardware=who.hardware,
        firmware=who.firmware,
        battery_serial=who.battery_serial,
        instance=flight.instance,
        instances=" ".join(str(i) for i in flight.instances),
        start_utc=_utc(who.start_utc_s),
        duration_s=ending.duration_s,
        air_s=ending.air_s,
        rows=ending.rows,
        battery=pack.battery,
        certificate=pack.status,
        cells=pack.cells,
        capacity_Ah=pack.capacity_Ah,
        cutoff_V=pack.cutoff_V,
        charge_Ah=total.charge_Ah,
        energy_Wh=total.energy_Wh,
        mean_power_W=_loaded_W(flight.samples, limit_s),
        temp_C=float(np.median(temps)) if temps else NAN,
        end_voltage_V=ending.end_voltage_V,
        end_soc=ending.end_soc,
        end_soc_sd=ending.end_soc_sd,
        end_of_flight_s=ending.end_of_flight_s,
        refused_share=ending.refused_in_air,
        mean_nis=ending.mean_nis,
        resistance_scale=last.resistance_scale,
        resistance_scale_sd=last.resistance_scale_sd,
        capacity_scale=last.capacity_scale,
        capacity_scale_sd=last.capacity_scale_sd,
        skipped_bytes=flight.skipped_bytes,
        warnings="; ".join(_warnings(flight, run)),
    )


def _loaded_W(samples: Sequence[Sample], limit_s: float) -> float:
    """Return the mean power under load [W]; NaN if no current tells. A step longer than `limit_s` [s] is a gap."""
    least_A = loaded_A(np.array([sample.current_A for sample in samples]))
    total = drawn((sample for sample in samples if sample.current_A > least_A), limit_s)
    return total.energy_Wh * 3600.0 / total.time_s if total.time_s > 0.0 else NAN


def _identified(row: FlightRow, job: Job) -> FlightRow:
    """Return the row with the name of its aircraft, and where that name comes from."""
    aircraft = str(getattr(row, job.by) or "") if job.by else ""
    if aircraft:
        return replace(row, aircraft=aircraft, aircraft_from="--by")
    return replace(row, aircraft_from="--aircraft" if job.aircraft_pattern else "folder")


def _scored(row: FlightRow, ending: Outcome) -> FlightRow:
    """Return the row with the errors of the forecasts, if the log shows the end of flight."""
    scored: dict[str, float | bool] = {}
    for checkpoint in ending.checkpoints:
        key = next(k for k in CHECKPOINTS if checkpoint.label.startswith(k))
        scored[f"inside_{key}"] = checkpoint.inside and math.isfinite(checkpoint.remaining_s)
        scored[f"error_{key}_s"] = checkpoint.error_s
    return replace(row, **scored)  # type: ignore[arg-type]  # names and types are those of CHECKPOINTS


def _warnings(flight: Flight, run: list[ReplayedRow]) -> list[str]:
    return list(dict.fromkeys([w for s in run for w in s.estimate.warnings] + list(flight.notes)))


def _aircraft(log: LogFile, job: Job, system: int | None) -> str:
    """Return the name of the aircraft: by the user's pattern, else the log's folder, with the system id if not 1."""
    if job.aircraft_pattern:
        match = re.search(job.aircraft_pattern, log.name)
        return (match[1] if match.re.groups and match[1] else match[0]) if match else ""
    folder = PurePath(log.name).parent.name
    return f"{folder} / {system}" if system is not None and system != 1 else folder


def _utc(start_s: float) -> str:
    if not math.isfinite(start_s):
        return ""
    return datetime.fromtimestamp(round(start_s), UTC).strftime(START_FORMAT)
