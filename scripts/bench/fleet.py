"""A fleet to time and to look at: 200 dated flights of five aircraft, one of which ages; on 1 and on 2 workers.

    python scripts/bench/fleet.py make DIR [FLIGHTS]     only write the logs
    python scripts/bench/fleet.py [FLIGHTS [REPEATS]]    time the fleet on 1 and 2 workers, and its memory

Flights are simulated by the model itself: good for time and memory, no evidence of accuracy.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np

os.environ.setdefault("OMP_NUM_THREADS", "1")

AIRCRAFT = ("heron", "kestrel", "merlin", "plover", "swift")
AGEING, GROWTH = "merlin", 0.45  # its resistance at the end of the year, over what it was
FIRST_US, YEAR_US = 1_735_689_600_000_000, 31_536_000_000_000
RATE_HZ = 1.0
FLIGHTS, REPEATS = 200, 3


def make(folder: Path, flights: int = FLIGHTS, shapes: int = 20, seed: int = 11) -> None:
    """Write the logs: `shapes` flights of each kind are flown, a log is one of them with its own noise and date."""
    from uavbatt.battery import battery_file
    from uavbatt.battery.scaling import pack_of
    from uavbatt.simulate.flight import SimulatedFlight, simulate_flight, with_effects
    from uavbatt.simulate.tlog_writer import write_tlog

    random = np.random.default_rng(seed)
    base = pack_of(battery_file.read_battery("lipo-generic"), 4, 5.0, 13.2, 14.0)
    parameters = {"BATT_CAPACITY": 5000.0, "BATT_CRT_VOLT": 13.2, "BATT_LOW_VOLT": 14.0}
    flown: dict[tuple[int, bool], list[Any]] = {}
    for number in range(flights):
        aircraft = AIRCRAFT[number % len(AIRCRAFT)]
        share = number / max(flights - 1, 1)
        shape = int(share * shapes)
        if (key := (min(shape, shapes - 1), aircraft == AGEING)) not in flown:
            pack = with_effects(base, {"resistance_growth": GROWTH * share if aircraft == AGEING else 0.0})
            power_W, ambient_C = float(random.uniform(260.0, 420.0)), float(random.uniform(5.0, 30.0))
            flown[key] = simulate_flight(
                pack, SimulatedFlight(power_W, ambient_C, rate_Hz=RATE_HZ, seed=int(random.integers(1 << 30)))
            )
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


RUN = """
import resource, sys, time
begin = time.perf_counter()
from pathlib import Path
from uavbatt.battery import battery_file
from uavbatt.fleet import run
from uavbatt.fleet.fly import Job
from uavbatt.fleet.logs import find_logs
from uavbatt.battery.sizing.pack_size import PackOptions
if __name__ == "__main__":
    logs, output, workers = sys.argv[1:]
    found, rows = find_logs([logs]), []
    job = Job(battery_file.read_battery("lipo-generic"), PackOptions())
    for finished in run.run_fleet(run.connected(int(workers)), found, job, Path(output)):
        rows += [time.perf_counter()] if finished.row is not None else []
    peak_MB = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    workers_MB = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    skipped = len(rows) // 10
    per_s = (len(rows) - 1 - skipped) / (rows[-1] - rows[skipped])
    print(time.perf_counter() - begin, per_s, peak_MB, workers_MB)
"""


class Measured(NamedTuple):
    """Measured holds the time of a whole run [s], flights a second, memory at its most, and what else ran.

    Flights a second count once the workers are warm; memory is that of the main process and of a worker; `others` is
    how many cores other work on the machine kept busy meanwhile, without which the times mean little.
    """

    whole_s: float
    per_s: float
    main_MB: float
    worker_MB: float
    others: float


def measured(logs: Path, workers: int) -> Measured:
    """Return how one fleet does in processes of its own, from nothing to its tables."""
    with tempfile.TemporaryDirectory() as output:
        script = Path(output) / "fleet_run.py"
        script.write_text(RUN, encoding="utf-8")
        command = [sys.executable, str(script), str(logs), f"{output}/out", str(workers)]
        begin, before_s = time.perf_counter(), _others_s()
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        others = (_others_s() - before_s) / (time.perf_counter() - begin)
    return Measured(*[*map(float, done.stdout.split()), others])


def _others_s() -> float:
    """Return the processor time [s] of all cores without this process and its children; NaN without /proc."""
    if not Path("/proc/stat").exists():
        return float("nan")
    ticks = [int(n) for n in Path("/proc/stat").read_text().split("\n")[0].split()[1:]]
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    idle = ticks[3] + ticks[4]
    return (sum(ticks) - idle) / os.sysconf("SC_CLK_TCK") - used.ru_utime - used.ru_stime


def lines(flights: int = FLIGHTS, repeats: int = REPEATS) -> Iterator[str]:
    """Yield the fleet on 1 and 2 workers, in words, and the memory of a small one beside it. The runs take turns."""
    with tempfile.TemporaryDirectory() as folder:
        few, many = Path(folder) / "few", Path(folder) / "many"
        fewer = max(flights // 4, 4)
        make(few, fewer)
        make(many, flights)
        small = measured(few, 2)  # also fills the cache of compiled code, where numba is installed
        turns = [(measured(many, 1), measured(many, 2)) for _ in range(repeats)]
        one, two = (Measured(*map(median, zip(*runs, strict=True))) for runs in zip(*turns, strict=True))
        ratios = ", ".join(
            f"{a.whole_s:.0f}/{b.whole_s:.0f} s beside {a.others:.2f}/{b.others:.2f} busy cores" for a, b in turns
        )
        yield (
            f"fleet of {flights} flights, whole: 1 worker {one.whole_s:.1f} s, 2 workers {two.whole_s:.1f} s, "
            f"ratio {one.whole_s / two.whole_s:.2f} (turn by turn: {ratios})"
        )
        yield (
            f"fleet of {flights} flights, after the start: {one.per_s:.1f} and {two.per_s:.1f} flights/s, "
            f"ratio {two.per_s / one.per_s:.2f}"
        )
        yield (
            f"memory at most: {fewer} flights {small.main_MB:.0f} MB main, {small.worker_MB:.0f} MB a worker; "
            f"{flights} flights {two.main_MB:.0f} MB main, {two.worker_MB:.0f} MB a worker"
        )


if __name__ == "__main__":
    if sys.argv[1:2] == ["make"]:
        make(Path(sys.argv[2]), *map(int, sys.argv[3:4]))
    else:
        for line in lines(*map(int, sys.argv[1:3])):
            print(line, flush=True)
