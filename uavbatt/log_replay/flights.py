"""The flights of one log, each judged by itself: a pack that was changed or charged begins another one."""

from __future__ import annotations

from typing import NamedTuple

from uavbatt.log_replay.outcome import Outcome, outcome
from uavbatt.log_replay.run import ReplayedRow
from uavbatt.records import Flight
from uavbatt.telemetry.discharges import of_discharges


class ReplayedFlight(NamedTuple):
    """ReplayedFlight holds a flight, its replayed rows, and what came of it."""

    flight: Flight
    run: list[ReplayedRow]
    outcome: Outcome


def flights_of(whole: ReplayedFlight, cutoff_V: float) -> list[ReplayedFlight]:
    """Return each flight of a replayed log, whose pack has this cut-off [V]; the log as it is if it is one flight."""
    parts = of_discharges(whole.flight)
    if parts[0] is whole.flight:
        return [whole]
    found = []
    for part in parts:
        first_s, last_s = part.samples[0].time_s, part.samples[-1].time_s
        run = [row for row in whole.run if first_s <= row.estimate.time_s <= last_s]
        found.append(ReplayedFlight(part, run, outcome(run, cutoff_V, whole.outcome.reserve_soc)))
    return found
