"""Everything that the companion process sends, and to whom.

Only messages that `mavlink.originated` lists go to the autopilot; behind the proxy the heartbeat goes there only if
requests are allowed. Everything else goes to the ground-station endpoints only.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from uavbatt.live.config import Config
from uavbatt.live.feeds.announced import WITHOUT_AFTER_S, Announcer
from uavbatt.live.feeds.battery_component import BatteryFeed
from uavbatt.live.feeds.named import NamedFeed
from uavbatt.live.feeds.proxy_client import ProxyClient
from uavbatt.live.headline import takes_alarms
from uavbatt.live.report import Report
from uavbatt.live.requests.mission import MissionRequest
from uavbatt.live.requests.parameters import Requests, parameter_names
from uavbatt.live.requests.streams import StreamRequests
from uavbatt.mavlink.endpoint import Link
from uavbatt.mavlink.framing import header
from uavbatt.mavlink.originated import may_reach_autopilot
from uavbatt.mavlink.outgoing import BATTERY, SEVERITY_CRITICAL, SEVERITY_WARNING, Outgoing
from uavbatt.navigation import Mode, Navigation
from uavbatt.telemetry.link.reader import LiveReader
from uavbatt.telemetry.link.vehicle import Vehicle
from uavbatt.telemetry.link.vehicle_choice import VehicleChoice
from uavbatt.telemetry.route.settings import names_to_ask

ANNOUNCE_PERIOD_S = 0.25
NO_READINGS = "No battery readings: time unknown"
MOST_SAID = 8  # announcements that are kept for the page


class Sender:
    """Sender sends heartbeats, feeds and requests when they are due."""

    def __init__(self, config: Config, link: Link, stations: Sequence[Link], key: bytes | None) -> None:
        self._config, self._link, self._stations = config, link, stations
        self._named = NamedFeed(config.feed.named_rate_Hz)
        self._component = BatteryFeed(config.feed.battery_rate_Hz)
        self.requests = Requests(config.link.request_rate_Hz)
        self._mission, self._streams = MissionRequest(), StreamRequests()
        self._key = key
        self._outs: dict[tuple[int, int], Outgoing] = {}
        self._announcers: dict[int, Announcer] = {}
        self._beat_s = self._look_s = float("-inf")
        self._without_since_s = math.nan  # armed without any battery; infinite once that was said in this flight
        self._system: int | None = None  # the followed vehicle's
        self.announcements: deque[tuple[float, str]] = deque(maxlen=MOST_SAID)  # (time [s], text)

    def send(self, now_s: float, reports: Sequence[Report], reader: LiveReader) -> None:
        """Send all that is due at `now_s` on the monotonic clock [s]."""
        link, vehicle = self._config.link, reader.followed
        system = (vehicle.system if vehicle is not None else link.system) or 1
        own = self._out(system, link.own_component)
        to_gcs, to_autopilot = self._heartbeats(now_s, own)
        if vehicle is not None:
            navigation, has_mission = reader.navigation, reader.planned is not None
            to_gcs += self._feeds(now_s, reports, vehicle, navigation, own)
            to_autopilot += self._asked(now_s, vehicle, navigation, own, has_mission=has_mission)
        for frame in to_autopilot:
            if may_reach_autopilot(header(frame).message_id, link.request, link.request_mission):
                self._link.write(frame, now_s)
        for frame in to_gcs:
            self._to_gcs(frame, now_s)

    def _heartbeats(self, now_s: float, own: Outgoing) -> tuple[list[bytes], list[bytes]]:
        """Return the heartbeats that are due, for the ground stations and for the autopilot."""
        link = self._config.link
        if now_s < self._beat_s:
            return [], []
        self._beat_s = now_s + 1.0
        may_go_up = link.request or link.request_mission or not isinstance(self._link, ProxyClient)
        return (
            [own.heartbeat()] if "named" in self._config.feed.kinds else [],
            [own.heartbeat()] if may_go_up else [],
        )

    def _feeds(
        self, now_s: float, reports: Sequence[Report], vehicle: Vehicle, navigation: Navigation, own: Outgoing
    ) -> list[bytes]:
        """Return the frames about the batteries that are due: named values, announcements, battery component."""
        kinds = self._config.feed.kinds
        texts = self._announced(now_s, reports, vehicle, navigation)  # also for the page
        made: list[bytes] = []
        if "named" in kinds:
            made += self._named.frames(now_s, reports, own)
            made += [own.text(*text) for text in texts]
        if "battery" in kinds:
            out = self._out(vehicle.system or 1, BATTERY)
            made += self._component.frames(now_s, reports, vehicle.battery_ids, out)
        return made

    def _asked(
        self, now_s: float, vehicle: Vehicle, navigation: Navigation, own: Outgoing, *, has_mission: bool
    ) -> list[bytes]:
        """Return the requests to the autopilot that are due, as far as the operator allows them."""
        component, known, link = vehicle.component or 1, vehicle.parameters, self._config.link
        made: list[bytes] = []
        if link.request:
            is_px4, is_copter = vehicle.is_px4 is True, navigation.mode is not Mode.UNKNOWN
            names = parameter_names(vehicle.battery_ids, is_px4)
            if is_copter:
                made += self._streams.frames(now_s, vehicle.now_s, navigation, is_px4, component, own)
            if is_copter and navigation.has_way:
                names += names_to_ask(known.known, is_px4)
            made += self.requests.again(now_s, component, known.doubted, own)
            made += self.requests.frames(now_s, component, known.known, names, own)
        if link.request_mission and not has_mission:
            made += self._mission.frames(now_s, vehicle.now_s, vehicle.route, component, own)
        return made

    def begin_vehicle(self, now_s: float, following: VehicleChoice) -> None:
        """Drop the requests and announcements of the last vehicle, as another one is followed from now on.

        The change is announced with the system ids of both, as a ground station may show only one of them; `now_s` is
        monotonic [s].
        """
        before, self._system = self._system, following.vehicle.system if following.vehicle is not None else None
        if words := following.words:
            self.announcements.append((now_s, words))
            if "named" in self._config.feed.kinds:
                outs = [
                    self._out(system, self._config.link.own_component) for system in (before, self._system) if system
                ]
                for frame in (*self._named.ended(now_s, outs[0]), *(o.text(SEVERITY_CRITICAL, words) for o in outs)):
                    self._to_gcs(frame, now_s)
        self._announcers.clear()
        self.requests.begin_again()
        self._mission, self._streams = MissionRequest(), StreamRequests()

    def _announced(
        self, now_s: float, reports: Sequence[Report], vehicle: Vehicle, navigation: Navigation
    ) -> list[tuple[int, str]]:
        """Return the announcements that are due now."""
        if now_s < self._look_s:
            return []
        self._look_s = now_s + ANNOUNCE_PERIOD_S
        is_airborne = navigation.is_aloft(vehicle.now_s)
        made = self._without_battery(now_s, vehicle, reports)
        again: list[tuple[int, str]] = []
        for report in reports:
            announcer = self._announcers.get(report.instance)
            if announcer is None:
                announcer = self._announcers[report.instance] = Announcer(report.instance, self._config.feed.alarms_s)
            is_first = report is reports[0] or takes_alarms(report, reports[0], now_s)
            made += announcer.texts(now_s, report, vehicle.armed, is_airborne, is_first)
            again += announcer.repeats(now_s, report, is_first)
        self.announcements.extend((now_s, text) for _, text in made)  # the page keeps all of them
        return made + again

    def _without_battery(self, now_s: float, vehicle: Vehicle, reports: Sequence[Report]) -> list[tuple[int, str]]:
        """Return, once a flight, that an armed vehicle has told of no battery so far."""
        if reports or vehicle.armed is not True:
            self._without_since_s = math.nan
            return []
        if math.isnan(self._without_since_s):
            self._without_since_s = now_s
        if now_s - self._without_since_s < WITHOUT_AFTER_S:
            return []
        self._without_since_s = math.inf
        return [(SEVERITY_WARNING, NO_READINGS)]

    def _to_gcs(self, frame: bytes, now_s: float) -> None:
        if isinstance(self._link, ProxyClient):
            self._link.to_gcs(frame)
        for station in self._stations:
            station.write(frame, now_s)

    def _out(self, system: int, component: int) -> Outgoing:
        """Return the packer of our frames of a system and component, made at the first use."""
        if (system, component) not in self._outs:
            self._outs[system, component] = Outgoing(system, component, self._key)
        return self._outs[system, component]
