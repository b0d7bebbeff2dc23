"""From a battery file to the numbers that the model runs on, for a pack of any size of the type."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.effects import EFFECTS
from uavbatt.battery.equations import Number
from uavbatt.battery.high_voltage import ORDINARY_FULL_V, ocv_of_fuller
from uavbatt.battery.model import SOC_GRID, Parameters
from uavbatt.battery.pack import Installation

Array = NDArray[np.float64]


class Pack(NamedTuple):
    """Pack is a battery file applied to one aircraft's pack: its parameters, limits [V] and standard deviations."""

    cell: Parameters
    installation: Installation
    cutoff_V: Number
    low_V: Number
    resistance_scale_sd: float
    capacity_scale_sd: float
    capacity_short_sd: float  # added for less than is stated: few packs hold more than is printed
    bias_sd_V: float  # discrepancy of the model, per cell
    bias_tau_s: float
    reaction_sd_V: float  # of the drop that its electrodes take beyond those of its type at a large load, per cell
    ocv_sd_V: Array  # on SOC_GRID: how far the file's own open-circuit voltage may be off, per cell
    ocv_drift_sd_V: Array  # the part of it that changes with the charge
    temperature_sd_K: float
    row_share: float  # part of a change of current between rows that a row's voltage does not show
    drop_share: float  # relative error of the drop under load, from reading to reading
    lag_share: tuple[float, float]  # relative error of the polarisation and of the diffusion overpotential
    rested_share: tuple[float, float]  # of the discrepancy in a first row at rest; and what of that is left when full
    evidence_share: float  # share of a reading that counts when capacities are compared
    empty_soc_sd: float  # of the charge left at the knee, as a share of the charge drawn by then
    sag_compensated: bool = False  # the autopilot has added its own guess of I·R to the voltage it reports
    guess_sd: float = 0.0  # relative sd of a current that is not measured, around its unknown mean

    def at_weakest_cell(self, below_V: float) -> Pack:
        """Return the pack with its limits where its weakest cell meets them, `below_V` [V] below the mean cell."""
        raised_V = self.installation.cells * below_V
        return self._replace(cutoff_V=self.cutoff_V + raised_V, low_V=self.low_V + raised_V)


# Voltage and current of a row are not read at the same instant: the error grows with the change of the current since
# the row before. On flights with a row every 12 s it was 14 mV, and 10 mohm times the change, for a pack of 90 mohm.
ROW_SHARE = 0.12
DROP_SHARE = 0.09  # errors that all readings share are in the discrepancy
COLLAPSE_V = 4.0  # volts per unit of charge
# A pack in service is not the tested pack: aged electrodes, or those of another batch, react more slowly. This lowers
# the voltage as soon as the load begins, by the same amount at every charge and temperature: 0.05 V a cell at 0.6 of
# the exchange current, which a pack that has lost a sixth of its charge may have. With a smaller sd the filter would
# explain this drop by resistance, which grows in the cold and at the knee, and correct the charge for it.
SERVICE_REACTION_SD_V = 0.05
# The rest, beside the reaction, changes by 5 to 15 mV within some minutes as the cell warms and empties.
SERVICE_BIAS_SD_V, SERVICE_BIAS_TAU_S = 0.012, 2000.0
SERVICE_RESISTANCE_SD = 0.2  # contacts and leads of a pack in service; what ages the electrodes is no resistance
# A file that was fitted to so many flights, of packs whose resistances differ so much, was fitted to packs in service:
# their scatter is measured, and only half of the reaction remains beside it.
FLEET_FLIGHTS, FLEET_RESISTANCE_SD, FLEET_REACTION_SD_V = 8, 0.12, 0.025
# The printed capacity of an untested make is no measurement either.
UNKNOWN_MAKE_CAPACITY_SD = 0.45
# The curve of an untested make is a mean over makes, with an error that stays the same for minutes: a tenth of the
# readings is independent, and the wide discrepancy covers the error of the drop.
UNKNOWN_MAKE_EVIDENCE, UNKNOWN_MAKE_DROP_SHARE = 0.1, 0.06
UNKNOWN_MAKE_BIAS_SD_V, UNKNOWN_MAKE_BIAS_TAU_S = 0.02, 3000.0
# Its resistance has a wide spread already. With more spread for the reaction, rounding of the readings does more harm
# in a log that begins in the air.
UNKNOWN_MAKE_REACTION_SD_V = 0.02
# A mean over makes does not tell how much charge a make leaves in its cells at the knee: 0.5 to 5 % at 2 to 5 C in
# three makes, 0 to 24 % in a fourth, which diffuses slowly.
UNKNOWN_MAKE_EMPTY_SOC_SD = 0.05
# A fit has seen packs at rest mostly when full; a mean over makes is equally good at rest at any charge.
RESTED_SHARE, UNKNOWN_MAKE_RESTED_SHARE = (1.0, 0.5), (0.5, 1.0)
# The standard error of a parameter ignores correlations: an OCV that is too high at every charge comes with too little
# resistance, and the voltage of a flight is known far better than either. For three makes with a known curve 11 mV were
# stated, of which 4 mV changed with the charge. A certified file may come from tests with an unmeasured load, as in the
# study: its standard errors include that.
ALONE_SHARE = {"fitted": 0.4}
# The discrepancy of a prior includes errors of its knots; this share of it remains for the model itself.
BESIDE_KNOTS = 0.45
# The status of the file widens the belief: a file that was not gated may describe another battery. A generic file has
# wide spreads by itself; the numbers of an edited file may come from anywhere.
WIDENING = {"certified": 1.0, "fitted": 1.25, "generic": 1.25, "edited": 1.5}


