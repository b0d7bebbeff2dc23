"""Readers against pymavlink and pyulog, in one run: battery rows of a 60 MB `.BIN`, a 36 MB `.tlog` and a ULog.

    python scripts/bench/readers.py [REPEATS]

Both sides give time, voltage, current, charge and temperature of every battery row, ours as columns and, in brackets,
as the objects that a replay takes; the rows are compared before they
are timed. `warm`: modules loaded, the file in the system's cache. `cold`: a new process with all its imports. Medians
of processor time, which all of them spend in one thread, so that other work on the machine bends them less; read the
ratios, the seconds are this machine's.
"""

from __future__ import annotations

import gc
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from scoring import data

from bench.logs import make_bin, make_tlog  # found by the line above

REPEATS = 5
ULOG = "flights/px4/hexa_6s_33s.ulg"
Rows = list[tuple[float, ...]]
Reader = Callable[[str], Any]


def ours(path: str) -> NDArray[np.float64]:
    """Read battery rows by our readers, as columns."""
    from uavbatt.telemetry.read import read_columns

    rows = read_columns(path)
    return np.column_stack((rows.time_s, rows.voltage_V, rows.current_A, rows.consumed_Ah, rows.temp_C))


def ours_samples(path: str) -> tuple[Any, ...]:
    """Read battery rows by our readers, an object a row, with all else that a replay needs."""
    from uavbatt.telemetry.read import read_log

    return read_log(path).samples


def pymavlink_bin(path: str) -> Rows:
    """Read battery rows of a DataFlash log by pymavlink, its index in C."""
    from pymavlink import DFReader

    log, rows = DFReader.DFReader_binary(path), Rows()
    while (m := log.recv_match(type=["BAT"])) is not None:
        rows.append((m.TimeUS / 1e6, m.Volt, m.Curr, m.CurrTot / 1000, m.Temp))
    return rows


def pymavlink_tlog(path: str) -> Rows:
    """Read battery rows of a telemetry log by pymavlink, its index and a filter by type."""
    from pymavlink import mavutil

    log, rows = mavutil.mavlink_connection(path), Rows()
    while (m := log.recv_match(type=["BATTERY_STATUS"])) is not None:
        rows.append(
            (
                m._timestamp,
                m.voltages[0] / 1000,
                m.current_battery / 100,
                m.current_consumed / 1000,
                m.temperature / 100,
            )
        )
    return rows


def pyulog(path: str) -> Rows:
    """Read battery rows of a ULog by pyulog, only that topic asked for."""
    from pyulog import ULog

    data = ULog(path, ["battery_status"]).data_list[0].data
    names = ("timestamp", "voltage_v", "current_a", "discharged_mah", "temperature")
    return [tuple(row) for row in zip(*(data[name].tolist() for name in names), strict=True)]


PEERS: dict[str, tuple[str, Callable[[str], Rows]]] = {
    ".BIN": ("pymavlink", pymavlink_bin), ".tlog": ("pymavlink", pymavlink_tlog), ".ulg": ("pyulog", pyulog)
}  # fmt: skip


def warm_s(reads: Sequence[Reader], path: str, repeats: int) -> list[float]:
    """Return the median processor time [s] of each reader in this process, in turn, after one that does not count."""
    for read in reads:
        read(path)
    turns = [[_timed(partial(read, path)) for read in reads] for _ in range(repeats)]
    return [median(times) for times in zip(*turns, strict=True)]


def cold_s(names: Sequence[str], path: str, repeats: int) -> list[float]:
    """Return the median processor time [s] of a new process for each function of `names`: its imports, the file."""
    code = "import sys; sys.path.insert(0, {!r})\nfrom bench.readers import {}; {}({!r})"
    here = str(Path(__file__).parents[1])
    return new_processes_s([code.format(here, name, name, path) for name in names], repeats)


