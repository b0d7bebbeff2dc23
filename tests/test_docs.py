"""The documentation holds: examples are read, tables of keys are the code's, links lead somewhere, names are there."""

from __future__ import annotations

import ast
import json
import re
import typing
from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path

import msgspec
import pytest
from command import called
from packs.made import flight

import uavbatt
from uavbatt import dataset, output
from uavbatt.battery import battery_file, sections, vehicle_file
from uavbatt.battery.effects import EFFECTS, unit_words
from uavbatt.cli.app import app
from uavbatt.dataset import folder
from uavbatt.dataset.discharge_csv import COLUMNS as DISCHARGE_COLUMNS
from uavbatt.diagnosis.classes import EffectClass
from uavbatt.diagnosis.refit.residual import Shape
from uavbatt.fleet.row import COLUMNS as FLEET_COLUMNS
from uavbatt.live import config
from uavbatt.live.feeds.web import content
from uavbatt.live.report import Report
from uavbatt.packs.ledger import Ledger
from uavbatt.records import Status
from uavbatt.telemetry.formats import airdata_csv, blackbox_csv, csv_table, dji_record_csv, edgetx_csv

ROOT = Path(__file__).resolve().parents[1]
FORMATS = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
MEASURED = ("soc_start", "soc_end", "charge_Ah", "energy_Wh", "temp_mean_C", "temp_max_C")
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])


def agree(documented_keys: Iterable[str], keys: Iterable[str]) -> None:
    """The table has every key of the code and none besides."""
    told, real = set(documented_keys), set(keys)
    assert not real - told, f"docs/formats.md lacks {sorted(real - told)}"
    assert not told - real


def example(title: str) -> str:
    """The text of the example of that title."""
    found = re.search(rf'^```\w+ title="{re.escape(title)}"\n(.*?)^```$', FORMATS, re.MULTILINE | re.DOTALL)
    assert found is not None, f"docs/formats.md has no example {title}"
    return found[1]


def written(tmp_path: Path, *titles: str) -> Path:
    """The examples as files in a folder."""
    for title in titles:
        path = tmp_path / title
        path.parent.mkdir(exist_ok=True)
        path.write_text(example(title), encoding="utf-8")
    return tmp_path


def documented(heading: str, table: int = 0) -> list[str]:
    """The first column of a table of keys below a heading of docs/formats.md."""
    section = re.split(r"^## ", FORMATS, flags=re.MULTILINE)
    text = next(part for part in section if part.startswith(f"{heading}\n"))
    tables = re.findall(r"^\| (?:key|column) \|.*\n\|[-| :]+\n((?:\|.*\n)+)", text, flags=re.MULTILINE)
    return [row.split("|")[1].strip().strip("`") for row in tables[table].splitlines()]


def keys_of(record: type, prefix: str = "") -> list[str]:
    """Every key of a file that msgspec reads, sections by their path."""
    hints = typing.get_type_hints(record)
    found = []
    for name in record.__struct_fields__:
        inner = [t for t in _types(hints[name]) if isinstance(t, type) and issubclass(t, msgspec.Struct)]
        found += keys_of(inner[0], f"{prefix}{name}.") if inner else [f"{prefix}{name}"]
    return found


def _types(hint: object) -> Iterable[object]:
    yield hint
    for inner in typing.get_args(hint):
        yield from _types(inner)


def keys_in(value: object, prefix: str = "") -> set[str]:
    """Every key of a JSON document, those in lists and objects by their path."""
    if isinstance(value, list):
        return set().union(*(keys_in(entry, prefix) for entry in value))
    if not isinstance(value, dict):
        return set()
    return {f"{prefix}{key}" for key in value}.union(*(keys_in(v, f"{prefix}{key}.") for key, v in value.items()))


def test_the_data_set_of_the_page_is_read(tmp_path: Path) -> None:
    folder = written(tmp_path, "dataset/battery.toml", "dataset/discharge.csv", "dataset/flags.toml") / "dataset"
    found = dataset.load(folder)
    assert (found.name, found.cells_series, len(found.runs), len(found.flags)) == ("acme-4s-5000", 4, 2, 1)
    assert found.uncertainty == dataset.Uncertainty(
        voltage_resolution_V=0.01, voltage_calibration_V=0.02, current_resolution_A=0.1, current_calibration_A=0.2,
        reading_time_s=1.0, temperature_resolution_C=0.1, temperature_calibration_C=0.5,
    )  # fmt: skip


