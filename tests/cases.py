"""Which of the cases of a test every run asks, and which are left to .ci/run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest


def first_quick(number: int, cases: Sequence[Any]) -> list[Any]:
    """Return the cases as parameters of a test; those after the first `number` are marked slow."""
    return [
        *cases[:number],
        *(pytest.param(*(c if isinstance(c, tuple) else (c,)), marks=pytest.mark.slow) for c in cases[number:]),
    ]
