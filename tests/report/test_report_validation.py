"""The validation page of the study's data, with a model made up as the tests plus a known bias (no fit)."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from unittest.mock import patch
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure

from uavbatt import dataset
from uavbatt.report.page import page, write_page
from uavbatt.report.validation import figures as validation_figures
from uavbatt.report.validation.tables import gains_table
from uavbatt.report.validation.validation_page import validation_report
from uavbatt.validation.gating import gate
from uavbatt.validation.gating.heldout import HeldOut
from uavbatt.validation.gating.temperature_gains import Gain
from uavbatt.validation.iso5725 import precision
from uavbatt.validation.judging.corridor import Corridor, corridor, corridors
from uavbatt.validation.judging.finding import Finding
from uavbatt.validation.judging.findings import findings
from uavbatt.validation.judging.readings import read_once
from uavbatt.validation.study import paper
from uavbatt.validation.validate import LevelPrecision, Validation

STUDY = dataset.load()
READINGS = read_once(STUDY)
HOSTILE = "<script>alert('$x$')</script>"
NAN = math.nan


@cache
def said() -> tuple[Finding, ...]:
    """Findings about the tests."""
    return findings(READINGS, 25.0, corridor(READINGS, 25.0))


@cache
def bands(quantity: str) -> dict[float, Corridor]:
    """The corridors of the tests, which no model moves."""
    return corridors(READINGS, quantity)


def made(bias_V: float = 0.005) -> Validation:
    """The stage's result for a model that is `bias_V` above the tests everywhere."""
    levels, heat = READINGS.levels(25.0), READINGS.levels(25.0, "surface_C")
    band, limits = bands("voltage_V")[25.0], gate.Limits()
    assert levels is not None and heat is not None
    measured_C = np.concatenate([heat.values, np.full_like(heat.values, math.nan)], axis=1)
    held = HeldOut(
        "circuit", 25.0, 3, levels.time_s, levels.values, levels.values + bias_V, measured_C, measured_C + 0.3
    )
    claims = [
        gate.voltage_claim(held, limits, STUDY.cutoff_V, STUDY.uncertainty),
        gate.corridor_claim(held, band.mean, band.C, limits, STUDY.cutoff_V),
        gate.crossing_claim(held, limits, STUDY.uncertainty),
        gate.surface_claim(held, limits, STUDY.uncertainty),
        gate.claim_without_bias("reproducibility", 25.0, "2 samples"),
        gate.claim_without_bias("voltage bias at this temperature", -10.0, "one run"),
    ]
    kept = tuple(c for c in claims if c is not None)
    table = tuple(
        LevelPrecision(name, float(t), precision(found.cells(i)))
        for name, found in (("voltage_V", levels), ("surface_C", heat))
        for i, t in enumerate(found.time_s)
    )
    verdict = gate.overall(list(kept))
    volts, surfaces = bands("voltage_V"), bands("surface_C")
    return Validation(READINGS, limits, said(), table, volts, held, kept, verdict, None, surface_corridors=surfaces)


@pytest.fixture(scope="module")
def passed() -> str:
    return validation_report(made(), paper.replay(STUDY))


@pytest.fixture(scope="module")
def undecided() -> str:
    """Without the study's printed tables beside it."""
    return validation_report(made(0.08))


def text_of(html: str) -> str:
    """The page's words; fails when it is not well formed or fetches or runs something."""
    found = list(ElementTree.fromstring(html.partition("\n")[2].encode("utf-8")).iter())
    assert not any(e.tag == "script" or "src" in e.attrib for e in found)
    assert all(e.attrib["href"].startswith("#") for e in found if "href" in e.attrib)
    ids = [e.attrib["id"] for e in found if "id" in e.attrib]
    assert len(ids) == len(set(ids))
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", html[html.index("<body>") :]))


def answer_of(html: str) -> str:
    """The words of the answer, which is the first thing below the title: before every heading, table and drawing."""
    first = html[html.index("<main") : html.index("<nav")]
    assert 'class="answer' in first and "<table" not in first and "<svg" not in first
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", first)).strip()


def test_the_verdict_comes_first_in_words(passed: str) -> None:
    words = answer_of(passed)
    assert words.startswith("✓ pass ")
    assert "±0.15 V and ±10 s" in words
    assert "other packs of the make" in words and "not proven" in words
    serious = sum(f.severity == "serious" for f in said())
    assert f"{serious} serious findings" in words


