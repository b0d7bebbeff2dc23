"""F8: damage in a log is damage, whatever it redefines: one line of error or a log with notes, never a traceback."""

from __future__ import annotations

import math
import random
import struct
import warnings
from pathlib import Path

import pytest
from command import called

from uavbatt.errors import UavbattError
from uavbatt.telemetry.quality.info import describe, lines
from uavbatt.telemetry.read import read_bytes

ROOT = Path(__file__).parents[2]
LOGS = ("quad_3s.BIN", "quad_4s.tlog", "hexa_6s_cold.csv")
FORMAT_AT = b"\xa3\x95\x80"
ODD_BYTES = (b"\xff" * 8, b"\0" * 8, b"\x7f\xf0" * 4, b"\0\0\0\0\0\0\xf8\x7f", b"\xff\xff\x7f\x7f" * 2)
# Format characters by their size: a definition changed within a size leaves the length of its records as it was.
SIZES = ("bBM", "hHcCg", "iIfeELn", "dqQ")


def redefined(instance: float) -> bytes:
    """The log with a second definition of BAT in its middle, whose instance is a double, and twenty such records."""
    log = (ROOT / "logs/quad_3s.BIN").read_bytes()
    kind = log[log.index(b"BAT\0") - 2]
    labels = b"TimeUS,Inst,Volt,Curr"
    again = FORMAT_AT + struct.pack("<BB4s16s64s", kind, 3 + 24, b"BAT", b"Qdff", labels)
    rows = [struct.pack("<Qdff", 10_000_000_000 + k, instance, 12.0, 10.0) for k in range(20)]
    return log + again + b"".join(b"\xa3\x95" + bytes([kind]) + row for row in rows)


@pytest.mark.parametrize("instance", [1e19, -1e19, math.nan, math.inf, 256.0, -1.0, 0.5])
def test_an_impossible_instance_is_damage(instance: float, tmp_path: Path) -> None:
    (tmp_path / "f.BIN").write_bytes(redefined(instance))
    sound = called("info", ROOT / "logs/quad_3s.BIN", folder=tmp_path)
    told = called("info", "f.BIN", folder=tmp_path)
    assert told.returncode == 0 and "20 rows of an impossible battery instance dropped" in told.stdout
    assert told.stdout.splitlines()[1] == sound.stdout.splitlines()[1]


def test_a_log_with_impossible_instances_is_replayed(tmp_path: Path) -> None:
    (tmp_path / "f.BIN").write_bytes(redefined(1e19))
    flown = called("replay", "f.BIN", folder=tmp_path)
    assert flown.returncode == 0 and "impossible battery instance" in flown.stdout


def test_a_possible_instance_is_a_battery() -> None:
    assert read_bytes("f.BIN", redefined(255.0)).instances == (0, 255)


def mutated(data: bytes, dice: random.Random) -> bytes:
    """A damaged copy: bytes changed, cut, doubled; in a DataFlash log definitions too."""
    damaged = bytearray(data)
    for _ in range(dice.choice([1, 2, 5, 20, 100])):
        at = dice.randrange(len(damaged))
        match dice.randrange(6):
            case 0:
                damaged[at] = dice.randrange(256)
            case 1:
                del damaged[max(at, 200) : at + dice.randrange(1, 200)]
            case 2:
                piece = dice.randrange(len(damaged))
                damaged[at:at] = damaged[piece : piece + dice.randrange(1, 300)]
            case 3:
                damaged[at : at + 8] = dice.choice(ODD_BYTES)
            case 4:
                redefine(damaged, dice)
            case _:
                del damaged[max(at, 200) :]
    return bytes(damaged)


def redefine(log: bytearray, dice: random.Random) -> None:
    """Change the types and the order of the fields in one definition of a DataFlash log, if there is one."""
    found = log.find(FORMAT_AT, dice.randrange(min(len(log), 5000)))
    if found < 0 or found + 89 > len(log):
        return
    chars = bytes(log[found + 9 : found + 25])
    swapped = [next((dice.choice(same) for same in SIZES if chr(c) in same), chr(c)) for c in chars]
    log[found + 9 : found + 25] = "".join(swapped).encode("latin-1")
    labels = bytes(log[found + 25 : found + 89]).split(b"\0")[0].split(b",")
    dice.shuffle(labels)
    log[found + 25 : found + 89] = b",".join(labels)[:64].ljust(64, b"\0")


@pytest.mark.parametrize("name", LOGS)
def test_damaged_logs_raise_nothing_else(name: str) -> None:
    """Sixty damaged copies of each; thousands were read when this was written."""
    data, dice, read = (ROOT / "logs" / name).read_bytes(), random.Random(name), 0
    for _ in range(60):
        damaged = mutated(data, dice)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                flight = read_bytes(name, damaged)
            except UavbattError as error:
                assert "\n" not in str(error)
                continue
            assert all(line for line in lines(describe(flight)))
        read += 1
    assert read > 5
