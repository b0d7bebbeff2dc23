"""All batteries of the vehicle that is followed: estimator, last report and saved state of each.

row -> TrackedBattery -> Report
          |      ^
          v      |
saved state, written every few seconds, resumed at the first row of the same vehicle
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.errors import UavbattError
from uavbatt.live.config import Config
from uavbatt.live.log import tell
from uavbatt.live.memory import state
from uavbatt.live.memory.resumption import Resumption
from uavbatt.live.memory.saved import SavedBattery
from uavbatt.live.report import Report
from uavbatt.live.tracked_battery import TrackedBattery
from uavbatt.notice import Kind, Notice
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.prediction.pending import ALARM_S
from uavbatt.records import Estimate, PackFacts, Remaining, Status
from uavbatt.telemetry.link.live_row import LiveRow
from uavbatt.telemetry.link.reader import LiveReader
from uavbatt.telemetry.link.vehicle import Vehicle
from uavbatt.telemetry.parameters import BATTERY_NAMES
from uavbatt.telemetry.route.settings import NAMES

if TYPE_CHECKING:
    from uavbatt.live.memory.pack_keeper import PackKeeper

NOTE_S = 60.0
ONE_ENDS_SOON = Notice("by one of two senders less than two minutes may be left: land", Kind.MAY_END_SOON)


class Batteries:
    """Batteries takes the rows of one vehicle and gives a report of each battery.

    `clocks` reads all clocks at a monotonic time [s].
    """

    def __init__(
        self,
        config: Config,
        battery: BatteryFile,
        options: PackOptions,
        settings: ForecastSettings,
        reader: LiveReader,
        clocks: Callable[[float], state.Clock],
        now_s: float,
    ) -> None:
        self._config, self._battery, self._options, self._settings = config, battery, options, settings
        self._reader, self._clocks, self._start_s = reader, clocks, now_s
        self.reports: dict[int, Report] = {}
        self.tracked: dict[int, TrackedBattery] = {}
        self._put_by: dict[Vehicle | None, tuple[dict[int, TrackedBattery], dict[int, Report]]] = {}
        self._facts: dict[int, tuple[int, PackFacts]] = {}  # by the version of the parameters
        self._note_until_s = now_s + NOTE_S  # until then the notes say how the estimate began
        self._problem = ""
        self._resumption = self._read_resumption(now_s)
        self._keeper = self._open_ledger()

    def begin_vehicle(self) -> None:
        """Begin with the batteries of another vehicle, which is followed from now on.

        The batteries of the last vehicle are dropped, unless it is awaited: then they go on when it is heard again.
        """
        last, reader = (self.tracked, self.reports), self._reader
        self.tracked, self.reports = self._put_by.pop(reader.followed, ({}, {}))
        self._facts = {}
        self._put_by = {vehicle: kept for vehicle, kept in self._put_by.items() if vehicle is reader.following.awaited}
        if reader.following.awaited is not None:
            self._put_by.setdefault(reader.following.awaited, last)
        if self._keeper is not None:
            self._keeper.begin_vehicle()

    def look_at_vehicle(self) -> None:
        """Drop a resumed state if the serial number of the vehicle, heard later, shows that the state is of another."""
        if self._resumption.is_contradicted(self._vehicle):
            self.tracked.clear()
            self._reader.forget_resumed()

    def step(self, row: LiveRow, vehicle: Vehicle, now_s: float) -> Report:
        """Take one row of the followed vehicle through the estimator of its battery; return the report.

        now_s : on the monotonic clock [s]
        """
        tracked = self._battery_of(row.instance, now_s)
        if self._reader.following.awaited is None:  # else these are another crew's packs
            self._meet_pack(row, vehicle, now_s)
        estimate, remaining = self._estimate(tracked, row, vehicle, now_s)
        self._log_pack(row.instance, tracked, remaining)
        report = self._report(tracked, row, vehicle, now_s, estimate, remaining)
        self.reports[row.instance] = report
        return report

    def _estimate(
        self, tracked: TrackedBattery, row: LiveRow, vehicle: Vehicle, now_s: float
    ) -> tuple[Estimate, Remaining]:
        """Return estimate and remaining time after a row; refused if two senders speak for the battery."""
        gap_s = now_s - self._start_s + self._resumption.age_s
        facts = self._facts_of(row.instance, vehicle)
        estimate, remaining = tracked.step(row.sample, facts, gap_s, self._reader.navigation)
        conflict = self._reader.conflict(row.instance)
        if not conflict:
            return estimate, remaining
        why = Notice(f"two senders speak for this battery: {conflict}", Kind.TWO_SENDERS)
        if row.sample.armed is not False and remaining.remaining_alarm_s <= ALARM_S:  # the other may be right
            estimate = replace(estimate, warnings=(*estimate.warnings, ONE_ENDS_SOON))
        return _refused(estimate, remaining, why)

    def _log_pack(self, instance: int, tracked: TrackedBattery, remaining: Remaining) -> None:
        """Log the size of the pack when it becomes known or changes, or once why there is no estimate yet."""
        before, resolved = self.reports.get(instance), tracked.estimator.pack_size
        if resolved is not None and (before is None or before.cells != resolved.cells):
            tell(f"battery {instance}: {resolved.words}")
        elif resolved is None and before is None:
            tell(f"battery {instance}: no estimate yet: {remaining.reason}")

    def _report(
        self,
        tracked: TrackedBattery,
        row: LiveRow,
        vehicle: Vehicle,
        now_s: float,
        estimate: Estimate,
        remaining: Remaining,
    ) -> Report:
        """Return the report of a battery after a row; before take-off with the endurance."""
        before, resolved = self.reports.get(row.instance), tracked.estimator.pack_size
        flying_s, flown = row.sample.time_s - tracked.estimator.flying_since_s, tracked.flight_so_far
        report = Report(
            instance=row.instance,
            system=vehicle.system,
            component=vehicle.component,
            estimate=estimate,
            remaining=remaining,
            received_s=now_s,
            rows=before.rows + 1 if before is not None else 1,
            cells=resolved.cells if resolved is not None else 0,
            battery=self._battery.battery.name,
            certificate=self._battery.status,
            flying_since_s=now_s - flying_s,
            flown_J=flown.flown_J,
            flown_s=flown.flown_s,
        )
        return replace(report, endurance=tracked.endurance(row.sample.time_s)) if report.is_waiting else report

    def _battery_of(self, instance: int, now_s: float) -> TrackedBattery:
        """Return the battery of this instance; a new one begins from its saved state, if there is one."""
        if not self.tracked:
            self._reader.resume(*self._resumption.meet(self._vehicle))
        if instance not in self.tracked:
            saved, limit_s = self._resumption.of(instance), self._config.state.max_age_s
            self.tracked[instance] = TrackedBattery(self._battery, self._options, self._settings, saved, limit_s)
            self._note_until_s = now_s + NOTE_S
        return self.tracked[instance]

    def notes(self, now_s: float) -> list[str]:
        """Return notes for the operator about the saved state and the pack ledger."""
        found = [self._problem, self._keeper.note if self._keeper is not None else ""]
        if now_s <= self._note_until_s:
            found += [self._resumption.note]
            found += [f"battery {i}: {t.resumed}" for i, t in sorted(self.tracked.items()) if t.resumed]
        return [note for note in found if note]

    def close(self, now_s: float) -> None:
        """Save the state, and close the pack ledger."""
        self.save(now_s)
        if self._keeper is not None:
            self._keeper.close(now_s)

    def save(self, now_s: float) -> None:
        """Save the state that the next process may resume, if a file is configured and there is a state."""
        if self._keeper is not None:
            self._keeper.look_after(now_s)
        path = self._config.state.file
        is_own = self._reader.following.awaited is None  # else the state in the file belongs to the awaited vehicle
        batteries = self._resumable(now_s) if path and is_own else {}
        if not batteries:
            return
        known, vehicle = self._reader.parameters.items(), self._reader.followed
        content = state.SavedState(
            battery_sha256=self._battery.certificate.content_sha256,
            link=self._config.link.endpoint,
            vehicle=self._vehicle,
            parameters={n: v for n, v in known if _is_worth_keeping(n) and math.isfinite(v)},
            told=vehicle.told if vehicle is not None else b"",
            batteries=batteries,
        )
        try:
            state.write_state(Path(path), content, self._clocks(now_s))
            problem = ""
        except (OSError, UavbattError) as error:
            problem = f"state not saved: {error}"
        if problem not in ("", self._problem):
            tell(problem)
        self._problem = problem

    @property
    def _vehicle(self) -> state.SavedVehicle:
        """Return the identity of the vehicle whose batteries are estimated, as far as it is known."""
        vehicle = self._reader.followed
        if vehicle is None:
            return state.SavedVehicle(system=0, component=0)
        return state.SavedVehicle(system=vehicle.system, component=vehicle.component, hardware=vehicle.hardware)

    def _resumable(self, now_s: float) -> dict[str, SavedBattery]:
        """Return the batteries that the next process may resume: those whose last row is not too old."""
        waited_s = self._resumption.age_s + now_s - self._start_s
        left = self._resumption.left(self._vehicle).items()
        silent = {key: replace(saved, since_row_s=saved.since_row_s + waited_s) for key, saved in left}
        vehicle, tracked = self._reader.followed, self.tracked.items()
        known = {i: t.saved(self._facts_of(i, vehicle)) for i, t in tracked} if vehicle is not None else {}
        heard = {
            str(i): replace(saved, since_row_s=saved.since_row_s + self.reports[i].silent_s(now_s))
            for i, saved in known.items()
            if saved is not None
        }
        every = {**silent, **heard}
        return {key: saved for key, saved in every.items() if saved.since_row_s <= self._config.state.max_age_s}

    def _open_ledger(self) -> PackKeeper | None:
        packs = self._config.packs
        if not packs.file:
            return None
        from uavbatt.live.memory.pack_keeper import PackKeeper  # 4 MB that a flight without a ledger does not need

        return PackKeeper(Path(packs.file), packs.name, self._battery, self._options, self._utc_s)

    def _utc_s(self, now_s: float) -> float:
        """Return the seconds since 1970 at a monotonic time [s]; NaN while the clock is not set."""
        clock = self._clocks(now_s)
        return clock.wall_s if clock.is_clock_set else math.nan

    def _meet_pack(self, row: LiveRow, vehicle: Vehicle, now_s: float) -> None:
        """Tell the estimate on the ground which pack this is; with a ledger also its health, and the ledger the row."""
        tracked, said, keeper = self.tracked[row.instance], vehicle.pack(row.instance), self._keeper
        is_open = tracked.is_open_to_memory(row.sample.armed)
        if keeper is None:
            if said.serial and is_open:
                tracked.remember(said.serial, None)
            return
        known = keeper.meet(row.instance, said.serial, said.cycles, now_s)
        if known is not None and known.done() and is_open:
            tracked.remember(self._config.packs.name or said.serial, known.result())
        resolved = tracked.estimator.pack_size
        if resolved is not None:
            keeper.step(row.instance, row.sample, now_s, resolved.cells, resolved.rated_Ah)

    def _read_resumption(self, now_s: float) -> Resumption:
        """Return the state that an earlier process has left for this one."""
        if not self._config.state.file:
            return Resumption(state.FoundState(None, 0.0, ""))
        found = state.read_state(
            Path(self._config.state.file),
            SavedBattery,
            self._clocks(now_s),
            max_age_s=self._config.state.max_age_s,
            battery_sha256=self._battery.certificate.content_sha256,
            link=self._config.link.endpoint,
        )
        return Resumption(found)

    def _facts_of(self, instance: int, vehicle: Vehicle) -> PackFacts:
        """Return what the followed vehicle has stated of a battery; it is read anew when its parameters change."""
        version, facts = self._facts.get(instance, (-1, PackFacts()))
        if version != vehicle.parameters.version:
            version, facts = self._facts[instance] = vehicle.parameters.version, vehicle.facts(instance)
        return facts


def _is_worth_keeping(parameter: str) -> bool:
    """Return True if a parameter says what pack this is, or how the vehicle flies and returns."""
    return parameter.startswith(BATTERY_NAMES) or parameter in NAMES


def _refused(estimate: Estimate, remaining: Remaining, reason: Notice) -> tuple[Estimate, Remaining]:
    """Return the estimate and the remaining time as refused for this reason."""
    status = Status.REFUSED
    return replace(estimate, status=status, reason=reason), replace(remaining, status=status, reason=reason)
