"""Options that several commands share, so that they are spelled the same everywhere."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from uavbatt.errors import UsageError, terminal_line
from uavbatt.records import NAN

if TYPE_CHECKING:
    from uavbatt.battery.battery_file import BatteryFile
    from uavbatt.battery.sizing.pack_size import PackOptions

STANDARD_OUTPUT = Path("-")


def check_ending(path: Path | None, option: str, ending: str) -> None:
    """Raise UsageError for an output whose name has another ending than the file that is written."""
    if path is not None and path != STANDARD_OUTPUT and path.suffix.lower() != ending:
        raise UsageError(f"{option} {path}: expected a name that ends in {ending}")


def _page_name(report: Path | None) -> Path | None:
    check_ending(report, "--report", ".html")
    return report


def number_option(name: str, least: float, most: float, text: str) -> Any:
    """Return an option that takes a number from `least` to `most`; NaN is none. `text` is its help."""
    expected = f"a number from {least:g} to {most:g}" if math.isfinite(most) else f"a number of at least {least:g}"

    def parse(given: str) -> float:
        try:
            number = float(given)
        except ValueError:
            number = NAN
        if not least <= number <= most:
            raise typer.BadParameter(f"expected {expected}, found {given}")
        return number

    return typer.Option(name, parser=parse, metavar="NUMBER", help=f"{text} Expects {expected}.")


BATTERY = typer.Option("--battery", help="Packaged battery by name (see `uavbatt batteries`), or a battery file.")
RESERVE = number_option("--reserve-soc", 0.0, 0.99, "State of charge that ends the flight.")
UNCERTIFIED = typer.Option("--allow-uncertified", help="Read a battery file whose hash or verdict is broken.")
BatteryOption = Annotated[str, BATTERY]
CellsOption = Annotated[int | None, typer.Option("--cells", min=1, max=100, help="Cells in series.")]
CapacityOption = Annotated[float | None, typer.Option("--capacity-ah", help="Capacity of the pack [Ah].")]
CutoffOption = Annotated[float | None, typer.Option("--cutoff-voltage", help="Pack voltage that ends the flight [V].")]
ReserveOption = Annotated[float, RESERVE]
UncertifiedOption = Annotated[bool, UNCERTIFIED]
AmbientOption = Annotated[float, number_option("--ambient-c", -40.0, 60.0, "Ambient temperature [°C].")]
ReportOption = Annotated[Path | None, typer.Option("--report", help="HTML report, opens offline.", callback=_page_name)]
LoadOption = Annotated[str, typer.Option("--load", help="The load to come: learned, recent, log, or watts.")]
VehicleOption = Annotated[Path | None, typer.Option("--vehicle", help="Vehicle file of this aircraft.")]
PacksOption = Annotated[
    Path | None, typer.Option("--packs", metavar="FILE", help="Pack ledger (SQLite); made if missing.")
]
PackOption = Annotated[str, typer.Option("--pack", metavar="NAME", help="Name of the pack; default: its serial.")]
DEFAULT_BATTERY = "lipo-generic"


def positive_or_nan(value: float | None, option: str) -> float:
    """Return the value, or NaN for an option that was not given. Raises UsageError unless it is positive and finite."""
    if value is None:
        return NAN
    if not (math.isfinite(value) and value > 0.0):
        raise UsageError(f"{option} {value}: expected a positive number")
    return value


def stated_pack(
    cells: int | None, capacity_ah: float | None, cutoff_voltage: float | None, reserve_soc: float = 0.0
) -> PackOptions:
    """Return the pack that the options state. Raises UsageError if the pack or the reserve is impossible."""
    from uavbatt.battery.sizing.pack_size import PackOptions
    from uavbatt.limits import OPTIONS, check_stated

    capacity_Ah, cutoff_V = (
        positive_or_nan(capacity_ah, "--capacity-ah"),
        positive_or_nan(cutoff_voltage, "--cutoff-voltage"),
    )
    check_stated(cells, capacity_Ah, cutoff_V, reserve_soc=reserve_soc, names=OPTIONS)
    return PackOptions(cells=cells, capacity_Ah=capacity_Ah, cutoff_V=cutoff_V)


def check_writable(*targets: Path | None, reads: Iterable[Path | None] = (), makes: Path | None = None) -> None:
    """Raise UsageError before any work if an output cannot be written, or would overwrite another or an input.

    `makes` is a folder that the command itself will make.
    """
    check_apart(targets, reads)
    for target in targets:
        if target is None or target == STANDARD_OUTPUT:
            continue
        if target.is_dir():
            raise UsageError(f"{target}: expected a file name to write, it is a directory")
        if target.exists() and not target.is_file():  # it would be replaced by a file, e.g. /dev/null
            raise UsageError(f"{target}: expected a file name to write, it is a device or pipe (stdout is `-`)")
        if target.parent == makes and not makes.exists():
            continue
        if not target.parent.is_dir():
            raise UsageError(f"{target}: expected an existing folder to write into")
        if not os.access(target.parent, os.W_OK | os.X_OK):
            raise UsageError(f"{target}: expected a folder that can be written: permission denied")


def check_kind(battery: Path | None, vehicle: Path | None) -> None:
    """Raise UsageError for a battery file that is named as a vehicle file, or the other way round."""
    if battery is not None and battery.name.endswith(".vehicle.toml"):
        raise UsageError(f"-o {battery}: expected NAME.battery.toml; --vehicle writes a vehicle file")
    if vehicle is not None and vehicle.name.endswith(".battery.toml"):
        raise UsageError(f"--vehicle {vehicle}: expected NAME.vehicle.toml; -o writes a battery file")


def check_named(*targets: Path | None) -> None:
    """Raise UsageError for `-`, as a battery or vehicle file needs a name."""
    if STANDARD_OUTPUT in targets:
        raise UsageError("-: expected a file name to write")


def check_apart(targets: Iterable[Path | None], reads: Iterable[Path | None]) -> None:
    """Raise UsageError if two outputs are one file, or an output is a file that is read."""
    read = {os.path.realpath(path) for path in reads if path is not None}
    taken: set[str] = set()
    for target in targets:
        if target is None:
            continue
        name = "-" if target == STANDARD_OUTPUT else os.path.realpath(target)
        if name in taken:
            raise UsageError(f"{target}: expected a name of its own for each output")
        if name in read:
            raise UsageError(f"{target}: expected another name to write, it is read and would be lost")
        taken.add(name)


def say(line: str, *outputs: Path | None) -> None:
    """Print a line for the user on stdout, or on stderr if an output with data goes to stdout.

    If nobody reads stdout any more (`uavbatt ... | head`), the other lines are lost, but all files are written.
    """
    is_data = STANDARD_OUTPUT in outputs
    try:
        typer.echo(terminal_line(line), err=is_data)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), (sys.stderr if is_data else sys.stdout).fileno())


class ResultFiles(NamedTuple):
    """ResultFiles names the files of a result beside its text: JSON and an HTML page; None if not wanted."""

    json: Path | None
    page: Path | None

    def say(self, line: str) -> None:
        """Print a line for the user, as the function `say` does."""
        say(line, *self)

    def write_json(self, content: Any, indent: int = 2) -> None:
        """Write the content of the JSON file, if it is wanted."""
        from uavbatt.files import write_json

        if self.json is not None:
            write_json(self.json, content, indent)


def remark(line: str) -> None:
    """Print a line that is not a result, on stderr."""
    print(terminal_line(line), file=sys.stderr)


def read_battery(name: str, allow_uncertified: bool) -> BatteryFile:
    """Read the battery file that the options name; for an edited one, print a caveat on stderr."""
    from uavbatt.battery import battery_file

    content = battery_file.read_battery(name, allow_uncertified=allow_uncertified)
    if content.status == "edited":
        remark(f"uavbatt: {name}: {content.caveat}")
    return content
