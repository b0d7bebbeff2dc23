"""The process of `uavbatt live`, without the command-line library and the parts of filterpy that no flight uses.

That saves 60 MB in flight and half a second at the start.

Run by `uavbatt live` as `python -m uavbatt.cli.live_process`, with the configuration as JSON in $UAVBATT_LIVE.
"""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from uavbatt.errors import UavbattError, UsageError, terminal_line

if TYPE_CHECKING:
    from collections.abc import Sequence

    from uavbatt.battery.sizing.pack_size import PackOptions
    from uavbatt.live.config import Config, PackSection
    from uavbatt.mavlink.endpoint import Link
    from uavbatt.prediction.forecaster import ForecastSettings

CONFIG_VARIABLE = "UAVBATT_LIVE"
# Parts of filterpy that no flight uses, and the names that its filters import from them.
NOT_FLOWN = {"filterpy.stats": ("logpdf",), "filterpy.discrete_bayes": ()}


def run(config: Config) -> None:
    """Run the companion process until SIGTERM or SIGINT, or SIGHUP while the vehicle is not armed."""
    load_filterpy()
    from uavbatt.battery import battery_file
    from uavbatt.live import clock
    from uavbatt.live.daemon import Daemon
    from uavbatt.live.log import tell

    content = battery_file.read_battery(config.pack.battery, allow_uncertified=config.pack.allow_uncertified)
    if content.status == "edited":
        tell(f"{config.pack.battery}: {content.caveat}")
    options, settings = pack_and_forecasts(config.pack)
    link, stations = _links(config)
    daemon = Daemon(config, content, options, settings, link, stations)
    told: set[int] = set()
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):  # before this line each signal ends the process
        signal.signal(number, lambda signum, frame: told.add(signum))
    if config.http.listen:
        from uavbatt.live.feeds.web import serve

        serve(config.http, lambda: daemon.board, clock.now_s)
    tell(f"waiting for telemetry from {config.link.endpoint}; {_feeds(config)}")

    def is_stopped() -> bool:
        """Return True if the process must end; a hangup counts only while disarmed: a lost ssh ends no flight."""
        return bool(told - {signal.SIGHUP}) or (bool(told) and daemon.armed is not True)

    daemon.run(is_stopped)


def load_filterpy() -> None:
    """Load filterpy's Kalman filters before the first row, with empty modules in place of those in NOT_FLOWN.

    filterpy imports all its parts at once, and one of them imports scipy.stats: 43 MB and most of a second, for a
    likelihood that no flight uses. Only this process does so, because a program that uses `Estimator` may need all of
    filterpy. If a version of filterpy needs these parts, everything is loaded.
    """
    stand_ins = {name: ModuleType(name) for name in NOT_FLOWN if name not in sys.modules}
    for name, module in stand_ins.items():
        vars(module).update(dict.fromkeys(NOT_FLOWN[name]))
    sys.modules.update(stand_ins)
    try:
        import filterpy.kalman
    except ImportError:
        for name in [name for name in sys.modules if name.partition(".")[0] == "filterpy"]:
            del sys.modules[name]
        import filterpy.kalman  # noqa: F401


def _feeds(config: Config) -> str:
    from uavbatt.live.config import page_address

    words = [f"feed {', '.join(config.feed.kinds)} to {', '.join(config.link.gcs)}" if config.link.gcs else ""]
    words.append(f"page on {page_address(config.http.listen)}" if config.http.listen else "")
    words.append(_recording(Path(config.record.folder)) if config.record.folder else "")
    return "; ".join(word for word in words if word) or "no ground station (--gcs), no page (--http), no recording"


def _recording(folder: Path) -> str:
    """Return in words where the recording goes, or why it cannot; make the folder if it is missing."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        return f"cannot record into {folder}: {error.strerror}, trying again"
    return f"recording to {folder}" if os.access(folder, os.W_OK) else f"cannot record into {folder}: trying again"


def _links(config: Config) -> tuple[Link, Sequence[Link]]:
    """Return the links to the autopilot and to the ground stations; with the proxy, one link to the proxy."""
    from uavbatt.mavlink.links import check_endpoint, open_autopilot, open_link

    autopilot = check_endpoint(config.link.endpoint)
    for text in config.link.gcs:
        station = check_endpoint(text)
        if (station.host, station.port) == (autopilot.host, autopilot.port):
            raise UsageError(f"--gcs {text}: expected a ground station's address, it is the autopilot's ENDPOINT")
    if "proxy" not in config.feed.kinds:
        return open_autopilot(config.link.endpoint), [open_link(text) for text in config.link.gcs]
    from uavbatt.live.feeds.proxy import ProxySettings
    from uavbatt.live.feeds.proxy_client import ProxyClient, control_path

    link, feed = config.link, config.feed
    control = feed.proxy_control or control_path(link.endpoint)
    asks = (link.request, link.request_mission)
    return ProxyClient(ProxySettings(link.endpoint, link.gcs, control, *asks, soc=feed.proxy_soc)), ()


def pack_and_forecasts(pack: PackSection) -> tuple[PackOptions, ForecastSettings]:
    """Return the pack and the forecasts as the configuration states them. Raises UsageError for `--load log`."""
    from uavbatt.battery import vehicle_file
    from uavbatt.battery.sizing.pack_size import PackOptions
    from uavbatt.log_replay.load_options import stated_load
    from uavbatt.prediction.forecaster import ForecastSettings
    from uavbatt.records import NAN, Flight

    if pack.load == "log":
        raise UsageError("--load log: expected learned, recent or watts; in flight there is no log of the load to come")
    flown = vehicle_file.read_vehicle(Path(pack.vehicle)) if pack.vehicle else None
    chosen = stated_load(pack.load, Flight("live", "live", ()), flown)
    options = PackOptions(
        cells=pack.cells,
        capacity_Ah=pack.capacity_Ah or NAN,
        cutoff_V=pack.cutoff_voltage_V or NAN,
        ambient_C=NAN if pack.ambient_C is None else pack.ambient_C,
    )
    return options, ForecastSettings(chosen, pack.reserve_soc, pack.forecast_period_s)


def main() -> int:
    """Run the process with the configuration in $UAVBATT_LIVE; return its exit code, after one line for an error."""
    import msgspec

    from uavbatt.live.config import Config

    try:
        run(msgspec.json.decode(os.environ.pop(CONFIG_VARIABLE, "{}"), type=Config))
    except UavbattError as error:
        print(terminal_line(f"uavbatt: {error}"), file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:  # before `run` has taken the signals over
        print("uavbatt: interrupted", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
