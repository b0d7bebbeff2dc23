"""The saved state: written whole or not at all every few seconds, read once at the start.

    {"version", "boot_id", "monotonic_s", "wall_s", "battery_sha256", "parameters": {...}, "batteries": {id: {...}}}

Its age is told by the monotonic clock within one boot, by the wall clock across boots. What is damaged, too old or
made for another battery file is not resumed, and the reason is said.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from uavbatt.aside import written_aside

VERSION = 2
BOOT_ID = Path("/proc/sys/kernel/random/boot_id")

Saved = dict[str, Any]


def boot_id() -> str:
    """An identity of this boot of the computer; empty when it has none."""
    try:
        return BOOT_ID.read_text(encoding="ascii").strip()
    except OSError:
        return ""


def write(path: Path, content: Mapping[str, Any], monotonic_s: float, wall_s: float) -> None:
    """Save atomically. Raises OSError or UavbattError when the disk does not take it."""
    head = {"version": VERSION, "boot_id": boot_id(), "monotonic_s": monotonic_s, "wall_s": wall_s}
    with written_aside(path) as file:
        json.dump({**head, **content}, file, allow_nan=True)


def read(path: Path, monotonic_s: float, wall_s: float, max_age_s: float, battery_sha256: str) -> tuple[Saved, str]:
    """(state with its `age_s`, "") or ({}, the reason why there is none)."""
    try:
        saved = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(saved, dict) or saved.get("version") != VERSION:
            return {}, "saved state is of another version"
        same_boot = saved["boot_id"] != "" and saved["boot_id"] == boot_id()
        age_s = monotonic_s - saved["monotonic_s"] if same_boot else wall_s - saved["wall_s"]
        if saved["battery_sha256"] != battery_sha256:
            return {}, "saved state is of another battery file"
        if not 0.0 <= age_s <= max_age_s:
            return {}, f"saved state is {age_s:.0f} s old"
        return {**saved, "age_s": float(age_s)}, ""
    except FileNotFoundError:
        return {}, "no saved state"
    except (OSError, ValueError, KeyError, TypeError) as error:
        return {}, f"saved state cannot be read: {error}"
