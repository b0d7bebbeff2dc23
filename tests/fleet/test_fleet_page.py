"""The page of a fleet: what it says of packs that age, of flights to look at, and of nothing at all."""

from __future__ import annotations

import random
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from xml.etree import ElementTree

import pytest

from uavbatt.fleet.row import FlightRow
from uavbatt.records import NAN
from uavbatt.report.fleet.fleet_page import fleet_report
from uavbatt.report.fleet.groups import AgeingVerdict, Group, change, gathered, verdict


def rows(aircraft: str, growth: float, flights: int = 30, dated: bool = True, **more: object) -> list[FlightRow]:
    noise = random.Random(1)
    start = datetime(2025, 3, 1, tzinfo=UTC)
    return [
        FlightRow(
            file=f"/logs/{aircraft}/{n}.tlog",
            aircraft=aircraft,
            aircraft_from="--by",
            cells=4,
            capacity_Ah=5.0,
            certificate="fitted",
            start_utc=(start + timedelta(days=n)).strftime("%Y-%m-%dT%H:%M:%SZ") if dated else "",
            duration_s=900.0,
            energy_Wh=60.0,
            end_soc=0.3,
            resistance_scale=1.0 + growth * n / flights + noise.gauss(0, 0.02),
            resistance_scale_sd=0.08,
            capacity_scale=1.0 + noise.gauss(0, 0.01),
            capacity_scale_sd=0.04,
            **more,  # type: ignore[arg-type]
        )
        for n in range(flights)
    ]


def group(made: list[FlightRow]) -> Group:
    return next(iter(gathered(made).groups.values()))


def test_growth_is_told_and_noise_is_not() -> None:
    aged, steady = group(rows("heron", 0.4)), group(rows("swift", 0.0))
    grown, same = change(aged, aged.resistance), change(steady, steady.resistance)
    assert grown is not None and grown.is_certain and grown.difference == pytest.approx(0.27, abs=0.05)
    assert same is not None and not same.is_certain
    few = group(rows("plover", 0.4, flights=3))
    assert change(few, few.resistance) is None


def test_the_hours_of_a_pack_are_those_in_the_air() -> None:
    """A row without a current, or of a table of an earlier run, counts as long as its log is."""
    assert group([*rows("heron", 0.0, 4, air_s=600.0), *rows("heron", 0.0, 1)]).flown_s == 4 * 600.0 + 900.0


def test_a_growth_that_is_certain_stands_before_a_larger_one_that_may_be_chance() -> None:
    unsure = [replace(row, resistance_scale_sd=2.0) for row in rows("swift", 0.6)]
    page = fleet_report(gathered([*unsure, *rows("heron", 0.4)]), "x (fitted)")
    table = page[page.index("<tbody") :]
    assert table.index("heron") < table.index("swift")


def test_a_reason_names_its_first_three_logs_and_counts_all() -> None:
    bad = [FlightRow(file=f"/logs/b{n}.tlog", status="bad", reason="cut short") for n in range(5)]
    found = gathered([*bad, *rows("heron", 0.0, 4)])
    assert found.failures == {"cut short": 5} and found.failed == {"cut short": [row.file for row in bad[:3]]}
    assert "b0.tlog, b1.tlog, b2.tlog, …" in fleet_report(found, "x (fitted)")


def test_dates_order_the_flights_and_their_absence_does_not_matter() -> None:
    shuffled = rows("heron", 0.4)
    random.Random(2).shuffle(shuffled)
    dated, undated = group(shuffled), group(rows("heron", 0.4, dated=False))
    assert dated.is_dated and not undated.is_dated
    one, other = change(dated, dated.resistance), change(undated, undated.resistance)
    assert one is not None and other is not None
    assert one.difference == pytest.approx(other.difference)


def test_a_battery_with_a_serial_is_its_own_group_on_any_aircraft() -> None:
    found = gathered([*rows("a", 0.0, 4, battery_serial="77"), *rows("b", 0.0, 4, battery_serial="77")])
    (one,) = found.groups.values()
    assert one.name == "battery 77 (4S 5 Ah)" and one.flights == 8 and one.is_identified


