"""Reading the mission from the autopilot, when the operator allows it (`--request-mission`): the protocol's read half.

    we         MISSION_REQUEST_LIST        again every LIST_PAUSE_S, a few times
    autopilot  MISSION_COUNT
    we         MISSION_REQUEST_INT 0       the lowest item that is missing; again after a pause that grows
    autopilot  MISSION_ITEM_INT 0 ...
    we         MISSION_ACK                 when the mission is whole, or when we break off

It asks while the autopilot's mission is not known. It never asks while another station is transferring a mission: then
it breaks off and waits until that station is silent. The answers are read like any other transfer on the link.
"""

from __future__ import annotations

from uavbatt.mavlink.outgoing import Outgoing
from uavbatt.telemetry.route.messages import NavigationListener

LIST_PAUSE_S, MOST_LIST_REQUESTS = 2.0, 3
ITEM_PAUSE_S, LONGEST_ITEM_PAUSE_S, MOST_ITEM_REQUESTS = 1.0, 4.0, 5
REST_S, LONGEST_REST_S = 10.0, 120.0  # pauses after a reading that failed


class MissionRequest:
    """MissionRequest asks the autopilot for its mission, item by item; `frames` is called every turn of the loop."""

    def __init__(self) -> None:
        self._is_reading = False
        self._seq: int | None = None  # the item that was asked for last; None: the number of items
        self._times = 0  # how often it was asked for
        self._next_s = float("-inf")
        self._rest_s = REST_S

    def frames(self, now_s: float, time_s: float, route: NavigationListener, component: int,
               out: Outgoing) -> list[bytes]:  # fmt: skip
        """Return the requests that are due.

        now_s : monotonic [s]; time_s : vehicle's time [s]; route : mission messages heard; component : the autopilot's
        """
        is_others = route.transfer.is_others(time_s)
        if self._is_reading:
            if not route.wants_mission:
                return self._end(now_s, component, out, is_whole=True)
            if is_others:
                return self._end(now_s, component, out, is_whole=False)
            return self._go_on(now_s, route.transfer.missing, component, out)
        if is_others or not route.wants_mission or now_s < self._next_s:
            return []
        self._is_reading, self._seq, self._times = True, None, 0
        return self._ask(now_s, None, component, out)

    def _go_on(self, now_s: float, missing: int | None, component: int, out: Outgoing) -> list[bytes]:
        """Ask for the missing item: at once if it is another than before, else again after a pause."""
        if missing != self._seq and missing is not None:
            self._times = 0
            return self._ask(now_s, missing, component, out)
        if now_s < self._next_s:
            return []
        if self._times >= (MOST_LIST_REQUESTS if self._seq is None else MOST_ITEM_REQUESTS):
            return self._end(now_s, component, out, is_whole=False)
        return self._ask(now_s, self._seq, component, out)

    def _ask(self, now_s: float, seq: int | None, component: int, out: Outgoing) -> list[bytes]:
        self._seq, self._times = seq, self._times + 1
        if seq is None:
            self._next_s = now_s + LIST_PAUSE_S
            return [out.mission_list_request(component)]
        self._next_s = now_s + min(ITEM_PAUSE_S * self._times, LONGEST_ITEM_PAUSE_S)
        return [out.mission_item_request(component, seq)]

    def _end(self, now_s: float, component: int, out: Outgoing, is_whole: bool) -> list[bytes]:
        """End the reading; a failed one is tried again after a pause that grows."""
        self._is_reading = False
        self._next_s = now_s + self._rest_s
        self._rest_s = REST_S if is_whole else min(2.0 * self._rest_s, LONGEST_REST_S)
        was_begun = is_whole or self._seq is not None
        return [out.mission_acknowledgement(component, is_whole)] if was_begun else []
