"""The pack ledger in the companion process: gives the health of a pack on the ground, and takes in what a flight shows.

    serial or --pack  -> prior of the estimator, on the ground
    rows in the air   -> the ledger's airborne rows, every few seconds: a process that dies loses none of them
    landing           -> what the flight taught, saved

The disk may be slow and another program may write: all of it is done by one thread beside the loop, which never waits.
A flight that another process left may be in the air still: it is landed only when no rows of it have come meanwhile.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.remembered import PackHealth
from uavbatt.battery.sizing import PackOptions
from uavbatt.errors import UavbattError
from uavbatt.packs import airborne
from uavbatt.packs.airborne import Airborne, LeftOver
from uavbatt.packs.ledger import AnotherSize, Ledger, prior
from uavbatt.packs.remembering import recalled, taught
from uavbatt.records import NAN, Flight, Identity, PackFacts, Sample

FLUSH_S = 10.0
BEFORE_S, LANDED_S = 30.0, 20.0  # of rest before the take-off and after the landing, for the rested voltage
FLIGHT_SILENT_S = 120.0  # without a row a flight is over
RESUMED_WITHIN_S = 600.0

Result = TypeVar("Result")


@dataclass(slots=True)
class Kept:
    """Kept holds the rows of one battery's flight; the loop alone changes it, in place."""

    name: str
    health: Future[PackHealth | None]
    cycles: int | None = None
    number: Future[int] | None = None  # in the ledger, while it flies
    start_s: float = NAN  # monotonic
    disarmed_s: float = NAN
    last_s: float = NAN
    block: list[Sample] = field(default_factory=list)
    rows: deque[Sample] = field(default_factory=deque)  # not in the ledger yet; monotonic times
    flushed_s: float = -math.inf


