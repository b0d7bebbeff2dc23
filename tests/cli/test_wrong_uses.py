"""The wrong uses that people tried: exit code, the words that must be there, one line, and nothing written.

From the reports of five kinds of users. Where a slip can be put right or borne, the replay goes on and says so.
"""

from __future__ import annotations

import gzip
import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest
from command import Done, called, refused_live
from frames import hover, write_log

from uavbatt import Estimator
from uavbatt.battery import battery_file
from uavbatt.errors import UsageError

ROOT = Path(__file__).parents[2]
HEAD = "time_s,voltage_V,current_A\n"
DATASET = "sample,run,ambient_c,time_s,voltage_v,current_a,surface_c\n"
BATTERY = """name = "a"\nchemistry = "LiPo"\ncells_series = 4\ncapacity_Ah = 5.0\ncutoff_V = 13.2
load = "x"\nsource = "y"\n"""
TAKE_OFF_S, ROWS = 5, 90
STATED = ("--capacity-ah", "5")
FIVE_CELLS = ("--cells", "5", "--capacity-ah", "1.3")


def rows(
    volts: Callable[[int], float] = lambda k: 16.2 - 0.002 * k,
    amps: Callable[[int], float] = lambda k: 0.1 if k < TAKE_OFF_S else 18.0,
    seconds: Callable[[int], float] = float,
) -> str:
    """Ninety rows of a 4S pack, one a second: five at rest, then a hover at 18 A."""
    return "".join(f"{seconds(k)},{volts(k):.3f},{amps(k)}\n" for k in range(ROWS))


def with_column(name: str, value: str) -> str:
    return f"{HEAD.strip()},{name}\n" + "".join(f"{row},{value}\n" for row in rows().splitlines())


def runs(voltages: Callable[[int], float], count: int) -> str:
    return DATASET + "".join(f"A,{r + 1},25,{t},{voltages(t)},40,\n" for r in range(count) for t in range(0, 420, 60))


FILES: dict[str, str | bytes] = {
    "f.csv": HEAD + rows(),
    "notes.txt": "Dear diary,\nwe flew.\n",
    "empty.BIN": "",
    "millivolts.csv": HEAD + rows(volts=lambda k: 16200.0 - 2.0 * k),
    "percent.csv": with_column("reported_soc", "95"),
    "iso.csv": HEAD + "".join(f"2026-05-01T10:0{k // 60}:{k % 60:02d}Z,16.2,18\n" for k in range(ROWS)),
    "comma.csv": "time_s;voltage_V;current_A\n0;16,2;10\n1;16,1;10\n",
    "tabs.csv": (HEAD + rows()).replace(",", "\t"),
    "backward.csv": HEAD + rows() + "7,16.0,18\n",
    "bom.csv": b"\xef\xbb\xbf" + (HEAD + rows()).encode(),
    "epoch.csv": HEAD + rows(seconds=lambda k: 1.7e9 + k),
    "negative.csv": HEAD + rows(amps=lambda k: -0.1 if k < TAKE_OFF_S else -18.0),
    "ms.csv": HEAD + rows(seconds=lambda k: 1000.0 * k),
    "kelvin.csv": with_column("temp_C", "298.15"),
    "packed.csv.gz": gzip.compress((HEAD + rows()).encode()),
    "px4.csv": "timestamp,voltage_v,current_a\n" + rows(seconds=lambda k: 1e6 * k),
    "Flüge/✈.csv": HEAD + rows(),
    "leer/liesmich.txt": "no log",
    "edited.battery.toml": battery_file._text("lpab-3s")[0].replace(b"cells_series = 3", b"cells_series = 4"),
    "mv/battery.toml": BATTERY,
    "mv/discharge.csv": runs(lambda t: 16600.0 - 8.0 * t, 3),
    "semicolons/battery.toml": BATTERY,
    "semicolons/discharge.csv": runs(lambda t: 16.6 - 0.008 * t, 3).replace(",", ";"),
    "cell/battery.toml": BATTERY,
    "cell/discharge.csv": runs(lambda t: 4.15 - 0.002 * t, 3),
    "away/battery.toml": BATTERY.replace('"a"', '"../../away"'),
    "away/discharge.csv": runs(lambda t: 16.6 - 0.008 * t, 3),
    "end/battery.toml": BATTERY.replace("13.2", "16.7"),
    "end/discharge.csv": runs(lambda t: 16.6 - 0.008 * t, 3),
    "two/battery.toml": BATTERY,
    "two/discharge.csv": runs(lambda t: round(16.6 - 0.004 * t, 3), 2),
    "m100.vehicle.toml": """name = "m100"\nbattery = "lipo-generic"\nsource = "x"
[phases]\ntake_off_W = 1366.0\nflight_W = 1366.0\nlast_minute_W = 1366.0
[[traces]]\ntime_s = [0.0, 300.0]\npower_W = [1366.0, 1366.0]\nsoc = [1.0, 0.3]\n""",
}


