"""`uavbatt live`: the companion process beside the autopilot."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from uavbatt.cli.live_process import CONFIG_VARIABLE
from uavbatt.cli.options import BATTERY, RESERVE, UNCERTIFIED, CapacityOption, CellsOption, CutoffOption, stated_pack
from uavbatt.errors import UsageError

if TYPE_CHECKING:
    from uavbatt.live.config import Config


def live(
    endpoint: Annotated[
        str,
        typer.Argument(metavar="ENDPOINT", help="Telemetry: udpin:HOST:PORT, udpout:, tcp:, tcpin:, or DEVICE,BAUD."),
    ] = "",
    gcs: Annotated[list[str] | None, typer.Option("--gcs", help="Endpoint of a ground station.")] = None,
    feed: Annotated[list[str] | None, typer.Option("--feed", help="proxy, battery or named; may be repeated.")] = None,
    http: Annotated[str | None, typer.Option("--http", help="HOST:PORT of the page for a browser.")] = None,
    battery: Annotated[str | None, BATTERY] = None,
    cells: CellsOption = None,
    capacity_ah: CapacityOption = None,
    cutoff_voltage: CutoffOption = None,
    reserve_soc: Annotated[float | None, RESERVE] = None,
    allow_uncertified: Annotated[bool | None, UNCERTIFIED] = None,
    instance: Annotated[int | None, typer.Option("--instance", min=0, max=255, help="Only this battery.")] = None,
    vehicle: Annotated[str | None, typer.Option("--vehicle", help="Vehicle file of this aircraft.")] = None,
    load: Annotated[str | None, typer.Option("--load", help="The load to come: learned, recent, or watts.")] = None,
    packs: Annotated[
        str | None, typer.Option("--packs", metavar="FILE", help="Pack ledger (SQLite); made if missing.")
    ] = None,
    pack: Annotated[
        str | None, typer.Option("--pack", metavar="NAME", help="Name of the pack; default: its serial.")
    ] = None,
    mission: Annotated[
        str | None, typer.Option("--mission", help="Mission file (.waypoints, .plan); replaces the autopilot's.")
    ] = None,
    record: Annotated[str | None, typer.Option("--record", metavar="DIR", help="Folder for recordings.")] = None,
    state: Annotated[
        str | None, typer.Option("--state", metavar="FILE", help="File of the saved state, to go on after a crash.")
    ] = None,
    request: Annotated[bool | None, typer.Option("--request", help="Ask for rates and battery parameters.")] = None,
    request_mission: Annotated[
        bool | None, typer.Option("--request-mission", help="Ask the autopilot for its mission.")
    ] = None,
    system: Annotated[int | None, typer.Option("--system", min=1, max=255, help="Only this vehicle.")] = None,
    component: Annotated[
        int | None, typer.Option("--component", min=1, max=255, help="Only the autopilot with this component id.")
    ] = None,
    config: Annotated[Path | None, typer.Option("--config", help="uavbatt.toml; options override it.")] = None,
) -> None:
    """Estimate in flight: read the autopilot's telemetry, show the time left in a browser or a ground station.

    Every option has a key in the configuration file (--config, explained in scripts/uavbatt.toml and docs/live.md).

    Example: uavbatt live udpin:127.0.0.1:14551 --http 127.0.0.1:8080
    """
    from uavbatt.live.config import checked, read_config

    given: dict[str, dict[str, Any]] = {
        "link": {"endpoint": endpoint or None, "gcs": gcs or None, "request": request, "system": system}
        | {"component": component, "request_mission": request_mission},
        "pack": {"battery": battery, "cells": cells, "capacity_Ah": capacity_ah, "cutoff_voltage_V": cutoff_voltage}
        | {"reserve_soc": reserve_soc, "allow_uncertified": allow_uncertified, "instance": instance}
        | {"vehicle": vehicle, "load": load, "mission": mission},
        "packs": {"file": packs, "name": pack},
        "feed": {"kinds": feed or None},
        "http": {"listen": http},
        "record": {"folder": record},
        "state": {"file": state},
    }
    stated_pack(cells, capacity_ah, cutoff_voltage, reserve_soc or 0.0)
    for kind in feed or []:
        if kind not in ("proxy", "battery", "named"):
            raise UsageError(f"--feed {kind}: expected proxy, battery or named")
    merged = checked(_overridden(read_config(config), given))
    if feed and not merged.link.gcs:
        raise UsageError(f"--feed {feed[0]}: expected --gcs ENDPOINT, where the ground station is")
    _check_places(merged)
    _exec_live(merged)


def _overridden(config: Config, given: dict[str, dict[str, Any]]) -> Config:
    """Return the configuration with the options of the command line in place of its own."""
    from msgspec.structs import replace

    sections = {
        name: replace(getattr(config, name), **{key: value for key, value in keys.items() if value is not None})
        for name, keys in given.items()
    }
    return replace(config, **sections)


def _check_places(config: Config) -> None:
    """Raise UsageError if the recording folder is a file, the state file is a folder, or its folder does not exist."""
    folder, state = config.record.folder, config.state.file
    if folder and Path(folder).exists() and not Path(folder).is_dir():
        raise UsageError(f"--record {folder}: expected a folder, it is a file")
    if state and Path(state).exists() and not Path(state).is_file():  # the new state takes its place
        raise UsageError(f"--state {state}: expected a file, it is a folder, a device or a pipe")
    if state and not Path(state).parent.is_dir():
        raise UsageError(f"--state {state}: expected an existing folder to write into")


def _exec_live(config: Config) -> None:
    """Replace this process by `live_process`, so that the command-line library does not stay in memory."""
    import msgspec

    os.environ[CONFIG_VARIABLE] = msgspec.json.encode(config).decode()
    sys.stderr.flush()
    os.execv(sys.executable, [sys.executable, "-m", "uavbatt.cli.live_process"])
