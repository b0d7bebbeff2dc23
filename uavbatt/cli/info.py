"""`uavbatt info`: what a log holds, and whether a replay of it can be trusted."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from uavbatt.cli.logs import InstanceOption, SystemOption
from uavbatt.cli.options import say


def info(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="A log: .BIN, .log, .tlog, .ulg or CSV.")],
    instance: InstanceOption = None,
    system: SystemOption = None,
) -> None:
    """Show the batteries of a log, their rates and gaps, what is missing, and if a replay can be trusted.

    Example: uavbatt info flight.BIN
    """
    from uavbatt.telemetry import read_log
    from uavbatt.telemetry.quality.info import describe, lines

    for line in lines(describe(read_log(log, instance, system))):
        say(line)
