"""Ask before take-off whether a flight of so many minutes fits, at worst, at the temperature outside.

    python examples/plan_a_flight.py MINUTES POWER_W AMBIENT_C

It runs `uavbatt plan` and reads its JSON: commands and files are the interface for programs in any language.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

PACK = ["--battery", "lipo-generic", "--cells", "4", "--capacity-ah", "5", "--cutoff-voltage", "13.2"]
UAVBATT = Path(sys.executable).with_name("uavbatt")


def main(minutes: str, power_W: str, ambient_C: str) -> int:
    asked = [str(UAVBATT), "plan", *PACK, "--power-w", power_W, "--ambient-c", ambient_C, "--json", "-"]
    done = subprocess.run(asked, stdout=subprocess.PIPE, text=True)  # messages for people go to stderr
    if done.returncode != 0:
        return done.returncode
    planned = json.loads(done.stdout)["planned"]
    if planned["lo_s"] is None:
        print(f"not known: {planned['remark']}")
        return 4
    fits = planned["lo_s"] >= 60.0 * float(minutes)
    print(f"{minutes} min at {power_W} W and {ambient_C} °C: {'fits' if fits else 'does not fit'}; "
          f"19 of 20 such flights last {planned['lo_s'] / 60:.1f} min or more, half of them "
          f"{planned['median_s'] / 60:.1f} min")  # fmt: skip
    return 0 if fits else 1


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    sys.exit(main(*sys.argv[1:]))
