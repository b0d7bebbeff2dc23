"""F2, F12: several autopilots on one port, several senders of one identity: who is followed, and who is believed."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from daemon_bench import OPTIONS, Bench, FakeLink
from live_rig import Station, free_port, running, until
from pymavlink.dialects.v20 import ardupilotmega as dialect
from test_live_faults import GROUND_ROWS, SELDOM, flight, true_soc

from uavbatt.battery import battery_file
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.live.config import Config, LinkSection, RecordSection, StateSection
from uavbatt.live.daemon import Daemon
from uavbatt.live.feeds import proxy
from uavbatt.live.feeds.proxy_client import ProxyClient
from uavbatt.live.feeds.web import content
from uavbatt.mavlink.links import open_link
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.records import Sample
from uavbatt.simulate.tlog_writer import battery_status, heartbeat
from uavbatt.telemetry import read_log


def capacity(mAh: float) -> Any:
    return dialect.MAVLink_param_value_message(b"BATT_CAPACITY", mAh, 9, 1, 0)


def row(volts: float, amps: float = 12.0, drawn_Ah: float = 0.1) -> Any:
    return battery_status(Sample(0.0, volts, amps, 25.0, drawn_Ah, armed=True), 0)


def fly(
    bench: Bench, seconds: float, system: int = 1, volts: float = 16.0, sender: object = "fc", armed: bool = True
) -> None:
    for k in range(int(seconds * 5)):
        if k % 5 == 0:
            bench.send(heartbeat(armed), system=system, sender=sender)
        bench.send(row(volts, drawn_Ah=12.0 * bench.now_s / 3600.0 - 3.0), system=system, sender=sender)
        bench.daemon.turn()
        bench.now_s += 0.2


@pytest.mark.parametrize("word", ["heartbeat", "one battery message", "parameter"])
def test_wrong_vehicle_first(word: str) -> None:
    """Three frames of system 42 before the real autopilot, then sound telemetry of system 1."""
    bench = Bench()
    said = {"heartbeat": heartbeat(False), "one battery message": row(24.0), "parameter": capacity(22000)}[word]
    for _ in range(1 if word == "one battery message" else 3):
        bench.send(said, system=42, sender="other")
        bench.daemon.turn()
        bench.now_s += 1.0
    bench.send(capacity(5000))
    fly(bench, 20.0)
    (report,) = bench.daemon.board.reports
    assert report.system == 1 and report.at(bench.now_s).remaining_s > 0.0
    assert "heard systems 42, 1; following 1" in bench.daemon.board.notes
    assert bench.daemon._reader.parameters["BATT_CAPACITY"] == 5000.0
    assert {m.get_srcSystem() for m in bench.to_gcs() if m.get_type() == "NAMED_VALUE_FLOAT"} == {1}


@pytest.mark.slow  # the same without a process is its witness
def test_wrong_vehicle_first_through_the_process() -> None:
    port, station = free_port(), Station()
    line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    arguments = [f"udpin:127.0.0.1:{port}", "--gcs", f"udpout:127.0.0.1:{station.port}", "--capacity-ah", "5"]
    with running(*arguments) as process:
        link: Any = dialect.MAVLink(None, srcSystem=42, srcComponent=1)
        assert process.stderr is not None and "waiting for telemetry" in process.stderr.readline()
        for system in (42, 42, 42, *[1] * 70):  # longer than the load takes to show itself
            link.srcSystem = system
            line.sendto(bytes(heartbeat(True).pack(link)), ("127.0.0.1", port))
            if system == 1:
                line.sendto(bytes(row(16.0).pack(link)), ("127.0.0.1", port))
            time.sleep(0.1)
        said = station.until(lambda m: m.get_type() == "NAMED_VALUE_FLOAT" and m.name == "REM_S" and m.value > 60)
        assert said.get_srcSystem() == 1
        process.terminate()
        assert "uavbatt: heard systems 42, 1; following 1\n" in process.stderr.readlines()


def test_a_vehicle_that_speaks_is_not_let_go_while_it_is_heard(tmp_path: Path) -> None:
    """Another's telemetry beside ours, and ours without a battery message for a minute: it is still ours."""
    bench = Bench()
    fly(bench, 5.0)
    for _ in range(60):
        bench.send(heartbeat(True))
        bench.send(row(22.0), system=42, sender="other")
        bench.send(row(22.0), system=42, sender="other")
        bench.daemon.turn()
        bench.now_s += 1.0
    (report,) = bench.daemon.board.reports
    assert (report.system, report.at(bench.now_s).status) == (1, "stale")
    fly(bench, 5.0)
    assert bench.daemon.board.reports[0].estimate.voltage_V == pytest.approx(16.0)


