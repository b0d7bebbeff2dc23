"""Frames as bytes: nothing is lost or invented, and only a battery's time is ever rewritten."""

from __future__ import annotations

import random
import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.live.feeds.rewriter import CONVERGING, ESTIMATE_LAYOUT, NOTHING, OK, Rewriter
from uavbatt.mavlink import framing


def frame(message: Any, system: int = 1, component: int = 1, v1: bool = False, sign: bool = False) -> bytes:
    link = dialect.MAVLink(None, srcSystem=system, srcComponent=component)
    if sign:
        link.signing.secret_key, link.signing.sign_outgoing = b"k" * 32, True
    return bytes(message.pack(link, force_mavlink1=v1))


def battery(id: int = 0, left_s: int = 0, percent: int = 80, **more: Any) -> Any:
    volts = [16400] + [65535] * 9
    return dialect.MAVLink_battery_status_message(id, 0, 0, 2510, volts, 1250, 700, -1, percent, left_s, **more)


def decoded(data: bytes) -> Any:
    return dialect.MAVLink(None).decode(bytearray(data))


def told(status: int = OK, remaining_s: float = 321.9, since_s: float = 100.0, soc: float = 0.42, id: int = 0) -> bytes:
    return struct.pack(ESTIMATE_LAYOUT, 1, 1, id, status, remaining_s, soc, since_s)


def rewriter(**given: Any) -> Rewriter:
    made = Rewriter(soc=given.pop("rewrite_soc", False))
    made.take(told(**given))
    return made


@given(st.binary(max_size=600))
def test_pieces_are_all_the_bytes(data: bytes) -> None:
    assert b"".join(data[a:b] for a, b, _ in framing.pieces(data)) == data


@given(st.lists(st.binary(max_size=80), max_size=12))
def test_a_splitter_gives_back_what_it_took(chunks: list[bytes]) -> None:
    splitter, out = framing.Splitter(), b""
    for chunk in chunks:
        out += b"".join(piece for piece, _ in splitter.feed(chunk))
        if len(chunk) % 3 == 0:
            out += splitter.flush()
    assert out + splitter.flush() == b"".join(chunks)


def test_a_frame_in_single_bytes_is_one_frame() -> None:
    data, splitter = frame(battery()), framing.Splitter()
    made = [piece for k in range(len(data)) for piece in splitter.feed(data[k : k + 1])]
    assert made == [(data, True)]


def test_the_rest_of_a_flushed_frame_passes_and_the_next_is_whole() -> None:
    data, splitter = frame(battery()), framing.Splitter()
    assert splitter.feed(data[:20]) == [] and splitter.flush() == data[:20]
    assert splitter.feed(data[20:] + data) == [(data[20:], False), (data, True)]


def test_frames_are_found_again_after_a_wrong_length() -> None:
    frames = framing.Frames()
    found = []
    for candidate in frames.feed(b"\xfd\x30\x00" + frame(battery()) + frame(battery(id=3)) + b"\xfe\x01"):
        if framing.battery_of(candidate) is None:
            frames.reject()
        else:
            found.append(candidate)
    assert found == [frame(battery()), frame(battery(id=3))]


@pytest.mark.parametrize("left_s", [0, 700])
def test_the_time_is_put_in_and_nothing_else_changes(left_s: int) -> None:
    original = battery(left_s=left_s, voltages_ext=[0, 0, 0, 0], charge_state=1)
    seen = decoded(rewriter().frame(frame(original), 101.0))
    assert seen.time_remaining == 320  # 321.9 less one second of age
    assert {k: v for k, v in seen.to_dict().items() if k != "time_remaining"} == {
        k: v for k, v in decoded(frame(original)).to_dict().items() if k != "time_remaining"
    }
    assert (seen.get_srcSystem(), seen.get_srcComponent(), seen.get_seq()) == (1, 1, 0)


def test_percent_is_rewritten_on_request_only() -> None:
    assert decoded(rewriter().frame(frame(battery()), 100.0)).battery_remaining == 80
    assert decoded(rewriter(rewrite_soc=True).frame(frame(battery()), 100.0)).battery_remaining == 42


def test_a_known_time_is_never_zero() -> None:
    assert decoded(rewriter(remaining_s=0.2).frame(frame(battery()), 102.0)).time_remaining == 1


def untouched() -> dict[str, bytes]:
    good = frame(battery())
    return {
        "v1": frame(battery(), v1=True),
        "signed": frame(battery(), sign=True),
        "damaged": good[:-1] + bytes([good[-1] ^ 1]),
        "damaged payload": good[:12] + bytes([good[12] ^ 8]) + good[13:],
        "cut": good[:-3],
        "longer": good + b"\0",
        "another system": frame(battery(), system=2),
        "another component": frame(battery(), component=180),
        "another battery": frame(battery(id=1)),
        "another message": frame(dialect.MAVLink_heartbeat_message(2, 3, 128, 0, 3, 3)),
        "garbage": b"\xfd\x00\xfe garbage \xfd",
    }


@pytest.mark.parametrize("kind", untouched())
def test_everything_else_passes_byte_for_byte(kind: str) -> None:
    data = untouched()[kind]
    assert rewriter().frame(data, 100.0) == data
    if kind != "longer":
        assert rewriter().datagram(data, 100.0) == data


@pytest.mark.parametrize(
    "given",
    [{"status": NOTHING}, {"since_s": 96.9}, {"since_s": 101.0}, {"remaining_s": float("nan")}, {"remaining_s": -5.0}],
)
def test_without_a_fresh_estimate_the_frame_passes(given: dict[str, Any]) -> None:
    data = frame(battery())
    assert rewriter(**given).frame(data, 100.0) == data


def test_the_autopilots_own_time_gives_way_only_to_an_ok() -> None:
    own = frame(battery(left_s=700))
    assert rewriter(status=CONVERGING).frame(own, 100.0) == own
    assert rewriter(status=CONVERGING).frame(frame(battery()), 100.0) != frame(battery())


def test_one_datagram_with_several_frames() -> None:
    other = frame(dialect.MAVLink_heartbeat_message(2, 3, 128, 0, 3, 3))
    seen = rewriter().datagram(other + frame(battery()) + b"junk" + other, 100.0)
    assert seen.startswith(other) and seen.endswith(b"junk" + other)
    assert decoded(seen[len(other) : -len(other) - 4]).time_remaining == 321


def test_mutated_frames_are_passed_unchanged() -> None:
    """20 000 frames with a flipped bit: each passes as it came, since its checksum is wrong."""
    dice, good, made = random.Random(1), frame(battery(voltages_ext=[0, 0, 0, 0], charge_state=1)), rewriter()
    for _ in range(20_000):
        bad = bytearray(good)
        at = dice.randrange(1, len(bad))
        bad[at] ^= 1 << dice.randrange(8)
        passed = made.frame(bytes(bad), 100.0)
        assert passed == bad, f"byte {at}"
