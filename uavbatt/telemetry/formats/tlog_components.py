"""Batteries of a telemetry log that are MAVLink components of their own, beside the autopilot of the same system.

Such a component says by its heartbeat that it is a battery; the battery of a gimbal or a payload is none. The rules are
those of the live link: it speaks for the vehicle only if it did so before the autopilot reported a battery, and the
autopilot reported none in its first seconds. (The companion's own feed `battery`, which a ground station records, has
the same form, but begins after the autopilot.) A battery id that the autopilot reports is the autopilot's.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from uavbatt.mavlink import fields
from uavbatt.telemetry.builder import FALLBACK_AFTER_S
from uavbatt.telemetry.formats import tlog_payloads
from uavbatt.telemetry.formats.chain import Mask
from uavbatt.telemetry.formats.tlog_frames import FrameTable


class LoggedComponents(NamedTuple):
    """LoggedComponents holds the components whose batteries count.

    frames : mask of their frames that are read; sources : 256 * system + component; unused : (source, battery id) of
    messages of these components that do not count.
    """

    frames: Mask
    sources: set[int]
    unused: list[tuple[int, int]]


def battery_sources(found: FrameTable) -> set[int]:
    """Return the sources that say by a heartbeat that they are batteries and that send BATTERY_STATUS."""
    beating = found.of(fields.HEARTBEAT)
    is_battery = tlog_payloads.heartbeats(beating, fields.is_battery)
    return set(beating.source[is_battery].tolist()) & set(found.of(fields.BATTERY_STATUS).source.tolist())


def battery_components(found: FrameTable, autopilot: int) -> LoggedComponents:
    """Return the battery components that speak for the vehicle of this autopilot; none without an autopilot (-1)."""
    none = LoggedComponents(np.zeros(len(found.source), np.bool_), set(), [])
    sources = {source for source in battery_sources(found) if source >> 8 == autopilot >> 8 and source != autopilot}
    if not sources:
        return none
    told = dict(_told(found, autopilot))
    first_told = min(told.values(), default=len(found.source))
    first_s = found.time_s[found.source == autopilot][0]
    if told and found.time_s[first_told] - first_s < FALLBACK_AFTER_S:
        return none
    place = found.places(fields.BATTERY_STATUS)
    place = place[np.isin(found.source[place], list(sources))]
    numbers = tlog_payloads.KINDS[fields.BATTERY_STATUS].messages(found.at(place)).instance
    said = [*zip(found.source[place].tolist(), numbers.tolist(), strict=True)]
    early = set(found.source[place[place < first_told]].tolist())
    # reversed: of several components that send a battery id, the first to do so has it
    owners = {number: source for source, number in reversed(said) if source in early and number not in told}
    used = set(owners.values())
    chosen = none.frames.copy()
    chosen[place] = [owners.get(number) == source for source, number in said]
    chosen |= np.isin(found.source, list(used)) & np.isin(found.message_id, list(fields.IDENTITY_LENGTH))
    unused = [(s, number) for s, number in dict.fromkeys(said) if s in used and owners.get(number) != s]
    return LoggedComponents(chosen, used, unused)


def _told(found: FrameTable, autopilot: int) -> Iterator[tuple[int, int]]:
    """Yield the id and first place of each battery of which the autopilot itself sends a voltage."""
    for message_id, kind in tlog_payloads.KINDS.items():
        place = found.places(message_id)
        place = place[found.source[place] == autopilot]
        said = kind.messages(found.at(place))
        for number in set(said.instance[said.voltage_V > 0.0].tolist()):
            yield number, int(place[(said.instance == number) & (said.voltage_V > 0.0)][0])
