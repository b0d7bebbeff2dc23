"""The validation page of the study's data, with a model made up as the tests plus a known bias (no fit)."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from uavbatt import dataset
from uavbatt.dataset import whole_minutes
from uavbatt.report.validation_inputs import Change
from uavbatt.validation import gate, page, paper
from uavbatt.validation.corridor import corridor, corridors
from uavbatt.validation.findings import Finding, findings
from uavbatt.validation.heldout import HeldOut
from uavbatt.validation.iso5725 import precision
from uavbatt.validation.validate import LevelPrecision, Validation

STUDY = dataset.load()
HOSTILE = "<script>alert('$x$')</script>"
NAN = math.nan


def made(bias_V: float = 0.005) -> Validation:
    """The stage's result for a model that is `bias_V` above the tests everywhere."""
    levels, heat = whole_minutes(STUDY, 25.0), whole_minutes(STUDY, 25.0, "surface_C")
    band, limits = corridor(STUDY, 25.0), gate.Limits()
    assert levels is not None and heat is not None and band is not None
    measured_C = np.concatenate([heat.values, np.full_like(heat.values, math.nan)], axis=1)
    held = HeldOut(
        "circuit", 25.0, 3, levels.time_s, levels.values, levels.values + bias_V, measured_C, measured_C + 0.3
    )
    claims = [
        gate.voltage_claim(held, limits, STUDY.cutoff_V, STUDY.uncertainty),
        gate.corridor_claim(held, band.mean, band.C, limits, STUDY.cutoff_V),
        gate.crossing_claim(held, limits, STUDY.uncertainty),
        gate.surface_claim(held, limits, STUDY.uncertainty),
        gate.informing("reproducibility", 25.0, "2 samples"),
        gate.informing("voltage bias at this temperature", -10.0, "one run"),
    ]
    kept = tuple(c for c in claims if c is not None)
    table = tuple(
        LevelPrecision(name, float(t), precision(found.cells(i)))
        for name, found in (("voltage_V", levels), ("surface_C", heat))
        for i, t in enumerate(found.time_s)
    )
    verdict = gate.overall(list(kept))
    return Validation(STUDY, 25.0, limits, findings(STUDY), table, corridors(STUDY), held, kept, verdict, None)


@pytest.fixture(scope="module")
def passed() -> str:
    return page.validation_page(made(), paper.replay(STUDY))


def text_of(html: str) -> str:
    """The page's words; fails when it is not well formed or fetches or runs something."""
    found = list(ElementTree.fromstring(html.partition("\n")[2].encode("utf-8")).iter())
    assert not any(e.tag == "script" or "src" in e.attrib for e in found)
    assert all(e.attrib["href"].startswith("#") for e in found if "href" in e.attrib)
    ids = [e.attrib["id"] for e in found if "id" in e.attrib]
    assert len(ids) == len(set(ids))
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", html[html.index("<body>") :]))


def test_the_verdict_comes_first_in_words(passed: str) -> None:
    words = text_of(passed)
    assert words.index("✓ pass Tests held back from the fit agree") < 300
    assert "±0.15 V and ±10 s" in words[:500]
    assert "for other packs of the make it is not proven" in words[:700]
    assert "Read first: 4 serious findings" in words


def test_a_model_that_is_off_fails_in_words() -> None:
    words = text_of(page.validation_page(made(0.2)))
    assert "✗ fail Do not fly on this model" in words[:300]
    assert "beyond ±0.15" in words[:600]


def test_an_undecided_gate_says_that_nothing_is_proven() -> None:
    words = text_of(page.validation_page(made(0.08)))
    assert "? not enough data Not proven" in words[:300]


def test_every_part_is_there(passed: str) -> None:
    words = text_of(passed)
    for heading in ("Claims", "Bias against the limits", "What the tests say about themselves", "Curves and corridors",
                    "Over ambient temperature", "Precision", "Uncertainty budget", "Data",
                    "Agreement with the study's printed tables"):  # fmt: skip
        assert f"<h2>{heading.replace(chr(39), '&#x27;')}</h2>" in passed, heading
    for figure in (1, 4, 5, 6, 7):
        assert f"(the study&#x27;s Figure {figure})" in passed, figure
    assert "Mandel&#x27;s k" in passed
    assert "45 of 45" in words and "25 of 27" in words and "26 of 27" in words
    assert "F_emp = 2.83" in words
    assert "instant of reading (B)" in words
    assert "guard band" in words


def test_findings_keep_their_order(passed: str) -> None:
    words = text_of(passed)
    places = [words.index(re.sub(r"\s+", " ", f.title.replace("'", "&#x27;"))) for f in findings(STUDY)]
    assert places == sorted(places)


def test_unknown_precision_is_a_dash_and_two_samples_are_not_called_reproducibility(passed: str) -> None:
    assert "– to –" not in passed
    assert ">nan<" not in passed.lower()
    assert "not reproducibility" in passed


def test_a_claim_of_which_nothing_is_known_shows_no_number(passed: str) -> None:
    row = re.search(r"<tr><td>reproducibility.*?</tr>", passed, re.DOTALL)
    assert row is not None
    assert row[0].count(">–<") == 3


def test_before_and_after_has_its_place() -> None:
    changes = (
        Change("voltage RMSE", "mV", 107.0, 80.0, "held-out tests", 0, "yes"),
        Change("gone", "V", NAN, 1.0, "x"),
    )
    words = text_of(page.validation_page(made(), changes=changes))
    assert "107 mV 80 mV −25%" in words
    assert "Before and after" not in text_of(page.validation_page(made()))


def test_words_from_files_stay_text() -> None:
    hostile = replace(made(), dataset=replace(STUDY, name=HOSTILE, load=HOSTILE, source=HOSTILE),
                      findings=(Finding("x", HOSTILE, HOSTILE, "note"),))  # fmt: skip
    runs = tuple(replace(r, sample=HOSTILE if r.sample == "1" else r.sample) for r in STUDY.runs)
    hostile = replace(hostile, dataset=replace(hostile.dataset, runs=runs))
    html = page.validation_page(hostile)
    text_of(html)
    assert "<script" not in html


def test_another_data_set_is_not_called_the_study() -> None:
    assert "the study&#x27;s Figure" not in page.validation_page(made())


def test_the_page_is_written_whole(tmp_path: Path) -> None:
    page.write(tmp_path / "v.html", made())
    assert [p.name for p in tmp_path.iterdir()] == ["v.html"]