def test_a_silent_vehicle_gives_way_to_one_that_speaks(tmp_path: Path) -> None:
    """Nothing of the first is left with the second: pack, trend, alarms, recording, the system of our own frames."""
    state = StateSection(file=str(tmp_path / "state.json"))
    bench = Bench(PackOptions(), record=RecordSection(folder=str(tmp_path), min_free_MB=0.0), state=state)
    bench.send(capacity(5000))
    fly(bench, 20.0)
    fly(bench, 2.0, armed=False)
    bench.now_s += 11.0
    bench.send(heartbeat(True), system=42, sender="other")
    bench.send(capacity(9000), system=42, sender="other")
    fly(bench, 1.0, system=42, volts=15.9, sender="other")
    bench.station.sent.clear()
    fly(bench, 19.0, system=42, volts=15.9, sender="other")
    (report,) = bench.daemon.board.reports
    resolved = bench.daemon.batteries.tracked[0].estimator.pack_size
    assert report.system == 42 and resolved is not None and resolved.capacity_Ah == 9.0
    assert "heard systems 1, 42; following 42" in bench.daemon.board.notes
    assert {m.get_srcSystem() for m in bench.to_gcs()} == {42}
    oldest_s = bench.daemon.board.trend.lines(bench.now_s)[0][0][0]
    assert oldest_s is not None and oldest_s < 21.0
    fly(bench, 5.0)  # the first is back: it was on the ground, and the second is not silent
    assert bench.daemon.board.reports[0].system == 42
    bench.daemon.close()
    logs = sorted(tmp_path.glob("*.tlog"))
    assert [read_log(log).identity.system for log in logs] == [1, 42]
    assert read_log(logs[1]).facts[0][1].capacity_Ah == 9.0
    assert json.loads(Path(state.file).read_text())["parameters"]["BATT_CAPACITY"] == 9000.0


def other_flies(bench: Bench, seconds: float, first: bool | None = None) -> None:
    """Vehicle 42 flies beside the first one, which is silent, or armed or not."""
    for _ in range(int(seconds)):
        if first is not None:
            bench.send(heartbeat(first))
            bench.send(row(15.8, drawn_Ah=12.0 * bench.now_s / 3600.0 - 3.0))
        bench.send(heartbeat(True), system=42, sender="other")
        bench.send(row(16.4), system=42, sender="other")
        bench.daemon.turn()
        bench.now_s += 1.0


def test_a_vehicle_that_fell_silent_in_the_air_is_followed_again() -> None:
    """Its estimate goes on with its next row; both changes are said, to those who look at either vehicle."""
    bench = Bench()
    other_flies(bench, 60.0, first=True)
    rows = bench.daemon.board.reports[0].rows
    other_flies(bench, 12.0)
    assert bench.daemon.board.reports[0].system == 42
    assert "system 1 fell silent in the air: followed again when it speaks" in bench.daemon.board.notes
    other_flies(bench, 1.0, first=True)
    (report,) = bench.daemon.board.reports
    assert (report.system, report.rows) == (1, rows + 1) and report.at(bench.now_s).remaining_s > 0.0
    assert bench.daemon.board.notes == ("heard systems 1, 42; following 1",)
    bench.station.sent, sent = [], bench.to_gcs()
    said = [(m.get_srcSystem(), m.text) for m in sent if m.get_type() == "STATUSTEXT" and "System" in m.text]
    assert said == [
        (1, "System 1 is silent: following system 42"),
        (42, "System 1 is silent: following system 42"),
        (42, "System 1 is heard again and followed"),
        (1, "System 1 is heard again and followed"),
    ]
    assert [text for _, text in bench.daemon.board.announcements][-1] == "System 1 is heard again and followed"
    last = {m.name: m.value for m in sent if m.get_type() == "NAMED_VALUE_FLOAT" and m.get_srcSystem() == 42}
    assert last["REM_S"] != last["REM_S"]  # nobody fills it any more
    other_flies(bench, 30.0, first=True)
    assert bench.daemon.board.reports[0].rows == rows + 31


def test_a_vehicle_that_fell_silent_is_awaited_for_an_hour() -> None:
    bench = Bench()
    other_flies(bench, 20.0, first=True)
    other_flies(bench, 15.0)
    bench.now_s += 3700.0
    other_flies(bench, 5.0)
    other_flies(bench, 3.0, first=True)
    assert bench.daemon.board.reports[0].system == 42


def test_a_vehicle_that_landed_in_silence_is_not_followed_again() -> None:
    bench = Bench()
    other_flies(bench, 20.0, first=True)
    other_flies(bench, 60.0)
    other_flies(bench, 20.0, first=False)
    assert bench.daemon.board.reports[0].system == 42
    assert bench.daemon.board.notes == ("heard systems 1, 42; following 42",)


