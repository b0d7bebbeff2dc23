"""`uavbatt diagnose`: which effect the battery file lacks, how large it is, what else it could be."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from uavbatt.cli.logs import InstanceOption
from uavbatt.cli.options import (
    BatteryOption,
    CapacityOption,
    CellsOption,
    CutoffOption,
    ReportOption,
    UncertifiedOption,
    check_named,
    check_writable,
    read_battery,
    remark,
    say,
    stated_pack,
)
from uavbatt.errors import NotEnoughData, UsageError, terminal_line
from uavbatt.limits import Seen
from uavbatt.records import Flight, PackFacts

if TYPE_CHECKING:
    from uavbatt.battery.battery_file import BatteryFile
    from uavbatt.battery.sizing import PackOptions, PackSize
    from uavbatt.dataset import DataSet
    from uavbatt.diagnosis.close import Closed
    from uavbatt.diagnosis.diagnosis import Diagnosis
    from uavbatt.fitting.observed import Observed

Size = tuple[int, float, float]  # cells, capacity [Ah], cut-off [V]


def diagnose(
    sources: Annotated[list[Path], typer.Argument(metavar="LOG|DATASET...", help="Flight logs and data-set folders.")],
    battery: BatteryOption,
    cells: CellsOption = None,
    capacity_ah: CapacityOption = None,
    cutoff_voltage: CutoffOption = None,
    allow_uncertified: UncertifiedOption = False,
    instance: InstanceOption = None,
    without: Annotated[list[str] | None, typer.Option("--without", help="Effect to leave out; repeatable.")] = None,
    gate: Annotated[Path | None, typer.Option("--gate", metavar="DATASET", help="Bench tests to gate with.")] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="The diagnosis as JSON.")] = None,
    report: ReportOption = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="NEW.battery.toml, the extended file.")] = None,
) -> None:
    """Trace what the battery file explains badly to the effect that it lacks; error before and after.

    Exit code 4 when the records cannot tell (the reason is in the JSON, too).
    """
    from uavbatt import dataset as data
    from uavbatt.battery import battery_file
    from uavbatt.battery.effects import EFFECTS
    from uavbatt.files import write_json
    from uavbatt.telemetry import read_log

    check_named(output)
    check_writable(json_file, report, output, reads=sources)
    unknown = [name for name in without or [] if name not in EFFECTS]
    if unknown:
        raise UsageError(f"--without {unknown[0]}: expected one of {', '.join(EFFECTS)}")
    content = read_battery(battery, allow_uncertified)
    stated = stated_pack(cells, capacity_ah, cutoff_voltage)
    datasets = [data.load(p) for p in sources if p.is_dir()]
    flights = _distinct([read_log(p, instance) for p in sources if not p.is_dir()])
    try:
        found, closed, new = _run(content, datasets, flights, stated, tuple(without or ()), gate)
    except NotEnoughData as error:
        if json_file is not None:
            write_json(json_file, {"verdict": "not_enough_data", "reason": str(error), "classes": []})
        raise
    path = str(battery_file.write_battery(new, output)) if output is not None else None
    for line in _lines(found, closed):
        say(line, json_file, report)
    if json_file is not None:
        write_json(json_file, _as_json(found, closed, content.status, path))
    if report is not None:
        from uavbatt.report.diagnosis import diagnosis_report
        from uavbatt.report.page import write_page

        write_page(report, diagnosis_report(found, closed, content, new))
        say(f"report: {report}", json_file, report)
    if path is not None:
        say(f"{path}: {new.certificate.status}", json_file, report)


def _run(
    content: BatteryFile,
    datasets: list[DataSet],
    flights: list[Flight],
    stated: PackOptions,
    without: tuple[str, ...],
    gate: Path | None,
) -> tuple[Diagnosis, Closed, BatteryFile]:
    from uavbatt import dataset as data
    from uavbatt.battery.sizing import PackOptions, pack_from
    from uavbatt.diagnosis import close
    from uavbatt.diagnosis.diagnosis import diagnose as find
    from uavbatt.diagnosis.gate import verdicts
    from uavbatt.fitting import observed
    from uavbatt.log_replay import engine_for

    tests = data.load(gate) if gate is not None else None
    sizes = {_flown_size(f, content, stated) for f in flights} | {_tested_size(d, content, stated) for d in datasets}
    if len(sizes) > 1:
        listed = ", ".join(f"{n}S {q:g} Ah" for n, q, _ in sorted(sizes))
        raise NotEnoughData(f"the records are of different packs ({listed}): expected records of one")
    series, capacity_Ah, cutoff_V = next(iter(sizes))
    records: list[Observed] = [r for d in datasets for r in observed.from_dataset(d, capacity_Ah)]
    records += [_observed(f, series, capacity_Ah) for f in flights]
    options = PackOptions(cells=series, capacity_Ah=capacity_Ah, cutoff_V=cutoff_V)
    pack = pack_from(content, options)
    with _Progress() as tell:
        engine = engine_for(is_long=True)
        found = find(records, content, pack, without, tell, engine)
        closed = close.judge(found, content, flights, options, tell, engine)
    new = close.extended(content, found)
    if tests is not None:
        remark(f"gating with {gate} ...")
        new = close.gated(new, found, verdicts(tests, new))
    return found, closed, new


def _observed(flight: Flight, cells: int, capacity_Ah: float) -> Observed:
    from uavbatt.fitting import observed

    if not any(math.isfinite(s.current_A) for s in flight.samples):
        raise NotEnoughData(f"{flight.source}: no row has a current: nothing can be traced without it")
    return observed.from_flight(flight, cells, capacity_Ah)


def _distinct(flights: list[Flight]) -> list[Flight]:
    """UsageError when a log is named twice: it would count as two pieces of evidence."""
    seen: dict[object, str] = {}
    for flight in flights:
        key = (len(flight.samples), flight.samples[0], flight.samples[-1])
        if repr(key) in seen:
            raise UsageError(f"{flight.source}: the same log as {seen[repr(key)]}: expected different flights")
        seen[repr(key)] = flight.source
    return flights


def _flown_size(flight: Flight, content: BatteryFile, stated: PackOptions) -> Size:
    """The size of a flight's pack, whose rows must not deny it. Raises UsageError in words."""
    from uavbatt.battery.sizing import resting
    from uavbatt.battery.statements import check_whole, size_from_rows

    size = size_from_rows(content, stated, flight, flight.facts_at(math.inf))
    check_whole(flight, size, resting(content))
    return _rounded(size)


