"""Close the loop: the extended battery file, and the error before and after on records that were left out.

Each record is predicted with the values from the other records, so that no record judges itself. Remaining time is
judged by a replay of the log with its load known (`--load log`); the remaining error is that of the battery model.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import msgspec
import numpy as np

from uavbatt.battery.battery_file import BatteryFile, Certificate, EffectEntry, Verdict
from uavbatt.battery.effects import EFFECTS
from uavbatt.battery.model import Array
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.diagnosis.diagnosis import Diagnosis
from uavbatt.diagnosis.refit import residual
from uavbatt.diagnosis.refit.candidates import QUANTITIES
from uavbatt.diagnosis.refit.heldout import open_loop
from uavbatt.diagnosis.refit.problem import Refit
from uavbatt.diagnosis.search.worth import left_out_values
from uavbatt.engine import PLAIN, Engine
from uavbatt.estimator import Estimator
from uavbatt.fitting.assemble import rounded
from uavbatt.log_replay.load_options import logged_load
from uavbatt.log_replay.run import steps
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.prediction.load.waits import in_air_s
from uavbatt.records import NAN, Flight
from uavbatt.scoring.end_of_flight import end_of_flight
from uavbatt.telemetry.quality.drawn import loaded_A

# Rows are thinned to one in ROW_S, as the model is slower; one forecast a minute is judged, the first after SETTLING_S.
ROW_S, FORECAST_S, SETTLING_S = 2.0, 60.0, 60.0


@dataclass(frozen=True, slots=True)
class HeldOutErrors:
    """HeldOutErrors holds errors on held-out records; NaN if there is nothing to judge by (no end, no temperature).

    `coverage` is the share of forecasts whose interval holds the true remaining time.
    """

    voltage_rmse_V: float
    temp_rmse_K: float
    remaining_mae_s: float
    coverage: float


@dataclass(frozen=True, slots=True)
class ClosedLoop:
    """ClosedLoop holds the errors before and after the extension, and the names of the held-out records."""

    before: HeldOutErrors
    after: HeldOutErrors
    held_out: tuple[str, ...]

    @property
    def worse(self) -> str:
        """Name the errors on held-out records that became larger, as `voltage 101 -> 114 mV`; "" if none."""
        b, a = self.before, self.after
        pairs = (
            ("voltage", 1000.0 * b.voltage_rmse_V, 1000.0 * a.voltage_rmse_V, "mV"),
            ("remaining time", b.remaining_mae_s, a.remaining_mae_s, "s"),
        )
        return ", ".join(f"{name} {old:.0f} -> {new:.0f} {unit}" for name, old, new, unit in pairs if new > old + 0.5)


def values_by_name(fit: Refit, values: Array) -> dict[str, dict[str, float]]:
    """Return effect -> quantity -> value for the values [freed] of a refit, without the start of charge of a flight."""
    by_name = {QUANTITIES[f.index].name: float(v) for f, v in zip(fit.candidate.freed, values, strict=True)}
    return {
        name: {
            q.name: by_name[q.name] for q in EFFECTS[name].quantities if q.name in by_name and name != "initial_charge"
        }
        for name in fit.candidate.names
    }


def with_effects(file: BatteryFile, effects: dict[str, dict[str, float]], errors: dict[str, float]) -> BatteryFile:
    """Return the file with effects added or resized; effects without a shared value (start of charge) are left out.

    effects : effect -> quantity -> value; errors : standard error by quantity.
    """
    entries = {entry.name: entry for entry in file.effects}
    for name, values in effects.items():
        if not values:
            continue
        old = entries.get(name)
        neutral = {q.name: q.prior if q.prior_sd == 0.0 else q.neutral for q in EFFECTS[name].quantities}
        parameters = {**(old.parameters if old else neutral), **values}
        entries[name] = EffectEntry(
            name=name,
            parameters={k: rounded(v) for k, v in parameters.items()},
            standard_error={
                **(old.standard_error if old else {}),
                **{k: rounded(errors[k]) for k in values if k in errors},
            },
        )
    return msgspec.structs.replace(file, effects=list(entries.values()))


def extended(file: BatteryFile, diagnosis: Diagnosis, worse: str = "") -> BatteryFile:
    """Return the battery file with the found effects, or the file itself if none was found; flights do not certify it.

    worse : the errors that became larger on held-out records (`ClosedLoop.worse`); the file states them.
    """
    if diagnosis.verdict == "no_missing_effect":
        return file
    fit = diagnosis.after
    names = [QUANTITIES[f.index].name for f in fit.candidate.freed]
    errors = dict(zip(names, map(float, fit.errors()), strict=True)) if names else {}
    values = fit.values()[0] if names else np.zeros(0)
    by_name = values_by_name(fit, values)
    new = with_effects(file, by_name, errors)
    discrepancy = file.discrepancy
    if diagnosis.verdict == "undeclared_effect":  # unexplained error widens every interval
        share = file.battery.cells_series / float(diagnosis.problem.pack.installation.cells)
        discrepancy = msgspec.structs.replace(
            discrepancy,
            voltage_rmse_V=rounded(max(discrepancy.voltage_rmse_V, residual.size_V(diagnosis.residual_after) * share)),
            temperature_rmse_K=rounded(
                max(discrepancy.temperature_rmse_K, _known(residual.size_K(diagnosis.residual_after)))
            ),
            source=f"{discrepancy.source}; widened by what diagnosis left unexplained",
        )
    carried = [n for n in fit.candidate.names if by_name[n]]
    remark = f"diagnosed on {len(diagnosis.problem.evidence.names)} records: {', '.join(carried) or 'nothing to add'}"
    dropped = [n for n in fit.candidate.names if not by_name[n]]
    doubted = [f"predicts held-out records worse: {worse}"] if worse else []
    remarks = [*file.battery.remarks, remark, *doubted, *(f"found, but each flight has its own: {n}" for n in dropped)]
    return msgspec.structs.replace(
        new,
        battery=msgspec.structs.replace(file.battery, remarks=remarks),
        discrepancy=discrepancy,
        certificate=Certificate(status=_ungated(file), data_sha256=file.certificate.data_sha256),
    )


def gated(new: BatteryFile, diagnosis: Diagnosis, verdicts: list[Verdict]) -> BatteryFile:
    """Return the extended file with the gate's verdicts: `certified` if all pass and nothing is left unexplained."""
    passed = bool(verdicts) and all(v.verdict == "pass" for v in verdicts)
    certificate = msgspec.structs.replace(
        new.certificate,
        status="certified" if passed and diagnosis.verdict != "undeclared_effect" else _ungated(new),
        validated_ambient_C=sorted({v.ambient_C for v in verdicts if v.ambient_C is not None}) if passed else [],
        verdicts=verdicts,
    )
    return msgspec.structs.replace(new, certificate=certificate)


