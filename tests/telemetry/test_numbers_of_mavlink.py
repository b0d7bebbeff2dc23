"""Numbers of commands, modes and vehicles against pymavlink's own tables: a wrong one would make a route wrong."""

from __future__ import annotations

import importlib
import pkgutil
from types import SimpleNamespace

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as dialect

import uavbatt
from uavbatt.navigation import Action, Mode
from uavbatt.telemetry.formats import tlog_route
from uavbatt.telemetry.route.commands import Fields, mission_item
from uavbatt.telemetry.route.modes import copter_mode, copter_mode_named, mode_of

COMMANDS = {number: entry.name for number, entry in dialect.enums["MAV_CMD"].items()}
UNDERSTOOD = {
    "NAV_WAYPOINT": Action.WAYPOINT, "NAV_LOITER_UNLIM": Action.LOITER_UNLIMITED,
    "NAV_LOITER_TURNS": Action.LOITER_TURNS, "NAV_LOITER_TIME": Action.LOITER_TIME,
    "NAV_RETURN_TO_LAUNCH": Action.RETURN, "NAV_LAND": Action.LAND, "NAV_TAKEOFF": Action.TAKEOFF,
    "NAV_SPLINE_WAYPOINT": Action.SPLINE, "NAV_DELAY": Action.DELAY, "DO_JUMP": Action.JUMP,
    "DO_CHANGE_SPEED": Action.SPEED, "NAV_PAYLOAD_PLACE": Action.PLACE,
    "NAV_LOITER_TO_ALT": Action.LOITER_TO_HEIGHT,
}  # fmt: skip
# Commands that do something else than to move a multirotor or to wait.
QUIET = (
    "ROI", "CONDITION_DELAY", "CONDITION_DISTANCE", "CONDITION_YAW", "RELAY", "SERVO", "ACTUATOR", "START", "VIDEO",
    "DIGICAM", "MOUNT", "CAM_TRIGG", "FENCE", "PARACHUTE", "GRIPPER", "AUTOTUNE", "RESUME_REPEAT", "SPRAYER", "SCRIPT",
    "CAMERA", "STORAGE", "JUMP_TAG", "GIMBAL", "CAPTURE", "TRIGGER", "WINCH",
)  # fmt: skip
WORDS = {
    "TAKEOFF_LOCAL": "a local take-off", "LAND_LOCAL": "a local landing", "NAV_FOLLOW": "following",
    "CHANGE_ALT": "a change of height", "DO_ORBIT": "an orbit",
    "ARC_WAYPOINT": "an arc", "ALTITUDE_WAIT": "waiting for a height", "VTOL_TAKEOFF": "a VTOL take-off",
    "VTOL_LAND": "a VTOL landing", "GUIDED_ENABLE": "guidance by another computer",
    "SET_MODE": "a change of mode", "SET_HOME": "a new home",
    "RALLY_LAND": "a landing at a rally point", "GO_AROUND": "going around", "REPOSITION": "a new place",
    "PAUSE_CONTINUE": "a pause", "DO_JUMP_TAG": "a jump to a tag", "VTOL_TRANSITION": "a VTOL transition",
    "SCRIPT_TIME": "a script",
}  # fmt: skip


def action_of(number: int) -> Action:
    return mission_item(Fields(1, 3, number, 1.0, 1.0, 0.0, 0.0, 47.0, 8.0, 30.0)).action


@pytest.mark.parametrize(("name", "action"), UNDERSTOOD.items())
def test_a_command_that_is_understood_has_its_number(name: str, action: Action) -> None:
    assert action_of(getattr(dialect, f"MAV_CMD_{name}")) is action


def test_no_other_command_is_taken_for_one_that_is_understood() -> None:
    others = {number for number, name in COMMANDS.items() if name.removeprefix("MAV_CMD_") not in UNDERSTOOD}
    assert {action_of(number) for number in others} == {Action.OTHER, Action.UNKNOWN}


def test_only_commands_that_move_nothing_are_passed_over() -> None:
    passed = [COMMANDS[number] for number in COMMANDS if action_of(number) is Action.OTHER]
    assert [name for name in passed if not any(word in name for word in QUIET)] == []
    assert [name for name in passed if name.startswith("MAV_CMD_NAV_")] == ["MAV_CMD_NAV_ROI"]
    assert len(passed) > 40  # the usual ones of cameras, gimbals and servos are among them


@pytest.mark.parametrize(("part", "words"), WORDS.items())
def test_a_command_that_is_not_understood_is_named_in_words(part: str, words: str) -> None:
    named = [number for number, name in COMMANDS.items() if part in name]
    if not named:
        pytest.skip(f"this pymavlink knows no {part}")  # 2.4.40, the oldest allowed, lacks two of them
    numbers = [number for number in named if action_of(number) is Action.UNKNOWN]
    told = {mission_item(Fields(1, 3, number, 0.0, 0.0, 0.0, 0.0, 47.0, 8.0, 30.0)).reason for number in numbers}
    assert any(reason.startswith(f"{words} is not understood") for reason in told)


