"""The study's method replayed column by column, and its agreement with the tables it prints.

Equations (1)-(17) live in `paper_equations`. Voltage needs Tables 2 and 6 only. The surface temperatures of sample
2 are not printed: Table 9 implies its means, and equation (17) with the 0.1 °C lattice of the readings implies its
sum of squares (`rebuild`). Agreement is counted by printed figure; every difference is named.
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np

from uavbatt.dataset import DataSet, Levels, whole_minutes
from uavbatt.errors import NotEnoughData
from uavbatt.validation.iso5725.cells import Array
from uavbatt.validation.study import paper_equations as eq

STUDY = "lpab-3s"
LATTICE_C = 0.1  # step of the study's thermometer


@dataclass(frozen=True, slots=True)
class ColumnFigures:
    """ColumnFigures holds equations (1)-(7) evaluated for one sample at one instant; V or °C by `quantity`."""

    sample: str
    quantity: str
    time_s: float
    mean: float
    sd: float
    drift_ratio: float
    drifts: bool
    sigma_r: float
    r: float
    share_beyond_r: float


@dataclass(frozen=True, slots=True)
class PooledResults:
    """PooledResults holds equations (8)-(17) evaluated over the samples at one instant; V or °C by `quantity`.

    `share_beyond_R` is NaN where single results are not known.
    `may_pool` is the study's own rule: t <= t_kr and F <= F_kr, with F the ratio of variances that the table
    belongs to; `F_printed` is the ratio of SDs of equation (11).
    """

    quantity: str
    time_s: float
    means: tuple[float, ...]
    variances: tuple[float, ...]
    t: float
    t_critical: float
    F_printed: float
    F: float
    F_critical: float
    may_pool: bool
    sigma_R: float
    R: float
    share_beyond_R: float
    mean: float
    S2: float
    C: float


@dataclass(frozen=True, slots=True)
class Agreement:
    """Agreement counts figures of a printed table that are met (`agree` of `total`) and names the others (`slips`)."""

    table: str
    agree: int
    total: int
    slips: tuple[str, ...]
    counted: str


@dataclass(frozen=True, slots=True)
class FisherClaim:
    """FisherClaim compares the printed F_emp with each column's ratios of SDs and of variances."""

    printed: float
    critical_printed: float
    critical: float
    at_first_instant: tuple[float, float]
    nearest: float
    reproducible: bool


@dataclass(frozen=True, slots=True)
class PaperReplay:
    """PaperReplay holds the study's method applied at one ambient temperature.

    `pooled_surface` of the study's own data rests on rebuilt figures (`rebuild`).
    """

    ambient_C: float
    samples: tuple[str, ...]
    columns: tuple[ColumnFigures, ...]
    pooled: tuple[PooledResults, ...]
    pooled_surface: tuple[PooledResults, ...]
    agreements: tuple[Agreement, ...]
    fisher: FisherClaim | None
    notes: tuple[str, ...]


def printed_tables() -> dict[str, Any]:
    """Read the study's printed Tables 5, 8, 9, F_emp and F_kr; figures of Tables 8 and 9 are text."""
    file = resources.files("uavbatt") / "data" / "study" / "printed.toml"
    return tomllib.loads(file.read_text("utf-8"))


def column(sample: str, quantity: str, time_s: float, x: Array) -> ColumnFigures:
    """Evaluate equations (1)-(7) for the results `x` of one sample at one instant."""
    a = eq.eq5_pair_differences(x)
    sigma_r = eq.eq6_pair_sd(a)
    r, ratio = eq.eq7_repeatability_limit(sigma_r), eq.drift_ratio(x)
    drifts, beyond = ratio >= eq.DRIFT_LIMIT, eq.share_beyond(a, r)
    return ColumnFigures(sample, quantity, time_s, eq.eq3_mean(x), eq.eq4_sd(x), ratio, drifts, sigma_r, r, beyond)


def pool(quantity: str, time_s: float, means: Array, variances: Array, n: int, results: Array | None) -> PooledResults:
    """Evaluate equations (8)-(17) from the sample means and variances; `results` for (13), if they are known."""
    high, low = int(np.argmax(means)), int(np.argmin(means))
    t = eq.eq10_student(means[high], variances[high], means[low], variances[low], n) if high != low else 0.0
    sds = np.sqrt(variances)
    printed, F = eq.eq11_fisher_printed(sds.min(), sds.max()), eq.fisher(sds.min(), sds.max())
    sigma_R = eq.eq14_sigma_R(eq.eq15_between_variance(means), eq.within_variance(variances))
    R, mean = eq.eq16_reproducibility_limit(sigma_R), eq.eq12_grand_mean(means)
    beyond = math.nan if results is None else eq.share_beyond(eq.eq13_deviations(results, mean), R)
    S2 = eq.eq17_total_variance(means, variances, n)
    t_kr, f_kr = eq.t_critical(n), eq.f_critical(n)
    may_pool = bool(t <= t_kr and (sds.max() == 0 or not f_kr < F))
    ratios = (float(t), t_kr, float(printed), float(F), f_kr)
    figures = (*ratios, may_pool, sigma_R, R, beyond, mean, S2, eq.corridor_half_width(S2))
    return PooledResults(quantity, time_s, tuple(means.tolist()), tuple(variances.tolist()), *figures)


