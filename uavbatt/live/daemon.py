"""The companion process: one loop from telemetry to every feed.

    links -> frames -> rows -> estimator of each battery -> reports -> proxy, named values, battery component, page
               |                                   |
               +-> recording (.tlog)               +-> recording (.jsonl), saved state

Nothing in a turn waits: links do not block, and a slow reader is dropped. The clock is an argument, so that tests can
set it. Only this loop feeds the watchdog and sends the heartbeat, so that both stop if the loop hangs.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.live import clock
from uavbatt.live.batteries import Batteries
from uavbatt.live.config import Config, signing_key
from uavbatt.live.feeds.proxy_client import ProxyClient
from uavbatt.live.feeds.sender import Sender
from uavbatt.live.headline import Headline
from uavbatt.live.listener import HeardFrame, Listener
from uavbatt.live.log import tell
from uavbatt.live.memory import state
from uavbatt.live.recorder import Recorder
from uavbatt.live.report import NOTHING_YET, Board, Report
from uavbatt.live.systemd import notify
from uavbatt.mavlink import fields
from uavbatt.mavlink.endpoint import Link
from uavbatt.mavlink.outgoing import Outgoing
from uavbatt.mavlink.pipe import wait
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.records import Status
from uavbatt.telemetry.formats.recording import PERIOD_NAME
from uavbatt.telemetry.link.live_row import LiveRow
from uavbatt.telemetry.link.vehicle import Vehicle

LONGEST_WAIT_S = 0.1
# A busy link wakes the loop 200 times a second at most; after a turn with FLOOD pieces or more there is no pause.
REST_S, FLOOD = 0.005, 32
STATUS_PERIOD_S = 5.0
STAMP_STEP_US = 4  # resolution of the times in a tlog [us]


class Daemon:
    """Daemon estimates every battery of one vehicle in flight; `turn` is one pass of its loop."""

    def __init__(
        self,
        config: Config,
        battery: BatteryFile,
        options: PackOptions,
        settings: ForecastSettings,
        link: Link,
        stations: Sequence[Link] = (),
        *,
        clock_s: Callable[[], float] = clock.now_s,
        wall_s: Callable[[], float] = time.time,
        is_clock_set: Callable[[float], bool] = state.is_clock_set,
    ) -> None:
        self.config, self.board = config, Board()
        self._settings, self._link, self._stations = settings, link, stations
        self._problems: dict[str, str] = {}  # of the links by endpoint, as they were told
        self._clock_s = clock_s
        self._start_s = clock_s()
        self._start_us = int(wall_s() * 1e6)
        self._stamp_us = 0
        key = signing_key(config.link.signing_key_file)
        self._listener = Listener(config, key)
        self._reader = self._listener.reader

        def clocks(now_s: float) -> state.Clock:
            unix_s = wall_s()
            return state.clock(now_s, unix_s, is_clock_set(unix_s))

        self.batteries = Batteries(config, battery, options, settings, self._reader, clocks, self._start_s)
        self._counts = {"rows": 0, "refused": 0}
        self._changes = 0  # of the vehicle that is followed
        self._recorder = Recorder(config.record) if config.record.folder else None
        self._sender = Sender(config, link, stations, key)
        self._headline = Headline()
        self._status_s = self._state_s = self._watch_s = -math.inf

    @property
    def armed(self) -> bool | None:
        """Return the armed bit of the followed vehicle's last heartbeat; None before it."""
        vehicle = self._reader.followed
        return vehicle.armed if vehicle is not None else None

    def run(self, is_stopped: Callable[[], bool]) -> None:
        """Run the loop until told to stop, then close everything."""
        notify("READY=1")
        while not is_stopped():
            descriptors = [fd for link in (self._link, *self._stations) for fd in link.filenos()]
            wait(descriptors, LONGEST_WAIT_S)
            if self.turn() < FLOOD:
                time.sleep(REST_S)
        notify("STOPPING=1")
        self.close()

    def turn(self) -> int:
        """Read what has come in and send what is due; return the number of pieces that came in."""
        now_s = self._clock_s()
        pieces = self._link.read(now_s)
        for frame in self._listener.frames(pieces):
            self._take(frame, now_s)
        for station in self._stations:
            station.read(now_s)  # read and dropped: we do not answer requests of a ground station
        late_s = self._reader.late_s
        known = {number: report.late_by(late_s) for number, report in self.batteries.reports.items()}
        reports = self._headline.in_order(known, now_s, self.armed)
        self._sender.send(now_s, reports, self._reader)
        self._housekeeping(now_s, reports)
        return len(pieces)

    def close(self) -> None:
        """Save the state, close the recording and all links."""
        self.batteries.close(self._clock_s())
        if self._recorder is not None:
            self._recorder.close()
        if isinstance(self._link, ProxyClient):
            self._link.stop()
        for link in (self._link, *self._stations):
            link.close()

    def _take(self, frame: HeardFrame, now_s: float) -> None:
        """Process one complete and valid frame."""
        us = self._start_us + int((now_s - self._start_s) * 1e6)
        self._stamp_us = max(us & ~(STAMP_STEP_US - 1), self._stamp_us + STAMP_STEP_US)
        rows, is_ours = self._reader.take(frame.data, frame.header, self._stamp_us / 1e6, frame.sender)
        if self._reader.following.changes != self._changes:
            self._begin_vehicle(now_s)
        vehicle = self._reader.followed
        if vehicle is None or not is_ours:
            return
        if frame.header.message_id == fields.AUTOPILOT_VERSION:
            self.batteries.look_at_vehicle()
        if self._recorder is not None:
            self._record(self._recorder, vehicle, frame, now_s)
        for row in rows:
            if self.config.pack.instance in (None, row.instance):
                self._step(row, vehicle, now_s)

    def _begin_vehicle(self, now_s: float) -> None:
        """Drop the last vehicle, as another one is followed from now on, and announce it."""
        self._changes = self._reader.following.changes
        if self.batteries.reports:
            self.board.trend.forget()
        self.batteries.begin_vehicle()
        self._sender.begin_vehicle(now_s, self._reader.following)
        self._headline = Headline()
        if self._recorder is not None and self._reader.followed is not None:
            self._recorder.begin_anew(self._reader.followed.words)

    def _record(self, recorder: Recorder, vehicle: Vehicle, frame: HeardFrame, now_s: float) -> None:
        """Record a frame of the vehicle, and before its first one the time between our forecasts."""
        if not recorder.remembers(PERIOD_NAME.encode()):
            own = Outgoing(frame.header.system, self.config.link.own_component)
            period = own.parameter(PERIOD_NAME, self._settings.forecast_period_s)
            recorder.remember(PERIOD_NAME.encode(), period)
        recorder.frame(frame.data, self._stamp_us, vehicle.now_s, now_s, vehicle.armed)

    def _step(self, row: LiveRow, vehicle: Vehicle, now_s: float) -> None:
        """Estimate one row, and tell the proxy at once, so that the next frame carries the new time."""
        before = self.batteries.reports.get(row.instance)
        if before is not None and before.is_stale(now_s):
            self._sender.requests.begin_again()
        report = self.batteries.step(row, vehicle, now_s)
        self._counts["rows"] += 1
        self._counts["refused"] += report.remaining.status is Status.REFUSED
        self._sender.requests.row()
        if isinstance(self._link, ProxyClient) and "proxy" in self.config.feed.kinds:
            self._link.estimate(report.late_by(self._reader.late_s), now_s)
        if self._recorder is not None:
            if before is None and self.batteries.tracked[row.instance].resumed:
                self._recorder.tell_again(self._stamp_us, now_s)
            self._recorder.step(report.instance, report.estimate, report.remaining, now_s)

    def _housekeeping(self, now_s: float, reports: Sequence[Report]) -> None:
        """Publish, flush, save, and tell the service manager."""
        notes = [*self._link_notes(), *self.batteries.notes(now_s), *self._headline.notes, *self._listener.notes()]
        if self._recorder is not None and self._recorder.problem:
            notes.append(self._recorder.problem)
        trend = self.board.trend
        trend.look(now_s, reports)
        counts = {**self._listener.counts, **self._counts}
        self.board = Board(
            tuple(reports), tuple(notes), counts, trend, self._link.problem, tuple(self._sender.announcements)
        )
        if self._recorder is not None:
            self._recorder.flush(now_s)
        if now_s >= self._state_s:
            self._state_s = now_s + self.config.state.period_s
            self.batteries.save(now_s)
        if now_s >= self._watch_s:
            self._watch_s = now_s + 1.0
            notify("WATCHDOG=1")
        if now_s >= self._status_s:
            self._status_s = now_s + STATUS_PERIOD_S
            notify(f"STATUS={self._words(now_s, reports)}")

    def _link_notes(self) -> list[str]:
        """Return the problems of links that are not open; each change goes to the log once."""
        names = (self.config.link.endpoint, *self.config.link.gcs)
        problems = {name: link.problem for name, link in zip(names, (self._link, *self._stations), strict=False)}
        for name, problem in problems.items():
            if problem != self._problems.get(name, ""):
                tell(problem or f"{name} is open")
        self._problems = problems
        return [*filter(None, problems.values())]

    def _words(self, now_s: float, reports: Sequence[Report]) -> str:
        """Return one line for `systemctl status`."""
        if not reports:
            return self._link.problem or NOTHING_YET
        shown = reports[0].at(now_s)
        if math.isfinite(shown.remaining_s):
            return f"{shown.remaining_s / 60:.1f} min left ({shown.remaining_lo_s / 60:.1f} at worst), {shown.status}"
        return shown.reason if reports[0].is_waiting else f"{shown.status}: {shown.reason}"
