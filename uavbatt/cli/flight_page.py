"""The flight page as a file: the values of a replay handed to the report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.sizing import PackSize
from uavbatt.files import atomic_write
from uavbatt.log_replay import Outcome, Step
from uavbatt.records import Flight


def write(
    path: str | Path,
    flight: Flight,
    run: Sequence[Step],
    resolved: PackSize,
    outcome: Outcome,
    battery: BatteryFile,
) -> None:
    """Write the page of one replayed flight to `path` (`-`: standard output), whole or not at all."""
    from uavbatt.report.flight import flight_report

    html = flight_report(flight, run, resolved, outcome, battery)
    with atomic_write(path) as file:
        file.write(html)
