"""What the flight page reads, as shapes: the page lies below replay and pipeline and must not import them.

`replay.Step`, `replay.Outcome`, `replay.Checkpoint` and `pipeline.Resolved` have these shapes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from uavbatt.records import Estimate, Remaining


class StepLike(Protocol):
    """One output line."""

    @property
    def estimate(self) -> Estimate:
        """The filter's belief after the row."""

    @property
    def remaining(self) -> Remaining:
        """The forecast after the row."""


class CheckpointLike(Protocol):
    """The forecast at one instant before the known end."""

    @property
    def label(self) -> str:
        """The instant in words."""

    @property
    def before_end_s(self) -> float:
        """The true remaining time [s]."""

    @property
    def remaining_s(self) -> float:
        """The forecast [s], NaN when refused."""

    @property
    def lo_s(self) -> float:
        """Its 5 % point [s]."""

    @property
    def hi_s(self) -> float:
        """Its 95 % point [s]."""

    @property
    def error_s(self) -> float:
        """Forecast less truth [s]; positive is optimistic."""

    @property
    def inside(self) -> bool:
        """Whether the truth lies in the interval."""


class OutcomeLike(Protocol):
    """What a replay shows in figures; NaN where it cannot be told."""

    @property
    def rows(self) -> int:
        """Number of rows."""

    @property
    def duration_s(self) -> float:
        """From the first row to the last [s]."""

    @property
    def end_voltage_V(self) -> float:
        """The last voltage [V]."""

    @property
    def end_soc(self) -> float:
        """State of charge after the last row, 0..1."""

    @property
    def end_soc_sd(self) -> float:
        """Its standard deviation."""

    @property
    def end_of_flight_s(self) -> float:
        """When the flight ended by the battery [s], NaN when the log does not show it."""

    @property
    def refused_in_air(self) -> float:
        """Share of rows refused after the first minute under load."""

    @property
    def mean_nis(self) -> float:
        """Mean normalised innovation squared."""

    @property
    def checkpoints(self) -> Sequence[CheckpointLike]:
        """Forecasts at fixed instants before the end."""


class ResolvedLike(Protocol):
    """The pack as it was estimated, and where each number came from."""

    @property
    def battery(self) -> str:
        """Name of the battery file."""

    @property
    def status(self) -> str:
        """`certified`, `fitted`, `generic` or `edited`."""

    @property
    def cells(self) -> int:
        """Cells in series."""

    @property
    def cells_from(self) -> str:
        """Who said so."""

    @property
    def capacity_Ah(self) -> float:
        """Capacity of the pack [Ah]."""

    @property
    def capacity_from(self) -> str:
        """Who said so."""

    @property
    def cutoff_V(self) -> float:
        """The voltage that ends the flight [V]."""

    @property
    def cutoff_from(self) -> str:
        """Who said so."""

    @property
    def low_V(self) -> float:
        """The vehicle's low-voltage warning [V]."""

    @property
    def low_from(self) -> str:
        """Who said so."""
