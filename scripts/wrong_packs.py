"""Packs of another model that differ from what is stated: the forecasts and warnings, and how late they come.

    python scripts/wrong_packs.py [--only estimator|mixed|landed|gauged|live] [--quick] [--markdown FILE]
                                  [--flight NAME]

Flies small, worn, part-charged and mis-stated packs through the estimator, with the generic battery and with one fitted
to healthy packs of the make (mixed: to packs of every age; landed: to the same, whose crews land with charge left;
gauged: generic, of packs that say themselves what they hold), and the faults of sensors, swaps and statements through
the companion process. Reports, does not judge. Tables go to stdout, progress to stderr; --markdown also writes them for
docs/wrong_packs.md.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar

os.environ.setdefault("OMP_NUM_THREADS", "1")  # small matrices: a second thread only gets in the way

from scoring.progress import progress
from scoring.table import Table, show

SECTIONS = ("estimator", "mixed", "landed", "gauged", "live")
EACH, EACH_QUICK, WORKERS = 6, 2, 2
SHOWN_S, SHOWN_EVERY_S = 180.0, 5.0
Given = TypeVar("Given")
Made = TypeVar("Made")


def main(arguments: list[str] | None = None) -> int:
    """Fly the chosen sections, or one flight."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--only", choices=SECTIONS, action="append", help="one section; may be given again")
    parser.add_argument("--quick", action="store_true", help="a third of the flights, the faults of the tests alone")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="also write the tables as Markdown")
    parser.add_argument("--flight", metavar="NAME", help="print the lines of one flight's last three minutes")
    given = parser.parse_args(arguments)
    if given.flight is not None:
        return _one(given.flight)
    show(_tables(given.only or SECTIONS, given.quick), given.markdown)
    return 0


def _tables(sections: Iterable[str], is_quick: bool) -> list[Table]:
    from scoring import scenarios, wrong_cases, wrong_judged, wrong_live, wrong_tables

    say, made = progress(time.monotonic()), []
    flown: list[wrong_judged.Judged] = []
    faults: list[wrong_live.Heard] = []
    each = EACH_QUICK if is_quick else EACH
    cases = wrong_cases.every(each) if "estimator" in sections else []
    for fleet in wrong_cases.FLEETS:
        cases += wrong_cases.of_fleet(each, fleet) if fleet in sections else []
    cases += wrong_cases.gauged(each) if "gauged" in sections else []
    if cases:
        flown = list(_each(wrong_judged.judged, cases, say, "estimator"))
        made += [wrong_tables.issue(flown), wrong_tables.groups(flown), wrong_tables.worst(flown)]
    if "live" in sections:
        names = [*scenarios.SCENARIOS, *(() if is_quick else scenarios.MORE)]
        faults = list(_each(wrong_live.heard, names, say, "live"))
        made.append(wrong_live.table(faults))
    return [*made, wrong_tables.targets(flown, faults)]


def _each(work: Callable[[Given], Made], given: list[Given], say: Callable[[str], None], name: str) -> Iterator[Made]:
    """Return the results of all cases, worked out on two cores, in the order given."""
    with get_context("spawn").Pool(WORKERS) as pool:
        for number, made in enumerate(pool.imap(work, given, chunksize=1), 1):
            if number % 10 == 0 or number == len(given):
                say(f"{name}: {number} of {len(given)}")
            yield made


def _one(name: str) -> int:
    """Return the lines of one flight through the estimator, by its name in the tables."""
    from scoring import wrong_cases, wrong_judged

    fleets = [c for fleet in wrong_cases.FLEETS for c in wrong_cases.of_fleet(EACH, fleet)]
    cases = {case.name: case for case in wrong_cases.every(EACH) + fleets + wrong_cases.gauged(EACH)}
    if name not in cases:
        print(f"wrong_packs: --flight {name}: expected one of {', '.join(cases)}", file=sys.stderr)
        return 2
    print(cases[name].words)
    flown, run = wrong_judged.replayed(cases[name])
    for step, soc in zip(run, flown.soc, strict=True):
        left_s = flown.end_s - step.estimate.time_s
        if left_s <= SHOWN_S and left_s % SHOWN_EVERY_S == 0.0:
            known, said = step.estimate, step.remaining
            print(
                f"{left_s:4.0f} s left, said {said.remaining_s:4.0f} [{said.remaining_lo_s:4.0f}, "
                f"{said.remaining_hi_s:4.0f}] alarm point {said.remaining_alarm_s:4.0f}  {known.voltage_V:6.2f} V "
                f"{known.current_A:5.1f} A  soc {known.soc:.3f} ± {known.soc_sd:.3f} (true {soc:.3f})  capacity "
                f"{known.capacity_scale:.2f} ± {known.capacity_scale_sd:.2f}  ohms {known.resistance_scale:.2f}  "
                f"{said.status} {said.reason}"
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
