"""The discharge data-set folder: what it holds, and one line for every way it can be wrong."""

import shutil
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from uavbatt import dataset
from uavbatt.errors import BadInput

HEADER = "sample,run,ambient_c,time_s,voltage_v,current_a,surface_c\n"
BATTERY = """name = "x"\nchemistry = "LiPo"\ncells_series = 3\ncutoff_V = 9.3\nload = "unknown"\nsource = "test"\n"""
ROWS = "a,1,25,0,12.5,,\na,1,25,60,11.0,,\na,1,25,120,10.5,,\n"


def folder(tmp_path: Path, rows: str = ROWS, battery: str = BATTERY, header: str = HEADER) -> Path:
    (tmp_path / "battery.toml").write_text(battery, "utf-8")
    (tmp_path / "discharge.csv").write_text(header + rows, "utf-8")
    return tmp_path


def complaint(path: Path) -> str:
    with pytest.raises(BadInput) as raised:
        dataset.load(path)
    assert "\n" not in str(raised.value)
    return str(raised.value)


def test_packaged_study():
    study = dataset.load()
    assert (study.name, study.cells_series, study.capacity_Ah, study.cutoff_V) == ("lpab-3s", 3, None, 9.3)
    assert len(study.runs) == 48
    assert len(study.ambients_C) == 28
    assert sum(np.isfinite(r.surface_C).all() for r in study.runs) == 10
    assert all(np.isnan(r.current_A).all() for r in study.runs)
    misprint = next(f for f in study.flags if f.kind == "likely misprint")
    flagged = next(r for r in study.runs if r.sample == "T1" and r.ambient_C == misprint.ambient_C)
    assert flagged.voltage_V[flagged.time_s == misprint.time_s] == [10.45]  # flagged, never changed


def test_levels_of_the_study():
    volts = dataset.levels(dataset.load(), 25)
    assert volts.values.shape == (10, 2, 9)
    assert volts.left_out == ("sample T1 (one run)",)
    assert volts.cells(0)[0][:3] == [12.52, 12.48, 12.49]
    heat = dataset.levels(dataset.load(), 25, "surface_C")
    assert heat.samples == ("1",)
    assert dataset.levels(dataset.load(), 10).samples == ("T1",)
    assert dataset.levels(dataset.load(), 10, "surface_C") is None


def test_digest_is_of_the_content_not_of_the_bytes(tmp_path):
    source = resources.files("uavbatt") / "data" / "study"
    for name in ("battery.toml", "discharge.csv"):
        text = (source / name).read_text("utf-8")
        (tmp_path / name).write_bytes(("# note\n" * (name != "discharge.csv") + text).replace("\n", "\r\n").encode())
    assert dataset.load(tmp_path).sha256 == dataset.load().sha256
    text = (tmp_path / "discharge.csv").read_text("utf-8").replace("12.52", "12.53", 1)
    (tmp_path / "discharge.csv").write_text(text, "utf-8")
    assert dataset.load(tmp_path).sha256 != dataset.load().sha256


def test_digest_covers_the_battery_too(tmp_path):
    first = dataset.load(folder(tmp_path)).sha256
    assert dataset.load(folder(tmp_path, battery=BATTERY.replace("9.3", "9.4"))).sha256 != first


def test_runs_of_different_lengths_are_compared_where_all_are(tmp_path):
    rows = ROWS + "a,2,25,0,12.5,,\na,2,25,60,11.1,,\na,2,25,120,10.6,,\na,2,25,180,10.0,,\n"
    table = dataset.levels(dataset.load(folder(tmp_path, rows)), 25)
    assert list(table.time_s) == [0, 60, 120]
    assert "runs end between 120 s and 180 s" in table.notes[0]


def test_missing_readings_are_nan(tmp_path):
    rows = "a,1,25,0,12.5,,\na,1,25,60,11.2,3.5,\na,1,25,120,10.5,,24\na,1,25,180,10.1,3.4,25\n"
    run = dataset.load(folder(tmp_path, rows)).runs[0]
    assert np.isnan(run.surface_C[1]) and np.isnan(run.current_A[0]) and run.surface_C[3] == 25


@pytest.mark.parametrize(("empty", "read_A"), [({0}, 3.0), ({4}, 3.4), ({2, 3}, 3.2), ({1, 4, 8}, None)])
def test_a_few_empty_currents_are_read_from_their_neighbours_and_many_are_no_measurement(
    tmp_path: Path, empty: set[int], read_A: float | None
) -> None:
    """One empty cell of one run took the current away from all runs of a set."""
    shown = ["" if k in empty else f"{3.0 + 0.1 * (k if k else 0):.1f}" for k in range(10)]
    rows = "".join(f"a,1,25,{60 * k},{12.5 - 0.2 * k:.1f},{amps},\n" for k, amps in enumerate(shown))
    run = dataset.load(folder(tmp_path, rows)).runs[0]
    if read_A is None:
        assert not run.is_metered and np.isnan(run.current_A).all()
    else:
        assert run.is_metered and run.current_A[min(empty)] == pytest.approx(read_A, abs=0.11)