def test_a_pack_s_resistance_is_a_line_in_the_table_where_it_has_a_history() -> None:
    page = fleet_report(gathered([*rows("heron", 0.4), *rows("plover", 0.4, flights=2)]), "x (fitted)")
    root = ElementTree.fromstring(page.partition("\n")[2])
    (line,) = [svg for svg in root.iter("svg") if svg.get("class") == "spark"]
    assert str(line.get("aria-label")).startswith("Resistance of heron (4S 5 Ah): 1.0")
    points = [point.split(",") for point in line.find("polyline").attrib["points"].split()]  # type: ignore[union-attr]
    assert len(points) == 30 and float(points[-1][1]) < float(points[0][1])  # upwards


def test_the_page_is_well_formed_whatever_files_are_called() -> None:
    bad = FlightRow(file="/x/<b>&\x07.BIN", status="bad", reason="expected <a log> & nothing else", look="x")
    scored = {"error_120_s": 30.0, "inside_120": True, "error_60_s": float("nan"), "inside_60": False}
    made = [
        *rows("heron $x$ <i>", 0.4),
        *rows("swift", 0.0, look="landed nearly empty: state of charge 0.02", **scored),
        bad,
    ]
    page = fleet_report(gathered(made), "x (fitted)", (("logs", "61"),))
    ElementTree.fromstring(page.replace("<!DOCTYPE html>", ""))
    assert "Resistance has grown in: heron" in page and "landed nearly empty: state of charge …" in page
    assert "expected &lt;a log&gt; &amp; nothing else" in page and "<script" not in page


def test_a_fleet_of_nothing_is_a_page_too() -> None:
    page = fleet_report(gathered([]), "x (generic)")
    ElementTree.fromstring(page.replace("<!DOCTYPE html>", ""))
    assert "no forecast can be checked" in page


def test_a_folder_is_no_aircraft_and_gets_no_verdict() -> None:
    loose = [replace(row, aircraft_from="folder") for row in rows("a", 0.4)]
    judged = group(loose)
    found = verdict(judged, change(judged, judged.resistance), change(judged, judged.capacity))
    assert found.kind == "cannot tell" and "--by" in found.words
    page = fleet_report(gathered(loose), "x (fitted)")
    assert "Resistance has grown" not in page and "one folder is not one aircraft" in page


def test_packs_of_another_size_are_never_one_group() -> None:
    mixed = [*rows("a", 0.0, 4), *(replace(row, capacity_Ah=3.0) for row in rows("a", 0.4, 4))]
    assert [g.flights for g in gathered(mixed).groups.values()] == [4, 4]


def test_a_verdict_knows_what_it_could_have_seen() -> None:
    def judged(values: list[tuple[float, float]]) -> AgeingVerdict:
        one = Group("p", resistance=values, capacity=[(1.0, 0.01)] * len(values), start_s=[NAN] * len(values))
        return verdict(one, change(one, one.resistance), change(one, one.capacity))

    noisy = judged([(1.82, 0.9), (1.9, 0.9), (2.0, 0.9), (2.04, 0.9), (1.7, 0.9), (2.2, 0.9)])
    assert noisy.kind == "cannot tell" and "not visible" in noisy.words
    quiet = judged([(1.0, 0.02), (1.01, 0.02), (1.0, 0.02), (1.01, 0.02), (0.99, 0.02), (1.0, 0.02)])
    assert quiet.kind == "steady" and "steady to within" in quiet.words
    assert judged([(1.0, 0.02)] * 3 + [(1.4, 0.02)] * 3).kind == "grown"
    assert judged([(1.0, 0.02)] * 3).words == "too few flights"


def test_at_most_one_flight_in_five_is_to_be_looked_at_the_gravest_first() -> None:
    made = [replace(row, look="flew on below the cut-off voltage") for row in rows("a", 0.0, 20)]
    made[13] = replace(made[13], look="landed nearly empty: state of charge 0.01")
    found = gathered(made)
    assert len(found.look) == 4 and found.looked == 20 and found.look[0].file == made[13].file


def test_a_few_flights_that_need_a_look_are_all_listed() -> None:
    """Of three, one was listed."""
    made = [replace(row, look="flew on below the cut-off voltage") for row in rows("a", 0.0, 3)]
    assert len(gathered(made).look) == 3


def test_a_fleet_of_failures_does_not_look_calm() -> None:
    page = fleet_report(gathered([FlightRow(file="a.BIN", status="bad", reason="no log")] * 3), "x (generic)")
    assert "None of 3 logs could be replayed" in page and 'class="answer bad"' in page and "0 need a look" not in page
