"""The flight page as a file: the values of a replay handed to the report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from uavbatt.aside import written_aside
from uavbatt.battery.file import BatteryFile
from uavbatt.pipeline import Resolved
from uavbatt.records import Flight
from uavbatt.replay import Outcome, Step


def write(
    path: str | Path,
    flight: Flight,
    run: Sequence[Step],
    resolved: Resolved,
    outcome: Outcome,
    battery: BatteryFile,
) -> None:
    """Write the page of one replayed flight to `path` (`-`: standard output), whole or not at all."""
    from uavbatt.report.flight import flight_report

    html = flight_report(flight, run, resolved, outcome, battery)
    with written_aside(path) as file:
        file.write(html)
