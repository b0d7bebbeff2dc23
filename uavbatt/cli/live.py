"""`uavbatt live`: the companion process beside the autopilot."""

from __future__ import annotations

import signal
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from uavbatt.cli.options import known
from uavbatt.errors import BadInput, UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from uavbatt.config import Config, PackSection
    from uavbatt.mavlink.endpoint import Link
    from uavbatt.pipeline import PackOptions


def live(
    endpoint: Annotated[
        str, typer.Argument(metavar="ENDPOINT", help="udpin:, udpout:, tcp:, tcpin: or a device.")
    ] = "",
    gcs: Annotated[list[str] | None, typer.Option("--gcs", help="Where a ground station is.")] = None,
    feed: Annotated[list[str] | None, typer.Option("--feed", help="proxy, battery or named; may be repeated.")] = None,
    http: Annotated[str | None, typer.Option("--http", help="HOST:PORT of the page for a browser.")] = None,
    battery: Annotated[str | None, typer.Option("--battery", help="Packaged battery, or a battery file.")] = None,
    cells: Annotated[int | None, typer.Option("--cells", min=1, max=100, help="Cells in series.")] = None,
    capacity_ah: Annotated[float | None, typer.Option("--capacity-ah", help="Capacity of the pack [Ah].")] = None,
    cutoff_voltage: Annotated[float | None, typer.Option("--cutoff-voltage", help="Ends the flight [V].")] = None,
    reserve_soc: Annotated[float | None, typer.Option("--reserve-soc", min=0.0, max=0.99)] = None,
    allow_uncertified: Annotated[bool | None, typer.Option("--allow-uncertified")] = None,
    instance: Annotated[int | None, typer.Option("--instance", min=0, max=255, help="Only this battery.")] = None,
    vehicle: Annotated[str | None, typer.Option("--vehicle", help="Vehicle file: how this aircraft flew.")] = None,
    load: Annotated[str | None, typer.Option("--load", help="learned, recent or watts.")] = None,
    record: Annotated[str | None, typer.Option("--record", metavar="DIR", help="Record into this folder.")] = None,
    state: Annotated[str | None, typer.Option("--state", metavar="FILE", help="State that survives a crash.")] = None,
    request: Annotated[
        bool | None, typer.Option("--request", help="Ask the autopilot for rate, parameters.")
    ] = None,
    system: Annotated[int | None, typer.Option("--system", min=1, max=255, help="Only this vehicle.")] = None,
    component: Annotated[int | None, typer.Option("--component", min=1, max=255)] = None,
    config: Annotated[Path | None, typer.Option("--config", help="uavbatt.toml; options override it.")] = None,
) -> None:
    """Estimate in flight: telemetry in, time left out (scripts/uavbatt.toml says more)."""
    from uavbatt.config import checked, read

    given: dict[str, dict[str, Any]] = {
        "link": {"endpoint": endpoint or None, "gcs": gcs or None, "request": request, "system": system}
        | {"component": component},
        "pack": {"battery": battery, "cells": cells, "capacity_Ah": capacity_ah, "cutoff_voltage_V": cutoff_voltage}
        | {"reserve_soc": reserve_soc, "allow_uncertified": allow_uncertified, "instance": instance}
        | {"vehicle": vehicle, "load": load},
        "feed": {"kinds": feed or None},
        "http": {"listen": http},
        "record": {"folder": record},
        "state": {"file": state},
    }
    known(capacity_ah, "--capacity-ah")
    known(cutoff_voltage, "--cutoff-voltage")
    for kind in feed or []:
        if kind not in ("proxy", "battery", "named"):
            raise UsageError(f"--feed {kind}: expected proxy, battery or named")
    _run(checked(_overridden(read(config), given)))


def _overridden(config: Config, given: dict[str, dict[str, Any]]) -> Config:
    """The configuration with what the command line says on top."""
    from msgspec.structs import replace

    sections = {
        name: replace(getattr(config, name), **{key: value for key, value in keys.items() if value is not None})
        for name, keys in given.items()
    }
    return replace(config, **sections)


def _run(config: Config) -> None:
    from uavbatt.battery import file
    from uavbatt.daemon import Daemon

    content = file.read(config.pack.battery, allow_uncertified=config.pack.allow_uncertified)
    options = pack_options(config.pack)
    link, stations = _links(config)
    stopped: list[int] = []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda signum, frame: stopped.append(signum))
    daemon = Daemon(config, content, options, link, stations)
    if config.http.listen:
        from uavbatt.feed.web import serve

        serve(config.http, lambda: daemon.board, time.monotonic)
    print(f"uavbatt: listening on {config.link.endpoint}; {_feeds(config)}", file=sys.stderr, flush=True)
    daemon.run(lambda: bool(stopped))


def _feeds(config: Config) -> str:
    words = [f"feed {', '.join(config.feed.kinds)} to {', '.join(config.link.gcs)}" if config.link.gcs else ""]
    words.append(f"page on http://{config.http.listen}/" if config.http.listen else "")
    words.append(f"recording to {config.record.folder}" if config.record.folder else "")
    return "; ".join(word for word in words if word) or "no ground station (--gcs), no page (--http), no recording"


def _links(config: Config) -> tuple[Link, Sequence[Link]]:
    """The way to the autopilot and to the ground stations; behind the proxy both are its business."""
    from uavbatt.mavlink.endpoint import parse
    from uavbatt.mavlink.links import open_link

    for text in (config.link.endpoint, *config.link.gcs):
        parse(text)
    if "proxy" not in config.feed.kinds:
        return open_link(config.link.endpoint), [open_link(text) for text in config.link.gcs]
    from uavbatt.feed.proxy import Settings
    from uavbatt.feed.proxy_client import ProxyClient, control_path

    link, feed = config.link, config.feed
    control = feed.proxy_control or control_path(link.endpoint)
    return ProxyClient(Settings(link.endpoint, link.gcs, control, link.request, feed.proxy_soc)), ()


def pack_options(pack: PackSection) -> PackOptions:
    """What the configuration states of the pack, for the estimator."""
    from uavbatt.battery import vehicle as vehicle_file
    from uavbatt.cli.loads import stated_load
    from uavbatt.pipeline import PackOptions
    from uavbatt.records import NAN, Flight

    if pack.load == "log":
        raise UsageError("--load log: expected learned, recent or watts; in flight no log knows what is to come")
    flown = vehicle_file.read(Path(pack.vehicle)) if pack.vehicle else None
    chosen = stated_load(pack.load, Flight("live", "live", ()), flown)
    if pack.forecast_period_s is not None and pack.forecast_period_s < 0.2:
        raise BadInput("uavbatt.toml", "key pack.forecast_period_s", "0.2 s or more")
    options = PackOptions(
        cells=pack.cells,
        capacity_Ah=pack.capacity_Ah or NAN,
        cutoff_V=pack.cutoff_voltage_V or NAN,
        reserve_soc=pack.reserve_soc,
        ambient_C=NAN if pack.ambient_C is None else pack.ambient_C,
        load=chosen,
    )
    if pack.forecast_period_s is None:
        return options
    from dataclasses import replace

    return replace(options, forecast_period_s=pack.forecast_period_s)