@pytest.mark.usefixtures("undrawn")
def test_a_model_that_is_off_fails_in_words() -> None:
    words = answer_of(validation_report(made(0.2)))
    assert words.startswith("✗ fail Do not fly on this model")
    assert "beyond ±0.15" in words


def test_an_undecided_gate_says_that_nothing_is_proven(undecided: str) -> None:
    words = answer_of(undecided)
    assert words.startswith("? not enough data Not proven")


def test_every_part_is_there(passed: str) -> None:
    words = text_of(passed)
    for heading in ("Claims", "Bias against the limits", "Findings about the tests", "Curves and corridors",
                    "Over ambient temperature", "Precision", "Uncertainty budget", "Data",
                    "Agreement with the study's printed tables"):  # fmt: skip
        assert re.search(f"<h2 id=[^>]*>{heading.replace(chr(39), '&#x27;')}</h2>", passed), heading
    for figure in (1, 4, 5, 6, 7):
        assert f"(the study&#x27;s Figure {figure})" in passed, figure
    assert "Mandel&#x27;s k" in passed
    assert "45 of 45" in words and "25 of 27" in words and "26 of 27" in words
    assert "F_emp = 2.83" in words
    assert "instant of reading (B)" in words
    assert "guard band" in words


def test_findings_keep_their_order(passed: str) -> None:
    words = text_of(passed)
    places = [words.index(re.sub(r"\s+", " ", f.title.replace("'", "&#x27;"))) for f in said()]
    assert places == sorted(places)


def test_unknown_precision_is_a_dash_and_two_samples_are_not_called_reproducibility(passed: str) -> None:
    assert "– to –" not in passed
    assert ">nan<" not in passed.lower()
    assert "not reproducibility" in passed


def test_a_claim_of_which_nothing_is_known_shows_no_number(passed: str) -> None:
    row = re.search(r"<tr><td>reproducibility.*?</tr>", passed, re.DOTALL)
    assert row is not None
    assert row[0].count(">–<") == 3


def test_before_and_after_is_shown_where_the_model_was_extended(passed: str) -> None:
    gain = Gain("both", "cold", "all", 0.107, 0.080, 0.09, 0.07, p_value=0.004, holds=True)
    words = text_of(page("", "", gains_table([gain])))
    assert "107 mV 80 mV −25% held-out tests, all temperatures yes (p = 0.004)" in words
    assert "Before and after" not in text_of(passed)


def test_words_from_files_stay_text() -> None:
    runs = tuple(replace(r, sample=HOSTILE if r.sample == "1" else r.sample) for r in STUDY.runs)
    tests = replace(STUDY, name=HOSTILE, load=HOSTILE, source=HOSTILE, runs=runs)
    hostile = replace(made(), readings=read_once(tests), findings=(Finding("x", HOSTILE, HOSTILE, "note"),))
    html = validation_report(hostile)
    text_of(html)
    assert "<script" not in html


def test_another_data_set_is_not_called_the_study(undecided: str) -> None:
    assert "the study&#x27;s Figure" not in undecided


def test_the_page_is_written_whole(passed: str, tmp_path: Path) -> None:
    write_page(tmp_path / "v.html", passed)
    assert [p.name for p in tmp_path.iterdir()] == ["v.html"]


def test_the_axis_of_times_reaches_as_far_as_the_widest_bias_in_parts_of_its_own_limit() -> None:
    """A time of 8 of 10 s beside a voltage of 0.1 of 0.15 V, each judged at one instant: both lie inside."""
    one, reached = np.ones(1), []

    def kept(draw: Callable[[Figure], None], *_: object) -> str:
        figure = Figure()
        draw(figure)
        reached.append(figure.axes[0].get_xlim()[1])
        return ""

    made_up = [("time of 10 V", 8.0, 10.0, "s"), ("voltage bias", 0.1, 0.15, "V")]
    claims = [gate.Claim(name, 25.0, "pass", "", True, one, bias * one, 0.0 * one, 0.0 * one, limit, unit)
              for name, bias, limit, unit in made_up]  # fmt: skip
    with patch.object(validation_figures.plot, "drawing", kept):
        validation_figures.claim_figures(claims)
    assert reached == [pytest.approx(1.2)]
