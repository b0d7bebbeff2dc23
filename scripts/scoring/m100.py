"""The M100 benchmark, leave one aircraft out: what each method said on every flight whose end is known.

Everything that is learned (battery file, vehicle file, the usable charge of a calibrated pilot) is learned from the
two other aircraft, so that no number of the aircraft held out is in it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from peers import px4

from scoring.data import M100, M100_CELLS, M100_CUTOFF_V, ended
from scoring.lines import Lines, logged, ours, replayed
from scoring.peer_lines import PeerPack, calibrated, peer_lines
from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.fitting.battery import RecordedPack, fit_battery
from uavbatt.fitting.vehicle import fit_vehicle
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.prediction.load.library import LearnedLoad, UnknownAircraft, learned_load
from uavbatt.prediction.load.scenarios import Load, RecentMean
from uavbatt.scoring.scores import FlightScore

RATED_AH = 5.7
LOG, LEARNED, UNKNOWN, RECENT = "ours, log", "ours, learned", "ours, unknown aircraft", "ours, recent"
PX4_SET = px4.Parameters(r_internal=0.005)  # the kinder reading where rows are seconds apart, see peers.px4
OPTIONS = PackOptions(cells=M100_CELLS, capacity_Ah=RATED_AH, cutoff_V=M100_CUTOFF_V)


@dataclass(frozen=True, slots=True)
class Fold:
    """A Fold holds what the two other aircraft teach."""

    aircraft: str
    battery: BatteryFile
    library: LearnedLoad
    peers: PeerPack


@dataclass(frozen=True, slots=True)
class Result:
    """A Result is one method on one flight."""

    flight: M100
    lines: Lines
    score: FlightScore


def fold(flights: list[M100], aircraft: str) -> Fold:
    """Learn battery, vehicle and calibration from every flight of the other aircraft."""
    others = [f for f in flights if f.aircraft != aircraft]
    size = RecordedPack(f"m100-without-{aircraft}", M100_CELLS, RATED_AH, M100_CUTOFF_V)
    battery = fit_battery(size, [], [f.flight for f in others]).file
    learned = learned_load(fit_vehicle(size.name, [f.flight for f in others], battery, OPTIONS))
    peers = calibrated(M100_CELLS, RATED_AH, [(f.flight, f.end_s) for f in ended(others)], PX4_SET)
    return Fold(aircraft, battery, learned, peers)


def our_lines(known: Fold, flight: M100) -> dict[str, Lines]:
    """Return the forecast lines of the four ways to know the load, on one battery file."""
    loads: dict[str, Load] = {
        LOG: logged(flight.flight),
        LEARNED: known.library,
        UNKNOWN: UnknownAircraft(),
        RECENT: RecentMean(),
    }
    return {
        name: ours(replayed(flight.flight, known.battery, OPTIONS, ForecastSettings(load)))
        for name, load in loads.items()
    }


def results(flights: list[M100], say: Callable[[str], None]) -> dict[str, list[Result]]:
    """Return every method on every flight that reaches its end, by method."""
    found: dict[str, list[Result]] = {}
    for aircraft in sorted({f.aircraft for f in flights}):
        say(f"m100: learning from the aircraft other than {aircraft}")
        known = fold(flights, aircraft)
        for flight in ended([f for f in flights if f.aircraft == aircraft]):
            say(f"m100: {flight.name}")
            said = {**our_lines(known, flight), **peer_lines(known.peers, flight.flight.samples)}
            for name, lines in said.items():
                score = lines.scored(flight.name, aircraft, flight.start_s, flight.end_s)
                found.setdefault(name, []).append(Result(flight, lines, score))
    return found
