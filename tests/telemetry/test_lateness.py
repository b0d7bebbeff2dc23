"""How late frames come, by the vehicle's own clock: what is late, and what only looks so."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.mavlink import framing
from uavbatt.telemetry.link.lateness import BOOT_TIME_AT, Lateness, boot_time_s

BOOT_S = 100.0


def worst_s(frames: Iterable[tuple[float, float]]) -> float:
    """The most that is said; frames: times of reception and since boot [s]."""
    lateness, worst = Lateness(), 0.0
    for at_s, boot_s in frames:
        lateness = lateness.after(at_s, boot_s)
        worst = max(worst, lateness.late_s(at_s))
    return worst


def fresh(seconds: float, from_s: float = 0.0) -> list[tuple[float, float]]:
    return [(from_s + k / 4.0, BOOT_S + from_s + k / 4.0) for k in range(int(4 * seconds))]


def later(frames: Iterable[tuple[float, float]], by_s: float) -> list[tuple[float, float]]:
    return [(at_s + by_s, boot_s) for at_s, boot_s in frames]


def test_a_link_that_holds_its_frames_back_is_late_by_that() -> None:
    assert worst_s([*fresh(60.0), *later(fresh(60.0, 60.0), 30.0)]) == pytest.approx(30.0, abs=0.1)
    crawling = [(1.25 * at_s, boot_s) for at_s, boot_s in fresh(100.0)]
    assert worst_s(crawling) == pytest.approx(25.0, abs=1.0)


def test_a_link_that_has_caught_up_is_late_no_more() -> None:
    lateness = Lateness()
    for at_s, boot_s in [*fresh(60.0), *later(fresh(20.0, 60.0), 30.0), *fresh(20.0, 110.0)]:
        lateness = lateness.after(at_s, boot_s)
    assert lateness.late_s(130.0) == pytest.approx(0.0, abs=0.1)


MIXED = ("jitter", "twice, the second time 20 s late")
FALSE_ALARMS = {
    "jitter": [(at_s + 4.0 * (k % 5 == 0), boot_s) for k, (at_s, boot_s) in enumerate(fresh(300.0))],
    "twice, the second time 20 s late": [*fresh(300.0), *later(fresh(300.0), 20.0)],
    "a clock that is slow by a second in three hours": [
        (at_s, (1.0 - 9e-5) * at_s) for at_s, _ in fresh(86_400.0)[::40]
    ],
    "a clock that is fast": [(at_s, 1.01 * at_s) for at_s, _ in fresh(3600.0)],
    "a reboot": [*fresh(60.0), *((at_s, at_s - 62.0) for at_s, _ in fresh(60.0, 64.0))],
    "49.7 days": [(at_s, (at_s + 2**32 / 1000.0 - 30.0) % (2**32 / 1000.0)) for at_s, _ in fresh(60.0)],
    "a clock that stands": [(at_s, BOOT_S) for at_s, _ in fresh(60.0)],
    "another clock": [*fresh(60.0), *((at_s, at_s + 1e6) for at_s, _ in fresh(60.0, 60.0))],
    "one damaged frame, a minute ahead": [*fresh(60.0), (60.0, BOOT_S + 120.0), *fresh(60.0, 60.25)],
    "one damaged frame, the first of all": [(0.0, BOOT_S + 60.0), *fresh(60.0, 0.25)],
    "a clock that was set back": [(at_s, boot_s + 1e5) for at_s, boot_s in fresh(60.0)] + fresh(60.0, 60.0),
}


@pytest.mark.parametrize("what", FALSE_ALARMS)
def test_what_only_looks_late_is_not(what: str) -> None:
    """While frames of now come at all: what is left over behind the last of them is late."""
    received = sorted(FALSE_ALARMS[what], key=lambda frame: frame[0])
    assert worst_s(frame for frame in received if what not in MIXED or frame[0] < 300.0) < 1.0


def test_a_burst_after_a_silence_is_late_only_until_it_is_over() -> None:
    held = [(70.0 + 0.001 * k, boot_s) for k, (_, boot_s) in enumerate(fresh(10.0, 60.0))]
    lateness, said = Lateness(), dict[float, float]()
    for at_s, boot_s in [*fresh(60.0), *held, *fresh(10.0, 70.25)]:
        lateness = lateness.after(at_s, boot_s)
        said[at_s] = lateness.late_s(at_s)
    assert max(late_s for at_s, late_s in said.items() if at_s >= 70.25) < 1.0


def test_a_clock_that_falls_silent_says_nothing() -> None:
    lateness = Lateness()
    for at_s, boot_s in [*fresh(60.0), *later(fresh(1.0, 60.0), 5.0)]:
        lateness = lateness.after(at_s, boot_s)
    assert lateness.late_s(66.0) == pytest.approx(5.0, abs=0.1) and lateness.late_s(120.0) == 0.0


MESSAGES: list[Any] = [
    lambda ms: dialect.MAVLink_system_time_message(0, ms),
    lambda ms: dialect.MAVLink_attitude_message(ms, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1),
    lambda ms: dialect.MAVLink_local_position_ned_message(ms, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0),
    lambda ms: dialect.MAVLink_global_position_int_message(ms, 1, 2, 3, 4, 0, 0, 0, 0),
]


@pytest.mark.parametrize("is_v1", [False, True])
def test_the_clock_is_read_from_the_bytes(is_v1: bool) -> None:
    """As pymavlink reads it; MAVLink 2 trims the zeros behind the last byte that is none."""
    link: Any = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    for made, milliseconds in itertools.product(MESSAGES, (0, 1, 256, 1_234_567, 2**32 - 1)):
        frame = bytes(made(milliseconds).pack(link, force_mavlink1=is_v1))
        number = framing.header(frame).message_id
        assert number in BOOT_TIME_AT and boot_time_s(frame, number) == milliseconds / 1000.0


def test_an_autopilot_that_restarts_behind_a_late_link_is_not_late() -> None:
    """Its clock fell back by more than the silence was long, as a later way of the same frames does."""
    lateness = Lateness()
    for at_s, boot_s in [*fresh(100.0), *later(fresh(20.0, 100.0), 5.0)]:
        lateness = lateness.after(at_s, boot_s)
    assert lateness.late_s(125.0) == pytest.approx(5.0, abs=0.2)
    for second in range(60):
        lateness = lateness.after(126.0 + second, 3.0 + second)
    assert lateness.late_s(185.0) < 1.0