class PackKeeper:
    """The keeper takes rows of batteries in, gives the priors of their packs, and saves their flights in the ledger."""

    def __init__(
        self,
        path: Path,
        stated: str,
        battery: BatteryFile,
        options: PackOptions,
        utc_s: Callable[[float], float],
    ) -> None:
        """`utc_s` turns a monotonic time [s] into seconds since 1970, NaN while the clock is not set."""
        self._path, self._stated, self._battery, self._options, self._utc_s = path, stated, battery, options, utc_s
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="packs")
        self._kept: dict[int, Kept] = {}
        self.note = ""
        self._ledger = Ledger(path)
        self._left_over = {left.number: left for left in airborne.left_over(self._ledger)}
        self._ask_s: dict[int, float] = {}  # when to ask whether it has grown, monotonic

    def meet(self, instance: int, serial: str, cycles: int | None, now_s: float) -> Future[PackHealth | None] | None:
        """Return what is remembered of the pack of a battery, once it has a name; None while it has none.

        Of two batteries under one name only the first is remembered. `cycles` may be told later than the name.
        """
        name = self._stated or serial
        first = next((i for i, kept in self._kept.items() if kept.name == name), instance)
        if not name:
            return None
        if first != instance:
            self.note = f"pack ledger: batteries {first} and {instance} are both called {name}: only {first} is kept"
            return None
        kept = self._kept.get(instance)
        if kept is None or kept.name != name:
            if kept is not None:
                self._land(kept)
            health = self._worker.submit(self._noting_errors, self._recalled, name, now_s)
            self._kept[instance] = kept = Kept(name, health)
        kept.cycles = cycles if cycles is not None else kept.cycles
        return kept.health

    def step(self, instance: int, sample: Sample, now_s: float, cells: int, capacity_Ah: float) -> None:
        """Take in one row of a battery, at a monotonic time [s]."""
        kept = self._kept.get(instance)
        if kept is None and sample.armed and not self.note:
            self.note = f"pack ledger: battery {instance} tells no serial and is not remembered: give --pack NAME"
        if kept is None or not (math.isfinite(sample.voltage_V) and math.isfinite(sample.current_A)):
            return
        kept.last_s = now_s
        kept.block.append(replace(sample, time_s=now_s))
        if now_s - kept.block[0].time_s >= airborne.ROW_S:
            kept.rows.append(_mean(kept.block))
            kept.block = []
        if kept.number is None and sample.armed:
            self._take_off(kept, now_s, cells, capacity_Ah)
        kept.disarmed_s = NAN if sample.armed else kept.disarmed_s if math.isfinite(kept.disarmed_s) else now_s
        while kept.number is None and kept.rows and kept.rows[0].time_s < now_s - BEFORE_S:
            kept.rows.popleft()

    def look_after(self, now_s: float) -> None:
        """Write the rows that are due, and save what a flight taught when it is over."""
        for kept in self._kept.values():
            if kept.number is None:
                continue
            if now_s - kept.disarmed_s >= LANDED_S or now_s - kept.last_s >= FLIGHT_SILENT_S:
                self._land(kept)
            elif now_s - kept.flushed_s >= FLUSH_S:
                self._flush(kept, now_s)
        for number, left in list(self._left_over.items()):
            if self._is_resumable(left, now_s):
                continue
            wait_s = 0.0 if self._utc_s(now_s) - left.last_utc_s > RESUMED_WITHIN_S else FLIGHT_SILENT_S + FLUSH_S
            if now_s >= self._ask_s.setdefault(number, now_s + wait_s):
                del self._left_over[number], self._ask_s[number]
                self._worker.submit(self._noting_errors, self._learned_unless_grown, left)

    def close(self, now_s: float) -> None:
        """Write what is held; a flight that is still in the air stays airborne in the ledger."""
        for kept in self._kept.values():
            if kept.number is not None:
                self._flush(kept, now_s)
        self._worker.shutdown()
        self._ledger.close()

    def _take_off(self, kept: Kept, now_s: float, cells: int, capacity_Ah: float) -> None:
        """The pack is armed: its rows go into the ledger from now on, on top of those of a process that died."""
        every = [left for left in list(self._left_over.values()) if left.flight.name == kept.name]
        left = next((left for left in reversed(every) if self._is_resumable(left, now_s)), None)
        if left is not None:  # the last one; what cannot be resumed `look_after` lands
            del self._left_over[left.number]
            self._ask_s.pop(left.number, None)
            kept.number = Future()
            kept.number.set_result(left.number)
            kept.start_s = now_s - (self._utc_s(now_s) - left.flight.start_utc_s)
            return
        kept.start_s = kept.rows[0].time_s if kept.rows else now_s
        flight = Airborne(kept.name, self._utc_s(kept.start_s), cells, capacity_Ah, kept.cycles)
        kept.number = self._worker.submit(airborne.store_flight, self._ledger, flight)

    def _is_resumable(self, left: LeftOver, now_s: float) -> bool:
        """Return True if the flight may be going on still; without a clock, then or now, nobody knows its age."""
        return 0.0 <= self._utc_s(now_s) - left.last_utc_s <= RESUMED_WITHIN_S

    def _flush(self, kept: Kept, now_s: float) -> None:
        assert kept.number is not None
        kept.flushed_s = now_s
        rows = [replace(row, time_s=row.time_s - kept.start_s) for row in kept.rows]
        kept.rows.clear()
        if rows:
            number = kept.number
            self._worker.submit(self._noting_errors, lambda: airborne.store_rows(self._ledger, number.result(), rows))

    def _land(self, kept: Kept) -> None:
        """The flight is over: what it taught is saved, and known the next time the pack is met."""
        if kept.number is None:
            return
        self._flush(kept, kept.last_s)
        number, kept.number = kept.number, None
        self._worker.submit(self._noting_errors, lambda: self._learned(number.result()))

    def _noting_errors(self, work: Callable[..., Result], *arguments: object) -> Result | None:
        """Run work of the thread; an error becomes the note, gives nothing, and does not end the process."""
        try:
            return work(*arguments)
        except UavbattError as error:
            self.note = f"pack ledger: {error}"
        except Exception as error:  # in flight nothing ends the process
            self.note = f"pack ledger: {type(error).__name__} in uavbatt itself: {error}"
        return None

    def _recalled(self, name: str, now_s: float) -> PackHealth | None:
        last = self._ledger.last(name)
        self.note = f"pack {name}: {'met before' if last is not None else 'new'}"
        if last is None:
            return None
        return prior(last, self._utc_s(now_s), self._battery.certificate.content_sha256)

    def _learned_unless_grown(self, was: LeftOver) -> None:
        """Land a flight of another process, or wait on if it flies still, or if its number is another flight's now."""
        now = self._airborne(was.number)
        if now is not None and (now.flight != was.flight or len(now.rows) > len(was.rows)):
            self._left_over[now.number] = now
        else:
            self._learned(was.number)

    def _airborne(self, number: int) -> LeftOver | None:
        return next((one for one in airborne.left_over(self._ledger) if one.number == number), None)

    def _learned(self, number: int) -> None:
        left = self._airborne(number)
        if left is None:
            return
        flight = left.flight
        facts = PackFacts(cells_series=flight.cells, capacity_Ah=flight.capacity_Ah)
        identity = Identity(battery_serial=flight.name, battery_cycles=flight.cycles, start_utc_s=flight.start_utc_s)
        log = Flight("live", "live", left.rows, facts=((0.0, facts),), identity=identity)
        found = taught(self._battery, self._options, log, recalled(self._ledger, flight.name, log, self._battery))
        if found.record is None:
            airborne.delete_flight(self._ledger, number)
            self.note = f"pack {flight.name}: nothing learned: {found.why_not}"
            return
        try:
            after = self._ledger.save(flight.name, found.record, landed=number)
        except AnotherSize as error:
            airborne.delete_flight(self._ledger, number)
            self.note = f"pack {flight.name}: not remembered: {error}"
            return
        words = "; ".join(finding.words for finding in after.findings)
        self.note = f"pack {flight.name}: flight remembered" + (f"; {words}" if words else "")


def _mean(block: list[Sample]) -> Sample:
    """Rows together as one, at their mean time."""
    temps = [row.temp_C for row in block if math.isfinite(row.temp_C)]
    count = len(block)
    return Sample(
        time_s=sum(row.time_s for row in block) / count,
        voltage_V=sum(row.voltage_V for row in block) / count,
        current_A=sum(row.current_A for row in block) / count,
        temp_C=sum(temps) / len(temps) if temps else NAN,
        armed=block[-1].armed,
    )
