"""Flights and bench tests, prepared for the comparison with the model.

They are checked, binned, and get the whitening by which a misfit is judged (`whitening`), and the charge that each is
believed to start with.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import msgspec
import numpy as np
from numpy.typing import NDArray

from uavbatt.battery.battery_file import BatteryFile, Wander
from uavbatt.battery.initial_state import IDLE_C_RATE
from uavbatt.battery.model import Array
from uavbatt.diagnosis.refit import late_current
from uavbatt.diagnosis.refit.candidates import capacity_sd
from uavbatt.diagnosis.refit.meter_noise import noise_V, resting_noise_V
from uavbatt.diagnosis.refit.whitening import (
    Whitener,
    cold_factor,
    flight_error_V,
    quick_A,
    recovery_error_V,
    temperature_whitener,
    voltage_whiteners,
)
from uavbatt.errors import NotEnoughData
from uavbatt.fitting import observed, wander
from uavbatt.fitting.observed import ObservedRecord, Stack

FLATNESS_S = 6.0  # rows of a residual count by how flat the voltage is there, in the sizes that are shown
# A shorter record is not long against the correlation time of the error; with less charge drawn, no capacity shows.
SHORTEST_S, LEAST_DRAWN = 240.0, 0.15
LOADED_SHARE = 0.3  # of the upper current (90 % point): less is rest
LEAST_RECORDS, LEAST_CHANGE = 2, 0.04  # one record may have a peculiarity of its day; relative spread of the current
CLEARLY_NOT_FULL = 0.85  # of the charge: no voltage sensor that is nearly right shows less for a full pack
FULL_SD = 0.008  # of the charge of a full pack: chargers end at different currents
RESTED_SD, LOADED_SD = 0.03, 0.06  # of the charge that a first voltage shows: 12 and 24 mV of a cell on the plateau
START_OHMAH, LEAST_START = 0.05, 0.05  # of a cell that has just been loaded; no flight begins emptier
ZERO_C_RATE = 0.02  # an aircraft that flies draws a hundred times as much
IDLE_NOISE_A = 0.15  # at rest an offset of the current is known to within this


@dataclass(frozen=True, slots=True)
class Evidence:
    """Evidence holds records, in `stack` side by side, with their whitening.

    `shifted_A` [shifts, rows, records] is late current.
    `quick_A` [rows, records] is the part of the current to which the polarisation has not responded yet.

    `start_soc` and `start_sd` are the charge that each record is believed to start with and its sd.
    """

    records: tuple[ObservedRecord, ...]
    stack: Stack
    volts: tuple[Whitener, ...]
    temps: tuple[Whitener | None, ...]
    shifted_A: Array
    quick_A: Array
    known_ambient: Array
    start_soc: Array
    start_sd: Array
    full_soc: float
    charged_in_part: NDArray[np.bool_]  # rested well below full: the start is known to be another than believed
    familiar: NDArray[np.bool_]  # begins no colder than what the file's error was learned on
    shows_delay: bool  # rows come often enough to tell a late current from the instant of a step of the load

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the records."""
        return self.stack.names

    @property
    def believed_full(self) -> Evidence:
        """Return the same records, those charged in part believed to have started full, whatever their voltage says."""
        full = self.charged_in_part
        return replace(
            self,
            start_soc=np.where(full, self.full_soc, self.start_soc),
            start_sd=np.where(full, FULL_SD, self.start_sd),
            charged_in_part=np.zeros_like(full),
        )

    @property
    def has_temperature(self) -> bool:
        """Return True if every record has a temperature."""
        return all(t is not None for t in self.temps)


def idle_A(evidence: Evidence) -> float:
    """Return the smallest mean current [A] that the sensor reports before take-off; inf if no record begins at rest."""
    stack = evidence.stack
    idle = np.abs(stack.current_A) < IDLE_C_RATE * stack.capacity_Ah
    lengths = np.argmin(idle, axis=0)  # rows before the first under load
    means = [float(np.mean(stack.current_A[:n, j])) for j, n in enumerate(lengths) if n and idle[0, j]]
    return min(means, default=float("inf"))


def check_records(records: list[ObservedRecord]) -> None:
    """Raise NotEnoughData, with the reason, when the records cannot tell effects apart."""
    if not records:
        raise NotEnoughData("no record has a measured current, and diagnose needs one")
    sizes = {(r.cells, round(r.capacity_Ah, 2)) for r in records}
    if len(sizes) > 1:
        listed = ", ".join(f"{n}S {q:g} Ah" for n, q in sorted(sizes))
        raise NotEnoughData(f"the records are of different packs ({listed}): expected flights of one")
    if all(np.nanmax(np.abs(r.current_A)) < ZERO_C_RATE * r.capacity_Ah for r in records):
        raise NotEnoughData("the current is zero throughout: expected a working current sensor")
    useful = [r for r in records if _long_enough(r)]
    if len(useful) < LEAST_RECORDS and (not useful or not np.isfinite(useful[0].ambient_C)):
        raise NotEnoughData(
            f"{len(useful)} of {len(records)} records last {SHORTEST_S:.0f} s and draw {LEAST_DRAWN:.0%} of the "
            f"charge: expected at least {LEAST_RECORDS}, to check that each shows the same"
        )
    if _change(useful) < LEAST_CHANGE:
        raise NotEnoughData("the load is constant: expected changes of current, because causes look alike without them")


