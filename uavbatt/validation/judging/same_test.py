"""Findings about runs that are not repeats of one test: copied, cut short, of another load, charge or temperature.

Statistics take such a run for scatter, or do not see it: a comparison ends with the shortest run, and a copy makes the
repeats look better than they are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from uavbatt.dataset import DataSet
from uavbatt.dataset.checks import charge_Ah
from uavbatt.dataset.records import Array, Run
from uavbatt.fitting.observed import MAD_TO_SD
from uavbatt.validation.judging.finding import Finding
from uavbatt.validation.judging.readings import Readings

# Coarse readings of two short runs may be equal by chance. Within a run they go together, so that chance is not that of
# independent readings: of the study's 190 pairs of 18 readings the most alike share 9, and 3 on average.
LEAST_CHANCE = 1e-6
USUAL_SHARE = 0.5  # of equal readings, where there are no other repeats to tell it
FEWEST_REPEATS = 3
SHORT_SHARE = 0.7  # of the median duration: worn packs of one type differ by less
OTHER_LOAD, LEAST_OTHER_LOAD = 0.1, 0.04  # of the median current; the smaller one where the repeats tell their scatter
SCATTERED, TELLING_REPEATS = 6.0, 6  # robust sds, and so many repeats tell them
# Discharges at room temperature down to the cut-off give so much of the rated capacity: at 10 C and more, of a used
# pack, three quarters; a new one holds a little more than is printed on it.
ROOM_C, GIVEN_SHARE = 15.0, (0.7, 1.15)
FAR_FROM_AIR_K = 10.0  # a pack that has lain at its ambient temperature begins with it
SAME_TEMP_K = 3.0
MOST_NAMED = 6


def not_the_same_test(readings: Readings, ambient_C: float) -> Iterator[Finding]:
    """Find copied runs and wrong temperatures in all tests, and other loads and cut runs among those at `ambient_C`."""
    runs = readings.dataset.runs
    yield from _copies(runs)
    yield from _far_from_air(runs)
    yield from _unmetered(readings.dataset)
    yield from _not_the_rated_capacity(readings.dataset)
    repeats = readings.dataset.at(ambient_C)
    if len(repeats) >= FEWEST_REPEATS:
        yield from _cut_short(repeats)
        yield from _other_load(repeats)


def _copies(runs: Sequence[Run]) -> Iterator[Finding]:
    if pairs := list(_equal_pairs(runs)):
        named = _list([f"{_name(b)} is {_name(a)}" for a, b in pairs])
        detail = f"All readings are equal, to the last digit: {named}. A copy is no repeat: leave it out."
        title = "A run is a copy of another" if len(pairs) == 1 else f"{len(pairs)} runs are copies of others"
        yield Finding("copied_run", title, detail, "serious", {"pairs": len(pairs)})


def _equal_pairs(runs: Sequence[Run]) -> Iterator[tuple[Run, Run]]:
    """Yield the pairs whose readings are all equal, if chance does not make so many equal in one of all pairs.

    How often two readings are equal by chance is what the other pairs of one ambient temperature show.
    """
    pairs = [(a, b, *_equal_numbers(a, b)) for a, b in combinations(runs, 2) if len(a.time_s) == len(b.time_s)]
    others = [(n, of) for a, b, n, of in pairs if a.ambient_C == b.ambient_C and n < of]
    alike, of_all = np.sum(others, axis=0) if others else (0, 0)
    share = max(alike, 1) / of_all if others else USUAL_SHARE
    for a, b, equal, numbers in pairs:
        if equal == numbers and len(pairs) * share**numbers < LEAST_CHANCE:
            yield a, b


def _equal_numbers(a: Run, b: Run) -> tuple[int, int]:
    """Return how many readings that change within a run are the same in both, and how many there are.

    Readings that do not change, or that only one of them has, count as different if they differ, else not at all.
    """
    equal, numbers = 0, 0
    for x, y in zip(_columns(a), _columns(b), strict=True):
        same = (x == y) | (np.isnan(x) & np.isnan(y))
        changes = np.nanmin(x, initial=np.inf) < np.nanmax(x, initial=-np.inf)
        counts = ~same | (changes & ~np.isnan(x))
        equal, numbers = equal + int(np.sum(same & counts)), numbers + int(np.sum(counts))
    return equal, numbers


def _columns(run: Run) -> tuple[Array, ...]:
    return run.voltage_V, run.current_A, run.surface_C


def _far_from_air(runs: Sequence[Run]) -> Iterator[Finding]:
    first = [(run, float(run.surface_C[0]) - run.ambient_C) for run in runs]
    far = [(run, off_K) for run, off_K in first if abs(off_K) > FAR_FROM_AIR_K]
    if far:
        named = _list([f"{_name(run)} with {run.surface_C[0]:g} °C" for run, _ in far])
        is_fahrenheit = all(abs((run.surface_C[0] - 32.0) / 1.8 - run.ambient_C) < SAME_TEMP_K for run, _ in far)
        cause = "degrees Fahrenheit?" if is_fahrenheit else "another ambient temperature than stated, or a warm pack?"
        title = f"{len(far)} run{'s begin' if len(far) > 1 else ' begins'} far from the stated ambient temperature"
        most_K = max((off_K for _, off_K in far), key=abs)
        yield Finding("surface_far_from_ambient", title, f"{named} ({cause}).", "warning", {"off_K": most_K})


def _unmetered(dataset: DataSet) -> Iterator[Finding]:
    """Find runs without a current among others with one."""
    without = [run for run in dataset.runs if not run.is_metered]
    if without and len(without) < len(dataset.runs):
        verb = "were" if len(without) > 1 else "was"
        title = f"The current of {len(without)} of {len(dataset.runs)} runs {verb} not measured"
        which, means = "most of them", "the model is fitted to none"
        if dataset.is_metered:
            which = _list([_name(run) for run in without])
            means = "the model is fitted to the others and predicts these"
        detail = f"{which}: {means}. Leave no current empty, or fill in that of the load."
        yield Finding("unmetered_run", title, detail, "warning", {"runs": len(without)})


def _not_the_rated_capacity(dataset: DataSet) -> Iterator[Finding]:
    """Find whole discharges whose charge is not near the rated capacity."""
    whole = [run for run in dataset.runs if run.is_metered and run.ambient_C >= ROOM_C]
    given_Ah = [charge_Ah(run) for run in whole if run.voltage_V[-1] <= dataset.cutoff_V]
    if not given_Ah or dataset.capacity_Ah is None:
        return
    usual_Ah = float(np.median(given_Ah))
    share = usual_Ah / dataset.capacity_Ah
    if GIVEN_SHARE[0] <= share <= GIVEN_SHARE[1]:
        return
    title = f"Whole discharges give {share:.0%} of the rated capacity"
    cause = "worn packs, an ammeter that reads low" if share < 1.0 else "an ammeter that reads high"
    detail = (
        f"Half of {len(given_Ah)} runs give {usual_Ah:.3g} Ah or more down to {dataset.cutoff_V:g} V, "
        f"{dataset.capacity_Ah:g} Ah are stated: {cause}, or another capacity? "
        "State the capacity that such a pack holds when it is new."
    )
    yield Finding("other_capacity", title, detail, "warning", {"given_Ah": usual_Ah, "rated_Ah": dataset.capacity_Ah})


def _cut_short(repeats: Sequence[Run]) -> Iterator[Finding]:
    lasts_s = np.array([run.time_s[-1] - run.time_s[0] for run in repeats])
    usual_s = float(np.median(lasts_s))
    short = [(run, s) for run, s in zip(repeats, lasts_s, strict=True) if s < SHORT_SHARE * usual_s]
    if short:
        named = _list([f"{_name(run)} lasts {s / 60:.3g} min" for run, s in short])
        detail = f"{named}; half of the runs last {usual_s / 60:.3g} min. What comes later is not compared."
        title = (
            f"{len(short)} run{'s are' if len(short) > 1 else ' is'} much shorter than the others (cut, or minutes?)"
        )
        yield Finding("short_run", title, detail, "warning", {"shortest_s": float(np.min(lasts_s)), "usual_s": usual_s})


def _other_load(repeats: Sequence[Run]) -> Iterator[Finding]:
    means_A = np.array([float(np.mean(run.current_A)) for run in repeats])
    if np.sum(np.isfinite(means_A)) < FEWEST_REPEATS:
        return
    usual_A = float(np.nanmedian(means_A))
    least_A = OTHER_LOAD * abs(usual_A)
    if np.sum(np.isfinite(means_A)) >= TELLING_REPEATS:
        scatter_A = MAD_TO_SD * float(np.nanmedian(np.abs(means_A - usual_A)))
        least_A = min(least_A, max(LEAST_OTHER_LOAD * abs(usual_A), SCATTERED * scatter_A))
    other = [(run, a) for run, a in zip(repeats, means_A, strict=True) if abs(a - usual_A) > least_A]
    if other:
        named = _list([f"{_name(run)} with {a:.3g} A" for run, a in other])
        detail = f"{named}; half of the runs draw {usual_A:.3g} A or more. The voltages of other loads are no repeats."
        title = f"{len(other)} run{'s have' if len(other) > 1 else ' has'} another load than the others"
        worst_A = max((a for _, a in other), key=lambda a: abs(a - usual_A))
        yield Finding("other_load", title, detail, "warning", {"mean_A": worst_A, "usual_A": usual_A})


def _name(run: Run) -> str:
    return f"run {run.run} of sample {run.sample} at {run.ambient_C:g} °C"


def _list(names: Sequence[str]) -> str:
    return ", ".join(names[:MOST_NAMED]) + (f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else "")
