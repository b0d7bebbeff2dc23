"""The filter's recursion over a window of rows, compiled: the twin of `estimation.recursion`, equal to it to rounding.

Model and noise are the functions that the recursion calls; only the recursion itself (blocks of rows here, predict and
update in `member`) stands a second time, as loops over rows and members instead of arrays of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbatt.battery import state_space as b
from uavbatt.battery.model import Array
from uavbatt.battery.pack import c_rate, true_current
from uavbatt.battery.scaling import Pack
from uavbatt.battery.state_space import SIZE, Belief, X
from uavbatt.compiled.jit import as_numbers, compiled, share
from uavbatt.compiled.member import predict, settle, shown_V, update
from uavbatt.estimation import innovation, noise, recursion
from uavbatt.estimation import meter as voltmeter
from uavbatt.estimation.block import BLOCK_S, Block
from uavbatt.estimation.innovation import Innovation, Tangent, tangent_points, tangent_through, within_block
from uavbatt.estimation.meter import Meter, Scatter, meter_after, meter_noise, scatter_after
from uavbatt.estimation.recursion import FilteredRow, FilterState, weighed
from uavbatt.estimation.summary import summary
from uavbatt.records import Sample

share(innovation)
share(recursion)
share(voltmeter)


class Moments(NamedTuple):
    """Moments holds the arrays of a belief, which are changed in place: means, covariances, ln of the weights."""

    x: Array
    P: Array
    log_weight: Array


class Standing(NamedTuple):
    """Standing holds the rest of a filter's state (`FilterState`); the open block is an array, changed in place."""

    time_s: float
    current_A: float
    block_A: float
    tangent: Tangent
    block: Array
    air: noise.Air
    load: noise.LastLoad
    meter: Meter
    scatter: Scatter


class Filtered(NamedTuple):
    """Filtered holds what rows lead to: the beliefs (the given one first), and the state after the last row.

    moments : of the beliefs [beliefs, members, ...]; ambient_C : of each belief; in_force : the belief after each row;
    shown : what each row shows [rows, 4], as `Innovation` has it.
    """

    moments: Moments
    ambient_C: Array
    in_force: NDArray[np.int64]
    shown: Array
    standing: Standing


def filter_window(pack: Pack, state: FilterState, samples: Sequence[Sample]) -> tuple[list[FilteredRow], FilterState]:
    """Take a window of rows in, as `recursion.filter_window` does.

    Returns the filter after each row, and the state after the last.
    """
    if not samples:
        return [], state
    found = run(as_numbers(pack), *begun(state, samples))
    beliefs = [
        state.belief,
        *(Belief(*one) for one in list(zip(*found.moments, found.ambient_C.tolist(), strict=True))[1:]),
    ]
    known = [state.summary, *(summary(belief, pack.spread.empty_soc_sd) for belief in beliefs[1:])]
    rows = [
        FilteredRow(beliefs[k], known[k], Innovation(*row))
        for k, row in zip(found.in_force.tolist(), found.shown.tolist(), strict=True)
    ]
    time_s, current_A, block_A, at, block, air, load, meter, scatter = found.standing
    open_block = Block(*block.tolist())
    air, load, meter, scatter = noise.Air(*air), noise.LastLoad(*load), Meter(*meter), Scatter(*scatter)
    now = FilterState(
        beliefs[-1], known[-1], time_s, current_A, block_A, Tangent(*at), open_block, air, load, meter, scatter
    )
    return rows, now


def begun(state: FilterState, samples: Sequence[Sample]) -> tuple[Moments, Standing, Array, int]:
    """Return the arguments of `run` after the pack: state, rows [4, n], and the largest number of beliefs."""
    belief, block = state.belief, np.array(state.block, dtype=float)
    standing = Standing(
        state.time_s, state.current_A, state.block_A, state.tangent, block,
        state.air, state.load, state.meter, state.scatter,
    )  # fmt: skip
    rows = np.array([[s.time_s, s.voltage_V, s.current_A, s.temp_C] for s in samples]).T.copy()
    moments = Moments(belief.means, belief.covariances, belief.log_weights)
    return moments, as_numbers(standing), rows, most_beliefs(rows[0], state.time_s)


def most_beliefs(times_s: Array, at_s: float) -> int:
    """Return the largest number of beliefs that rows at these times [s] lead to, from a filter at `at_s` [s]."""
    known_s = np.append(times_s[np.isfinite(times_s)], at_s)
    return min(times_s.size, int(np.ptp(known_s) / BLOCK_S)) + 4


@compiled
def keep(moments: Moments, k: int, now: Moments) -> None:
    """Copy the moments of belief `k`; an assignment of arrays would take numba six seconds to compile."""
    for member in range(now.log_weight.size):
        moments.log_weight[k, member] = now.log_weight[member]
        for i in range(SIZE):
            moments.x[k, member, i] = now.x[member, i]
            for j in range(SIZE):
                moments.P[k, member, i, j] = now.P[member, i, j]