def test_a_parachute_that_is_released_ends_the_route_and_one_that_is_armed_does_not() -> None:
    armed, released = (
        mission_item(Fields(1, 3, dialect.MAV_CMD_DO_PARACHUTE, param1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)).action
        for param1 in (1.0, 2.0)
    )
    assert (armed, released) == (Action.OTHER, Action.UNKNOWN)


def test_the_modes_of_arducopter_are_those_of_pymavlink() -> None:
    """Two of them no firmware has had since 2013, and their numbers are free."""
    named = {number: name for number, name in mavutil.mode_mapping_acm.items() if name not in ("POSITION", "OF_LOITER")}
    assert all(copter_mode_named(name) is copter_mode(number) is not Mode.UNKNOWN for number, name in named.items())


def test_the_modes_of_px4_are_those_of_pymavlink() -> None:
    flown = {"MISSION": Mode.MISSION, "RTL": Mode.RETURN, "LAND": Mode.LAND, "LOITER": Mode.HOLD,
             "MANUAL": Mode.MANUAL, "TAKEOFF": Mode.TAKEOFF, "POSCTL": Mode.MANUAL, "ALTCTL": Mode.MANUAL,
             "OFFBOARD": Mode.MANUAL}  # fmt: skip
    for name, mode in flown.items():
        _, main, of_auto = mavutil.px4_map[name]
        said = SimpleNamespace(
            type=dialect.MAV_TYPE_QUADROTOR,
            autopilot=dialect.MAV_AUTOPILOT_PX4,
            custom_mode=main << 16 | of_auto << 24,
        )
        assert mode_of(said) is mode, name


def test_the_vehicles_whose_modes_are_known_are_those_with_rotors() -> None:
    """A generic multirotor was none: its route was never used."""
    rotors = ("QUADROTOR", "COAXIAL", "HELICOPTER", "HEXAROTOR", "OCTOROTOR", "TRICOPTER", "DODECAROTOR", "DECAROTOR",
              "GENERIC_MULTIROTOR")  # fmt: skip
    types = {number: entry.name.removeprefix("MAV_TYPE_") for number, entry in dialect.enums["MAV_TYPE"].items()}
    for number, name in types.items():
        said = SimpleNamespace(type=number, autopilot=dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, custom_mode=3)
        if name != "ENUM_END":  # its number is that of the next one
            assert (mode_of(said) is Mode.MISSION) is (name in rotors), name


def test_each_constant_that_is_named_as_a_message_has_its_number() -> None:
    found = 0
    for part in pkgutil.walk_packages(uavbatt.__path__, "uavbatt."):
        if part.name.startswith(("uavbatt.telemetry", "uavbatt.mavlink", "uavbatt.live", "uavbatt.simulate")):
            for name, value in vars(importlib.import_module(part.name)).items():
                number = getattr(dialect, f"MAVLINK_MSG_ID_{name.lstrip('_')}", None)
                if isinstance(value, int) and number is not None and number >= 0:
                    found += 1
                    assert value == number, f"{part.name}.{name}"
    assert found > 30


SIZES = {"int8_t": 1, "uint8_t": 1, "char": 1, "int16_t": 2, "uint16_t": 2, "int32_t": 4, "uint32_t": 4, "float": 4,
         "int64_t": 8, "uint64_t": 8, "double": 8}  # fmt: skip
KINDS = {"i": "int", "u": "uint", "f": "float"}


def on_the_wire(message_id: int) -> dict[str, tuple[int, str]]:
    """Offset and type of each field of a message, by the order in which pymavlink packs them."""
    message, found, offset = dialect.mavlink_map[message_id], dict[str, tuple[int, str]](), 0
    type_of = dict(zip(message.fieldnames, message.fieldtypes, strict=True))
    for name, length in zip(message.ordered_fieldnames, message.array_lengths, strict=True):
        found[name] = (offset, type_of[name])
        offset += SIZES[type_of[name]] * max(length, 1)
    return found


@pytest.mark.parametrize("message_id", tlog_route.LAYOUTS)
def test_the_fields_of_a_log_lie_where_pymavlink_puts_them(message_id: int) -> None:
    layout, expected = tlog_route.LAYOUTS[message_id], on_the_wire(message_id)
    assert layout.fields is not None
    newer = {"mission_id"}  # an extension that came after some releases of pymavlink
    for name in layout.fields.keys() - (newer - expected.keys()):
        kind, offset = layout.fields[name][:2]
        assert (offset, f"{KINDS[kind.kind]}{'' if kind.kind == 'f' else f'{8 * kind.itemsize}_t'}") == expected[name]
