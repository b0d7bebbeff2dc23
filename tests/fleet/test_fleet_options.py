"""What a fleet shares with a replay: vehicle file, load to come, instance, join; with others all is flown again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from command import called
from frames import hover, write_log

pytest.importorskip("pyarrow", reason="the extra `fleet` is not installed")

from uavbatt.battery import battery_file
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.battery.vehicle_file import Phases, Trace, VehicleFile
from uavbatt.fleet.fly import Job, fly_log
from uavbatt.fleet.journal import job_key
from uavbatt.fleet.logs import LogFile, find_logs
from uavbatt.fleet.row import FlightRow

PLAIN = Job(battery_file.read_battery("lipo-generic"), PackOptions(capacity_Ah=5.0))
VEHICLE = VehicleFile(
    name="q",
    battery="lipo-generic",
    source="a test",
    phases=Phases(take_off_W=300.0, flight_W=300.0, last_minute_W=300.0),
    traces=[Trace(time_s=[0.0, 300.0], power_W=[300.0, 300.0], soc=[1.0, 0.6])],
)


@pytest.fixture(scope="module")
def two_batteries(tmp_path_factory: pytest.TempPathFactory) -> LogFile:
    """One aircraft with two packs in parallel, of which the second gives more."""
    path = tmp_path_factory.mktemp("two") / "two.tlog"
    write_log(path, [*hover(60, 16.7, 8.0, 0), *hover(60, 16.7, 12.0, 1)])
    return find_logs([str(path)])[0]


def flown(log: LogFile, **changes: object) -> FlightRow:
    (row,) = fly_log(log, replace(PLAIN, **changes))  # type: ignore[arg-type]
    assert row.status == "ok", row.reason
    return row


def test_the_battery_that_is_asked_for_is_flown(two_batteries: LogFile) -> None:
    first, second = flown(two_batteries), flown(two_batteries, instance=1)
    assert (first.instance, second.instance) == (0, 1)
    assert second.charge_Ah == pytest.approx(1.5 * first.charge_Ah, rel=0.03)
    assert "no battery instance 7" in fly_log(two_batteries, replace(PLAIN, instance=7))[0].reason


def test_batteries_are_joined_as_they_are_wired(two_batteries: LogFile) -> None:
    parts, whole = flown(two_batteries), flown(two_batteries, join="parallel")
    assert whole.charge_Ah == pytest.approx(2.5 * parts.charge_Ah, rel=0.03)
    assert flown(two_batteries, join="series").cells == 2 * (parts.cells or 0)


def test_a_statement_that_the_log_contradicts_is_the_reason_in_its_row(two_batteries: LogFile) -> None:
    """It was "expected at least one row with the voltage of a pack", of a log full of them."""
    (row,) = fly_log(two_batteries, replace(PLAIN, options=PackOptions(capacity_Ah=5.0, cells=3)))
    assert row.status == "bad" and row.reason.startswith("--cells: 3 cells in series: 16.7 V is 5.57 V a cell")


def test_a_vehicle_file_or_a_stated_load_is_what_is_expected_to_come(shared_fleet: tuple[LogFile, float]) -> None:
    log, end_s = shared_fleet
    known = flown(log, load="log")
    assert known.end_of_flight_s == pytest.approx(end_s, abs=0.5)
    hard, gentle = flown(log, load="900"), flown(log, load="300")
    assert hard.error_half_s < gentle.error_half_s
    assert flown(log, vehicle=VEHICLE).error_half_s != flown(log).error_half_s


@pytest.fixture(scope="module")
def shared_fleet(short_log: Path) -> tuple[LogFile, float]:
    """A flight to its end."""
    log = find_logs([str(short_log)])[0]
    return log, flown(log).end_of_flight_s


@pytest.mark.parametrize(
    "other",
    [
        {"load": "recent"},
        {"vehicle": VEHICLE},
        {"instance": 1},
        {"join": "parallel"},
        {"options": PackOptions(capacity_Ah=5.2)},
    ],
    ids=lambda other: next(iter(other)),
)
def test_with_other_options_every_flight_is_flown_again(other: dict[str, object]) -> None:
    assert job_key(replace(PLAIN, **other)) != job_key(PLAIN)  # type: ignore[arg-type]
    assert job_key(replace(PLAIN, **other)) == job_key(replace(PLAIN, **other))  # type: ignore[arg-type]


def test_another_vehicle_file_of_the_same_name_is_another(tmp_path: Path) -> None:
    trace = Trace(time_s=[0.0, 300.0], power_W=[350.0, 350.0], soc=[1.0, 0.6])
    again = VehicleFile(name="q", battery="lipo-generic", source="a test", phases=VEHICLE.phases, traces=[trace])
    assert job_key(replace(PLAIN, vehicle=again)) != job_key(replace(PLAIN, vehicle=VEHICLE))


def test_the_command_resumes_and_flies_again_what_is_asked_otherwise(tmp_path: Path) -> None:
    write_log(tmp_path / "a.tlog", hover(40, 16.7, 12.0))
    call = ("fleet", "a.tlog", "-o", "out", "--capacity-ah", "5", "--workers", "1")
    first, again = called(*call, folder=tmp_path), called(*call, folder=tmp_path)
    assert "(1 done now)" in first.stdout and "(0 done now)" in again.stdout, first.stderr + again.stderr
    assert "(1 done now)" in called(*call, "--load", "400", folder=tmp_path).stdout


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--load", "fast"), "--load fast: expected learned, recent, log or a positive number of watts"),
        (("--join", "around"), "--join around: expected parallel or series"),
        (("--join", "series", "--instance", "1"), "expected one of the two"),
        (("--vehicle", "no.vehicle.toml"), "no.vehicle.toml"),
        (("--workers", "100000"), "--workers 100000: expected at most"),
    ],
)
def test_wrong_options_are_named_before_anything_is_flown(tmp_path: Path, words: tuple[str, ...], said: str) -> None:
    write_log(tmp_path / "a.tlog", hover(20, 16.7, 12.0))
    done = called("fleet", "a.tlog", "-o", "out", *words, folder=tmp_path)
    assert done.returncode in (1, 2) and said in done.stderr and done.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()