def test_rows_without_a_voltage_are_left_out(tmp_path):
    run = dataset.load(folder(tmp_path, ROWS + "a,1,25,180,,3.5,24\na,1,25,240,10.1,,\n")).runs[0]
    assert list(run.time_s) == [0, 60, 120, 240] and np.isfinite(run.voltage_V).all()


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (ROWS.replace("11.0", "11000"), "discharge.csv: line 3, voltage_v: expected 1.5 to 15 V"),
        (ROWS.replace("11.0", "11000"), "millivolts?"),
        (ROWS.replace("11.0", "1100"), "centivolts?"),
        (ROWS.replace("11.0", "nan"), "line 3, voltage_v: expected a finite number"),
        (ROWS.replace("11.0", "eleven"), "found 'eleven'"),
        (ROWS.replace("a,1,25,60", "a,1,25,"), "line 3, time_s: expected a finite number, found ''"),
        (ROWS + "a,1,25,60,11.0,,\n", "line 5: expected each reading once, it repeats line 3"),
        (ROWS + '"' + 200_000 * "a,1,25,60,11.0,,\n", "discharge.csv: expected a table, cannot be read"),
        (ROWS + "a,1,25,90,11.0,,\n", "line 5, time_s: expected time increasing"),
        (ROWS[: ROWS.rindex("a,1")], "at least 3 voltage readings, found 2"),
        (ROWS.replace("11.0", "12.5").replace("10.5", "12.5"), "voltage_v is constant at 12.5"),
        (ROWS.replace(",,\n", ",,20\n"), "column surface_c: expected readings, every row says 20"),
        (ROWS.replace(",,\n", ",0,\n"), "column current_a: expected readings, every row says 0"),
        (ROWS.replace("a,1,25,60", "a,1,298,60"), "line 3, ambient_c: expected -80 to 70 °C, found 298 (kelvin?)"),
        (ROWS.replace("a,1,25", "a,1,77"), "line 2, ambient_c: expected -80 to 70 °C, found 77 (degrees Fahrenheit?)"),
        ("-,-,degC,s,V,A,degC\n" + ROWS, "line 2, run: expected a finite number, found '-' (a row of units?"),
        (ROWS.replace("11.0", "11,0"), "line 3: expected 7 cells, found 8 (decimal commas?"),
        (ROWS.replace("a,1,25,60", "a,1.5,25,60"), "line 3, run: expected a whole number, found '1.5'"),
        (ROWS.replace("a,1,25,60", ",1,25,60"), "line 3, sample: expected a label"),
        (ROWS.replace("11.0,,", "11.0,"), "line 3: expected 7 cells, found 6"),
        (ROWS.replace("25,60", "25,60000000"), "line 4, time_s: expected time increasing"),
        ("a,1,25,0,4.2,,\na,1,25,60,3.7,,\na,1,25,120,3.5,,\n", "4.2 V at most for 3 cells: per cell?"),
        ("", "line 2: expected at least one row"),
    ],
)
def test_bad_rows_name_their_line(tmp_path, rows, said):
    assert said in complaint(folder(tmp_path, rows))


@pytest.mark.parametrize(
    ("header", "said"),
    [
        (HEADER.replace("voltage_v", "voltag_v"), "line 1: expected the column voltage_v, found voltag_v"),
        (HEADER.replace(",surface_c", ""), "line 1: expected the column surface_c; all of them"),
        (HEADER.replace("\n", ",humidity\n"), "found humidity"),
        (HEADER.replace("sample,run", "Sample,Run"), "line 1: expected the columns sample,run, found Sample"),
        (HEADER.replace(",", ";"), "found semicolons or tabs between the columns: write commas"),
        ("", "line 1: expected the columns sample,run"),
    ],
)
def test_bad_header(tmp_path, header, said):
    assert said in complaint(folder(tmp_path, header=header))


