"""When a message rate and a parameter are asked for: once at first, then with pauses, a few times, never more."""

from __future__ import annotations

from itertools import pairwise

from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.live.requests.parameters import MOST_ASKED, Requests, parameter_names
from uavbatt.mavlink.outgoing import Outgoing
from uavbatt.telemetry.parameters import HeardOnce

OUT = Outgoing(1, 193)


def said(frames: list[bytes]) -> list[object]:
    """The names of the parameters that are asked for, and the messages whose rate is."""
    found = [dialect.MAVLink(None).decode(bytearray(frame)) for frame in frames]
    return [m.param_id if m.get_type() == "PARAM_REQUEST_READ" else int(m.param1) for m in found]


def asked(requests: Requests, seconds: float, *names: str, **known: float) -> list[object]:
    """What is asked for in so many seconds, ten times a second."""
    found: list[object] = []
    for k in range(int(10.0 * seconds)):
        found += said(requests.frames(0.1 * k, 1, known, names, OUT))
    return found


def test_the_names_are_those_of_the_autopilot_and_of_its_batteries() -> None:
    assert parameter_names([], False)[:2] == ["BATT_CAPACITY", "BATT_LOW_VOLT"]
    assert [n for n in parameter_names([1, 0], False) if "CAPACITY" in n] == ["BATT_CAPACITY", "BATT2_CAPACITY"]
    of_second = ["BAT2_N_CELLS", "BAT2_CAPACITY", "BAT2_V_EMPTY"]
    assert parameter_names([1], True) == [*of_second, "COM_LOW_BAT_ACT", "BAT_CRIT_THR"]


def test_each_parameter_is_asked_for_once_before_any_is_asked_for_again() -> None:
    found = [name for name in asked(Requests(5.0), 30.0, "A", "B", "C", B=1.0) if name != 147]
    assert found[:3] == ["A", "B", "C"]  # a known one once: it may have changed before we heard
    assert [found.count(name) for name in "ABC"] == [MOST_ASKED, 1, MOST_ASKED]


def test_a_slow_link_is_not_flooded_with_requests_for_parameters() -> None:
    requests, names, at_s = Requests(5.0), [f"P{k}" for k in range(30)], []
    for k in range(200):
        at_s += [0.01 * k for name in said(requests.frames(0.01 * k, 1, {}, names, OUT)) if name != 147]
    assert 18 <= len(at_s) <= 20 and min(b - a for a, b in pairwise(at_s)) > 0.09


def test_after_a_gap_everything_is_asked_for_again() -> None:
    requests = Requests(5.0)
    asked(requests, 30.0, "A", A=1.0)
    assert "A" not in asked(requests, 30.0, "A", A=1.0)
    requests.begin_again()
    assert asked(requests, 30.0, "A", A=1.0).count("A") == 1


def test_the_rate_is_asked_for_while_rows_come_slower_than_half_of_it() -> None:
    silent, slow, fast = Requests(5.0), Requests(5.0), Requests(5.0)
    due_s: list[list[int]] = [[], [], []]
    for k in range(1000):
        for requests, period, times_s in zip((silent, slow, fast), (0, 10, 2), due_s, strict=True):
            if period and k % period == 0:
                requests.row()
            if 147 in said(requests.frames(0.1 * k, 1, {}, (), OUT)):
                times_s.append(round(0.1 * k))
    assert due_s == [[0, 4, 12, 28, 58, 88], [0, 4, 12, 28, 58, 88], [0]]  # the pauses grow to half a minute


def test_a_doubted_parameter_is_asked_for_every_second_a_few_times() -> None:
    requests, doubted = Requests(5.0), {"A": HeardOnce(5.0, 1)}
    due = [k for k in range(100) if requests.again(0.1 * k, 1, doubted, OUT)]
    assert due == [0, 10, 20, 30][:MOST_ASKED]
    assert requests.again(10.0, 1, {"A": HeardOnce(6.0, 2)}, OUT)  # another value is another doubt
    assert requests.again(20.0, 1, {}, OUT) == []