def test_the_system_that_is_asked_for_is_waited_for() -> None:
    bench = Bench(link=LinkSection(endpoint="x", gcs=["y"], system=7))
    fly(bench, 3.0)
    assert bench.daemon.board.reports == ()
    assert bench.daemon.board.notes == ("heard system 1; waiting for system 7",)
    fly(bench, 3.0, system=7)
    assert [r.system for r in bench.daemon.board.reports] == [7]
    bench.now_s += 60.0
    fly(bench, 3.0)
    assert bench.daemon.board.reports[0].system == 7


def test_an_autopilot_that_sends_no_battery_is_asked_for_it() -> None:
    bench = Bench(link=LinkSection(endpoint="x", gcs=["y"], request=True))
    for _ in range(3):
        bench.send(heartbeat(False), system=5)
        bench.daemon.turn()
        bench.now_s += 1.0
    asked = bench.link.messages
    assert {m.target_system for m in asked if m.get_type() == "COMMAND_LONG"} == {5}


def test_every_system_on_one_port_takes_no_memory_for_ever() -> None:
    bench = Bench()
    fly(bench, 2.0)
    for system in range(2, 255):
        bench.send(heartbeat(True), system=system, sender="many")
        bench.send(row(16.0), system=system, sender="many")
    bench.daemon.turn()
    fly(bench, 2.0)
    assert len(bench.daemon._reader._vehicles) <= 16 and bench.daemon.board.reports[0].system == 1


class Source:
    """One socket of its own that speaks as system 1 component 1."""

    def __init__(self, port: int) -> None:
        self._line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._line.bind(("127.0.0.1", 0))
        self._to = ("127.0.0.1", port)
        self._link: Any = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
        self.name = f"127.0.0.1:{self._line.getsockname()[1]}"

    def count_from(self, number: int) -> None:
        """Go on with this running number of frames, as another autopilot behind the same address would."""
        self._link.seq = number % 256

    def send(self, *messages: Any) -> None:
        for message in messages:
            self._line.sendto(bytes(message.pack(self._link)), self._to)
            self._link.seq = (self._link.seq + 1) % 256


@contextmanager
def two_sources() -> Iterator[tuple[Daemon, list[float], Source, Source, FakeLink]]:
    """A daemon on a real socket with a clock of the test, two who send to it, and the ground station."""
    port, station, now_s = free_port(), FakeLink(), [1000.0]
    settings = Config(link=LinkSection(endpoint="x", gcs=["y"]))
    link = open_link(f"udpin:127.0.0.1:{port}")
    daemon = Daemon(
        settings,
        battery_file.read_battery("lipo-generic"),
        OPTIONS,
        ForecastSettings(),
        link,
        [station],
        clock_s=lambda: now_s[0],
    )
    yield daemon, now_s, Source(port), Source(port), station
    daemon.close()


def taken(daemon: Daemon, frames: int) -> None:
    """Turn until that many more frames were found."""
    wanted = daemon.board.counts.get("frames", 0) + frames
    until(lambda: (daemon.turn(), daemon.board.counts["frames"] >= wanted)[1])


@pytest.mark.parametrize("what", ["voltage", "current", "charge drawn"])
def test_two_sources_of_one_battery_that_disagree_are_refused(what: str) -> None:
    forged = {"voltage": row(16.4), "current": row(15.8, 3.0), "charge drawn": row(15.8, 12.0, 0.5)}[what]
    with two_sources() as (daemon, now_s, true, false, station):
        for k in range(150):
            true.send(heartbeat(True), row(15.8))
            is_forged = 50 <= k < 100
            if is_forged:
                false.send(heartbeat(True), forged)
            taken(daemon, 4 if is_forged else 2)
            shown = daemon.board.reports[0].at(now_s[0]) if daemon.board.reports else None
            if k in (49, 149):
                assert shown is not None and shown.remaining_s > 0.0, k
            if 60 < k < 100:
                assert shown is not None and shown.status == "refused" and shown.remaining_s != shown.remaining_s, k
            if k == 99:
                now = content(daemon.board, now_s[0])
                assert f"disagree on battery 0: {what}" in now["notes"][0]
                assert true.name in now["notes"][0] and false.name in now["notes"][0]
                assert (now["batteries"][0]["soc"], now["batteries"][0]["remaining_s"]) == (None, None)
            now_s[0] += 0.25
        assert daemon.board.counts["rows"] == 150  # the second sender's are not taken in
        texts = station.messages
        said = [m.text for m in texts if m.get_type() == "STATUSTEXT"]
        assert said == ["Battery 0: time unknown, two senders disagree"]


