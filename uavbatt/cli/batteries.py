"""`uavbatt batteries`: the packaged battery files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from uavbatt.cli.options import check_writable, say


def batteries(
    as_json: Annotated[Path | None, typer.Option("--json", help="The list as JSON.")] = None,
) -> None:
    """List the packaged batteries that --battery takes by name.

    Example: uavbatt batteries
    """
    from uavbatt.battery import battery_file
    from uavbatt.files import write_json

    check_writable(as_json)
    found = [battery_file.read_battery(name) for name in battery_file.packaged()]
    for content in found:
        typed = content.battery
        size = f"{typed.cells_series}S" + (f" {typed.capacity_Ah:g} Ah" if typed.capacity_Ah else "")
        say(f"{typed.name:<14} {content.status:<10} {size:<12} {typed.chemistry}", as_json)
    if as_json is not None:
        write_json(as_json, [{"status": content.status, "battery": content.battery} for content in found])
