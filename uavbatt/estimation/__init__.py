"""STATE: the Kalman filter that turns samples into a belief about the pack."""

from uavbatt.estimation.soc_filter import SocFilter

__all__ = ["SocFilter"]
