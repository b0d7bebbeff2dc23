"""A flight through the companion process itself: rows and parameters in as MAVLink over UDP, what it says out.

    rows, parameters, extra frames -> UDP -> Daemon, by a clock of ours -> UDP -> STATUSTEXT
                                                 |
                                                 +-> what every feed shows at each row

The daemon, its links and its frames are those of `uavbatt live`; only the clock is handed in, so that a flight of a
quarter of an hour takes seconds. A silence is a gap between rows: the loop goes on turning, nobody speaks.
"""

from __future__ import annotations

import re
import socket
import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.battery import battery_file
from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.live.config import Config, LinkSection
from uavbatt.live.daemon import Daemon
from uavbatt.mavlink import framing
from uavbatt.mavlink.links import open_link
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.records import NAN, Sample
from uavbatt.simulate.tlog_writer import battery_status

START_S, WALL_S = 1000.0, 1.7e9  # of the process's clocks at the first row
PERIOD_S = 5.0  # between forecasts; in flight it is 1 s, which would take four times as long here
TURN_S = 1.0
BUSY_GAP_S, SLOW_TURN_S = 30.0, 600.0  # of a long silence only the first and last half minute are turned through
STATUSTEXT = 253
TIME_LEFT = re.compile(r"(\d+):(\d\d) min left")
AUTOPILOT = "autopilot"


@dataclass(frozen=True, slots=True)
class Extra:
    """An Extra is a frame that is sent just before the first row at or after `time_s` [s]."""

    time_s: float
    message: Any  # of pymavlink
    system: int = 1
    component: int = 1
    sender: str = AUTOPILOT  # each sender has a socket, so an address, of its own


@dataclass(frozen=True, slots=True)
class Shown:
    """Shown holds what the feeds show after a row; NaN is unknown, `status` empty before the first report."""

    time_s: float
    remaining_s: float = NAN
    remaining_lo_s: float = NAN
    remaining_hi_s: float = NAN
    remaining_alarm_s: float = NAN
    soc: float = NAN
    status: str = ""
    reason: str = ""
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()  # of the page


@dataclass(frozen=True, slots=True)
class Text:
    """A Text is a STATUSTEXT as the ground station received it."""

    time_s: float
    severity: int
    text: str

    @property
    def left_s(self) -> float:
        """Return the time left that it speaks of [s]; NaN when it speaks of something else."""
        said = TIME_LEFT.search(self.text)
        return 60.0 * int(said[1]) + int(said[2]) if said else NAN


@dataclass(frozen=True, slots=True)
class Flown:
    """Flown holds a row of output for every row of input, and all that was said; times are those of the rows."""

    rows: tuple[Shown, ...]
    texts: tuple[Text, ...]

    def alarm_s(self, threshold_s: float = 120.0) -> float:
        """Return when the ground station was first told that so much time was left, or less [s]; NaN if never."""
        return next((t.time_s for t in self.texts if t.left_s <= threshold_s), NAN)


def flown_live(
    rows: Sequence[Sample],
    options: PackOptions,
    *,
    battery: str | BatteryFile = "lipo-generic",
    parameters: Mapping[str, float] | None = None,
    is_px4: bool = False,
    extras: Sequence[Extra] = (),
    **sections: Any,
) -> Flown:
    """Fly the rows through a daemon of its own.

    parameters are sent with the first row: whole numbers (`int`) as PX4 sends them, if it is one. sections are those
    of the configuration (`feed`, `state`, ...).
    """
    content = battery_file.read_battery(battery) if isinstance(battery, str) else battery
    with closing(Flight(content, options, is_px4, sections)) as flight:
        shown = []
        coming = sorted(extras, key=lambda extra: extra.time_s)
        for number, row in enumerate(rows):
            flight.turn_until(row.time_s)
            while coming and coming[0].time_s <= row.time_s:
                flight.send_extra(coming.pop(0))
            flight.send(heartbeat(bool(row.armed), is_px4))
            for name, value in (parameters or {}).items() if number == 0 else ():
                flight.send(parameter(name, value, is_px4))
            flight.send(battery_status(row, 0))
            flight.turn()
            shown.append(flight.shown(row.time_s))
        return Flown(tuple(shown), tuple(flight.texts))


