"""`uavbatt packs`: the health of each pack in the ledger, its trend, and when to retire it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from uavbatt.cli.options import ReportOption, check_writable, remark, say
from uavbatt.errors import UavbattError, UsageError

MOST_NAMES = 10  # of known packs in an error

if TYPE_CHECKING:
    from uavbatt.packs.ledger import Ledger
    from uavbatt.packs.records import LedgerFlight, PackRow


def packs(
    ledger: Annotated[Path, typer.Argument(metavar="FILE.sqlite", help="The pack ledger.")],
    pack: Annotated[str, typer.Option("--pack", metavar="NAME", help="Only this pack, flight by flight.")] = "",
    summary: Annotated[Path | None, typer.Option("--json", help="The same as JSON.")] = None,
    report: ReportOption = None,
    forget: Annotated[str, typer.Option("--forget", metavar="NAME", help="Delete a pack with its flights.")] = "",
    export: Annotated[Path | None, typer.Option("--export", help="Write the pack of --pack to this file.")] = None,
    take_in: Annotated[Path | None, typer.Option("--import", help="Add the pack of an exported file.")] = None,
) -> None:
    """Show each pack of a ledger: capacity, resistance, trend, and when to retire it.

    Example: uavbatt packs packs.sqlite --report packs.html
    """
    from uavbatt.packs.ledger import Ledger

    check_writable(summary, report, export, reads=(ledger, take_in))
    if export is not None and not pack:
        raise UsageError("--export: expected --pack NAME as well, the pack to write")
    if forget or take_in is not None:
        _change(ledger, forget, take_in)
    with Ledger(ledger, only_read=True) as opened:
        if export is not None:
            _export(opened, pack, export)
        found = _chosen(opened, pack)
        flights = opened.flights(pack) if pack else []
        for line in _lines(found, flights):
            say(line, summary, report, export)
        if summary is not None:
            _write_summary(summary, found, flights)
        if report is not None:
            _write_report(report, opened, found)


def _change(path: Path, forget: str, take_in: Path | None) -> None:
    """Delete a pack, import a pack; a ledger that does not exist is refused before one is made."""
    from uavbatt.packs import exchange
    from uavbatt.packs.ledger import Ledger

    carried = exchange.read_pack(take_in) if take_in is not None else None
    if forget:
        Ledger(path, only_read=True).close()
    with Ledger(path) as ledger:
        if forget:
            if not ledger.forget(forget):
                raise UavbattError(f"{path}: expected a pack named {forget} to forget, found none")
            remark(f"{forget} is forgotten")
        if carried is not None:
            remark(f"{exchange.import_pack(ledger, carried)} is taken in")


def _export(ledger: Ledger, pack: str, path: Path) -> None:
    from uavbatt.files import atomic_write, json_for
    from uavbatt.packs.exchange import plain_pack, text_of

    content = plain_pack(ledger, pack)
    with atomic_write(path) as stream:
        stream.write(json_for(stream, text_of(content)))


def _chosen(ledger: Ledger, name: str) -> list[PackRow]:
    if not name:
        return ledger.packs()
    found = ledger.pack(name)
    if found is None:
        known = [pack.name for pack in ledger.packs()]
        there = f"{', '.join(known[:MOST_NAMES])}{', ...' if len(known) > MOST_NAMES else ''}" or "none"
        raise UavbattError(f"{ledger.path}: expected a pack named {name}, found {there}")
    return [found]


def _lines(found: list[PackRow], flights: list[LedgerFlight]) -> list[str]:
    """Return the packs as lines of text, and the flights of the pack that was asked for."""
    from uavbatt.packs.words import flight_line, pack_lines

    if not found:
        return [
            "no packs are remembered yet: `uavbatt replay LOG... --packs FILE` and `uavbatt live --packs FILE` do it"
        ]
    now_utc_s = time.time()
    lines = [line for pack in found for line in pack_lines(pack, now_utc_s)]
    return lines + [flight_line(after, now_utc_s) for after in flights]


def _write_summary(path: Path, found: list[PackRow], flights: list[LedgerFlight]) -> None:
    from uavbatt.files import write_json

    packs: list[dict[str, Any]] = [_plain(pack) for pack in found]
    if flights:
        packs[0]["history"] = [
            {"flight": after.flight, "known": after.known._asdict(), "findings": after.findings} for after in flights
        ]
    write_json(path, packs)


def _plain(pack: PackRow) -> dict[str, Any]:
    from dataclasses import asdict

    row = asdict(pack)
    return {**{k: v for k, v in row.items() if k not in ("outlook", "findings")}, **row["outlook"]} | {
        "findings": row["findings"]
    }


def _write_report(path: Path, ledger: Ledger, found: list[PackRow]) -> None:
    from uavbatt.report.packs import MOST_FIGURES, packs_report
    from uavbatt.report.page import write_page

    drawn = [(pack, ledger.flights(pack.name)) for pack in found[:MOST_FIGURES]]
    write_page(path, packs_report(str(ledger.path.name), found, drawn))
