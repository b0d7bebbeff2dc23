"""`uavbatt validate`: judge discharge tests, build the corridor, gate the battery model, ship it."""

from __future__ import annotations

import math
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uavbatt.cli.options import ReportOption, ResultFiles, check_writable, number_option, remark, say
from uavbatt.cli.progress import progress_bar
from uavbatt.errors import UsageError

if TYPE_CHECKING:
    from uavbatt.dataset import DataSet
    from uavbatt.validation.gating.gate import Limits
    from uavbatt.validation.study.paper import PaperReplay
    from uavbatt.validation.validate import Validation

MOST_CLAIMS = 12  # claims without a vote that are printed; the report has all


class Method(StrEnum):
    """Method says how the tests are judged."""

    ISO = "iso"
    PAPER = "paper"


def validate(
    dataset: Annotated[
        Path | None, typer.Argument(metavar="[DATASET]", help="Data-set folder; default: the packaged study.")
    ] = None,
    ship: Annotated[
        Path | None, typer.Option("--ship", metavar="DIR", help="Folder for the battery file, written on pass.")
    ] = None,
    report: ReportOption = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Every number as JSON.")] = None,
    method: Annotated[
        Method, typer.Option("--method", help="iso (gates), or paper: the study's equations as printed.")
    ] = Method.ISO,
    template: Annotated[
        Path | None, typer.Option("--template", metavar="DIR", help="Write a data set to fill in, and nothing else.")
    ] = None,
    limit_v: Annotated[
        float | None,
        number_option("--limit-v", 0.001, math.inf, "Largest bias that passes [V of this pack]; default: 0.05 a cell."),
    ] = None,
    limit_s: Annotated[
        float, number_option("--limit-s", 0.1, math.inf, "Largest bias of the crossing time that passes, in s.")
    ] = 10.0,
    crossing_v: Annotated[
        float | None, number_option("--crossing-v", 0.1, math.inf, "Voltage of this pack whose crossing is timed [V].")
    ] = None,
) -> None:
    """Judge the tests by ISO 5725, build the corridor of permissible dispersion, and gate the battery model.

    Exit code 0: pass, 1: fail, 4: not enough data.

    Example: uavbatt validate mypack/ --ship . --report mypack.html
    """
    from uavbatt import dataset as data

    if template is not None:
        data.write_template(template)
        say(f"written: {', '.join(str(template / name) for name in data.TEMPLATE_FILES)}")
        return
    check_writable(report, json_file, makes=ship)
    if ship is not None and ship.exists() and not ship.is_dir():
        raise UsageError(f"--ship {ship}: expected a folder")
    tests = data.load(dataset)
    if method is Method.PAPER:
        if ship is not None or report is not None:
            raise UsageError("--method paper judges the tests as printed: --ship and --report need --method iso")
        _paper(tests, ResultFiles(json_file, report))
        return
    limits = _limits(tests.cells_series, limit_v, limit_s, crossing_v)
    result = _iso(tests, limits, ship, ResultFiles(json_file, report))
    raise typer.Exit({"pass": 0, "fail": 1, "not enough data": 4}[result.verdict])


def _iso(tests: DataSet, limits: Limits, ship: Path | None, files: ResultFiles) -> Validation:
    """Judge the tests, print the result, and write the files that are wanted."""
    from uavbatt.validation.as_json import to_builtins
    from uavbatt.validation.validate import validate as judge

    remark(f"fitting {tests.name}, one occasion left out at a time ...")
    with progress_bar(tests.name) as progress:
        result = judge(tests, limits, progress)
    printed = _paper_replay(tests)
    for line in _lines(result):
        files.say(line)
    if ship is not None:
        ship.mkdir(parents=True, exist_ok=True)
    files.write_json(to_builtins(result, printed), indent=1)
    if files.page is not None:
        from uavbatt.report.page import write_page
        from uavbatt.report.validation.validation_page import validation_report

        write_page(files.page, validation_report(result, printed))
        files.say(f"report: {files.page}")
    if ship is not None:
        _ship(result, ship, files)
    return result


def _ship(result: Validation, folder: Path, files: ResultFiles) -> None:
    """Write the battery file that has passed into the folder."""
    from uavbatt.battery import battery_file

    if result.battery is None:
        remark("nothing shipped: the verdict is not pass")
        return
    path = folder / f"{result.battery.battery.name}{battery_file.SUFFIX}"
    files.say(f"shipped: {battery_file.write_battery(result.battery, path)}")


def _limits(cells: int, limit_V: float | None, limit_s: float, crossing_V: float | None) -> Limits:
    """Return the limits of the gate, which are for three cells, from the limits stated for this pack."""
    from uavbatt.validation.gating.gate import Limits

    usual, share = Limits(), 3.0 / cells
    return Limits(
        voltage_V=usual.voltage_V if limit_V is None else limit_V * share,
        time_s=limit_s,
        crossing_V=usual.crossing_V if crossing_V is None else crossing_V * share,
    )


