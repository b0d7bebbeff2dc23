"""Records with unknown numbers are compared alike in every version of Python: rows, statements, missions."""

from __future__ import annotations

import ast
import struct
from dataclasses import replace
from pathlib import Path

import pytest

import uavbatt
from uavbatt.navigation import Action, Mission, MissionItem, Position
from uavbatt.records import PackFacts, Sample

# NaNs that come from two frames are two objects; Python itself takes only one and the same object for equal.
ONE_NAN, OTHER_NAN = (struct.unpack("<f", b"\x00\x00\xc0\x7f")[0] for _ in range(2))


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (Sample(0.0, 16.0, ONE_NAN), Sample(0.0, 16.0, OTHER_NAN)),
        (PackFacts(capacity_Ah=ONE_NAN, cells_series=4), PackFacts(capacity_Ah=OTHER_NAN, cells_series=4)),
        (Position(1.0, 47.0, 8.0, 10.0, up_ms=ONE_NAN), Position(1.0, 47.0, 8.0, 10.0, up_ms=OTHER_NAN)),
        (
            Mission((MissionItem(1, Action.WAYPOINT, 47.0, 8.0, ONE_NAN),)),
            Mission((MissionItem(1, Action.WAYPOINT, 47.0, 8.0, OTHER_NAN),)),
        ),
    ],
    ids=lambda record: type(record).__name__,
)
def test_unknown_equals_unknown(one: object, other: object) -> None:
    """With Python 3.13 each row was taken for a new statement about the pack, and asked for a new route forecast."""
    assert ONE_NAN is not OTHER_NAN
    assert one == other and hash(one) == hash(other) and len({one, other}) == 1


def test_known_differs_from_unknown_and_from_another_number() -> None:
    known = PackFacts(capacity_Ah=5.0)
    assert known != PackFacts() and known != replace(known, capacity_Ah=5.1) and known != Sample(0.0, 16.0)
    assert known == replace(known)


def test_every_record_with_an_unknown_number_is_compared_so() -> None:
    """Seven were not: with Python 3.13 a smart battery's statement was not equal to itself, read again."""
    for path in Path(uavbatt.__file__).parent.rglob("*.py"):
        for made in (node for node in ast.walk(ast.parse(path.read_text("utf-8"))) if isinstance(node, ast.ClassDef)):
            how = [ast.unparse(decorator) for decorator in made.decorator_list]
            values = [ast.unparse(line.value) for line in made.body if isinstance(line, ast.AnnAssign) and line.value]
            if any("dataclass(frozen=True" in words for words in how) and {"NAN", "math.nan"} & set(values):
                assert "nan_equal" in how, f"{path.name}: {made.name}"
