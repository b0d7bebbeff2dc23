"""What many tests begin with: a pack of the packaged generic battery."""

from __future__ import annotations

from functools import cache

from uavbatt.battery import battery_file
from uavbatt.battery.scaling import Pack, pack_of


@cache
def generic_pack(cells: int = 4, capacity_Ah: float = 5.0, cutoff_V: float = 13.2, low_V: float = 14.0) -> Pack:
    """A pack of `lipo-generic`: 4S 5 Ah, cut-off 13.2 V and low-voltage warning 14.0 V of the pack if not said else."""
    return pack_of(battery_file.read_battery("lipo-generic"), cells, capacity_Ah, cutoff_V, low_V)
