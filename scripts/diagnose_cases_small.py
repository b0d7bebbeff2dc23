#!/usr/bin/env python3
"""Small effects: labelled cases of one size, compared with healthy sets of as many flights.

Run: .venv/bin/python scripts/diagnose_cases_small.py BATTERY.battery.toml HEALTHY FOLDER... [--size quarter]
HEALTHY holds healthy flights, FOLDER labelled cases, both of `scripts/porous_cases.py`. Each case: what its effect
would be worth, its place by chi-square, what is worth most. Then how many would be told, and how many with the truth
among three names, at the level that one healthy set in fifty passes: with the errors that the battery file states, and
with a half, a fifth and none of them, so that it is seen whether a smaller stated error would show more. Last, how
often the truth is inside the stated interval, and how healthy sets scatter.
"""

from __future__ import annotations

import json
import sys
from typing import NamedTuple

import numpy as np
from diagnose_cases_pack import arguments, flights, ready, records
from diagnose_cases_table import SAME, true_value

from uavbatt.diagnosis.classes import COVERAGE
from uavbatt.diagnosis.diagnosis import options_of, problem_of
from uavbatt.diagnosis.refit.candidates import NOTHING
from uavbatt.diagnosis.refit.solver import SETTLED, refit
from uavbatt.diagnosis.search.rivals import RIVAL_SHARE
from uavbatt.diagnosis.search.trial import FIRST_TURNS, Trial, trial
from uavbatt.diagnosis.search.worth import Worth, at_bound
from uavbatt.fitting.observed import ObservedRecord

SHARES = (1.0, 0.5, 0.2, 0.0)  # of the errors that the file states
FLIGHTS, ROUNDS, PASSES, SEATS = 3, 3, 0.02, 3


class Single(NamedTuple):
    """A Single is one effect on its own: its name, worth, and size with its standard error; by chi-square."""

    name: str
    worth: Worth
    size: float
    sd: float

    def value(self, share: float) -> float:
        """Return what it is worth if the stated errors were `share` of what they are."""
        known = self.worth.known / (self.worth.known + share**2 * (1.0 - self.worth.known))
        return min(float(np.sum(self.worth.gains)), self.worth.most) * known


def singles(tried: Trial) -> list[Single]:
    """Return the effects of a trial that do not stand at a bound."""
    pairs = zip(tried.fits, tried.worths, strict=True)
    return [
        Single(f.candidate.name, w, float(f.values()[0][0]), float(f.errors()[0])) for f, w in pairs if not at_bound(f)
    ]


def told(found: list[Single], share: float, level: float) -> list[str]:
    """Return the names of the rivals by chi-square, none below the level."""
    most = max(s.value(share) for s in found)
    return [s.name for s in found if most > level and s.value(share) > max(0.5 * level, RIVAL_SHARE * most)]


def main() -> int:
    """Print each case, then the counts."""
    parser = arguments("healthy")
    parser.add_argument("--size", default="quarter")
    given = parser.parse_args()
    file, pack, engine = ready(given.battery)

    def tried(flown: list[ObservedRecord]) -> list[Single]:
        problem = problem_of(flown, file, pack, engine.states)
        nothing = refit(problem, [NOTHING], iterations=SETTLED)[0]
        return singles(trial(problem, nothing, options_of(problem, file, ()), FIRST_TURNS))

    sound, random, healthy = records(sorted(given.healthy.glob("*.csv"))), np.random.default_rng(7), []
    for _ in range(ROUNDS):
        order = random.permutation(len(sound))
        sets = [order[k : k + FLIGHTS] for k in range(0, order.size - FLIGHTS + 1, FLIGHTS)]
        healthy += [tried([sound[i] for i in chosen]) for chosen in sets]
    cases, inside = [], []
    print("| case | effect | worth | place | worth most |\n|---|---|---|---|---|")
    for folder in given.folders:
        for name, label in json.loads((folder / "labels.json").read_text()).items():
            if label.get("size") != given.size:
                continue
            effect = SAME.get(label["effect"], label["effect"])
            found = tried(flights(folder / name))
            cases.append((effect, found))
            size, own = true_value(effect, label), [s for s in found if s.name == effect]
            inside += [abs(s.size - size) < COVERAGE * s.sd for s in own if size is not None]
            its = next((f"{s.value(1.0):.1f} | {k + 1}" for k, s in enumerate(found) if s.name == effect), "– | –")
            most = max(found, key=lambda s: s.value(1.0))
            print(f"| {name} | {effect} | {its} | {most.name} {most.value(1.0):.1f} |", flush=True)
    print("\n| stated errors | level | told | truth among three names |\n|---|---|---|---|")
    for share in SHARES:
        level = float(np.quantile([max(s.value(share) for s in found) for found in healthy], 1.0 - PASSES))
        names = [(effect, told(found, share, level)) for effect, found in cases]
        right = sum(effect in rivals[:SEATS] for effect, rivals in names)
        print(f"| {share:g} | {level:.1f} | {sum(bool(r) for _, r in names)} of {len(cases)} | {right} |")
    print(f"\nTruth inside the 95 % interval: {sum(inside)} of {len(inside)}.\n")
    print("Scatter of each effect's size over the healthy sets, in its stated standard errors:")
    for name in sorted(s.name for s in healthy[0]):
        sizes = [s for found in healthy for s in found if s.name == name]
        print(f"- {name} {np.std([s.size for s in sizes]) / np.median([s.sd for s in sizes]):.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
