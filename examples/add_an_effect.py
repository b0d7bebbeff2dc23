"""Switch an effect on in a battery file and see what it changes on a log.

    python examples/add_an_effect.py logs/quad_4s.tlog NEW.battery.toml harness_resistance harness_ohm=0.015

docs/nomenclature.md has the names and units. `uavbatt diagnose` finds an effect and its value from flights; here you
choose them yourself and see what they change. The new battery file says that it is not certified.
"""

from __future__ import annotations

import sys
from pathlib import Path

import msgspec

import uavbatt
from uavbatt.battery import battery_file
from uavbatt.battery.sections import BatteryFile, EffectEntry


def with_effect(file: BatteryFile, name: str, parameters: dict[str, float]) -> BatteryFile:
    """Return the file with one more effect, or with another size of one that it has."""
    others = [entry for entry in file.effects if entry.name != name]
    certificate = msgspec.structs.replace(file.certificate, status="generic", verdicts=[], validated_ambient_C=[])
    effects = [*others, EffectEntry(name=name, parameters=parameters)]
    return msgspec.structs.replace(file, effects=effects, certificate=certificate)


def main(log: str, new: str, name: str, *values: str) -> None:
    parameters = {key: float(value) for key, _, value in (text.partition("=") for text in values)}
    before = battery_file.read_battery("lipo-generic")
    battery_file.write_battery(with_effect(before, name, parameters), Path(new))
    after = battery_file.read_battery(new)  # raises BadInput for an unknown name or a value outside its bounds

    for words, file in (("without", before), (f"with {name}", after)):
        flown = uavbatt.replay(log, file, forecast_period_s=30.0)
        half = next((c for c in flown.outcome.checkpoints if c.label == "half time"), None)
        told = (
            f"half time: said {half.remaining_s:.0f} s, true {half.before_end_s:.0f} s" if half else "no end in the log"
        )
        print(f"{words}: mean NIS {flown.outcome.mean_nis:.2f}; {told}")


if __name__ == "__main__":
    if len(sys.argv) < 5:
        sys.exit(__doc__)
    try:
        main(*sys.argv[1:])
    except uavbatt.UavbattError as error:
        sys.exit(str(error))
