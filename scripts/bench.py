"""Speed side by side with the peers, in one run: medians and ratios as a table.

    python scripts/bench.py [--markdown FILE] [--only engine,cli,daemon,season,reading,fleet] [--flights 200]
        [--repeats 5]

Peers come with `pip install --group bench` (filterpy, progpy, pymavlink, pyulog); one that is not installed is named
and left out. ProgPy may live in another interpreter: --progpy-python PATH. Our own twins need the extra `fast`.
Read the ratios: the seconds are this machine's, and what else it does shows in them.
"""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from statistics import median

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent))

from bench import engine, fleet, missions, readers, season  # found by the line above

from uavbatt.simulate.flight import SimulatedFlight, simulate_flight, with_effects, write_log

PARTS = ("engine", "cli", "daemon", "season", "reading", "fleet")
DAEMON = """
import time
begin = time.perf_counter()
import uavbatt.cli.live_process, uavbatt.live.daemon, filterpy.kalman
from uavbatt.battery import battery_file
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.estimator import Estimator
from uavbatt.records import Sample
estimator = Estimator(battery_file.read_battery("lipo-generic"), PackOptions(cells=4, capacity_Ah=5.0))
estimator.step(Sample(0.0, 16.4, 20.0, 25.0))
ready_s = time.perf_counter() - begin
for k in range(200):
    estimator.step(Sample(1.0 + k, 16.3 - 0.002 * k, 20.0, 25.0))
peak_kB = open('/proc/self/status').read().split('VmHWM:')[1].split()[0]
print(ready_s, float(peak_kB) / 1024)
"""


def engine_rows(python: str) -> Iterator[engine.Row]:
    """Yield the rows of filter, forecast, accuracy, replay and growth."""
    took_s, words = engine.progpy_s(python)
    if took_s != took_s:
        print(f"ProgPy left out: {words}; pip install progpy, or --progpy-python", file=sys.stderr)
    yield from engine.filter_rows()
    yield from engine.forecast_rows(took_s)
    yield from engine.accuracy_rows(words)
    yield from engine.replay_rows()
    yield from engine.growth_rows()


def cli_rows(repeats: int) -> Iterator[engine.Row]:
    """Yield the rows of whole commands in new processes: replay of a 20-minute flight and of a short one, diagnosis."""
    with tempfile.TemporaryDirectory() as folder:
        logs = {name: Path(folder) / f"{name}.csv" for name in ("20 min at 10 Hz", "8 min at 1 Hz")}
        write_log(logs["20 min at 10 Hz"], engine.flight(20.0), engine.pack())
        write_log(logs["8 min at 1 Hz"], engine.flight(8.0, 1.0), engine.pack())
        for name, log in logs.items():
            arguments = ["replay", str(log), "--cells", "4", "--capacity-ah", "5", "--cutoff-voltage", "13.2"]
            yield from _with_and_without(f"uavbatt replay, {name}", arguments, repeats)
        flights = [Path(folder) / f"worn_{n}.csv" for n in range(3)]
        worn = with_effects(engine.pack(), {"capacity_fade": 0.15})
        for n, log in enumerate(flights):
            write_log(
                log, simulate_flight(worn, SimulatedFlight(250.0 + 60.0 * n, 10.0 + 8.0 * n, rate_Hz=2.0, seed=n)), worn
            )
        pack = ["--battery", "lipo-generic", "--cells", "4", "--capacity-ah", "5", "--cutoff-voltage", "13.2"]
        yield from _with_and_without("uavbatt diagnose, 3 flights", ["diagnose", *map(str, flights), *pack], 1)
    yield plan_row(repeats)


def plan_row(repeats: int) -> engine.Row:
    """Return the row of a plan of a mission of many items in a new process; the budget is 2 s."""
    with tempfile.TemporaryDirectory() as folder:
        survey, quad = Path(folder) / "survey.waypoints", Path(folder) / "quad.vehicle.toml"
        missions.write_survey(survey)
        missions.write_quad(quad)
        arguments = ["plan", "--mission", str(survey), "--vehicle", str(quad), "--cells", "4", "--capacity-ah", "16"]
        took_s = median(engine.run_cli(arguments, plain=True) for _ in range(repeats))
    return f"uavbatt plan --mission, {missions.ITEMS} items", f"{took_s:.2f} s", "", ""


def _with_and_without(name: str, arguments: list[str], repeats: int) -> Iterator[engine.Row]:
    """Yield the times of a command without numba and with it (its code compiled before)."""
    plain = median(engine.run_cli(arguments, plain=True) for _ in range(repeats))
    if not engine.HAS_TWIN:
        yield name, f"{plain:.2f} s", "", ""
        return
    engine.run_cli(arguments, plain=False)
    quick = median(engine.run_cli(arguments, plain=False) for _ in range(repeats))
    yield f"{name}, numpy | numba", f"{plain:.2f} | {quick:.2f} s", "", f"{plain / quick:.2f}"


def daemon_rows(repeats: int) -> Iterator[engine.Row]:
    """Yield the rows of a live process: the time until it can estimate, and its memory after 200 rows."""
    runs = [
        subprocess.run([sys.executable, "-c", DAEMON], capture_output=True, text=True, check=True).stdout.split()
        for _ in range(repeats)
    ]
    ready_s, peak_MB = (median(float(run[k]) for run in runs) for k in (0, 1))
    yield "daemon: imports to the first estimate", f"{ready_s:.2f} s", "", ""
    yield "daemon: memory at its most", f"{peak_MB:.0f} MB", "", ""


def main() -> None:
    """Print the table; with --markdown also write it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--markdown", type=Path)
    parser.add_argument("--only", default=",".join(PARTS))
    parser.add_argument("--flights", type=int, default=fleet.FLIGHTS)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--progpy-python", default=sys.executable)
    given = parser.parse_args()
    parts = set(given.only.split(","))
    if not parts <= set(PARTS):
        parser.error(f"--only: expected some of {', '.join(PARTS)}")
    made = {
        "engine": lambda: engine_rows(given.progpy_python),
        "cli": lambda: cli_rows(given.repeats),
        "daemon": lambda: daemon_rows(given.repeats),
        "season": season.rows,
    }
    lines = [f"{platform.machine()}, Python {platform.python_version()}, load {os.getloadavg()[0]:.1f}", ""]
    lines += ["| what | ours | beside | ratio |", "|---|---|---|---|"]
    for line in lines:
        print(line, flush=True)
    for part in PARTS:
        if part not in parts:
            continue
        if part in made:
            told = (f"| {' | '.join(cell.replace('|', '/') for cell in row)} |" for row in made[part]())
        else:
            told = (
                f"| {text} | | | |" for text in (readers.lines() if part == "reading" else fleet.lines(given.flights))
            )
        for line in told:
            print(line, flush=True)
            lines.append(line)
    if given.markdown is not None:
        given.markdown.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
