"""Drift of an effect within a flight: does its size stay the same from take-off to landing?

    value(t) = value + drift (t/L - 1/2),        t since the record began, L its length
    value(t) = value + drift (T(t) - T_m)/ΔT,    T(t) the temperature read, T_m the middle of all, ΔT their span

Only effects of sensors and wiring can drift here. The states of the cell do not depend on them, so that their values
may differ from row to row. Only the voltage gain is tried along the temperature (a converter that warms up): a current
or a lead that changed with temperature would look like the temperature dependence of the resistance.
"""

from __future__ import annotations

from uavbatt.battery.effects import EFFECTS, unit_words
from uavbatt.diagnosis.refit.candidates import INDEX, QUANTITIES, Candidate, Course, FreeQuantity
from uavbatt.diagnosis.refit.problem import Problem, Refit
from uavbatt.diagnosis.refit.simulation import MAY_DRIFT
from uavbatt.diagnosis.refit.solver import refit

TURNS = 8  # iterations: the start is the fit without drift, so that few are needed
VARIES_WITH_TEMPERATURE = "voltage_gain"  # the only effect that is tried with a drift along the temperature
WITHIN: dict[Course, str] = {
    "time": "within each",
    "temperature": "from the coldest of the temperatures read to the warmest",
}


def drifting(problem: Problem, fit: Refit, along: Course = "time") -> Refit | None:
    """Refit an effect with a drift along time or temperature, equal in all records; None if it cannot drift."""
    first = fit.candidate.freed[fit.candidate.slice_of(fit.candidate.name)][0]
    quantity = next(q for q in EFFECTS[fit.candidate.name].quantities if INDEX[q.name] == first.index)
    if quantity.name not in MAY_DRIFT:
        return None
    widest = quantity.high - quantity.low
    drift = FreeQuantity(first.index, 0.0, quantity.prior_sd, -widest, widest, log=False, along=along)
    both = fit.candidate.plus(Candidate((f"{fit.candidate.name} that drifts",), (drift,), (1,)))
    return refit(problem, [both], start=[fit], iterations=TURNS)[0]


def words(drift: Refit) -> str:
    """Say how the effect changes, as `current_gain is not the same throughout a record: ...`."""
    quantity = drift.candidate.freed[-1]
    unit = unit_words(QUANTITIES[quantity.index].unit)
    change = f"{drift.values()[0][-1]:+.3g} {unit}".strip()
    assert quantity.along is not None  # the quantity that `drifting` has freed last
    name, course = drift.candidate.names[-2], WITHIN[quantity.along]
    return f"{name} is not the same throughout a record: it changes by {change} {course}"
