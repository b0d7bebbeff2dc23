"""The forecasts of one flight as columns, with the rule for a refusal: it counts as a forecast of 0 s."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uavbatt.records import NAN
from uavbatt.scoring.metrics import FloatArray, crps_quantiles, mass_within

MAX_AGE_S = 60.0  # the slowest telemetry scored so far has a row every 12 s and gaps of 30 s; a longer gap is silence


@dataclass(frozen=True, slots=True)
class ForecastLines:
    """ForecastLines holds forecasts as columns; `points` has rows of median, 5 % and 95 % point, NaN where refused."""

    time_s: FloatArray
    points: FloatArray
    interval: bool

    def in_force(self, at_s: FloatArray) -> ForecastLines:
        """Return the forecasts that a display shows at the instants `at_s` [s]; NaN before the first line."""
        row = np.searchsorted(self.time_s, at_s + 1e-6, side="right") - 1
        age_s = np.where(row < 0, NAN, at_s - self.time_s[row])
        left_s = np.where(age_s <= MAX_AGE_S, np.maximum(self.points[:, row] - age_s, 0.0), NAN)
        return ForecastLines(at_s, left_s, self.interval)

    def as_scored(self) -> FloatArray:
        """Return `points` with a refusal as a sure 0 s, and a median that has no interval as a sure median."""
        median, lo, hi = np.where(np.isnan(self.points[0]), NAN, self.points)
        median = np.nan_to_num(median, nan=0.0)
        return np.stack([median, np.where(np.isnan(lo), median, lo), np.where(np.isnan(hi), median, hi)])

    def inside(self, truth_s: FloatArray) -> FloatArray:
        """Return 1 where the interval holds the truth, else 0; NaN throughout for a method without intervals."""
        _, lo, hi = np.where(np.isnan(self.points[0]), NAN, self.points)
        return np.where(self.interval, (lo <= truth_s) & (truth_s <= hi), NAN)

    def width_s(self) -> FloatArray:
        """Return the width hi - lo [s] of every line; NaN where there is none."""
        return np.where(self.interval & np.isfinite(self.points[0]), self.points[2] - self.points[1], NAN)

    def crps_s(self, truth_s: FloatArray) -> FloatArray:
        """Return the CRPS [s] of every line."""
        median, lo, hi = self.as_scored()
        return crps_quantiles(truth_s, lo, median, hi)

    def mass(self, truth_s: FloatArray, half_band_s: FloatArray | float) -> FloatArray:
        """Return the probability of truth +- half band of every line; 0 where it is refused."""
        median, lo, hi = self.as_scored()
        within = mass_within(truth_s - half_band_s, truth_s + half_band_s, lo, median, hi)
        return np.where(np.isnan(self.points[0]), 0.0, within)  # near the end even 0 s would lie in the band
