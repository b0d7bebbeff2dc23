"""Every score of the project in one run, beside the methods of PX4, ArduPilot and INAV.

    python scripts/score.py [--only m100|truth|flights|routes] [--markdown FILE]

Reads the measured data ($UAVBATT_DATA, else ../shared/data beside the checkout). Tables go to stdout, progress to
stderr; --markdown also writes them for docs/scores.md.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # small matrices: a second thread only gets in the way

from scoring.progress import progress
from scoring.table import Table

SECTIONS = ("m100", "truth", "flights", "routes")


def main(arguments: list[str] | None = None) -> int:
    """Run the chosen sections; 1 when the data are not there."""
    from uavbatt.errors import UavbattError
    from uavbatt.files import atomic_write

    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--only", choices=SECTIONS, action="append", help="one section; may be given again")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="also write the tables as Markdown")
    given = parser.parse_args(arguments)
    tables: list[Table] = []
    try:
        for section in given.only or SECTIONS:
            made = _section(section)
            print("\n".join(t.text() for t in made), flush=True)
            tables += made
        if given.markdown is not None:
            with atomic_write(given.markdown, "w") as stream:
                stream.write("\n".join(t.markdown() for t in tables) + "\n")
    except UavbattError as error:
        print(f"score: {error}", file=sys.stderr)
        return error.exit_code
    return 0


def _section(name: str) -> list[Table]:
    from scoring import data

    folder, began_s = data.folder(), time.monotonic()
    say = progress(began_s)
    if name == "m100":
        from scoring import m100, m100_tables

        made = m100_tables.tables(m100.results(data.m100(folder), say))
    elif name == "truth":
        from scoring import truth

        made = truth.tables(folder, say)
    elif name == "routes":
        from scoring import routes

        made = routes.tables(folder, say)
    else:
        from scoring import shared

        made = shared.tables(folder, say)
    say(f"{name}: done")
    return made


if __name__ == "__main__":
    sys.exit(main())