def _complete(levels: Levels) -> tuple[list[Array], tuple[str, ...]]:
    """Return the samples' tables cut to the number of runs that all have, as the formulas need one n."""
    tables = [levels.curves(j) for j in range(len(levels.samples))]
    n = min(len(t) for t in tables)
    note = f"{levels.quantity}: samples cut to their first {n} runs, the study's formulas need equal numbers"
    return [t[:n] for t in tables], (note,) if any(len(t) > n for t in tables) else ()


def replay(dataset: DataSet, ambient_C: float = 25.0) -> PaperReplay:
    """Apply the study's method to the repeated runs at `ambient_C` [°C]. Raises NotEnoughData below three runs."""
    volts = whole_minutes(dataset, ambient_C)
    if volts is None:
        raise _too_few(ambient_C)
    return replay_levels(dataset.name, volts, whole_minutes(dataset, ambient_C, "surface_C"))


def replay_levels(name: str, volts: Levels, heat: Levels | None) -> PaperReplay:
    """Apply the study's method to tables of voltage and surface temperature, of the data set called `name`.

    The printed tables are compared for the study only. Raises NotEnoughData below three runs.
    """
    ambient_C = volts.ambient_C
    tables, notes = _complete(volts)
    if len(tables[0]) < 3:
        raise _too_few(ambient_C)
    columns = _columns(volts, tables)
    pooled = _pooled(volts, tables)
    surface: tuple[PooledResults, ...] = ()
    if heat is not None and len(heat.occasions) >= 3:
        warm, more = _complete(heat)
        columns, surface, notes = columns + _columns(heat, warm), _pooled(heat, warm), notes + more
    agreements: tuple[Agreement, ...] = ()
    claim = None
    if name == STUDY and ambient_C == 25.0 and heat is not None and _is_whole(volts, tables, heat):
        printed = printed_tables()
        surface = rebuild(heat.curves(0), printed)
        agreements = (_table5(tables[0][:, 0], printed), _table8(pooled, printed), _table9(surface, printed))
        claim = _fisher_claim(pooled, printed)
        notes += ("temperatures of sample 2 are not printed: rebuilt from Table 9 and equation (17)",)
    return PaperReplay(ambient_C, volts.samples, columns, pooled, surface, agreements, claim, notes)


def _too_few(ambient_C: float) -> NotEnoughData:
    return NotEnoughData(f"the study's method needs three runs or more at {ambient_C:g} °C")


def _is_whole(volts: Levels, tables: list[Array], heat: Levels) -> bool:
    """Return True for tables of the size that the study printed: 2 x 10 x 9 voltages, 10 x 9 temperatures."""
    whole = [t.shape for t in tables] == [(10, 9)] * 2 and list(volts.time_s) == [60.0 * m for m in range(9)]
    return whole and heat.curves(0).shape == (10, 9)


def _columns(levels: Levels, tables: list[Array]) -> tuple[ColumnFigures, ...]:
    by_sample = list(zip(levels.samples, tables, strict=True))
    return tuple(
        column(s, levels.quantity, float(t), table[:, i]) for s, table in by_sample for i, t in enumerate(levels.time_s)
    )


def _pooled(levels: Levels, tables: list[Array]) -> tuple[PooledResults, ...]:
    if len(tables) < 2:
        return ()
    n, pooled = len(tables[0]), []
    for i, t in enumerate(levels.time_s):
        cells = [table[:, i] for table in tables]
        means, sds = (np.array([f(c) for c in cells]) for f in (eq.eq3_mean, eq.eq4_sd))
        pooled.append(pool(levels.quantity, float(t), means, sds**2, n, np.concatenate(cells)))
    return tuple(pooled)


