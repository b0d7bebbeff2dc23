"""The `[powers]` of a vehicle file: power over airspeed and climb, from flights that logged both or flew a known route.

It is a least-squares fit with a prior (momentum theory and other aircraft). Power is a share of each flight's own hover
power, which is fitted together with the shape, so that flights with a payload also give the shape (a payload scales all
but the drag). The model of the shape has an error of its own, which limits the weight of many blocks at the same
airspeed and climb: so the few blocks at high airspeed count too.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.battery.pack import Installation, true_power
from uavbatt.battery.powers import FAST_MS, PRIOR_SD, TERMS, UNKNOWN, Powers, terms
from uavbatt.prediction.route.progress import Progress
from uavbatt.records import Flight, Sample

BLOCK_S, LONGEST_ROW_S = 5.0, 30.0
SHORTEST_S = 120.0
# v_h = √(m g / 2 ρ A): 4 m/s for 2 kg on four propellers of 15 inch, 6 for 3 kg on 13 inch. The best of them is taken.
INDUCED_MS = (4.0, 5.0, 6.0, 7.0)
TURNS, NOISE, LEAST_NOISE, NOISE_MEMORY_S = 6, 0.1, 0.02, 10.0
SHAPE_SD = 0.01  # error of the law itself within a cell of 1 m/s airspeed and climb
KNOWN_MS, FASTEST_SHARE = 10.0, 0.999
STEADY_SHARE = 0.3  # of the flight's median power; less is no flight
# The spread of fast flight between the flights of one aircraft, which counts as two flights: on 24 flights of a Matrice
# 100 it was 0.03 (0.05 for an aircraft left out), on six simulated ones 0.01 to 0.03.
FAST_SD = 0.08
AS_METERED = Installation(1, 1.0)


class PowerRows(NamedTuple):
    """PowerRows holds block means: power [W], airspeed, climb [m/s], take-off and landing shares, time [s]."""

    power_W: Array
    airspeed_ms: Array
    climb_ms: Array
    taking_off: Array
    landing: Array
    length_s: Array


def powers(flights: list[Flight], sensors: Installation = AS_METERED) -> Powers | None:
    """Return the power over airspeed and climb by the flights; None if no flight has both for two minutes.

    sensors : what the battery file knows of voltage and current sensor.
    """
    rows_by_flight = [rows for flight in flights if (rows := flown_rows(flight, sensors)) is not None]
    if not rows_by_flight:
        return None
    fits = [_fit(rows_by_flight, induced_ms) for induced_ms in INDUCED_MS]
    return min(fits, key=lambda fit: fit[0])[1]


def flown_rows(flight: Flight, sensors: Installation) -> PowerRows | None:
    """Return the means of one flight in blocks of BLOCK_S; None when too little of it is known."""
    progress, rows = Progress(), []
    before_s = math.nan
    for sample in flight.samples:
        navigation = flight.navigation_at(sample.time_s)
        progress = progress.after(sample.time_s, navigation)
        motion, power_W = progress.flown(sample.time_s, navigation), _power_W(sensors, sample)
        row_s, before_s = sample.time_s - before_s, sample.time_s
        if (
            motion is not None
            and progress.steadiness.is_steady
            and math.isfinite(power_W)
            and 0.0 < row_s <= LONGEST_ROW_S
        ):
            rows.append((sample.time_s, power_W, *map(float, motion), row_s))
    table = np.array(rows)
    if not len(table):
        return None
    table = table[table[:, 1] > STEADY_SHARE * np.median(table[:, 1])]
    if table[:, -1].sum() < SHORTEST_S:
        return None
    return _blocks(table)


def _power_W(sensors: Installation, sample: Sample) -> float:
    """Return the power of a row [W]; NaN where it is not measured."""
    return float(true_power(sensors, sample.voltage_V, sample.current_A)) if sample.voltage_V > 0.0 else math.nan


def _blocks(table: Array) -> PowerRows:
    """Return means over blocks of BLOCK_S of rows (time, power, airspeed, climb, taking off, landing, length)."""
    _, block = np.unique(np.floor(table[:, 0] / BLOCK_S), return_inverse=True)
    lengths_s = np.bincount(block, table[:, -1]).astype(float)
    power_W, airspeed_ms, climb_ms, taking_off, landing = (
        np.bincount(block, column * table[:, -1]) / lengths_s for column in table[:, 1:6].T
    )
    return PowerRows(power_W, airspeed_ms, climb_ms, taking_off, landing, lengths_s)


class PowerLaw(NamedTuple):
    """A PowerLaw holds the fitted shares of the terms, the hover power of each flight, and what the fit leaves.

    shares [terms]; precision [terms, terms] : the inverse of their covariance; hovers_W [flights]
    residuals : of each flight's blocks, relative to the law
    counts, variance [blocks of all flights] : independent readings in a block, and the variance of one of them
    """

    shares: Array
    precision: Array
    hovers_W: Array
    residuals: list[Array]
    counts: Array
    variance: Array


def _fit(rows_by_flight: list[PowerRows], induced_ms: float) -> tuple[float, Powers]:
    """Fit the law of all flights with this induced speed [m/s]; return the misfit and the powers."""
    law = _law(rows_by_flight, induced_ms)
    return _misfit(law), _as_powers(law, rows_by_flight, induced_ms)


def _law(rows_by_flight: list[PowerRows], induced_ms: float) -> PowerLaw:
    """Fit the shares of all flights and the hover power of each; the turns follow what is not linear."""
    columns = plain = [terms(*rows[1:5], induced_ms) for rows in rows_by_flight]
    of_each = [np.minimum(rows.length_s / NOISE_MEMORY_S, 1.0) for rows in rows_by_flight]
    counts, crowd = np.concatenate(of_each), _crowds(rows_by_flight, of_each)
    ends = np.cumsum([len(c) for c in columns])[:-1]
    shares, noise = UNKNOWN.shares, NOISE
    for _ in range(TURNS):
        variance = noise**2 + crowd * SHAPE_SD**2
        weight = counts / variance
        flights = zip(rows_by_flight, columns, np.split(weight, ends), strict=True)
        hovers_W = np.array([_hover_W(rows, c, w, shares) for rows, c, w in flights])
        columns = [_dragged(c, h / hovers_W.mean()) for c, h in zip(plain, hovers_W, strict=True)]
        relative = [1.0 + c @ shares for c in columns]
        pairs = zip(rows_by_flight, hovers_W, strict=True)
        excess = np.concatenate([rows.power_W / hover_W - 1.0 for rows, hover_W in pairs])
        design, excess = (
            _beside_hovers(np.split(values, ends), relative, np.split(weight, ends))
            for values in (np.concatenate(columns), excess)
        )
        shares, precision = _solved(design, excess, weight)
        noise = max(float(np.sqrt(np.average((excess - design @ shares) ** 2, weights=counts))), LEAST_NOISE)
    residuals = [
        rows.power_W / (h * (1.0 + c @ shares)) - 1.0
        for rows, c, h in zip(rows_by_flight, columns, hovers_W, strict=True)
    ]
    return PowerLaw(shares, precision, hovers_W, residuals, counts, variance)


def _hover_W(rows: PowerRows, columns: Array, weight: Array, shares: Array) -> float:
    """Return the hover power [W] with which a flight fits the shares best."""
    relative = 1.0 + columns @ shares
    return float(weight @ (rows.power_W * relative) / (weight @ relative**2))


def _beside_hovers(values: list[Array], relative: list[Array], weight: list[Array]) -> Array:
    """Return values of the blocks of all flights without their part that another hover power of the flight explains.

    So shares and hover powers are solved for together. In turns they would need hundreds of them: a flight of fast
    blocks alone fits a flat law with a low hover power nearly as well.
    """
    flights = zip(values, relative, weight, strict=True)
    return np.concatenate([v - np.multiply.outer(r, (w * r) @ v / (w @ r**2)).reshape(v.shape) for v, r, w in flights])


def _solved(design: Array, excess: Array, weight: Array) -> tuple[Array, Array]:
    """Return the most probable shares [terms] of the relative excess over hover, and their precision [terms, terms].

    design [blocks, terms]; excess, weight [blocks]; the prior is that of an unknown aircraft
    """
    precision = (design.T * weight) @ design + np.diag(PRIOR_SD**-2)
    shares = np.linalg.solve(precision, (design.T * weight) @ excess + UNKNOWN.shares / PRIOR_SD**2)
    return shares, precision


def _misfit(law: PowerLaw) -> float:
    """Return -2 ln of the probability of the blocks and of the shares, up to a constant."""
    weight = law.counts / law.variance
    data = weight @ np.concatenate(law.residuals) ** 2
    prior = np.sum(((law.shares - UNKNOWN.shares) / PRIOR_SD) ** 2)
    return float(data + prior) + float(law.counts @ np.log(law.variance))


def _as_powers(law: PowerLaw, rows_by_flight: list[PowerRows], induced_ms: float) -> Powers:
    """Return the law as the section [powers] of a vehicle file, with its uncertainty and its range."""
    hovers_W, shape_sd = law.hovers_W, _fast_shape_sd(law.precision, law.shares, induced_ms)
    squares = np.concatenate(law.residuals) ** 2
    return Powers(
        hover_W=_rounded(float(np.mean(hovers_W)), 1),
        induced_ms=induced_ms,
        **{term: _rounded(share, 4) for term, share in zip(TERMS, law.shares, strict=True)},
        level_sd=_rounded(_spread(hovers_W / hovers_W.mean() - 1.0, UNKNOWN.level_sd), 4),
        fast_sd=_rounded(math.hypot(_spread(_unusual(rows_by_flight, law.residuals), FAST_SD), shape_sd), 4),
        row_sd=_rounded(float(np.sqrt(np.average(squares, weights=law.counts))), 4),
        fastest_ms=_fastest_ms(rows_by_flight),
        flights=len(rows_by_flight),
        seconds=_rounded(sum(float(rows.length_s.sum()) for rows in rows_by_flight), 0),
    )


def _fast_shape_sd(precision: Array, shares: Array, induced_ms: float) -> float:
    """Return the relative sd of the power in level flight at KNOWN_MS that the fit leaves."""
    column = terms(KNOWN_MS, 0.0, 0.0, 0.0, induced_ms)
    return math.sqrt(float(column @ np.linalg.solve(precision, column))) / (1.0 + float(column @ shares))


def _fastest_ms(rows_by_flight: list[PowerRows]) -> float:
    """Return the airspeed [m/s] of the fastest block, at least KNOWN_MS, which other aircraft have shown."""
    airspeed_ms = np.concatenate([rows.airspeed_ms for rows in rows_by_flight])
    return max(KNOWN_MS, _rounded(float(np.quantile(airspeed_ms, FASTEST_SHARE)), 1))


def _dragged(columns: Array, level: float) -> Array:
    """Return the columns of a flight at this level, per hover power: a payload does not add to the drag of the air."""
    return columns / np.where(np.array(TERMS) == "drag", level, 1.0)


def _crowds(rows_by_flight: list[PowerRows], counts: list[Array]) -> Array:
    """Return how many blocks share the cell of 1 m/s airspeed and climb of each block, over all flights."""
    bins = np.floor(
        np.concatenate([np.stack([rows.airspeed_ms, rows.climb_ms + 0.5], axis=1) for rows in rows_by_flight])
    )
    _, cell = np.unique(bins, axis=0, return_inverse=True)
    return np.asarray(np.bincount(cell, np.concatenate(counts))[cell], float)


def _unusual(rows_by_flight: list[PowerRows], residuals: list[Array]) -> Array:
    """Return the error of each flight's mean power away from hover, where it flies fast or climbs."""
    means = []
    for rows, misfit in zip(rows_by_flight, residuals, strict=True):
        far = (rows.airspeed_ms > FAST_MS) | (rows.climb_ms > 1.0)
        if rows.length_s[far].sum() > NOISE_MEMORY_S * 3.0:  # three independent blocks
            means.append(float(np.average(misfit[far], weights=rows.length_s[far])))
    return np.array(means)


def _spread(values: Array, prior: float) -> float:
    """Return the standard deviation of the values; the prior counts as two flights."""
    return math.sqrt((float(np.sum(np.square(values))) + 2.0 * prior**2) / (len(values) + 2.0))


def _rounded(value: float, digits: int) -> float:
    return round(float(value), digits)
