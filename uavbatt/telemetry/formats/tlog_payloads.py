"""Payloads of the MAVLink messages that a log reader wants, as columns.

The layouts are those on the wire: fields by falling size, then extensions. Units and sentinels are read in
`mavlink.fields` message by message for the live link. A log has thousands of battery messages, so the same rules are
here again for whole columns; a test keeps both the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbatt.mavlink import fields
from uavbatt.telemetry.columns import Column, distinct
from uavbatt.telemetry.formats.chain import Mask
from uavbatt.telemetry.formats.tlog_frames import FrameTable


def layout_of(**fields: tuple[Any, int]) -> np.dtype[Any]:
    """Return the layout of a payload, made from the type and the offset of each field that is read."""
    formats, offsets = zip(*fields.values(), strict=True)
    return np.dtype({"names": list(fields), "formats": formats, "offsets": offsets})


HEARTBEAT = layout_of(type=("u1", 4), autopilot=("u1", 5), base_mode=("u1", 6))
PARAM_VALUE = layout_of(value=("<f4", 0), id=("S16", 8), type=("u1", 24))
SYS_STATUS = layout_of(voltage=("<u2", 14), current=("<i2", 16), remaining=("i1", 30))
BATTERY2 = layout_of(voltage=("<u2", 0), current=("<i2", 2))
BATTERY_STATUS = layout_of(
    consumed=("<i4", 0), temperature=("<i2", 8), voltages=(("<u2", 10), 10), current=("<i2", 30), id=("u1", 32),
    remaining=("i1", 35), voltages_ext=(("<u2", 4), 41),
)  # fmt: skip
AUTOPILOT_VERSION = layout_of(uid=("<u8", 8), flight_sw=("<u4", 16))
_SPLIT_MV = 65534  # a higher voltage is 65534 in voltages[0] plus the rest in the next entry


class BatteryMessages(NamedTuple):
    """BatteryMessages hold one entry for each message; `cells_V` has one row each, or is None if none tells cells."""

    instance: NDArray[np.int64]
    voltage_V: Column
    current_A: Column
    temp_C: Column
    consumed_Ah: Column
    reported_soc: Column
    cells_V: NDArray[np.float64] | None = None

    def at(self, chosen: Any) -> BatteryMessages:
        """Return some of the messages, chosen by mask or index."""
        columns: Any = [None if column is None else column[chosen] for column in self]
        return BatteryMessages(*columns)


class MessageKind(NamedTuple):
    """A MessageKind of battery message has a layout, and a function that says what its records mean."""

    layout: np.dtype[Any]
    read: Callable[[Any], BatteryMessages]

    def messages(self, frames: FrameTable) -> BatteryMessages:
        """Return what frames of this kind say."""
        return self.read(frames.records(self.layout))


class _Beat(NamedTuple):
    type: int
    autopilot: int
    base_mode: int


class _Parameter(NamedTuple):
    param_id: str
    param_value: float
    param_type: int


def heartbeats(frames: FrameTable, is_so: Callable[[Any], bool]) -> Mask:
    """Return the mask of the heartbeats for which `is_so` holds; it is asked once for each kind of heartbeat."""
    beats = frames.records(HEARTBEAT)
    packed = beats["type"].astype(np.int32) << 16 | beats["autopilot"].astype(np.int32) << 8 | beats["base_mode"]
    found = np.zeros(len(packed), np.bool_)
    for kind in distinct(packed):
        if is_so(_Beat(kind >> 16, kind >> 8 & 0xFF, kind & 0xFF)):
            found |= packed == kind
    return found


def parameters(frames: FrameTable, is_px4: Iterable[bool]) -> Iterator[tuple[str, float]]:
    """Yield the name and value of every PARAM_VALUE."""
    messages = frames.records(PARAM_VALUE)
    columns = (messages["id"].tolist(), messages["value"].tolist(), messages["type"].tolist())
    for name, value, kind, px4 in zip(*columns, is_px4, strict=True):
        text = name.split(b"\0", 1)[0].decode("ascii", errors="replace")
        yield fields.parameter(_Parameter(text, value, kind), px4)


def are_integers(frames: FrameTable) -> Mask:
    """Return the mask of the PARAM_VALUE frames that hold an integer."""
    return np.isin(frames.records(PARAM_VALUE)["type"], list(fields.INTEGER_CODES))


def together(parts: Sequence[BatteryMessages]) -> BatteryMessages:
    """Return the messages of several kinds as one, one kind behind the other."""
    width = max(0 if p.cells_V is None else p.cells_V.shape[1] for p in parts)
    cells = [np.full((len(p.instance), width), np.nan) if p.cells_V is None else p.cells_V for p in parts]
    columns: list[Any] = [np.concatenate(same) for same in zip(*(p[:-1] for p in parts), strict=True)]
    columns.append(np.concatenate(cells) if width else None)
    return BatteryMessages(*columns)


def _battery_status(messages: Any) -> BatteryMessages:
    mV, ext_mV = messages["voltages"].astype(np.int64), messages["voltages_ext"].astype(np.int64)
    # some senders fill unused cells with 0: no cell is at 0 V in flight
    filled = (mV != 0) & (mV != 65535)
    is_split = mV[:, 0] == _SPLIT_MV
    is_known = filled.any(axis=1)
    filled_ext = (ext_mV > 1) & (ext_mV < 65535) & (is_known & ~is_split)[:, None]
    all_mV, all_filled = np.hstack((mV, ext_mV)), np.hstack((filled, filled_ext))
    total_mV = np.sum(all_mV, axis=1, where=all_filled)
    has_cells = (np.count_nonzero(all_filled, axis=1) > 1) & ~is_split
    cells_V = np.where(all_filled & has_cells[:, None], all_mV / 1000, np.nan) if has_cells.any() else None
    return BatteryMessages(
        instance=messages["id"].astype(np.int64),
        voltage_V=np.where(is_known, total_mV / 1000, np.nan),
        current_A=_current_A(messages["current"]),
        temp_C=_unless(messages["temperature"] == 32767, messages["temperature"] / 100),
        consumed_Ah=_unless(messages["consumed"] == -1, messages["consumed"] / 1000),
        reported_soc=_soc(messages["remaining"]),
        cells_V=cells_V,
    )


def _sys_status(messages: Any) -> BatteryMessages:
    return _of_one_battery(0, messages)._replace(reported_soc=_soc(messages["remaining"]))


def _battery2(messages: Any) -> BatteryMessages:
    return _of_one_battery(1, messages)


def _of_one_battery(number: int, messages: Any) -> BatteryMessages:
    """Return what a kind of message that names no battery says of voltage and current."""
    instance, unknown = np.full(len(messages), number, np.int64), np.full(len(messages), np.nan)
    voltage_V, current_A = _voltage_V(messages["voltage"]), _current_A(messages["current"])
    return BatteryMessages(instance, voltage_V, current_A, unknown, unknown, unknown)


KINDS = {
    fields.BATTERY_STATUS: MessageKind(BATTERY_STATUS, _battery_status),
    fields.SYS_STATUS: MessageKind(SYS_STATUS, _sys_status),
    fields.BATTERY2: MessageKind(BATTERY2, _battery2),
}


def _unless(unknown: Any, value: Any) -> Column:
    return np.where(unknown, np.nan, value)


def _voltage_V(mV: Any) -> Column:
    return _unless((mV == 0) | (mV == 65535), mV / 1000)


def _current_A(centiamps: Any) -> Column:
    return _unless((centiamps == -1) | (centiamps == 32767), centiamps / 100)


def _soc(percent: Any) -> Column:
    return _unless((percent < 0) | (percent > 100), percent / 100)
