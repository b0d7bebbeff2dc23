"""Live frames of one vehicle -> rows of its batteries, by the same rules and functions as for a tlog.

    HEARTBEAT: armed, PX4 or not        PARAM_VALUE: PackFacts of each battery (`HeardParameters` decides which count)
    AUTOPILOT_VERSION: serial number
    BATTERY_STATUS / SYS_STATUS / BATTERY2: a Sample
    route and place: `NavigationListener`

SYS_STATUS is used for battery 0 (BATTERY2 for 1) only if no BATTERY_STATUS comes for it: such rows are held for
FALLBACK_AFTER_S and then released. If battery 0 is the only one, they count again after ALONE_AFTER_S without its
BATTERY_STATUS. The first row of a battery waits for the second one: one damaged frame in 65 536 has a good checksum,
and must not make a battery that does not exist. PARAM_VALUE of an integer waits for the first heartbeat, because PX4
sends the bits of an integer and ArduPilot its value. An armed vehicle is disarmed when two heartbeats in a row say so:
a damaged one must not end a flight.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from uavbatt.mavlink import fields, framing
from uavbatt.records import PackFacts, Sample
from uavbatt.telemetry.builder import ALONE_AFTER_S, BEATING_S, FALLBACK_AFTER_S, LONGEST_ALONE_S, LogBuilder
from uavbatt.telemetry.cleaning.pack_voltage import PackVoltages, is_in_sys_status
from uavbatt.telemetry.identity import stated_serial
from uavbatt.telemetry.link.heard_route import HeardRoute, ToldFrame
from uavbatt.telemetry.link.lateness import Lateness
from uavbatt.telemetry.link.live_row import CONFIRMED_WITHIN_S, LiveRow, heard_twice
from uavbatt.telemetry.link.speakers import Speakers
from uavbatt.telemetry.parameters import (
    BATTERY_NAMES,
    HeardParameters,
    capacity_notes,
    facts_timeline,
    statements_of,
)
from uavbatt.telemetry.route.messages import OF_AUTOPILOT, NavigationListener
from uavbatt.telemetry.route.settings import NAMES

LAST_BEAT_S = 10.0  # slow radios carry a heartbeat every 5 s
WITHOUT_VOLTAGE = 5  # battery messages without a voltage before a note says so
MOST_HELD = 500
MOST_PARAMETERS = 1000


class Vehicle:
    """Vehicle takes the frames of one autopilot in order of reception, and gives the rows of its batteries."""

    def __init__(self, system: int, component: int, own_component: int | None = None) -> None:
        self.system, self.component = system, component
        self.speakers = Speakers()
        self.parameters = HeardParameters()
        self.voltages = PackVoltages()
        self.words: dict[bytes, bytes] = {}  # frames that a recording begins with: heartbeat, parameters, home, mission
        self.heard_route = HeardRoute(self.source, own_component, self.words)
        self.battery_ids: set[int] = set()
        self.is_px4: bool | None = None  # until the first heartbeat
        self._unread: list[tuple[Any, bytes]] = []  # integers that were heard before it
        self.hardware = ""  # serial number of the autopilot
        self.packs: dict[int, fields.PackIdentity] = {}  # identity of each pack, as it says itself
        self._without_voltage = 0  # battery messages without a voltage since the last one with it
        self.speaks = False  # True once it has sent two messages of a battery
        self.heard_s = -math.inf
        self._beat_s = -math.inf
        self._said_armed = False  # by the last heartbeat
        self.lateness = Lateness()
        self._log = LogBuilder(longest_step_s=math.inf)  # the clock is monotonic: a long step is a real gap
        self._held: list[LiveRow] = []
        self._unconfirmed: dict[int, LiveRow] = {}
        self._fallback_ids: set[int] = set()
        self._unconfirmed_fallback: dict[int, LiveRow] = {}
        self._first_s: float | None = None
        self._sys_status_s = -math.inf
        self._alone_s = 0.0  # time of SYS_STATUS without BATTERY_STATUS of battery 0
        self._spoke_s = -math.inf

    @property
    def source(self) -> tuple[int, int]:
        """Return system and component of the autopilot."""
        return self.system, self.component

    @property
    def route(self) -> NavigationListener:
        """Return what is known of route and place."""
        return self.heard_route.listener

    @property
    def now_s(self) -> float:
        """Return the time of the vehicle's last frame, from its first [s]."""
        return self._log.now_s

    @property
    def armed(self) -> bool | None:
        """Return the armed bit of the last heartbeat; None before it, and if the last that was disarmed is old.

        Some routers send heartbeats on one way and telemetry on another: a vehicle heard on the ground has flown since.
        """
        is_old = self.now_s - self._beat_s > LAST_BEAT_S
        return None if is_old and self._log.armed is False else self._log.armed

    @property
    def is_beating(self) -> bool:
        """Return True if a heartbeat came shortly before the last frame, so that the armed bit is up to date."""
        return self.now_s - self._beat_s <= BEATING_S

    @property
    def notes(self) -> list[str]:
        """Return notes for the operator about the voltages and capacities of the batteries."""
        stated = [note for id in self.battery_ids for note in capacity_notes(self.parameters.known, id)]
        if self._without_voltage < WITHOUT_VOLTAGE:
            return [*self.voltages.notes, *stated]
        doubt = "is its wire broken, or the pack out?" if self.speaks else "is the autopilot's battery monitor set up?"
        return [f"battery messages come without a voltage: {doubt}"]

    def passes(self, stamp_s: float) -> float:
        """Note a frame of its system, received at `stamp_s` [s]; return the time from its first frame [s]."""
        return self._log.time_s(stamp_s)

    def facts(self, instance: int) -> PackFacts:
        """Return the facts that the vehicle has stated about one battery so far."""
        said = facts_timeline(((0.0, n, v) for n, v in self.parameters.known.items()), instance, is_telemetry=True)
        return said[-1][1] if said else PackFacts()

    def pack(self, instance: int) -> fields.PackIdentity:
        """Return serial and cycles of a battery's pack: from its own messages, else the serial from the parameter."""
        said = self.packs.get(instance, fields.PackIdentity(instance))
        return replace(said, serial=said.serial or stated_serial(self.parameters.known, instance))

    def meet(self, pack: fields.PackIdentity, frame: bytes) -> None:
        """Take what a pack states of itself: who it is, and its size as statements like the parameters."""
        if pack.serial or pack.cycles is not None:
            self.packs[pack.id] = pack
        for name, value in statements_of(pack):
            self._take_statement(name, value, frame)

    @property
    def told(self) -> bytes:
        """Return the frames in which the vehicle told what it may not tell again: parameters, home, mission."""
        known = self.parameters.known
        stated = (frame for name, frame in self.words.items() if name.decode("latin-1") in known)
        return b"".join((*stated, self.heard_route.frames))

    def resume(self, earlier: Mapping[str, float], told: Sequence[ToldFrame] = ()) -> None:
        """Use parameters, and the frames `told` to an earlier process; what the vehicle tells has priority."""
        self.parameters.resume(earlier)
        self.heard_route.resume(self.now_s, told)
        self.route.builder.settings(self.now_s, self.parameters.known)
        for header, message, frame in told:  # a recording begins with them, too
            if header.message_id == fields.PARAM_VALUE and header.source == self.source:
                name, _ = fields.parameter(message, self.is_px4 is True)
                if name in self.parameters.known:
                    self.words.setdefault(name.encode("latin-1"), frame)

    def take(
        self, message_id: int, message: Any, battery: fields.BatteryFields | None, frame: bytes, time_s: float
    ) -> list[LiveRow]:
        """Return the rows that a message of the autopilot completes; `battery` is the battery reading in it, if any."""
        if message_id == fields.HEARTBEAT:
            self._beat(message, frame, time_s)
            return self._released(time_s)
        if message_id == fields.PARAM_VALUE:
            self._hear(message, frame)
            return []
        if message_id == fields.AUTOPILOT_VERSION:
            self.hardware = self.hardware or fields.hardware(message.uid)
            return []
        if message_id in OF_AUTOPILOT:
            self.heard_route.take(time_s, message_id, message, frame)
            return []
        if battery is None:  # from a program that writes a mission, with the autopilot's own ids
            return []
        if message_id == fields.BATTERY_STATUS:
            is_in_other = is_in_sys_status(battery.id, self.is_px4 is True, self.battery_ids)
            row = self._row(time_s, self.voltages.of(battery, time_s, self._log.armed, is_in_other))
            if row is None:
                return []
            if row.instance == 0:
                self._alone_s = 0.0
            return self._confirmed(row)
        return self._fallback(message_id, battery, time_s)

    def _beat(self, heartbeat: Any, frame: bytes, time_s: float) -> None:
        """Take the armed bit and the make of the autopilot, and then the integers that waited for its make."""
        says_armed = fields.is_armed(heartbeat)
        self._log.armed = says_armed or (self._said_armed and time_s - self._beat_s <= BEATING_S)
        self._said_armed, self._beat_s = says_armed, time_s
        self.is_px4 = heartbeat.autopilot == fields.AUTOPILOT_PX4
        self.route.take(time_s, fields.HEARTBEAT, heartbeat)
        self.words[b"heartbeat"] = frame
        unread, self._unread = self._unread, []
        for said, of_frame in unread:
            self._hear(said, of_frame)

    def _hear(self, message: Any, frame: bytes) -> None:
        if self.is_px4 is None and fields.is_integer(message):
            self._unread = [*self._unread[-MOST_PARAMETERS:], (message, frame)]
            return
        name, value = fields.parameter(message, self.is_px4 is True)
        self._take_statement(name, value, frame)

    def _take_statement(self, name: str, value: float, frame: bytes) -> None:
        """Process a statement of a parameter or of a pack; those that count about battery and flight are recorded."""
        if name not in self.parameters.known and len(self.parameters.known) >= MOST_PARAMETERS:
            return
        value = value if math.isfinite(value) else math.nan
        is_armed, beat_age_s = self._log.armed is True, self.now_s - self._beat_s
        sequence = framing.sequence(frame)
        counts = self.parameters.counts(name, value, sequence, is_armed=is_armed, beat_age_s=beat_age_s)
        if counts:
            self.route.builder.parameter(self.now_s, name, value)
        if counts and (name.startswith(BATTERY_NAMES) or name in NAMES):
            self.words[name.encode("latin-1")] = frame

    def _confirmed(self, row: LiveRow) -> list[LiveRow]:
        """Return the rows of BATTERY_STATUS that count from now on, and drop held rows of the same battery."""
        found = heard_twice(row, self.battery_ids, self._unconfirmed)
        if len(found) < 2:
            return found
        first, _ = found
        is_completed = first.sample.cell_voltages_V and not row.sample.cell_voltages_V
        self._held = [held for held in self._held if held.instance not in self.battery_ids and held.instance != 0]
        return [row] if is_completed else found  # the first row lacks the same cells

    def _fallback(self, message_id: int, battery: fields.BatteryFields, time_s: float) -> list[LiveRow]:
        """Return rows of SYS_STATUS or BATTERY2 once it is clear that no BATTERY_STATUS comes for the battery."""
        is_sys_status = message_id == fields.SYS_STATUS
        if is_sys_status:
            self.voltages.hear(battery.voltage_V, time_s)
            self._alone_s += min(time_s - self._sys_status_s, LONGEST_ALONE_S)
            self._sys_status_s = time_s
        if is_sys_status and self.battery_ids == {0} and self._alone_s > ALONE_AFTER_S:
            row = self._row(time_s, battery)
            return [] if row is None else [row]
        if self.battery_ids if is_sys_status else 1 in self.battery_ids:
            return []
        if self._first_s is None:
            self._first_s = time_s
        row = self._row(time_s, battery)
        found = [] if row is None else heard_twice(row, self._fallback_ids, self._unconfirmed_fallback)
        self._held += found[: MOST_HELD - len(self._held)]
        return self._released(time_s)

    def _released(self, time_s: float) -> list[LiveRow]:
        if self._first_s is None or time_s - self._first_s < FALLBACK_AFTER_S:
            return []
        released, self._held = self._held, []
        return released

    def _row(self, time_s: float, battery: fields.BatteryFields) -> LiveRow | None:
        """Return the row, cleaned by the rules of the log readers; None if they drop it."""
        sample = Sample(
            time_s=time_s,
            voltage_V=battery.voltage_V,
            current_A=battery.current_A,
            temp_C=battery.temp_C,
            consumed_Ah=battery.consumed_Ah,
            reported_soc=battery.reported_soc,
            armed=self._log.armed,
            cell_voltages_V=battery.cell_voltages_V,
        )
        if not self._log.add(battery.id, sample):
            self._without_voltage += not math.isfinite(battery.voltage_V)
            return None
        self._without_voltage = 0
        kept = self._log.rows[battery.id]
        del kept[:-1]
        del self._log.notes[:-10]
        self.speaks = self.speaks or time_s - self._spoke_s <= CONFIRMED_WITHIN_S
        self._spoke_s = time_s
        return LiveRow(battery.id, kept[-1])
