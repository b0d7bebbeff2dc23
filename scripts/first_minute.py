"""Count of the first intervals after take-off that miss the end of their flight.

    python scripts/first_minute.py [--part tuned|kept|all] [--only generic|fitted] [--each]

Every shared flight, from the first interval that is shown and 5, 15 and 30 s later: an interval misses when it does not
contain the true end or, where a log has no end, does not meet the last interval of its flight. Flights of an even
number in their folder may be looked at while forecasts are tuned, the others are kept back for the end.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

os.environ.setdefault("OMP_NUM_THREADS", "1")  # small matrices: a second thread only gets in the way

from scoring.progress import progress
from scoring.table import Table

if TYPE_CHECKING:
    from scoring.first_intervals import EarlyIntervals

PARTS: dict[str, Callable[[int], bool]] = {
    "tuned": lambda number: number % 2 == 0,
    "kept": lambda number: number % 2 == 1,
    "all": lambda number: True,
}


def main(arguments: list[str] | None = None) -> int:
    """Print the table; 1 when the data are not there."""
    from scoring import data, first_intervals

    from uavbatt.errors import UavbattError

    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--part", choices=PARTS, default="all", help="which half of the flights")
    parser.add_argument("--only", choices=("generic", "fitted"), help="one kind of files")
    parser.add_argument("--set", help="sets whose name holds this word")
    parser.add_argument("--each", action="store_true", help="also a line for each flight")
    given = parser.parse_args(arguments)
    say = progress(time.monotonic())
    found: list[first_intervals.EarlyIntervals] = []
    try:
        folder = data.folder()
        kinds = {"generic": first_intervals.generic, "fitted": first_intervals.fitted}
        for kind in [given.only] if given.only else kinds:
            for flown in kinds[kind](folder):
                if given.set is None or given.set in flown.name:
                    found += first_intervals.firsts(flown, PARTS[given.part], say)
    except UavbattError as error:
        print(f"first_minute: {error}", file=sys.stderr)
        return error.exit_code
    if given.each:
        print("\n".join(_line(first) for first in found))
    print(_table(found, given.part).text())
    return 0


def _line(first: EarlyIntervals) -> str:
    from scoring.first_intervals import AFTER_S

    said = " ".join(
        f"{'!' if first.misses(k) else ' '}[{shown[0]:.0f}, {shown[1]:.0f}]" if (shown := first.shown[k]) else "refused"
        for k in range(len(AFTER_S))
    )
    return f"{first.of:24} {first.name:30} {said}  {'end' if first.is_end else 'last'} {first.end_s}"


def _table(firsts: list[EarlyIntervals], part: str) -> Table:
    from scoring.first_intervals import AFTER_S

    groups = {name: [f for f in firsts if f.of == name] for name in dict.fromkeys(f.of for f in firsts)}
    rows = []
    for name, flights in {**groups, "all": firsts}.items():
        missed = [f"{sum(f.misses(k) for f in flights)}" for k in range(len(AFTER_S))]
        refused = [f"{sum(f.shown[k] is None for f in flights)}" for k in range(len(AFTER_S))]
        widths = [s[1] - s[0] for f in flights if (s := f.shown[0]) is not None]
        width_s = f"{statistics.median(widths):.0f}" if widths else "–"
        cells = [f"{m} ({r})" if r != "0" else m for m, r in zip(missed, refused, strict=True)]
        rows.append((name, str(len(flights)), str(sum(f.is_end for f in flights)), *cells, width_s))
    head = ("set", "flights", "with an end", "first", *(f"+{s:.0f} s" for s in AFTER_S[1:]), "first width [s]")
    return Table(f"First intervals that miss ({part})", head, tuple(rows), "In brackets: refused at that instant.")


if __name__ == "__main__":
    sys.exit(main())
