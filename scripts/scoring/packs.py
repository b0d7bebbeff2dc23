"""Packs that are flown again and again: the ledger's values, flight by flight, beside the truth."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from peers.columns import FloatArray

from scoring.lines import ours
from scoring.table import DASH, Table, figure
from scoring.truth import FLYING_A
from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.remembered import PackHealth
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.estimator import Estimator
from uavbatt.log_replay.run import steps
from uavbatt.packs import remembering
from uavbatt.packs.ledger import Ledger
from uavbatt.packs.records import LedgerFlight
from uavbatt.plan.endurance import TakeOff, endurance
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.prediction.load.scenarios import LoggedLoad
from uavbatt.records import Flight
from uavbatt.telemetry import read_log

PERIOD_S = 10.0
INSTANTS = (0.25, 0.5)
JUDGED_FROM = 3  # the first flight that two others came before


@dataclass(frozen=True, slots=True)
class Answer:
    """An Answer is what the simulator says of one flight: true power to its end, and the pack's true capacity."""

    time_s: FloatArray
    power_W: FloatArray
    start_s: float
    end_s: float
    ambient_C: float
    start_soc: float
    capacity: float
    is_emptied: bool


@dataclass(frozen=True, slots=True)
class Forecast:
    """A Forecast holds errors at the instants (shares of the flight), if inside the 90 % interval, the plan's error."""

    errors: tuple[float, ...]
    inside: tuple[bool, ...]
    plan_error: float


@dataclass(frozen=True, slots=True)
class Flown:
    """Flown holds one flight without and with the ledger, and what the ledger has after it."""

    pack: str
    number: int
    answer: Answer
    without: Forecast
    with_ledger: Forecast
    after: LedgerFlight | None
    known_Ah: tuple[float, float, float]  # after the flight: value, 5 %, 95 %


def flown(
    data: Path, pack: str, battery: BatteryFile, ledger: Ledger, say: Callable[[str], None], *, has_thermometer: bool
) -> list[Flown]:
    """Return all flights of a pack in order, each forecast with what those before it taught."""
    found = []
    for number, path in enumerate(sorted((data / "packs/practice" / pack).glob("flight_*.tlog")), 1):
        say(f"packs: {pack} flight {number}")
        flight, answer = read_log(path), _answer(data / "packs/answers", pack, number)
        if not has_thermometer:
            flight = replace(flight, samples=tuple(replace(sample, temp_C=math.nan) for sample in flight.samples))
        name = remembering.name_of(flight) or pack
        remembered = remembering.health_before(ledger, name, flight, battery)
        alone, with_ledger = (_forecast(flight, answer, battery, known) for known in (None, remembered))
        record = remembering.flight_for_ledger(battery, PackOptions(), flight).record
        after = ledger.save(name, record) if record is not None else None
        row = ledger.pack(name)
        seen = row.outlook if row is not None else None
        known_Ah = (seen.capacity_Ah, seen.capacity_lo_Ah, seen.capacity_hi_Ah) if seen else (math.nan,) * 3
        found.append(Flown(pack, number, answer, alone, with_ledger, after, known_Ah))
    return found


def _answer(folder: Path, pack: str, number: int) -> Answer:
    entries = json.loads((folder / "flights.json").read_text("utf-8"))
    told = next(e for e in entries if (e["pack"], e["flight"]) == (pack, number))
    with (folder / f"{pack}_{number:02d}.csv").open(newline="") as stream:
        rows = [(float(row["t"]), float(row["v"]), float(row["i"])) for row in csv.DictReader(stream)]
    time_s, volts, amps = np.array(rows).T
    return Answer(
        time_s=time_s,
        power_W=np.maximum(volts * amps, 0.0),
        start_s=float(time_s[np.argmax(amps > FLYING_A)]),
        end_s=told["end_s"],
        ambient_C=told["ambient_c"],
        start_soc=told["initial_soc"],
        capacity=told["capacity"],
        is_emptied=told["flown_s"] > told["end_s"],
    )


