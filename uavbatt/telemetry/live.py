"""Live frames -> rows of every battery of one vehicle, by the same rules and functions as a tlog is read.

    frame (any system) -> checksum -> the chosen vehicle's? -> HEARTBEAT: armed, PX4 or not
                                                               PARAM_VALUE: PackFacts of each battery
                                                               BATTERY_STATUS / SYS_STATUS / BATTERY2: a Sample

The vehicle is the first autopilot heard, unless system and component are given. SYS_STATUS speaks for battery 0
(BATTERY2 for 1) only where no BATTERY_STATUS does: such rows are held for FALLBACK_AFTER_S and then released.
The first row of a battery waits for its second: one damaged frame of 65 536 has a good checksum, and shall not make
a battery that nobody has.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from uavbatt.mavlink import fields, framing
from uavbatt.records import PackFacts, Sample
from uavbatt.telemetry.builder import LogBuilder
from uavbatt.telemetry.parameters import facts_timeline
from uavbatt.telemetry.tlog_frames import decoder

FALLBACK_AFTER_S = 5.0
CONFIRMED_WITHIN_S = 60.0
MOST_HELD = 500
MOST_PARAMETERS = 1000
BATTERY_IDS = (fields.BATTERY_STATUS, fields.SYS_STATUS, fields.BATTERY2)
WANTED = frozenset((*BATTERY_IDS, fields.HEARTBEAT, fields.PARAM_VALUE))
AUTOPILOT_COMPONENT = 1


class Row(NamedTuple):
    """One telemetry row of one battery."""

    instance: int
    sample: Sample


def checksum() -> Callable[[bytes], bool]:
    """Whether a whole frame's checksum is good; a message that this dialect does not know counts as good."""
    from pymavlink.dialects.v20 import ardupilotmega
    from pymavlink.generator.mavcrc import x25crc

    extras = {number: kind.crc_extra for number, kind in ardupilotmega.mavlink_map.items()}

    def is_good(frame: bytes) -> bool:
        extra = extras.get(framing.header(frame).message_id)
        if extra is None:
            return True
        end = (6 if frame[0] == framing.V1 else framing.V2_HEADER) + frame[1]
        crc = x25crc(frame[1:end] + bytes([extra]))
        return bool(crc.crc == frame[end] | frame[end + 1] << 8)

    return is_good


