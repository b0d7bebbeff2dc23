"""The recording: raw frames as `NAME.tlog`, the estimates of each battery as `NAME.batteryN.jsonl` beside it.

tlog: `time (u64, big endian, microseconds since 1970) | frame`. A recording begins with the vehicle's battery
parameters and heartbeat, as far as they are known, so that it can be replayed on its own. Times in the JSON lines count
from its first frame. A new recording begins when the file has reached its size limit and, with `while-armed`, at each
arming; if the vehicle is armed again within RESUMED_WITHIN_S, the last recording goes on. If there are more than
`max_files`, the oldest are deleted, but recordings shorter than SHORT_S first: so a flapping armed bit or a process
that restarts again and again deletes no flights. A full disk stops the recording, never the process; it tries again.
"""

from __future__ import annotations

import os
import struct
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO, TextIO

from uavbatt.live.config import RecordSection
from uavbatt.live.log import tell
from uavbatt.output import JsonLinesSink, line
from uavbatt.records import Estimate, Remaining

RETRY_S = 30.0
LOOK_S = 5.0
FLUSH_S = 1.0
RESUMED_WITHIN_S = 120.0
SHORT_S = 60.0
MB = 1_000_000


class Recorder:
    """Recorder writes the recording; `problem` says why it does not write."""

    def __init__(self, settings: RecordSection) -> None:
        self._settings = settings
        self._folder = Path(settings.folder)
        self._raw: BinaryIO | None = None
        self._lines: dict[int, TextIO] = {}
        self._name, self._start_s = "", 0.0
        self._paused_s: float | None = None  # disarmed since
        self._prelude: dict[bytes, bytes] = {}
        self.words: Mapping[bytes, bytes] = {}  # the vehicle's own frames that a recording begins with
        self._next_s = self._look_s = self._flush_s = float("-inf")
        self.problem = ""
        self._is_stop_told = False

    def remember(self, key: bytes, frame: bytes) -> None:
        """Keep a frame of ours with which every new recording begins; a newer one of the same key replaces it."""
        self._prelude[key] = frame

    def remembers(self, key: bytes) -> bool:
        """Return True if a frame of this key is kept."""
        return key in self._prelude

    def begin_anew(self, words: Mapping[bytes, bytes]) -> None:
        """Begin a new recording for another vehicle; `words` are the vehicle's frames at its beginning, by key."""
        self.close()
        self._prelude, self.words = {}, words

    def tell_again(self, stamp_us: int, now_s: float) -> None:
        """Record the vehicle's own frames once more: an earlier process has heard frames of it before this one."""
        if self._raw is None or self._paused_s is not None:
            return
        try:
            self._write_words(stamp_us)
        except OSError as error:
            self._note_failure(error.strerror or str(error), now_s)

    def frame(self, frame: bytes, stamp_us: int, time_s: float, now_s: float, armed: bool | None) -> None:
        """Record one frame: stamp_us since 1970 [µs], time_s on the reader's clock, now_s monotonic [s]."""
        if self._paused_s is not None and now_s - self._paused_s > RESUMED_WITHIN_S:
            self.close()
        if self._settings.when == "while-armed" and not armed:
            if self._raw is not None and self._paused_s is None:
                self._paused_s = now_s
            return
        self._paused_s = None
        try:
            if self._raw is None and not self._begin_file(stamp_us, time_s, now_s):
                return
            assert self._raw is not None
            self._raw.write(struct.pack(">Q", stamp_us) + frame)
            if now_s >= self._look_s:
                self._look(now_s)
        except OSError as error:
            self._note_failure(error.strerror or str(error), now_s)

    def step(self, instance: int, estimate: Estimate, remaining: Remaining, now_s: float) -> None:
        """Record the estimate and the remaining time of a row."""
        if self._raw is None or self._paused_s is not None:
            return
        try:
            if instance not in self._lines:
                path = self._folder / f"{self._name}.battery{instance}.jsonl"
                self._lines[instance] = path.open("w", encoding="utf-8")
            shifted = replace(estimate, time_s=estimate.time_s - self._start_s)
            JsonLinesSink(self._lines[instance]).write(line(shifted, remaining))
        except OSError as error:
            self._note_failure(error.strerror or str(error), now_s)

    def flush(self, now_s: float) -> None:
        """Flush buffered data to the operating system, once a second."""
        if now_s < self._flush_s:
            return
        self._flush_s = now_s + FLUSH_S
        try:
            for file in self._files():
                file.flush()
        except OSError as error:
            self._note_failure(error.strerror or str(error), now_s)

    def close(self) -> None:
        """End this recording; the next frame begins another."""
        for file in self._files():
            try:
                file.close()
            except OSError as error:
                self.problem = f"recording lost its end: {error.strerror}"
        self._raw, self._lines, self._paused_s = None, {}, None

    def _files(self) -> list[BinaryIO | TextIO]:
        return [*([self._raw] if self._raw is not None else []), *self._lines.values()]

    def _begin_file(self, stamp_us: int, time_s: float, now_s: float) -> bool:
        if now_s < self._next_s:
            return False
        self._folder.mkdir(parents=True, exist_ok=True)
        if self._free_MB() < self._settings.min_free_MB:
            self._note_failure(f"less than {self._settings.min_free_MB:g} MB free", now_s)
            return False
        self._name = self._new_name(stamp_us)
        self._raw = (self._folder / f"{self._name}.tlog").open("wb")
        self._start_s, self.problem = time_s, ""
        self._look_s = now_s + LOOK_S
        self._write_words(stamp_us)
        self._remove_oldest()
        return True

    def _write_words(self, stamp_us: int) -> None:
        """Write the frames with which a recording begins. Raises OSError."""
        assert self._raw is not None
        for kept in (*self._prelude.values(), *self.words.values()):
            self._raw.write(struct.pack(">Q", stamp_us) + kept)

    def _new_name(self, stamp_us: int) -> str:
        base = time.strftime("uavbatt-%Y%m%d-%H%M%S", time.gmtime(stamp_us / 1e6))
        names = [base, *(f"{base}-{n}" for n in range(2, 1000))]
        return next(name for name in names if not (self._folder / f"{name}.tlog").exists())

    def _look(self, now_s: float) -> None:
        """Check the files every LOOK_S: close one that has reached its size limit, stop if the disk is too full."""
        self._look_s = now_s + LOOK_S
        assert self._raw is not None
        if self._raw.tell() > self._settings.max_file_MB * MB:
            self.close()
        elif self._free_MB() < self._settings.min_free_MB:
            self._note_failure(f"less than {self._settings.min_free_MB:g} MB free", now_s)
        else:
            self._is_stop_told = False  # it records again

    def _free_MB(self) -> float:
        disk = os.statvfs(self._folder)
        return disk.f_bavail * disk.f_frsize / MB

    def _remove_oldest(self) -> None:
        there = sorted(self._folder.glob("uavbatt-*.tlog"), key=lambda p: (p.stat().st_mtime_ns, p.name))
        others = sorted((p for p in there if p.stem != self._name), key=lambda p: not _is_short(p))
        for old in others[: max(len(there) - self._settings.max_files, 0)]:
            for part in [old, *self._folder.glob(f"{old.stem}.battery*.jsonl")]:
                part.unlink(missing_ok=True)

    def _note_failure(self, why: str, now_s: float) -> None:
        self.close()
        if not self._is_stop_told:
            self._is_stop_told = True
            tell(f"recording stopped: {why}; tried again every {RETRY_S:.0f} s")
        self.problem = f"not recording: {why}"
        self._next_s = now_s + RETRY_S


def _is_short(path: Path) -> bool:
    """Return True if a recording spans less than SHORT_S, from its first stamp to its last writing."""
    try:
        with path.open("rb") as file:
            head = file.read(8)
        last_s = path.stat().st_mtime
    except OSError:
        return False
    return len(head) < 8 or abs(last_s - struct.unpack(">Q", head)[0] / 1e6) < SHORT_S
