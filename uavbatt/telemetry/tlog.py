"""Telemetry logs (.tlog) of a ground station: choose the autopilot, take its battery messages.

A tlog may hold several vehicles, gimbals, other ground stations and batteries that are components
of their own; only the chosen autopilot speaks of the battery here. BATTERY_STATUS names batteries by id;
SYS_STATUS counts only where that vehicle sent no BATTERY_STATUS at all, BATTERY2 (old) where none
had the id 1.
"""

from __future__ import annotations

from collections.abc import Sequence

from uavbatt.mavlink import fields
from uavbatt.records import Sample
from uavbatt.telemetry.builder import LogBuilder
from uavbatt.telemetry.tlog_frames import Frame, decoder, frames

_BATTERY_IDS = (fields.BATTERY_STATUS, fields.SYS_STATUS, fields.BATTERY2)
_WANTED = frozenset((*_BATTERY_IDS, fields.HEARTBEAT, fields.PARAM_VALUE))
_AUTOPILOT_COMPONENT = 1

Source = tuple[int, int]  # system, component


def read(data: bytes) -> LogBuilder:
    """All batteries' rows and the parameters of the first autopilot in a tlog."""
    log = LogBuilder()
    wanted: list[Frame] = []
    last: Frame | None = None
    for skipped, frame in frames(data, _WANTED, decoder()):
        log.skipped_bytes += skipped
        if frame is None:
            continue
        if last is None:
            log.time_s(frame.time_s)  # time counts from the first frame of any kind
        if frame.message is not None and frame.message_id in _WANTED:
            wanted.append(frame)
        last = frame
    source = _autopilot(wanted, log)
    if source is not None:
        _push([f for f in wanted if (f.system, f.component) == source], log)
    if last is not None:
        log.time_s(last.time_s)
    return log


def _autopilot(wanted: Sequence[Frame], log: LogBuilder) -> Source | None:
    """The source whose battery messages are read; component 1 goes before all others."""
    beats: dict[Source, bool] = {}
    senders: dict[Source, None] = {}
    for frame in wanted:
        source = (frame.system, frame.component)
        if frame.message_id == fields.HEARTBEAT:
            beats[source] = beats.get(source, False) or fields.is_autopilot(frame.message)
        elif frame.message_id in _BATTERY_IDS:
            senders.setdefault(source)
    candidates = [s for s in senders if beats.get(s)]
    # A short or cut log may hold no heartbeat: then component 1 is believed to be the autopilot.
    candidates = candidates or [s for s in senders if s not in beats and s[1] == _AUTOPILOT_COMPONENT]
    if not candidates:
        return None
    chosen = min(candidates, key=lambda s: s[1] != _AUTOPILOT_COMPONENT)
    for system, component in senders:
        if (system, component) != chosen:
            log.notes.append(
                f"battery messages of system {system} component {component} ignored"
                f" (read: system {chosen[0]} component {chosen[1]})"
            )
    return chosen


def _push(messages: Sequence[Frame], log: LogBuilder) -> None:
    """Push the rows, parameters and arming of one autopilot, in order."""
    present = {f.message_id for f in messages}
    ids = {f.message.id for f in messages if f.message_id == fields.BATTERY_STATUS}
    is_px4 = False  # until a heartbeat says so: nothing is read ahead
    if fields.BATTERY_STATUS not in present and fields.SYS_STATUS in present:
        log.notes.append("no BATTERY_STATUS in the log: SYS_STATUS read instead")
    for frame in messages:
        time_s = log.time_s(frame.time_s)
        if frame.message_id == fields.HEARTBEAT:
            log.armed = fields.is_armed(frame.message)
            is_px4 = frame.message.autopilot == fields.AUTOPILOT_PX4
        elif frame.message_id == fields.PARAM_VALUE:
            log.add_parameter(time_s, *fields.parameter(frame.message, is_px4))
        elif frame.message_id == fields.BATTERY_STATUS:
            _add(log, time_s, fields.battery_status(frame.message))
        elif frame.message_id == fields.SYS_STATUS and not ids:
            _add(log, time_s, fields.sys_status(frame.message))
        elif frame.message_id == fields.BATTERY2 and 1 not in ids:
            _add(log, time_s, fields.battery2(frame.message))


def _add(log: LogBuilder, time_s: float, battery: fields.BatteryFields) -> None:
    sample = Sample(
        time_s=time_s,
        voltage_V=battery.voltage_V,
        current_A=battery.current_A,
        temp_C=battery.temp_C,
        consumed_Ah=battery.consumed_Ah,
        reported_soc=battery.reported_soc,
        armed=log.armed,
        cell_voltages_V=battery.cell_voltages_V,
    )
    log.add(battery.id, sample)
