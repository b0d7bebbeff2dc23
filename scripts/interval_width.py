"""Sources of the width of the interval, on packs of a model that is not ours.

    python scripts/interval_width.py [--battery fitted|generic] [--each N]

Takes the flights of `wrong_packs.py` whose current is read right, and replaces one doubt after the other by the truth.
The table goes to stdout, progress to stderr.
"""

from __future__ import annotations

import argparse
import os
import sys
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")  # small matrices: a second thread only gets in the way

from scoring.progress import progress


def main(arguments: list[str] | None = None) -> int:
    """Print the table."""
    from scoring import width, wrong_cases

    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--battery", choices=(wrong_cases.FITTED, wrong_cases.GENERIC), default=wrong_cases.FITTED)
    parser.add_argument("--each", type=int, default=6, metavar="N", help="flights of each group")
    given = parser.parse_args(arguments)
    say, found = progress(time.monotonic()), list[width.Instant]()
    for case in wrong_cases.metered(given.each, given.battery):
        say(case.name)
        found += width.instants(case)
    print(width.table(f"What makes the interval wide, {given.battery} battery", found).text())
    return 0


if __name__ == "__main__":
    sys.exit(main())
