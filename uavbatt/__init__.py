"""uavbatt: how long a drone can keep flying, how sure that is, and why it can be trusted."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"
__all__ = ["Estimate", "Estimator", "Flight", "Remaining", "Sample", "__version__", "read_log"]

if TYPE_CHECKING:
    from uavbatt.estimator import Estimator
    from uavbatt.records import Estimate, Flight, Remaining, Sample
    from uavbatt.telemetry import read_log

_HOMES = {
    "Estimator": "uavbatt.estimator",
    "read_log": "uavbatt.telemetry",
    "Estimate": "uavbatt.records",
    "Flight": "uavbatt.records",
    "Remaining": "uavbatt.records",
    "Sample": "uavbatt.records",
}


def __getattr__(name: str) -> Any:
    """Load on first use, so that `import uavbatt` costs nothing."""
    if name not in _HOMES:
        raise AttributeError(f"module 'uavbatt' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_HOMES[name]), name)
