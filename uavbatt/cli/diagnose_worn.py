"""`diagnose --packs`: the wear of the pack before the diagnosed flights is known, so that it is no missing effect."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from uavbatt.errors import UsageError

if TYPE_CHECKING:
    from uavbatt.battery.battery_file import BatteryFile
    from uavbatt.battery.remembered import PackHealth
    from uavbatt.battery.scaling import Pack
    from uavbatt.records import Flight


class BasePack(NamedTuple):
    """A BasePack is the pack from which missing effects are searched: new, or as worn as earlier flights have shown.

    file : the battery file with that wear; wear_sd : sd of its fade and of its resistance growth; words : for the user
    """

    pack: Pack
    file: BatteryFile
    wear_sd: tuple[float, float] = (0.0, 0.0)
    words: str = ""


def base_pack(packs: Path | None, stated: str, flights: list[Flight], file: BatteryFile, pack: Pack) -> BasePack:
    """Return the pack with the wear before the first of these flights, if a ledger is given and has it.

    Raises UsageError if the flights are of several packs, or of one without a name.
    """
    from uavbatt.cli import pack_memory
    from uavbatt.packs.ledger import prior
    from uavbatt.packs.remembering import key_of

    with pack_memory.open_memory(packs, stated, only_read=True) as memory:
        if memory.ledger is None:
            return BasePack(pack, file)
        name = _name(flights, stated)
        first = min(flights, key=lambda flight: _moment(flight.identity.start_utc_s))
        start_utc_s = first.identity.start_utc_s
        last = memory.ledger.before(name, start_utc_s, key_of(first.samples))
    if last is None:
        return BasePack(pack, file, words=f"pack {name}: no flight before these is remembered")
    health = prior(last, start_utc_s, file.certificate.content_sha256)
    if not health.may_be(pack):
        return BasePack(pack, file, words=f"pack {name}: remembered with {health.cells} cells, not believed to be this")
    return _worn_pack(name, file, pack, health)


def _worn_pack(name: str, file: BatteryFile, pack: Pack, health: PackHealth) -> BasePack:
    from uavbatt.battery.remembered import type_ohm, wear_of
    from uavbatt.battery.scaling import pack_of
    from uavbatt.diagnosis.close import with_effects

    effects, wear_sd = wear_of(pack, health)
    worn, size = with_effects(file, effects, {}), pack.installation
    base = pack_of(worn, int(size.cells), float(size.capacity_Ah), pack.cutoff_V, pack.low_V)
    ohm = math.exp(health.log_ohm)
    words = (
        f"pack {name}: {math.exp(health.log_Ah):.2f} Ah and {1000.0 * ohm:.1f} mohm a cell "
        f"({ohm / type_ohm(pack):.0%} of its type) by the flights before are taken as known"
    )
    return BasePack(base, worn, wear_sd, words)


def _name(flights: list[Flight], stated: str) -> str:
    """Return the name of the pack of all flights."""
    from uavbatt.packs.remembering import name_of

    names = sorted({name_of(flight, stated) for flight in flights})
    if names == [""] or not names:
        raise UsageError("--packs: expected logs with the pack's serial, or --pack NAME")
    if len(names) > 1:
        listed = ", ".join(name or "no serial" for name in names)
        raise UsageError(f"--packs: expected flights of one pack, found {listed}")
    return names[0]


def _moment(start_utc_s: float) -> float:
    return start_utc_s if math.isfinite(start_utc_s) else math.inf