def test_the_keys_of_a_data_set() -> None:
    assert sorted(documented("Discharge data set")) == sorted(keys_of(folder._Battery))
    assert documented("Discharge data set", 1) == list(DISCHARGE_COLUMNS)
    assert sorted(documented("Discharge data set", 2)) == sorted(keys_of(folder._Flags))


def test_the_telemetry_csv(tmp_path: Path) -> None:
    flight = uavbatt.read_log(written(tmp_path, "flight.csv") / "flight.csv")
    assert (len(flight.samples), flight.notes) == (3, ())
    assert documented("Telemetry CSV") == [*csv_table.REQUIRED, *csv_table.OPTIONAL]


def test_the_tables_of_other_programs() -> None:
    for number, module in enumerate((airdata_csv, dji_record_csv, edgetx_csv, blackbox_csv)):
        of_one_cell = {k: v for k, v in module.COLUMNS.items() if not k.startswith("cell_") or k == "cell_1_V"}
        names = [name for theirs in (*of_one_cell.values(), *getattr(module, "WORDS", {}).values()) for name in theirs]
        agree(documented("DJI, radio and blackbox CSV", number), names)


def test_the_battery_file(tmp_path: Path) -> None:
    found = battery_file.read_battery(written(tmp_path, "acme.battery.toml") / "acme.battery.toml")
    assert (found.status, found.battery.capacity_Ah) == ("fitted", 5.0)
    listed = keys_of(sections.BatteryFile)
    agree(documented("Battery file"), {*listed, "certificate.verdicts"})
    shown = keys_in(msgspec.toml.decode(example("acme.battery.toml"))) & set(listed)
    assert set(listed) - shown == {key for key in listed if key.startswith("discrepancy.wander.")}  # its own section


def test_the_vehicle_file(tmp_path: Path) -> None:
    assert (
        vehicle_file.read_vehicle(written(tmp_path, "quad.vehicle.toml") / "quad.vehicle.toml").phases.flight_W == 250.0
    )
    agree(documented("Vehicle file"), keys_of(vehicle_file.VehicleFile))


def test_the_configuration(tmp_path: Path) -> None:
    stated = config.read_config(written(tmp_path, "uavbatt.toml") / "uavbatt.toml")
    assert config.checked(stated) == stated and stated.pack.capacity_Ah == 5.0
    agree(documented("Configuration"), keys_of(config.Config))


def test_a_replay_s_rows_and_summary(tmp_path: Path, short_log: Path) -> None:
    assert documented("Replay: JSON Lines and CSV") == list(output.COLUMNS)
    along_a_route = documented("Replay: JSON Lines and CSV", 1)
    assert along_a_route == list(getattr(output, "ROUTE_COLUMNS", along_a_route))
    assert list(json.loads(example("row.jsonl"))) == list(output.COLUMNS)
    assert called("replay", short_log, "--json", "s.json", folder=tmp_path).returncode == 0
    said = keys_in(json.loads((tmp_path / "s.json").read_text()))
    agree(documented("Replay: summary"), said)
    agree(keys_in(json.loads(example("summary.json"))), said)
    ledger = ("--packs", "p.sqlite", "--pack", "A")
    assert called("replay", short_log, "no.csv", *ledger, "--json", "s.json", folder=tmp_path).returncode == 1
    remembered, failed = json.loads((tmp_path / "s.json").read_text())
    assert set(failed) == {"log", "error"}
    assert documented("Replay: summary", 1) == ["pack", "pack_flights", "pack_findings"]
    assert keys_in(remembered) - said <= set(documented("Replay: summary", 1))


def test_a_plan_s_summary(tmp_path: Path) -> None:
    pack = ("--cells", "4", "--capacity-ah", "5", "--power-w", "250")
    assert called("plan", *pack, "--json", "p.json", folder=tmp_path).returncode == 0
    said = keys_in(json.loads((tmp_path / "p.json").read_text()))
    agree(keys_in(json.loads(example("plan.json"))), said)
    agree(documented("Plan: summary"), {key for key in said if not key.startswith("planned.")})


def test_the_numbers_of_the_plans_are_those_of_their_commands(tmp_path: Path) -> None:
    written(tmp_path, "quad.vehicle.toml", "round.waypoints")
    for title in ("plan.json", "mission.json"):
        commands = re.findall(r"`uavbatt (plan [^`]+)`", FORMATS.partition(f'title="{title}"')[0])
        assert called(*commands[-1].split(), "--json", title, folder=tmp_path).returncode == 0
        said, told = json.loads((tmp_path / title).read_text()), json.loads(example(title))
        assert_alike({**said, "table": said["table"][2:3], "legs": said.get("legs", [])[:1]}, {"legs": [], **told})


