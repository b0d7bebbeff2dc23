#!/usr/bin/env python3
"""Extended against unscented Kalman filter on the same battery model: accuracy on flights with known truth, and cost.

Run: .venv/bin/python scripts/compare_filters.py [BATTERY_FILE]    (needs the shared data; a battery file fitted to
`truth/lab` and `truth/reference` with `uavbatt fit` is made when none is named)
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path
from unittest.mock import patch

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
from scoring.truth import truth_battery

from uavbatt.battery import battery_file
from uavbatt.battery import state_space as b
from uavbatt.battery.model import Array
from uavbatt.battery.pack import c_rate
from uavbatt.battery.scaling import Pack, pack_of
from uavbatt.battery.state_space import SIZE
from uavbatt.estimation import kalman, noise, recursion
from uavbatt.estimation.filter import SocFilter
from uavbatt.estimation.kalman import Condition
from uavbatt.estimation.recursion import FilterState, Innovation
from uavbatt.telemetry import read_log

DATA = Path(os.environ.get("UAVBATT_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
SETS = ("reference/r0", "practice/p1")


def unscented_close(
    pack: Pack, state: FilterState, condition: Condition = kalman.condition
) -> tuple[FilterState, Innovation]:
    """Do what `recursion._close` does, with filterpy's unscented transform for both steps.

    condition : takes the pseudo-measurement in by which a cell is never more than full; the block's own goes unscented.
    """
    block, at = state.block, state.belief
    mean_A, dt_s = block.charge_As / block.duration_s, block.duration_s
    points = MerweScaledSigmaPoints(SIZE, alpha=0.3, beta=2.0, kappa=0.0)
    ukf = UnscentedKalmanFilter(SIZE, 2, dt=1.0, hx=None, fx=None, points=points)
    ukf.x, ukf.P = at.means[0].copy(), at.covariances[0] + 1e-12 * np.eye(SIZE)
    ukf.Q = np.diag(noise.process_variances(pack, at.means[0], float(c_rate(pack.installation, mean_A)), dt_s))
    ukf.predict(fx=lambda x, dt: b.transition(pack, x, mean_A, at.ambient_C, dt_s))
    updates = 0

    def by_unscented(x: Array, P: Array, innovation: Array, observation: Array, noise_R: Array) -> tuple[Array, Array]:
        nonlocal updates
        updates += 1
        if updates > 1:  # a cell is never more than full
            return condition(x, P, innovation, observation, noise_R)
        count = innovation.shape[1]

        def reading(x: Array) -> Array:
            volts = float(b.voltage(pack, x, block.current_A))
            return np.array([volts, x[b.X.SENSOR] + pack.installation.offset_K])[:count]

        ukf._dim_z = count
        ukf.z, ukf.sigmas_h = np.zeros((count, 1)), np.zeros((2 * SIZE + 1, count))
        ukf.update(np.array([block.voltage_V, block.temp_C])[:count], R=noise_R[0], hx=reading)
        return ukf.x[None].copy(), ukf.P[None].copy()

    predicted = b.Belief(ukf.x[None].copy(), ukf.P[None].copy(), at.log_weights, at.ambient_C)
    step_A = block.current_A - state.block_A
    belief, shown, air = recursion._update(pack, predicted, state.air, block, step_A, by_unscented, weighs=True)
    after = recursion.state_at(pack, belief, state.time_s, state.current_A, air)
    return after._replace(block_A=block.current_A), shown


def score(battery: battery_file.BatteryFile) -> tuple[float, float, float]:
    """Return (soc RMSE over the eight flights, the worst flight's, microseconds a sample)."""
    errors, spent, rows = [], 0.0, 0
    for folder in SETS:
        for number in (1, 2, 3, 4):
            flight = read_log(DATA / "truth" / folder / f"flight_{number}.tlog")
            answers = DATA / "truth/answers" / folder / f"flight_{number}.csv"
            truth = np.genfromtxt(answers, delimiter=",", skip_header=1)
            estimator = SocFilter(pack_of(battery, 4, 5.016, 13.2, 14.0))
            begun = time.perf_counter()
            said = np.array([(s.time_s, estimator.step(s).soc) for s in flight.samples])
            spent, rows = spent + time.perf_counter() - begun, rows + len(said)
            errors.append(np.sqrt(np.mean((said[:, 1] - np.interp(said[:, 0], truth[:, 0], truth[:, 1])) ** 2)))
    return float(np.sqrt(np.mean(np.square(errors)))), max(errors), 1e6 * spent / rows


def main() -> None:
    """Print the table."""
    if not DATA.is_dir():
        sys.exit(f"{DATA}: expected the shared data (set UAVBATT_DATA)")
    if len(sys.argv) > 1:
        path = Path(sys.argv[1])
    else:
        path = Path(tempfile.mkdtemp()) / "truth.battery.toml"
        battery_file.write_battery(truth_battery(DATA), path)
    battery = battery_file.read_battery(path)
    print("filter     soc RMSE   worst flight   us a sample")
    for name, close in (("extended", recursion._close), ("unscented", unscented_close)):
        with patch.object(recursion, "_close", close):
            rmse, worst, cost = score(battery)
        print(f"{name:10s} {rmse:8.4f} {worst:14.4f} {cost:13.0f}")


if __name__ == "__main__":
    main()
