"""`uavbatt fit`: one battery file from bench tests, from flights, or from both, and what they do not determine."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import msgspec
import numpy as np

from uavbatt.battery.battery_file import Battery, BatteryFile, Certificate
from uavbatt.battery.equations import SECONDS_PER_HOUR
from uavbatt.battery.model import Array
from uavbatt.battery.sections import FITTED_HIGH, FITTED_LOW, Discrepancy
from uavbatt.battery.sizing.log_statements import first_voltages
from uavbatt.battery.sizing.pack_size import PackSize
from uavbatt.battery.sizing.remarks import possible_facts
from uavbatt.dataset import DataSet
from uavbatt.errors import NotEnoughData, UsageError
from uavbatt.fitting import assemble, observed, prior, solve, wander, whole_flights
from uavbatt.fitting.observed import Stack
from uavbatt.fitting.prior import Chemistry
from uavbatt.fitting.solve import CellFit
from uavbatt.limits import FirstVoltages, Resting, cells_doubt, ending_doubt, refuse_certain
from uavbatt.output import counted
from uavbatt.records import Flight

# Spread of packs of one type, new to worn out; flights of a fleet have shown part of the spread already.
MAKE_RESISTANCE_SD, MAKE_CAPACITY_SD, FLEET_CAPACITY_SD = 0.06, 0.05, 0.04
EVALUATIONS = 60  # of a fit, at most; fits of 3 to 40 flights need 10 to 60
LEAST_GAIN = 0.8  # a posterior sd above this share of the prior's: the data add nothing
# What records should reach, else the file says that they do not: a resistance of 1.4 and of 0.85 times that at 25 °C
# (by the usual activation, 1500 K), and the charge below which the voltage falls off.
COLD_C, WARM_C, DEEP_SOC = 5.0, 35.0, 0.1
TEMPERATURE_ENDS = (1.0, 99.0)  # per cent of the readings: a single spike is no temperature that was flown
FAR_SDS = 2.5  # sds of the prior: LiPo and lithium-ion packs stay within 2.2
ELECTRIC = ("ocv_", "r0_", "polarisation_", "diffusion_ratio", "diffusion_tau_s")  # heat flows in many ways


@dataclass(frozen=True, slots=True)
class RecordedPack:
    """RecordedPack holds the size of the pack of the records, and the voltage that ends a flight [V; NaN: unstated]."""

    name: str
    cells: int
    capacity_Ah: float
    cutoff_V: float
    notices: tuple[str, ...] = ()  # statements of the vehicles that are odd or not believed

    @property
    def pack_size(self) -> PackSize:
        """Return the same size as a `PackSize`, the record that estimates are made for."""
        by = "fit"
        sized = (self.cells, by, self.capacity_Ah, by, self.cutoff_V, by)
        return PackSize(self.name, "fitted", *sized, float("nan"), by)


@dataclass(frozen=True, slots=True)
class FittedBattery:
    """FittedBattery holds the battery file, not sealed yet, and what the data show, do not show or make doubtful."""

    file: BatteryFile
    known: tuple[str, ...]
    unknown: tuple[str, ...]
    doubtful: tuple[str, ...] = ()


class FittedRecords(NamedTuple):
    """FittedRecords holds the records of a fit side by side, the bench tests first, and how many there are of each."""

    stack: Stack
    bench: int
    flights: int

    @property
    def has_spread(self) -> bool:
        """Return True if the records tell how much packs differ: three flights or more, and no bench test."""
        return self.flights > 2 and not self.bench


def fit_battery(size: RecordedPack, datasets: list[DataSet], flights: list[Flight]) -> FittedBattery:
    """Fit one cell type to all records together. Raises NotEnoughData when no record has a current."""
    bench = [r for d in datasets for r in observed.from_dataset(d, size.capacity_Ah)]
    read, unread = whole_flights.read(flights, size.cells, size.capacity_Ah)
    if not bench and not read:
        raise NotEnoughData(next(iter(unread), "nothing to fit: expected bench tests or flights with a current"))
    whole, later = whole_flights.from_take_off(read)
    flown, fuller = whole_flights.alike_when_full(whole)
    records = FittedRecords(observed.stack(bench + flown), len(bench), len(flown))
    fit = _solve(records)
    doubtful = (*(f"{words}: left out" for words in unread), *later, *fuller, *_doubtful(fit))
    lowest_soc, found = _lowest_soc(records.stack, fit), (fit.x, fit.standard_errors)
    if not records.bench and lowest_soc > DEEP_SOC:
        found = assemble.with_unseen_ocv(fit.slots, *found, lowest_soc)
    unknown = _unknown_words(fit, records, lowest_soc)
    known = (*_known_words(fit, *found), *(_pack_words(fit) if records.has_spread else ()))
    return FittedBattery(_file(size, datasets, records, fit, found, [*doubtful, *unknown]), known, unknown, doubtful)


def _file(
    size: RecordedPack,
    datasets: list[DataSet],
    records: FittedRecords,
    fit: CellFit,
    found: tuple[Array, dict[str, float]],
    remarks: list[str],
) -> BatteryFile:
    """Return the battery file of a fit, with the values and standard errors `found` of its slots and these remarks."""
    x, error = found
    cutoff_V = _first([size.cutoff_V, assemble.rounded(fit.chemistry.cutoff_V * size.cells)])
    spread = float(np.std(fit.own[:, 1])) if records.has_spread else 0.0
    return BatteryFile(
        battery=Battery(
            name=size.name,
            chemistry=datasets[0].chemistry if datasets else fit.chemistry.name,
            cells_series=size.cells,
            capacity_Ah=size.capacity_Ah,
            cutoff_V=cutoff_V,
            low_V=assemble.rounded(max(fit.chemistry.low_V * size.cells, cutoff_V)),
            source=f"fitted to {counted(records.bench, 'bench test')} and {counted(records.flights, 'flight')}",
            remarks=remarks,
        ),
        parameters=assemble.parameter_table(
            *(fit.slots, x, error, max(spread, MAKE_RESISTANCE_SD)),
            MAKE_CAPACITY_SD if records.bench else FLEET_CAPACITY_SD,
            spread_flights=records.flights if records.has_spread else None,
        ),
        effects=assemble.effect_entries(fit.slots, x, error, fit.effects),
        discrepancy=_discrepancy(records, fit, size.cells),
        certificate=Certificate(
            status="fitted",
            data_sha256=datasets[0].sha256 if len(datasets) == 1 else "",
            statistics=_range_C(records.stack),
        ),
    )


def _lowest_soc(stack: Stack, fit: CellFit) -> float:
    """Return the lowest charge that a record reached, of the stated capacity."""
    discharged_share = np.sum(stack.current_A * stack.dt_s, axis=0) / SECONDS_PER_HOUR / stack.capacity_Ah
    return float(np.min(fit.own[:, 0] - discharged_share))


def _discrepancy(records: FittedRecords, fit: CellFit, cells: int) -> Discrepancy:
    """Return what the fit leaves of the voltages, stated for a pack of so many cells.

    How it changes in time is learned from the flights, or from all records if there are less than two flights.
    """
    stack, source = records.stack, f"{counted(records.bench, 'bench test')}, {counted(records.flights, 'flight')}"
    trajectory = solve.replay_fit(stack, fit)
    left = assemble.discrepancy(stack, trajectory, cells, held_out=False, source=source)
    typical = range(records.bench if records.flights > 1 else 0, len(stack.names))
    return msgspec.structs.replace(left, wander=wander.learn(stack, trajectory, list(typical), cells))


def _solve(records: FittedRecords) -> CellFit:
    """Fit the cell as a LiPo cell or, if the flights make it more probable, as a lithium-ion cell.

    Flights show no voltage without load: with the prior of a LiPo cell the OCV of lithium-ion cells became up to 0.6 V
    too high, with ohms to match, and flights at another load were predicted wrong. A bench test tells OCV from ohms.
    """
    kinds = (prior.LIPO,) if records.bench else (prior.LIPO, prior.LITHIUM_ION)
    return max((_solve_for(records, kind) for kind in kinds), key=lambda found: found.log_evidence)


def _solve_for(records: FittedRecords, chemistry: Chemistry) -> CellFit:
    """Fit the cell to packs that are alike or, if the flights make these more probable, to packs in service.

    A worn pack among packs that are said to be alike bends the curve of the type: of ten flights with packs that hold
    88 to 101 % the soc was wrong by 2.1 of its sds. Where packs are alike, more freedom costs. A resistance that falls
    towards empty stands for the knee of worn packs: then the fit begins again without it.
    """
    fit = partial(solve.fit_cell, records.stack, evaluations=EVALUATIONS, chemistry=chemistry)
    if records.bench:
        return fit(*solve.freedom(records.bench, records.flights))
    usual = (solve.ALIKE, solve.IN_SERVICE)[: 2 if records.has_spread else 1]
    found = max((fit(own_prior=packs) for packs in usual), key=lambda one: one.log_evidence)
    if np.max(prior.dips(found.slots, found.x)) < prior.BUMP:
        return found
    rising = [(fit(own_prior=packs, rising_ohms=True), ln_odds) for packs, ln_odds in solve.PACKS_OF_FLIGHTS]
    return max(rising, key=lambda one: one[0].log_evidence + one[1])[0]


def size_of(
    name: str, datasets: list[DataSet], flights: list[Flight], cells: int | None, capacity_Ah: float, cutoff_V: float
) -> RecordedPack:
    """Return the pack's size by the options, else the data sets, else the vehicles.

    Raises UsageError if none of them states it, and for options that the voltages contradict (`limits`). Statements of
    a vehicle that the voltages contradict are ignored.
    """
    known_cells = [d.cells_series for d in datasets] + [n for f in flights if (n := _flown_cells(f)) is not None]
    series = cells or next(iter(known_cells), None)
    if series is None:
        raise UsageError("cells: neither a data set nor a vehicle states them: give --cells")
    _check_caller(series if cells else None, cutoff_V, series, datasets, flights)
    checked = [possible_facts(f.facts_at(np.inf), series, FirstVoltages()) for f in flights]
    facts, notices = [fact for fact, _ in checked], dict.fromkeys(n for _, words in checked for n in words)
    capacities_Ah = [d.capacity_Ah for d in datasets if d.capacity_Ah] + [f.capacity_Ah for f in facts]
    capacity = _first([capacity_Ah, *capacities_Ah])
    if not np.isfinite(capacity):
        raise UsageError("capacity: neither a data set nor a vehicle states it: give --capacity-ah")
    ends_V = _first([cutoff_V, *[f.critical_voltage_V for f in facts], *[d.cutoff_V for d in datasets]])
    return RecordedPack(name, int(series), float(capacity), float(ends_V), tuple(notices))


def _flown_cells(flight: Flight) -> int | None:
    """Return the cells that a vehicle states, unless its first voltages contradict them."""
    cells = flight.facts_at(np.inf).cells_series
    doubt = cells_doubt(cells, first_voltages(flight.samples), Resting()) if cells else None
    return None if doubt is not None and doubt.is_certain else cells


def _check_caller(
    cells: int | None, cutoff_V: float, series: int, datasets: list[DataSet], flights: list[Flight]
) -> None:
    """Raise UsageError if the stated cells do not fit the first voltages of a record, or the stated cut-off no cell."""
    refuse_certain(ending_doubt("--cutoff-voltage ", cutoff_V, series))
    if cells is None:
        return
    for data in datasets:
        if data.cells_series != cells:
            raise UsageError(f"--cells {cells}: expected {data.cells_series}, as {data.path}/battery.toml states")
    firsts = [(str(d.path), FirstVoltages(d.first_V)) for d in datasets]
    for source, voltages in firsts + [(f.source, first_voltages(f.samples)) for f in flights]:
        refuse_certain(cells_doubt(cells, voltages, Resting()), f"{source}: --cells: ")


def _first(values: list[float]) -> float:
    return next((v for v in values if np.isfinite(v)), float("nan"))


def _known_words(fit: CellFit, x: Array, standard_error: dict[str, float]) -> tuple[str, ...]:
    """Return each parameter with its standard error, in words."""
    pairs = zip(fit.slots, x, strict=True)
    return tuple(f"{slot.name} = {float(value):.4g} ± {standard_error[slot.name]:.2g}" for slot, value in pairs)


def _pack_words(fit: CellFit) -> tuple[str, ...]:
    """Return in words how much the packs of the flights differ."""
    resistance, capacity = np.std(fit.own[:, 1:], axis=0)
    return (f"packs of the flights differ by {resistance:.0%} in resistance, {capacity:.0%} in capacity (sd)",)


def _range_C(stack: Stack) -> dict[str, float]:
    """Return the temperature range of the records [°C] as statistics of the certificate; empty if none was measured."""
    return {FITTED_LOW: round(span[0], 1), FITTED_HIGH: round(span[1], 1)} if (span := _measured_C(stack)) else {}


def _measured_C(stack: Stack) -> tuple[float, float] | None:
    """Return the 1st and the 99th percentile of the measured temperatures [°C]; None if none was measured."""
    temps = stack.temp_C[stack.compare]
    temps = temps[np.isfinite(temps)]
    low_C, high_C = np.percentile(temps, TEMPERATURE_ENDS) if temps.size else (np.nan, np.nan)
    return (float(low_C), float(high_C)) if temps.size else None


def _doubtful(fit: CellFit) -> tuple[str, ...]:
    """Return in words which fitted values no cell of its kind has: they stand for another cause."""
    names = [slot.name for slot, u in zip(fit.slots, fit.u, strict=True) if abs(u) > FAR_SDS]
    far = [name for name in names if name.startswith(ELECTRIC)]
    why = "another chemistry, or other cells, capacity or currents than stated? Do not trust it beyond these records"
    return (f"{', '.join(far)} lie far from those of {fit.chemistry.name} cells: {why}",) if far else ()


def _unknown_words(fit: CellFit, records: FittedRecords, lowest_soc: float) -> tuple[str, ...]:
    """Return in words which quantities the records do not determine."""
    stack = records.stack
    told_nothing = [
        s.name for i, s in enumerate(fit.slots) if np.sqrt(fit.covariance_u[i, i]) > LEAST_GAIN and s.sd > 0.0
    ]
    lines = []
    if told_nothing:
        lines.append(f"your data say little about {', '.join(told_nothing)} (typical {fit.chemistry.name} values used)")
    span = _measured_C(stack)
    if span is None:
        lines.append("no temperature was measured: resistance in the cold and in the heat is the prior's")
    else:
        if span[0] > COLD_C:
            lines.append(f"no cold data: nothing below {span[0]:.0f} °C")
        if span[1] < WARM_C:
            lines.append(f"no warm data: nothing above {span[1]:.0f} °C")
    if lowest_soc > DEEP_SOC:
        lines.append(
            f"no deep discharge: nothing below a charge of {lowest_soc:.2f} "
            "(a flight down to the cut-off makes the last minutes surer)"
        )
    if not records.bench:
        lines.append("flights alone cannot tell capacity from state of charge: the stated capacity stands")
    if not stack.rested.any():
        lines.append("no record starts at rest: the open-circuit voltage near full is the prior's")
    return tuple(lines)
