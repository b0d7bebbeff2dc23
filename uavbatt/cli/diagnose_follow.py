"""`uavbatt diagnose --follow`: which effect began in which flight of a pack, and does it grow?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uavbatt.cli.diagnose_records import (
    DiagnoseOptions,
    ProgressLine,
    flown_size,
    observed_of,
    one_size,
    reason_written,
    with_known_start,
)
from uavbatt.cli.logs import asked_flights, data_sets_and_logs
from uavbatt.cli.options import ResultFiles, remark
from uavbatt.cli.pack_memory import open_memory, unknown_pack
from uavbatt.errors import NotEnoughData, UsageError
from uavbatt.packs.dates import date_text
from uavbatt.records import Flight

if TYPE_CHECKING:
    from uavbatt.battery.battery_file import BatteryFile
    from uavbatt.battery.sizing.pack_size import PackOptions
    from uavbatt.diagnosis.follow import Follow, FollowedEffect
    from uavbatt.packs.ledger import Ledger


def follow_and_tell(sources: Sequence[Path], options: DiagnoseOptions, files: ResultFiles) -> None:
    """Follow the flights and write the result. Raises NotEnoughData with the reason, which is also in the JSON."""
    flights = _in_order(_read(sources, options.instance), options.ledger, options.pack_name)
    with reason_written(files):
        found = _follow(flights, options.battery, options.pack, options.without)
    dates = _dates(found, flights)
    for line in _lines(found, dates):
        files.say(line)
    files.write_json(_as_json(found, dates, options.battery.status))
    if files.page is not None:
        from uavbatt.report.follow import follow_report
        from uavbatt.report.page import write_page

        write_page(files.page, follow_report(found, dates, options.battery.battery.name))
        files.say(f"report: {files.page}")


def _read(sources: Sequence[Path], instance: int | None) -> list[Flight]:
    """Read the logs that are named, and those in folders, each once."""
    tests = next((source for source in sources if (source / "battery.toml").exists()), None)
    if tests is not None:
        raise UsageError(f"{tests}: a data set of bench tests: expected flights, which have an order of time")
    return asked_flights(data_sets_and_logs(sources)[1], instance)


def _in_order(flights: list[Flight], packs: Path | None, pack: str) -> list[Flight]:
    """Return the flights in order of time: by the ledger, else by the logs' clocks, else as they were named."""
    if packs is not None and not pack:
        raise UsageError("--packs: expected --pack NAME as well, the pack to follow")
    with open_memory(packs, pack, only_read=True) as memory:
        if memory.ledger is not None:
            return _of_the_ledger(flights, memory.ledger, pack)
    starts = [f.identity.start_utc_s for f in flights]
    if all(math.isfinite(s) for s in starts):
        return sorted(flights, key=lambda f: f.identity.start_utc_s)
    remark("some logs have no date: the logs are taken in the order in which they are named")
    return flights


def _of_the_ledger(flights: list[Flight], ledger: Ledger, pack: str) -> list[Flight]:
    """Return those flights that are in the ledger under this pack, in its order."""
    from uavbatt.packs.remembering import key_of

    every = [after.flight for after in ledger.flights(pack)]
    if not every:
        raise unknown_pack(ledger, pack)
    keyed = [(key_of(f.samples), f) for f in flights]
    logs = [[f for key, f in keyed if was.is_of(key, f.identity.start_utc_s)] for was in every]
    its = [same[-1] for same in logs if same]
    if len(its) < len(flights):
        left_out = f"{len(flights) - len(its)} of {len(flights)} logs are left out"
        remark(f"{left_out}: the ledger has no such flight of {pack}")
    return its


def _follow(flights: list[Flight], content: BatteryFile, stated: PackOptions, without: tuple[str, ...]) -> Follow:
    from uavbatt.battery.sizing.pack_size import PackOptions, pack_from
    from uavbatt.diagnosis.follow import follow
    from uavbatt.log_replay.run import engine_for

    if not flights:
        raise NotEnoughData("no flight to follow")
    series, capacity_Ah, cutoff_V = one_size([flown_size(f, content, stated) for f in flights])
    records = with_known_start([observed_of(f, series, capacity_Ah) for f in flights])
    pack = pack_from(content, PackOptions(cells=series, capacity_Ah=capacity_Ah, cutoff_V=cutoff_V))
    with ProgressLine() as tell:
        return follow(records, content, pack, without, tell, engine_for(is_long=True))


def _dates(found: Follow, flights: list[Flight]) -> tuple[str, ...]:
    """Return the day of each followed flight; empty if its log has no date."""
    starts = {f.source: f.identity.start_utc_s for f in flights}
    return tuple(date_text(starts[name]) if math.isfinite(starts[name]) else "" for name in found.flights)


def _lines(found: Follow, dates: Sequence[str]) -> list[str]:
    """Return the course of each effect as lines of text."""
    from uavbatt.diagnosis.follow_words import course_words, size_words
    from uavbatt.diagnosis.words import MEANING

    said = {
        "no_missing_effect": "no effect has begun: the model explains every flight as well as it can",
        "effect_found": "an effect has begun",
        "undeclared_effect": "something is missing, and the effects below do not explain all of it",
    }
    lines = [f"{found.verdict}: {said[found.verdict]} ({len(found.flights)} flights)"]
    for one in found.effects:
        told = one.found
        lines.append(f"  {' or '.join(told.members)} (probability {told.probability:.2f}): {MEANING[told.members[0]]}")
        lines.append(f"    {course_words(one, found.flights, dates)}")
        lines.append(f"    {size_words(one)}")
        lines.append(f"    check: {told.would_separate}")
    lines += [f"  doubt: {reason}" for reason in found.reasons]
    lines += [f"  left out, too short: {name}" for name in found.left_out]
    return lines


def _as_json(found: Follow, dates: Sequence[str], status: str) -> dict[str, Any]:
    """Return the result for JSON: the keys of a diagnosis, with the course of each class."""
    flights = [{"file": name, "date": day or None} for name, day in zip(found.flights, dates, strict=True)]
    return {
        "verdict": found.verdict,
        "classes": [_class_json(one, flights) for one in found.effects],
        "reasons": list(found.reasons),
        "flights": flights,
        "left_out": list(found.left_out),
        "certificate_status": status,
        "battery_file": None,
    }


def _class_json(one: FollowedEffect, flights: list[dict[str, str | None]]) -> dict[str, Any]:
    from dataclasses import asdict

    since = {"flight": one.course.begins + 1, "earliest": one.earliest + 1, "latest": one.latest + 1}
    return {
        **asdict(one.found),
        "since": {**since, **flights[one.course.begins]},
        "grows": one.course.grows,
        "quantity": one.quantity,
        "off": one.off,
        "values": [asdict(value) for value in one.values],
    }