def assert_alike(said: object, told: object) -> None:
    """What a page tells is what a program says, but for the last digits."""
    if isinstance(told, dict) and isinstance(said, dict):
        assert said.keys() == told.keys()
        for key, value in told.items():
            assert_alike(said[key], value)
    elif isinstance(told, list) and isinstance(said, list):
        for one, other in zip(said, told, strict=True):
            assert_alike(one, other)
    else:
        assert said == (pytest.approx(told, rel=0.01, abs=0.1) if isinstance(told, float) else told)


def test_a_mission_s_plan() -> None:
    """Its example is what the command says: asked above."""
    told = keys_in(json.loads(example("mission.json")))
    of_the_pack = set(documented("Plan: summary")) - {"load"}
    own = {key for key in told - of_the_pack if not key.startswith("planned.")}
    rows = {key for key in told if key.startswith("table.")} | {"planned", "table"}
    agree(documented("Plan: summary", 1), own | rows)


def test_the_pack_ledger_s_json(tmp_path: Path) -> None:
    ledger, pack = tmp_path / "p.sqlite", ("--pack", "A")
    loss = flight(8, 1.0, 0.75, weak_cell=3, weak_cell_V=0.012, cycles=41, fullest_cell_V=4.25,
                  **dict.fromkeys(MEASURED, 0.5))  # fmt: skip
    with Ledger(ledger) as opened:
        opened.save_all("A", [*(flight(k) for k in range(8)), loss])
    assert called("packs", ledger, *pack, "--json", "p.json", folder=tmp_path).returncode == 0
    assert called("packs", ledger, *pack, "--export", "A.json", folder=tmp_path).returncode == 0
    for title, made, table in (("packs.json", "p.json", 0), ("A.json", "A.json", 1)):
        said = keys_in(json.loads((tmp_path / made).read_text()))
        agree(keys_in(json.loads(example(title))), said)
        agree(documented("Pack ledger", table), {key for key in said if not key.startswith("history.flight.")})
    taken_in = called("packs", "q.sqlite", "--import", written(tmp_path, "A.json") / "A.json", folder=tmp_path)
    assert taken_in.returncode == 0, taken_in.stderr


def test_the_packaged_batteries(tmp_path: Path) -> None:
    assert called("batteries", "--json", "b.json", folder=tmp_path).returncode == 0
    said = json.loads((tmp_path / "b.json").read_text())
    assert json.loads(example("batteries.json")) == [one for one in said if one["battery"]["name"] == "lipo-generic"]


def test_a_diagnosis() -> None:
    said = keys_in(json.loads(example("diagnosis.json")))
    of_a_class = {f"classes.{field.name}" for field in fields(EffectClass)}
    of_what_is_left = {f"left.{field.name}" for field in fields(Shape)}
    assert set(documented("Diagnosis")) == {key for key in said if key.count(".") < 1} | of_a_class | of_what_is_left
    assert of_what_is_left <= said


def test_the_fleet_s_table() -> None:
    agree(documented("Fleet table"), [name for name, _ in FLEET_COLUMNS])


def test_the_page_s_json() -> None:
    estimate = uavbatt.Estimate(0.0, 0.5, 0.1, 15.0, 10.0, 25.0, 150.0, 0.0, 1.0, Status.OK)
    report = Report(0, 1, 1, estimate, uavbatt.Remaining(0.0, 60.0, 30.0, 90.0, 50.0, Status.OK), 0.0)

    class Board:
        reports, notes, announcements, counts = (report,), ("a note",), ((0.0, "a text"),), {"rows": 1}

    said = content(Board, 1.0)  # type: ignore[arg-type]
    of_a_battery = [f"batteries.{key}" for key in said["batteries"][0] if key not in output.COLUMNS]
    assert sorted(documented("Live: now.json")) == sorted([*said, *of_a_battery])


def test_the_effects_of_the_nomenclature() -> None:
    text = (ROOT / "docs" / "nomenclature.md").read_text(encoding="utf-8").partition("## Effects")[2]
    rows = [[cell.strip().strip("`") for cell in row.split("|")[1:-1]] for row in re.findall(r"^\|.*`.*$", text, re.M)]
    told = [(row[2], "" if row[3] == "–" else row[3], row[4], row[5]) for row in rows]
    quantities = [quantity for effect in EFFECTS.values() for quantity in effect.quantities]
    assert told == [(q.name, unit_words(q.unit), f"{q.low:g} to {q.high:g}", f"{q.neutral:g}") for q in quantities]
    assert [row[0] for row in rows if row[0]] == list(EFFECTS)


