"""The engine: who does the works that can be done at once for many rows."""

from __future__ import annotations

from typing import NamedTuple

from uavbatt.battery.openloop import States, states
from uavbatt.estimation.recursion import Window, filter_window
from uavbatt.prediction.batch import Answers, answers


class Engine(NamedTuple):
    """The works that can be done at once for many rows or columns; an Estimator uses the first two.

    `PLAIN` does them in numpy, `compiled.engine()` in compiled code; live programs need neither.
    """

    filter_window: Window = filter_window  # the filter over the rows of a window
    answers: Answers = answers  # the ends of forecasts
    states: States = states  # the model without correction, for `diagnosis`


PLAIN = Engine()
