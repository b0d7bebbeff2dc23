"""`diagnose --packs`: what the flights before have shown of the pack is known, and is no missing effect."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest
from packs.made import flight as remembered_flight
from planted_flights import CAPACITY_AH, CELLS, FILE, MISSIONS, PACK, fly

from uavbatt.battery.remembered import type_ohm
from uavbatt.cli.diagnose_worn import base_pack
from uavbatt.diagnosis.diagnosis import diagnose
from uavbatt.errors import UsageError
from uavbatt.log_replay.run import engine_for
from uavbatt.packs.ledger import Ledger
from uavbatt.packs.records import FlightEvidence, FlightRecord
from uavbatt.records import Flight, Identity, Sample

FADE = 0.15
START_UTC_S = 1.8e9


def flight(serial: str = "A", start_utc_s: float = START_UTC_S) -> Flight:
    identity = Identity(battery_serial=serial, start_utc_s=start_utc_s)
    return Flight("a.tlog", "tlog", (Sample(0.0, 16.0, 10.0),), identity=identity)


def before(number: int) -> FlightRecord:
    """A flight of a faded pack, whose ohm·Ah is that of its type."""
    log_ohm, log_Ah = math.log(type_ohm(PACK) / (1.0 - FADE)), math.log((1.0 - FADE) * CAPACITY_AH)
    told = FlightEvidence(log_ohm, log_Ah, 0.02**2, 0.01**2, 0.0)
    size = {"cells": CELLS, "rated_Ah": CAPACITY_AH, "type_ohm": type_ohm(PACK)}
    return replace(remembered_flight(number), told=told, battery_sha256=FILE.certificate.content_sha256, **size)


@pytest.fixture
def packs(tmp_path: Path) -> Path:
    """A ledger that has met the pack five times."""
    path = tmp_path / "packs.sqlite"
    with Ledger(path) as ledger:
        ledger.save_all("A", [before(number) for number in range(5)])
    return path


def test_a_pack_that_was_met_before_is_worn_as_it_was_then(packs: Path) -> None:
    base = base_pack(packs, "", [flight()], FILE, PACK)
    assert base.pack.installation.present_capacity_Ah == pytest.approx((1.0 - FADE) * CAPACITY_AH, rel=0.03)
    assert "pack A: 4.2" in base.words
    assert base.wear_sd[0] > 0.0
    assert base_pack(None, "", [flight()], FILE, PACK).pack is PACK


def test_flights_before_the_first_one_only(packs: Path) -> None:
    base = base_pack(packs, "", [flight(start_utc_s=1.7e9), flight()], FILE, PACK)
    assert base.pack is PACK
    assert base.words == "pack A: no flight before these is remembered"


@pytest.mark.parametrize(
    ("serials", "words"), [([""], "expected logs with the pack's serial, or --pack NAME"), (["A", "B"], "found A, B")]
)
def test_flights_of_no_pack_or_of_several_are_named(packs: Path, serials: list[str], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        base_pack(packs, "", [flight(serial) for serial in serials], FILE, PACK)


def test_the_fade_that_is_known_is_no_missing_effect(packs: Path) -> None:
    records = [fly(*mission, fade=FADE) for mission in MISSIONS[:2]]
    base = base_pack(packs, "", [flight()], FILE, PACK)
    engine = engine_for(is_long=True)
    assert diagnose(records, FILE, PACK, engine=engine).verdict != "no_missing_effect"
    assert diagnose(records, FILE, base.pack, wear_sd=base.wear_sd, engine=engine).verdict == "no_missing_effect"
