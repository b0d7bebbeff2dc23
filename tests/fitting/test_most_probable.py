"""Searches side by side: each finds what it finds alone, to the last digit, and an error ends them all."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from uavbatt.battery.model import Array
from uavbatt.fitting.most_probable import Residuals, most_probable

ENDS = {"evaluations": 50, "xtol": 1e-9, "ftol": 1e-9}
TARGETS = (np.array([1.5, 0.7, 3.0]), np.array([1.0, 1.0, 1.0]), np.array([0.2, 9.0]))


def compared_with(target: Array) -> Residuals:
    return lambda u, simulated: np.concatenate([simulated[:, : target.size] - target, 0.1 * u], axis=1)


def test_each_search_ends_where_it_ends_alone() -> None:
    together = most_probable(np.exp, [compared_with(t) for t in TARGETS], [np.zeros(3)] * 3, **ENDS)
    for target, found in zip(TARGETS, together, strict=True):
        (alone,) = most_probable(np.exp, [compared_with(target)], [np.zeros(3)], **ENDS)
        assert np.array_equal(found.x, alone.x) and np.array_equal(found.jac, alone.jac)
    assert len({found.nfev for found in together}) > 1  # the others went on without the first that was done
    assert most_probable(np.exp, [], [], **ENDS) == []


def test_an_error_is_raised_and_nobody_waits_for_ever() -> None:
    def breaks(u: Array, simulated: Array) -> Array:
        raise ArithmeticError("in a residual")

    def fails(u: Array) -> Array:
        raise ArithmeticError("in the simulation")

    before, others = threading.active_count(), compared_with(TARGETS[0])
    with pytest.raises(ArithmeticError, match="in a residual"):
        most_probable(np.exp, [others, breaks], [np.zeros(3)] * 2, **ENDS)
    with pytest.raises(ArithmeticError, match="in the simulation"):
        most_probable(fails, [others, others], [np.zeros(3)] * 2, **ENDS)
    assert threading.active_count() == before
