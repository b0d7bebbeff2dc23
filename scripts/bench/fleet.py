"""A fleet to time and to look at: 200 dated flights of five aircraft, one of which ages; on 1 and on 2 workers.

    python scripts/bench/fleet.py make DIR [FLIGHTS]     only write the logs
    python scripts/bench/fleet.py [FLIGHTS]              time the fleet on 1 and 2 workers, and its memory

Flights are simulated by the model itself: good for time and memory, no evidence of accuracy.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

os.environ.setdefault("OMP_NUM_THREADS", "1")

AIRCRAFT = ("heron", "kestrel", "merlin", "plover", "swift")
AGEING, GROWTH = "merlin", 0.45  # its resistance at the end of the year, over what it was
FIRST_US, YEAR_US = 1_735_689_600_000_000, 31_536_000_000_000
RATE_HZ = 1.0
FLIGHTS = 200


def make(folder: Path, flights: int = FLIGHTS, shapes: int = 20, seed: int = 11) -> None:
    """Write the logs: `shapes` flights of each kind are flown, a log is one of them with its own noise and date."""
    from uavbatt.battery import file
    from uavbatt.battery.build import pack_of
    from uavbatt.mavlink.tlog_writer import write_tlog
    from uavbatt.simulate import Mission, fly, with_effects

    random = np.random.default_rng(seed)
    base = pack_of(file.read("lipo-generic"), 4, 5.0, 13.2, 14.0)
    parameters = {"BATT_CAPACITY": 5000.0, "BATT_CRT_VOLT": 13.2, "BATT_LOW_VOLT": 14.0}
    flown: dict[tuple[int, bool], list[Any]] = {}
    for number in range(flights):
        aircraft = AIRCRAFT[number % len(AIRCRAFT)]
        share = number / max(flights - 1, 1)
        shape = int(share * shapes)
        if (key := (min(shape, shapes - 1), aircraft == AGEING)) not in flown:
            pack = with_effects(base, {"resistance_growth": GROWTH * share if aircraft == AGEING else 0.0})
            power_W, ambient_C = float(random.uniform(260.0, 420.0)), float(random.uniform(5.0, 30.0))
            flown[key] = fly(pack, Mission(power_W, ambient_C, rate_Hz=RATE_HZ, seed=int(random.integers(1 << 30))))
        # most land with a rest: only every sixth log shows the end of its flight
        whole = flown[key]
        samples = whole if number % 6 == 0 else whole[: int(len(whole) * random.uniform(0.6, 0.9))]
        noise = random.normal(0.0, (0.003, 0.1), (len(samples), 2)).tolist()
        noisy = [
            replace(s, voltage_V=s.voltage_V + v, current_A=max(s.current_A + a, 0.0))
            for s, (v, a) in zip(samples, noise, strict=True)
        ]
        target = folder / aircraft / f"flight_{number:04d}.tlog"
        target.parent.mkdir(parents=True, exist_ok=True)
        write_tlog(target, noisy, parameters, epoch_us=FIRST_US + int(share * YEAR_US))


def seconds(logs: Path, workers: int) -> tuple[float, float]:
    """Wall time [s] of one whole `uavbatt fleet`, and the most memory [MB] that its main process held."""
    with tempfile.TemporaryDirectory() as output:
        command = [sys.executable, "-m", "uavbatt.cli", "fleet", str(logs), "-o", output, "--workers", str(workers)]
        code = "import resource,sys;from uavbatt.cli import main;sys.argv=sys.argv[1:]\ntry: main()\nfinally: "
        code += "print('peak', resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)"
        begin = time.perf_counter()
        done = subprocess.run([sys.executable, "-c", code, *command[2:]], capture_output=True, text=True, check=True)
        took_s = time.perf_counter() - begin
    found = re.search(r"^peak ([\d.]+)$", done.stdout, re.MULTILINE)
    return took_s, float(found[1]) if found else float("nan")


def lines(flights: int = FLIGHTS) -> Iterator[str]:
    """The fleet on 1 and 2 workers, in words."""
    with tempfile.TemporaryDirectory() as folder:
        logs = Path(folder)
        make(logs, flights)
        rows = flights
        one_s, one_MB = seconds(logs, 1)
        two_s, two_MB = seconds(logs, 2)
        yield f"fleet of {rows} flights: 1 worker {one_s:.1f} s, 2 workers {two_s:.1f} s, ratio {one_s / two_s:.2f}"
        yield f"main process: at most {one_MB:.0f} MB with 1 worker, {two_MB:.0f} MB with 2"


if __name__ == "__main__":
    if sys.argv[1:2] == ["make"]:
        make(Path(sys.argv[2]), *map(int, sys.argv[3:4]))
    else:
        for line in lines(*map(int, sys.argv[1:2])):
            print(line, flush=True)
