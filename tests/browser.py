"""One headless Chromium for all pages, spoken to over its debugging pipe: one start, any width, light and dark.

(`--window-size` does not go below 500 px; the protocol does.) No package is needed for it.
"""

from __future__ import annotations

import base64
import fcntl
import json
import os
import select
import shutil
import signal
import time
from pathlib import Path
from typing import Any

ANSWER_S = 90.0
FREE_FROM = 10  # descriptors out of the way of 3 and 4, by which Chromium knows the pipe's ends


def program() -> str | None:
    """Return the path of Chromium; None where there is none."""
    return next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


class Browser:
    """A running Chromium with one tab."""

    def __init__(self, chromium: str, folder: Path) -> None:
        (read, self._out), (self._in, write) = os.pipe(), os.pipe()
        high = [fcntl.fcntl(end, fcntl.F_DUPFD, FREE_FROM) for end in (read, write)]
        command = [chromium, "--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--no-first-run",
                   "--remote-debugging-pipe", f"--user-data-dir={folder}", "about:blank"]  # fmt: skip
        quiet = os.open(os.devnull, os.O_RDWR)
        actions = [(os.POSIX_SPAWN_DUP2, quiet, 1), (os.POSIX_SPAWN_DUP2, quiet, 2),
                   (os.POSIX_SPAWN_DUP2, high[0], 3), (os.POSIX_SPAWN_DUP2, high[1], 4)]  # fmt: skip
        self._pid = os.posix_spawn(chromium, command, os.environ, file_actions=actions, setpgroup=0)
        for end in (read, write, quiet, *high):
            os.close(end)
        self._held, self._count, self._session = b"", 0, ""
        target = self.ask("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        self.ask("Page.enable")

    def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Give a command of the protocol and return its result."""
        self._count += 1
        call = {"id": self._count, "method": method, "params": parameters}
        self._write(call | ({"sessionId": self._session} if self._session else {}))
        while True:
            said = self._next()
            if said.get("id") == self._count:
                assert "error" not in said, f"{method}: {said['error']}"
                return dict(said["result"])

    def open(self, url: str, width: int, scheme: str, height: int = 900) -> None:
        """Show a page at a width in pixels, `light` or `dark`."""
        phone = width < 600
        self.ask("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=phone)
        self.ask("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        self.ask("Page.navigate", url=url)
        end_s = time.monotonic() + ANSWER_S
        while self.evaluate("document.readyState + location.protocol") in ("loading" + "file:", "completeabout:"):
            assert time.monotonic() < end_s, url
        while self.evaluate("document.readyState") != "complete":
            assert time.monotonic() < end_s, url
            time.sleep(0.02)

    def evaluate(self, expression: str) -> Any:
        """Return what a script says on the page that is shown."""
        said = self.ask("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in said, said["exceptionDetails"]
        return said["result"].get("value")

    def picture(self, path: Path, *, is_whole: bool = True) -> None:
        """Write the page as it is seen to a PNG."""
        shot = self.ask("Page.captureScreenshot", captureBeyondViewport=is_whole)
        path.write_bytes(base64.b64decode(shot["data"]))

    def close(self) -> None:
        """End the program."""
        os.killpg(self._pid, signal.SIGTERM)
        os.waitpid(self._pid, 0)
        os.close(self._in)
        os.close(self._out)

    def _write(self, call: dict[str, Any]) -> None:
        left = json.dumps(call).encode() + b"\0"
        while left:
            left = left[os.write(self._out, left) :]

    def _next(self) -> dict[str, Any]:
        end_s = time.monotonic() + ANSWER_S
        while b"\0" not in self._held:
            ready, _, _ = select.select([self._in], [], [], max(end_s - time.monotonic(), 0.0))
            data = os.read(self._in, 1 << 16) if ready else b""
            assert data, "chromium does not answer"
            self._held += data
        message, _, self._held = self._held.partition(b"\0")
        return dict(json.loads(message))
