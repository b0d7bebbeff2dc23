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
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

from uavbatt import dataset
from uavbatt.battery import belief as b
from uavbatt.battery import file
from uavbatt.battery.belief import SIZE
from uavbatt.battery.build import pack_of
from uavbatt.battery.pack import c_rate
from uavbatt.estimation import noise
from uavbatt.estimation.soc_filter import SocFilter
from uavbatt.fitting.battery import Size, fit_battery
from uavbatt.telemetry import read_log

DATA = Path(os.environ.get("UAVBATT_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
SETS = ("reference/r0", "practice/p1")


class Unscented(ExtendedKalmanFilter):
    """filterpy's UKF in the place of the EKF: the linear maps that SocFilter hands over are not used."""

    def __init__(self, dim_x: int, dim_z: int) -> None:
        super().__init__(dim_x, dim_z)
        points = MerweScaledSigmaPoints(dim_x, alpha=0.3, beta=2.0, kappa=0.0)
        self.ukf = UnscentedKalmanFilter(dim_x, dim_z, dt=1.0, hx=None, fx=None, points=points)


class UnscentedSocFilter(SocFilter):
    """SocFilter with the unscented transform for both steps."""

    def _filterpy(self):
        if not isinstance(self._kalman, Unscented):
            kalman = Unscented(SIZE, 2)
            kalman.x, kalman.P = self._kalman.x.copy(), self._kalman.P.copy()
            self._kalman = kalman
        return self._kalman

    def _predict(self, mean_A, dt_s):
        kalman = self._filterpy()
        ukf = kalman.ukf
        ukf.x, ukf.P = kalman.x.copy(), 0.5 * (kalman.P + kalman.P.T) + 1e-12 * np.eye(SIZE)
        rate = float(c_rate(self.pack.installation, mean_A))
        ukf.Q = np.diag(noise.process_variances(self.pack, kalman.x, rate, dt_s))
        ukf.predict(fx=lambda x, dt: b.transition(self.pack, x, mean_A, self._ambient_C, dt_s))
        kalman.x, kalman.P = ukf.x.copy(), ukf.P.copy()
        original = kalman.update

        def update(measured, jacobian, expected, R):
            current_A = self._block_seen_A
            has_temp = len(measured) == 2

            def reading(x):
                volts = float(b.voltage(self.pack, x, current_A))
                return np.array([volts, x[b.C.SENSOR]]) if has_temp else np.array([volts])

            ukf._dim_z = len(measured)
            ukf.z = np.zeros((len(measured), 1))
            ukf.sigmas_h = np.zeros((2 * SIZE + 1, len(measured)))
            ukf.update(measured, R=R, hx=reading)
            kalman.x, kalman.P = ukf.x.copy(), ukf.P.copy()
            kalman.update = original

        kalman.update = update

    def _update(self, block, step_A):
        self._block_seen_A = block.current_A
        return super()._update(block, step_A)


def score(kind: type[SocFilter], battery: file.BatteryFile) -> tuple[float, float, float]:
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
        file.write(fitted.file, path)
    battery = file.read(path)
    print("filter     soc RMSE   worst flight   us a sample")
    for name, kind in (("extended", SocFilter), ("unscented", UnscentedSocFilter)):
        rmse, worst, cost = score(kind, battery)
        print(f"{name:10s} {rmse:8.4f} {worst:14.4f} {cost:13.0f}")


if __name__ == "__main__":
    main()
