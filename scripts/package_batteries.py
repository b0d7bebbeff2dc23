#!/usr/bin/env python3
"""The battery files that come with the package: the study's pack through the gate, the generic ones from the priors.

    .venv/bin/python scripts/package_batteries.py

Run it after a change of the model, the prior or the gate, and commit what it writes.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

from uavbatt import dataset
from uavbatt.battery.battery_file import SUFFIX, write_battery
from uavbatt.fitting.generic import generic_lipo, generic_lithium_ion
from uavbatt.validation.validate import validate

FOLDER = Path(__file__).parents[1] / "uavbatt" / "data" / "batteries"


def main() -> None:
    """Write the files into the package; nothing if the study does not pass."""
    certified = validate(dataset.load()).battery
    if certified is None:
        sys.exit("the study's tests do not pass the gate: nothing is written")
    for battery in (certified, generic_lipo(), generic_lithium_ion()):
        print(write_battery(battery, FOLDER / f"{battery.battery.name}{SUFFIX}"))


if __name__ == "__main__":
    main()
