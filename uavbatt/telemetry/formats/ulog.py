"""PX4 logs (.ulg) through pyulog (extra `ulog`).

`battery_status` (one topic instance a battery) keeps its unknowns as voltage 0, current -1,
remaining -1, temperature NaN or 0. Names of other fields moved between versions, these did not.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator
from typing import Any

from uavbatt.errors import BadInput, MissingExtra
from uavbatt.records import NAN, Identity, Sample
from uavbatt.telemetry.builder import LogBuilder, finite_or_nan
from uavbatt.telemetry.formats.px4_unknown import px4_value
from uavbatt.telemetry.formats.ulog_packs import OF_PACKS, packs
from uavbatt.telemetry.formats.ulog_route import OF_ROUTE, navigation
from uavbatt.telemetry.identity import utc_s, version
from uavbatt.telemetry.parameters import statements_of

_TOPICS = [*OF_PACKS, "vehicle_status", "vehicle_gps_position", *OF_ROUTE]
_ARMED_STATE = 2  # vehicle_status.arming_state
_US = 1e6
_TIME = "timestamp"

Event = tuple[int, int, Any]  # (time [us], rank at equal times, what happened)


def read_ulog(source: str, data: bytes) -> LogBuilder:
    """Read all batteries' rows and the parameters of a ULog file; `source` names it in errors."""
    ulog = _open(source, data)
    log = LogBuilder()
    log.time_s(ulog.start_timestamp / _US)
    for name, value in ulog.initial_parameters.items():
        _add_parameter(log, 0.0, name, value)
    stated = [*packs(ulog)]
    log.packs = {pack.id: pack for _, pack in stated}
    of_packs = ((time_us, 0, statement) for time_us, pack in stated for statement in statements_of(pack))
    for time_us, _, what in sorted([*of_packs, *_events(ulog)], key=lambda event: event[:2]):
        # PX4 also logs the last sample from before the start: it counts as at the start.
        time_s = log.time_s(max(time_us, ulog.start_timestamp) / _US)
        if isinstance(what, bool):
            log.armed = what
        elif isinstance(what[0], str):
            _add_parameter(log, time_s, *what)
        else:
            instance, row = what
            log.add(instance, _sample(row, time_s, log.armed))
    log.time_s(ulog.last_timestamp / _US)
    log.identity = _identity(ulog)
    log.navigation = navigation(ulog, log.parameters)
    if ulog.file_corruption:
        log.notes.append("the file is damaged: what pyulog could read is used")
    if ulog.dropouts:
        lost_s = sum(dropout.duration for dropout in ulog.dropouts) / 1000
        log.notes.append(f"dropouts of the logger: {len(ulog.dropouts)}, {lost_s:.1f} s in all")
    return log


class _EndlessReading(Exception):
    """_EndlessReading ends pyulog's endless loop: after a short read at the end it steps back by the asked length."""


class _BoundedFile(io.BytesIO):
    """_BoundedFile is a file in memory that ends pyulog's endless loop at a cut definitions section."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self._reads_left = 8 * len(data) + 1000  # a sound file takes two reads a message

    def read(self, size: int | None = -1, /) -> bytes:
        self._reads_left -= 1
        if self._reads_left < 0:
            raise _EndlessReading
        return super().read(size)


def _open(source: str, data: bytes) -> Any:
    try:
        from pyulog import ULog
    except ImportError:
        raise MissingExtra("ulog", "reading PX4 .ulg logs") from None
    try:
        with contextlib.redirect_stdout(io.StringIO()):  # pyulog prints what it stumbles over
            ulog = ULog(_BoundedFile(data), message_name_filter_list=_TOPICS)
    except Exception as error:  # pyulog raises whatever its parsing happens to raise
        raise BadInput(source, "", f"a sound ULog file, pyulog gave up ({type(error).__name__})") from None
    ulog.data_list[:] = [topic for topic in ulog.data_list if _TIME in topic.data]  # a damaged definition has none
    return ulog


def _identity(ulog: Any) -> Identity:
    """Return hardware and firmware by the log's information messages, and the start by the first GPS fix."""
    said = ulog.msg_info_dict
    number = said.get("ver_sw_release")
    starts = [
        utc_s((utc_us - time_us + ulog.start_timestamp) / _US)
        for topic in ulog.data_list
        if topic.name == "vehicle_gps_position" and "time_utc_usec" in topic.data
        for utc_us, time_us in zip(topic.data["time_utc_usec"].tolist(), topic.data[_TIME].tolist(), strict=True)
        if utc_us > 0
    ]
    return Identity(
        hardware=str(said.get("sys_uuid", "")),
        firmware=f"PX4 {version(number)}" if isinstance(number, int) else "",
        start_utc_s=next((s for s in starts if s == s), NAN),
    )


def _events(ulog: Any) -> Iterator[Event]:
    """Yield parameter changes, arming and battery rows with their times, each kind in its own order."""
    for time_us, name, value in ulog.changed_parameters:
        yield int(time_us), 0, (name, value)
    for topic in ulog.data_list:
        stamps = topic.data[_TIME]
        if topic.name == "vehicle_status" and topic.multi_id == 0 and "arming_state" in topic.data:
            for time_us, state in zip(stamps, topic.data["arming_state"], strict=True):
                yield int(time_us), 1, bool(state == _ARMED_STATE)
        elif topic.name == "battery_status":
            for index, time_us in enumerate(stamps):
                yield int(time_us), 2, (topic.multi_id, _row(topic.data, index))


def _add_parameter(log: LogBuilder, time_s: float, name: str, value: Any) -> None:
    if isinstance(value, int | float):  # a damaged type field leaves bytes here
        log.add_parameter(time_s, name, value)


def _row(columns: Any, index: int) -> dict[str, float]:
    return {name: float(values[index]) for name, values in columns.items()}


def _sample(row: dict[str, float], time_s: float, armed: bool | None) -> Sample:
    def read(column: str) -> float:
        return finite_or_nan(px4_value(column, row.get(column, NAN)))

    remaining = read("remaining")
    return Sample(
        time_s=time_s,
        voltage_V=row.get("voltage_v", NAN),
        current_A=read("current_a"),
        temp_C=read("temperature"),
        consumed_Ah=read("discharged_mah") / 1000,
        reported_soc=remaining if 0 <= remaining <= 1 else NAN,
        armed=armed,
        cell_voltages_V=_cells(row),
    )


def _cells(row: dict[str, float]) -> tuple[float, ...]:
    """Return the measured cell voltages [V]; if all are equal, the autopilot has only divided the pack's voltage."""
    cells = [v for name, v in row.items() if name.startswith("voltage_cell_v[") and v > 0]
    return tuple(cells) if len(set(cells)) > 1 else ()