@pytest.mark.parametrize(
    ("battery", "said"),
    [
        (BATTERY.replace("cells_series = 3\n", ""), "battery.toml: key cells_series: expected it to be there"),
        (BATTERY + "cutof_V = 9\n", "did you mean cutoff_V?"),
        (BATTERY.replace("= 3", '= "three"'), "key cells_series"),
        (BATTERY.replace("9.3", "-1"), "key cutoff_V"),
        (BATTERY.replace("9.3", "3.3"), "cutoff_V: expected the voltage of the whole pack: 3.3 V is 1.1 V a cell"),
        (BATTERY + "capacity_Ah = 5000\n", "capacity_Ah: expected ampere-hours, found 5000 (mAh?)"),
        (BATTERY + "[uncertainty]\nvoltage_resolution = 0.01\n", "key uncertainty.voltage_resolution"),
        (BATTERY + "oops", "expected TOML"),
        (BATTERY.replace('"x"', '"../../evil/name"'), "battery.toml: key name: expected the name of a file"),
        (BATTERY.replace('"x"', r'"..\\evil"'), "key name"),
        (BATTERY.replace('"x"', '".hidden"'), "key name"),
        (BATTERY.replace('"x"', r'"a\nb"'), "key name"),
    ],
)
def test_bad_battery_names_the_key(tmp_path, battery, said):
    assert said in complaint(folder(tmp_path, battery=battery))


def measured(current_A: float = 10.0, second_s: float = 1.0, surface: float = 1.0, zero: float = 0.0) -> str:
    """Return a whole discharge of 5 Ah in half an hour, with each quantity in a unit of so many of ours."""
    rows = [(60.0 * i, 12.5 - 0.11 * i, current_A, surface * (25.0 + 0.3 * i) + zero) for i in range(31)]
    return "".join(f"a,1,25,{t * second_s:g},{v:.2f},{i:g},{c:.1f}\n" for t, v, i, c in rows)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (measured(-10.0), "sample a, run 1 at 25 °C, current_a: expected positive numbers in discharge"),
        (measured(10_000.0), "sample a, run 1 at 25 °C: expected current_a in A and time_s in s, the run draws"),
        (measured(10_000.0), "(milliamperes?)"),
        (measured(second_s=200.0), "the run draws 1e+03 Ah of 5 Ah"),
        (measured(second_s=500.0), "(milliseconds?)"),
        (measured(second_s=1 / 60), "no run draws more than 0.083 Ah of 5 Ah (minutes?)"),
        (measured(second_s=1 / 3600), "(hours?)"),
        (measured(surface=1.8, zero=32.0), "column surface_c: expected °C, sample a, run 1 at 25 °C begins with 77"),
    ],
)
def test_a_wrong_unit_shows_in_the_sums_over_a_run(tmp_path, rows, said):
    assert said in complaint(folder(tmp_path, rows, BATTERY + "capacity_Ah = 5.0\n"))


def test_a_discharge_in_the_right_units_is_read(tmp_path):
    assert len(dataset.load(folder(tmp_path, measured(), BATTERY + "capacity_Ah = 5.0\n")).runs) == 1


def test_bad_folders(tmp_path):
    assert "found nothing" in complaint(tmp_path / "none")
    assert "battery.toml and discharge.csv missing" in complaint(tmp_path)
    (tmp_path / "battery.toml").write_text(BATTERY)
    assert "discharge.csv missing" in complaint(tmp_path)
    assert "found a file" in complaint(tmp_path / "battery.toml")
    (tmp_path / "discharge.csv").write_bytes(b"\xff\xfe\x00")
    assert "text in UTF-8" in complaint(tmp_path)
    (tmp_path / "discharge.csv").write_text("")
    assert "the file is empty" in complaint(tmp_path)


def test_column_order_does_not_matter(tmp_path):
    a = dataset.load(folder(tmp_path))
    (tmp_path / "b").mkdir()
    shutil.copy(tmp_path / "battery.toml", tmp_path / "b")
    turned = "\n".join(",".join(reversed(line.split(","))) for line in (HEADER + ROWS).splitlines())
    (tmp_path / "b" / "discharge.csv").write_text(turned)
    assert dataset.load(tmp_path / "b").sha256 == a.sha256


def test_a_template_is_a_data_set_and_overwrites_nothing(tmp_path: Path) -> None:
    dataset.write_template(tmp_path / "mine")
    found = dataset.load(tmp_path / "mine")
    assert (found.cells_series, found.capacity_Ah, len(found.runs)) == (4, 5.0, 3)
    with pytest.raises(BadInput, match="overwrites nothing"):
        dataset.write_template(tmp_path / "mine")


def test_all_missing_keys_are_named_at_once(tmp_path: Path) -> None:
    dataset.write_template(tmp_path)
    (tmp_path / "battery.toml").write_text('name = "a"\ncells_series = 4\n')
    with pytest.raises(BadInput, match="keys chemistry, cutoff_V, load, source: expected them to be there"):
        dataset.load(tmp_path)


def test_all_missing_columns_are_named_at_once(tmp_path: Path) -> None:
    dataset.write_template(tmp_path)
    (tmp_path / "discharge.csv").write_text("sample;run;ambient_c\nA;1;25\n")
    with pytest.raises(BadInput, match=r"the columns sample,run,ambient_c,.*semicolons"):
        dataset.load(tmp_path)
