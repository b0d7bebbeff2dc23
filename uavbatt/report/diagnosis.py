"""The diagnosis page: what is wrong, how sure, what else it could be, what to check; the error before and after."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from uavbatt import __version__
from uavbatt.files import atomic_write
from uavbatt.report import plot
from uavbatt.report.page import (
    Html,
    bullets,
    details,
    element,
    figure,
    grid,
    number,
    page,
    paragraph,
    section,
    strong,
    table,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]
ANSWERS = {
    "no_missing_effect": ("good", "Nothing is missing: the battery file explains these records as well as it can."),
    "effect_found": ("bad", "Something is missing in the battery file, and it has a name."),
    "undeclared_effect": ("unsure", "Something is missing that none of the known effects explains."),
}
COLOURS = (plot.BLUE, plot.RED, plot.GREEN, plot.PINK, plot.AMBER, plot.SKY)


@dataclass(frozen=True, slots=True)
class Suspect:
    """One class of effects that the records cannot tell apart."""

    members: tuple[tuple[str, str, str], ...]  # name, meaning, what to check
    probability: float
    values: tuple[tuple[str, str, float, float, float, str], ...]  # quantity in words, its name, value, lo, hi, unit


@dataclass(frozen=True, slots=True)
class Track:
    """Residuals of one record, measured minus modelled: voltage [V] and temperature [K], before and after."""

    name: str
    time_s: Array
    before_V: Array
    after_V: Array
    before_K: Array
    after_K: Array


@dataclass(frozen=True, slots=True)
class DiagnosisPage:
    """All that the page says."""

    battery: str
    verdict: str
    suspects: tuple[Suspect, ...]
    doubts: tuple[str, ...]
    floor_V: float
    errors: tuple[tuple[str, float, float, str, int], ...]  # what, before, after, unit, decimals
    held_out: tuple[str, ...]
    tracks: tuple[Track, ...]
    changes: tuple[str, ...]  # lines of the battery file that differ, with + and -
    notes: tuple[str, ...] = ()


def write(path: Path, inputs: DiagnosisPage) -> None:
    """Write the page, whole or not at all."""
    with atomic_write(path, "w") as stream:
        stream.write(diagnosis_report(inputs))


def diagnosis_report(d: DiagnosisPage) -> str:
    """The whole page as HTML."""
    mood, answer = ANSWERS[d.verdict]
    return page(
        f"{d.battery}: what the battery file lacks",
        "uavbatt diagnose",
        element("div", paragraph(strong(answer)), *map(_suspect, d.suspects), css=f"answer {mood}"),
        *([section("Doubts", bullets(d.doubts))] if d.doubts else []),
        section("Error before and after", _errors(d)),
        section("Residuals, measured minus modelled", *_residuals(d)),
        section("Change of the battery file", *_changes(d)),
        *([section("Notes", bullets(d.notes))] if d.notes else []),
        footer=f"uavbatt {__version__}. A small residual after the fix proves little: do the check first.",
    )


def _suspect(s: Suspect) -> Html:
    (name, meaning, _), others = s.members[0], s.members[1:]
    rows = [
        (words, q, number(v, _decimals(v)), f"{number(lo, _decimals(v))} to {number(hi, _decimals(v))}", unit)
        for words, q, v, lo, hi, unit in s.values
    ]
    sure = f"The cause is {'among these' if others else 'this'} with a probability of {s.probability:.0%}."
    rivals = [paragraph("These records cannot tell it from:"), bullets(f"{m} ({n})" for n, m, _ in others)]
    return element(
        "div",
        paragraph(strong(f"{meaning[0].upper()}{meaning[1:]}"), f" ({name})."),
        *(rivals if others else []),
        paragraph(sure),
        paragraph(strong("What to check")),
        bullets(f"{c[0].upper()}{c[1:]} ({n})." for n, _, c in s.members),
        table(("if it is so", "quantity", "value", "95 % interval", "unit"), rows, text_columns=(0, 1, 4)),
    )


def _decimals(value: float) -> int:
    """Three significant digits."""
    size = abs(value)
    return 3 if size == 0.0 else int(np.clip(2 - np.floor(np.log10(size)), 0, 5))


def _errors(d: DiagnosisPage) -> Html:
    rows = [(what, number(b, n), number(a, n), unit) for what, b, a, unit, n in d.errors]
    caption = (
        f"Each of {len(d.held_out)} records predicted with the values that the others give; the battery's own model "
        f"leaves about {number(1000.0 * d.floor_V, 0, 'mV')}."
    )
    return table(("", "before", "after", "unit"), rows, caption, text_columns=(0, 3))


def _residuals(d: DiagnosisPage) -> list[Html]:
    out = [
        _panel(d, "Voltage before", "before_V", 1000.0, "mV"),
        _panel(d, "Voltage after", "after_V", 1000.0, "mV"),
    ]
    if any(np.isfinite(t.before_K).any() for t in d.tracks):
        out += [
            _panel(d, "Temperature before", "before_K", 1.0, "K"),
            _panel(d, "Temperature after", "after_K", 1.0, "K"),
        ]
    return [grid(*out)]


def _panel(d: DiagnosisPage, title: str, field: str, scale: float, unit: str) -> Html:
    both = [getattr(t, "before_" + field.split("_")[1]) for t in d.tracks]  # the same scale before and after
    reach = scale * max(float(np.nanpercentile(np.abs(b), 97)) if np.isfinite(b).any() else 0.0 for b in both) * 1.2
    limit = max(reach, 2.5 * scale * d.floor_V if unit == "mV" else 1.0)

    def draw(axes: Axes) -> None:
        if unit == "mV":
            axes.axhspan(-scale * d.floor_V, scale * d.floor_V, facecolor=plot.SHADE, linewidth=0, label="floor")
        axes.axhline(0.0, color=plot.INK, linewidth=0.7)
        for i, t in enumerate(d.tracks[:6]):
            colour = COLOURS[i % len(COLOURS)]
            axes.plot(t.time_s / 60.0, scale * getattr(t, field), color=colour, linewidth=1.0, label=t.name)
        axes.set_ylim(-limit, limit)

    alt = f"{title}: measured minus modelled against time, {len(d.tracks)} records"
    return figure(plot.panel(draw, alt, x="minutes", y=unit), title)


def _changes(d: DiagnosisPage) -> list[Html]:
    if not d.changes:
        return [paragraph("None.")]
    text = element("pre", "\n".join(d.changes))
    lines = [details(f"{len(d.changes)} lines", text) if len(d.changes) > 40 else text]
    if any(len(s.members) > 1 for s in d.suspects):
        lines.insert(0, paragraph("Where several causes are possible, the file takes the one that is named first."))
    return lines
