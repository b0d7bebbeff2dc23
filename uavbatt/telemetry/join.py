"""Several batteries of one aircraft joined into one pack, as the motors see them.

In parallel their currents add up and their voltage is one; in series their voltages add up and their current is one.
Rows are those of the first battery, each with the others' latest values, so that no row depends on a later one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from enum import StrEnum
from itertools import pairwise
from pathlib import Path

from uavbatt.errors import UsageError
from uavbatt.records import NAN, Flight, PackFacts, Sample
from uavbatt.telemetry.read import Content, content_of, read_bytes

PAIRED_S, PAIRED_ROWS = 2.0, 1.5  # an older reading of another battery is not used
CHANGED_S = 10.0  # of packs that are changed together, the first rows come within this time
ALIKE = 0.1  # wires and sensors tell packs in parallel apart by a few percent


class Wiring(StrEnum):
    """Wiring says how the batteries of an aircraft are connected."""

    PARALLEL = "parallel"
    SERIES = "series"


def read_joined(path: str | Path, wiring: Wiring, system: int | None = None) -> Flight:
    """Read all batteries of a log as one pack.

    Raises UsageError for a log of one battery, else as `read_log`.
    """
    return bytes_joined(*content_of(Path(path)), wiring, system)


def bytes_joined(source: str, data: Content, wiring: Wiring, system: int | None = None) -> Flight:
    """Read all batteries of a log in memory as one pack; `source` is its name. Otherwise as `read_joined`."""
    instances = read_bytes(source, data, None, system).instances
    if len(instances) < 2:
        raise UsageError(f"{source}: one battery: there is nothing to join in {wiring}")
    return joined([read_bytes(source, data, instance, system) for instance in instances], wiring)


def joined(flights: Sequence[Flight], wiring: Wiring) -> Flight:
    """Return the batteries `flights` of one log as one pack.

    Raises UsageError for voltages that cannot be in parallel.
    """
    typical_V = [_typical_V(flight) for flight in flights]
    if wiring is Wiring.PARALLEL and max(typical_V) > (1.0 + ALIKE) * min(typical_V):
        shown = " and ".join(f"{v:.1f} V" for v in typical_V)
        raise UsageError(f"{flights[0].source}: batteries of {shown} are not in parallel")
    lead, others = flights[0], [flight.samples for flight in flights[1:]]
    positions = [0] * len(others)
    patience_s = max(PAIRED_S, PAIRED_ROWS * _row_s(lead.samples))
    rows = []
    for sample in lead.samples:
        together = [sample]
        for k, samples in enumerate(others):
            while positions[k] < len(samples) and samples[positions[k]].time_s <= sample.time_s:
                positions[k] += 1
            latest = samples[positions[k] - 1] if positions[k] else Sample(-math.inf, NAN)
            fresh = sample.time_s - latest.time_s <= patience_s
            together.append(latest if fresh else Sample(sample.time_s, NAN))
        rows.append(_row(together, wiring))
    named = ", ".join(str(flight.instance) for flight in flights)
    changes = sorted({time_s for flight in flights for time_s, _ in flight.facts})
    return replace(
        lead,
        samples=tuple(rows),
        facts=tuple((t, _facts([flight.facts_at(t) for flight in flights], wiring)) for t in changes),
        notes=(*lead.notes, f"batteries {named} joined in {wiring}"),
        identity=replace(lead.identity, battery_serial=_serial(flights, -math.inf), battery_cycles=None),
        discharges=tuple((begin_s, _serial(flights, begin_s)) for begin_s, _ in lead.discharges),
        joined=len(flights),
    )


def _serial(flights: Sequence[Flight], time_s: float) -> str:
    """Return the serials of the joined packs at a time [s] as one; empty if one of them is not known.

    None of them names the joined pack: it holds more than each, and each may fly with another next time.
    """
    serials = [
        [flight.identity.battery_serial, *(s for begin_s, s in flight.discharges if begin_s <= time_s + CHANGED_S)][-1]
        for flight in flights
    ]
    return "+".join(sorted(serials)) if all(serials) else ""


def _row(rows: Sequence[Sample], wiring: Wiring) -> Sample:
    """Return one row of the joined pack; where one battery lacks a value, a mean is of the others and a sum is NaN."""
    volts, amps = [r.voltage_V for r in rows], [r.current_A for r in rows]
    cells = [r.cell_voltages_V for r in rows]
    if wiring is Wiring.PARALLEL:
        voltage_V, current_A, consumed_Ah = _mean(volts), sum(amps), sum(r.consumed_Ah for r in rows)
        cell_voltages_V = min((c for c in cells if c), key=min, default=())
    else:
        voltage_V, current_A, consumed_Ah = sum(volts), _mean(amps), _mean([r.consumed_Ah for r in rows])
        cell_voltages_V = tuple(v for c in cells for v in c) if all(cells) else ()
    return replace(
        rows[0],
        voltage_V=voltage_V,
        current_A=current_A,
        temp_C=_mean([r.temp_C for r in rows]),
        consumed_Ah=consumed_Ah,
        reported_soc=_mean([r.reported_soc for r in rows]),
        cell_voltages_V=cell_voltages_V,
    )


def _facts(facts: Sequence[PackFacts], wiring: Wiring) -> PackFacts:
    """Join the vehicle's words about each battery into words about the joined pack."""
    capacities = [f.capacity_Ah for f in facts]
    said = [f.sag_compensated for f in facts if f.sag_compensated is not None]
    joined = replace(
        facts[0],
        sag_compensated=any(said) if said else None,
        temperature_of_escs=any(f.temperature_of_escs for f in facts),
        full_share=min(f.full_share for f in facts),
    )
    if wiring is Wiring.PARALLEL:
        return replace(joined, capacity_Ah=sum(capacities))
    cells = [f.cells_series for f in facts]
    return replace(
        joined,
        cells_series=sum(c for c in cells if c) if all(cells) else None,
        capacity_Ah=min(capacities) if all(map(math.isfinite, capacities)) else NAN,
        low_voltage_V=sum(f.low_voltage_V for f in facts),
        critical_voltage_V=sum(f.critical_voltage_V for f in facts),
    )


def _mean(values: Sequence[float]) -> float:
    known = [v for v in values if math.isfinite(v)]
    return sum(known) / len(known) if known else NAN


def _typical_V(flight: Flight) -> float:
    known = sorted(s.voltage_V for s in flight.samples if math.isfinite(s.voltage_V))
    return known[len(known) // 2] if known else NAN


def _row_s(samples: Sequence[Sample]) -> float:
    gaps = sorted(b.time_s - a.time_s for a, b in pairwise(samples))
    return gaps[len(gaps) // 2] if gaps else 0.0
