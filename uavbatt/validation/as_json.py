"""A validation as plain values for JSON: every number that the stage found, unknown (NaN, infinity) as null."""

from __future__ import annotations

from typing import Any

from uavbatt.files import plain
from uavbatt.validation.study.paper import PaperReplay
from uavbatt.validation.validate import Validation


def to_builtins(validation: Validation, paper: PaperReplay | None = None) -> dict[str, Any]:
    """Turn `validation`, and the study's method replayed if it is given, into JSON values.

    `claims` are the shipped model's, `rivals` the other models with theirs. The readings themselves are named by
    their hash, not repeated; the held-out ones stand beside their predictions in `held_out`.
    """
    dataset = validation.dataset
    out: dict[str, Any] = {
        "verdict": validation.verdict,
        "method": validation.method,
        "dataset": {
            "name": dataset.name,
            "source": dataset.source,
            "cells_series": dataset.cells_series,
            "cutoff_V": dataset.cutoff_V,
            "capacity_Ah": dataset.capacity_Ah,
            "runs": len(dataset.runs),
            "ambients_C": plain(dataset.ambients_C),
            "sha256": dataset.sha256,
            "uncertainty": plain(dataset.uncertainty),
            "flags": plain(dataset.flags),
        },
    }
    for name in ("ambient_C", "limits", "claims", "findings", "precision", "drifts", "corridors", "surface_corridors"):
        out[name] = plain(getattr(validation, name))
    out["held"] = plain(validation.held)
    pairs = zip(validation.rivals, validation.rival_claims, strict=True)
    out["rivals"] = [{"held": plain(held_out), "claims": plain(claims)} for held_out, claims in pairs]
    out["temperatures"] = plain(validation.temperatures)
    out["battery"] = plain(validation.battery)
    out["paper"] = plain(paper)
    return out