def new_processes_s(codes: Sequence[str], repeats: int) -> list[float]:
    """Return the median processor time [s] of a new process for each of `codes`, after one that does not count.

    The codes take turns. All find their bytecode compiled, as installed packages do: ours would be compiled in every
    process of an environment that forbids to write it.
    """
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "", "PYTHONPYCACHEPREFIX": folder}
        runs = [partial(subprocess.run, [sys.executable, "-c", c], check=True, env=environment) for c in codes]
        for run in runs:
            run()
        turns = [[_timed(run) for run in runs] for _ in range(repeats)]
        return [median(times) for times in zip(*turns, strict=True)]


def _timed(work: Callable[[], Any]) -> float:
    """Return the processor time [s] of this process and of its ended children; garbage is collected before."""
    gc.collect()
    before_s = _spent_s()
    work()
    return _spent_s() - before_s


def _spent_s() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def same(a: NDArray[np.float64], other: Rows) -> bool:
    """Return True if the rows are the same: equal values, times by their differences to the first row."""
    if len(a) != len(other):
        return False
    b = np.array(other)
    return bool(np.allclose(a[:, 0] - a[0, 0], b[:, 0] - b[0, 0], atol=2e-6, rtol=0) and np.all(a[:, 1:] == b[:, 1:]))


IMPORTS = (
    ("our .BIN reader", "import uavbatt.telemetry.read, uavbatt.telemetry.formats.dataflash_binary"),
    ("our .tlog reader", "import uavbatt.telemetry.read, uavbatt.telemetry.formats.tlog"),
    ("pymavlink.DFReader", "import pymavlink.DFReader"),
    ("pymavlink.mavutil", "import pymavlink.mavutil"),
    ("pyulog", "import pyulog"),
    ("the command line", "import uavbatt.cli.app"),
)


def import_line(name: str, statement: str, repeats: int) -> str:
    """Return the processor time [ms] of an import in a new process less that of none, and the memory [MB] then held."""
    told = f"{statement}\nprint(int(open('/proc/self/status').read().split('VmHWM:')[1].split()[0]) / 1024)"  # its own
    none_s, all_s = new_processes_s(("", statement), repeats)
    peak = subprocess.run([sys.executable, "-c", told], check=True, capture_output=True, text=True).stdout
    return f"import of {name}: {1000 * (all_s - none_s):.0f} ms, {float(peak):.0f} MB"


def lines(repeats: int = REPEATS) -> Iterator[str]:
    """Yield every reader beside its peer, in words."""
    with tempfile.TemporaryDirectory() as folder:
        made = {".BIN": Path(folder) / "big.BIN", ".tlog": Path(folder) / "big.tlog", ".ulg": data.place() / ULOG}
        messages = {".BIN": make_bin(made[".BIN"]), ".tlog": make_tlog(made[".tlog"])}
        for suffix, path in made.items():
            if not path.is_file():
                yield f"{suffix}: no log of this kind here"
                continue
            peer, read = PEERS[suffix]
            size_MB = path.stat().st_size / 1e6
            told = f"{size_MB:.1f} MB" + (f", {messages[suffix] / 1e6:.2f} M messages" if suffix in messages else "")
            rows = ours(str(path))
            equal = "rows equal" if same(rows, read(str(path))) else "ROWS DIFFER"
            equal = "by pyulog itself, its unknowns made NaN" if suffix == ".ulg" else equal
            warm = warm_s((read, ours, ours_samples), str(path), repeats)
            cold = cold_s((read.__name__, "ours", "ours_samples"), str(path), repeats)
            for what, (theirs_s, ours_s, samples_s) in (("warm", warm), ("cold", cold)):
                yield (
                    f"{suffix:5s} {told}, {len(rows)} battery rows ({equal}), {what}: {peer} {theirs_s:.3f} s, "
                    f"ours {ours_s:.3f} s ({samples_s:.3f}), ratio {theirs_s / ours_s:.1f} ({theirs_s / samples_s:.1f})"
                )
    for name, statement in IMPORTS:
        yield import_line(name, statement, repeats)


if __name__ == "__main__":
    for line in lines(*map(int, sys.argv[1:2])):
        print(line, flush=True)
