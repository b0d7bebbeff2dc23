"""Telemetry logs (.tlog) of a ground station: choose the autopilot, take its battery messages.

A tlog may hold several vehicles, gimbals, other ground stations and batteries that are components of their own. Only
battery messages of the chosen autopilot are read, or of such batteries if it has none (`tlog_components`).
BATTERY_STATUS names batteries by id. SYS_STATUS counts only if the vehicle sent no BATTERY_STATUS at all, or if battery
0 is the only one and sent none for 5 s. BATTERY2 (old) counts only if no BATTERY_STATUS has the id 1.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbatt.errors import UsageError
from uavbatt.mavlink import fields
from uavbatt.records import Identity
from uavbatt.telemetry.builder import (
    ALONE_AFTER_S,
    BEATING_S,
    CLOCK_GAP_S,
    LEAP_S,
    LONGEST_ALONE_S,
    LogBuilder,
    finite_or_nan,
)
from uavbatt.telemetry.column_rules import add_rows, times_s
from uavbatt.telemetry.columns import UNKNOWN, Column, Columns, distinct, latest_before
from uavbatt.telemetry.formats import tlog_payloads
from uavbatt.telemetry.formats.chain import Mask
from uavbatt.telemetry.formats.recording import forecast_period_s, is_recording
from uavbatt.telemetry.formats.tlog_cells import BatteryStatusRows, HeardMessages, with_all_cells
from uavbatt.telemetry.formats.tlog_components import LoggedComponents, battery_components, battery_sources
from uavbatt.telemetry.formats.tlog_frames import FrameTable, frames
from uavbatt.telemetry.formats.tlog_payloads import BatteryMessages
from uavbatt.telemetry.formats.tlog_route import LAYOUTS, TlogClock, navigation
from uavbatt.telemetry.identity import utc_s, version
from uavbatt.telemetry.parameters import HeardParameters, statements_of

_BATTERY_IDS = (fields.BATTERY_STATUS, fields.SYS_STATUS, fields.BATTERY2)
_AUTOPILOT_COMPONENT = 1
_NOBODY = -1
_MAKES = {3: "ArduPilot", fields.AUTOPILOT_PX4: "PX4"}


_Stated = tuple[int, int, tuple[str, float]]  # place and sequence number of a frame, the name and the value in it


class _Beats(NamedTuple):
    """_Beats holds the heartbeats of the chosen vehicle: their places among its frames, and what they say."""

    place: NDArray[np.int64]
    armed: Mask
    is_px4: Mask


def read_tlog(source: str, data: bytes | memoryview, system: int | None = None, has_route: bool = True) -> LogBuilder:
    """Read all batteries' rows and the parameters of one autopilot in a tlog: of `system`, else of the first.

    has_route : read route and place as well, which takes several times as long as the batteries.

    Raises UsageError when no autopilot of that system speaks of a battery in the log named `source`.
    """
    log = LogBuilder(
        longest_step_s=math.inf if is_recording(data) else LEAP_S,
        reboot_gap_s=CLOCK_GAP_S,  # its times are those of the ground station
        forecast_period_s=forecast_period_s(data),
    )
    found = frames(data)
    log.skipped_bytes = found.skipped_bytes
    if math.isnan(found.first_s):
        return log
    chosen = _autopilot(source, found, system)
    components = battery_components(found, chosen)
    of_source = found.at((found.source == chosen) | components.frames)
    # only battery frames set the clock, so that reading more kinds of messages moves no row
    own = of_source.at(~np.isin(of_source.message_id, list(LAYOUTS.keys() - {fields.HEARTBEAT})))
    if chosen != _NOBODY:
        _note_ignored(found, chosen, components, log)
        log.identity = _identity(own, chosen, found.first_s)
    # time counts from the first frame of any kind, and lasts until the last
    time_s = times_s(log, np.concatenate(([found.first_s], own.time_s, [found.last_s])))[1:-1]
    beats = _beats(own, time_s)
    _add_parameters(own, time_s, beats, log)
    _add_rows(own, time_s, beats, log)
    if chosen != _NOBODY and has_route:
        clock = TlogClock(own.start, own.time_s, time_s, np.isin(own.message_id, _BATTERY_IDS))
        log.navigation = navigation(found, of_source, chosen, clock, log.parameters)
    return log


def _autopilot(name: str, found: FrameTable, system: int | None) -> int:
    """Return the source whose battery messages are read, component 1 if possible; _NOBODY if there is none.

    An autopilot without battery messages is chosen only if its system has batteries that are components.
    """
    beating = found.of(fields.HEARTBEAT)
    is_autopilot = tlog_payloads.heartbeats(beating, fields.is_autopilot)
    beaters, autopilots = set(beating.source.tolist()), set(beating.source[is_autopilot].tolist())
    in_order = distinct(found.source[np.isin(found.message_id, _BATTERY_IDS)])
    candidates = [s for s in in_order if s in autopilots]
    # A short or cut log may hold no heartbeat: then component 1 is believed to be the autopilot.
    candidates = candidates or [s for s in in_order if s not in beaters and s & 0xFF == _AUTOPILOT_COMPONENT]
    with_components = {s >> 8 for s in battery_sources(found)} if autopilots and not candidates else set()
    candidates = candidates or sorted(s for s in autopilots if s >> 8 in with_components)
    if system is not None:
        candidates = _of_system(name, candidates, system)
    if not candidates:
        return _NOBODY
    return min(candidates, key=lambda s: s & 0xFF != _AUTOPILOT_COMPONENT)


def _note_ignored(found: FrameTable, chosen: int, components: LoggedComponents, log: LogBuilder) -> None:
    """Note whose battery messages are read in the place of others, or are not read."""
    for source in distinct(found.source[np.isin(found.message_id, _BATTERY_IDS)]):
        if source in components.sources:
            log.notes.append(f"batteries of {_named(source)} read: it is a battery, and the autopilot reported none")
        elif source != chosen:
            log.notes.append(f"battery messages of {_named(source)} ignored (read: {_named(chosen)})")
    log.notes += [
        f"battery {number} of {_named(source)} ignored: another reports it" for source, number in components.unused
    ]
    of_chosen = distinct(found.message_id[found.source == chosen])
    if not components.sources and fields.BATTERY_STATUS not in of_chosen and fields.SYS_STATUS in of_chosen:
        log.notes.append("no BATTERY_STATUS in the log: SYS_STATUS read instead")


def _of_system(name: str, candidates: list[int], system: int) -> list[int]:
    """Return the candidates of a system. Raises UsageError, with the systems that there are, if it has none."""
    own = [source for source in candidates if source >> 8 == system]
    if not own:
        there = ", ".join(str(number) for number in sorted({source >> 8 for source in candidates})) or "none"
        raise UsageError(f"{name}: no battery messages of system {system}; systems that have some: {there}")
    return own


def _named(source: int) -> str:
    return f"system {source >> 8} component {source & 0xFF}"


def _identity(own: FrameTable, source: int, first_s: float) -> Identity:
    """Read who sent the chosen frames, by its own words, and when the log begins by the ground's clock."""
    beats = own.of(fields.HEARTBEAT).records(tlog_payloads.HEARTBEAT)
    make = _MAKES.get(int(beats["autopilot"][0]), "") if len(beats) else ""
    told = own.of(fields.AUTOPILOT_VERSION).records(tlog_payloads.AUTOPILOT_VERSION)[:1].tolist()
    hardware = next((fields.hardware(uid) for uid, _ in told), "")
    number = next((version(number) for _, number in told if number), "")
    return Identity(source >> 8, hardware, f"{make} {number}".strip(), start_utc_s=utc_s(first_s))