def _tested_size(dataset: DataSet, content: BatteryFile, stated: PackOptions) -> Size:
    """The size of a tested pack: a data set tells of its pack what a vehicle tells of its."""
    from uavbatt.battery.sizing import checked, size_of_pack

    said = PackFacts(capacity_Ah=dataset.capacity_Ah or math.nan, critical_voltage_V=dataset.cutoff_V)
    seen = Seen(dataset.first_V)
    try:
        return _rounded(checked(content, size_of_pack(content, stated, said, dataset.cells_series, seen=seen), seen))
    except UsageError as error:
        raise UsageError(f"{dataset.path}: {error}") from None


def _rounded(size: PackSize) -> Size:
    """Rounded so that records of one pack agree."""
    return size.cells, round(size.capacity_Ah, 4), round(size.cutoff_V, 3)


class _Progress:
    """The step at hand on stderr when it is a terminal."""

    def __enter__(self) -> _Progress:
        return self

    def __call__(self, step: str) -> None:
        if sys.stderr.isatty():
            print(f"\r\033[K{terminal_line(step)} ...", end="", file=sys.stderr, flush=True)

    def __exit__(self, *_: object) -> None:
        if sys.stderr.isatty():
            print("\r\033[K", end="", file=sys.stderr, flush=True)


def _lines(found: Diagnosis, closed: Closed) -> list[str]:
    from uavbatt.battery.effects import unit_words
    from uavbatt.diagnosis.words import MEANING

    said = {
        "no_missing_effect": "nothing is missing: the residual is what this battery's model leaves anyway",
        "effect_found": "an effect is missing",
        "undeclared_effect": "something is missing that no candidate explains",
    }
    lines = [f"{found.verdict}: {said[found.verdict]}"]
    for one in found.classes:
        lines.append(f"  {' or '.join(one.members)} (probability {one.probability:.2f}): {MEANING[one.members[0]]}")
        for name, i in one.parameters.items():
            lines.append(f"    {name} = {i.value:.4g} [{i.lo:.4g}, {i.hi:.4g}] {unit_words(i.unit)}".rstrip())
        lines.append(f"    check: {one.would_separate}")
    lines += [f"  doubt: {reason}" for reason in found.reasons]
    if found.blocks:
        told = ", ".join(f"{b.name} {b.saved:.0f}" for b in found.blocks)
        lines.append(f"  evidence (chi-square saved): {told}")
    if found.hidden:
        lines.append("  no more than this could hide in these records (95 %):")
        lines += [
            f"    {h.name}: {h.quantity} {h.lo:.3g} to {h.hi:.3g} {unit_words(h.unit)}".rstrip() for h in found.hidden
        ]
    if not found.problem.evidence.has_temperature:
        lines.append("  no temperature: effects that show in it only are not among the candidates")
    b, a = closed.before, closed.after
    lines.append(
        f"  held out: voltage RMSE {1000 * b.voltage_rmse_V:.0f} -> {1000 * a.voltage_rmse_V:.0f} mV, remaining time "
        f"MAE {_number(b.remaining_mae_s)} -> {_number(a.remaining_mae_s)} s"
    )
    return lines


def _number(value: float) -> str:
    return f"{value:.0f}" if math.isfinite(value) else "unknown"


def _as_json(found: Diagnosis, closed: Closed, status: str, path: str | None) -> dict[str, Any]:
    """DESIGN's diagnosis output: NaN as null."""
    from dataclasses import asdict

    return {
        "verdict": found.verdict,
        "classes": [asdict(c) for c in found.classes],
        "reasons": list(found.reasons),
        "before": asdict(closed.before),
        "after": asdict(closed.after),
        "held_out": list(closed.held_out),
        "left": asdict(found.left),
        "evidence": {b.name: b.saved for b in found.blocks},
        "hidden": [asdict(h) for h in found.hidden],
        "certificate_status": status,
        "battery_file": path,
    }