def lattice_sum_of_squares(target: float, tolerance: float, mean: float, n: int) -> float | None:
    """Return the sum of squares of n readings on the 0.1 °C lattice with this mean, nearest to `target`, or None.

    With v = 10·x whole, Σv = N is given, Σv² = Q is whole with the parity of N, and SS = (Q - N²/n)/100.
    """
    N = round(n * mean / LATTICE_C)
    floor = N * N / n
    Q = round((target / LATTICE_C**2 + floor - N) / 2) * 2 + N
    least = (n - N % n) * (N // n) ** 2 + (N % n) * (N // n + 1) ** 2
    ss = (max(Q, least) - floor) * LATTICE_C**2
    return ss if abs(ss - target) <= tolerance else None


def rebuild(first: Array, printed: dict[str, Any]) -> tuple[PooledResults, ...]:
    """Rebuild Table 9: sample 2's mean is 2x̄ - x̄_1, its variance follows from (17) and the lattice.

    `first`: sample 1's temperatures, run x minute [°C]. A minute without a lattice solution gets a NaN variance.
    """
    n, rebuilt = len(first), []
    table = printed["table9"]
    for i, minute in enumerate(printed["minutes"]):
        mean_1, S2_1 = eq.eq3_mean(first[:, i]), eq.eq4_sd(first[:, i]) ** 2
        mean_2 = round(2 * float(table["mean_C"][i]) - mean_1, 9)
        between = n * (mean_1 - mean_2) ** 2 / 2
        target = (2 * n - 1) * float(table["S2_C2"][i]) - (n - 1) * S2_1 - between
        ss_2 = lattice_sum_of_squares(target, (2 * n - 1) * 0.51e-5, mean_2, n)
        variances = np.array([S2_1, math.nan if ss_2 is None else round(ss_2, 9) / (n - 1)])
        rebuilt.append(pool("surface_C", 60.0 * minute, np.array([mean_1, mean_2]), variances, n, None))
    return tuple(rebuilt)


def meets(printed: str, computed: float, decimals: int | None = None) -> bool:
    """Return True if `computed` rounds to the printed figure (to its own digits, or to `decimals`)."""
    places = len(printed.partition(".")[2]) if decimals is None else decimals
    return abs(round(float(printed), places) - computed) <= 0.5 * 10.0**-places * (1 + 1e-6)


def _table5(x: Array, printed: dict[str, Any]) -> Agreement:
    figures = [f for row in printed["table5_V"] for f in row]
    pairs = list(zip(figures, eq.eq5_pair_differences(x), strict=True))
    slips = tuple(f"Table 5, difference {i + 1}: {p} printed, {a:.3f} computed"
                  for i, (p, a) in enumerate(pairs) if not meets(f"{p:.2f}", a))  # fmt: skip
    return Agreement("Table 5", len(pairs) - len(slips), len(pairs), slips, "45 differences to 0.01 V")


def _compare(table: str, rows: dict[str, tuple[list[str], list[float], int | None]], counted: str) -> Agreement:
    slips, total = [], 0
    for name, (figures, computed, decimals) in rows.items():
        for i, (figure, value) in enumerate(zip(figures, computed, strict=True)):
            total += 1
            if not meets(figure, value, decimals):
                slips.append(f"{table}, {name} at {i} min: {figure} printed, {value:.4g} computed")
    return Agreement(table, total - len(slips), total, tuple(slips), counted)


def _table8(pooled: tuple[PooledResults, ...], printed: dict[str, Any]) -> Agreement:
    rows = printed["table8"]
    counted = ("9 means to 0.01 V (the third printed digit is a padded zero and up to 5 mV wrong), "
               "9 variances and 9 half-widths to their printed digits")  # fmt: skip
    return _compare("Table 8", {
        "mean": (rows["mean_V"], [p.mean for p in pooled], 2),
        "S²": (rows["S2_V2"], [p.S2 for p in pooled], None),
        "C": (rows["C_V"], [p.C for p in pooled], None),
    }, counted)  # fmt: skip


def _table9(pooled: tuple[PooledResults, ...], printed: dict[str, Any]) -> Agreement:
    rows = printed["table9"]
    counted = ("9 means and 9 variances agree if readings of sample 2 on the 0.1 °C lattice can give them (a test of "
               "consistency, not of prediction); 9 half-widths C = 2√S² to their printed digits")  # fmt: skip
    on_lattice = [p.mean if abs(p.means[1] * 100 - round(p.means[1] * 100)) < 1e-6 else math.nan for p in pooled]
    return _compare("Table 9", {
        "mean": (rows["mean_C"], on_lattice, None),
        "S²": (rows["S2_C2"], [p.S2 for p in pooled], None),
        "C": (rows["C_C"], [p.C for p in pooled], None),
    }, counted)  # fmt: skip


def _fisher_claim(pooled: tuple[PooledResults, ...], printed: dict[str, Any]) -> FisherClaim:
    ratios = [f for p in pooled for f in (p.F_printed, p.F)]
    nearest = min(ratios, key=lambda f: abs(f - printed["F_emp"]))
    first, same = pooled[0], bool(meets(f"{printed['F_emp']:.2f}", nearest))
    critical = first.F_critical
    return FisherClaim(
        printed["F_emp"], printed["F_kr"], critical, (first.F_printed, first.F), nearest, same
    )  # fmt: skip
