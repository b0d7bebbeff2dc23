"""Battery files: round trip, and that no edit goes unnoticed by whoever reads one."""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
import tomli_w
from cases import first_quick
from typer.testing import CliRunner

from uavbatt import Estimator
from uavbatt.battery import battery_file
from uavbatt.battery.battery_file import BatteryFile, Wander
from uavbatt.battery.scaling import pack_of
from uavbatt.cli.app import app
from uavbatt.errors import BadInput, Uncertified
from uavbatt.fitting.generic import generic_lipo, generic_lithium_ion

PACKAGED = ("lipo-generic", "liion-generic", "lpab-3s")
PRIVATE = ("content_sha256", "date", "tool_version")  # of the certificate: what the hash does not cover


def packaged_content(name: str) -> dict[str, Any]:
    return tomllib.loads(battery_file._text(name)[0].decode())


def leaves(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Paths of all leaves, an empty list or table included."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    below = [leaf for key, inner in items for leaf in leaves(inner, (*path, key))]
    yield from below or [path]


def at(content: Any, path: tuple[Any, ...]) -> Any:
    for key in path:
        content = content[key]
    return content


def flipped(content: dict[str, Any], path: tuple[Any, ...]) -> dict[str, Any]:
    """A copy with one leaf changed, as little as its type allows."""
    changed = copy.deepcopy(content)
    parent, key = at(changed, path[:-1]), path[-1]
    old = parent[key]
    if isinstance(old, bool):
        parent[key] = not old
    elif isinstance(old, int):
        parent[key] = old + 1
    elif isinstance(old, float):
        parent[key] = old * (1 + 1e-9) if old else 1e-9
    elif isinstance(old, str):
        others = {"pass": "not enough data", "certified": "fitted", "generic": "fitted"}
        parent[key] = others.get(old, old + "x") if key in ("verdict", "status") else old + "x"
    elif isinstance(old, list):
        old.append(1.5 if key == "validated_ambient_C" else "x")
    else:
        old["x"] = 1.0
    return changed


def written(content: dict[str, Any], folder: Path, name: str = "edited") -> Path:
    path = folder / f"{name}{battery_file.SUFFIX}"
    path.write_bytes(tomli_w.dumps(content).encode())
    return path


# a knot, a parameter, an effect, the corridor and a verdict: each by every road into the house
BY_ROAD = [
    ("lpab-3s", path)
    for path in (
        ("parameters", "resistance_ohmAh", 3),
        ("parameters", "ocv_V", 7),
        ("effects", 0, "parameters", "polarisation_ratio"),
        ("corridor", "limit_V", 2),
        ("certificate", "verdicts", 0, "verdict"),
        ("certificate", "status"),
        ("discrepancy", "voltage_rmse_V"),
        ("battery", "cutoff_V"),
    )
]


def named(case: tuple[str, tuple[Any, ...]]) -> str:
    return f"{case[0]}:{'.'.join(str(key) for key in case[1])}"


@pytest.mark.parametrize("name", PACKAGED)
def test_packaged_files_are_intact(name: str) -> None:
    assert name in battery_file.packaged()
    read = battery_file.read_battery(name)
    assert read.certificate.content_sha256 == battery_file.content_hash(read)
    assert read.battery.name == name
    assert read.status == ("certified" if name == "lpab-3s" else "generic")


@pytest.mark.parametrize("made", [generic_lipo(), generic_lithium_ion()], ids=["LiPo", "Li-ion"])
def test_the_packaged_priors_are_those_in_the_code(made: BatteryFile) -> None:
    """Whoever changes a prior packages it again: scripts/package_batteries.py."""
    packaged = battery_file.read_battery(made.battery.name)
    assert battery_file.content_hash(packaged) == battery_file.content_hash(made)


@pytest.mark.parametrize("name", PACKAGED)
def test_round_trip(name: str, tmp_path: Path) -> None:
    first = battery_file.read_battery(name)
    path = battery_file.write_battery(first, tmp_path / "new" / f"copy{battery_file.SUFFIX}")
    again = battery_file.read_battery(path)
    assert battery_file.content_hash(again) == battery_file.content_hash(first) == again.certificate.content_sha256
    assert msgspec.structs.replace(again, certificate=first.certificate) == first
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_layout_comments_and_date_are_not_content(tmp_path: Path) -> None:
    content = packaged_content("lpab-3s")
    content["certificate"]["date"], content["certificate"]["tool_version"] = "1999-01-01", "9.9"
    path = written(dict(reversed(content.items())), tmp_path)
    path.write_text("# a comment\n" + path.read_text())
    assert battery_file.read_battery(path).certificate.date == "1999-01-01"


@pytest.mark.parametrize("name", first_quick(1, PACKAGED))
def test_every_edit_is_noticed(name: str, tmp_path: Path) -> None:
    """Each leaf of the file, changed by as little as its type allows."""
    content, unnoticed = packaged_content(name), []
    for path in leaves(content):
        edited = written(flipped(content, path), tmp_path)
        if path[0] == "certificate" and path[1] in PRIVATE[1:]:
            battery_file.read_battery(edited)
            continue
        try:
            battery_file.read_battery(edited)
            unnoticed.append(path)
        except (Uncertified, BadInput) as error:
            assert str(edited) in str(error) and "\n" not in str(error)
    assert not unnoticed


def test_every_removal_is_noticed(tmp_path: Path) -> None:
    """Each leaf taken out: refused, unless the default says the same."""
    content, was = packaged_content("lpab-3s"), msgspec.to_builtins(battery_file.read_battery("lpab-3s"))
    for path in leaves(content):
        if path[0] == "certificate":
            continue
        less = copy.deepcopy(content)
        del at(less, path[:-1])[path[-1]]
        try:
            read = battery_file.read_battery(written(less, tmp_path))
        except (Uncertified, BadInput):
            continue
        assert msgspec.to_builtins(read) == was, path


@pytest.mark.parametrize("case", BY_ROAD, ids=named)
def test_estimator_and_replay_notice(case: tuple[str, tuple[Any, ...]], tmp_path: Path) -> None:
    edited = written(flipped(packaged_content(case[0]), case[1]), tmp_path)
    with pytest.raises(Uncertified, match="content_sha256"):
        Estimator.from_battery(edited)
    assert Estimator.from_battery(edited, allow_uncertified=True).battery.battery.name == case[0]
    log = tmp_path / "f.csv"
    log.write_text("time_s,voltage_V,current_A\n" + "".join(f"{t},12.2,8\n" for t in range(20)))
    out = tmp_path / "f.jsonl"
    call = ["replay", str(log), "--battery", str(edited), "--capacity-ah", "5", "--jsonl", str(out)]
    refused = CliRunner().invoke(app, call)
    assert isinstance(refused.exception, Uncertified) and refused.exception.exit_code == 1
    assert not out.exists()
    passed = CliRunner().invoke(app, [*call, "--allow-uncertified"])
    assert passed.exit_code == 0 and len(out.read_text().splitlines()) == 20


def test_a_fail_verdict_is_refused_even_when_sealed(tmp_path: Path) -> None:
    """A file that was written whole, hash and all, but whose gate said fail."""
    content = packaged_content("lpab-3s")
    content["certificate"]["verdicts"][0]["verdict"] = "fail"
    failed = msgspec.convert(content, battery_file.BatteryFile)
    path = battery_file.write_battery(failed, tmp_path / f"failed{battery_file.SUFFIX}")
    with pytest.raises(Uncertified, match="it is fail") as caught:
        battery_file.read_battery(path)
    assert failed.certificate.verdicts[0].claim in str(caught.value)
    with pytest.raises(Uncertified, match="it is fail"):
        Estimator.from_battery(path)
    assert battery_file.read_battery(path, allow_uncertified=True).certificate.verdicts[0].verdict == "fail"


def broken(edit: str) -> dict[str, Any]:
    content = packaged_content("lpab-3s")
    table, first = content["parameters"], content["effects"][0]
    if edit == "unknown key":
        table["colour"] = 1.0
    elif edit == "unknown section":
        content["extras"] = {}
    elif edit == "missing key":
        del content["battery"]["cutoff_V"]
    elif edit == "missing section":
        del content["discrepancy"]
    elif edit == "text for a number":
        table["resistance_scale_sd"] = "much"
    elif edit == "number for a text":
        content["battery"]["name"] = 3
    elif edit == "unsorted knots":
        table["ocv_soc"][2], table["ocv_soc"][3] = table["ocv_soc"][3], table["ocv_soc"][2]
    elif edit == "knots twice":
        table["resistance_soc"][1] = table["resistance_soc"][0]
    elif edit == "too few values":
        table["ocv_V"].pop()
    elif edit == "negative resistance":
        table["resistance_ohmAh"][0] = -0.01
    elif edit == "unknown effect":
        first["name"] = "gremlins"
    elif edit == "unknown quantity":
        first["parameters"]["gremlins"] = 1.0
    elif edit == "out of bounds":
        first["parameters"]["polarisation_ratio"] = 1e6
    elif edit == "unknown verdict":
        content["certificate"]["verdicts"][0]["verdict"] = "perhaps"
    elif edit == "unknown status":
        content["certificate"]["status"] = "blessed"
    elif edit == "no cells":
        content["battery"]["cells_series"] = 0
    return content


BROKEN = {
    "unknown key": "colour",
    "unknown section": "extras",
    "missing key": "cutoff_V",
    "missing section": "discrepancy",
    "text for a number": "resistance_scale_sd",
    "number for a text": "name",
    "unsorted knots": "ocv_soc",
    "knots twice": "resistance_soc",
    "too few values": "ocv_soc",
    "negative resistance": "resistance_ohmAh",
    "unknown effect": "gremlins",
    "unknown quantity": "gremlins",
    "out of bounds": "polarisation_ratio",
    "unknown verdict": "perhaps",
    "unknown status": "blessed",
    "no cells": "battery",
}


@pytest.mark.parametrize("edit", BROKEN)
def test_what_is_malformed_is_named(edit: str, tmp_path: Path) -> None:
    """Malformed is malformed, --allow-uncertified or not."""
    path = written(broken(edit), tmp_path)
    for allow in (False, True):
        with pytest.raises(BadInput) as caught:
            battery_file.read_battery(path, allow_uncertified=allow)
        message = str(caught.value)
        assert message.startswith(str(path)) and BROKEN[edit] in message and "\n" not in message


@pytest.mark.parametrize("data", [b"", b"\x89PNG\r\n\x1a\n\0\0", b"[battery", b"\xff\xfe\x00", b"[battery]\nname = 1"])
def test_no_battery_file(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x.battery.toml"
    path.write_bytes(data)
    with pytest.raises(BadInput) as caught:
        battery_file.read_battery(path)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)


def test_missing_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="found no file of this name"):
        battery_file.read_battery(tmp_path / "none.battery.toml")
    with pytest.raises(BadInput, match="found a directory"):
        battery_file.read_battery(tmp_path)
    with pytest.raises(BadInput, match="lipo-generic, lpab-3s"):
        battery_file.read_battery("lipo-genric")


