"""A delay that is none: a reading behind a filter follows the truth gradually, and not late as a whole.

Averaging over a few seconds is common in power modules and in firmware. Behind a first-order filter of tau a step of
the load arrives as 1 - exp(-t/tau). With a single delay in its place, the model is wrong after every step. The effect
has no name among the candidates: a battery file with a delay in it would be wrong in flight.
"""

from __future__ import annotations

from dataclasses import replace

from uavbatt.diagnosis.refit import late_current
from uavbatt.diagnosis.refit.problem import Problem, Refit
from uavbatt.diagnosis.refit.solver import SETTLED, refit

STANDS_FOR = "current_delay"


def following(problem: Problem, fit: Refit) -> Refit | None:
    """Refit a delay, the effect added last, as a filter of one reading; None for any other effect.

    Of the result a positive value is the time constant [s] of the current, a negative one that of the voltage.
    """
    if fit.candidate.name != STANDS_FOR:
        return None
    evidence = problem.evidence
    followed_A = late_current.followed(evidence.records, evidence.stack)
    filtered = replace(problem, evidence=replace(evidence, shifted_A=followed_A))
    return refit(filtered, [fit.candidate], start=[fit], iterations=SETTLED)[0]


def words(slow: Refit) -> str:
    """Say which reading follows gradually, as `current_delay is no delay: the voltage read follows ...`."""
    place = slow.candidate.slice_of(STANDS_FOR).start
    tau_s = float(slow.values()[0][place])
    reading = "current" if tau_s > 0 else "voltage"
    return (
        f"{STANDS_FOR} is no delay: the {reading} read follows the truth gradually, as behind a filter of "
        f"{abs(tau_s):.1f} s"
    )
