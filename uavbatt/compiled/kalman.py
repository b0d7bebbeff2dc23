"""The steps of a Kalman filter for one member, in loops for numba: what `estimation.kalman` does with arrays of them.

F is mostly zeros and H has one or two rows, so that loops that pass over what has no influence are far quicker than
products of matrices.
"""

from __future__ import annotations

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.battery.state_space import SIZE
from uavbatt.compiled.jit import compiled
from uavbatt.estimation.kalman import NUDGE

PER_NUDGES = 0.5 / NUDGE


@compiled
def sparse_product(F: Array, M: Array) -> Array:
    """Return F M; what has no influence, most of F, is passed over."""
    out = np.zeros((SIZE, SIZE))
    for i in range(SIZE):
        for k in range(SIZE):
            share = F[i, k]
            if share != 0.0:
                for j in range(SIZE):
                    out[i, j] += share * M[k, j]
    return out


@compiled
def predicted_covariance(F: Array, P: Array) -> Array:
    """Return F P Fᵀ, as F (F P)ᵀ: P is symmetric."""
    return sparse_product(F, sparse_product(F, P).T)


@compiled
def projected(P: Array, H: Array) -> tuple[Array, Array]:
    """Return P Hᵀ, transposed [readings, 9], and H P Hᵀ [readings, readings]."""
    n = H.shape[0]
    PHt, S = np.zeros((n, SIZE)), np.zeros((n, n))
    for m in range(n):
        for k in range(SIZE):
            if H[m, k] != 0.0:
                for j in range(SIZE):
                    PHt[m, j] += H[m, k] * P[k, j]
    for m in range(n):
        for other in range(n):
            for j in range(SIZE):
                S[m, other] += PHt[m, j] * H[other, j]
    return PHt, S


@compiled
def joseph(x: Array, P: Array, PHt: Array, S: Array, H: Array, R: Array, y: Array) -> None:
    """Condition mean and covariance, in place, on one measurement of at most two readings, S = H P Hᵀ + R.

    The covariance is in Joseph's form as in filterpy, (1 - K H) P (1 - K H)ᵀ + K R Kᵀ, but from the right to the left
    in vectors: K has two columns at most.
    """
    n = y.size
    K = np.empty((n, SIZE))
    determinant = S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0] if n == 2 else S[0, 0]
    for j in range(SIZE):
        if n == 2:
            K[0, j] = (PHt[0, j] * S[1, 1] - PHt[1, j] * S[1, 0]) / determinant
            K[1, j] = (PHt[1, j] * S[0, 0] - PHt[0, j] * S[0, 1]) / determinant
        else:
            K[0, j] = PHt[0, j] / determinant
    for m in range(n):
        for i in range(SIZE):
            x[i] += K[m, i] * y[m]
            for j in range(SIZE):
                P[i, j] -= K[m, i] * PHt[m, j]
    across = np.zeros((n, SIZE))  # the term that K takes away once more: P Hᵀ, of what is left, less K R
    for m in range(n):
        for i in range(SIZE):
            for j in range(SIZE):
                across[m, i] += P[i, j] * H[m, j]
            for other in range(n):
                across[m, i] -= K[other, i] * R[other, m]
    for m in range(n):
        for i in range(SIZE):
            for j in range(SIZE):
                P[i, j] -= across[m, i] * K[m, j]
