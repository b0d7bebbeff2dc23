"""The one list of messages that may be sent to an autopilot. No dependencies, because the proxy uses it too.

HEARTBEAT always (behind the proxy only with one of the two options below). With `--request` PARAM_REQUEST_READ, and
COMMAND_LONG for SET_MESSAGE_INTERVAL. With `--request-mission` the read half of the mission protocol. Never a message
that writes or commands, and never a battery message.
"""

from __future__ import annotations

HEARTBEAT, PARAM_REQUEST_READ, COMMAND_LONG = 0, 20, 76
MISSION_REQUEST_LIST, MISSION_ACK, MISSION_REQUEST_INT = 43, 47, 51
FOR_REQUEST = frozenset((PARAM_REQUEST_READ, COMMAND_LONG))
FOR_REQUEST_MISSION = frozenset((MISSION_REQUEST_LIST, MISSION_REQUEST_INT, MISSION_ACK))


def may_reach_autopilot(message_id: int, request: bool, request_mission: bool) -> bool:
    """Return True if a message of ours may travel towards the autopilot with these options."""
    if message_id == HEARTBEAT:
        return True
    return (request and message_id in FOR_REQUEST) or (request_mission and message_id in FOR_REQUEST_MISSION)
