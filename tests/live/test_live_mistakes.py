"""Mistakes in a call of `uavbatt live`: said in one true sentence, before anything else is said."""

from __future__ import annotations

import socket
from contextlib import closing
from pathlib import Path

import pytest
from command import refused_live, run
from live_rig import free_port, running

HERE = "udpin:127.0.0.1:{port}"


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (("/dev/ttyS0,57601",), "endpoint `/dev/ttyS0,57601`: 57601 is no baud rate of this system"),
        ((HERE, "--feed", "named"), "--feed named: expected --gcs ENDPOINT, where the ground station is"),
        ((HERE, "--gcs", "udpout:127.0.0.1:{port}"), "it is the autopilot's ENDPOINT"),
        ((HERE, "--http", "127.0.0.1:{taken}"), "--http 127.0.0.1:{taken}: Address already in use"),
        ((HERE, "--state", "gone/state.json"), "--state gone/state.json: expected an existing folder to write into"),
        ((HERE, "--state", "."), "--state .: expected a file, it is a folder, a device or a pipe"),
        ((HERE, "--state", "/dev/null"), "--state /dev/null: expected a file, it is a folder, a device or a pipe"),
        (("udpin:127.0.0.1:{taken_udp}",), "endpoint `udpin:127.0.0.1:{taken_udp}`: Address already in use"),
    ],
)
def test_a_call_that_cannot_be_is_one_line_and_nothing_else(tmp_path: Path, call: tuple[str, ...], words: str) -> None:
    with (
        closing(socket.create_server(("127.0.0.1", 0))) as taken,
        closing(socket.socket(type=socket.SOCK_DGRAM)) as udp,
    ):
        udp.bind(("127.0.0.1", 0))
        ports = {"port": free_port(), "taken": taken.getsockname()[1], "taken_udp": udp.getsockname()[1]}
        said = [word.format(**ports) for word in call]
        if "--http" in said:
            done = run("live", *said, folder=tmp_path)  # one of them in a process of its own
        else:
            done = refused_live(*said, folder=tmp_path)
    (line,) = done.stderr.splitlines()
    assert done.returncode == 2 and line.endswith(words.format(**ports)) and not done.stdout


def test_what_may_come_right_is_waited_for_and_never_said_to_work() -> None:
    with running("/dev/ttyNOPE", "--record", "/proc/nope") as process:
        assert process.stderr is not None
        lines = [process.stderr.readline() for _ in range(2)]
    assert "waiting for telemetry from /dev/ttyNOPE" in lines[0]
    assert "cannot record into /proc/nope: No such file" in lines[0]
    assert "cannot open /dev/ttyNOPE: No such file" in lines[1]
    assert not any("listening" in line or "recording to" in line for line in lines)
