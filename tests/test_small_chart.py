"""Small drawings and tables: every point in its place, gaps stay gaps, foreign text stays text."""

from __future__ import annotations

import math
from xml.etree import ElementTree

import pytest

from uavbatt.records import Flight, Sample
from uavbatt.small_chart import MOST_POINTS, Size, Span, small_chart, small_table, span

HOSTILE = '<script>alert("1")</script>&\u202e.BIN'
SQUARE = Size(104.0, 104.0)


def drawn(svg: str, tag: str = "polyline") -> list[list[tuple[float, ...]]]:
    """The points of every line, or band, of a drawing."""
    found = ElementTree.fromstring(svg).iter(tag)
    return [[tuple(map(float, point.split(","))) for point in shape.attrib["points"].split()] for shape in found]


def test_the_line_fills_the_drawing_from_its_least_to_its_greatest_value() -> None:
    assert drawn(small_chart([0, 5, 10], [3.0, 4.0, 3.5], alt="a", size=SQUARE)) == [
        [(2.0, 102.0), (52.0, 2.0), (102.0, 52.0)]
    ]


def test_a_gap_parts_the_line_and_the_band() -> None:
    y = [1.0, 2.0, math.nan, 2.0, 1.0]
    band = ([0.0] * 5, [3.0, 3.0, math.nan, 3.0, math.inf])
    svg = small_chart(range(5), y, alt="a", band=band, shown=Span(0.0, 4.0), size=SQUARE)
    assert [len(line) for line in drawn(svg)] == [2, 2]
    around, alone = drawn(svg, "polygon")
    assert around == [(2.0, 27.0), (27.0, 27.0), (27.0, 102.0), (2.0, 102.0)] and alone == [(77.0, 27.0), (77.0, 102.0)]


def test_what_is_beyond_the_axis_ends_at_its_edge() -> None:
    svg = small_chart([0, 1], [0.0, 9.0], alt="a", shown=Span(0.0, 1.0), size=SQUARE)
    assert drawn(svg) == [[(2.0, 102.0), (102.0, 2.0)]]


@pytest.mark.parametrize(
    ("values", "least", "expected"),
    [
        ([1.0, 2.0], 0.0, Span(1.0, 2.0)),
        ([1.0, 1.1], 0.4, Span(0.85, 1.25)),
        ([5.0, 5.0], 0.0, Span(4.5, 5.5)),
        ([math.nan], 0.0, Span(0.0, 1.0)),
    ],
)
def test_the_span_of_an_axis(values: list[float], least: float, expected: Span) -> None:
    assert span(values, least=least) == pytest.approx(expected)


def test_a_long_line_is_thinned_to_points_that_are_its_own() -> None:
    (line,) = drawn(small_chart(range(10_000), [float(k) for k in range(10_000)], alt="a", size=SQUARE))
    assert len(line) == MOST_POINTS and (line[0], line[-1]) == ((2.0, 102.0), (102.0, 2.0))


def test_foreign_text_stays_text() -> None:
    made = small_table(HOSTILE, [(HOSTILE, HOSTILE)], small_chart([0, 1], [0, 1], alt=HOSTILE, css="x"))
    tags = {element.tag for element in ElementTree.fromstring(made).iter()}
    assert tags == {"div", "strong", "table", "tbody", "tr", "th", "td", "svg", "polyline"}
    assert "&lt;script&gt;" in made and "\u202e" not in made


def test_a_notebook_shows_a_flight_in_a_few_lines() -> None:
    flight = Flight(HOSTILE, "csv", tuple(Sample(float(k), 16.8 - 0.01 * k) for k in range(500)), duration_s=499.0)
    shown = flight._repr_html_()
    assert len(shown) < 10_000
    text = " ".join(ElementTree.fromstring(shown).itertext())
    assert "500 in 499 s" in text and "11.81 to 16.80 V" in text and HOSTILE.replace("\u202e", "\ufffd") in text


def test_a_flight_without_a_voltage_has_no_drawing() -> None:
    for rows in ((Sample(0.0, math.nan),), ()):
        assert "<svg" not in Flight("f", "csv", rows)._repr_html_()
