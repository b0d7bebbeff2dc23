"""A pack without a current sensor: the doubt about the load that is assumed for it.

The assumed power is that of a typical multirotor, within a factor of 1.6; a power that the caller states is right
within a fifth. Around its mean the load changes by a fifth for about a minute at a time. The filter treats errors of
blocks of two seconds as independent: so that their sum is as large, each counts as five times as much.
"""

from __future__ import annotations

import math
from dataclasses import replace

from uavbatt.battery.scaling import Pack
from uavbatt.notice import Kind, Notice
from uavbatt.records import NAN, Estimate, Status

ASSUMED_SD, STATED_SD = (0.5, 1.2), (0.2, 0.4)
ASSUMED = Notice("no current sensor: the load is assumed", Kind.NO_CURRENT)


def unmetered_pack(pack: Pack, *, is_stated: bool) -> Pack:
    """Return the pack with the doubt of a current that nobody measured; is_stated : the caller states the power.

    A current that is k times the assumed one is a capacity and an ohmic drop k times less: the filter doubts the
    capacity scale, which scales both, and the voltage's fall tells k as the flight goes on.
    """
    level_sd, about_it_sd = STATED_SD if is_stated else ASSUMED_SD
    resistance_scale_sd = math.hypot(pack.spread.resistance_scale_sd, level_sd)
    return pack._replace(
        spread=pack.spread._replace(
            resistance_scale_sd=resistance_scale_sd, capacity_scale_sd=level_sd, guess_sd=about_it_sd
        )
    )


def unmetered_estimate(found: Estimate) -> Estimate:
    """Return the estimate without the current that nobody measured; it is never `ok`."""
    found = replace(found, current_A=NAN, power_W=NAN)
    if found.status is not Status.OK:
        return found
    return replace(found, status=Status.CONVERGING, reason=ASSUMED)
