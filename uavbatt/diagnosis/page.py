"""A diagnosis as the report page takes it."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import Any

import msgspec
import tomli_w

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.effects import unit_words
from uavbatt.diagnosis.classes import EffectClass
from uavbatt.diagnosis.close import Closed
from uavbatt.diagnosis.diagnosis import Diagnosis
from uavbatt.diagnosis.words import CHECK, MEANING, QUANTITY
from uavbatt.report.diagnosis import DiagnosisPage, Suspect, Track


def inputs(found: Diagnosis, closed: Closed, old: BatteryFile, new: BatteryFile) -> DiagnosisPage:
    """All that the page says."""
    b, a = closed.before, closed.after
    errors = (
        ("voltage RMSE", 1000.0 * b.voltage_rmse_V, 1000.0 * a.voltage_rmse_V, "mV", 0),
        ("temperature RMSE", b.temp_rmse_K, a.temp_rmse_K, "K", 2),
        ("remaining time, mean error", b.remaining_mae_s, a.remaining_mae_s, "s", 0),
        ("truth inside the 90 % interval", 100.0 * b.coverage, 100.0 * a.coverage, "%", 0),
    )
    tracks = tuple(
        Track(Path(r.name).stem, r.time_s - r.time_s[0], r.voltage_V, s.voltage_V, r.temp_K, s.temp_K)
        for r, s in zip(found.residual_before, found.residual_after, strict=True)
    )
    notes: tuple[str, ...] = ()
    if not found.problem.evidence.has_temperature:
        notes += ("No temperature was measured: effects that show in it only are not among the candidates.",)
    if old.status == "edited":
        notes += (f"The {old.caveat}.",)
    return DiagnosisPage(
        battery=old.battery.name,
        verdict=found.verdict,
        suspects=tuple(_suspect(c) for c in found.classes),
        doubts=found.reasons,
        floor_V=found.floor_V,
        errors=errors,
        held_out=closed.held_out,
        tracks=tracks,
        changes=difference(old, new),
        notes=notes,
    )


def _suspect(one: EffectClass) -> Suspect:
    values = tuple(
        (QUANTITY.get(name, name), name, i.value, i.lo, i.hi, unit_words(i.unit)) for name, i in one.parameters.items()
    )
    return Suspect(tuple((m, MEANING[m], CHECK[m]) for m in one.members), one.probability, values)


def difference(old: BatteryFile, new: BatteryFile) -> tuple[str, ...]:
    """Lines of the battery file that change, without hash and date."""
    before, after = _text(old).splitlines(), _text(new).splitlines()
    changes = difflib.unified_diff(before, after, "before", "after", lineterm="", n=1)
    return tuple(changes)


def _text(file: BatteryFile) -> str:
    content: dict[str, Any] = msgspec.to_builtins(file)
    for key in ("content_sha256", "date", "tool_version"):
        content["certificate"].pop(key, None)
    return tomli_w.dumps(_without_none(content))


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_none(v) for k, v in value.items() if v is not None}
    return [_without_none(v) for v in value] if isinstance(value, list) else value