def test_status_widens_the_belief() -> None:
    certified = battery_file.read_battery("lpab-3s")
    fitted = msgspec.structs.replace(
        certified, certificate=msgspec.structs.replace(certified.certificate, status="fitted")
    )
    sure, unsure = (pack_of(f, 3, 5.0, 9.3, 10.5).spread for f in (certified, fitted))
    assert unsure.resistance_scale_sd > sure.resistance_scale_sd
    assert unsure.bias_sd_V > sure.bias_sd_V


def test_a_file_of_before_a_key_was_added_keeps_its_hash() -> None:
    """A key of [discrepancy.wander] that nobody states is as if it were not there: the hash as it was before it.

    Another packaged prior has another hash: then take the one that the version before wrote.
    """
    wander = Wander(
        soc=[0.0, 1.0], voltage_sd_V=[0.004, 0.004], voltage_time_s=120.0, voltage_noise_V=0.002, rest_sd_V=0.002,
        temperature_sd_K=0.2, temperature_time_s=600.0, temperature_noise_K=0.05,
    )  # fmt: skip
    generic = battery_file.read_battery("lipo-generic")
    file = msgspec.structs.replace(generic, discrepancy=msgspec.structs.replace(generic.discrepancy, wander=wander))
    assert battery_file.content_hash(file).startswith("a02a76cfaca2bcb2")
