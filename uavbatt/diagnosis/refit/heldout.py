"""Error on left-out records: each is predicted with the values from the other records."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.diagnosis.refit import residual
from uavbatt.diagnosis.refit.batch import at_best
from uavbatt.diagnosis.refit.problem import Problem, Refit


def open_loop(problem: Problem, fit: Refit, values: list[Array]) -> tuple[float, float]:
    """Return the RMSE of voltage under load above the cut-off [V] and of temperature [K].

    values : the values for each record, [freed] per record.
    """
    u = fit.u.copy()
    for j, own_value in enumerate(values):
        for k, freed, value in zip(fit.quantities, fit.candidate.freed, own_value, strict=True):
            u[j, k] = freed.at(float(value))
    residuals = residual.residuals(problem.evidence, at_best(problem, replace(fit, u=u)))
    stack, squares = problem.evidence.stack, []
    for j, r in enumerate(residuals):
        volts = stack.voltage_V[problem.evidence.volts[j].rows, j]
        squares.append(np.mean(r.voltage_V[~r.rest & (volts > problem.pack.cutoff_V)] ** 2))
    return float(np.sqrt(np.mean(squares))), residual.size_K(residuals)
