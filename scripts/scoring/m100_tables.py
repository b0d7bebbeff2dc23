"""The tables of the M100 benchmark."""

from __future__ import annotations

import numpy as np

from scoring.m100 import LEARNED, LOG, UNKNOWN, Result
from scoring.peer_lines import MAH
from scoring.table import DASH, Table, figure, grid, share, with_error
from uavbatt.scoring.metrics import percentage_interval
from uavbatt.scoring.scores import Instant, PooledScores, ScoreRow, pool

INSTANTS = ("360 s", "240 s", "120 s", "60 s", "25%", "50%", "75%")
JUDGED = INSTANTS[:4]


def tables(found: dict[str, list[Result]]) -> list[Table]:
    """Return all tables of the benchmark."""
    pooled = {name: pool(r.score for r in results) for name, results in found.items()}
    with_interval = {name: p for name, p in pooled.items() if p.rows[0].inside is not None}
    flights = len(next(iter(found.values())))
    return [
        _errors(pooled, flights),
        _biases(pooled),
        _intervals(with_interval),
        _crps(pooled),
        _metrics(pooled),
        _alarms(found),
        _coverage({name: found[name] for name in with_interval}),
        _against_percentage(found),
    ]


def _row(pooled: PooledScores, label: str) -> ScoreRow:
    return next(r for r in pooled.rows if r.label == label)


def _errors(pooled: dict[str, PooledScores], flights: int) -> Table:
    rows = [(n, [with_error(_row(p, i).mae_s, _row(p, i).mae_se_s) for i in INSTANTS]) for n, p in pooled.items()]
    note = "Seconds before the end, and share of the flight that is over. A refusal counts as a forecast of 0 s."
    return grid(f"M100: mean absolute error [s] ± standard error, {flights} flights", INSTANTS, rows, note)


def _biases(pooled: dict[str, PooledScores]) -> Table:
    def cell(row: ScoreRow) -> str:
        return with_error(row.bias_s, row.bias_se_s, sign=True)

    rows = [(n, [cell(_row(p, i)) for i in INSTANTS]) for n, p in pooled.items()]
    return grid("M100: bias [s] ± standard error", INSTANTS, rows, "Positive: the forecast was too optimistic.")


def _intervals(pooled: dict[str, PooledScores]) -> Table:
    rows = []
    for name, p in pooled.items():
        at = [_row(p, i) for i in INSTANTS]
        rows.append((f"{name}: inside", [f"{r.inside} of {r.flights}" for r in at]))
        rows.append((f"{name}: width [s]", [figure(r.width_s) for r in at]))
    return grid("M100: the 90 % interval", INSTANTS, rows)


def _crps(pooled: dict[str, PooledScores]) -> Table:
    rows = [(n, [with_error(_row(p, i).crps_s, _row(p, i).crps_se_s) for i in INSTANTS]) for n, p in pooled.items()]
    note = "For a method without an interval this is its mean absolute error."
    return grid("M100: CRPS [s] ± standard error", INSTANTS, rows, note)


def _metrics(pooled: dict[str, PooledScores]) -> Table:
    head = ("alpha-lambda 10 %", "alpha-lambda 20 %", "prognostic horizon [s]", "CRA", "refused")
    rows = [
        (
            name,
            [
                f"{p.alpha_lambda[0.1]} of {p.flights}",
                f"{p.alpha_lambda[0.2]} of {p.flights}",
                with_error(*p.horizon_s),
                with_error(*p.cra, decimals=2),
                share(p.refused),
            ],
        )
        for name, p in pooled.items()
    ]
    note = "Alpha-lambda: flights with half the probability or more within ± alpha of the truth at half time."
    return grid("M100: prognostic metrics", head, rows, note)


def _alarms(found: dict[str, list[Result]]) -> Table:
    head = ("least left [s]", "median left [s]", "most left [s]", "with < 60 s left", "never raised")
    rows = []
    for name, results in found.items():
        left_s = np.array([r.score.alarm_at_s for r in results])
        cells = [figure(v) for v in (left_s.min(), float(np.median(left_s)), left_s.max())]
        rows.append((name, [*cells, str(int((left_s < 60.0).sum())), str(int((left_s == 0.0).sum()))]))
    note = "True seconds left when the alarm is raised; 120 is right. Ours goes by its own stated risk, not the median."
    return grid("M100: the two-minute alarm", head, rows, note)


