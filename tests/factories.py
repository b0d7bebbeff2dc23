"""What many tests begin with: a pack of the packaged generic battery, an estimator with it, the powers of a flight."""

from __future__ import annotations

from functools import cache

from uavbatt.battery import battery_file
from uavbatt.battery.remembered import PackHealth
from uavbatt.battery.scaling import Pack, pack_of
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.estimator import Estimator
from uavbatt.log_replay.run import engine_for
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.prediction.load.power_history import PowerHistory


@cache
def generic_pack(cells: int = 4, capacity_Ah: float = 5.0, cutoff_V: float = 13.2, low_V: float = 14.0) -> Pack:
    """A pack of `lipo-generic`: 4S 5 Ah, cut-off 13.2 V and low-voltage warning 14.0 V of the pack if not said else."""
    return pack_of(battery_file.read_battery("lipo-generic"), cells, capacity_Ah, cutoff_V, low_V)


def with_spread(pack: Pack, **changed: object) -> Pack:
    """The pack with other standard deviations, by the names of `spreads.Spread`."""
    return pack._replace(spread=pack.spread._replace(**changed))


def generic_estimator(options: PackOptions, period_s: float = 10.0, remembered: PackHealth | None = None) -> Estimator:
    """An estimator on `lipo-generic` for a stated pack, compiled where it can be; a forecast every `period_s` [s]."""
    settings = ForecastSettings(forecast_period_s=period_s)
    return Estimator(battery_file.read_battery("lipo-generic"), options, settings, engine_for(is_long=True), remembered)


def flown(*power_W: float, each_s: float = 5.0) -> PowerHistory:
    """A flight that has asked these powers, each for so long."""
    found = PowerHistory()
    for watts in power_W:
        found = found.after(watts, each_s)
    return found
