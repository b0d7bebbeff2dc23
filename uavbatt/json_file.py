"""Values as JSON, and JSON files: unknown (NaN, infinity) is null, and a file is there whole or not at all."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from uavbatt.aside import written_aside
from uavbatt.printable import printable

_FOREIGN = re.compile("[\x7f-\U0010ffff]")  # of what JSON does not escape by itself


def plain(value: Any) -> Any:
    """Dataclasses, arrays and mappings as dicts, lists and numbers; NaN and infinity as None.

    Keys that are numbers (ambient temperatures) become their shortest text.
    """
    if isinstance(value, msgspec.Struct):
        return plain(msgspec.to_builtins(value))
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {key if isinstance(key, str) else f"{key:g}": plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def write_json(path: Path, content: Any, indent: int = 2) -> None:
    """Write `content`, made `plain`, to `path`."""
    with written_aside(path, "w") as stream:
        stream.write(_escaped(json.dumps(plain(content), indent=indent, ensure_ascii=False)) + "\n")


def _escaped(text: str) -> str:
    """JSON whose foreign texts reach neither a terminal as commands nor the encoder as halves of characters."""
    return _FOREIGN.sub(lambda found: found[0] if printable(found[0]) == found[0] else json.dumps(found[0])[1:-1], text)
