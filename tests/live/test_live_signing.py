"""F12, F13: signatures of received frames: who holds the key is heard, and what is rejected is said."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from daemon_bench import Bench

from uavbatt.live.config import FeedSection, LinkSection
from uavbatt.live.feeds.web import content
from uavbatt.records import Sample
from uavbatt.simulate.tlog_writer import battery_status, heartbeat

KEY, OTHER_KEY = bytes(range(32)), bytes(range(1, 33))


def row(volts: float) -> Any:
    return battery_status(Sample(0.0, volts, 12.0, 25.0, 0.1, armed=True), 0)


def fly(bench: Bench, seconds: float, volts: float = 16.0) -> None:
    for k in range(round(seconds * 5)):
        if k % 5 == 0:
            bench.send(heartbeat(True))
        bench.send(row(volts))
        bench.daemon.turn()
        bench.now_s += 0.2


def signed_by(bench: Bench, key: bytes | None) -> None:
    bench._out.signing.secret_key, bench._out.signing.sign_outgoing = key, key is not None


@pytest.fixture
def keyed(tmp_path: Path) -> Bench:
    path = tmp_path / "key"
    path.write_text(KEY.hex() + "\n")
    return Bench(link=LinkSection(endpoint="x", gcs=["y"], signing_key_file=str(path)))


def test_a_forger_without_the_key_is_not_heard(keyed: Bench) -> None:
    """Same system, component and address, unsigned, wrongly signed and recorded frames: the vehicle's number stands."""
    signed_by(keyed, KEY)
    fly(keyed, 10.0)
    recorded = keyed.framed(row(16.4))
    keyed.link.incoming.append((recorded, "fc"))
    keyed.daemon.turn()
    rows = keyed.daemon.board.counts["rows"]
    for _ in range(10):
        signed_by(keyed, None)
        keyed.send(row(16.4))
        signed_by(keyed, OTHER_KEY)
        keyed.send(row(16.4))
        keyed.link.incoming.append((recorded, "fc"))
        signed_by(keyed, KEY)
        fly(keyed, 0.2, volts=15.8)
    assert keyed.daemon.board.counts["rows"] == rows + 10
    assert keyed.daemon.board.counts["rejected_signatures"] == 30
    assert set(keyed.daemon.board.notes) == {
        "10 frames of system 1 with a wrong signature rejected",
        "10 frames of system 1 without a signature rejected",
        "10 frames of system 1 sent again or late rejected",
    }


def test_a_vehicle_that_does_not_sign_is_heard_and_that_is_said(keyed: Bench) -> None:
    fly(keyed, 10.0)
    assert keyed.daemon.board.reports[0].at(keyed.now_s).remaining_s > 0.0
    assert keyed.daemon.board.notes == ("system 1 does not sign its frames: whoever is on the link can speak for it",)


def test_a_wrong_key_is_said_and_not_silence_without_a_reason(keyed: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    signed_by(keyed, OTHER_KEY)
    fly(keyed, 10.0)
    now = content(keyed.daemon.board, keyed.now_s)
    assert now["batteries"] == [] and "no frame fits the key: is link.signing_key_file the vehicle's?" in now["notes"]
    assert capsys.readouterr().err.count("with a wrong signature rejected") == 1


def test_a_stream_that_begins_more_than_a_minute_behind_is_late(keyed: Bench) -> None:
    signed_by(keyed, KEY)
    keyed._out.signing.timestamp = 10**12
    fly(keyed, 2.0)
    keyed._out.signing.link_id, keyed._out.signing.timestamp = 7, 10**12 - 61 * 100_000
    rows = keyed.daemon.board.counts["rows"]
    keyed.send(row(16.0))
    keyed.daemon.turn()
    assert keyed.daemon.board.counts["rows"] == rows
    keyed._out.signing.timestamp = 10**12 - 50 * 100_000
    keyed.send(row(16.0))
    keyed.daemon.turn()
    assert keyed.daemon.board.counts["rows"] == rows + 1


def test_a_signed_stream_behind_the_proxy_feed_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    link = LinkSection(endpoint="x", gcs=["y"])
    bench = Bench(link=link, feed=FeedSection(kinds=("proxy",)))
    fly(bench, 2.0)
    assert bench.daemon.board.notes == ()
    signed_by(bench, KEY)
    fly(bench, 4.0)
    note = "the autopilot signs its frames: the proxy passes them as they are, without our time"
    assert bench.daemon.board.notes == (note,)
    assert capsys.readouterr().err.count(note) == 1
