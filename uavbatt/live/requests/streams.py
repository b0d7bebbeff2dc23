"""Requests for the messages of route and place that a copter does not send (`--request`).

On a port of its own an ArduPilot sends little more than its heartbeat until somebody asks: without a position there is
no way home, and without the present item no route. Only a message that is not heard is asked for, so that no rate that
another program has set is changed, and a few times only: an autopilot without an estimate of the wind sends none.
"""

from __future__ import annotations

from uavbatt.mavlink.outgoing import Outgoing
from uavbatt.navigation import Navigation
from uavbatt.telemetry.route.messages import GLOBAL_POSITION_INT, HOME_POSITION, MISSION_CURRENT, WIND, WIND_COV

RATES_Hz = {GLOBAL_POSITION_INT: 2.0, MISSION_CURRENT: 1.0, HOME_POSITION: 0.2, WIND: 1.0, WIND_COV: 1.0}
SILENT_S = 10.0  # so long nothing was heard of it; slow streams come every 5 s
FIRST_PAUSE_S, MOST_ASKED = 5.0, 4


def unheard(navigation: Navigation, time_s: float, is_px4: bool) -> list[int]:
    """Return the messages of route and place that are not heard at the vehicle's time `time_s` [s]."""
    at = navigation.position
    is_heard = {
        GLOBAL_POSITION_INT: at is not None and time_s - at.time_s <= SILENT_S,
        MISSION_CURRENT: time_s - navigation.current_heard_s <= SILENT_S,
        HOME_POSITION: navigation.home is not None and not navigation.home.is_of_mission,
        WIND_COV if is_px4 else WIND: navigation.wind is not None,
    }
    return [message_id for message_id, heard in is_heard.items() if not heard]


class StreamRequests:
    """StreamRequests asks the autopilot for messages that are not heard, after pauses that grow."""

    def __init__(self) -> None:
        self._asked: dict[int, tuple[int, float]] = {}  # message -> times asked, next time [s]

    def frames(
        self, now_s: float, time_s: float, navigation: Navigation, is_px4: bool, component: int, out: Outgoing
    ) -> list[bytes]:
        """Return the requests that are due.

        now_s : monotonic [s]; time_s : the vehicle's time [s]; component : the autopilot's
        """
        made, missing = [], unheard(navigation, time_s, is_px4)
        for message_id in missing:
            times, next_s = self._asked.get(message_id, (0, now_s + FIRST_PAUSE_S))
            if times < MOST_ASKED and now_s >= next_s:
                made.append(out.interval_request(component, message_id, RATES_Hz[message_id]))
                times, next_s = times + 1, now_s + FIRST_PAUSE_S * 2.0**times
            self._asked[message_id] = times, next_s
        self._asked = {message_id: asked for message_id, asked in self._asked.items() if message_id in missing}
        return made
