"""Warnings of an estimate about the battery file, the temperature and the wear of the pack."""

from __future__ import annotations

import math

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.scaling import Pack
from uavbatt.battery.sizing.pack_size import PackSize
from uavbatt.estimation.summary import BeliefSummary
from uavbatt.notice import Kind, Notice
from uavbatt.records import PackFacts, Sample

ACTS_WITHIN = 0.1  # of the capacity: two minutes of a flight of twenty
ACTS_SOON = Notice("the autopilot will soon return or land by its own count of the charge", Kind.ACTS_SOON)
NOTICED_WEAR, WEAR_IS_SURE = 0.15, 2.5
BELOW_VALIDATED_K, ABOVE_VALIDATED_K = 5.0, 20.0  # a pack in flight is warmer than the air of its test


def remarks(
    battery: BatteryFile,
    size: PackSize,
    facts: PackFacts,
    sample: Sample,
    known: BeliefSummary,
    pack: Pack,
    *,
    is_metered: bool,
) -> tuple[str, ...]:
    """Return the warnings after a sample, from the belief's means in `known`.

    is_metered : a sensor measures the current; without one the wear of the pack cannot be told.
    """
    found = [size.uncertified] if size.uncertified else []
    validated, core_C = battery.certificate.validated_ambient_C, known.core_temp_C
    if validated and math.isfinite(core_C):
        low_C, high_C = min(validated) - BELOW_VALIDATED_K, max(validated) + ABOVE_VALIDATED_K
        if not low_C <= core_C <= high_C:  # without a number that changes, so that it is said once
            side = f"below {low_C:g}" if core_C < low_C else f"above {high_C:g}"
            found.append(f"pack {side} °C: outside the validated range")
    if not math.isfinite(sample.temp_C):
        found.append(Notice("no usable pack temperature", Kind.NO_TEMPERATURE))
    if pack.sag_compensated:
        found.append("the autopilot reports sag-compensated voltage (BATT_OPTIONS bit 6)")
    if is_metered and is_worn(known, battery) and battery.is_measured:
        found.append(
            "this pack has more resistance than its type: aged, or colder than it says; less charge is expected"
        )
    if facts.acts_below_soc > 0.0 and acts_soon(facts, sample):
        found.append(ACTS_SOON)
    return tuple(found)


def acts_soon(facts: PackFacts, sample: Sample) -> bool:
    """Return True if the autopilot will soon return or land by itself, because its own count of the charge says so.

    Its count may come to its end before the pack does.
    """
    counted = 1.0 - sample.consumed_Ah / facts.capacity_Ah
    soc = sample.reported_soc if math.isfinite(sample.reported_soc) else counted
    return sample.armed is not False and soc < facts.acts_below_soc + ACTS_WITHIN


def is_worn(known: BeliefSummary, battery: BatteryFile) -> bool:
    """Return True if the pack surely has more resistance than the packs of its type are spread by."""
    unusual = math.hypot(NOTICED_WEAR, battery.parameters.resistance_scale_sd)
    return known.wear > unusual and known.wear > WEAR_IS_SURE * known.wear_sd
