"""How much of the records a model leaves unexplained, compared with what the battery file's own model leaves."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.diagnosis.refit import residual
from uavbatt.diagnosis.refit.problem import Problem, Refit
from uavbatt.diagnosis.refit.residual import Residual
from uavbatt.diagnosis.refit.solver import refit

LEFT = 1.25  # chi-square per number that the model may leave; see scripts/diagnose_cases_chance.py
USUAL = 1.05  # largest value that effect-free flights leave for the voltage
FAR = 2.0  # times the error that the model is expected to have: more is not its wander; 1.8 at most in healthy sets


def explains(problem: Problem, fit: Refit) -> bool:
    """Return True if a refit leaves no more than the file's own model does."""
    misfit = left_per_number(problem, fit)
    return not max(misfit.voltage, misfit.temperature) > LEFT


def floor_V(file: BatteryFile, problem: Problem) -> float:
    """Return the size of residual that the battery's own model leaves on this pack [V]."""
    share = problem.pack.installation.cells / file.battery.cells_series
    return float(file.discrepancy.voltage_rmse_V * share)


class MisfitPerNumber(NamedTuple):
    """MisfitPerNumber holds the chi-square per number that a model leaves."""

    voltage: float
    temperature: float  # NaN: not measured


def left_per_number(problem: Problem, best: Refit) -> MisfitPerNumber:
    """Return the chi-square per number that is left once the file's stated errors are at their most probable.

    The prior of those errors counts with the voltage: an error of six standard errors explains nothing.
    """
    problem = replace(problem, nuisances=problem.stated)
    fit = refit(problem, [best.candidate], start=[best], iterations=6, file_errors=True)[0]
    misfit = per_number(problem, fit)
    numbers = sum(v.rows.size for v in problem.evidence.volts)
    return misfit._replace(voltage=misfit.voltage + (fit.total - float(np.sum(fit.residual**2))) / numbers)


def per_number(problem: Problem, fit: Refit) -> MisfitPerNumber:
    """Return the chi-square per number that a refit leaves of voltage and of temperature."""
    squares, numbers = np.zeros(2), np.zeros(2)
    for row, volts, temps in zip(fit.residual, problem.evidence.volts, problem.evidence.temps, strict=True):
        first, size = volts.rows.size, temps.rows.size if temps is not None else 0
        squares += [np.sum(row[:first] ** 2), np.sum(row[first : first + size] ** 2)]
        numbers += [first, size]
    return MisfitPerNumber(
        float(squares[0] / numbers[0]), float(squares[1] / numbers[1]) if numbers[1] else float("nan")
    )


def times_expected(problem: Problem, file: BatteryFile, after: list[Residual]) -> float:
    """Return the voltage residual under load as a multiple of the error that the model is expected to have there.

    In the chi-square per number an error that lasts for a whole flight counts as a single error, and is hardly seen. A
    file without a learned wander has one error for all charges.
    """
    if file.discrepancy.wander is None:
        return residual.size_V(after) / floor_V(file, problem)
    shares = [r.voltage_V / v.sd for r, v in zip(after, problem.evidence.volts, strict=True)]
    return float(np.sqrt(np.mean([np.mean(s[~r.rest] ** 2) for s, r in zip(shares, after, strict=True)])))