class LiveReader:
    """Frames of one vehicle in order of reception; holds what a row needs from earlier frames."""

    def __init__(self, system: int | None = None, component: int | None = None) -> None:
        self.system, self.component = system, component
        self._asked = (system, component)
        self._decode = decoder()
        self._log = LogBuilder()
        self.battery_ids: set[int] = set()
        self._said: dict[str, float] = {}  # parameters
        self._earlier: Mapping[str, float] = {}  # the same, said to an earlier process
        self.version = 0  # of the parameters
        self.is_px4 = False
        self.rejected = 0
        self._held: list[Row] = []
        self._unconfirmed: dict[int, Row] = {}
        self._first_s: float | None = None

    @property
    def now_s(self) -> float:
        """Time of the vehicle's last frame, from its first [s]."""
        return self._log.now_s

    @property
    def armed(self) -> bool | None:
        """The armed bit of the last heartbeat; None before it."""
        return self._log.armed

    @property
    def is_found(self) -> bool:
        """Whether the vehicle is known."""
        return self.system is not None and self.component is not None

    def belongs(self, header: framing.Header) -> bool:
        """Whether a frame is of the chosen vehicle's system."""
        return self.system is not None and header.system == self.system

    def take(self, frame: bytes, header: framing.Header, stamp_s: float) -> list[Row]:
        """Rows that this frame completes. `stamp_s` [s]: time of reception, never falling."""
        message: Any = None
        if header.message_id in WANTED:
            message = self._decode(frame)
            if not message:
                self.rejected += 1
                return []
            self._choose(header, message)
        if not self.belongs(header):
            return []
        time_s = self._log.time_s(stamp_s)
        if message is None or header.component != self.component:
            return []
        return self._rows(header.message_id, message, time_s)

    def facts(self, instance: int) -> PackFacts:
        """What the vehicle has said so far of one battery."""
        said = facts_timeline(((0.0, n, v) for n, v in self.parameters.items()), instance, is_telemetry=True)
        return said[-1][1] if said else PackFacts()

    @property
    def parameters(self) -> Mapping[str, float]:
        """The vehicle's parameters, as far as they are known."""
        return {**self._earlier, **self._said}

    def resume(self, parameters: Mapping[str, float]) -> None:
        """Parameters that an earlier process heard of this vehicle, instead of any resumed before."""
        self.version += 1
        self._earlier = parameters

    def _choose(self, header: framing.Header, message: Any) -> None:
        """Settle on the first autopilot: its heartbeat, or component 1 speaking of batteries or parameters."""
        if self.is_found:
            return
        system, component = self._asked
        if system not in (None, header.system) or component not in (None, header.component):
            return
        is_heartbeat = header.message_id == fields.HEARTBEAT
        if fields.is_autopilot(message) if is_heartbeat else header.component == (component or AUTOPILOT_COMPONENT):
            self.system, self.component = header.system, header.component

    def _rows(self, message_id: int, message: Any, time_s: float) -> list[Row]:
        if message_id == fields.HEARTBEAT:
            self._log.armed = fields.is_armed(message)
            self.is_px4 = message.autopilot == fields.AUTOPILOT_PX4
            return self._released(time_s)
        if message_id == fields.PARAM_VALUE:
            self._remember(*fields.parameter(message, self.is_px4))
            return []
        if message_id == fields.BATTERY_STATUS:
            row = self._row(time_s, fields.battery_status(message))
            if row is None:
                return []
            return self._confirmed(row)
        return self._fallback(message_id, message, time_s)

    def _confirmed(self, row: Row) -> list[Row]:
        """The row, with the first one of its battery if this is the second; nothing if it is the first."""
        if row.instance in self.battery_ids:
            return [row]
        first = self._unconfirmed.pop(row.instance, None)
        if first is None or row.sample.time_s - first.sample.time_s > CONFIRMED_WITHIN_S:
            self._unconfirmed[row.instance] = row
            return []
        self.battery_ids.add(row.instance)
        self._held = [held for held in self._held if held.instance not in self.battery_ids and held.instance != 0]
        return [first, row]

    def _fallback(self, message_id: int, message: Any, time_s: float) -> list[Row]:
        """A row of SYS_STATUS or BATTERY2, once it is clear that no BATTERY_STATUS speaks for it."""
        is_sys = message_id == fields.SYS_STATUS
        if self.battery_ids if is_sys else 1 in self.battery_ids:
            return []
        if self._first_s is None:
            self._first_s = time_s
        row = self._row(time_s, fields.sys_status(message) if is_sys else fields.battery2(message))
        if row is not None and len(self._held) < MOST_HELD:
            self._held.append(row)
        return self._released(time_s)

    def _released(self, time_s: float) -> list[Row]:
        if self._first_s is None or time_s - self._first_s < FALLBACK_AFTER_S:
            return []
        released, self._held = self._held, []
        return released

    def _row(self, time_s: float, battery: fields.BatteryFields) -> Row | None:
        """The row, cleaned by the rules of the log readers; None when they drop it."""
        sample = Sample(
            time_s=time_s,
            voltage_V=battery.voltage_V,
            current_A=battery.current_A,
            temp_C=battery.temp_C,
            consumed_Ah=battery.consumed_Ah,
            reported_soc=battery.reported_soc,
            armed=self._log.armed,
            cell_voltages_V=battery.cell_voltages_V,
        )
        if not self._log.add(battery.id, sample):
            return None
        kept = self._log.rows[battery.id]
        del kept[:-1]
        del self._log.notes[:-10]
        return Row(battery.id, kept[-1])

    def _remember(self, name: str, value: float) -> None:
        if name in self._said or len(self._said) < MOST_PARAMETERS:
            self.version += 1
            self._said[name] = value if value - value == 0.0 else float("nan")
