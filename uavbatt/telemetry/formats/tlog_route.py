"""Messages of route and place in a telemetry log (.tlog): their layouts on the wire, and their way to `Navigation`.

Only frames of these messages are decoded, as light tuples with the attributes of the MAVLink XML.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from uavbatt.navigation import Navigation
from uavbatt.telemetry.columns import Column, latest_before
from uavbatt.telemetry.formats.chain import Mask, Places
from uavbatt.telemetry.formats.tlog_frames import FrameTable
from uavbatt.telemetry.formats.tlog_payloads import layout_of
from uavbatt.telemetry.route import messages
from uavbatt.telemetry.route.events import Event, play
from uavbatt.telemetry.route.messages import NavigationListener


class _Kind(NamedTuple):
    """_Kind holds the frames of one message from the autopilot or from others, and what takes their messages."""

    message_id: int
    frames: FrameTable
    take: Callable[[float, int, Any], None]


def _item(place: str) -> np.dtype[Any]:
    """Return the layout of MISSION_ITEM or MISSION_ITEM_INT, which write the place differently."""
    return layout_of(
        param1=("<f4", 0), param2=("<f4", 4), param3=("<f4", 8), param4=("<f4", 12), x=(place, 16), y=(place, 20),
        z=("<f4", 24), seq=("<u2", 28), command=("<u2", 30), target_system=("u1", 32), target_component=("u1", 33),
        frame=("u1", 34), mission_type=("u1", 37),
    )  # fmt: skip


LAYOUTS = {
    messages.HEARTBEAT: layout_of(custom_mode=("<u4", 0), type=("u1", 4), autopilot=("u1", 5)),
    messages.GLOBAL_POSITION_INT: layout_of(
        lat=("<i4", 4), lon=("<i4", 8), relative_alt=("<i4", 16), vx=("<i2", 20), vy=("<i2", 22), vz=("<i2", 24)
    ),
    messages.VFR_HUD: layout_of(airspeed=("<f4", 0)),
    messages.WIND: layout_of(direction=("<f4", 0), speed=("<f4", 4)),
    messages.WIND_COV: layout_of(wind_x=("<f4", 8), wind_y=("<f4", 12), var_horiz=("<f4", 20)),
    messages.HOME_POSITION: layout_of(latitude=("<i4", 0), longitude=("<i4", 4), altitude=("<i4", 8)),
    messages.EXTENDED_SYS_STATE: layout_of(landed_state=("u1", 1)),
    messages.MISSION_CURRENT: layout_of(seq=("<u2", 0), total=("<u2", 2), mission_id=("<u4", 6)),
    messages.MISSION_ITEM_REACHED: layout_of(seq=("<u2", 0)),
    messages.MISSION_COUNT: layout_of(
        count=("<u2", 0), target_system=("u1", 2), target_component=("u1", 3), mission_type=("u1", 4)
    ),
    messages.MISSION_ITEM: _item("<f4"),
    messages.MISSION_ITEM_INT: _item("<i4"),
    messages.MISSION_ACK: layout_of(
        target_system=("u1", 0), target_component=("u1", 1), type=("u1", 2), mission_type=("u1", 3)
    ),
    messages.MISSION_CLEAR_ALL: layout_of(
        target_system=("u1", 0), target_component=("u1", 1), mission_type=("u1", 2)
    ),
    messages.MISSION_WRITE_PARTIAL_LIST: layout_of(
        start_index=("<i2", 0), end_index=("<i2", 2), target_system=("u1", 4), target_component=("u1", 5),
        mission_type=("u1", 6),
    ),
}  # fmt: skip
MESSAGES: dict[int, Any] = {number: namedtuple("Message", layout.names or ()) for number, layout in LAYOUTS.items()}
_ALL_COMPONENTS = 0
_MICROSECOND_S = 1e-6
_LONGEST_STEP_S = 60.0  # stamps have no checksum: one that leaps further is damaged


class TlogClock(NamedTuple):
    """TlogClock holds the frames that tell the log's time: places in the file, stamps [s], times [s], which are rows.

    A row is a battery message.
    """

    start: Places
    stamp_s: Column
    time_s: Column
    is_row: Mask

    def times_s(self, frames: FrameTable) -> list[float]:
        """Return the times of other frames [s].

        Each counts from the clock's frame before it, by the stamps if these are sound.
        """
        if not len(self.start):
            return [0.0] * len(frames.start)
        last = np.maximum(latest_before(frames.start, self.start), 0)
        since_s = np.clip(frames.time_s - self.stamp_s[last], 0.0, _LONGEST_STEP_S)
        # a message behind a battery row was not known at that row, even with the same stamp
        row = latest_before(frames.start, self.start[self.is_row])
        known_s = np.append(self.time_s[self.is_row] + _MICROSECOND_S, 0.0)[row]
        times: list[float] = np.round(np.maximum(self.time_s[last] + since_s, known_s), 6).tolist()
        return times


def navigation(
    found: FrameTable, own: FrameTable, source: int, clock: TlogClock, parameters: list[tuple[float, str, float]]
) -> tuple[Navigation, ...]:
    """Return what a log tells of route and place.

    found : frames of all senders; own : those of the autopilot `source`
    parameters : (time [s], name, value) of the statements that count
    """
    listener = NavigationListener(keeps_all=True)
    kinds = [*_of_autopilot(own, listener), *_of_others(found, source, listener)]
    play(_in_order(kinds, clock), parameters, listener.builder)
    return listener.builder.timeline()


def _of_autopilot(own: FrameTable, listener: NavigationListener) -> Iterator[_Kind]:
    """Yield the autopilot's messages; of heartbeats only those that bring a change."""
    for message_id in LAYOUTS.keys() & {messages.HEARTBEAT, *messages.OF_AUTOPILOT}:
        frames = own.of(message_id)
        if message_id == messages.HEARTBEAT:
            frames = frames.at(_changes(frames))
        yield _Kind(message_id, frames, listener.take)