def monotone_cubic(at: Array, knots: Array, values: Array) -> Array:
    """Return a cubic through `values` [..., knots] at the points `at` between the knots, monotone where the values are.

    Fritsch & Carlson (1980) with Butland's slopes, as `scipy.interpolate.pchip`, whose import would take a third of the
    time in which a short replay is done.
    """
    width, chord = np.diff(knots), np.diff(values) / np.diff(knots)
    slope = _slopes(width, chord)
    left = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, knots.size - 2)
    span = at - knots[left]
    bend = (3.0 * chord - 2.0 * slope[..., :-1] - slope[..., 1:]) / width
    twist = (slope[..., :-1] + slope[..., 1:] - 2.0 * chord) / width**2
    curve = values[..., left] + span * (slope[..., left] + span * (bend[..., left] + span * twist[..., left]))
    return np.asarray(curve)


def _slopes(width: Array, chord: Array) -> Array:
    """Return the slope at each knot: the weighted harmonic mean of both chords, 0 where the direction turns."""
    if width.size == 1:
        return np.concatenate([chord, chord], axis=-1)
    before, after = chord[..., :-1], chord[..., 1:]
    weight, other = width[:-1] + 2.0 * width[1:], 2.0 * width[:-1] + width[1:]
    is_going_on = before * after > 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        inner = np.where(is_going_on, (weight + other) / (weight / before + other / after), 0.0)
    first = _end_slope(width[0], width[1], chord[..., :1], chord[..., 1:2])
    last = _end_slope(width[-1], width[-2], chord[..., -1:], chord[..., -2:-1])
    return np.concatenate([first, inner, last], axis=-1)


def _end_slope(width: float, next_width: float, chord: Array, next_chord: Array) -> Array:
    """Return the three-point slope at an end, limited so that the curve does not overshoot."""
    slope = ((2.0 * width + next_width) * chord - width * next_chord) / (width + next_width)
    steep = (np.sign(chord) != np.sign(next_chord)) & (np.abs(slope) > 3.0 * np.abs(chord))
    return np.where(np.sign(slope) != np.sign(chord), 0.0, np.where(steep, 3.0 * chord, slope))


def dense(knots_soc: Array, values: Array) -> Array:
    """Return a table [..., grid] on SOC_GRID: a monotone cubic (Fritsch-Carlson) through `values` [..., knots].

    It is straight beyond the outer knots. Below the lowest knot it falls at least as fast as COLLAPSE_V: an emptied
    cell has no plateau.
    """
    table = monotone_cubic(np.clip(SOC_GRID, knots_soc[0], knots_soc[-1]), knots_soc, values)
    slope = np.diff(values, axis=-1) / np.diff(knots_soc)
    below = np.minimum(SOC_GRID - knots_soc[0], 0.0)
    above = np.maximum(SOC_GRID - knots_soc[-1], 0.0)
    table += np.maximum(slope[..., :1], COLLAPSE_V) * below + slope[..., -1:] * above
    return table


def dense_resistance(knots_soc: Array, values: Array) -> Array:
    """Return a table as `dense` does, in the logarithm so that it stays positive, and flat beyond the outer knots."""
    return np.exp(monotone_cubic(np.clip(SOC_GRID, knots_soc[0], knots_soc[-1]), knots_soc, np.log(values)))


def cell_parameters(file: BatteryFile, fullest_V: float = ORDINARY_FULL_V) -> Parameters:
    """Return the parameters of the file's cell with its effects on; `fullest_V` as in `pack_of`."""
    table = file.parameters
    ocv_soc = np.array(table.ocv_soc)
    fields = {
        name: value
        for entry in file.effects
        if EFFECTS[entry.name].acts_on == "cell"
        for name, value in entry.parameters.items()
    }
    return Parameters(
        ocv_V=dense(ocv_soc, ocv_of_fuller(ocv_soc, np.array(table.ocv_V), fullest_V)),
        r0_ohmAh=dense_resistance(np.array(table.resistance_soc), np.array(table.resistance_ohmAh)),
        **fields,
    )


