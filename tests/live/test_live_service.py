"""The companion process as a service: watchdog, full disk, limits of the recording, orderly end, its files."""

from __future__ import annotations

import json
import re
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
import urllib.request
from pathlib import Path

import msgspec
import pytest
from daemon_bench import Bench, FakeLink
from live_rig import PATIENCE_S, ROOT, Station, Vehicle, free_port, manager_at, running, until

from uavbatt.live import config
from uavbatt.live.config import Config, LinkSection, RecordSection
from uavbatt.live.feeds.web import serve
from uavbatt.live.recorder import Recorder
from uavbatt.mavlink.endpoint import Chunk
from uavbatt.records import Sample
from uavbatt.simulate.tlog_writer import battery_status, heartbeat

FILE_SIZE = resource.RLIMIT_FSIZE


class StuckLink(FakeLink):
    """Hangs from the moment that `stuck` is set until `freed` is."""

    def __init__(self) -> None:
        super().__init__()
        self.stuck, self.hangs, self.freed = threading.Event(), threading.Event(), threading.Event()

    def read(self, now_s: float) -> list[Chunk]:
        if self.stuck.is_set():
            self.hangs.set()
            self.freed.wait(PATIENCE_S)
        return super().read(now_s)


def test_only_the_loop_feeds_the_watchdog(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A loop that hangs falls silent towards the service manager and the autopilot, though the page still answers."""
    pytest.importorskip("uvicorn")
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    bench, link, port, over = Bench(), StuckLink(), free_port(), threading.Event()
    daemon = bench.daemon
    daemon._clock_s = time.monotonic
    daemon._link = daemon._sender._link = link
    serve(config.HttpSection(listen=f"127.0.0.1:{port}"), lambda: daemon.board, time.monotonic)
    with manager_at(tmp_path / "notify") as told:
        loop = threading.Thread(target=daemon.run, args=(over.is_set,), daemon=True)
        loop.start()
        until(lambda: told.count(b"WATCHDOG=1") >= 2)
        link.stuck.set()
        assert link.hangs.wait(PATIENCE_S)
        fed, beats = told.count(b"WATCHDOG=1"), len(link.sent)
        time.sleep(1.6)
        assert (told.count(b"WATCHDOG=1"), len(link.sent)) == (fed, beats)
        assert urllib.request.urlopen(f"http://127.0.0.1:{port}/now.json", timeout=PATIENCE_S).status == 200
        link.stuck.clear()
        link.freed.set()
        until(lambda: told.count(b"WATCHDOG=1") > fed)
        over.set()
        loop.join(PATIENCE_S)
    assert b"READY=1" in told and b"STOPPING=1" in told


def test_the_unit_file_is_without_fault() -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("no systemd-analyze here")
    unit = ROOT / "scripts/uavbatt.service"
    done = subprocess.run(["systemd-analyze", "verify", str(unit)], capture_output=True, text=True, timeout=PATIENCE_S)
    assert (done.returncode, done.stderr) == (0, "")
    text = unit.read_text()
    for line in ("Type=notify", "WatchdogSec=10", "DynamicUser=yes", "StateDirectory=uavbatt", "Restart=on-failure"):
        assert line in text.splitlines()


@pytest.mark.slow  # a disk that fills up, below, is its witness
def test_a_disk_that_is_full_stops_recording_and_state_but_not_the_estimate(vehicle: Vehicle, tmp_path: Path) -> None:
    """No file of this process may grow beyond 2 kB: the ground station goes on seeing the time, the page says why."""
    station, port = Station(), free_port()
    arguments = [f"udpin:127.0.0.1:{vehicle.to[1]}", "--gcs", f"udpout:127.0.0.1:{station.port}", "--capacity-ah", "5"]
    arguments += ["--record", str(tmp_path / "r"), "--state", str(tmp_path / "state.json")]
    arguments += ["--http", f"127.0.0.1:{port}"]
    limits = (2000, resource.getrlimit(resource.RLIMIT_FSIZE)[1])
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    with running(*arguments, PYTHONDONTWRITEBYTECODE="1") as process:
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, limits)

        def notes() -> str:
            try:
                with urllib.request.urlopen(f"http://127.0.0.1:{port}/now.json") as answer:
                    return " ".join(json.load(answer)["notes"])
            except OSError:
                return ""

        until(lambda: "not recording: File too large" in notes() and "state not saved" in notes())
        station.until(lambda m: m.get_type() == "NAMED_VALUE_FLOAT" and m.name == "REM_S" and m.value > 60)
        process.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE_S) == 0
    assert resource.getrlimit(resource.RLIMIT_FSIZE) == before
    assert not list(tmp_path.glob("*.part"))  # what could not be written whole is not left behind


def test_a_disk_that_is_full_is_said_once_in_the_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What is held cannot be written either when the file is closed, and each of two tries fails so."""
    recorder, before = Recorder(RecordSection(folder=str(tmp_path), min_free_MB=0.0)), resource.getrlimit(FILE_SIZE)
    resource.setrlimit(FILE_SIZE, (2000, before[1]))
    try:
        for k in range(400):
            recorder.frame(b"x" * 50, 1_700_000_000_000_000 + k * 100_000, 0.1 * k, 0.1 * k, True)
            recorder.flush(0.1 * k)
    finally:
        resource.setrlimit(FILE_SIZE, before)
    assert len(list(tmp_path.glob("*.tlog"))) == 2
    assert recorder.problem == "not recording: File too large"
    assert capsys.readouterr().err == "uavbatt: recording stopped: File too large; tried again every 30 s\n"


def test_sigterm_writes_out_what_is_held_and_the_replay_gives_the_same_lines(vehicle: Vehicle, tmp_path: Path) -> None:
    """Replayed with the options of the flight, by the command, the recording gives its own JSON Lines."""
    station = Station()
    arguments = [f"udpin:127.0.0.1:{vehicle.to[1]}", "--gcs", f"udpout:127.0.0.1:{station.port}", "--capacity-ah", "5"]
    with running(*arguments, "--record", str(tmp_path), "--state", str(tmp_path / "s.json")) as process:
        station.until(lambda m: m.get_type() == "NAMED_VALUE_FLOAT" and m.name == "REM_S" and m.value > 60)
        time.sleep(2.5)  # three forecasts or more
        process.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE_S) == 0
    (log,), (lines,) = tmp_path.glob("*.tlog"), tmp_path.glob("*.battery0.jsonl")
    out = tmp_path / "again.jsonl"
    command = [sys.executable, "-c", "from uavbatt.cli import main; main()", "replay", str(log)]
    done = subprocess.run([*command, "--capacity-ah", "5", "--jsonl", str(out)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    said = [json.loads(text) for text in lines.read_text().splitlines()]
    assert len(said) >= 15 and [json.loads(text) for text in out.read_text().splitlines()] == said
    assert json.loads((tmp_path / "s.json").read_text())["batteries"]["0"]["consumed_Ah"] > 0.0


def test_while_armed_records_from_arming_to_disarming(tmp_path: Path) -> None:
    bench = Bench(record=RecordSection(folder=str(tmp_path), when="while-armed", min_free_MB=0.0))
    for armed in (False, True, False, True, False):
        bench.now_s += 130.0 if armed else 0.0  # between two flights
        for _ in range(20):
            bench.send(heartbeat(armed))
            bench.send(battery_status(Sample(0.0, 16.0, 12.0 if armed else 0.2, 25.0, 0.1), 0))
            bench.daemon.turn()
            bench.now_s += 0.2
    bench.daemon.close()
    logs, lines = sorted(tmp_path.glob("*.tlog")), sorted(tmp_path.glob("*.jsonl"))
    assert len(logs) == 2 and len(lines) == 2
    assert [len(path.read_text().splitlines()) for path in lines] == [21, 21]  # two heartbeats disarm


def test_recordings_keep_to_their_limits_of_size_and_number(tmp_path: Path) -> None:
    limits = RecordSection(folder=str(tmp_path), max_file_MB=0.005, max_files=3, min_free_MB=0.0)
    bench = Bench(record=limits)
    (tmp_path / "mine.tlog").write_bytes(b"not ours")
    bench.fly(120.0)
    bench.daemon.close()
    logs = sorted(tmp_path.glob("uavbatt-*.tlog"), key=lambda p: p.stat().st_mtime_ns)
    assert len(logs) == 3 and all(log.stat().st_size < 10_000 for log in logs)
    assert {p.name.split(".")[0] for p in tmp_path.glob("*.jsonl")} <= {log.stem for log in logs}
    assert (tmp_path / "mine.tlog").exists()
    from uavbatt.telemetry import read_log

    assert all(read_log(log).samples for log in logs)  # each can be replayed on its own


def test_a_disk_that_fills_up_ends_the_recording_until_there_is_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench, free = Bench(record=RecordSection(folder=str(tmp_path), min_free_MB=100.0)), [200.0]
    assert bench.daemon._recorder is not None
    monkeypatch.setattr(type(bench.daemon._recorder), "_free_MB", lambda self: free[0])
    bench.fly(10.0)
    assert bench.daemon.board.notes == ()
    free[0] = 50.0
    bench.fly(10.0)
    assert "not recording: less than 100 MB free" in bench.daemon.board.notes[0]
    free[0] = 200.0
    bench.fly(40.0)
    assert bench.daemon.board.notes == () and len(list(tmp_path.glob("*.tlog"))) == 2


def test_every_key_stands_in_the_sample_with_its_default() -> None:
    sample = ROOT / "scripts/uavbatt.toml"
    stated = config.read_config(sample)
    assert stated == Config(link=LinkSection(endpoint="udpin:127.0.0.1:14551"))
    shown = {
        section: set(re.findall(r"^#?(\w+) = ", text, re.M))
        for section, text in re.findall(r"^\[(\w+)\]\n(.*?)(?=^\[|\Z)", sample.read_text(), re.M | re.S)
    }
    known = {f.name: {k.name for k in msgspec.structs.fields(f.type)} for f in msgspec.structs.fields(Config)}
    assert shown == known


def test_options_go_before_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import typer.testing

    from uavbatt.cli import app, live

    become: list[Config] = []
    monkeypatch.setattr(live, "_exec_live", become.append)
    path = tmp_path / "u.toml"
    path.write_text('[link]\nendpoint = "tcp:a:1"\ngcs = ["udpout:b:2"]\n[pack]\ncells = 6\ncapacity_Ah = 9.0\n')
    monkeypatch.setenv("UAVBATT_CONFIG", str(path))
    run = typer.testing.CliRunner().invoke
    assert run(app.app, ["live"]).exit_code == 0
    assert run(app.app, ["live", "udpin:c:3", "--cells", "4", "--feed", "battery", "--record", "d"]).exit_code == 0
    first, second = become
    assert (first.link.endpoint, first.pack.cells, first.pack.capacity_Ah) == ("tcp:a:1", 6, 9.0)
    assert first.feed.kinds == ("named",)
    assert (second.link.endpoint, second.link.gcs, second.pack.cells) == ("udpin:c:3", ["udpout:b:2"], 4)
    assert (second.pack.capacity_Ah, list(second.feed.kinds), second.record.folder) == (9.0, ["battery"], "d")


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("[link]\nendpiont = 'x'\n", "endpiont"), ("[link]\nrequest_rate_Hz = 0\n", "link.request_rate_Hz"),
        ("[pack]\ncells = 'four'\n", "pack.cells"), ("[feed]\nkinds = ['radio']\n", "feed.kinds"),
        ("[record]\nwhen = 'sometimes'\n", "record.when"),
        ("[pack]\nforecast_period_s = 0\n", "pack.forecast_period_s"), ("[state]\nperiod_s = -1\n", "state.period_s"),
        ("[record]\nmax_file_MB = inf\n", "record.max_file_MB"), ("[wings]\n", "wings"), ("[link\n", "TOML"),
    ],
)  # fmt: skip
def test_an_error_names_the_key_and_the_file(tmp_path: Path, text: str, key: str) -> None:
    path = tmp_path / "my.toml"
    path.write_text(text)
    with pytest.raises(config.BadInput) as error:
        config.read_config(path)
    assert key in str(error.value) and "my.toml" in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[pack]\ncapacity_ah = 5\n", "key pack.capacity_ah: expected a known key, did you mean capacity_Ah?"),
        ("capacity_Ah = 5\n", "key capacity_Ah: expected one of link, pack, packs, feed, http, record, state"),
        ("[pack]\ncapacity_Ah = 5000\n", "key pack.capacity_Ah: expected `float` <= 500.0"),
    ],
)
def test_an_unknown_key_is_told_the_nearest(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "my.toml").write_text(text)
    with pytest.raises(config.BadInput) as error:
        config.read_config(tmp_path / "my.toml")
    assert said in str(error.value)


def test_the_address_of_the_page_is_one_that_a_browser_takes() -> None:
    shown = [config.page_address(text) for text in ("8080", ":8080", "127.0.0.1:8080", "[::1]:8080")]
    assert shown == [*3 * ["http://127.0.0.1:8080/"], "http://[::1]:8080/"]