def _lines(result: Validation) -> list[str]:
    """Return the verdict, then its claims, then the findings about the tests, as lines of text."""
    tests = result.dataset
    return [
        f"{tests.name}: {result.verdict.upper()} at {result.ambient_C:g} °C "
        f"({len(tests.runs)} runs, {len(tests.ambients_C)} ambient temperatures)",
        "",
        *_claim_lines(result),
        "",
        "findings about the tests",
        *(f"  [{f.severity}] {f.title}" for f in result.findings),
        "",
        *_precision_lines(result),
    ]


def _claim_lines(result: Validation) -> list[str]:
    """Return the claims that gate, and the first MOST_CLAIMS of those that only inform."""
    from uavbatt.report.validation.tables import plain_reason

    said = [(c.gates, f"  {c.verdict:>15}  {c.claim} at {c.ambient_C:g} °C: {plain_reason(c)}") for c in result.claims]
    gating, others = [line for gates, line in said if gates], [line for gates, line in said if not gates]
    left_out = len(others) - MOST_CLAIMS
    more = [f"  {'':>15}  ... and {left_out} more in the report"] if left_out > 0 else []
    return ["claims", *gating, "claims that inform and do not gate", *others[:MOST_CLAIMS], *more]


def _precision_lines(result: Validation) -> list[str]:
    """Return the precision of the voltage at each whole minute."""
    lines = ["precision (ISO 5725-2)", "    min      mean      s_r      s_L      s_R        r        R"]
    for row in result.precision:
        if row.quantity == "voltage_V" and (row.time_s % 60.0) < 1e-6:
            p = row.precision
            lines.append(
                f"  {row.time_s / 60.0:5.0f}  "
                + " ".join(f"{v:8.4f}" for v in (p.mean, p.s_r, p.s_L, p.s_R, p.r, p.R))
                + ("  s_L² < 0, set to 0" if p.negative_between else "")
            )
    return lines


def _paper_replay(tests: DataSet) -> PaperReplay | None:
    """Return the result of the study's own method; None if it does not apply to these tests."""
    from uavbatt.errors import UavbattError
    from uavbatt.validation.study import paper

    try:
        return paper.replay(tests)
    except UavbattError:
        return None


def _paper(tests: DataSet, files: ResultFiles) -> None:
    from uavbatt.validation.study import paper

    replayed = paper.replay(tests)
    for line in _paper_lines(tests.name, replayed):
        files.say(line)
    files.write_json(replayed, indent=1)


def _paper_lines(name: str, replayed: PaperReplay) -> list[str]:
    """Return the agreement of the study's equations with its printed tables, then each column, as lines of text."""
    lines = [f"{name}: the study's equations (1)-(17) as printed", "agreement with the printed tables"]
    for found in replayed.agreements:
        lines.append(f"  {found.table}: {found.agree} of {found.total} ({found.counted})")
        lines += [f"    not met: {slip}" for slip in found.slips]
    fisher = replayed.fisher
    if fisher is not None:
        verdict = "reproduced" if fisher.reproducible else "cannot be reproduced"
        lines.append(f"  F_emp = {fisher.printed:g} {verdict}: the nearest ratio of any column is {fisher.nearest:.3f}")
    lines.append("column by column")
    lines += [
        f"  sample {c.sample} {c.quantity} {c.time_s / 60.0:g} min: mean {c.mean:.4f}, sd {c.sd:.4f}, r {c.r:.4f}"
        + (", drifts by the study's rule" if c.drifts else "")
        for c in replayed.columns
    ]
    return [*lines, *(f"  note: {note}" for note in replayed.notes), "", *_conclusion(replayed)]


def _conclusion(replayed: PaperReplay) -> list[str]:
    """Return the conclusion by the study's own rules: precision, pooling and corridor, as lines of text."""
    volts = [column for column in replayed.columns if column.quantity == "voltage_V"]
    drifting = [column for column in volts if column.drifts]
    worst = max(volts, key=lambda column: column.r)
    lines = [
        f"conclusion by the study's own rules, at {replayed.ambient_C:g} °C",
        f"  repeatability: r is {worst.r:.3f} V at most (sample {worst.sample}, {worst.time_s / 60.0:g} min); "
        f"{len(drifting)} of {len(volts)} columns of voltage drift",
    ]
    for name, unit, pooled in (("voltage", "V", replayed.pooled), ("temperature", "°C", replayed.pooled_surface)):
        if not pooled:
            continue
        apart = [one for one in pooled if not one.may_pool]
        minutes = ", ".join(f"{one.time_s / 60.0:g}" for one in apart)
        said = f"may not be pooled at {minutes} min" if apart else "may be pooled at every instant"
        corridor = max(pooled, key=lambda one: one.C)
        lines.append(
            f"  {name}: the samples {said}; corridor mean ± C, C at most {corridor.C:.3f} {unit} "
            f"({corridor.time_s / 60.0:g} min)"
        )
    if not replayed.pooled:
        lines.append("  one sample: nothing to pool, no corridor by the study's rules")
    return [*lines, "  this method judges the tests only; `--method iso` also gates the model"]
