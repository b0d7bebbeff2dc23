"""The estimator's side of the proxy: it starts the proxy or finds it running, reads telemetry, and sends the time left.

The rest of the process uses it as its link to the autopilot. The proxy runs in a session of its own: if this process
dies, the proxy goes on passing frames, and the next process connects to it. A proxy that has died is started again.
"""

from __future__ import annotations

import hashlib
import json
import os
import socket
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from uavbatt.errors import UsageError
from uavbatt.live.feeds import proxy, rewriter
from uavbatt.live.log import tell
from uavbatt.live.report import Report
from uavbatt.mavlink.endpoint import Chunk
from uavbatt.mavlink.pipe import Pipe
from uavbatt.records import Status

HELLO_PERIOD_S = 1.0
SHORTEST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 10.0
GENTLE = 5  # niceness of the estimator beside a proxy
STATUS_CODES = {Status.OK: rewriter.OK, Status.CONVERGING: rewriter.CONVERGING}


def control_path(autopilot: str) -> str:
    """Return the path of a proxy's socket: in $RUNTIME_DIRECTORY, else $XDG_RUNTIME_DIR, else a private folder.

    Raises UsageError if the folder cannot be made or belongs to another user.
    """
    named = os.environ.get("RUNTIME_DIRECTORY", "").split(":")[0] or os.environ.get("XDG_RUNTIME_DIR", "")
    folder = Path(named) if named else Path(tempfile.gettempdir()) / f"uavbatt-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        is_ours = bool(named) or folder.stat().st_uid == os.getuid()
    except OSError as error:
        raise UsageError(f"{folder}: expected a folder for the proxy's socket: {error.strerror}") from None
    if not is_ours:
        raise UsageError(f"{folder}: expected a folder of this user")
    return str(folder / f"proxy-{hashlib.sha256(autopilot.encode()).hexdigest()[:12]}.sock")


class ProxyClient:
    """ProxyClient is a `Link` to the autopilot, with a way to the ground stations and to the rewriter."""

    is_stream = True

    def __init__(self, settings: proxy.ProxySettings) -> None:
        self._settings = settings
        self._pipe: Pipe | None = None
        self._messages = proxy.Messages()
        self._child: subprocess.Popen[bytes] | None = None
        self._hello_s = self._next_s = float("-inf")
        self._pause_s = SHORTEST_PAUSE_S
        self._from = ""  # sender of the telemetry that follows
        self.pid = 0
        self.rewritten = 0
        self.problem = ""  # of the proxy's link to the autopilot

    def filenos(self) -> Iterator[int]:
        """Yield the control socket, when connected."""
        if self._pipe is not None:
            yield self._pipe.fd

    def read(self, now_s: float) -> list[Chunk]:
        """Return the bytes that the autopilot sent, and keep the proxy alive."""
        if self._pipe is None:
            self._attach(now_s)
        if self._pipe is None:
            return []
        if now_s >= self._hello_s:
            self._hello_s = now_s + HELLO_PERIOD_S
            self._tell(proxy.HELLO, b"")
        found: list[Chunk] = []
        while self._pipe is not None and (data := self._pipe.read()) != b"":
            if data is None:
                self._close_control(now_s)
                break
            for message in self._messages.feed(data):
                found += self._chunks(message)
        return found

    def _chunks(self, message: tuple[bytes, bytes]) -> list[Chunk]:
        """Return the bytes that a message of the proxy carries, and take in what it says of the proxy."""
        kind, body = message
        if kind == proxy.TELEMETRY:
            return [(body, self._from)]
        if kind == proxy.STATION:
            return [(body, proxy.STATION)]
        if kind == proxy.FROM:
            self._from = body.decode("ascii", "replace")
        elif kind == proxy.STATS:
            self._stats(body)
        return []

    def write(self, data: bytes, now_s: float) -> None:
        """Send a frame to the autopilot; the proxy passes it on only if it was started for that."""
        if self._settings.request or self._settings.request_mission:
            self._tell(proxy.TO_AUTOPILOT, data)

    def to_gcs(self, data: bytes) -> None:
        """Send a frame to the ground stations."""
        self._tell(proxy.TO_GCS, data)

    def estimate(self, report: Report, now_s: float) -> None:
        """Send the time left to the proxy; also a refusal, so that frames pass unchanged from then on."""
        shown = report.at(now_s)
        known = STATUS_CODES.get(shown.status, rewriter.NOTHING)
        body = struct.pack(
            rewriter.ESTIMATE_LAYOUT,
            *(report.system, report.component, report.instance, known),
            *(max(report.remaining.remaining_s - report.late_s, 0.0), shown.soc, report.received_s),
        )
        self._tell(proxy.ESTIMATE, body)

    def close(self) -> None:
        """Close the connection to the proxy, which keeps running."""
        if self._pipe is not None:
            self._pipe.close()
        self._pipe = None

    def stop(self) -> None:
        """End the proxy, as in an orderly stop of the service."""
        self._tell(proxy.QUIT, b"")
        self.close()
        if self._child is not None:
            try:
                self._child.wait(2.0)
            except subprocess.TimeoutExpired:
                self._child.terminate()

    def _tell(self, kind: bytes, body: bytes) -> None:
        if self._pipe is not None and not self._pipe.write(proxy.message(kind, body)):
            self.close()

    def _stats(self, body: bytes) -> None:
        told = json.loads(body)
        self.pid, self.rewritten, self.problem = told["pid"], told["rewritten"], str(told.get("problem", ""))
        if told["settings"] != self._settings._asdict():
            tell("the proxy that runs has other settings: it is replaced")
            self._tell(proxy.QUIT, b"")
            self.close()

    def _attach(self, now_s: float) -> None:
        """Connect to the running proxy, or start one and try again soon."""
        if now_s < self._next_s:
            return
        try:
            line = _connected(self._settings.control)
        except OSError:
            self._start(now_s)
            return
        line.setblocking(False)
        self._pipe, self._messages = Pipe(line.fileno(), line), proxy.Messages()
        self._pause_s, self._hello_s = SHORTEST_PAUSE_S, float("-inf")

    def _start(self, now_s: float) -> None:
        if self._child is not None and self._child.poll() is None:
            self._next_s = now_s + 0.05  # the proxy is starting
            return
        if self._child is not None:
            self._child = None
            self._pause(now_s)
            return
        try:
            self._child = subprocess.Popen(
                [sys.executable, "-m", "uavbatt.live.feeds.proxy", json.dumps(self._settings._asdict())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                start_new_session=True,
            )
        except OSError as error:  # no memory or no descriptor: this may pass
            self.problem = f"the proxy does not start: {error.strerror}"
            self._pause(now_s)
            return
        self._next_s = now_s + 0.05
        os.nice(max(GENTLE - os.nice(0), 0))  # frames have priority over estimates

    def _pause(self, now_s: float) -> None:
        """Try again after a pause, which doubles each time."""
        self._pause_s = min(2.0 * self._pause_s, LONGEST_PAUSE_S)
        self._next_s = now_s + self._pause_s

    def _close_control(self, now_s: float) -> None:
        self.close()
        self._next_s = now_s + 0.05


def _connected(path: str) -> socket.socket:
    """Return a connection to the socket of a running proxy. Raises OSError where there is none."""
    line = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        line.connect(path)
    except OSError:
        line.close()
        raise
    return line