@pytest.mark.parametrize("gap_s", [0.25, 1.0, 3.0])
def test_a_stream_that_goes_on_from_another_port_is_the_same_aircraft(gap_s: float) -> None:
    """A new NAT binding, a TCP link opened anew: at 60 A the pack is another by then, and nobody disagrees."""
    with two_sources() as (daemon, now_s, before, after, station):
        for k in range(160):
            source, at_s = (before, k / 4.0) if k < 80 else (after, k / 4.0 + gap_s)
            now_s[0] = 1000.0 + at_s
            source.send(heartbeat(True), row(16.0 - 0.01 * at_s, 30.0 if k < 80 else 24.0, 0.02 * at_s))
            taken(daemon, 2)
            if k >= 100:  # the first is believed until it has been silent for two seconds
                assert daemon.board.reports[0].at(now_s[0]).remaining_s > 0.0, k
            assert daemon.board.notes == (), k
        said = station.messages
        assert not [m.text for m in said if m.get_type() == "STATUSTEXT" and "two senders" in m.text]


@pytest.mark.parametrize("same", [False, True])
def test_two_vehicles_of_one_number_behind_one_address_are_told_apart(same: bool) -> None:
    """A router or a radio passes both on: each counts its own frames. One autopilot on two ways agrees with itself."""
    with two_sources() as (daemon, now_s, source, _, _):
        counts = {"first": 0, "second": 100}
        for k in range(100):
            for who in ("first", "second") if k >= 20 else ("first",):
                volts = 15.8 if same or who == "first" else 15.2
                source.count_from(counts[who])
                source.send(heartbeat(True), row(volts))
                counts[who] += 2
            taken(daemon, 4 if k >= 20 else 2)
            if k == 19 or (same and k > 19):
                assert daemon.board.reports[0].at(now_s[0]).remaining_s > 0.0, k
            now_s[0] += 0.25
        if same:
            assert daemon.board.counts["rows"] == 20 + 2 * 80  # both links' rows count
        else:
            assert daemon.board.reports[0].at(now_s[0]).status == "refused"
            note = content(daemon.board, now_s[0])["notes"][0]
            assert f"disagree on battery 0: voltage (both behind {source.name})" in note


def test_one_autopilot_on_two_ways_is_one() -> None:
    """The same rows by two addresses; when the first falls silent the second goes on, with the same estimate."""
    with two_sources() as (daemon, now_s, first, second, _):
        for k in range(100):
            words = heartbeat(True), row(16.0 - 0.3 * (k % 3), 12.0 + 10.0 * (k % 3), 0.001 * k)
            senders = [first, second] if k < 50 else [second]
            for sender in senders:
                sender.send(*words)
            taken(daemon, 2 * len(senders))
            now_s[0] += 0.25
        assert daemon.board.notes == () and daemon.board.counts["rows"] >= 90
        assert daemon.board.reports[0].at(now_s[0]).remaining_s > 0.0
        assert daemon.board.reports[0].rows == daemon.board.counts["rows"]  # never begun anew


def test_the_proxy_tells_the_estimator_who_sends(tmp_path: Path) -> None:
    port = free_port()
    settings = proxy.ProxySettings(f"udpin:127.0.0.1:{port}", [], str(tmp_path / "control"))
    served, client, sources = proxy.Proxy(settings), ProxyClient(settings), (Source(port), Source(port))
    heard: list[object] = []

    def turn() -> int:
        served.turn(0.0)
        heard.extend(sender for _, sender in client.read(0.0))
        return len(heard)

    until(lambda: (turn(), client.pid)[1])
    for source in 2 * sources:
        before = len(heard)
        source.send(row(16.0))
        while turn() == before:
            time.sleep(0.01)
    client.close()
    served.close()
    assert heard == [source.name for source in sources] * 2


def test_a_sender_without_a_battery_does_not_shut_out_the_one_that_has_it() -> None:
    bench = Bench()
    for _ in range(20):
        bench.send(heartbeat(True), sender="first, mute")
        bench.send(row(16.0), sender="second")
        bench.daemon.turn()
        bench.now_s += 0.5
    assert bench.daemon.board.counts["rows"] == 20


def test_silence30h_pack_45(tmp_path: Path) -> None:
    """F4: landed, silent for 30 h, then a pack at 45 %: neither live's clock leaps, nor its recording's."""
    bench = Bench(OPTIONS, settings=SELDOM, record=RecordSection(folder=str(tmp_path), min_free_MB=0.0))
    bench.play(flight()[: GROUND_ROWS + 120])
    bench.now_s += 30.0 * 3600.0
    another = flight(0.45, seed=5)[: GROUND_ROWS + 60]
    bench.play(another)
    report = bench.daemon.board.reports[0]
    assert report.estimate.time_s > 30.0 * 3600.0
    assert report.estimate.soc == pytest.approx(true_soc(another, 0.45), abs=0.04)
    bench.daemon.close()
    (log,) = tmp_path.glob("*.tlog")
    assert read_log(log).samples[-1].time_s == pytest.approx(report.estimate.time_s, abs=1e-4)
