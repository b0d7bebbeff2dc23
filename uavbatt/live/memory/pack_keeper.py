"""The pack ledger in the companion process: it gives the health of a pack on the ground, and stores each flight.

    serial or --pack  -> prior of the estimator, on the ground
    rows in the air   -> the ledger's airborne rows, every few seconds: a process that dies loses none of them
    landing           -> the record of the flight, saved

The disk may be slow, and another program may hold the ledger. So one thread beside the loop does all the writing, and
the loop never waits. Rows that could not be written are kept and written with the next ones, or after the landing. If
the file disappears (a memory stick that is pulled out), the flights wait until it is back: no other one is made.

A flight that an earlier process left may still be in the air. It counts as landed only if no rows have come since.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.remembered import PackHealth
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.errors import BadInput, UavbattError
from uavbatt.live.log import tell
from uavbatt.live.memory.kept_flight import FlightInAir, LedgerBattery
from uavbatt.packs import airborne
from uavbatt.packs.airborne import Airborne, UnfinishedFlight
from uavbatt.packs.ledger import AnotherSize, Ledger, prior
from uavbatt.packs.remembering import flight_for_ledger, health_before
from uavbatt.records import Flight, Identity, PackFacts, Sample

FLUSH_S = 10.0
LANDED_S = 20.0  # rest after the landing that is kept, for the rested voltage
FLIGHT_SILENT_S = 120.0  # without a row a flight is over
RESUMED_WITHIN_S = 600.0
MOST_LANDING = 8  # flights that wait to be written

Result = TypeVar("Result")


class PackKeeper:
    """PackKeeper takes the rows of each battery, gives the health of its pack, and saves its flights in the ledger."""

    def __init__(
        self,
        path: Path,
        stated: str,
        battery: BatteryFile,
        options: PackOptions,
        utc_s: Callable[[float], float],
    ) -> None:
        """Open the ledger; `utc_s` turns a monotonic time [s] into seconds since 1970, NaN without a set clock."""
        self._path, self._stated, self._battery, self._options, self._utc_s = path, stated, battery, options, utc_s
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="packs")
        self._kept: dict[int, LedgerBattery] = {}
        self._landing: deque[tuple[LedgerBattery, FlightInAir]] = deque(maxlen=MOST_LANDING)  # not yet in the ledger
        self.note = ""
        self._opened, self._is_doubted, self._is_away = Ledger(path), False, False
        self._left_over = {left.number: left for left in airborne.left_over(self._opened)}
        self._ask_s: dict[int, float] = {}  # when to ask whether it has grown, monotonic

    def begin_vehicle(self) -> None:
        """Land what flies and forget the batteries, as another vehicle is followed from now on."""
        for kept in self._kept.values():
            self._land(kept)
        self._kept.clear()

    def meet(self, instance: int, serial: str, cycles: int | None, now_s: float) -> Future[PackHealth | None] | None:
        """Return the future health of a battery's pack; None while the pack has no name.

        If two batteries have the same name, only the first is kept. `cycles` may come later than the name. A flight
        counts from its landing on.
        """
        name = self._stated or serial
        kept = self._kept.get(instance)
        if kept is not None and kept.name != name:  # another pack: no row of it is of this flight
            self._land(self._kept.pop(instance))
            kept = None
        first = next((i for i, other in self._kept.items() if other.name == name), instance)
        if not name:
            return None
        if first != instance:
            self.note = f"pack ledger: batteries {first} and {instance} are both called {name}: only {first} is kept"
            return None
        if kept is None:
            health = self._worker.submit(self._noting_errors, self._look_up, name, now_s)
            self._kept[instance] = kept = LedgerBattery(name, health)
        kept.cycles = cycles if cycles is not None else kept.cycles
        return kept.health

    def step(self, instance: int, sample: Sample, now_s: float, cells: int, capacity_Ah: float) -> None:
        """Take in one row of a battery, at a monotonic time [s]."""
        kept = self._kept.get(instance)
        if kept is None and sample.armed and not self.note:
            self.note = f"pack ledger: battery {instance} tells no serial and is not remembered: give --pack NAME"
        if kept is None or not (math.isfinite(sample.voltage_V) and math.isfinite(sample.current_A)):
            return
        kept.add(sample, now_s)
        if kept.flying is None and sample.armed:
            self._take_off(kept, now_s, cells, capacity_Ah)
        kept.settle(bool(sample.armed), now_s)

    def look_after(self, now_s: float) -> None:
        """Write the rows that are due, and save the record of each flight that is over."""
        for kept in self._kept.values():
            if kept.flying is None:
                continue
            if now_s - kept.disarmed_s >= LANDED_S or now_s - kept.last_s >= FLIGHT_SILENT_S:
                self._land(kept)
            elif now_s - kept.flushed_s >= FLUSH_S:
                self._flush(kept, kept.flying, now_s)
        self._land_again()
        for number, left in list(self._left_over.items()):
            if self._is_resumable(left, now_s):
                continue
            wait_s = 0.0 if self._utc_s(now_s) - left.last_utc_s > RESUMED_WITHIN_S else FLIGHT_SILENT_S + FLUSH_S
            if now_s >= self._ask_s.setdefault(number, now_s + wait_s):
                del self._left_over[number], self._ask_s[number]
                self._worker.submit(self._noting_errors, self._learn_unless_grown, left)

    def close(self, now_s: float) -> None:
        """Write all rows that wait; a flight that is still in the air stays open in the ledger."""
        for kept in self._kept.values():
            if kept.flying is not None:
                self._flush(kept, kept.flying, now_s)
        self._land_again()
        self._worker.shutdown()
        self._opened.close()

    def _present_ledger(self) -> Ledger:
        """Return the ledger, opened anew if its file was away and is back. Raises BadInput while it is away."""
        if self._opened.is_gone or self._is_doubted:
            if not self._path.exists():
                self._is_away = True
                raise BadInput(self._path, "", "the pack ledger, and it is gone: flights wait until it is back")
            fresh = Ledger(self._path)
            self._opened.close()
            self._opened, self._is_doubted = fresh, False
            if self._is_away:
                self._is_away, self.note = False, f"pack ledger: {self._path} is back"
                tell(self.note)
        return self._opened

    def _take_off(self, kept: LedgerBattery, now_s: float, cells: int, capacity_Ah: float) -> None:
        """Begin a flight when the pack is armed, or go on with the flight of a process that died."""
        every = [left for left in list(self._left_over.values()) if left.flight.name == kept.name]
        left = next((left for left in reversed(every) if self._is_resumable(left, now_s)), None)
        if left is not None:  # the last one; what cannot be resumed `look_after` lands
            del self._left_over[left.number]
            self._ask_s.pop(left.number, None)
            start_s = now_s - (self._utc_s(now_s) - left.flight.start_utc_s)
            kept.flying = FlightInAir(left.flight, start_s, left.number)
            return
        start_s = kept.rows[0].time_s if kept.rows else now_s
        flight = Airborne(kept.name, self._utc_s(start_s), cells, capacity_Ah, kept.cycles)
        kept.flying = FlightInAir(flight, start_s)
        self._flush(kept, kept.flying, now_s)

    def _is_resumable(self, left: UnfinishedFlight, now_s: float) -> bool:
        """Return True if the flight may still be in the air; False if a clock was not set, so that its age is
        unknown."""
        return 0.0 <= self._utc_s(now_s) - left.last_utc_s <= RESUMED_WITHIN_S

    def _flush(self, kept: LedgerBattery, flying: FlightInAir, now_s: float) -> None:
        kept.flushed_s = now_s
        kept.hand_over(flying)
        if flying.is_to_be_written:
            flying.writing = self._worker.submit(self._noting_errors, self._write, flying)

    def _write(self, flying: FlightInAir) -> None:
        """Store a flight and its rows; rows that cannot be written now are stored the next time."""
        ledger = self._present_ledger()
        if flying.number is None or (flying.ledger is not ledger and not self._is_stored(flying)):
            flying.number = airborne.store_flight(ledger, flying.flight)
        flying.ledger, rows = ledger, flying.take_rows()
        try:
            airborne.store_rows(ledger, flying.number, rows)
        except UavbattError:
            flying.give_back(rows)
            raise

    def _land(self, kept: LedgerBattery) -> None:
        """End the flight and save its record, which counts the next time the pack is connected."""
        if kept.flying is None:
            return
        flying, kept.flying = kept.flying, None
        kept.hand_over(flying)
        kept.health = self._worker.submit(self._noting_errors, self._end_flight, kept, flying)

    def _land_again(self) -> None:
        """Try again to save the landed flights that could not be written."""
        for _ in range(len(self._landing)):
            kept, flying = self._landing.popleft()
            kept.health = self._worker.submit(self._noting_errors, self._end_flight, kept, flying)

    def _end_flight(self, kept: LedgerBattery, flying: FlightInAir) -> PackHealth | None:
        """Save the record of a flight, and return the new health of the pack."""
        try:
            self._write(flying)
        except UavbattError:
            if self._may_wait(flying):
                self._landing.append((kept, flying))
            raise
        assert flying.number is not None
        self._learn(flying.number)
        return self._health_of(kept.name, kept.last_s)

    def _is_stored(self, flying: FlightInAir) -> bool:
        """Return True if the ledger holds this flight under its number."""
        found = self._airborne(flying.number) if flying.number is not None else None
        return found is not None and found.flight.name == flying.flight.name

    def _may_wait(self, flying: FlightInAir) -> bool:
        """Return True if a landed flight is to be written later; False if the user has deleted its pack."""
        try:
            return flying.number is None or self._airborne(flying.number) is not None
        except UavbattError:
            return True

    def _noting_errors(self, work: Callable[..., Result], *arguments: object) -> Result | None:
        """Run work in the thread; on an error set the note and return None, so that the process goes on."""
        try:
            return work(*arguments)
        except UavbattError as error:
            words = f"pack ledger: {error}"
        except Exception as error:  # in flight nothing ends the process
            words = f"pack ledger: {type(error).__name__} in uavbatt itself: {error}"
        self._is_doubted = True
        if words != self.note:
            tell(words)
        self.note = words
        return None

    def _look_up(self, name: str, now_s: float) -> PackHealth | None:
        health = self._health_of(name, now_s)
        self.note = f"pack {name}: {'met before' if health is not None else 'new'}"
        return health

    def _health_of(self, name: str, now_s: float) -> PackHealth | None:
        now_utc_s = self._utc_s(now_s)
        last = self._present_ledger().last(name, now_utc_s)
        return prior(last, now_utc_s, self._battery.certificate.content_sha256) if last is not None else None

    def _learn_unless_grown(self, was: UnfinishedFlight) -> None:
        """Save the flight of an earlier process, or wait longer if it has new rows or its number is reused."""
        now = self._airborne(was.number)
        if now is not None and (now.flight != was.flight or len(now.rows) > len(was.rows)):
            self._left_over[now.number] = now
        else:
            self._learn(was.number)

    def _airborne(self, number: int) -> UnfinishedFlight | None:
        return next((one for one in airborne.left_over(self._present_ledger()) if one.number == number), None)

    def _learn(self, number: int) -> None:
        left = self._airborne(number)
        if left is None:
            return
        flight = left.flight
        facts = PackFacts(cells_series=flight.cells, capacity_Ah=flight.capacity_Ah)
        identity = Identity(battery_serial=flight.name, battery_cycles=flight.cycles, start_utc_s=flight.start_utc_s)
        log = Flight("live", "live", left.rows, facts=((0.0, facts),), identity=identity)
        before = health_before(self._present_ledger(), flight.name, log, self._battery)
        found = flight_for_ledger(self._battery, self._options, log, before)
        if found.record is None:
            airborne.delete_flight(self._present_ledger(), number)
            self.note = f"pack {flight.name}: nothing learned: {found.why_not}"
            return
        try:
            after = self._present_ledger().save(flight.name, found.record, landed=number)
        except AnotherSize as error:
            airborne.delete_flight(self._present_ledger(), number)
            self.note = f"pack {flight.name}: not remembered: {error}"
            return
        words = "; ".join(finding.words for finding in after.findings)
        self.note = f"pack {flight.name}: flight remembered" + (f"; {words}" if words else "")
