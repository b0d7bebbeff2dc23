"""A daemon without sockets, its links and its clocks in the hands of a test or a script."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.battery import battery_file
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.live.config import Config, LinkSection
from uavbatt.live.daemon import Daemon
from uavbatt.mavlink.endpoint import Chunk
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.records import Sample
from uavbatt.simulate.tlog_writer import battery_status, heartbeat

OPTIONS = PackOptions(capacity_Ah=5.0, cells=4)


class FakeLink:
    """A FakeLink is a link without a socket: the caller puts in what it reads, and looks at what it writes."""

    is_stream, problem = False, ""

    def __init__(self) -> None:
        self.incoming: list[Chunk] = []
        self.sent: list[bytes] = []

    def filenos(self) -> Iterator[int]:
        return iter(())

    def read(self, now_s: float) -> list[Chunk]:
        taken, self.incoming = self.incoming, []
        return taken

    def write(self, data: bytes, now_s: float) -> None:
        self.sent.append(data)

    @property
    def messages(self) -> list[Any]:
        """Return what was written, as messages."""
        return [dialect.MAVLink(None).decode(bytearray(data)) for data in self.sent]

    def close(self) -> None:
        pass


class Bench:
    """A Bench holds a daemon, its links and its clocks."""

    def __init__(
        self,
        options: PackOptions = OPTIONS,
        start_s: float = 1000.0,
        *,
        settings: ForecastSettings = ForecastSettings(),
        is_clock_set: bool = True,
        **sections: Any,
    ) -> None:
        self.now_s, self.wall_offset_s = start_s, 1.7e9
        self.link, self.station = FakeLink(), FakeLink()
        sections.setdefault("link", LinkSection(endpoint="udpin:127.0.0.1:1", gcs=["udpout:127.0.0.1:2"]))
        self.daemon = Daemon(
            Config(**sections), battery_file.read_battery("lipo-generic"), options, settings, self.link, [self.station],
            clock_s=lambda: self.now_s, wall_s=lambda: self.wall_offset_s + self.now_s,
            is_clock_set=lambda wall_s: is_clock_set,
        )  # fmt: skip
        self._out: Any = dialect.MAVLink(None, srcSystem=1, srcComponent=1)

    def framed(self, message: Any, system: int = 1, component: int = 1) -> bytes:
        self._out.srcSystem, self._out.srcComponent = system, component
        frame = bytes(message.pack(self._out))
        self._out.seq = (self._out.seq + 1) % 256
        return frame

    def send(self, message: Any, system: int = 1, component: int = 1, sender: object = "fc") -> None:
        self.link.incoming.append((self.framed(message, system, component), sender))

    def fly(self, seconds: float, volts: float = 16.0, used: float = 0.0) -> None:
        """Fly at 12 A with telemetry at 5 Hz for so many seconds; `used` [Ah] was drawn before."""
        rate_Hz, amps = 5.0, 12.0
        for k in range(int(seconds * rate_Hz)):
            if k % int(rate_Hz) == 0:
                self.send(heartbeat(True))
            drawn = amps * k / rate_Hz / 3600.0
            self.send(battery_status(Sample(0.0, volts - 0.5 * drawn, amps, 25.0, used + drawn, armed=True), 0))
            self.daemon.turn()
            self.now_s += 1.0 / rate_Hz

    def play(self, samples: Iterable[Sample]) -> None:
        """Play rows at their own times, a heartbeat before each."""
        last_s: float | None = None
        for sample in samples:
            self.now_s += sample.time_s - last_s if last_s is not None else 0.0
            last_s = sample.time_s
            self.send(heartbeat(bool(sample.armed)))
            self.send(battery_status(sample, 0))
            self.daemon.turn()

    def to_gcs(self) -> list[Any]:
        return [dialect.MAVLink(None).decode(bytearray(data)) for data in self.station.sent]

    def named(self) -> dict[str, float]:
        return {m.name: m.value for m in self.to_gcs() if m.get_type() == "NAMED_VALUE_FLOAT"}