@compiled
def close(pack: Pack, now: Moments, at: Standing) -> tuple[Moments, Standing, Innovation]:
    """Take the open block in, as `recursion._close` does: it changes every member in place and empties the block.

    Returns the moments with their new weights, the state after it, and the block against the model.
    """
    block, weight, members, air = at.block, np.exp(now.log_weight), now.log_weight.size, at.air
    mean_A, mean_C = block[4] / block[0], block[5] / block[6] if block[6] > 0.0 else np.nan
    innovation_V, variance_V2 = np.empty(members), np.empty(members)
    shown_V, shown_nis, expected_V, warmer_K, dt_s = 0.0, 0.0, 0.0, 0.0, block[1]
    load = noise.load_after(at.load, c_rate(pack.installation, block[2] / dt_s), dt_s)
    is_settling = noise.is_settling(load)
    of_meter = meter_noise(at.meter, at.scatter, dt_s, pack.installation.cells)
    for k in range(members):
        if is_settling:
            settle(pack, now.x[k], now.P[k], dt_s)
        predict(pack, now.x[k], now.P[k], block[2] / dt_s, air.ambient_C, dt_s)
        innovation_V[k], variance_V2[k], nis, volts, off_K = update(
            pack, now.x[k], now.P[k], block[3] / block[0], mean_A, mean_C, mean_A - at.block_A, of_meter
        )
        shown_V, shown_nis = shown_V + weight[k] * innovation_V[k], shown_nis + weight[k] * nis
        expected_V, warmer_K = expected_V + weight[k] * volts, warmer_K + weight[k] * off_K
    for i in range(block.size):
        block[i] = 0.0
    log_weight = now.log_weight
    if not is_settling:
        log_weight = weighed(log_weight, innovation_V, variance_V2, pack.spread.evidence_share)
    if np.isfinite(warmer_K):
        air = noise.air_after(air, warmer_K, pack.spread.temperature_sd_K, dt_s)
    soc = np.sum(np.exp(log_weight) * now.x[:, X.SOC])
    line = tangent(pack, now.x, log_weight, at.current_A)
    after = Standing(
        at.time_s, at.current_A, mean_A, line, block, air, load, at.meter, scatter_after(at.scatter, shown_V)
    )
    return Moments(now.x, now.P, log_weight), after, Innovation(shown_V, shown_nis, expected_V, soc)


@compiled
def with_row(at: Standing, time_s: float, voltage_V: float, current_A: float, temp_C: float) -> Standing:
    """Return the state after a row, which is added to the open block in place, as `Block.after` does."""
    block, dt_s = at.block, time_s - at.time_s
    block[0] += 1.0
    block[1] += dt_s
    block[2] += 0.5 * (at.current_A + current_A) * dt_s
    block[3] += voltage_V
    block[4] += current_A
    if np.isfinite(temp_C):
        block[5] += temp_C
        block[6] += 1.0
    meter = meter_after(at.meter, voltage_V, dt_s)
    return Standing(time_s, current_A, at.block_A, at.tangent, block, at.air, at.load, meter, at.scatter)


@compiled
def tangent(pack: Pack, x: Array, log_weight: Array, current_A: float) -> Tangent:
    """Return the tangent of the model at the members' means, as `innovation.tangent` does."""
    points_A, drawn_As = tangent_points(pack, current_A)
    volts, soc = np.zeros(3), np.zeros(3)
    for k in range(log_weight.size):
        weight, now, at = np.exp(log_weight[k]), b.unpack(pack, x[k]), x[k].copy()
        for i in range(3):
            at[X.SOC] = x[k, X.SOC] - drawn_As[i] / (3600.0 * now.installation.present_capacity_Ah)
            volts[i] += weight * shown_V(pack, now, at, X.SOC, points_A[i])
            soc[i] += weight * at[X.SOC]
    return tangent_through(points_A, drawn_As, volts, soc)


@compiled
def run(pack: Pack, given: Moments, at: Standing, rows: Array, most: int) -> Filtered:
    """Take all rows [time, voltage, current, temperature; n] in, from a state of the filter, which is left as it is.

    most : the largest number of beliefs that the rows can give, the given one included.
    """
    n, last = rows.shape[1], 0
    now = Moments(given.x.copy(), given.P.copy(), given.log_weight)
    at = Standing(
        at.time_s, at.current_A, at.block_A, at.tangent, at.block.copy(), at.air, at.load, at.meter, at.scatter
    )
    kept = Moments(
        np.empty((most, *now.x.shape)), np.empty((most, *now.P.shape)), np.empty((most, now.log_weight.size))
    )
    keep(kept, 0, now)
    in_force, ambient_C, shown = np.zeros(n, np.int64), np.full(most, at.air.ambient_C), np.full((n, 4), np.nan)
    for k in range(n):
        in_force[k] = last
        time_s, voltage_V, metered_A, temp_C = rows[0, k], rows[1, k], rows[2, k], rows[3, k]
        dt_s = time_s - at.time_s
        if not (np.isfinite(voltage_V) and np.isfinite(metered_A)) or dt_s < 0.0:
            continue
        if dt_s > BLOCK_S and at.block[1] > 0.0:  # rows before a gap belong to the time before it
            now, at, _ = close(pack, now, at)
        current_A = true_current(pack.installation, metered_A, voltage_V)
        at = with_row(at, time_s, voltage_V, current_A, temp_C)
        if at.block[1] < BLOCK_S:
            shown[k, 0], _, shown[k, 2], shown[k, 3] = within_block(at.tangent, voltage_V, current_A, at.block[2])
            continue
        now, at, (shown[k, 0], shown[k, 1], shown[k, 2], shown[k, 3]) = close(pack, now, at)
        last += 1
        keep(kept, last, now)
        in_force[k], ambient_C[last] = last, at.air.ambient_C
    first = Moments(kept.x[: last + 1], kept.P[: last + 1], kept.log_weight[: last + 1])
    return Filtered(first, ambient_C[: last + 1], in_force, shown, at)