def _ungated(file: BatteryFile) -> Literal["fitted", "edited"]:
    """Return the status before any gate: from data, but not better than the status of the file it is based on."""
    return "edited" if file.status == "edited" else "fitted"


def _known(value: float) -> float:
    return value if math.isfinite(value) else 0.0


def remaining(
    flight: Flight, file: BatteryFile, options: PackOptions, engine: Engine = PLAIN
) -> tuple[list[float], list[bool]]:
    """Return absolute errors [s] and interval hits of one flight's forecasts; empty when the log has no end."""
    thin, last = [], -math.inf
    for s in flight.samples:
        if s.time_s - last >= ROW_S - 1e-6:
            thin.append(s)
            last = s.time_s
    rows = [s for s in thin if math.isfinite(s.voltage_V) and math.isfinite(s.current_A)]
    time_s, volts, amps = (np.array([getattr(s, n) for s in rows]) for n in ("time_s", "voltage_V", "current_A"))
    cutoff_V = options.cutoff_V
    end_s = end_of_flight(time_s, volts, amps, cutoff_V=cutoff_V, min_current_A=loaded_A(amps))
    if not math.isfinite(end_s):
        return [], []
    flight = replace(flight, samples=tuple(thin))
    load = logged_load(flight, file)
    estimator = Estimator(file, options, ForecastSettings(load, forecast_period_s=FORECAST_S), engine)
    take_off_s = float(time_s[amps > loaded_A(amps)][0])
    errors, hits, due = [], [], take_off_s + SETTLING_S
    for step in steps(flight, estimator):
        line = step.remaining
        settled_s = (over_s + SETTLING_S for begin_s, over_s in load.waits if begin_s <= line.time_s)
        due = max([due, *settled_s])
        if line.time_s < due or line.time_s >= end_s:
            continue
        due += FORECAST_S
        true_s = float(in_air_s(line.time_s, end_s, load.waits))
        is_known = math.isfinite(line.remaining_s)
        errors.append(abs(line.remaining_s - true_s) if is_known else true_s)
        hits.append(is_known and line.remaining_lo_s <= true_s <= line.remaining_hi_s)
    return errors, hits


def judge(
    diagnosis: Diagnosis,
    file: BatteryFile,
    flights: list[Flight],
    options: PackOptions,
    progress: Callable[[str], None] | None = None,
    engine: Engine = PLAIN,
) -> ClosedLoop:
    """Judge the error before and after on every record, each left out in turn; `engine` replays the flights."""
    problem, fit = diagnosis.problem, diagnosis.after
    values = left_out_values(problem, fit)
    by_name = dict(zip(problem.evidence.names, values, strict=True))
    pairs: dict[str, tuple[list[float], list[bool]]] = {"before": ([], []), "after": ([], [])}
    for flight in flights:
        if flight.source not in by_name:
            continue
        if progress is not None:
            progress(f"replay of {flight.source}")
        new = with_effects(file, values_by_name(fit, by_name[flight.source]), {})
        for key, used in (("before", file), ("after", new)):
            if key == "after" and new is file:
                continue
            errors, hits = remaining(flight, used, options, engine)
            pairs[key][0].extend(errors)
            pairs[key][1].extend(hits)
    plain = open_loop(problem, diagnosis.before, [np.zeros(0)] * len(values))
    fixed = open_loop(problem, fit, values)
    return ClosedLoop(_error(*plain, *pairs["before"]), _error(*fixed, *pairs["after"]), problem.evidence.names)


def _error(voltage_V: float, temp_K: float, errors: list[float], hits: list[bool]) -> HeldOutErrors:
    return HeldOutErrors(
        voltage_V, temp_K, float(np.mean(errors)) if errors else NAN, float(np.mean(hits)) if hits else NAN
    )
