"""`uavbatt simulate`: a flight that never flew, as a log of any kind."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from uavbatt.cli.options import (
    DEFAULT_BATTERY,
    AmbientOption,
    BatteryOption,
    CapacityOption,
    CellsOption,
    CutoffOption,
    UncertifiedOption,
    check_writable,
    known,
    read_battery,
    remark,
)
from uavbatt.errors import UsageError


def simulate(
    output: Annotated[Path, typer.Option("-o", "--output", help="FILE.tlog, FILE.BIN or FILE.csv")],
    battery: BatteryOption = DEFAULT_BATTERY,
    power_w: Annotated[float, typer.Option("--power-w", min=1.0, help="Mean power of the flight [W].")] = 200.0,
    ambient_c: AmbientOption = 20.0,
    start_soc: Annotated[
        float, typer.Option("--start-soc", min=0.05, max=1.0, help="State of charge at take-off, 0..1.")
    ] = 1.0,
    effect: Annotated[list[str] | None, typer.Option("--effect", help="NAME=VALUE, may be repeated.")] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="The same seed, the same log.")] = 1,
    rate_hz: Annotated[float, typer.Option("--rate-hz", min=0.05, max=50.0, help="Rows of telemetry a second.")] = 2.0,
    cells: CellsOption = 4,
    capacity_ah: CapacityOption = 5.0,
    cutoff_voltage: CutoffOption = None,
    allow_uncertified: UncertifiedOption = False,
) -> None:
    """Simulate a flight of a battery file's own model until the pack is empty, and write it as a log."""
    from uavbatt.battery.scaling import pack_of
    from uavbatt.limits import OPTIONS, check_stated
    from uavbatt.simulate import Mission, fly, with_effects, write

    check_writable(output)
    content = read_battery(battery, allow_uncertified)
    series = cells or content.battery.cells_series
    share = series / content.battery.cells_series
    given_V, given_Ah = known(cutoff_voltage, "--cutoff-voltage"), known(capacity_ah, "--capacity-ah")
    check_stated(series, given_Ah, given_V, names=OPTIONS)
    cutoff_V = given_V if given_V == given_V else content.battery.cutoff_V * share
    low_V = (content.battery.low_V or float("nan")) * share
    pack = pack_of(content, series, given_Ah, cutoff_V, low_V)
    pack = with_effects(pack, dict(_effect(text) for text in effect or []))
    samples = fly(pack, Mission(power_w, ambient_c, start_soc, rate_hz, seed))
    write(output, samples, pack)
    remark(f"{output}: {len(samples)} rows, {samples[-1].time_s:.0f} s")


def _effect(text: str) -> tuple[str, float]:
    name, equals, value = text.partition("=")
    try:
        return name, float(value)
    except ValueError:
        raise UsageError(f"--effect {text}: expected NAME=VALUE" + ("" if equals else ", `=` is missing")) from None
