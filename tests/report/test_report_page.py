"""A page stands alone: nothing fetched, nothing run, and what comes from files stays text."""

from __future__ import annotations

import math
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from uavbatt.errors import BadInput, printable
from uavbatt.files import atomic_write
from uavbatt.report import plot
from uavbatt.report.page import badge, duration, element, number, page, paragraph, table

HOSTILE = "<script>alert(1)</script>\"'&\x00\u202e\ud800.BIN"
ACTIVE = {"script", "iframe", "object", "embed", "link", "base", "form", "img"}


def assert_stands_alone(html: str) -> None:
    """Well formed, nothing that runs, nothing fetched, no repeated id."""
    found = list(ElementTree.fromstring(html.partition("\n")[2].encode("utf-8")).iter())
    assert not {e.tag for e in found} & ACTIVE
    attributes = [pair for e in found for pair in e.attrib.items()]
    assert all(value.startswith("#") for name, value in attributes if name in ("src", "href", "action"))
    assert not any(name.startswith("on") for name, _ in attributes)
    ids = [value for name, value in attributes if name == "id"]
    assert len(ids) == len(set(ids))
    assert not re.search(r"url\((?!#)|@import", html)


def test_a_page_stands_alone_and_escapes_what_comes_from_files() -> None:
    made = page(HOSTILE, HOSTILE, paragraph(HOSTILE), table((HOSTILE,), [(HOSTILE,)], HOSTILE), footer=HOSTILE)
    assert_stands_alone(made)
    assert "<script" not in made
    assert "&lt;script&gt;" in made
    assert not set("\x00\u202e\ud800") & set(made)


def test_a_drawing_has_a_description_own_ids_and_the_palette_of_the_page() -> None:
    def draw(axes: object) -> None:
        axes.plot([0, 1, 2], [0, 1, 0], color=plot.BLUE, label=plot.literal("$x$ <b>"))  # type: ignore[attr-defined]
        axes.axvspan(0, 1, hatch="///")  # type: ignore[attr-defined]

    one = plot.panel(draw, 'a "quoted" <thing>', x="time (s)", y="voltage (V)")
    two = plot.panel(draw, "another", x="time (s)", y="current (A)")
    assert_stands_alone(page("t", "k", one, two))
    assert 'aria-label="a &quot;quoted&quot; &lt;thing&gt;"' in one
    assert "var(--blue)" in one
    assert plot.BLUE not in one
    assert "voltage (V)" in one
    assert "<b>" not in one


def test_a_drawing_is_the_same_every_time() -> None:
    def draw(axes: object) -> None:
        axes.plot([0, 1], [0, 1])  # type: ignore[attr-defined]

    first, second = (plot.panel(draw, "alt", x="x", y="y") for _ in range(2))
    assert first == second


def test_every_colour_of_a_drawing_is_defined_in_both_settings() -> None:
    css = page("t", "k")
    dark = css[css.index("prefers-color-scheme: dark") :]
    for name in plot.VARIABLES.values():
        assert f"--{name}:" in css[: css.index("prefers-color-scheme")], name
        assert f"--{name}:" in dark[: dark.index("* {")], name


def test_unknown_is_never_shown_as_zero() -> None:
    assert number(math.nan, 2, "V") == duration(math.nan) == "–"
    assert number(math.inf, 0) == duration(math.inf) == "unbounded"
    assert number(-0.001, 1) == "0.0"
    assert number(1.25, 1, "V", sign=True) == "+1.2 V"
    assert duration(719.4) == "11 min 59 s"
    assert duration(-61.0) == "−1 min 01 s"


def test_a_verdict_has_a_sign_beside_its_colour() -> None:
    assert "✓ pass" in badge("pass")
    assert "✗ fail" in badge("fail")
    assert "? not enough data" in badge("not enough data")


def test_markup_is_not_escaped_twice() -> None:
    assert element("p", element("b", "a & b")) == "<p><b>a &amp; b</b></p>"
    assert printable("a\tb\nc") == "a\tb\nc"


def test_written_aside_leaves_all_or_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "page.html"
    target.write_text("old")
    with pytest.raises(RuntimeError), atomic_write(target) as file:
        file.write("half")
        raise RuntimeError
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]
    with atomic_write(target) as file:
        file.write("new ±\n")
    assert target.read_bytes() == "new ±\n".encode()
    with atomic_write(tmp_path / "b", "wb") as binary:
        binary.write(b"\x00")
    assert (tmp_path / "b").read_bytes() == b"\x00"
    with atomic_write("-") as file:
        file.write("out")
    assert capsys.readouterr().out == "out"


def test_written_aside_names_the_place_it_cannot_write_to(tmp_path: Path) -> None:
    for place in (tmp_path, tmp_path / "absent" / "file"):
        with pytest.raises(BadInput, match=re.escape(str(place))), atomic_write(place) as file:
            file.write("x")
    assert list(tmp_path.iterdir()) == []
