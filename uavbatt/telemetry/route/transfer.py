"""The mission protocol, overheard: which mission the autopilot has, by the transfers of other programs.

    download   autopilot: MISSION_COUNT, then MISSION_ITEM(_INT) on request; complete when every item was heard
    upload     station: MISSION_COUNT, MISSION_ITEM(_INT); counts after MISSION_ACK accepted of the autopilot
    partial    station: MISSION_WRITE_PARTIAL_LIST, some items; counts after the same
    clearing   station: MISSION_CLEAR_ALL; counts after the same

An upload that breaks off leaves a mixture in the autopilot: the old mission is kept, marked as in transfer.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from uavbatt.navigation import Mission, MissionItem
from uavbatt.telemetry.route import commands

TRANSFER_SILENT_S = 10.0  # a transfer that is silent for so long is over; autopilots give up after 8 s
ACCEPTED = 0
MOST_ITEMS = 5000


class Transfer:
    """Transfer follows one transfer of a mission; it remembers if the one before broke off."""

    def __init__(self) -> None:
        self._count: int | None = None
        self._is_upload = False
        self._items: dict[int, MissionItem] = {}
        self._is_clearing = False
        self._in_doubt = False  # an upload began and did not end well
        self._heard_s = -math.inf
        self._written_s = self._others_heard_s = -math.inf

    @property
    def is_open(self) -> bool:
        """Return True if a mission is being transferred, or if an upload broke off."""
        return self._count is not None or self._in_doubt

    def may_change(self, known: Mission | None) -> bool:
        """Return True if the mission may be another one after what is open; a station that reads it changes nothing."""
        is_read_again = known is not None and not self._is_upload and self._count == len(known.items)
        return self.is_open and (self._in_doubt or not is_read_again)

    def is_others(self, time_s: float) -> bool:
        """Return True if another station has been transferring a mission in the last seconds before `time_s` [s]."""
        return time_s - self._others_heard_s <= TRANSFER_SILENT_S

    def of_another(self, time_s: float) -> None:
        """Note a message of the mission protocol that is not between the autopilot and this process."""
        self._others_heard_s = time_s

    @property
    def missing(self) -> int | None:
        """Return the number of the first missing item of an open download; None without one."""
        if self._count is None or self._is_upload:
            return None
        return next((seq for seq in range(self._count) if seq not in self._items), None)

    def passes(self, time_s: float) -> None:
        """End a transfer that has been silent for more than TRANSFER_SILENT_S; `time_s` : the time now [s]."""
        if self._count is not None and time_s - self._heard_s > TRANSFER_SILENT_S:
            self._end(in_doubt=self._in_doubt or (self._is_upload and bool(self._items)))

    def begins(self, time_s: float, count: int, is_upload: bool, old: Sequence[MissionItem] = ()) -> None:
        """Begin a transfer of `count` items; items of `old` that are not sent stay."""
        if count > MOST_ITEMS:
            return
        self._in_doubt = self._in_doubt or (self._is_upload and bool(self._items) and self._count is not None)
        self._count, self._is_upload, self._heard_s = count, is_upload, time_s
        self._written_s = time_s if is_upload else self._written_s
        self._items = {item.seq: item for item in old}

    def takes(self, time_s: float, item: MissionItem, is_upload: bool) -> None:
        """Take an item, if it belongs to the open transfer."""
        if self._count is None or is_upload is not self._is_upload or item.seq >= self._count:
            return
        self._items[item.seq] = item
        self._heard_s = time_s
        self._written_s = time_s if is_upload else self._written_s

    def clears(self, time_s: float) -> None:
        """Note that another program asks the autopilot to delete its mission."""
        self._is_clearing, self._heard_s, self._written_s = True, time_s, time_s

    def whole(self, source: str, has_home_item: bool) -> Mission | None:
        """Return the mission of a download once it is complete, else None."""
        return None if self._is_upload else self._finished(source, has_home_item)

    def explains_acknowledgement(self, time_s: float) -> bool:
        """Return True if an acknowledgement at `time_s` [s] may belong to a transfer that was heard."""
        return self._is_clearing or time_s - self._written_s <= TRANSFER_SILENT_S

    def acknowledged(self, result: int, source: str, has_home_item: bool) -> Mission | None:
        """Return the mission that the autopilot has accepted with this acknowledgement; None if there is none."""
        if self._is_clearing:
            self._is_clearing = False
            if result == ACCEPTED:
                self._in_doubt = False
                return commands.mission((), source, has_home_item)
            return None
        if not self._is_upload or self._count is None:
            return None
        if result == ACCEPTED:
            return self._finished(source, has_home_item)
        self._end(in_doubt=self._in_doubt or bool(self._items))
        return None

    def _finished(self, source: str, has_home_item: bool) -> Mission | None:
        if self._count is None or len(self._items) < self._count:
            return None
        items = [self._items[seq] for seq in range(self._count)]
        self._end(in_doubt=False)
        return commands.mission(items, source, has_home_item)

    def _end(self, in_doubt: bool) -> None:
        self._count, self._items, self._in_doubt = None, {}, in_doubt
