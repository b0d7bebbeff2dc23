"""F3: a battery file that is let through although it was edited, or failed, is never shown as certified."""

from __future__ import annotations

import json
import urllib.request
from pathlib import Path
from typing import Any

import msgspec
import pytest
from command import called
from live_rig import Vehicle, free_port, running, until

from uavbatt.battery import battery_file
from uavbatt.battery.scaling import pack_of

pytestmark = pytest.mark.usefixtures("undrawn")

ROOT = Path(__file__).parents[2]
TLOG = ROOT / "logs/quad_4s.tlog"
LET = "--allow-uncertified"


@pytest.fixture
def tampered(tmp_path: Path) -> Path:
    """The packaged prior with one word changed, as `sed s/generic/certified/` leaves it."""
    text = battery_file._text("lipo-generic")[0].decode()
    path = tmp_path / "t.battery.toml"
    path.write_text(text.replace('status = "generic"', 'status = "certified"'))
    return path


@pytest.fixture
def failed(tmp_path: Path) -> Path:
    """A file that was written whole, hash and all, but whose gate said fail."""
    certified = battery_file.read_battery("lpab-3s")
    verdicts = [*certified.certificate.verdicts]
    verdicts[0] = msgspec.structs.replace(verdicts[0], verdict="fail")
    certificate = msgspec.structs.replace(certified.certificate, verdicts=verdicts)
    return battery_file.write_battery(
        msgspec.structs.replace(certified, certificate=certificate), tmp_path / "f.battery.toml"
    )


@pytest.mark.parametrize("which", ["tampered", "failed"])
def test_refused_without_the_option_and_edited_with_it(
    which: str, request: pytest.FixtureRequest, short_log: Path
) -> None:
    path: Path = request.getfixturevalue(which)
    folder = path.parent
    outputs = ("--json", "s.json", "--report", "p.html", "--jsonl", "l.jsonl")
    call = ("replay", short_log, "--battery", path, "--cells", "4", "--capacity-ah", "2", *outputs)
    refused = called(*call, folder=folder)
    assert refused.returncode == 1 and LET in refused.stderr and not (folder / "s.json").exists()
    done = called(*call, LET, folder=folder)
    assert done.returncode == 0
    assert "edited, not certified" in done.stdout and "(certified)" not in done.stdout
    assert f"{path}: battery file is edited, not certified" in done.stderr
    told = json.loads((folder / "s.json").read_text())
    assert told["certificate_status"] == "edited"
    assert any("edited, not certified" in w for w in told["warnings"])
    lines = [json.loads(line) for line in (folder / "l.jsonl").read_text().splitlines()]
    assert all(any("edited" in w for w in line["warnings"]) for line in lines)
    page = (folder / "p.html").read_text()
    assert "edited" in page and "Certified: the model" not in page and "passed the gate on" not in page


def test_claims_of_other_content_are_gone_and_its_own_hash_is_told(tampered: Path) -> None:
    read = battery_file.read_battery(tampered, allow_uncertified=True)
    assert (read.certificate.verdicts, read.certificate.validated_ambient_C) == ([], [])
    assert read.certificate.content_sha256 != battery_file.read_battery("lipo-generic").certificate.content_sha256


def test_a_plan_says_it(tampered: Path) -> None:
    call = ("plan", "--battery", tampered, LET, "--power-w", "250", "--cells", "4", "--capacity-ah", "5")
    done = called(*call, "--json", "p.json", "--report", "p.html", folder=tampered.parent)
    assert done.returncode == 0 and "(edited)" in done.stdout and "not certified" in done.stdout
    told = json.loads((tampered.parent / "p.json").read_text())
    assert told["certificate_status"] == "edited" and "edited" in told["warnings"][0]
    assert "edited" in (tampered.parent / "p.html").read_text()


def test_a_fleet_says_it(tampered: Path, short_log: Path) -> None:
    pytest.importorskip("pyarrow", reason="the extra `fleet` is not installed")
    from uavbatt.battery.sizing.pack_size import PackOptions
    from uavbatt.fleet.fly import Job, fly_log
    from uavbatt.fleet.logs import find_logs

    (row,) = fly_log(
        find_logs([str(short_log)])[0],
        Job(battery_file.read_battery(tampered, allow_uncertified=True), PackOptions(4, 2.0)),
    )
    assert row.certificate == "edited" and "edited, not certified" in row.warnings


def test_it_widens_at_least_as_fitted(failed: Path) -> None:
    def spread(status: str, path: Path | str) -> tuple[float, ...]:
        read = battery_file.read_battery(path, allow_uncertified=True)
        as_status = msgspec.structs.replace(read.certificate, status=status)
        pack = pack_of(msgspec.structs.replace(read, certificate=as_status), 3, 5.0, 9.3, 10.5)
        return pack.spread.resistance_scale_sd, pack.spread.capacity_scale_sd, pack.spread.bias_sd_V

    assert battery_file.read_battery(failed, allow_uncertified=True).status == "edited"
    for edited, fitted in zip(spread("edited", failed), spread("fitted", failed), strict=True):
        assert edited >= fitted


def test_what_is_written_from_it_stays_edited(tampered: Path) -> None:
    """Sealing does not wash: a copy with a sound hash is refused all the same."""
    copy = battery_file.write_battery(
        battery_file.read_battery(tampered, allow_uncertified=True), tampered.parent / "copy.battery.toml"
    )
    refused = called("replay", TLOG, "--battery", copy, folder=tampered.parent)
    assert refused.returncode == 1 and "it is edited" in refused.stderr
    assert battery_file.read_battery(copy, allow_uncertified=True).status == "edited"


def test_the_live_page_says_it(tampered: Path) -> None:
    pytest.importorskip("starlette", reason="the extra `web` is not installed")
    vehicle, port = Vehicle(free_port()), free_port()
    vehicle.start()
    arguments = ("--battery", str(tampered), LET, "--capacity-ah", "5", "--http", f"127.0.0.1:{port}")

    def batteries() -> list[dict[str, Any]]:
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/now.json") as answer:
                found: list[dict[str, Any]] = json.load(answer)["batteries"]
                return found
        except OSError:
            return []

    try:
        with running(f"udpin:127.0.0.1:{vehicle.to[1]}", *arguments) as process:
            shown = until(batteries)[0]
    finally:
        vehicle.is_over = True
        vehicle.join(2.0)
    assert shown["certificate"] == "edited" and any("edited" in w for w in shown["warnings"])
    assert process.stderr is not None and "edited, not certified" in process.stderr.read()
