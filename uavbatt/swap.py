"""Is it another pack? A value that goes from row to row.

A pack is changed on the ground, and the telemetry falls silent meanwhile. After a silence a rested pack that shows,
row after row, another voltage than the believed one, up or down, is another. Without a silence only far too much
voltage tells: a rested pack that was just loaded shows too little for minutes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from uavbatt.records import NAN, Estimate

RESTED_C_RATE, SWAP_ROWS = 0.15, 3
FAR_CELL_V = 0.12
SILENCE_S, SILENT_ROWS, ODD_CELL_V, STEADY_CELL_V = 5.0, 4.0, 0.05, 0.03
NO_PACK_CELL_V = 2.0  # the autopilot lives on another supply
ROW_MEMORY = 0.9


@dataclass(frozen=True, slots=True)
class SwapWatch:
    """Since the last row with a pack at `seen_s`; `rows` in turn have shown another pack."""

    seen_s: float = NAN
    row_s: float = NAN  # the usual time between two rows
    is_after_silence: bool = False
    odd_V: float = NAN  # of the first odd row after a silence
    rows: int = 0

    @property
    def is_another(self) -> bool:
        """Whether enough rows have shown another pack."""
        return self.rows >= SWAP_ROWS

    def after(self, estimate: Estimate, cells: int, capacity_Ah: float) -> SwapWatch:
        """What is known after one more row."""
        if not estimate.voltage_V > NO_PACK_CELL_V * cells:
            return self
        now = self._at(estimate.time_s)
        if not abs(estimate.current_A) < RESTED_C_RATE * capacity_Ah:
            return replace(now, is_after_silence=False, odd_V=NAN, rows=0)
        other = estimate.innovation_V > FAR_CELL_V * cells
        if now.is_after_silence:  # the first odd row speaks for those like it: by then the filter has given in
            if not math.isfinite(now.odd_V) and abs(estimate.innovation_V) > ODD_CELL_V * cells:
                now = replace(now, odd_V=estimate.voltage_V)
            other = other or abs(estimate.voltage_V - now.odd_V) < STEADY_CELL_V * cells
        return replace(now, rows=now.rows + 1 if other else 0)

    def _at(self, time_s: float) -> SwapWatch:
        """The time has gone on; a silence may have passed."""
        gap_s = time_s - self.seen_s
        usual_s = self.row_s if math.isfinite(self.row_s) else 0.0
        if gap_s > max(SILENCE_S, SILENT_ROWS * usual_s):
            return replace(self, seen_s=time_s, is_after_silence=True, odd_V=NAN, rows=0)
        if not gap_s > 0.0:
            return replace(self, seen_s=time_s)
        row_s = gap_s + (self.row_s - gap_s) * ROW_MEMORY if math.isfinite(self.row_s) else gap_s
        return replace(self, seen_s=time_s, row_s=row_s)
