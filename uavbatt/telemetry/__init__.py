"""IN: flight logs of any kind become a `Flight`; nothing heavy is imported until a log is read."""

from uavbatt.telemetry.read import read_log

__all__ = ["read_log"]
