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

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from uavbatt import dataset
from uavbatt.battery import battery_file
from uavbatt.battery import state_space as b
from uavbatt.battery.pack import c_rate
from uavbatt.battery.scaling import pack_of
from uavbatt.battery.state_space import SIZE
from uavbatt.estimation import noise
from uavbatt.estimation.filter import SocFilter
from uavbatt.estimation.recursion import Moments
from uavbatt.fitting.battery import Size, fit_battery
from uavbatt.telemetry import read_log

DATA = Path(os.environ.get("UAVBATT_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
SETS = ("reference/r0", "practice/p1")


class UnscentedSocFilter(SocFilter):
    """SocFilter with filterpy's unscented transform for both steps: the linear maps that it hands over are not used."""

    def _predict(self, mean_A, dt_s):
        at = self._moments()
        points = MerweScaledSigmaPoints(SIZE, alpha=0.3, beta=2.0, kappa=0.0)
        self._ukf = ukf = UnscentedKalmanFilter(SIZE, 2, dt=1.0, hx=None, fx=None, points=points)
        ukf.x, ukf.P = at.x[0].copy(), at.P[0] + 1e-12 * np.eye(SIZE)
        rate, before = (float(c_rate(self.pack.installation, amps)) for amps in (mean_A, self._block_A))
        ukf.Q = np.diag(noise.process_variances(self.pack, at.x[0], rate, dt_s, before))
        ukf.predict(fx=lambda x, dt: b.transition(self.pack, x, mean_A, self._ambient_C, dt_s))
        self._at = Moments(ukf.x[None].copy(), ukf.P[None].copy(), at.log_weight)

    def _update(self, block, step_A):
        self._block_seen = block
        return super()._update(block, step_A)

    def _condition(self, at, innovation, observation, noise_R):
        block, ukf = self._block_seen, self._ukf
        if block is None:  # a cell is never more than full
            return super()._condition(at, innovation, observation, noise_R)
        self._block_seen = None
        count = innovation.shape[1]

        def reading(x):
            volts = float(b.voltage(self.pack, x, block.current_A))
            return np.array([volts, x[b.C.SENSOR]])[:count]

        ukf._dim_z = count
        ukf.z, ukf.sigmas_h = np.zeros((count, 1)), np.zeros((2 * SIZE + 1, count))
        ukf.update(np.array([block.voltage_V, block.temp_C])[:count], R=noise_R[0], hx=reading)
        return Moments(ukf.x[None].copy(), ukf.P[None].copy(), at.log_weight)


def score(kind: type[SocFilter], battery: battery_file.BatteryFile) -> tuple[float, float, float]:
    """(soc RMSE over the eight flights, the worst flight's, microseconds a sample)."""
    errors, spent, rows = [], 0.0, 0
    for folder in SETS:
        for number in (1, 2, 3, 4):
            flight = read_log(DATA / "truth" / folder / f"flight_{number}.tlog")
            answers = DATA / "truth/answers" / folder / f"flight_{number}.csv"
            truth = np.genfromtxt(answers, delimiter=",", skip_header=1)
            estimator = kind(pack_of(battery, 4, 5.016, 13.2, 14.0))
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
        flights = [read_log(DATA / f"truth/reference/r0/flight_{n}.tlog") for n in (1, 2, 3, 4)]
        fitted = fit_battery(Size("truth", 4, 5.0, 13.2), [dataset.load(DATA / "truth/lab")], flights)
        battery_file.write(fitted.file, path)
    battery = battery_file.read(path)
    print("filter     soc RMSE   worst flight   us a sample")
    for name, kind in (("extended", SocFilter), ("unscented", UnscentedSocFilter)):
        rmse, worst, cost = score(kind, battery)
        print(f"{name:10s} {rmse:8.4f} {worst:14.4f} {cost:13.0f}")


if __name__ == "__main__":
    main()
