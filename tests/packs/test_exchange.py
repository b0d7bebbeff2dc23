"""One pack as a file: from one ledger to another, and what is refused."""

from __future__ import annotations

import json

import pytest
from packs.made import flight

from uavbatt.errors import BadInput
from uavbatt.packs.exchange import import_pack, plain_pack, read_pack, text_of
from uavbatt.packs.ledger import Ledger

FLIGHTS = [flight(k, 1.0 + 0.02 * k, 1.0 - 0.01 * k, cycles=30 + k) for k in range(3)]


@pytest.fixture
def pack_file(tmp_path):
    path = tmp_path / "A.json"
    with Ledger(tmp_path / "first.sqlite") as ledger:
        ledger.save_all("A", FLIGHTS)
        path.write_text(text_of(plain_pack(ledger, "A")), "utf-8")
    return path


def test_a_pack_arrives_as_it_left(tmp_path, pack_file):
    with Ledger(tmp_path / "first.sqlite") as first, Ledger(tmp_path / "second.sqlite") as second:
        assert import_pack(second, read_pack(pack_file)) == "A"
        assert repr(second.pack("A")) == repr(first.pack("A"))


def test_taking_a_pack_in_twice_counts_its_flights_once(tmp_path, pack_file):
    with Ledger(tmp_path / "second.sqlite") as ledger:
        import_pack(ledger, read_pack(pack_file))
        import_pack(ledger, read_pack(pack_file))
        assert ledger.pack("A").outlook.flights == len(FLIGHTS)


def changed(content, **values):
    return {**content, "flights": [{**content["flights"][0], **values}]}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: [], "a pack as `uavbatt packs --export` writes it"),
        (lambda c: {**c, "version": 9}, "version 1, with at least one flight"),
        (lambda c: changed(c, told=[0.0, 1.0, -1.0, 1.0, 0.0]), "flight 1, key told: expected variances above zero"),
        (lambda c: changed(c, told=[1e9, 1.0, 1.0, 1.0, 0.0]), "flight 1, key told: expected ohms and ampere-hours"),
        (lambda c: changed(c, start_utc_s=1e308), "flight 1, key start_utc_s: expected 0 to 2.5e"),
        (lambda c: changed(c, start_utc_s=-1.0), "key start_utc_s"),
        (lambda c: changed(c, duration_s=-1.0), "key duration_s: expected 0 to"),
        (lambda c: changed(c, soc_end=1e308), "key soc_end: expected 0 to 1, found 1e"),
        (lambda c: changed(c, soc_start=-0.5), "key soc_start"),
        (lambda c: changed(c, charge_Ah=1e308), "key charge_Ah"),
        (lambda c: changed(c, energy_Wh=-1.0), "key energy_Wh"),
        (lambda c: changed(c, temp_max_C=1e308), "key temp_max_C"),
        (lambda c: changed(c, temp_mean_C=-1e308), "key temp_mean_C"),
        (lambda c: changed(c, weak_cell=-1), "key weak_cell: expected 0 to 100, found -1"),
        (lambda c: changed(c, weak_cell_V=1e308), "key weak_cell_V"),
        (lambda c: changed(c, cycles=10**30), "key flights|key cycles|expected"),
        (lambda c: changed(c, cells=0), "key cells: expected 1 to 100"),
        (lambda c: changed(c, rated_Ah=1e308), "key rated_Ah"),
        (lambda c: changed(c, type_ohm=-1.0), "key type_ohm"),
        (lambda c: changed(c, rated_Ah="nan"), "key rated_Ah: expected 0.05 to 500, found nan"),
        (lambda c: {**c, "name": "a\nb"}, "key name: expected a name of 1 to 64 printable"),
        (lambda c: {**c, "flights": [*c["flights"], {**c["flights"][0], "cells": 5}]}, "flight 4, key cells"),
        (lambda c: changed(c, cells="four"), "key flights|Expected|expected"),
    ],
)
def test_a_file_that_is_no_pack_changes_nothing(tmp_path, pack_file, change, words):
    pack_file.write_text(json.dumps(change(json.loads(pack_file.read_text("utf-8")))), "utf-8")
    with Ledger(tmp_path / "second.sqlite") as ledger:
        with pytest.raises(BadInput, match=words):
            import_pack(ledger, read_pack(pack_file))
        assert ledger.packs() == []


def test_a_pack_that_is_not_there_is_named_with_those_that_are(tmp_path, pack_file):
    with Ledger(tmp_path / "first.sqlite") as ledger, pytest.raises(BadInput, match="a pack named B, found A"):
        plain_pack(ledger, "B")