def test_every_public_name_is_in_the_api() -> None:
    text = (ROOT / "docs" / "api.md").read_text(encoding="utf-8").replace("\\", "")
    assert sorted(re.findall(r"^### uavbatt\.(\w+)$", text, re.M)) == sorted(uavbatt.__all__)


def test_the_readme_s_table_is_that_of_the_scores() -> None:
    """Six rows of docs/scores.md: whoever measures anew changes both."""
    scores = (ROOT / "docs" / "scores.md").read_text(encoding="utf-8")
    tables = {name: _score_rows(scores, name) for name in ("mean absolute error", "bias [s]", "the 90 % interval")}
    rows = [row for row in _rows((ROOT / "README.md").read_text(encoding="utf-8")) if len(row) == 7][1:]
    assert len(rows) == 6
    for method, *cells in rows:
        error, bias = tables["mean absolute error"][method], tables["bias [s]"][method]
        inside = tables["the 90 % interval"].get(f"{method}: inside", ["–"] * 7)
        assert cells == [error[2], bias[2], inside[2], error[5], bias[5], inside[5]], method


def test_pages_quote_the_replay_that_the_readme_shows() -> None:
    """That the README shows what the command prints is asked in tests/cli/test_first_answer.py."""
    readme, started = ((ROOT / name).read_text(encoding="utf-8") for name in ("README.md", "docs/getting_started.md"))
    said = re.findall(r"half time: said +(\d+) s (\[\d+, \d+\])", readme)
    assert [f"said {median} s {interval}" for median, interval in said] == re.findall(r"`(said \d.*?)`", started)
    score = json.loads(example("summary.json"))["scores"][0]
    assert said == [(f"{score['remaining_s']:.0f}", f"[{score['lo_s']:.0f}, {score['hi_s']:.0f}]")]


def _score_rows(text: str, title: str) -> dict[str, list[str]]:
    table = text.partition(f"**M100: {title}")[2].partition("\n\n")[2].partition("\n\n")[0]
    return {name: cells for name, *cells in _rows(table)}


def _rows(text: str) -> list[list[str]]:
    cells = ([cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line[:1] == "|")
    return [row for row in cells if set("".join(row)) - set("-:")]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_to_files_of_the_checkout(page: Path) -> None:
    """For readers of the checkout; `scripts/docs` does the same for the site, anchors included."""
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", re.sub(r"```.*?```", "", page.read_text("utf-8"), flags=re.S)):
        if "://" not in target:
            assert (page.parent / target).exists(), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_python_of_the_pages_is_python_and_names_what_there_is(page: Path) -> None:
    for code in re.findall(r"^```python\n(.*?)^```", page.read_text("utf-8"), re.M | re.S):
        for node in ast.walk(ast.parse(code)):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "uavbatt":
                assert node.attr in uavbatt.__all__, node.attr


def test_every_command_stands_in_the_readme() -> None:
    named = re.findall(
        r"^\| `(\w+)[ `].*\|$", (ROOT / "README.md").read_text("utf-8").partition("## Commands")[2], re.M
    )
    assert sorted(named) == sorted(str(command.name) for command in app.registered_commands)


def test_the_mission_file(tmp_path: Path) -> None:
    mission_file = pytest.importorskip("uavbatt.telemetry.formats.mission_file", reason="missions are not read yet")
    planned = mission_file.read_mission(written(tmp_path, "round.waypoints") / "round.waypoints")
    assert planned.home is not None and len(planned.mission.items) >= 3


def test_the_image_copies_what_there_is_and_runs_a_command_as_nobody_special() -> None:
    """No daemon builds it here: what can be read of it is."""
    lines = (ROOT / "scripts" / "Dockerfile").read_text("utf-8").splitlines()
    words = [line.split() for line in lines if line and not line.startswith("#")]
    copied = [name for verb, *names in words if verb == "COPY" and "--from=build" not in names for name in names[:-1]]
    assert copied and all((ROOT / name).exists() for name in copied)
    assert [names for verb, *names in words if verb == "USER"] == [["uavbatt"]]
    command = json.loads(next(line for line in lines if line.startswith("CMD")).partition(" ")[2])
    assert command[0] in {str(known.name) for known in app.registered_commands}