class Use(NamedTuple):
    """A call, its exit code, and words of what it says; `note` is what goes on with a word of warning."""

    call: tuple[str, ...]
    code: int
    words: tuple[str, ...]


def replayed(name: str, *more: str) -> tuple[str, ...]:
    return ("replay", name, *STATED, *more)


REFUSED: dict[str, Use] = {
    "a text file": Use(replayed("notes.txt"), 1, ("notes.txt", "expected a flight log", "text of another kind")),
    "a missing file": Use(replayed("gone.BIN"), 1, ("gone.BIN", "no such file")),
    "an empty folder": Use(replayed("leer"), 2, ("leer: expected a folder with flight logs", "found none")),
    "an empty file": Use(replayed("empty.BIN"), 1, ("empty.BIN", "an empty file")),
    "millivolts": Use(replayed("millivolts.csv"), 1, ("row 1 (line 2)", "voltage_V", "16200 (millivolts?)")),
    "percent": Use(replayed("percent.csv"), 1, ("reported_soc", "expected 0..1", "(percent?)")),
    "decimal commas": Use(replayed("comma.csv"), 1, ("header", "commas", "found semicolons")),
    "tabs": Use(replayed("tabs.csv"), 1, ("header", "commas", "found tabs")),
    "time backwards": Use(replayed("backward.csv"), 1, ("row 91 (line 92)", "time_s", "found 7")),
    "time in milliseconds": Use(replayed("ms.csv"), 1, ("time_s", "seconds", "(milliseconds?)")),
    "another instance": Use(replayed("f.csv", "--instance", "3"), 2, ("no battery instance 3", "the log has: 0")),
    "a wiring that is none": Use(replayed("f.csv", "--join", "delta"), 2, ("--join delta", "parallel or series")),
    "one battery joined": Use(replayed("f.csv", "--join", "series"), 2, ("one battery", "nothing to join")),
    "two voltages in parallel": Use(replayed("apart.tlog", "--join", "parallel"), 2, ("23.", "49.", "not in parallel")),
    "another vehicle": Use(
        replayed("vehicles.tlog", "--system", "9"), 2, ("system 9", "systems that have some: 1, 42")
    ),
    "a vehicle in a table": Use(replayed("f.csv", "--system", "1"), 2, ("system 1", "only a .tlog")),
    "no capacity": Use(("replay", "f.csv"), 2, ("f.csv", "capacity", "--capacity-ah")),
    "negative capacity": Use(("replay", "f.csv", "--capacity-ah", "-5"), 2, ("--capacity-ah", "positive")),
    "mAh": Use(("replay", "f.csv", "--capacity-ah", "5000"), 2, ("5000 Ah", "0.05 to 500 Ah", "(mAh?)")),
    "99 cells": Use(replayed("f.csv", "--cells", "99"), 2, ("99 cells", "0.164 V a cell", "2.5 to 4.45 V")),
    "half the cells": Use(replayed("f.csv", "--cells", "2"), 2, ("2 cells", "8.1 V a cell", "2.5 to 4.45 V")),
    "a cut-off of 100 V": Use(replayed("f.csv", "--cutoff-voltage", "100"), 2, ("25 V a cell", "2 to 4.2 V")),
    "a cut-off of a cell": Use(replayed("f.csv", "--cutoff-voltage", "3.3"), 2, ("one cell's value?", "13.2 V")),
    "no such folder": Use(replayed("f.csv", "--jsonl", "no/a.jsonl"), 2, ("no/a.jsonl", "an existing folder")),
    "a folder as a file": Use(replayed("f.csv", "--csv", "mv"), 2, ("mv", "a file name to write")),
    "a page that is no page": Use(replayed("f.csv", "--report", "x.pdf"), 2, ("--report x.pdf", "ends in .html")),
    "a picture that is none": Use(replayed("f.csv", "--png", "x.jpg"), 2, ("--png x.jpg", "ends in .png")),
    "a load that is none": Use(
        replayed("f.csv", "--load", "fast"), 2, ("--load fast", "learned, recent, log", "watts")
    ),
    "an address": Use(replayed("https://logs.px4.io/1.ulg"), 1, ("an address", "download the log first")),
    "an edited battery file": Use(
        replayed("f.csv", "--battery", "edited.battery.toml"), 1, ("was edited", "--allow-uncertified")
    ),
    "an unknown effect": Use(
        ("simulate", "-o", "a.csv", "--effect", "gremlin=1"), 2, ("--effect gremlin", "expected one of", "weak_cell")
    ),
    "99 999 W": Use(
        ("plan", "--cells", "4", *STATED, "--power-w", "99999"), 2, ("99999 W on 4S 5 Ah", "1351 C", "60 C")
    ),
    "1e308 W": Use(("plan", "--cells", "4", *STATED, "--power-w", "1e308"), 2, ("1e+308 W on 4S 5 Ah", "60 C")),
    "cells of a vehicle that its log contradicts": Use(
        ("fit", "f.csv", "--battery", "lipo-generic", "--vehicle", "x.vehicle.toml", *FIVE_CELLS),
        2,
        ("f.csv: 5 cells in series at 3.2 V a cell at rest", "another count"),
    ),
    "a battery file with the name of a vehicle file": Use(
        ("fit", "two", "-o", "x.vehicle.toml"), 2, ("-o x.vehicle.toml", "expected NAME.battery.toml")
    ),
    "other cells than the data set's": Use(
        ("fit", "two", "-o", "x.battery.toml", "--cells", "6"), 2, ("--cells 6", "expected 4, as two/battery.toml")
    ),
    "a folder without logs": Use(("fit", "leer", "-o", "x.battery.toml"), 2, ("leer: expected a data set", "or logs")),
    "a data set in mV": Use(("validate", "mv"), 1, ("discharge.csv", "line 2", "voltage_v", "(millivolts?)")),
    "a data set of one cell": Use(("validate", "cell"), 1, ("discharge.csv", "4.15 V at most for 4", "per cell?")),
    "a data set that leads away": Use(
        ("validate", "away", "--ship", "ship"), 1, ("away/battery.toml: key name", "found '../../away'")
    ),
    "a data set in semicolons": Use(("validate", "semicolons"), 1, ("discharge.csv", "commas", "semicolons")),
}
NOTED: dict[str, Use] = {
    "ISO 8601": Use(replayed("iso.csv"), 0, ("90 rows, 89 s",)),
    "a mark of byte order": Use(replayed("bom.csv"), 0, ("90 rows, 89 s",)),
    "seconds since 1970": Use(replayed("epoch.csv"), 0, ("90 rows, 89 s",)),
    "gzip": Use(replayed("packed.csv.gz"), 0, ("90 rows, 89 s",)),
    "a table of ulog2csv": Use(replayed("px4.csv"), 0, ("90 rows, 89 s",)),
    "a name in Unicode": Use(replayed("Flüge/✈.csv"), 0, ("Flüge/✈.csv", "90 rows")),
    "kelvin": Use(replayed("kelvin.csv"), 0, ("as if it were in kelvin: not used",)),
    "one cell too many": Use(replayed("f.csv", "--cells", "5"), 0, ("3.2 V a cell", "nearly empty, or another count")),
    "negative current": Use(replayed("negative.csv"), 0, ("the sensor's sign is reversed", "not known")),
    "another battery file": Use(
        replayed("f.csv", "--battery", "lpab-3s"),
        0,
        ("3S pack of a capacity that its tests do not tell; this one is scaled", "far off what this battery file"),
    ),
    "another vehicle file": Use(replayed("f.csv", "--vehicle", "m100.vehicle.toml"), 0, ("this aircraft draws", "W")),
    "two vehicles": Use(replayed("vehicles.tlog"), 0, ("battery messages of system 42", "ignored", "system 1")),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("wrong")
    for name, content in FILES.items():
        path = made / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    write_log(made / "apart.tlog", [*hover(30, 23.9, 10.0, 0), *hover(30, 50.2, 10.0, 1)])
    write_log(made / "vehicles.tlog", [*hover(70, 16.7, 12.0, system=1), *hover(70, 25.1, 20.0, system=42)])
    return made


def files(folder: Path) -> set[Path]:
    return set(folder.rglob("*"))


def assert_refused(done: Done, use: Use) -> None:
    said = done.stderr.strip()
    assert done.returncode == use.code, (done.returncode, said)
    assert said.startswith("uavbatt: ") and "\n" not in said and "Traceback" not in said
    assert all(word in said for word in use.words), said


@pytest.mark.parametrize("case", REFUSED)
def test_it_is_refused_in_one_line_and_nothing_is_written(case: str, folder: Path) -> None:
    before = files(folder)
    done = called(*REFUSED[case].call, folder=folder)
    assert_refused(done, REFUSED[case])
    assert done.stdout == "" and files(folder) == before


@pytest.mark.parametrize("case", NOTED)
def test_it_is_understood_or_borne_and_said(case: str, folder: Path) -> None:
    before, use = files(folder), NOTED[case]
    done = called(*use.call, folder=folder)
    assert done.returncode == use.code, done.stderr
    assert all(word in done.stdout for word in use.words), done.stdout
    assert files(folder) == before


def test_a_bad_log_among_good_ones(folder: Path) -> None:
    done = called("replay", "f.csv", "notes.txt", "bom.csv", *STATED, folder=folder)
    assert done.returncode == 1 and done.stdout.count("90 rows") == 2
    assert done.stderr.count("\n") == 1 and "notes.txt" in done.stderr


def test_two_runs_are_not_enough_data(folder: Path) -> None:
    done = called("validate", "two", "--method", "paper", folder=folder)
    assert_refused(done, Use((), 4, ("three runs or more",)))


def test_tests_that_begin_below_the_cut_off_are_not_enough_data(folder: Path) -> None:
    done = called("validate", "end", folder=folder)
    said = done.stderr.splitlines()[-1]  # after what is being done
    assert done.returncode == 4 and "above the cut-off of 16.7 V, found none" in said and "Traceback" not in done.stderr


def test_a_command_that_is_mistyped(folder: Path) -> None:
    done = called("repaly", "f.csv", folder=folder)
    assert done.returncode == 2 and "Did you mean 'replay'?" in done.stderr


@pytest.mark.parametrize(
    "use",
    [
        Use(("live", "foo:bar"), 2, ("`foo:bar`", "expected udpin:HOST:PORT")),
        Use(("live", "udpin:127.0.0.1:1", "--http", "0.0.0.0:8080"), 2, ("0.0.0.0", "http.token")),
        Use(("live", "udpin:127.0.0.1:1", "--feed", "proxy"), 2, ("proxy", "--gcs")),
        Use(("live", "udpin:127.0.0.1:1", "--cells", "999"), 2, ("--cells",)),
    ],
    ids=["an endpoint that is none", "a page for everybody", "a proxy without a station", "999 cells"],
)
def test_live_names_what_it_cannot_do(use: Use, folder: Path) -> None:
    done = refused_live(*use.call[1:], folder=folder)
    assert done.returncode == use.code and all(word in done.stderr for word in use.words), done.stderr
    assert "Traceback" not in done.stderr and done.stdout == ""


@pytest.mark.parametrize(
    "wrong",
    [{"capacity_Ah": -5.0}, {"cells": 999}, {"cells": 0}, {"reserve_soc": 20.0}, {"cutoff_V": math.inf}],
    ids=str,
)
def test_the_python_face_checks_what_it_is_given(wrong: dict[str, float]) -> None:
    stated = {"cells": 4, "capacity_Ah": 5.0, **wrong}
    with pytest.raises(UsageError, match=next(iter(wrong))):
        Estimator.from_battery("lipo-generic", **stated)  # type: ignore[arg-type]
