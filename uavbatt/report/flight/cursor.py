"""The cursor that all drawings of a flight share: a slider, the values in words, and the script that moves it."""

from __future__ import annotations

import json
import math
from html import escape
from importlib import resources

import numpy as np

from uavbatt.report.flight.series import Array, FlightSeries
from uavbatt.report.page import Html

MOST_ROWS = 600
LABEL = "Instant of the flight; the values follow. Keys: + closer, − wider, 0 the whole flight"
BUTTONS = (("0.5", "Closer"), ("2", "Wider"), ("0", "Whole flight"))  # factor of the span that is shown


def cursor() -> Html:
    """Return the slider, the place for its words and the buttons that zoom; hidden until the script runs."""
    slider = f'<input type="range" min="0" value="0" aria-label="{escape(LABEL)}"/>'
    buttons = " ".join(f'<button type="button" value="{factor}">{words}</button>' for factor, words in BUTTONS)
    return Html(f'<p id="instant" hidden="hidden">{slider} <output></output> <span>{buttons}</span></p>')


def cursor_script(rows: FlightSeries) -> Html:
    """Return the rows as data and the script; `page` names the script in its policy."""
    script = (resources.files("uavbatt.report.flight") / "cursor.js").read_text("utf-8")
    data = json.dumps(_chosen_rows(rows), separators=(",", ":")).replace("<", "\\u003c").replace("&", "\\u0026")
    return Html(f'<script type="application/json" id="rows">{data}</script>\n<script>{script}</script>')


def _chosen_rows(rows: FlightSeries) -> dict[str, list[float | None]]:
    """Return at most MOST_ROWS of the known rows, evenly chosen; None is not known."""
    informative = np.flatnonzero(np.isfinite(rows.voltage_V) | np.isfinite(rows.remaining_s))
    chosen = informative[np.unique(np.linspace(0, informative.size - 1, min(informative.size, MOST_ROWS)).astype(int))]
    columns: dict[str, tuple[Array, int]] = {
        "time_s": (rows.time_s, 1), "remaining_s": (rows.remaining_s, 0), "lo_s": (rows.lo_s, 0),
        "hi_s": (rows.hi_s, 0), "charge": (100.0 * rows.soc, 1), "voltage_V": (rows.voltage_V, 2),
        "current_A": (rows.current_A, 1), "temp_C": (rows.temp_C, 1),
    }  # fmt: skip
    return {name: [_plain(float(v), n) for v in values[chosen]] for name, (values, n) in columns.items()}


def _plain(value: float, decimals: int) -> float | None:
    return round(value, decimals) if math.isfinite(value) else None
