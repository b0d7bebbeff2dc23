"""uavbatt: how long a drone can keep flying, how sure that is, and why it can be trusted."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"  # pyproject.toml reads it here
__all__ = [
    "BadInput",
    "Estimate",
    "Estimator",
    "Flight",
    "MissingExtra",
    "NotEnoughData",
    "Remaining",
    "Replay",
    "Sample",
    "Status",
    "UavbattError",
    "Uncertified",
    "UsageError",
    "__version__",
    "read_log",
    "replay",
]

if TYPE_CHECKING:
    from uavbatt.errors import BadInput, MissingExtra, NotEnoughData, UavbattError, Uncertified, UsageError
    from uavbatt.estimator import Estimator
    from uavbatt.log_replay.whole import Replay, replay
    from uavbatt.records import Estimate, Flight, Remaining, Sample, Status
    from uavbatt.telemetry import read_log

_HOMES = {
    "BadInput": "uavbatt.errors",
    "Estimate": "uavbatt.records",
    "Estimator": "uavbatt.estimator",
    "Flight": "uavbatt.records",
    "MissingExtra": "uavbatt.errors",
    "NotEnoughData": "uavbatt.errors",
    "Remaining": "uavbatt.records",
    "Replay": "uavbatt.log_replay.whole",
    "Sample": "uavbatt.records",
    "Status": "uavbatt.records",
    "UavbattError": "uavbatt.errors",
    "Uncertified": "uavbatt.errors",
    "UsageError": "uavbatt.errors",
    "read_log": "uavbatt.telemetry",
    "replay": "uavbatt.log_replay.whole",
}


def __getattr__(name: str) -> Any:
    """Load a public name at its first use, so that `import uavbatt` is fast."""
    if name not in _HOMES:
        raise AttributeError(f"module 'uavbatt' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    """Return the public names alone, which a prompt completes."""
    return sorted(__all__)