def installation_of(file: BatteryFile, cells: int, capacity_Ah: float) -> Installation:
    """Return wiring and sensors as the file's effects have them, for `cells` in series of `capacity_Ah`."""
    fields = {
        name: value
        for entry in file.effects
        if EFFECTS[entry.name].acts_on == "installation"
        for name, value in entry.parameters.items()
    }
    return Installation(cells=cells, capacity_Ah=capacity_Ah, **fields)


def pack_of(
    file: BatteryFile, cells: int, capacity_Ah: float, cutoff_V: float, low_V: float, fullest_V: float = ORDINARY_FULL_V
) -> Pack:
    """Return the file scaled to `cells` in series of `capacity_Ah`, with its cut-off and low-voltage warning [V].

    fullest_V : at which a full cell rests [V]; above ORDINARY_FULL_V it is another kind of cell (`high_voltage`).
    """
    installation = installation_of(file, cells, capacity_Ah)
    widening = WIDENING[file.status]
    left = file.discrepancy
    unknown = file.status == "generic"
    resistance_scale_sd, reaction_sd_V = _service_spread(file)
    ocv_sd_V = _ocv_sd_V(file)
    stated_V = max(left.voltage_rmse_V / file.battery.cells_series, 1e-3) * widening
    stated_V *= BESIDE_KNOTS if unknown else 1.0
    return Pack(
        cell=cell_parameters(file, fullest_V if unknown else ORDINARY_FULL_V),  # the file of one make has its own curve
        installation=installation,
        cutoff_V=cutoff_V,
        low_V=low_V,
        resistance_scale_sd=resistance_scale_sd,
        capacity_scale_sd=file.parameters.capacity_scale_sd * widening,
        capacity_short_sd=UNKNOWN_MAKE_CAPACITY_SD * unknown,
        bias_sd_V=math.hypot(stated_V, UNKNOWN_MAKE_BIAS_SD_V if unknown else SERVICE_BIAS_SD_V),
        bias_tau_s=max(left.voltage_autocorrelation_s, UNKNOWN_MAKE_BIAS_TAU_S if unknown else SERVICE_BIAS_TAU_S),
        reaction_sd_V=reaction_sd_V,
        ocv_sd_V=ocv_sd_V,
        ocv_drift_sd_V=_drift_sd_V(ocv_sd_V, ALONE_SHARE.get(file.status, 1.0)),
        temperature_sd_K=max(left.temperature_rmse_K, 0.2),
        row_share=ROW_SHARE,
        drop_share=UNKNOWN_MAKE_DROP_SHARE if unknown else DROP_SHARE,
        lag_share=(_lag_share(file, "polarisation_ratio"), _lag_share(file, "diffusion_ratio")),
        rested_share=UNKNOWN_MAKE_RESTED_SHARE if unknown else RESTED_SHARE,
        evidence_share=UNKNOWN_MAKE_EVIDENCE if unknown else 1.0,
        empty_soc_sd=UNKNOWN_MAKE_EMPTY_SOC_SD if unknown else 0.0,
    )


def _service_spread(file: BatteryFile) -> tuple[float, float]:
    """Return the sds of ln of the resistance scale and of the reaction's drop [V] over packs in service."""
    table = file.parameters
    has_fleet = (table.spread_flights or 0) >= FLEET_FLIGHTS and table.resistance_scale_sd >= FLEET_RESISTANCE_SD
    if file.status == "fitted" and has_fleet:
        return table.resistance_scale_sd, FLEET_REACTION_SD_V
    scale_sd = math.hypot(table.resistance_scale_sd * WIDENING[file.status], SERVICE_RESISTANCE_SD)
    return scale_sd, UNKNOWN_MAKE_REACTION_SD_V if file.status == "generic" else SERVICE_REACTION_SD_V


def _ocv_sd_V(file: BatteryFile) -> Array:
    """Return the standard error of the OCV [V] on SOC_GRID, from those of its knots; 0 where none is stated."""
    table = file.parameters
    errors = [table.standard_error.get(f"ocv_{soc:g}", 0.0) for soc in table.ocv_soc]
    return np.asarray(np.interp(SOC_GRID, np.array(table.ocv_soc), np.array(errors)))


def _drift_sd_V(ocv_sd_V: Array, least: float) -> Array:
    """Return the part of the error of an open-circuit voltage that differs between charges; at least a share of it."""
    alike_V2 = np.median(ocv_sd_V) ** 2
    return np.asarray(np.sqrt(np.maximum(ocv_sd_V**2 - alike_V2, (least * ocv_sd_V) ** 2)))


def _lag_share(file: BatteryFile, quantity: str) -> float:
    """Return the relative error of an effect's quantity, 0.1 to 0.8: its own part, not what it shares with others."""
    share = ALONE_SHARE.get(file.status, 1.0)
    for entry in file.effects:
        if entry.parameters.get(quantity):
            error = share * entry.standard_error.get(quantity, 0.0)
            return float(np.clip(error / entry.parameters[quantity], 0.1, 0.8))
    return 0.1