def _long_enough(record: ObservedRecord) -> bool:
    drawn_Ah = float(np.sum(record.current_A[1:] * np.diff(record.time_s))) / 3600.0
    return record.time_s[-1] - record.time_s[0] >= SHORTEST_S and drawn_Ah >= LEAST_DRAWN * record.capacity_Ah


def _change(records: list[ObservedRecord]) -> float:
    """Return the relative spread of the current under load over all records, without the rows at rest."""
    loads = []
    for record in records:
        binned = observed.binned(record).current_A
        loads.append(binned[binned > LOADED_SHARE * np.percentile(binned, 90)] / record.capacity_Ah)
    together = np.concatenate(loads)
    return float(np.std(together) / np.mean(together))


def prepare(
    records: list[ObservedRecord], file: BatteryFile, ocv_soc: tuple[Array, Array], polarisation_tau_s: float
) -> Evidence:
    """Check, bin and whiten the records. Raises NotEnoughData when they cannot tell effects apart.

    ocv_soc : (soc, OCV [V] of a cell) of the battery file, ascending; polarisation_tau_s : its time constant [s]
    """
    check_records(records)
    records = sorted((r for r in records if _long_enough(r)), key=_content)
    spread = _wander(file, float(records[0].cells))
    ohm = float(np.mean(file.parameters.resistance_ohmAh)) * records[0].cells / records[0].capacity_Ah
    stack = observed.stack(records, timing_sd_s=FLATNESS_S)
    steep_V, resting_V = _steep_V(file, ocv_soc, records[0].cells), resting_noise_V(records)
    noises_V = [(noise_V(r, ohm), resting_V) for r in records]
    full_soc = spread.start_soc or 1.0
    start_soc, start_sd, in_part = _starts(stack, ocv_soc, full_soc)
    in_flight_V = flight_error_V(stack, spread, start_soc, (ocv_soc[0], steep_V))
    return Evidence(
        records=tuple(records),
        stack=stack,
        volts=voltage_whiteners(stack, in_flight_V, recovery_error_V(stack, ohm), spread, noises_V),
        temps=tuple(temperature_whitener(stack, j, spread, r) for j, r in enumerate(records)),
        shifted_A=late_current.shifted(records, stack),
        quick_A=quick_A(stack, polarisation_tau_s),
        known_ambient=np.array([np.isfinite(r.ambient_C) for r in records]),
        start_soc=start_soc,
        start_sd=start_sd,
        full_soc=full_soc,
        charged_in_part=in_part,
        familiar=np.array([cold_factor(spread, start_C) == 1.0 for start_C in stack.start_temp_C]),
        shows_delay=all(map(observed.is_fine, records)),
    )


def _wander(file: BatteryFile, cells: float) -> Wander:
    """Return the file's wander for a pack of `cells`; a file without one gets its RMSE at every charge."""
    discrepancy, share = file.discrepancy, cells / file.battery.cells_series
    spread = discrepancy.wander
    if spread is None:
        spread = Wander(
            soc=[0.0, 1.0],
            voltage_sd_V=[max(discrepancy.voltage_rmse_V, wander.USUAL_CELL_V * file.battery.cells_series)] * 2,
            voltage_time_s=max(discrepancy.voltage_autocorrelation_s, wander.USUAL_TIME_S),
            voltage_noise_V=wander.USUAL_NOISE_CELL_V * file.battery.cells_series,
            rest_sd_V=wander.USUAL_REST_CELL_V * file.battery.cells_series,
            temperature_sd_K=max(discrepancy.temperature_rmse_K, wander.USUAL_K),
            temperature_time_s=wander.USUAL_TIME_K_S,
            temperature_noise_K=wander.USUAL_NOISE_K,
        )
    return msgspec.structs.replace(
        spread,
        voltage_sd_V=[share * v for v in spread.voltage_sd_V],
        voltage_noise_V=share * spread.voltage_noise_V,
        rest_sd_V=share * spread.rest_sd_V,
    )


def _content(record: ObservedRecord) -> tuple[float, ...]:
    """Return a sort key that depends on the measurements, not on the names: sums of the columns."""
    return (float(np.sum(record.voltage_V)), float(np.sum(record.current_A)), float(record.time_s[-1]))


def _starts(stack: Stack, ocv_soc: tuple[Array, Array], full_soc: float) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return the start of charge, its sd, and True for a rested record that was clearly not full.

    A pack that rests near full counts as full: it has the charge `full_soc` of the battery file's full packs. If it
    rests lower, the voltage shows its charge. Under load the start is a guess, and no fuller than those packs.
    """
    volts = stack.voltage_V[0] / stack.cells
    drop = np.where(stack.rested, 0.0, stack.current_A[0] / stack.capacity_Ah * START_OHMAH)
    guess = np.clip(np.interp(volts + drop, ocv_soc[1], ocv_soc[0]), LEAST_START, 1.0)
    full = stack.rested & (guess > CLEARLY_NOT_FULL)
    centre = np.where(full, full_soc, np.minimum(guess, full_soc))
    return centre, np.where(full, FULL_SD, np.where(stack.rested, RESTED_SD, LOADED_SD)), stack.rested & ~full


def _steep_V(file: BatteryFile, ocv_soc: tuple[Array, Array], cells: int) -> Array:
    """Return the error of the voltage [V] at each charge of the table that an error of the capacity causes.

    Near empty a hundredth of the capacity changes the voltage by half a volt. Without this error, a flight that goes
    deeper than those the wander was learned on would distort all other values.
    """
    soc, ocv_V = ocv_soc
    out: Array = capacity_sd(file) * (1.0 - soc) * cells * np.gradient(ocv_V, soc)
    return out