def _of_others(found: FrameTable, source: int, listener: NavigationListener) -> Iterator[_Kind]:
    """Yield what other stations said of missions to the autopilot."""
    others = found.at((found.source != source) & np.isin(found.message_id, list(messages.OF_OTHERS)))
    for message_id in messages.OF_OTHERS if len(others.start) else ():
        frames = others.of(message_id)
        said = frames.records(LAYOUTS[message_id])
        is_to_it = np.isin(said["target_component"], (_ALL_COMPONENTS, source & 0xFF))
        yield _Kind(message_id, frames.at(is_to_it & (said["target_system"] == source >> 8)), listener.take_other)


def _in_order(kinds: Sequence[_Kind], clock: TlogClock) -> Iterator[Event]:
    """Yield the messages of all kinds as events, as they lie in the file.

    An event is made when it is asked for: a hundred thousand of them at once would keep the garbage collector busy.
    """
    start = np.concatenate([kind.frames.start for kind in kinds])
    said = [message for kind in kinds for message in _decoded(kind.frames, kind.message_id)]
    times_s = [time_s for kind in kinds for time_s in clock.times_s(kind.frames)]
    of_kind = np.repeat(np.arange(len(kinds)), [len(kind.frames.start) for kind in kinds]).tolist()
    for place in np.argsort(start, kind="stable").tolist():
        kind = kinds[of_kind[place]]
        yield times_s[place], kind.take, (kind.message_id, said[place])


def _decoded(frames: FrameTable, message_id: int) -> Iterator[Any]:
    """Return the messages of the frames as light tuples."""
    return map(MESSAGES[message_id]._make, frames.records(LAYOUTS[message_id]).tolist())


def _changes(beats: FrameTable) -> Mask:
    """Mark the heartbeats with another mode than the one before."""
    if not len(beats.start):
        return np.zeros(0, np.bool_)
    said = beats.records(LAYOUTS[messages.HEARTBEAT])
    differs = [said[name][1:] != said[name][:-1] for name in said.dtype.names]
    return np.concatenate(([True], np.any(differs, axis=0)))
