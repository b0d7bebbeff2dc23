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
from uavbatt.telemetry.formats.chain import Bytes, Mask

HEARTBEAT = np.dtype([("custom_mode", "<u4"), ("type", "u1"), ("autopilot", "u1"), ("base_mode", "u1")])
PARAM_VALUE = np.dtype([("value", "<f4"), ("count", "<u2"), ("index", "<u2"), ("id", "S16"), ("type", "u1")])
SYS_STATUS = np.dtype(
    {"names": ["voltage", "current", "remaining"], "formats": ["<u2", "<i2", "i1"], "offsets": [14, 16, 30]}
)
BATTERY2 = np.dtype([("voltage", "<u2"), ("current", "<i2")])
BATTERY_STATUS = np.dtype(
    {
        "names": ["consumed", "temperature", "voltages", "current", "id", "remaining", "voltages_ext"],
        "formats": ["<i4", "<i2", ("<u2", 10), "<i2", "u1", "i1", ("<u2", 4)],
        "offsets": [0, 8, 10, 30, 32, 35, 41],
    }
)
AUTOPILOT_VERSION = np.dtype({"names": ["uid", "flight_sw"], "formats": ["<u8", "<u4"], "offsets": [8, 16]})
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
    """A MessageKind of battery message has a layout, and a function that says what its payloads mean."""

    layout: np.dtype[Any]
    read: Callable[[Any], BatteryMessages]

    def messages(self, payloads: Bytes) -> BatteryMessages:
        """Return what the payloads say."""
        return self.read(payloads.view(self.layout)[:, 0])


class _Beat(NamedTuple):
    type: int
    autopilot: int
    base_mode: int


class _Parameter(NamedTuple):
    param_id: str
    param_value: float
    param_type: int


def heartbeats(payloads: Bytes, is_so: Callable[[Any], bool]) -> Mask:
    """Return the mask of the heartbeats for which `is_so` holds; it is asked once for each kind of heartbeat."""
    beats = payloads.view(HEARTBEAT)[:, 0]
    packed = beats["type"].astype(np.int32) << 16 | beats["autopilot"].astype(np.int32) << 8 | beats["base_mode"]
    found = np.zeros(len(packed), np.bool_)
    for kind in distinct(packed):
        if is_so(_Beat(kind >> 16, kind >> 8 & 0xFF, kind & 0xFF)):
            found |= packed == kind
    return found


def parameters(payloads: Bytes, is_px4: Iterable[bool]) -> Iterator[tuple[str, float]]:
    """Yield the name and value of every PARAM_VALUE."""
    messages = payloads.view(PARAM_VALUE)[:, 0]
    columns = (messages["id"].tolist(), messages["value"].tolist(), messages["type"].tolist())
    for name, value, kind, px4 in zip(*columns, is_px4, strict=True):
        text = name.split(b"\0", 1)[0].decode("ascii", errors="replace")
        yield fields.parameter(_Parameter(text, value, kind), px4)


def are_integers(payloads: Bytes) -> Mask:
    """Return the mask of the PARAM_VALUE payloads that hold an integer."""
    return np.isin(payloads.view(PARAM_VALUE)["type"][:, 0], list(fields.INTEGER_CODES))


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
    unknown = np.full(len(messages), np.nan)
    instance = np.zeros(len(messages), np.int64)
    return BatteryMessages(
        instance,
        _voltage_V(messages["voltage"]),
        _current_A(messages["current"]),
        unknown,
        unknown,
        _soc(messages["remaining"]),
    )


def _battery2(messages: Any) -> BatteryMessages:
    unknown = np.full(len(messages), np.nan)
    instance = np.ones(len(messages), np.int64)
    return BatteryMessages(
        instance, _voltage_V(messages["voltage"]), _current_A(messages["current"]), unknown, unknown, unknown
    )


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
