"""The engine: the functions that work on many rows at once, in numpy or compiled."""

from __future__ import annotations

from typing import NamedTuple

from uavbatt.battery.openloop import States, states
from uavbatt.estimation.recursion import Window, filter_window
from uavbatt.prediction.batch import Answers, answers


class Engine(NamedTuple):
    """Engine holds the functions that work on many rows at once; an `Estimator` uses the first two in `run`.

    `PLAIN` is their numpy form, `compiled.engine()` their compiled form. `Estimator.step` uses neither.
    """

    filter_window: Window = filter_window  # the filter over the rows of a window
    answers: Answers = answers  # the ends of forecasts
    states: States = states  # the model without correction, for `diagnosis`


PLAIN = Engine()
