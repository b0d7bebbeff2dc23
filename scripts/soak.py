"""Many flight hours in one process with a clock of its own: `soak.py [--hours 24] [--rate 2]`.

The memory may grow by less than 5 MB after the first hour, and nothing may fall over: every hour has gaps, an
autopilot that starts anew, a changed pack, lost, doubled and swapped frames, and a burst of damaged ones. The
recording is on, with its limits.
"""

from __future__ import annotations

import argparse
import gc
import os
import random
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.battery import file
from uavbatt.config import Config, LinkSection, RecordSection, StateSection
from uavbatt.daemon import Daemon
from uavbatt.mavlink.endpoint import Chunk
from uavbatt.mavlink.tlog_writer import battery_status, heartbeat
from uavbatt.pipeline import PackOptions
from uavbatt.records import Sample

FLIGHT_S, GROUND_S = 900.0, 60.0


class Line:
    """A link whose vehicle is this script."""

    is_stream = False

    def __init__(self) -> None:
        self.incoming: list[Chunk] = []
        self.sent = 0

    def filenos(self) -> Iterator[int]:
        return iter(())

    def read(self, now_s: float) -> list[Chunk]:
        taken, self.incoming = self.incoming, []
        return taken

    def write(self, data: bytes, now_s: float) -> None:
        self.sent += len(data)

    def close(self) -> None:
        pass


def rss_MB() -> float:
    """Resident memory of this process [MB]."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def frames(in_flight_s: float, dice: random.Random, link: Any) -> list[bytes]:
    """One turn's frames, as a bad radio delivers them."""
    flying = in_flight_s > GROUND_S
    amps = (12.0 if flying else 0.2) * dice.uniform(0.9, 1.1)
    drawn_Ah = max(in_flight_s - GROUND_S, 0.0) * 12.0 / 3600.0
    sample = Sample(0.0, 16.7 - 0.55 * drawn_Ah - 0.03 * amps, amps, 25.0, drawn_Ah, armed=flying)
    made = []
    for message in (heartbeat(flying), battery_status(sample, 0)):
        made.append(bytes(message.pack(link)))
        link.seq = (link.seq + 1) % 256
    if dice.random() < 0.1:
        made.pop()
    if dice.random() < 0.05:
        made += made
    if dice.random() < 0.05:
        made.reverse()
    if dice.random() < 0.2 and made:
        bad = bytearray(dice.choice(made))
        bad[dice.randrange(len(bad))] ^= 1 << dice.randrange(8)
        made.append(bytes(bad))
        made.append(dice.randbytes(dice.randrange(60)))
    return made


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--rate", type=float, default=2.0)
    args = parser.parse_args()
    now_s, dice, line = 1000.0, random.Random(1), Line()
    packer: Any = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    with tempfile.TemporaryDirectory() as folder:
        config = Config(
            link=LinkSection(endpoint="udpin:127.0.0.1:1", gcs=["udpout:127.0.0.1:2"], request=True),
            record=RecordSection(folder=folder, max_file_MB=2.0, max_files=3, min_free_MB=0.0),
            state=StateSection(file=str(Path(folder) / "state.json"), period_s=60.0),
        )
        options = PackOptions(capacity_Ah=5.0, cells=4, forecast_period_s=config.pack.forecast_period_s)
        clocks: dict[str, Any] = {"clock_s": lambda: now_s, "wall_s": lambda: 1.7e9 + now_s}
        daemon = Daemon(config, file.read("lipo-generic"), options, line, [Line()], **clocks)
        after_first_MB, hour, in_flight_s = 0.0, 0, 0.0
        steps = int(args.hours * 3600.0 * args.rate)
        for k in range(steps):
            line.incoming = [(data, "fc") for data in frames(in_flight_s, dice, packer)]
            daemon.turn()
            now_s += 1.0 / args.rate
            in_flight_s += 1.0 / args.rate
            if in_flight_s > GROUND_S + FLIGHT_S:
                in_flight_s, now_s = 0.0, now_s + dice.choice([2.0, 60.0, 600.0])  # another pack
            if int((k + 1) / args.rate / 3600.0) > hour or k == steps - 1:
                hour += 1
                used_MB = rss_MB()
                after_first_MB = after_first_MB or used_MB
                rows, bad = daemon.board.counts["rows"], daemon.board.counts["bad_checksums"]
                print(f"hour {hour:3}: {used_MB:6.1f} MB, {rows} rows, {bad} bad", flush=True)
        grown_MB = rss_MB() - after_first_MB
        recorded_MB = sum(f.stat().st_size for f in Path(folder).iterdir()) / 1e6
        daemon.close()
    print(f"grown by {grown_MB:.1f} MB since the first hour (limit 5); recordings hold {recorded_MB:.1f} MB")
    return 1 if grown_MB > 5.0 else 0


if __name__ == "__main__":
    sys.exit(main())
