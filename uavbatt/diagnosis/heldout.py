"""Error on records that were left out: each predicted with the values that the others give."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.diagnosis import attribute, residual
from uavbatt.diagnosis.problem import Problem, Refit
from uavbatt.diagnosis.refit import at_best

WORTH = 0.02  # of the error, in voltage or temperature


def left_out(problem: Problem, fit: Refit) -> list[Array]:
    """Per record, the quantities' values that the other records give; the fit's own when there is one record."""
    if not fit.candidate.freed or len(problem.evidence.names) < 2:
        return [fit.values()[0] if fit.candidate.freed else np.zeros(0)] * len(problem.evidence.names)
    return attribute.left_out(problem, fit)


def open_loop(problem: Problem, fit: Refit, values: list[Array]) -> tuple[float, float]:
    """RMSE under load above the cut-off [V] and of temperature [K], every record with its own given values."""
    first = len(fit.columns) - len(fit.candidate.freed)
    u = fit.u.copy()
    for j, given in enumerate(values):
        for k, freed in enumerate(fit.candidate.freed):
            u[j, first + k] = freed.at(float(given[k]))
    found = residual.residuals(problem.evidence, at_best(problem, replace(fit, u=u)))
    stack, squares = problem.evidence.stack, []
    for j, r in enumerate(found):
        volts = stack.voltage_V[problem.evidence.volts[j].rows, j]
        squares.append(np.mean(r.voltage_V[~r.rest & (volts > problem.pack.cutoff_V)] ** 2))
    return float(np.sqrt(np.mean(squares))), residual.size_K(found)


def helps(problem: Problem, before: Refit, after: Refit) -> bool:
    """Whether `after` predicts the records left out better than `before`, in voltage or else in temperature."""
    plain_V, plain_K = open_loop(problem, before, left_out(problem, before))
    fixed_V, fixed_K = open_loop(problem, after, left_out(problem, after))
    if fixed_V < (1.0 - WORTH) * plain_V:
        return True
    return bool(fixed_V < (1.0 + WORTH) * plain_V and fixed_K < (1.0 - WORTH) * plain_K)
