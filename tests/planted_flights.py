"""Flights for the tests of diagnosis, from a simulator written out here, not the package's own; what is found."""

from __future__ import annotations

import math

import msgspec
import numpy as np

from uavbatt.battery import battery_file
from uavbatt.battery.battery_file import Wander
from uavbatt.battery.scaling import cell_parameters
from uavbatt.battery.sizing.pack_size import PackOptions, pack_from
from uavbatt.diagnosis.diagnosis import Diagnosis, diagnose
from uavbatt.fitting.observed import ObservedRecord
from uavbatt.log_replay.run import engine_for

CELLS, CAPACITY_AH, CUTOFF_V = 4, 5.0, 13.2
GENERIC = battery_file.read_battery("lipo-generic")
# The planted flights are of this very pack: what is known of it is as good as a fit makes it.
FILE = msgspec.structs.replace(
    GENERIC,
    parameters=msgspec.structs.replace(
        GENERIC.parameters, resistance_scale_sd=0.06, capacity_scale_sd=0.02, standard_error={}
    ),
    discrepancy=msgspec.structs.replace(
        GENERIC.discrepancy,
        wander=Wander(
            soc=[0.0, 1.0], voltage_sd_V=[0.004, 0.004], voltage_time_s=120.0, voltage_noise_V=0.002, rest_sd_V=0.002,
            temperature_sd_K=0.2, temperature_time_s=600.0, temperature_noise_K=0.05,
        ),
    ),
)  # fmt: skip
PACK = pack_from(FILE, PackOptions(CELLS, CAPACITY_AH, CUTOFF_V))
MISSIONS = ((25.0, 150.0, 1), (8.0, 170.0, 2), (35.0, 185.0, 3), (17.0, 140.0, 4))
SOC = np.linspace(-0.05, 1.05, 221)


def fly(ambient_C: float, power_W: float, seed: int, **effect: float) -> ObservedRecord:
    """One flight in plain floats at 1 Hz by explicit steps: the battery's equations, not the package's code."""
    say = effect.get
    p = cell_parameters(FILE)
    random = np.random.default_rng(seed)
    fields = {k: float(v) for k, v in p._asdict().items() if np.ndim(v) == 0}
    capacity = CAPACITY_AH * (1.0 - say("fade", 0.0))
    soc, fast, slow, core, shown = 1.0, 0.0, 0.0, ambient_C, ambient_C
    gust, rows, under_s = 0.0, [], 0
    for second in range(4000):
        gust += -gust / 15.0 + 0.05 * random.standard_normal()
        watts = power_W * (1.0 + gust) if second >= 20 else 4.0
        kelvin = 1.0 / (core + 273.15) - 1.0 / 298.15
        ohm_Ah = float(np.interp(soc, SOC, p.r0_ohmAh)) * math.exp(fields["activation_K"] * kelvin)
        emf = float(np.interp(soc, SOC, p.ocv_V)) - fast - slow
        ohm = CELLS * ohm_Ah / capacity + say("harness", 0.0)
        amps = (CELLS * emf - math.sqrt(max((CELLS * emf) ** 2 - 4.0 * ohm * watts, 0.0))) / (2.0 * ohm)
        rate = amps / capacity
        drop = rate * ohm_Ah
        volts = CELLS * (emf - drop) - amps * say("harness", 0.0)
        cold = math.exp(fields["diffusion_activation_K"] * kelvin)
        reversible = say("entropy_VpK", 0.0) * (1.0 - soc) * (core + 273.15)
        heat = fields["heat_gain"] * rate * (drop + fast + slow + reversible)
        soc -= rate / 3600.0
        fast += (fields["polarisation_ratio"] * drop - fast) / fields["polarisation_tau_s"]
        slow += (fields["diffusion_ratio"] * drop * cold - slow) / fields["diffusion_tau_s"]
        core += (heat - fields["cooling_WpKAh"] * (core - ambient_C)) / fields["heat_capacity_JpKAh"]
        shown += (core - shown) / say("lag_s", fields["sensor_lag_s"])
        metered = (amps - say("unmetered_W", 0.0) / volts) * say("gain", 1.0) + say("offset_A", 0.0)
        noise = random.standard_normal(3) * np.array([0.02, 0.15, 0.1])
        seen, felt = volts + say("offset_V", 0.0), shown + say("offset_K", 0.0)
        rows.append((float(second), seen + noise[0], max(metered + noise[1], 0.0), felt + noise[2]))
        under_s = under_s + 1 if volts < CUTOFF_V else 0
        if under_s > 10:
            break
    time_s, voltage_V, current_A, temp_C = np.array(rows).T
    return ObservedRecord(f"flight {seed}", time_s, voltage_V, current_A, temp_C, math.nan, CELLS, CAPACITY_AH)


def found(records: list[ObservedRecord], *without: str) -> Diagnosis:
    return diagnose(records, FILE, PACK, without, engine=engine_for(is_long=True))
