"""ProgPy's unscented prediction of a battery's end that is 20 minutes away: seconds, and what it said, beside its own
simulation of many draws.

Its own BatteryCircuit under constant current, steps of 1 s, 1 % of uncertainty in each state. Run by `engine.progpy_s`
with the interpreter that has ProgPy (`pip install progpy`).
"""

from __future__ import annotations

import time
from statistics import median

import numpy as np
from progpy.models import BatteryCircuit
from progpy.predictors import UnscentedTransform
from progpy.uncertain_data import MultivariateNormalDist

AHEAD_S, DRAWS = 1200.0, 200
model = BatteryCircuit()


def load(time_s: float, state: object = None) -> object:
    """Return a constant current of 2 A."""
    return model.InputContainer({"i": 2.0})


end_s = model.simulate_to_threshold(load, dt=1, save_freq=1e9).times[-1]
state = model.simulate_to(end_s - AHEAD_S, load, dt=1).states[-1]
labels = list(state.keys())
mean = np.array([float(np.squeeze(state[name])) for name in labels])
belief = MultivariateNormalDist(labels, mean, np.diag((0.01 * np.maximum(np.abs(mean), 1e-3)) ** 2))
predictor = UnscentedTransform(model, Q=np.eye(len(labels)) * 1e-8)
spent = []
for _ in range(4):
    begin = time.perf_counter()
    found = predictor.predict(belief, load, dt=1, save_freq=AHEAD_S, horizon=2 * AHEAD_S)
    spent.append(time.perf_counter() - begin)


def drawn_end_s(values: np.ndarray) -> float:
    """Return the end [s] of ProgPy's own simulation from one draw of the belief."""
    start = model.StateContainer(dict(zip(labels, values, strict=True)))
    return float(model.simulate_to_threshold(load, x=start, dt=1, save_freq=1e9, horizon=2 * AHEAD_S).times[-1])


random = np.random.default_rng(7)
ends_s = [drawn_end_s(x) for x in random.multivariate_normal(mean, belief.cov, DRAWS)]
said_s, sd_s = float(found.time_of_event.mean["EOD"]), float(np.sqrt(found.time_of_event.cov[0][0]))
said = ", ".join(f"{said_s + z * sd_s:.0f}" for z in (-1.645, 0.0, 1.645))
truth = ", ".join(f"{s:.0f}" for s in np.quantile(ends_s, (0.05, 0.5, 0.95)))
print(median(spent[1:]), f"ProgPy's own model, drawn {DRAWS} times: {said} s of {truth} s")
