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
from pathlib import Path

from bench.memory import resident_MB
from daemon_bench import Bench

from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.live.config import LinkSection, PackSection, RecordSection, StateSection
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.records import Sample
from uavbatt.simulate.tlog_writer import battery_status, heartbeat

FLIGHT_S, GROUND_S = 900.0, 60.0


def used_MB() -> float:
    """Return the resident memory of this process [MB], without what nobody holds any more."""
    gc.collect()
    return resident_MB(os.getpid())


def frames(in_flight_s: float, dice: random.Random, bench: Bench) -> list[bytes]:
    """Return one turn's frames, as a bad radio delivers them."""
    flying = in_flight_s > GROUND_S
    amps = (12.0 if flying else 0.2) * dice.uniform(0.9, 1.1)
    drawn_Ah = max(in_flight_s - GROUND_S, 0.0) * 12.0 / 3600.0
    sample = Sample(0.0, 16.7 - 0.55 * drawn_Ah - 0.03 * amps, amps, 25.0, drawn_Ah, armed=flying)
    made = [bench.framed(message) for message in (heartbeat(flying), battery_status(sample, 0))]
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
    dice = random.Random(1)
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(
            PackOptions(capacity_Ah=5.0, cells=4),
            settings=ForecastSettings(forecast_period_s=PackSection().forecast_period_s),
            link=LinkSection(endpoint="udpin:127.0.0.1:1", gcs=["udpout:127.0.0.1:2"], request=True),
            record=RecordSection(folder=folder, max_file_MB=2.0, max_files=3, min_free_MB=0.0),
            state=StateSection(file=str(Path(folder) / "state.json"), period_s=60.0),
        )
        daemon = bench.daemon
        after_first_MB, hour, in_flight_s = 0.0, 0, 0.0
        steps = int(args.hours * 3600.0 * args.rate)
        for k in range(steps):
            bench.link.incoming = [(data, "fc") for data in frames(in_flight_s, dice, bench)]
            daemon.turn()
            for line in (bench.link, bench.station):
                line.sent.clear()  # what grows shall be the daemon's
            bench.now_s += 1.0 / args.rate
            in_flight_s += 1.0 / args.rate
            if in_flight_s > GROUND_S + FLIGHT_S:
                in_flight_s = 0.0  # another pack
                bench.now_s += dice.choice([2.0, 60.0, 600.0])
            if int((k + 1) / args.rate / 3600.0) > hour or k == steps - 1:
                hour += 1
                now_MB = used_MB()
                after_first_MB = after_first_MB or now_MB
                rows, bad = daemon.board.counts["rows"], daemon.board.counts["bad_checksums"]
                print(f"hour {hour:3}: {now_MB:6.1f} MB, {rows} rows, {bad} bad", flush=True)
        grown_MB = used_MB() - after_first_MB
        recorded_MB = sum(f.stat().st_size for f in Path(folder).iterdir()) / 1e6
        daemon.close()
    print(f"grown by {grown_MB:.1f} MB since the first hour (limit 5); recordings hold {recorded_MB:.1f} MB")
    return 1 if grown_MB > 5.0 else 0


if __name__ == "__main__":
    sys.exit(main())
