"""The last digit of a meter, as its readings show it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

LEAST = 1e-6  # a smaller difference is a rounding error of ours


def last_digit(readings: NDArray[np.float64]) -> float:
    """Return the smallest difference between two readings in turn; 0 if they are all the same."""
    steps = np.abs(np.diff(readings))
    seen = steps[steps > LEAST]
    return float(seen.min()) if seen.size else 0.0
