"""Replay a flight log and ask three questions: what was left at landing, how good were the forecasts, when did it warn.

python examples/replay_a_log.py logs/quad_4s.tlog [CAPACITY_AH]
"""

from __future__ import annotations

import math
import sys

import uavbatt


def main(log: str, capacity_Ah: float = math.nan) -> None:
    flown = uavbatt.replay(log, capacity_Ah=capacity_Ah)
    print(flown)

    last = flown.steps[-1]
    print(f"state of charge at the end {last.estimate.soc:.2f} ± {last.estimate.soc_sd:.2f}")

    for check in flown.outcome.checkpoints:  # empty when the log does not reach the end of flight
        print(f"{check.label}: said {check.remaining_s:.0f} s [{check.lo_s:.0f}, {check.hi_s:.0f}], "
              f"true {check.before_end_s:.0f} s")  # fmt: skip

    said = [step.remaining for step in flown.steps]
    first = next((it for it in said if it.remaining_lo_s < 120), None)  # a time that is not known is NaN
    if first is not None:
        print(f"less than two minutes left at worst: from {first.time_s:.0f} s on")


if __name__ == "__main__":
    if not 2 <= len(sys.argv) <= 3:
        sys.exit(__doc__)
    try:
        main(sys.argv[1], *map(float, sys.argv[2:]))
    except uavbatt.UavbattError as error:
        sys.exit(str(error))
