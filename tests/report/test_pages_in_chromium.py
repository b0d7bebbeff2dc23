"""Every page as a browser shows it, on a phone and on a desktop, light and dark: nobody is shut out of one.

No sideways scroll of the document, contrast of at least 4.5:1, letters of at least 12 px in drawings too, every table
within reach of the keyboard, `scope` on every heading of a table, a skip link, contents on long pages. What is asked
stands in `page_audit.js`; one Chromium serves all tests.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import numpy as np
import pytest
from browser import Browser
from cases import first_quick
from command import called
from daemon_bench import Bench
from live_rig import ROOT, free_port
from packs.made import flight as pack_flight
from report.test_report_validation import made as validated
from route_rig import planned, to

from uavbatt.battery import battery_file
from uavbatt.battery.sections import EffectEntry
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.diagnosis.classes import EffectClass, Interval
from uavbatt.diagnosis.close import ClosedLoop, HeldOutErrors
from uavbatt.diagnosis.diagnosis import Diagnosis
from uavbatt.diagnosis.refit.residual import Residual
from uavbatt.diagnosis.search.blocks import EvidenceBlock
from uavbatt.fleet.row import FlightRow
from uavbatt.live.config import HttpSection
from uavbatt.live.feeds.web import serve
from uavbatt.packs.ledger import Ledger
from uavbatt.records import Sample
from uavbatt.report.diagnosis import diagnosis_report
from uavbatt.report.fleet.fleet_page import fleet_report
from uavbatt.report.fleet.groups import gathered
from uavbatt.report.mission import mission_report
from uavbatt.report.validation.validation_page import validation_report

AUDIT = Path(__file__).with_name("page_audit.js").read_text("utf-8")
ROUTE = """QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t47.0\t8.0\t420\t1
1\t0\t3\t22\t0\t0\t0\t0\t0\t0\t20\t1
2\t0\t3\t16\t0\t0\t0\t0\t47.001\t8.0\t20\t1
"""
PACK = ("--battery", "lipo-generic", "--cells", "4", "--capacity-ah", "5", "--cutoff-voltage", "13.2")


def by_command(folder: Path, *call: str | Path) -> str:
    done = called(*call, "--report", "page.html", folder=folder)
    assert (folder / "page.html").exists(), done.stderr
    return (folder / "page.html").read_text("utf-8")


def flight(folder: Path) -> str:
    return by_command(folder, "replay", ROOT / "logs" / "quad_4s.tlog")


def route(folder: Path) -> str:
    (folder / "a.waypoints").write_text(ROUTE)
    called("simulate", "-o", "f.tlog", "--mission", "a.waypoints", "--wind", "4@0", folder=folder)
    return by_command(folder, "replay", "f.tlog")


def plan(folder: Path) -> str:
    return by_command(folder, "plan", *PACK, "--power-w", "180")


def mission(folder: Path) -> str:
    return mission_report(planned(to(1, 0.0, 6000.0, 40.0)), "far.waypoints")


def fleet(folder: Path) -> str:
    """Two packs, one that ages, flights with all that the list of those to look at knows, and logs that failed."""
    flown = [
        FlightRow(
            file=f"/logs/{serial}/0000{n}.BIN", aircraft=serial, battery_serial=serial, cells=4, capacity_Ah=5.0,
            certificate="generic", start_utc=f"2026-03-{n + 1:02d}T10:00:00Z", duration_s=900.0, energy_Wh=60.0,
            end_soc=0.3, resistance_scale=1.0 + growth * n, resistance_scale_sd=0.05, capacity_scale=1.0,
            capacity_scale_sd=0.04, error_120_s=4.0 * n, inside_120=True, look="landed nearly empty: 2 %" * (n > 7),
        )
        for serial, growth in (("ALPHA-000001", 0.05), ("BRAVO-000002", 0.0))
        for n in range(10)
    ]  # fmt: skip
    return fleet_report(gathered([*flown, FlightRow(file="x.BIN", status="bad", reason="no battery in it")]), "lipo")


def validation(folder: Path) -> str:
    return validation_report(validated())


def diagnosis(folder: Path) -> str:
    """A finding that two effects share, made up: a real one takes seconds of fitting."""
    old = battery_file.read_battery("lipo-generic")
    new = msgspec.structs.replace(
        old, effects=(*old.effects, EffectEntry(name="capacity_fade", parameters={"fade": 0.13}))
    )
    minutes, wave = np.arange(0.0, 900.0, 5.0), np.sin(np.arange(180.0) / 9.0)

    def residuals(volts: float) -> list[Residual]:
        rest = np.zeros(180, dtype=bool)
        columns = (minutes, volts * wave, 0.5 * wave, wave, wave, wave, wave, rest)
        return [Residual(f"/logs/a_rather_long_name_{k}.BIN", *columns) for k in range(4)]

    values = {"fade": Interval(0.13, 0.11, 0.16, "1"), "harness_ohm": Interval(0.012, 0.008, 0.016, "ohm")}
    blocks = tuple(EvidenceBlock(name, 90, saved) for name, saved in (("take-off", 40.0), ("last third", -3.0)))
    measured = SimpleNamespace(evidence=SimpleNamespace(has_temperature=False), tables=None)
    unused: Any = None
    found = Diagnosis(
        "effect_found", (EffectClass(("capacity_fade", "harness_resistance"), 0.8, values, "a bench test"),),
        ("the flights are short",), cast(Any, measured), unused, unused, residuals(0.08), residuals(0.01), 0.02, unused,
        blocks=blocks,
    )  # fmt: skip
    closed = ClosedLoop(HeldOutErrors(0.08, 0.7, 60.0, 0.4), HeldOutErrors(0.01, 0.7, 20.0, 0.9), ("a.BIN", "b.BIN"))
    return diagnosis_report(found, closed, old, new)


def packs(folder: Path) -> str:
    with Ledger(folder / "packs.sqlite") as ledger:
        for name, fade in (("UAVB-000001", 0.02), ("UAVB-000002", 0.0)):
            for k in range(6):
                ledger.save(name, pack_flight(k, 1.0 + fade * k, 1.0 - fade * k))
    return by_command(folder, "packs", "packs.sqlite")


PAGES = {page.__name__: page for page in (flight, route, plan, mission, fleet, validation, diagnosis, packs)}


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], str]:
    """The address of a page, which is made when it is first asked for."""
    made: dict[str, Path] = {}

    def address(name: str) -> str:
        if name not in made:
            made[name] = tmp_path_factory.mktemp(name) / "audited.html"
            made[name].write_text(PAGES[name](made[name].parent), "utf-8")
        return made[name].as_uri()

    return address


def complaints(browser: Browser, url: str, width: int) -> dict[str, Any]:
    found = {}
    for scheme in ("light", "dark"):
        browser.open(url, width, scheme)
        found[scheme] = browser.evaluate(AUDIT.replace("(WIDTH)", f"({width})"))
    return found


@pytest.mark.parametrize("width", first_quick(1, [390, 1280]))
@pytest.mark.parametrize("name", PAGES)
def test_a_page_shuts_nobody_out(browser: Browser, written: Callable[[str], str], name: str, width: int) -> None:
    assert complaints(browser, written(name), width) == {"light": [], "dark": []}


@pytest.mark.parametrize("state", ["waiting", "flying", "lost"])
def test_the_live_page_shuts_nobody_out(browser: Browser, state: str) -> None:
    pytest.importorskip("uvicorn")
    bench, port = Bench(), free_port()
    rest = Sample(0.0, 16.7, 0.1, 25.0, 0.0, armed=False)
    air = [replace(rest, time_s=k / 2, voltage_V=16.0, current_A=12.0, armed=True) for k in range(10, 40)]
    bench.play([replace(rest, time_s=k / 2) for k in range(10)] + (air if state != "waiting" else []))
    bench.now_s += 10.0 if state == "lost" else 0.1
    serve(HttpSection(listen=f"127.0.0.1:{port}"), lambda: bench.daemon.board, lambda: bench.now_s)
    for width in (390, 1280):
        assert complaints(browser, f"http://127.0.0.1:{port}/", width) == {"light": [], "dark": []}


@pytest.mark.parametrize(("capacity_Ah", "shown"), [(5.0, ("Cell voltage", 4.0)), (math.nan, ("Pack voltage", 16.0))])
def test_a_voltage_is_called_that_of_a_cell_only_if_the_cells_are_known(
    browser: Browser, capacity_Ah: float, shown: tuple[str, float]
) -> None:
    pytest.importorskip("uvicorn")
    bench, port = Bench(PackOptions(capacity_Ah=capacity_Ah)), free_port()
    bench.play([Sample(k / 2, 16.0, 12.0, 25.0, 0.0, armed=True) for k in range(30)])
    serve(HttpSection(listen=f"127.0.0.1:{port}"), lambda: bench.daemon.board, lambda: bench.now_s)
    browser.open(f"http://127.0.0.1:{port}/", 390, "light")
    label, value = (browser.evaluate(f"document.querySelector('[data-k={k}]').textContent") for k in ("volts", "cell"))
    assert (label, float(value.split()[0])) == shown


def test_the_cursor_moves_in_all_drawings_and_says_what_was_known_there(
    browser: Browser, written: Callable[[str], str]
) -> None:
    browser.open(written("flight"), 1280, "light")
    told = browser.evaluate(
        """(() => {
          document.querySelectorAll("details").forEach(d => { d.open = true; });
          const svg = document.querySelector(".wide svg"), box = svg.getBoundingClientRect();
          const at = share => { svg.dispatchEvent(new PointerEvent("pointermove",
            { clientX: box.left + share * box.width, clientY: box.top + 50, bubbles: true }));
            return document.querySelector("#instant output").textContent; };
          const said = [at(0.05), at(0.5)], lines = [...document.querySelectorAll("svg .cursor")];
          return JSON.stringify({ said, lines: lines.length, places: lines.map(l => l.getAttribute("x1")) });
        })()"""
    )
    seen = json.loads(told)
    ground, middle = seen["said"]
    assert ground.startswith("At 0:0") and "no forecast" in ground
    assert "left (" in middle and "% charge" in middle and "V" in middle
    assert seen["lines"] == 7 and len(set(seen["places"])) == 3  # the two sizes of one chart, and five alike


def test_a_span_of_time_is_shown_by_all_drawings_alike(browser: Browser, written: Callable[[str], str]) -> None:
    """By keyboard, by button, by dragging; the marks move inside their frame, and the axis says the new times."""
    browser.open(written("flight"), 1280, "light")
    told = browser.evaluate(
        """(() => {
          document.querySelectorAll("details").forEach(d => { d.open = true; });
          const slider = document.querySelector("#instant input"), wide = document.querySelector(".wide svg");
          const key = k => slider.dispatchEvent(new KeyboardEvent("keydown", { key: k, bubbles: true }));
          const seen = svg => [...svg.querySelectorAll(".ticks > g")].filter(g => getComputedStyle(g).display !== "none"
            ? g.querySelector("use") : false).map(g => g.textContent.trim());
          const words = () => [...wide.querySelectorAll(".words")].filter(g => getComputedStyle(g).display !== "none")
            .map(g => g.textContent.trim());
          const state = () => ({ words: words(), ticks: seen(wide), moved: [...document.querySelectorAll("svg .moves")]
            .map(g => Number((g.getAttribute("transform") || "matrix(1").slice(7).split(" ")[0]).toFixed(3)) });
          const drag = (from, to) => { const box = wide.getBoundingClientRect();
            for (const [kind, share] of [["pointerdown", from], ["pointermove", to], ["pointerup", to]])
              wide.dispatchEvent(new PointerEvent(kind, { clientX: box.left + share * box.width, clientY: box.top + 50,
                bubbles: true, pointerType: "mouse" })); };
          const found = { whole: state() };
          slider.value = Math.floor(slider.max / 2); slider.dispatchEvent(new Event("input"));
          key("+"); key("+"); found.closer = state();
          key("0"); found.back = state();
          document.querySelector("#instant button").click(); found.button = state();
          drag(0.2, 0.6); found.dragged = state();
          return JSON.stringify(found);
        })()"""
    )
    found = json.loads(told)
    assert set(found["closer"]["moved"]) == {"4.000"} and set(found["button"]["moved"]) == {"2.000"}
    assert set(found["back"]["moved"]) == {"1.000"} and found["back"]["ticks"] == found["whole"]["ticks"]
    minutes = [60 * int(m) + int(s) for m, s in (tick.split(":") for tick in found["closer"]["ticks"])]
    assert 3 <= len(minutes) <= 9 and minutes == sorted(minutes) and minutes[-1] - minutes[0] < 300
    assert set(found["closer"]["words"]) < set(found["whole"]["words"]) == set(found["back"]["words"])
    assert len(set(found["dragged"]["moved"])) == 1 and float(found["dragged"]["moved"][0]) > 4.0


@pytest.mark.parametrize("name", ["validation", "flight"])
def test_what_is_folded_on_the_screen_is_printed(browser: Browser, written: Callable[[str], str], name: str) -> None:
    browser.open(written(name), 1280, "light")
    folded = """(() => { const all = [...document.querySelectorAll("details:not([open]) > :not(summary)")];
        return JSON.stringify([all.length, all.filter(e => e.checkVisibility()).length]); })()"""
    count, seen = json.loads(browser.evaluate(folded))
    assert count > 1 and seen == 0
    browser.ask("Emulation.setEmulatedMedia", media="print")
    try:
        assert json.loads(browser.evaluate(folded)) == [count, count]
    finally:
        browser.ask("Emulation.setEmulatedMedia", media="")
