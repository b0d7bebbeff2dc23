"""Files fitted to the logs of a season: the time and the memory of `uavbatt fit` for few logs and for many.

The logs are flights of packs that differ in age, landed with charge left, by a model that is not ours.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from landed_logs import landed
from scoring.other_pack import CELLS, FULL_AH, LIPO, Pack, Power

from bench import engine
from uavbatt.simulate.flight import write_log

LOGS = (20, 80, 240)  # ascending, because the memory is that of the largest run so far


def rows() -> Iterator[engine.Row]:
    """Yield the time and the memory of fits of a battery file and of a vehicle file."""
    with tempfile.TemporaryDirectory() as folder:
        logs = [_written(Path(folder) / f"flight_{k:03}.csv", k) for k in range(LOGS[-1])]
        battery, vehicle = (str(Path(folder) / f"season.{kind}.toml") for kind in ("battery", "vehicle"))
        for count in LOGS:
            some = [*map(str, logs[:count]), "--cells", str(CELLS), "--capacity-ah", f"{FULL_AH:g}"]
            whole_s, peak_MB = _fitted([*some, "-o", battery])
            yield f"uavbatt fit -o, {count} logs", f"{whole_s:.0f} s", f"{peak_MB:.0f} MB at most", ""
            whole_s, _ = _fitted([*some, "--battery", battery, "--vehicle", vehicle])
            yield f"uavbatt fit --vehicle, {count} logs", f"{whole_s:.0f} s", "", ""


def _written(path: Path, seed: int) -> Path:
    """Write the log of a flight of about ten minutes with a row each second; return its path."""
    dice = np.random.default_rng(seed)
    pack = Pack(
        FULL_AH * dice.uniform(0.8, 1.0),
        1.0,
        FULL_AH,
        dice.uniform(0.9, 1.5),
        LIPO,
        CELLS,
        air_C=dice.uniform(0.0, 32.0),
    )
    log = landed(pack, Power(dice.uniform(200.0, 350.0), climb=0.3), dice.uniform(0.15, 0.5), seed)
    write_log(path, list(log.samples), engine.pack())
    return path


def _fitted(arguments: list[str]) -> tuple[float, float]:
    """Run the command in a process of its own; return its time [s], and the most memory of any child so far [MB]."""
    command = [sys.executable, "-m", "uavbatt", "fit", *arguments]
    begin = time.perf_counter()
    subprocess.run(command, check=True, capture_output=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
    return time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024.0
