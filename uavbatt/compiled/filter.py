"""The filter's recursion over a window of rows, compiled: the twin of `estimation.recursion`, equal to it to rounding.

Model and noise are the functions that the recursion calls; only the recursion itself (blocks of rows here, predict and
update in `member`) stands a second time, as loops over rows and members instead of arrays of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from uavbatt.battery import state_space as b
from uavbatt.battery.model import Array
from uavbatt.battery.pack import c_rate, true_current
from uavbatt.battery.scaling import Pack
from uavbatt.battery.state_space import SIZE, Belief, X
from uavbatt.compiled.jit import as_numbers, compiled, share
from uavbatt.compiled.member import predict, settle, update
from uavbatt.estimation import noise, recursion
from uavbatt.estimation.block import BLOCK_S, Block
from uavbatt.estimation.recursion import FilteredRow, FilterState, Innovation, weighed
from uavbatt.estimation.summary import summary
from uavbatt.records import Sample

share(recursion)


def most_beliefs(times_s: Array, at_s: float) -> int:
    """Return the largest number of beliefs that rows at these times [s] lead to, from a filter at `at_s` [s]."""
    known_s = np.append(times_s[np.isfinite(times_s)], at_s)
    return min(times_s.size, int(np.ptp(known_s) / BLOCK_S)) + 4


def filter_window(pack: Pack, state: FilterState, samples: Sequence[Sample]) -> tuple[list[FilteredRow], FilterState]:
    """Take a window of rows in, as `recursion.filter_window` does.

    Returns the filter after each row, and the state after the last.
    """
    if not samples:
        return [], state
    table = np.array([[s.time_s, s.voltage_V, s.current_A, s.temp_C] for s in samples]).T.copy()
    most = most_beliefs(table[0], state.time_s)
    new, in_force, shown, (time_s, current_A, block_A, block, air, load) = run(
        as_numbers(pack),
        state.air,
        state.load,
        table,
        most,
        state.time_s,
        state.current_A,
        state.block_A,
        np.array(state.block, dtype=float),
        state.belief.means,
        state.belief.covariances,
        state.belief.log_weights,
    )
    beliefs = [state.belief, *(Belief(*one) for one in list(zip(*new, strict=True))[1:])]
    known = [state.summary, *(summary(belief, pack.empty_soc_sd) for belief in beliefs[1:])]
    rows = [
        FilteredRow(beliefs[k], known[k], Innovation(*row))
        for k, row in zip(in_force.tolist(), shown.tolist(), strict=True)
    ]
    open_block, air, load = Block(*block.tolist()), noise.Air(*air), noise.LastLoad(*load)
    return rows, FilterState(beliefs[-1], known[-1], time_s, current_A, block_A, open_block, air, load)


@compiled
def put_all(means: Array, covariances: Array, log_weights: Array, x: Array, P: Array, log_weight: Array) -> None:
    """Copy the moments of all members; an assignment of arrays would take numba six seconds to compile."""
    for k in range(log_weight.size):
        log_weights[k] = log_weight[k]
        for i in range(SIZE):
            means[k, i] = x[k, i]
            for j in range(SIZE):
                covariances[k, i, j] = P[k, i, j]


@compiled
def close(
    pack: Pack,
    x: Array,
    P: Array,
    log_weight: Array,
    block: Array,
    block_A: float,
    air: noise.Air,
    load: noise.LastLoad,
) -> tuple[Array, float, float, float, float, noise.Air, noise.LastLoad]:
    """Take a block in, as `recursion._close` does: it changes every member in place.

    Returns the new ln of the weights, then innovation, NIS and expected voltage by the old weights, the block's mean
    current, the air after it, and the last load.
    """
    mean_A, mean_C = block[4] / block[0], block[5] / block[6] if block[6] > 0.0 else np.nan
    weight, members = np.exp(log_weight), log_weight.size
    innovation_V, variance_V2 = np.empty(members), np.empty(members)
    shown_V, shown_nis, expected_V, warmer_K, dt_s = 0.0, 0.0, 0.0, 0.0, block[1]
    load = noise.load_after(load, c_rate(pack.installation, block[2] / dt_s), dt_s)
    is_settling = noise.is_settling(load)
    for k in range(members):
        if is_settling:
            settle(pack, x[k], P[k], dt_s)
        predict(pack, x[k], P[k], block[2] / dt_s, air.ambient_C, dt_s)
        innovation_V[k], variance_V2[k], nis, volts, off_K = update(
            pack, x[k], P[k], block[3] / block[0], mean_A, mean_C, mean_A - block_A
        )
        shown_V, shown_nis = shown_V + weight[k] * innovation_V[k], shown_nis + weight[k] * nis
        expected_V, warmer_K = expected_V + weight[k] * volts, warmer_K + weight[k] * off_K
    for i in range(block.size):
        block[i] = 0.0
    if not is_settling:
        log_weight = weighed(log_weight, innovation_V, variance_V2, pack.evidence_share)
    if np.isfinite(warmer_K):
        air = noise.air_after(air, warmer_K, pack.temperature_sd_K, dt_s)
    return log_weight, shown_V, shown_nis, expected_V, mean_A, air, load


@compiled
def show_within(
    pack: Pack, x: Array, log_weight: Array, drawn_As: Array, current_A: Array, voltage_V: Array, shown: Array
) -> None:
    """Write rows within one block against the model into `shown` [rows, 4], as `Innovation` has them; NIS stays NaN.

    x, log_weight : means and ln of the weights after the block before; drawn_As : charge [A s] drawn since then, NaN
    for a row that is not taken in or closes the block.
    """
    taken = np.flatnonzero(np.isfinite(drawn_As))
    for row in taken:
        shown[row, 2] = shown[row, 3] = 0.0
    for k in range(log_weight.size):
        weight, now = np.exp(log_weight[k]), b.unpack(pack, x[k])
        for row in taken:
            left = x[k, X.SOC] - drawn_As[row] / (3600.0 * now.installation.present_capacity_Ah)
            between = b.Unpacked(now.cell, now.installation, now.state._replace(soc=left))
            shown[row, 2] += weight * b.reported_voltage(pack, between, x[k, X.BIAS], current_A[row])
            shown[row, 3] += weight * left
    for row in taken:
        shown[row, 0] = voltage_V[row] - shown[row, 2]


@compiled
def run(
    pack: Pack,
    air: noise.Air,
    load: noise.LastLoad,
    rows: Array,
    most: int,
    at_s: float,
    before_A: float,
    block_A: float,
    block: Array,
    x: Array,
    P: Array,
    log_weight: Array,
) -> tuple[Any, ...]:
    """Take all rows [time, voltage, current, temperature; n] in, from a state of the filter (`FilterState`).

    most : the largest number of beliefs that the rows can give, the given one included. Returns the beliefs (means [m,
    members, 9], covariances, ln of the weights and ambient temperatures [m], the given one first), which of them is in
    force after each row, what each row shows [n, 4] as `Innovation` has it, and the state after the last row: its time
    [s], currents of the last row and block [A], the open block, the air, the last load.
    """
    n, last = rows.shape[1], 0
    means, covariances = np.empty((most, *x.shape)), np.empty((most, *P.shape))
    log_weights = np.empty((most, log_weight.size))
    in_force, ambients_C, shown = np.zeros(n, np.int64), np.full(most, air.ambient_C), np.full((n, 4), np.nan)
    drawn_As, true_A = np.full(n, np.nan), np.full(n, np.nan)
    x, P, block = x.copy(), P.copy(), block.copy()
    put_all(means[0], covariances[0], log_weights[0], x, P, log_weight)
    for k in range(n):
        time_s, voltage_V, metered_A, temp_C = rows[0, k], rows[1, k], rows[2, k], rows[3, k]
        in_force[k] = last
        dt_s = time_s - at_s
        if not (np.isfinite(voltage_V) and np.isfinite(metered_A)) or dt_s < 0.0:
            continue
        current_A = true_current(pack.installation, metered_A, voltage_V)
        if dt_s > BLOCK_S and block[1] > 0.0:  # rows before a gap belong to the time before it
            log_weight, _, _, _, block_A, air, load = close(pack, x, P, log_weight, block, block_A, air, load)
        block[0] += 1.0
        block[1] += dt_s
        block[2] += 0.5 * (before_A + current_A) * dt_s
        block[3] += voltage_V
        block[4] += current_A
        if np.isfinite(temp_C):
            block[5] += temp_C
            block[6] += 1.0
        at_s, before_A = time_s, current_A
        if block[1] < BLOCK_S:
            drawn_As[k], true_A[k] = block[2], current_A
            continue
        log_weight, shown[k, 0], shown[k, 1], shown[k, 2], block_A, air, load = close(
            pack, x, P, log_weight, block, block_A, air, load
        )
        shown[k, 3] = np.sum(np.exp(log_weight) * x[:, X.SOC])
        last += 1
        put_all(means[last], covariances[last], log_weights[last], x, P, log_weight)
        in_force[k], ambients_C[last] = last, air.ambient_C
    begin = 0
    for end in np.append(np.flatnonzero(np.diff(in_force)) + 1, n):
        at = in_force[begin]
        show_within(
            pack, means[at], log_weights[at], drawn_As[begin:end], true_A[begin:end], rows[1, begin:end],
            shown[begin:end],
        )  # fmt: skip
        begin = end
    beliefs = (means[: last + 1], covariances[: last + 1], log_weights[: last + 1], ambients_C[: last + 1])
    return beliefs, in_force, shown, (at_s, before_A, block_A, block, air, load)