def _beats(own: FrameTable, time_s: Column) -> _Beats:
    place = own.places(fields.HEARTBEAT)
    beats = own.at(place)
    is_px4 = tlog_payloads.heartbeats(beats, lambda beat: beat.autopilot == fields.AUTOPILOT_PX4)
    said = tlog_payloads.heartbeats(beats, fields.is_armed)
    is_soon = np.diff(time_s[place], prepend=-math.inf) <= BEATING_S  # as in flight: two heartbeats in a row disarm
    return _Beats(place, said | (np.roll(said, 1) & is_soon), is_px4)


def _add_parameters(own: FrameTable, time_s: Column, beats: _Beats, log: LogBuilder) -> None:
    """Add the statements about vehicle and packs that count, by the same rules as in flight (`HeardParameters`)."""
    place, heard = own.places(fields.PARAM_VALUE), HeardParameters()
    statements = own.at(place)
    # Before the first heartbeat the vehicle counts as disarmed and not as PX4; integers wait for it, as in flight.
    if len(beats.place):
        waits = (place < beats.place[0]) & tlog_payloads.are_integers(statements)
        place = np.where(waits, beats.place[0], place)
    is_px4 = [k >= 0 and bool(beats.is_px4[k]) for k in latest_before(place + 1, beats.place).tolist()]
    said = tlog_payloads.parameters(statements, is_px4)
    stated = [
        *zip(place.tolist(), statements.sequence.tolist(), said, strict=True),
        *_statements_of_packs(own, time_s, log),
    ]
    stated.sort(key=lambda one: one[0])
    last = latest_before(np.array([at + 1 for at, _, _ in stated], np.int64), beats.place).tolist()
    for (at, sequence, (name, value)), beat in zip(stated, last, strict=True):
        is_armed = beat >= 0 and bool(beats.armed[beat])
        beat_age_s = float(time_s[at] - time_s[beats.place[beat]]) if beat >= 0 else math.inf
        if heard.counts(name, finite_or_nan(value), sequence, is_armed=is_armed, beat_age_s=beat_age_s):
            log.add_parameter(float(time_s[at]), name, value)


