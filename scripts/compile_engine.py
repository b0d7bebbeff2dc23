"""Compile the engine and keep it in the cache folder: a test run does it once and beside mypy, not in each process."""

from __future__ import annotations

from uavbatt import compiled
from uavbatt.battery.battery_file import read_battery
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.estimator import Estimator
from uavbatt.records import Sample


def main() -> None:
    estimator = Estimator(read_battery("lipo-generic"), PackOptions(4, 5.0, 13.2), engine=compiled.engine())
    for _ in estimator.run([Sample(float(second), 16.4, 20.0) for second in range(60)]):
        pass  # the first forecasts are among them


if __name__ == "__main__" and compiled.is_available():
    main()
