"""ProgPy's unscented prediction of a battery's end that is 20 minutes away: seconds, and what it said.

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

AHEAD_S = 1200.0
model = BatteryCircuit()


def load(time_s: float, state: object = None) -> object:
    """Constant current."""
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
print(median(spent[1:]), f"said {float(found.time_of_event.mean['EOD']):.1f} s, its own simulation {AHEAD_S:.1f} s")
