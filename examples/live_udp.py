"""Estimate live from MAVLink over UDP in your own program, without the companion process.

    python examples/live_udp.py udpin:127.0.0.1:14551 [ROWS]

This is the shortest program that works: it reads BATTERY_STATUS and prints one line. `uavbatt live` also handles stale
links, pack changes, parameters of the vehicle, recording and feeds.
"""

from __future__ import annotations

import sys
import time

from pymavlink import mavutil

import uavbatt

UNKNOWN_mV, UNKNOWN_cA, UNKNOWN_cdegC = 65535, -1, 32767  # what MAVLink sends for "not measured"


def sample_of(message: object, now_s: float) -> uavbatt.Sample:
    """Return one row of the battery in SI units; values that stand for "unknown" become NaN."""
    cells_mV = [v for v in message.voltages if v not in (0, UNKNOWN_mV)]  # type: ignore[attr-defined]
    current_cA, temp_cdegC = message.current_battery, message.temperature  # type: ignore[attr-defined]
    return uavbatt.Sample(
        time_s=now_s,
        voltage_V=sum(cells_mV) / 1000.0 if cells_mV else float("nan"),
        current_A=float("nan") if current_cA == UNKNOWN_cA else current_cA / 100.0,
        temp_C=float("nan") if temp_cdegC == UNKNOWN_cdegC else temp_cdegC / 100.0,
    )


def main(endpoint: str, rows: float = float("inf")) -> None:
    link = mavutil.mavlink_connection(endpoint)
    estimator = uavbatt.Estimator.from_battery("lipo-generic", cells=4, capacity_Ah=5.0, cutoff_V=13.2)
    seen = 0
    while seen < rows:
        message = link.recv_match(type="BATTERY_STATUS", blocking=True, timeout=10.0)
        if message is None:
            sys.exit(f"{endpoint}: no BATTERY_STATUS for 10 s")
        estimate, remaining = estimator.step(sample_of(message, time.monotonic()))
        seen += 1
        left = f"{remaining.remaining_s:.0f} s left [{remaining.remaining_lo_s:.0f}, {remaining.remaining_hi_s:.0f}]"
        told = left if remaining.status is not uavbatt.Status.REFUSED else f"no forecast: {remaining.reason}"
        print(f"soc {estimate.soc:.2f} ± {estimate.soc_sd:.2f}, {told}", flush=True)


if __name__ == "__main__":
    if not 2 <= len(sys.argv) <= 3:
        sys.exit(__doc__)
    main(sys.argv[1], *map(float, sys.argv[2:]))
