"""The pack ledger against packs whose true health is known: flight by flight, with and without it.

    python scripts/score_packs.py [--pack NAME]... [--markdown FILE] [--no-temperature]

The battery file is fitted from truth/lab and truth/reference. N1 and O1 were kept back while the slow filter was made.
Tables go to stdout, progress to stderr.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # small matrices: a second thread only gets in the way

KEPT_BACK = ("N1", "O1")


def main(arguments: list[str] | None = None) -> int:
    """Fly the packs and print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--pack", action="append", help="one pack's folder; may be given again; default: all")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="also write the tables as Markdown")
    parser.add_argument("--no-temperature", action="store_true", help="leave the thermometer of the packs out")
    given = parser.parse_args(arguments)

    from scoring import data, packs
    from scoring.progress import progress
    from scoring.table import show
    from scoring.truth import truth_battery

    from uavbatt.packs.ledger import Ledger

    say, folder = progress(time.monotonic()), data.folder()
    names = given.pack or sorted(path.name for path in (folder / "packs/practice").iterdir())
    say("packs: fitting the battery")
    battery = truth_battery(folder)
    with tempfile.TemporaryDirectory() as place, Ledger(Path(place) / "packs.sqlite") as ledger:
        has_thermometer = not given.no_temperature
        found = [
            flown
            for name in names
            for flown in packs.flown(folder, name, battery, ledger, say, has_thermometer=has_thermometer)
        ]
    show([packs.table(found), packs.summary(found, KEPT_BACK)], given.markdown)
    return 0


if __name__ == "__main__":
    sys.exit(main())