def _forecast(flight: Flight, answer: Answer, battery: BatteryFile, known: PackHealth | None) -> Forecast:
    """Return the forecast of the flight under its own true load, which tests the battery alone."""
    settings = ForecastSettings(LoggedLoad(answer.time_s, answer.power_W), forecast_period_s=PERIOD_S)
    estimator = Estimator(battery, PackOptions(), settings, remembered=known)
    lines = ours(list(steps(flight, estimator)))
    assert estimator.pack_size is not None
    length_s = answer.end_s - answer.start_s
    errors, inside = [], []
    for share in INSTANTS:
        row = int(np.searchsorted(lines.time_s, answer.start_s + share * length_s, side="right")) - 1
        true_s = answer.end_s - lines.time_s[row]
        errors.append(float(lines.remaining_s[row] - true_s) / length_s)
        assert lines.lo_s is not None and lines.hi_s is not None
        inside.append(bool(lines.lo_s[row] <= true_s <= lines.hi_s[row]))
    ahead = answer.time_s >= answer.start_s
    load = LoggedLoad(answer.time_s[ahead] - answer.start_s, answer.power_W[ahead])
    soc = min(answer.start_soc, 1.0)
    planned = endurance(battery, estimator.pack_size, load, TakeOff(answer.ambient_C, soc, remembered=known))
    return Forecast(tuple(errors), tuple(inside), planned.median_s / length_s - 1.0)


def table(found: Sequence[Flown]) -> Table:
    """Return the table of the flights, one by one."""
    head = ("flight", "true Ah", "known Ah after", "quarter", "half", "plan", "findings")
    rows = [_row(one) for one in found]
    note = (
        "Errors as shares of the flight, without -> with what the flights before taught; ✓ ✗: inside 90 %. "
        "Under the flight's own true load. e: flown to the end."
    )
    return Table("Packs remembered, flight by flight", head, tuple(rows), note)


def _row(one: Flown) -> tuple[str, ...]:
    true_Ah = one.answer.capacity * CAPACITY_AH_STATED
    value, low, high = one.known_Ah
    known = f"{value:.2f} [{low:.2f}, {high:.2f}] {'✓' if low <= true_Ah <= high else '✗'}"
    cells = [
        f"{100 * a:+.1f} -> {100 * b:+.1f} % {'✓' if inside else '✗'}"
        for a, b, inside in zip(one.without.errors, one.with_ledger.errors, one.with_ledger.inside, strict=True)
    ]
    planned = f"{100 * one.without.plan_error:+.0f} -> {100 * one.with_ledger.plan_error:+.0f} %"
    said = "; ".join(finding.words for finding in one.after.findings) if one.after is not None else ""
    name = f"{one.pack} {one.number}{'e' if one.answer.is_emptied else ''}, {one.answer.ambient_C:.0f} °C"
    return (name, f"{true_Ah:.2f}", known, *cells, planned, said or DASH)


CAPACITY_AH_STATED = 5.016  # by the vehicle, of which the truth is a share


def summary(found: Sequence[Flown], kept_back: Sequence[str]) -> Table:
    """Return the means of |error| from the third flight on, pack by pack."""
    head = ("pack", "quarter", "half", "plan", "inside", "capacity", "capacity inside")
    packs = list(dict.fromkeys(one.pack for one in found))
    rows = []
    for name in [*packs, "all"]:
        chosen = [one for one in found if name in (one.pack, "all") and one.number >= JUDGED_FROM]
        label = f"{name} (kept back)" if name in kept_back else name
        rows.append((label, *_means(chosen)))
    note = "Mean |error| of the flights from the third on, without -> with the ledger; capacity: as known after."
    return Table("Packs remembered, from the third flight on", head, tuple(rows), note)


def _means(chosen: Sequence[Flown]) -> tuple[str, ...]:
    def mean(values: Sequence[float]) -> str:
        return figure(100.0 * float(np.mean(np.abs(values))), 1)

    cells = [
        f"{mean([one.without.errors[k] for one in chosen])} -> {mean([one.with_ledger.errors[k] for one in chosen])} %"
        for k in range(len(INSTANTS))
    ]
    plans = [[getattr(one, which).plan_error for one in chosen] for which in ("without", "with_ledger")]
    inside = float(np.mean([one.with_ledger.inside for one in chosen]))
    true_Ah = [one.answer.capacity * CAPACITY_AH_STATED for one in chosen]
    capacity = [one.known_Ah[0] / true - 1.0 for one, true in zip(chosen, true_Ah, strict=True)]
    held = np.mean([one.known_Ah[1] <= true <= one.known_Ah[2] for one, true in zip(chosen, true_Ah, strict=True)])
    plan_words = f"{mean(plans[0])} -> {mean(plans[1])} %"
    return (*cells, plan_words, f"{inside:.0%}", f"{mean(capacity)} %", f"{held:.0%}")