def _statements_of_packs(own: FrameTable, time_s: Column, log: LogBuilder) -> Iterator[_Stated]:
    """Add who the packs are; yield what they state of their size."""
    for message_id, length in fields.IDENTITY_LENGTH.items():
        found, places = own.of(message_id), own.places(message_id).tolist()
        for at, sequence, payload in zip(places, found.sequence.tolist(), found.payloads(length), strict=True):
            said = fields.pack_identity(message_id, payload.tobytes())
            if said.serial or said.cycles is not None:
                log.packs.setdefault(said.id, said)
            if said.serial:
                log.serials.setdefault(said.id, []).append((float(time_s[at]), said.serial))
            yield from ((at, sequence, stated) for stated in statements_of(said))


def _add_rows(own: FrameTable, time_s: Column, beats: _Beats, log: LogBuilder) -> None:
    """Add the rows of all battery messages that count, in order."""
    places, parts = [], []
    ids: list[int] = []
    told = np.zeros(0, np.int64)
    for message_id, kind in tlog_payloads.KINDS.items():
        place = own.places(message_id)
        is_told = bool(ids) if message_id == fields.SYS_STATUS else message_id == fields.BATTERY2 and 1 in ids
        if is_told and ids == [0]:
            place, is_told = _alone(place, told, time_s), False
        if is_told or not len(place):
            continue
        said = kind.messages(own.at(place))
        if message_id == fields.BATTERY_STATUS:
            said = _completed(own, time_s, beats, place, said)
            ids, told = distinct(said.instance), place[said.voltage_V > 0.0]
        places.append(place)
        parts.append(said)
    if not parts:
        return
    place = np.concatenate(places)
    order = np.argsort(place, kind="stable")
    place, said = place[order], tlog_payloads.together(parts).at(order)
    armed = _armed(beats, latest_before(place, beats.place))
    rows = Columns(
        time_s[place], said.voltage_V, said.current_A, said.temp_C, said.consumed_Ah, said.reported_soc,
        armed, said.cells_V,
    )  # fmt: skip
    add_rows(log, said.instance, rows)


def _completed(
    own: FrameTable, time_s: Column, beats: _Beats, place: NDArray[np.int64], said: BatteryMessages
) -> BatteryMessages:
    """Return what BATTERY_STATUS says, with the cells that are missing from its sums."""
    heard, last = own.places(fields.SYS_STATUS), latest_before(place, beats.place)
    if said.cells_V is None:
        return said
    volts = tlog_payloads.KINDS[fields.SYS_STATUS].messages(own.at(heard)).voltage_V
    row = BatteryStatusRows(place, time_s[place], _armed(beats, last), np.append(beats.is_px4, False)[last])
    return with_all_cells(said, row, HeardMessages(heard, volts), time_s[heard])


def _armed(beats: _Beats, last: NDArray[np.int64]) -> NDArray[np.int8]:
    """Return whether the vehicle was armed by these heartbeats; UNKNOWN where there was none yet (index -1)."""
    return np.append(beats.armed.astype(np.int8), UNKNOWN)[last].astype(np.int8)


def _alone(place: NDArray[np.int64], told: NDArray[np.int64], time_s: Column) -> NDArray[np.int64]:
    """Return the messages that come after a while without the other ones of the battery, by the same rule as in
    flight."""
    steps_s = np.minimum(np.diff(time_s[place], prepend=-math.inf), LONGEST_ALONE_S)
    alone_s = np.append(np.cumsum(steps_s), 0.0)  # index -1, none before: the appended one
    last = latest_before(place, told)
    since_s = alone_s[latest_before(told, place)[last]] if len(told) else alone_s[:-1]
    is_alone: Mask = (last >= 0) & (alone_s[:-1] - since_s > ALONE_AFTER_S)
    return place[is_alone]