def _coverage(found: dict[str, list[Result]]) -> Table:
    aircraft = sorted({r.flight.aircraft for results in found.values() for r in results})
    head = ("all lines", *(f"aircraft {a}" for a in aircraft), "first third", "middle third", "last third")
    rows = []
    for name, results in found.items():
        whole = pool(r.score for r in results)
        parts = [pool(r.score for r in results if r.flight.aircraft == a).coverage[0] for a in aircraft]
        rows.append((name, [share(v) for v in (whole.coverage[0], *parts, *whole.coverage_thirds)]))
    return grid("M100: coverage of the 90 % interval, all lines of a flight", head, rows)


def _against_percentage(found: dict[str, list[Result]]) -> Table:
    rows: list[tuple[str, list[str]]] = []
    for name in (LOG, LEARNED, UNKNOWN):
        own = [_own(found[name], i) for i in JUDGED]
        rows.append((f"{name}: own interval", [*(_cell(*o) for o in own), _mean([w for w, _ in own])]))
        for rival in dict.fromkeys((name, MAH)):
            rows.append((f"  {rival}: ± p % at each instant", _each(found[name], found[rival])))
            rows.append((f"  {rival}: ± one p %", _one(found[name], found[rival])))
    note = (
        "Mean width [s] (flights inside). The rival is the median of the method named, ± p % of itself. p is chosen "
        "with hindsight on these very flights, which our interval has not seen: at each instant the least p that holds "
        "as many flights as our interval does there; or one p for the four instants that holds as many in all."
    )
    title = "M100: against the interval of a fixed percentage with the same coverage"
    return grid(title, (*JUDGED, "mean"), rows, note)


def _at(results: list[Result], label: str) -> list[Instant]:
    return [r.score.at[label] for r in results if label in r.score.at]


def _own(results: list[Result], label: str) -> tuple[float, int]:
    """Return mean width [s] and flights inside."""
    at = _at(results, label)
    return float(np.mean([i.width_s for i in at])), sum(bool(i.inside) for i in at)


def _cell(width_s: float, inside: int) -> str:
    return f"{figure(width_s)} ({inside})"


def _mean(widths_s: list[float]) -> str:
    return figure(float(np.mean(widths_s)))


def _each(ours: list[Result], rival: list[Result]) -> list[str]:
    """Return the rival with its own best p at each instant."""
    cells, widths_s = [], []
    for label in JUDGED:
        hits, at = _own(ours, label)[1], _at(rival, label)
        if not 0 < hits <= len(at):
            return [DASH] * (len(JUDGED) + 1)
        percent, width_s = percentage_interval([i.truth_s for i in at], [i.forecast_s for i in at], hits)
        cells.append(f"{_cell(width_s, hits)}, p {share(percent)}" if np.isfinite(percent) else "none holds")
        widths_s.append(width_s)
    return [*cells, _mean(widths_s)]


def _one(ours: list[Result], rival: list[Result]) -> list[str]:
    """Return the rival with one p for all instants."""
    hits = sum(_own(ours, label)[1] for label in JUDGED)
    every = [i for label in JUDGED for i in _at(rival, label)]
    percent, _ = percentage_interval([i.truth_s for i in every], [i.forecast_s for i in every], hits)
    if not np.isfinite(percent):
        return ["none holds"] * len(JUDGED) + [DASH]
    cells, widths_s = [], []
    for label in JUDGED:
        said_s = np.nan_to_num([i.forecast_s for i in _at(rival, label)])
        missed_s = np.abs([i.truth_s for i in _at(rival, label)] - said_s)
        inside = int((missed_s <= percent * said_s * (1.0 + 1e-9)).sum())
        widths_s.append(float(np.mean(2.0 * percent * said_s)))
        cells.append(f"{_cell(widths_s[-1], inside)}, p {share(percent)}")
    return [*cells, _mean(widths_s)]
