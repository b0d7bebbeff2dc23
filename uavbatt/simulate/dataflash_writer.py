"""Values -> ArduPilot DataFlash log (`.BIN`).

Every record is `0xA3 0x95 type` and a body laid out by the record's FMT, little endian, packed; `dataflash_layouts` has
the layouts. BAT is that of 4.1 and later with its remaining per cent. Units: V, A, mAh, Wh, ohm, degC.

Unknown floats stay NaN. `Temp` has no NaN and 0 means "no sensor" there, so an unknown temperature is written as 0 and
a measured 0.00 degC as 0.01. RemPct unknown is 255. VoltR, EnrgTot and Res are the autopilot's guesses, which a sample
does not hold: NaN. Cell voltages have no place in BAT and are left out.

Source: ArduPilot AP_Logger/LogStructure.h, AP_BattMonitor/LogStructure.h; checked against logs in the wild.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from heapq import merge
from pathlib import Path

from uavbatt.files import atomic_write
from uavbatt.records import NAN, Sample
from uavbatt.simulate.dataflash_layouts import (
    ARM,
    BAT,
    EV,
    FMT,
    HEAD,
    LAYOUTS,
    PARM,
    ROUTE_LAYOUTS,
    MessageLayout,
)
from uavbatt.simulate.tlog_writer import ascending_us

EVENT_ARMED, EVENT_DISARMED = 10, 11
NO_SENSOR_C = 0.0
UNKNOWN_PERCENT = 255


def write_dataflash(
    path: str | Path,
    samples: Iterable[Sample],
    parameters: Mapping[str, float] | None = None,
    *,
    instance: int = 0,
    route: Sequence[tuple[float, bytes]] = (),
) -> None:
    """Write `samples` and the vehicle's `parameters` (at time 0) to `path` as a binary DataFlash log.

    instance : number of the battery in BAT.Inst; `battery_id` of the tlog writer
    route : records of route and place with their times [s], ascending (`route_writer`)
    """
    with atomic_write(path, "wb") as file:
        for layout in (*LAYOUTS, *(ROUTE_LAYOUTS if route else ())):
            file.write(format_record(layout))
        for name, value in (parameters or {}).items():
            file.write(parameter_record(0, name, value))
        for _, record in merge(route, _sample_records(samples, instance), key=lambda told: told[0]):
            file.write(record)


def _sample_records(samples: Iterable[Sample], instance: int) -> Iterator[tuple[float, bytes]]:
    """Yield BAT for every sample, ARM and EV where arming becomes known or changes, with their times [s]."""
    last_us, armed = 0, None
    for sample in samples:
        last_us = ascending_us(sample.time_s, last_us)
        if sample.armed is not None and sample.armed != armed:
            armed = sample.armed
            yield sample.time_s, ARM.record(last_us, int(armed), 0, 0, 0)
            yield sample.time_s, EV.record(last_us, EVENT_ARMED if armed else EVENT_DISARMED)
        yield sample.time_s, battery_record(last_us, sample, instance)


def format_record(layout: MessageLayout) -> bytes:
    """Return the FMT record that describes `layout`."""
    length = len(HEAD) + 1 + layout.body.size
    return FMT.record(layout.type, length, layout.name.encode(), layout.format.encode(), layout.columns.encode())


def parameter_record(time_us: int, name: str, value: float) -> bytes:
    """Return one PARM record. Raises ValueError for a name of more than 16 characters."""
    encoded = name.encode("ascii")
    if len(encoded) > 16:
        raise ValueError(f"parameter {name!r}: at most 16 characters fit")
    return PARM.record(time_us, encoded, value)


def battery_record(time_us: int, sample: Sample, instance: int) -> bytes:
    """Return one BAT record of `sample`; the module's docstring says how unknown values are written."""
    return BAT.record(
        time_us,
        instance,
        sample.voltage_V,
        NAN,
        sample.current_A,
        sample.consumed_Ah * 1000.0,
        NAN,
        temperature_cdegC(sample.temp_C),
        NAN,
        percent(sample.reported_soc),
    )


def temperature_cdegC(temp_C: float) -> int:
    """Return a temperature [°C] in hundredths [cdegC]; 0 means no sensor, so a measured zero moves by one step."""
    if not math.isfinite(temp_C):
        return round(NO_SENSOR_C)
    hundredths = min(max(round(temp_C * 100.0), -32768), 32767)
    return hundredths if hundredths != 0 else 1


def percent(soc: float) -> int:
    """Return the remaining per cent, 0..100, of a state of charge; 255 when it is unknown."""
    return min(max(round(soc * 100.0), 0), 100) if math.isfinite(soc) else UNKNOWN_PERCENT
