"""The page of a diagnosis: what a person reads of the numbers that were found."""

from __future__ import annotations

import html
import re
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from uavbatt.battery import battery_file
from uavbatt.diagnosis.classes import EffectClass, Interval
from uavbatt.diagnosis.close import ClosedLoop, HeldOutErrors
from uavbatt.diagnosis.diagnosis import Diagnosis
from uavbatt.diagnosis.refit.residual import Residual
from uavbatt.report.diagnosis import diagnosis_report

pytestmark = pytest.mark.usefixtures("undrawn")
GAIN = EffectClass(("voltage_gain",), 0.53, {"gain_V": Interval(0.9914, 0.9881, 0.9948, "1")}, "a multimeter")
OFFSET = EffectClass(("temperature_offset",), 0.4, {"offset_K": Interval(-9.74, -15.3, -4.2, "K")}, "a thermometer")


def words(*classes: EffectClass) -> str:
    """Return the words of the page that tells of these classes."""
    file = battery_file.read_battery("lipo-generic")
    still = np.zeros(20)
    residuals = [Residual("a.BIN", np.arange(20.0), still, still, still, still, still, still, still > 0.0)]
    measured: Any = SimpleNamespace(evidence=SimpleNamespace(has_temperature=True), tables=None)
    unused = cast(Any, None)
    found = Diagnosis("effect_found", classes, (), measured, unused, unused, residuals, residuals, 0.02, unused)
    errors = HeldOutErrors(0.08, 0.7, 60.0, 0.9)
    text = diagnosis_report(found, ClosedLoop(errors, errors, ("a.BIN",)), file, file)
    return re.sub(r"\s+", " ", html.unescape(re.sub(r"<[^>]*>", " ", text)))


def test_a_gain_of_a_hundredth_can_be_read() -> None:
    told = words(GAIN)
    assert "0.9914 0.9881 to 0.9948" in told


def test_a_wide_interval_is_told_with_no_more_digits_than_it_has() -> None:
    assert "−9.7 −15.3 to −4.2 K" in words(OFFSET)


def test_two_effects_are_told_as_two_and_not_as_one_or_the_other() -> None:
    assert "Several things are missing in the battery file together" in words(GAIN, OFFSET)
    assert words(GAIN, OFFSET).count("One cause is this") == 2
    assert "it has a name" in words(GAIN) and "The cause is this" in words(GAIN)