class Flight:
    """A Flight runs a daemon between a vehicle and a ground station, on sockets of this machine."""

    def __init__(self, battery: BatteryFile, options: PackOptions, is_px4: bool, sections: Mapping[str, Any]) -> None:
        self.texts: list[Text] = []
        self._time_s: float | None = None  # of the rows
        self._vehicles: dict[str, socket.socket] = {}
        self._packer: Any = dialect.MAVLink(None)
        self._station, at_station = _bound()
        probe, at_daemon = _bound()
        probe.close()
        self._at_daemon = at_daemon
        link = LinkSection(endpoint=f"udpin:{_address(at_daemon)}", gcs=[f"udpout:{_address(at_station)}"])
        self._daemon = Daemon(
            Config(link=link, **sections), battery, options, ForecastSettings(forecast_period_s=PERIOD_S),
            open_link(link.endpoint), [open_link(link.gcs[0])],
            clock_s=lambda: START_S + (self._time_s or 0.0), wall_s=lambda: WALL_S + (self._time_s or 0.0),
        )  # fmt: skip

    def send(self, message: Any, system: int = 1, component: int = 1, sender: str = AUTOPILOT) -> None:
        """Send a frame of the vehicle, or of whoever sends it."""
        self._packer.srcSystem, self._packer.srcComponent = system, component
        frame = bytes(message.pack(self._packer))
        self._packer.seq = (self._packer.seq + 1) % 256
        if sender not in self._vehicles:
            self._vehicles[sender] = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._vehicles[sender].sendto(frame, self._at_daemon)

    def send_extra(self, extra: Extra) -> None:
        """Send a frame besides the rows."""
        self.send(extra.message, extra.system, extra.component, extra.sender)

    def turn_until(self, time_s: float) -> None:
        """Let the loop turn through what lies before the next row."""
        begin_s = time_s if self._time_s is None else self._time_s
        for at_s in _turns(begin_s, time_s):
            self._time_s = at_s
            self.turn()
        self._time_s = time_s

    def turn(self) -> None:
        """Run one pass of the loop; the ground station takes what it is sent."""
        self._daemon.turn()
        while True:
            try:
                frame = self._station.recv(65_536)
            except BlockingIOError:
                return
            if framing.header(frame).message_id == STATUSTEXT:
                said = dialect.MAVLink(None).decode(bytearray(frame))
                self.texts.append(Text(self._time_s or 0.0, said.severity, said.text))

    def shown(self, time_s: float) -> Shown:
        """Return what the battery that speaks for the vehicle shows now."""
        board = self._daemon.board
        if not board.reports:
            return Shown(time_s, notes=board.notes)
        report = board.reports[0]
        now = report.at(START_S + time_s)
        left = (now.remaining_s, now.remaining_lo_s, now.remaining_hi_s, now.remaining_alarm_s)
        warnings = report.estimate.warnings
        return Shown(time_s, *left, now.soc, now.status.value, now.reason, warnings, board.notes)

    def close(self) -> None:
        """End the daemon, release the sockets."""
        self._daemon.close()
        for line in (self._station, *self._vehicles.values()):
            line.close()


def heartbeat(armed: bool, is_px4: bool) -> Any:
    """Return a HEARTBEAT of a multicopter."""
    autopilot = dialect.MAV_AUTOPILOT_PX4 if is_px4 else dialect.MAV_AUTOPILOT_ARDUPILOTMEGA
    mode = dialect.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
    return dialect.MAVLink_heartbeat_message(dialect.MAV_TYPE_QUADROTOR, autopilot, mode, 0, 4, 3)


def parameter(name: str, value: float, is_px4: bool = False) -> Any:
    """Return a PARAM_VALUE; PX4 sends an `int` as the bits of 32."""
    kind = dialect.MAV_PARAM_TYPE_REAL32
    if is_px4 and isinstance(value, int):
        kind, (value,) = dialect.MAV_PARAM_TYPE_INT32, struct.unpack("<f", struct.pack("<i", value))
    return dialect.MAVLink_param_value_message(name.encode(), value, kind, 1, 0)


def _turns(begin_s: float, end_s: float) -> Iterator[float]:
    """Return instants between two rows, every TURN_S, seldom in the middle of a long silence."""
    at_s = begin_s + TURN_S
    while at_s < end_s - 1e-6:
        yield at_s
        is_middle = at_s - begin_s > BUSY_GAP_S and end_s - at_s > BUSY_GAP_S + SLOW_TURN_S
        at_s += SLOW_TURN_S if is_middle else TURN_S


def _bound() -> tuple[socket.socket, tuple[str, int]]:
    """Return a UDP socket of this machine with a port of its own."""
    line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    line.bind(("127.0.0.1", 0))
    line.setblocking(False)
    host, port = line.getsockname()
    return line, (host, port)


def _address(at: tuple[str, int]) -> str:
    return f"{at[0]}:{at[1]}"
