"""The companion process: one loop from telemetry to every feed.

    links -> frames -> rows -> estimator of each battery -> reports -> proxy, named values, battery component, page
               |                                   |
               +-> recording (.tlog)               +-> recording (.jsonl), saved state

Nothing waits for anything: links do not block, a slow reader is dropped, the clock is handed in. The watchdog is fed
by this loop alone, and only it writes the heartbeat: a process that hangs falls silent.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from uavbatt.battery.file import BatteryFile
from uavbatt.config import Config
from uavbatt.errors import UavbattError
from uavbatt.feed import state
from uavbatt.feed.notify import notify
from uavbatt.feed.now import STALE_AFTER_S, Report, Trend
from uavbatt.feed.proxy_client import ProxyClient
from uavbatt.feed.recorder import Recorder
from uavbatt.mavlink import fields, framing
from uavbatt.mavlink.endpoint import Link
from uavbatt.mavlink.outgoing import Outgoing
from uavbatt.mavlink.pipe import wait
from uavbatt.pipeline import PackOptions
from uavbatt.records import PackFacts, Status
from uavbatt.sender import Sender, in_order
from uavbatt.telemetry.live import LiveReader, Row, checksum
from uavbatt.telemetry.recording import PERIOD_NAME
from uavbatt.tracked import TrackedBattery

LONGEST_WAIT_S = 0.1
REST_S, FLOOD = 0.005, 32  # a busy link wakes the loop 200 times a second at most; a flood is not made to wait
MOST_SENDERS = 32
STATUS_PERIOD_S = 5.0
NOTE_S = 60.0
STAMP_STEP_US = 4  # a tlog's times are true to 4 us


@dataclass(slots=True)
class Board:
    """What other threads may read: replaced whole, never changed in place."""

    reports: tuple[Report, ...] = ()
    notes: tuple[str, ...] = ()
    counts: Mapping[str, int] = field(default_factory=dict)
    trend: Trend = field(default_factory=Trend)


class Daemon:
    """Estimates every battery of one vehicle while it flies; `turn` is one pass of the loop."""

    def __init__(
        self,
        config: Config,
        battery: BatteryFile,
        options: PackOptions,
        link: Link,
        stations: Sequence[Link] = (),
        *,
        clock_s: Callable[[], float] = time.monotonic,
        wall_s: Callable[[], float] = time.time,
    ) -> None:
        self.config, self.board = config, Board()
        self._battery, self._options = battery, options
        self._link, self._stations = link, stations
        self._clock_s, self._wall_s = clock_s, wall_s
        self._start_s = clock_s()
        self._start_us = int(wall_s() * 1e6)
        self._stamp_us = 0
        self._reader = LiveReader(config.link.system, config.link.component)
        self._is_good = checksum()
        self._frames: dict[object, framing.Frames] = {}
        self._tracked: dict[int, TrackedBattery] = {}
        self._facts: dict[int, tuple[int, PackFacts]] = {}
        self._reports: dict[int, Report] = {}
        self._counts = {"frames": 0, "bad_checksums": 0, "rows": 0, "refused": 0}
        self._recorder = Recorder(config.record) if config.record.folder else None
        self._sender = Sender(config, link, stations)
        self._status_s = self._state_s = self._watch_s = float("-inf")
        self._saved, self._note = self._load_state()
        self._state_problem = ""

    def run(self, is_stopped: Callable[[], bool]) -> None:
        """Until told to stop; then what is held is written out."""
        notify("READY=1")
        while not is_stopped():
            descriptors = [fd for link in (self._link, *self._stations) for fd in link.filenos()]
            wait(descriptors, LONGEST_WAIT_S)
            if self.turn() < FLOOD:
                time.sleep(REST_S)
        notify("STOPPING=1")
        self.close()

    def turn(self) -> int:
        """Take in what has come, send what is due; how many pieces came."""
        now_s = self._clock_s()
        pieces = self._link.read(now_s)
        for data, sender in pieces:
            if sender not in self._frames and len(self._frames) >= MOST_SENDERS:
                self._frames.pop(next(iter(self._frames)))
            frames = self._frames.setdefault(sender, framing.Frames())
            for frame in frames.feed(data):
                if not self._is_good(frame):
                    frames.reject()
                    self._counts["bad_checksums"] += 1
                    continue
                self._take(frame, now_s)
        for station in self._stations:
            station.read(now_s)  # its requests are not ours to answer
        self._sender.send(now_s, in_order(self._reports), self._reader)
        self._look_after(now_s)
        return len(pieces)

    def close(self) -> None:
        """Write out what is held, release everything."""
        self._save(self._clock_s())
        if self._recorder is not None:
            self._recorder.close()
        if isinstance(self._link, ProxyClient):
            self._link.stop()
        for link in (self._link, *self._stations):
            link.close()

    def _take(self, frame: bytes, now_s: float) -> None:
        """One whole frame with a good checksum."""
        self._counts["frames"] += 1
        header = framing.header(frame)
        us = self._start_us + int((now_s - self._start_s) * 1e6)
        self._stamp_us = max(us & ~(STAMP_STEP_US - 1), self._stamp_us + STAMP_STEP_US)
        rows = self._reader.take(frame, header, self._stamp_us / 1e6)
        if self._recorder is not None and self._reader.belongs(header):
            self._record(frame, header, now_s)
        for row in rows:
            if self.config.pack.instance in (None, row.instance):
                self._step(row, now_s)

    def _record(self, frame: bytes, header: framing.Header, now_s: float) -> None:
        assert self._recorder is not None
        if header.component == self._reader.component:
            if header.message_id == fields.HEARTBEAT:
                self._recorder.remember(b"heartbeat", frame)
            elif header.message_id == fields.PARAM_VALUE:
                start = 10 if frame[0] == framing.V2 else 6
                name = frame[start + 8 : start + 24].split(b"\0")[0]
                if name.startswith((b"BAT", b"FS_BATT")):
                    self._recorder.remember(name, frame)
        if not self._recorder.remembers(PERIOD_NAME.encode()):
            own = Outgoing(header.system, self.config.link.own_component)
            period = own.parameter(PERIOD_NAME, self._options.forecast_period_s)
            self._recorder.remember(PERIOD_NAME.encode(), period)
        self._recorder.frame(frame, self._stamp_us, self._reader.now_s, now_s, self._reader.armed)

    def _step(self, row: Row, now_s: float) -> None:
        """One row through its estimator and to the proxy, which must have it before the next frame."""
        instance = row.instance
        before = self._reports.get(instance)
        if before is not None and before.age_s(now_s) > STALE_AFTER_S:
            self._sender.requests.begin_again()
        if instance not in self._tracked:
            saved = self._saved.get("batteries", {}).get(str(instance))
            limit_s = self.config.state.max_age_s
            self._tracked[instance] = TrackedBattery(self._battery, self._options, saved, limit_s)
        tracked = self._tracked[instance]
        gap_s = now_s - self._start_s + self._saved.get("age_s", 0.0)
        estimate, remaining = tracked.step(row.sample, self._facts_of(instance), gap_s)
        resolved = tracked.estimator.resolved
        if resolved is not None and (before is None or before.cells != resolved.cells):
            with suppress(OSError, ValueError):  # whoever read our words may be gone: that ends no flight
                print(f"uavbatt: battery {instance}: {resolved.words}", file=sys.stderr, flush=True)
        self._counts["rows"] += 1
        self._counts["refused"] += remaining.status is Status.REFUSED
        self._sender.requests.row()
        report = Report(
            instance=instance,
            system=self._reader.system or 0,
            component=self._reader.component or 0,
            estimate=estimate,
            remaining=remaining,
            received_s=now_s,
            rows=before.rows + 1 if before is not None else 1,
            cells=resolved.cells if resolved is not None else 0,
            battery=self._battery.battery.name,
            certificate=self._battery.status,
        )
        self._reports[instance] = report
        if isinstance(self._link, ProxyClient) and "proxy" in self.config.feed.kinds:
            self._link.estimate(report, now_s)
        if self._recorder is not None:
            self._recorder.step(instance, estimate, remaining, now_s)

    def _facts_of(self, instance: int) -> PackFacts:
        version, facts = self._facts.get(instance, (-1, PackFacts()))
        if version != self._reader.version:
            facts = self._reader.facts(instance)
            self._facts[instance] = (self._reader.version, facts)
        return facts

    def _look_after(self, now_s: float) -> None:
        """Publish, flush, save, and tell the service manager."""
        if now_s - self._start_s > NOTE_S:
            self._note = ""  # how it began is of interest at the beginning
        notes = [self._note, self._state_problem, self._recorder.problem if self._recorder is not None else ""]
        reports, trend = tuple(in_order(self._reports)), self.board.trend
        trend.look(now_s, reports)
        self.board = Board(reports, tuple(n for n in notes if n), dict(self._counts), trend)
        if self._recorder is not None:
            self._recorder.flush(now_s)
        if now_s >= self._state_s:
            self._state_s = now_s + self.config.state.period_s
            self._save(now_s)
        if now_s >= self._watch_s:
            self._watch_s = now_s + 1.0
            notify("WATCHDOG=1")
        if now_s >= self._status_s:
            self._status_s = now_s + STATUS_PERIOD_S
            notify(f"STATUS={self._words(now_s)}")

    def _words(self, now_s: float) -> str:
        """One line for `systemctl status`."""
        if not self._reports:
            return "no battery telemetry yet"
        shown = in_order(self._reports)[0].at(now_s)
        if shown.remaining_s == shown.remaining_s:
            return f"{shown.remaining_s / 60:.1f} min left ({shown.remaining_lo_s / 60:.1f} at worst), {shown.status}"
        return f"{shown.status}: {shown.reason}"

    def _save(self, now_s: float) -> None:
        if not self.config.state.file:
            return
        batteries = {
            str(i): {**saved, "since_row_s": saved["since_row_s"] + self._reports[i].age_s(now_s)}
            for i, tracked in self._tracked.items()
            if (saved := tracked.saved(self._facts_of(i))) is not None
        }
        if not batteries:
            return
        known = {n: v for n, v in self._reader.parameters.items() if n.startswith(("BAT", "FS_BATT"))}
        content: dict[str, Any] = {
            "battery_sha256": self._battery.certificate.content_sha256,
            "parameters": known,
            "batteries": batteries,
        }
        try:
            state.write(Path(self.config.state.file), content, now_s, self._wall_s())
            self._state_problem = ""
        except (OSError, UavbattError) as error:
            self._state_problem = f"state not saved: {error}"

    def _load_state(self) -> tuple[dict[str, Any], str]:
        """The saved state, and a note of what came of it."""
        if not self.config.state.file:
            return {}, ""
        saved, why_not = state.read(
            Path(self.config.state.file),
            self._clock_s(),
            self._wall_s(),
            self.config.state.max_age_s,
            self._battery.certificate.content_sha256,
        )
        if why_not:
            return {}, "" if why_not == "no saved state" else why_not
        if isinstance(saved.get("parameters"), dict):
            self._reader.parameters.update(saved["parameters"])
        return saved, f"resumed from a state {saved['age_s']:.0f} s old"
