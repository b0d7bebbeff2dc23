"""`uavbatt diagnose`: which effect the battery file lacks, how large it is, and which other effects are possible."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from uavbatt.cli.diagnose_records import (
    ProgressLine,
    distinct,
    flown_size,
    observed_of,
    one_size,
    reason_written,
    tested_size,
)
from uavbatt.cli.logs import InstanceOption
from uavbatt.cli.options import (
    BatteryOption,
    CapacityOption,
    CellsOption,
    CutoffOption,
    PackOption,
    PacksOption,
    ReportOption,
    UncertifiedOption,
    check_named,
    check_writable,
    read_battery,
    remark,
    say,
    stated_pack,
)
from uavbatt.errors import UsageError
from uavbatt.records import Flight

if TYPE_CHECKING:
    from uavbatt.battery.battery_file import BatteryFile
    from uavbatt.battery.sizing import PackOptions
    from uavbatt.cli.diagnose_worn import BasePack
    from uavbatt.dataset import DataSet
    from uavbatt.diagnosis.close import ClosedLoop
    from uavbatt.diagnosis.diagnosis import Diagnosis
    from uavbatt.fitting.observed import ObservedRecord


def diagnose(
    sources: Annotated[list[Path], typer.Argument(metavar="LOG|DATASET...", help="Flight logs and data-set folders.")],
    battery: BatteryOption,
    cells: CellsOption = None,
    capacity_ah: CapacityOption = None,
    cutoff_voltage: CutoffOption = None,
    allow_uncertified: UncertifiedOption = False,
    instance: InstanceOption = None,
    without: Annotated[
        list[str] | None, typer.Option("--without", help="Effect to leave out; may be repeated.")
    ] = None,
    gate: Annotated[
        Path | None, typer.Option("--gate", metavar="DATASET", help="Bench tests that gate the extended file.")
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="The diagnosis as JSON.")] = None,
    report: ReportOption = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="NEW.battery.toml, the extended file.")] = None,
    follow: Annotated[
        bool, typer.Option("--follow", help="Since which flight does the effect show, and does it grow?")
    ] = False,
    packs: PacksOption = None,
    pack: PackOption = "",
) -> None:
    """Find the physical effect that the battery file lacks, with the error before and after it is added.

    With --packs the wear that earlier flights have shown counts as known. With --follow the logs are flights of one
    pack, or a folder of them, in order of time; with --packs only those of --pack.
    Exit code 4 if the records do not show it (the reason is also in the JSON).

    Example: uavbatt diagnose flight.BIN --battery mypack.battery.toml --report why.html
    """
    from uavbatt import dataset as data
    from uavbatt.battery import battery_file
    from uavbatt.files import write_json
    from uavbatt.telemetry import read_log

    check_named(output)
    check_writable(json_file, report, output, reads=[*sources, packs])
    _check_effects(without or [])
    content = read_battery(battery, allow_uncertified)
    stated = stated_pack(cells, capacity_ah, cutoff_voltage)
    if follow:
        from uavbatt.cli.diagnose_follow import FollowOptions, follow_and_tell

        if gate is not None or output is not None:
            raise UsageError(
                "--follow: expected neither --gate nor -o: it finds when an effect began and writes no battery file"
            )
        options = FollowOptions(instance, tuple(without or ()), packs, pack)
        follow_and_tell(sources, content, stated, options, json_file, report)
        return
    datasets = [data.load(p) for p in sources if p.is_dir()]
    flights = distinct([read_log(p, instance) for p in sources if not p.is_dir()])
    with reason_written(json_file):
        found, closed, new, base = _run(content, datasets, flights, stated, tuple(without or ()), gate, (packs, pack))
    path = str(battery_file.write_battery(new, output)) if output is not None else None
    for line in [*_lines(found, closed), *([f"  {base.words}"] if base.words else [])]:
        say(line, json_file, report)
    if json_file is not None:
        wear = {"pack": base.words} if base.words else {}
        write_json(json_file, {**_as_json(found, closed, content.status, path), **wear})
    if report is not None:
        from uavbatt.report.diagnosis import diagnosis_report
        from uavbatt.report.page import write_page

        write_page(report, diagnosis_report(found, closed, content, new))
        say(f"report: {report}", json_file, report)
    if path is not None:
        say(f"{path}: {new.certificate.status}", json_file, report)


def _check_effects(names: list[str]) -> None:
    """Raise UsageError for a name in `--without` that no effect has."""
    from uavbatt.battery.effects import EFFECTS

    unknown = next((name for name in names if name not in EFFECTS), None)
    if unknown is not None:
        raise UsageError(f"--without {unknown}: expected one of {', '.join(EFFECTS)}")


def _run(
    content: BatteryFile,
    datasets: list[DataSet],
    flights: list[Flight],
    stated: PackOptions,
    without: tuple[str, ...],
    gate: Path | None,
    remembered: tuple[Path | None, str],
) -> tuple[Diagnosis, ClosedLoop, BatteryFile, BasePack]:
    from uavbatt import dataset as data
    from uavbatt.battery.sizing import PackOptions, pack_from
    from uavbatt.cli.diagnose_worn import base_pack
    from uavbatt.diagnosis import close
    from uavbatt.diagnosis.diagnosis import diagnose as find
    from uavbatt.diagnosis.gate import verdicts
    from uavbatt.fitting import observed
    from uavbatt.log_replay.run import engine_for

    tests = data.load(gate) if gate is not None else None
    sizes = {flown_size(f, content, stated) for f in flights} | {tested_size(d, content, stated) for d in datasets}
    series, capacity_Ah, cutoff_V = one_size(sizes)
    records: list[ObservedRecord] = [r for d in datasets for r in observed.from_dataset(d, capacity_Ah)]
    records += [observed_of(f, series, capacity_Ah) for f in flights]
    options = PackOptions(cells=series, capacity_Ah=capacity_Ah, cutoff_V=cutoff_V)
    base = base_pack(*remembered, flights, content, pack_from(content, options))
    with ProgressLine() as tell:
        engine = engine_for(is_long=True)
        found = find(records, content, base.pack, without, tell, engine, base.wear_sd)
        closed = close.judge(found, base.file, flights, options, tell, engine)
    new = close.extended(content, found, closed.worse)
    if tests is not None:
        remark(f"gating with {gate} ...")
        new = close.gated(new, found, verdicts(tests, new))
    return found, closed, new, base


def _lines(found: Diagnosis, closed: ClosedLoop) -> list[str]:
    from uavbatt.battery.effects import unit_words
    from uavbatt.diagnosis.words import MEANING

    said = {
        "no_missing_effect": "nothing is missing: the residual is no larger than this model's known error",
        "effect_found": f"{len(found.classes)} effects are missing together"
        if found.classes[1:]
        else "an effect is missing",
        "undeclared_effect": "something is missing that no candidate explains",
    }
    lines = [f"{found.verdict}: {said[found.verdict]}"]
    if found.may_hide:
        lines.append("  if a small effect is missing nevertheless, it is most likely this one:")
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
        lines.append("  sizes that could be hidden in these records (95 %):")
        lines += [
            f"    {h.name}: {h.quantity} {h.lo:.3g} to {h.hi:.3g} {unit_words(h.unit)}".rstrip() for h in found.hidden
        ]
    if not found.problem.evidence.has_temperature:
        lines.append("  no temperature: effects that show only in it are not among the candidates")
    b, a = closed.before, closed.after
    lines.append(
        f"  held out: voltage RMSE {1000 * b.voltage_rmse_V:.0f} -> {1000 * a.voltage_rmse_V:.0f} mV, remaining time "
        f"MAE {_number(b.remaining_mae_s)} -> {_number(a.remaining_mae_s)} s"
    )
    if closed.worse:
        lines.append(f"  held-out records are predicted worse with it ({closed.worse}): do the check before you use it")
    return lines


def _number(value: float) -> str:
    return f"{value:.0f}" if math.isfinite(value) else "unknown"


def _as_json(found: Diagnosis, closed: ClosedLoop, status: str, path: str | None) -> dict[str, Any]:
    """Return the diagnosis for JSON, in which NaN becomes null."""
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
