"""Our own frames: MAVLink 2, packed by pymavlink; unknown values become the sentinel of each field.

They have the vehicle's system id, and the component of the companion (`own_component` of the configuration) or BATTERY.
If a key is given they are signed with the time of the wall clock, because a receiver refuses a stream that begins a
minute late. `originated` lists which of them may go to the autopilot.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

BATTERY, BATTERY_2 = 180, 181  # MAV_COMP_ID
SET_MESSAGE_INTERVAL = 511
SEVERITY_CRITICAL, SEVERITY_WARNING, SEVERITY_NOTICE = 2, 4, 5
UINT16_MAX, INT16_MAX = 65535, 32767
LONGEST_TEXT, LONGEST_NAME = 50, 10
SIGNING_EPOCH_S, SIGNING_TICKS_PER_S = 1_420_070_400, 100_000  # 2015-01-01, 10 us


class Outgoing:
    """Outgoing packs frames of one component and counts their sequence."""

    def __init__(
        self,
        system: int,
        component: int,
        signing_key: bytes | None = None,
        wall_s: Callable[[], float] = time.time,
    ) -> None:
        self._wall_s = wall_s
        self.system, self.component = system, component
        self._link: Any = dialect.MAVLink(None, srcSystem=system, srcComponent=component)
        if signing_key is not None:
            self._link.signing.secret_key = signing_key
            self._link.signing.link_id = component
            self._link.signing.sign_outgoing = True

    def pack(self, message: Any) -> bytes:
        """Return the frame of a message, signed where a key was given."""
        signing = self._link.signing
        if signing.sign_outgoing:  # never falls, whatever the clock does
            ticks = int((self._wall_s() - SIGNING_EPOCH_S) * SIGNING_TICKS_PER_S)
            signing.timestamp = max(signing.timestamp, ticks)
        frame = bytes(message.pack(self._link))
        self._link.seq = (self._link.seq + 1) % 256
        return frame

    def heartbeat(self) -> bytes:
        """Return a HEARTBEAT: of an onboard controller, or of a battery when this is a battery's component."""
        is_battery = self.component in (BATTERY, BATTERY_2)
        kind = dialect.MAV_TYPE_BATTERY if is_battery else dialect.MAV_TYPE_ONBOARD_CONTROLLER
        return self.pack(
            dialect.MAVLink_heartbeat_message(kind, dialect.MAV_AUTOPILOT_INVALID, 0, 0, dialect.MAV_STATE_ACTIVE, 3)
        )

    def interval_request(self, component: int, message_id: int, rate_Hz: float) -> bytes:
        """Return COMMAND_LONG SET_MESSAGE_INTERVAL: it asks for `message_id` every 1/`rate_Hz` seconds."""
        interval_us = 1e6 / rate_Hz
        return self.pack(
            dialect.MAVLink_command_long_message(
                self.system, component, SET_MESSAGE_INTERVAL, 0, message_id, interval_us, 0, 0, 0, 0, 0
            )
        )

    def parameter_request(self, component: int, name: str) -> bytes:
        """Return PARAM_REQUEST_READ, which asks for a parameter by name."""
        return self.pack(
            dialect.MAVLink_param_request_read_message(self.system, component, name.encode("ascii")[:16], -1)
        )

    def mission_list_request(self, component: int) -> bytes:
        """Return MISSION_REQUEST_LIST, which asks how many items the mission has."""
        return self.pack(dialect.MAVLink_mission_request_list_message(self.system, component))

    def mission_item_request(self, component: int, seq: int) -> bytes:
        """Return MISSION_REQUEST_INT, which asks for item `seq`."""
        return self.pack(dialect.MAVLink_mission_request_int_message(self.system, component, seq))

    def mission_acknowledgement(self, component: int, is_whole: bool) -> bytes:
        """Return the MISSION_ACK that ends our reading: the mission is whole, or we break off."""
        result = dialect.MAV_MISSION_ACCEPTED if is_whole else dialect.MAV_MISSION_OPERATION_CANCELLED
        return self.pack(dialect.MAVLink_mission_ack_message(self.system, component, result))

    def parameter(self, name: str, value: float) -> bytes:
        """Return a PARAM_VALUE of our own; only a recording holds one."""
        real = dialect.MAV_PARAM_TYPE_REAL32
        return self.pack(dialect.MAVLink_param_value_message(name.encode("ascii")[:16], value, real, 1, 0))

    def named_value(self, name: str, value: float, boot_ms: int) -> bytes:
        """Return NAMED_VALUE_FLOAT; NaN stays NaN: unknown."""
        label = name.encode("ascii")[:LONGEST_NAME]
        return self.pack(dialect.MAVLink_named_value_float_message(boot_ms & 0xFFFFFFFF, label, value))

    def text(self, severity: int, text: str) -> bytes:
        """Return STATUSTEXT, cut to 50 bytes."""
        content = text.encode("ascii", "replace")[:LONGEST_TEXT]
        return self.pack(dialect.MAVLink_statustext_message(severity, content))

    def battery(
        self,
        battery_id: int,
        *,
        voltage_V: float,
        current_A: float,
        temp_C: float,
        soc: float,
        remaining_s: float,
        charge_state: int = dialect.MAV_BATTERY_CHARGE_STATE_UNDEFINED,
    ) -> bytes:
        """Return BATTERY_STATUS of our own battery: its function is unknown, NaN becomes the field's sentinel."""
        return self.pack(
            dialect.MAVLink_battery_status_message(
                battery_id,
                dialect.MAV_BATTERY_FUNCTION_UNKNOWN,
                dialect.MAV_BATTERY_TYPE_UNKNOWN,
                _bounded(temp_C * 100.0, INT16_MAX, -INT16_MAX, INT16_MAX - 1),
                _pack_mV(voltage_V),
                _current_cA(current_A),
                -1,
                -1,
                _bounded(soc * 100.0, -1, 0, 100),
                seconds(remaining_s),
                charge_state,
            )
        )


def seconds(remaining_s: float) -> int:
    """Return time_remaining [s] for the wire: 0 is "not provided", so that a known time is at least 1."""
    return max(int(remaining_s), 1) if math.isfinite(remaining_s) else 0


def _bounded(value: float, unknown: int, low: int, high: int) -> int:
    return min(max(round(value), low), high) if math.isfinite(value) else unknown


def _current_cA(current_A: float) -> int:
    centi = _bounded(current_A * 100.0, -1, -INT16_MAX, INT16_MAX - 1)
    return -2 if centi == -1 and math.isfinite(current_A) else centi


def _pack_mV(voltage_V: float) -> list[int]:
    """Return voltages[10]: the pack in the first entry, the part above 65534 mV in the second."""
    fields = [UINT16_MAX] * 10
    total_mV = _bounded(voltage_V * 1000.0, UINT16_MAX, 0, 2 * (UINT16_MAX - 1))
    if math.isfinite(voltage_V):
        fields[0] = min(total_mV, UINT16_MAX - 1)
        if total_mV >= UINT16_MAX - 1:
            fields[1] = total_mV - fields[0]
    return fields
