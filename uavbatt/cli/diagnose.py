"""`uavbatt diagnose`: which effect the battery file lacks, how large it is, and which other effects are possible."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uavbatt.cli.diagnose_records import (
    DiagnoseOptions,
    ProgressLine,
    flown_size,
    observed_of,
    one_size,
    reason_written,
    tested_size,
    with_known_start,
)
from uavbatt.cli.logs import InstanceOption, SourcesArgument, asked_flights, data_sets_and_logs
from uavbatt.cli.options import (
    BatteryOption,
    CapacityOption,
    CellsOption,
    CutoffOption,
    PackOption,
    PacksOption,
    ReportOption,
    ResultFiles,
    UncertifiedOption,
    check_named,
    check_writable,
    read_battery,
    remark,
    stated_pack,
)
from uavbatt.errors import UsageError
from uavbatt.records import Flight

if TYPE_CHECKING:
    from uavbatt.battery.battery_file import BatteryFile
    from uavbatt.cli.diagnose_worn import BasePack
    from uavbatt.dataset import DataSet
    from uavbatt.diagnosis.close import ClosedLoop
    from uavbatt.diagnosis.diagnosis import Diagnosis
    from uavbatt.fitting.observed import ObservedRecord


def diagnose(
    sources: SourcesArgument,
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
    check_named(output)
    check_writable(json_file, report, output, reads=[*sources, packs])
    _check_effects(without or [])
    options = DiagnoseOptions(
        battery=read_battery(battery, allow_uncertified),
        pack=stated_pack(cells, capacity_ah, cutoff_voltage),
        without=tuple(without or ()),
        instance=instance,
        ledger=packs,
        pack_name=pack,
    )
    files = ResultFiles(json_file, report)
    if not follow:
        _diagnose_and_tell(sources, options, gate, files, output)
        return
    from uavbatt.cli.diagnose_follow import follow_and_tell

    if gate is not None or output is not None:
        raise UsageError(
            "--follow: expected neither --gate nor -o: it finds when an effect began and writes no battery file"
        )
    follow_and_tell(sources, options, files)


def _check_effects(names: list[str]) -> None:
    """Raise UsageError for a name in `--without` that no effect has."""
    from uavbatt.battery.effects import EFFECTS

    unknown = next((name for name in names if name not in EFFECTS), None)
    if unknown is not None:
        raise UsageError(f"--without {unknown}: expected one of {', '.join(EFFECTS)}")


def _diagnose_and_tell(
    sources: list[Path], options: DiagnoseOptions, gate: Path | None, files: ResultFiles, output: Path | None
) -> None:
    """Diagnose the records, print the result, and write the files that are wanted; `output` is the extended file."""
    from uavbatt.battery import battery_file
    from uavbatt.cli.diagnose_text import as_json, lines

    datasets, logs = data_sets_and_logs(sources)
    flights = asked_flights(logs, options.instance)
    with reason_written(files):
        found, closed, new, base = _run(datasets, flights, options, gate)
    path = str(battery_file.write_battery(new, output)) if output is not None else None
    for line in [*lines(found, closed), *([f"  {base.words}"] if base.words else [])]:
        files.say(line)
    wear = {"pack": base.words} if base.words else {}
    files.write_json({**as_json(found, closed, options.battery.status, path), **wear})
    if files.page is not None:
        from uavbatt.report.diagnosis import diagnosis_report
        from uavbatt.report.page import write_page

        write_page(files.page, diagnosis_report(found, closed, options.battery, new))
        files.say(f"report: {files.page}")
    if path is not None:
        files.say(f"{path}: {new.certificate.status}")


def _run(
    datasets: list[DataSet], flights: list[Flight], options: DiagnoseOptions, gate: Path | None
) -> tuple[Diagnosis, ClosedLoop, BatteryFile, BasePack]:
    """Return the diagnosis, the errors before and after it, the extended battery file, and the pack it began with."""
    from uavbatt import dataset as data
    from uavbatt.battery.sizing.pack_size import PackOptions, pack_from
    from uavbatt.cli.diagnose_worn import base_pack
    from uavbatt.diagnosis import close
    from uavbatt.diagnosis.diagnosis import diagnose as find
    from uavbatt.diagnosis.gate import verdicts
    from uavbatt.fitting import observed
    from uavbatt.log_replay.run import engine_for

    content, stated = options.battery, options.pack
    tests = data.load(gate) if gate is not None else None
    sizes = [flown_size(f, content, stated) for f in flights] + [tested_size(d, content, stated) for d in datasets]
    series, capacity_Ah, cutoff_V = one_size(sizes)
    records: list[ObservedRecord] = [r for d in datasets for r in observed.from_dataset(d, capacity_Ah)]
    records += with_known_start([observed_of(f, series, capacity_Ah) for f in flights])
    size = PackOptions(cells=series, capacity_Ah=capacity_Ah, cutoff_V=cutoff_V)
    base = base_pack(options.ledger, options.pack_name, flights, content, pack_from(content, size))
    with ProgressLine() as tell:
        engine = engine_for(is_long=True)
        found = find(records, content, base.pack, options.without, tell, engine, base.wear_sd)
        closed = close.judge(found, base.file, flights, size, tell, engine)
    new = close.extended(content, found, closed.worse)
    if tests is not None:
        remark(f"gating with {gate} ...")
        new = close.gated(new, found, verdicts(tests, new))
    return found, closed, new, base
