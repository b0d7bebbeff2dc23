"""Time of the peers' turn-back, row by row: their rules for the way home, applied to their time left."""

from __future__ import annotations

import numpy as np
from peers.columns import armed
from peers.return_home import home_times, inav_turn_s, px4_turn_s

from scoring.lines import Lines
from scoring.peer_lines import INAV_CALIBRATED, PX4_CALIBRATED, PeerPack, peer_lines
from uavbatt.records import Flight


def turn_lines(pack: PeerPack, flight: Flight) -> dict[str, Lines]:
    """Return the time until one must turn back [s], by PX4's and by INAV's rule, both calibrated."""
    said = peer_lines(pack, flight.samples)
    px4, inav = said[PX4_CALIBRATED], said[INAV_CALIBRATED]
    home_s, run_s = home_times(flight.navigation_at, px4.time_s)
    is_armed = armed(flight.samples)
    flown_s = np.maximum(inav.time_s - inav.time_s[np.argmax(is_armed)], 0.0)
    return {
        PX4_CALIBRATED: Lines(px4.time_s, px4_turn_s(px4.remaining_s, home_s)),
        INAV_CALIBRATED: Lines(inav.time_s, inav_turn_s(inav.remaining_s, flown_s, run_s)),
    }
