"""The two steps of a Kalman filter, as functions of mean and covariance for all members of a sum of Gaussians at once.

    predict     x⁻ = f(x)                        P⁻ = F P Fᵀ + Q
    condition   K = P⁻ Hᵀ (H P⁻ Hᵀ + R)⁻¹         x = x⁻ + K ν
                P = (1 - K H) P⁻ (1 - K H)ᵀ + K R Kᵀ                        (Joseph's form)

Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), sections 5.2 and 10.3. The
Jacobians F and H are central differences of the model's own functions, so that no equation is written twice. In flight
`condition` is filterpy's update (`filterpy_condition`); a test holds the two equal to 1e-9.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.battery.state_space import SIZE

if TYPE_CHECKING:
    from filterpy.kalman import ExtendedKalmanFilter

# Steps of the difference quotients: much larger than rounding, much smaller than any curvature of the model.
NUDGE = np.array([1e-4, 1e-4, 1e-4, 1e-2, 1e-2, 1e-4, 1e-4, 1e-4, 1e-4])


class Measurement(NamedTuple):
    """Measurement holds n readings against what each member of a belief expects of them.

    innovation : measured less expected [members, n]; observation : H [members, n, 9];
    noise_R : covariance of the measurement noise [members, n, n].
    """

    innovation: Array
    observation: Array
    noise_R: Array


Condition = Callable[[Array, Array, Measurement], tuple[Array, Array]]


def jacobian(function: Callable[[Array], Array], x: Array) -> tuple[Array, Array]:
    """Differentiate `function` at every member, all columns in one call of it.

    function : columns [9, any] -> values [n, any]; x : [members, 9].
    Returns (∂f/∂x [members, n, 9] by central differences, f(x) [members, n]).
    """
    nudges = np.diag(NUDGE)
    points = np.concatenate([x[:, None], x[:, None] + nudges, x[:, None] - nudges], axis=1)
    members, count, _ = points.shape
    values = function(points.reshape(members * count, SIZE).T).T.reshape(members, count, -1)
    plus, minus = values[:, 1 : SIZE + 1], values[:, SIZE + 1 :]
    return np.swapaxes((plus - minus) / (2.0 * NUDGE)[:, None], 1, 2), values[:, 0].copy()


def predict(transition: Callable[[Array], Array], x: Array, P: Array, process_Q: Array) -> tuple[Array, Array]:
    """Carry means [members, 9] and covariances [members, 9, 9] over one step.

    transition : columns [9, any] -> columns after the step; process_Q : variances of the process noise [members, 9].
    Returns the means and covariances after it.
    """
    F, moved = jacobian(transition, x)
    return moved, F @ P @ np.swapaxes(F, 1, 2) + process_Q[..., None] * np.eye(SIZE)


def condition(x: Array, P: Array, measurement: Measurement) -> tuple[Array, Array]:
    """Return means [members, 9] and covariances [members, 9, 9] after a measurement."""
    innovation, observation, noise_R = measurement
    PHt = P @ np.swapaxes(observation, 1, 2)
    gain = PHt @ np.linalg.inv(observation @ PHt + noise_R)
    keep = np.eye(SIZE) - gain @ observation
    spread = keep @ P @ np.swapaxes(keep, 1, 2) + gain @ noise_R @ np.swapaxes(gain, 1, 2)
    return x + (gain @ innovation[:, :, None])[:, :, 0], spread


def filterpy_condition() -> Condition:
    """Make a `condition` that lets filterpy do the work, one extended Kalman filter a member.

    filterpy is imported at the first measurement: it takes two seconds, which a replay can do without.
    """
    filters: list[ExtendedKalmanFilter] = []

    def by_filterpy(x: Array, P: Array, measurement: Measurement) -> tuple[Array, Array]:
        if len(filters) < len(x):
            from filterpy.kalman import ExtendedKalmanFilter

            filters[:] = [ExtendedKalmanFilter(dim_x=SIZE, dim_z=2) for _ in range(len(x))]
        x, P = x.copy(), P.copy()
        for member, (innovation, row, noise_R) in enumerate(zip(*measurement, strict=True)):
            kalman = filters[member]
            kalman.x, kalman.P = x[member], P[member]
            kalman.update(innovation, lambda x, row=row: row, lambda x: 0.0, R=noise_R)
            x[member], P[member] = kalman.x, kalman.P
        return x, P

    return by_filterpy
