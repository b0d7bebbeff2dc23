"""STATE: the Kalman filter that turns samples into a belief about the pack."""

from uavbatt.estimation.filter import SocFilter

__all__ = ["SocFilter"]
