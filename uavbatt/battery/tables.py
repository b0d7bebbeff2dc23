"""Tables over the charge: a monotone curve through the few knots of a battery file, on the model's dense grid."""

from __future__ import annotations

import numpy as np

from uavbatt.battery.model import SOC_GRID, Array

COLLAPSE_V = 4.0  # volts per unit of charge


def dense(knots_soc: Array, values: Array) -> Array:
    """Return a table [..., grid] on SOC_GRID: a monotone cubic (Fritsch-Carlson) through `values` [..., knots].

    It is straight beyond the outer knots. Below the lowest knot it falls at least as fast as COLLAPSE_V: an emptied
    cell has no plateau.
    """
    table = monotone_cubic(np.clip(SOC_GRID, knots_soc[0], knots_soc[-1]), knots_soc, values)
    slope_above = (values[..., -1:] - values[..., -2:-1]) / (knots_soc[-1] - knots_soc[-2])
    below = np.minimum(SOC_GRID - knots_soc[0], 0.0)
    above = np.maximum(SOC_GRID - knots_soc[-1], 0.0)
    table += slope_below(knots_soc, values) * below + slope_above * above
    return table


def slope_below(knots_soc: Array, values: Array) -> Array:
    """Return the slope [V], [..., 1], with which a table of `values` [..., knots] goes on below its lowest knot."""
    slope: Array = np.diff(values[..., :2], axis=-1) / (knots_soc[1] - knots_soc[0])
    return np.maximum(slope, COLLAPSE_V)


def dense_resistance(knots_soc: Array, values: Array) -> Array:
    """Return a table as `dense` does, in the logarithm so that it stays positive, and flat beyond the outer knots."""
    return np.exp(monotone_cubic(np.clip(SOC_GRID, knots_soc[0], knots_soc[-1]), knots_soc, np.log(values)))


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
