"""The diagnosis page: the missing effect, its probability, its rivals, what to check, and the error before and
after."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import tomli_w
from numpy.typing import NDArray

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.effects import unit_words
from uavbatt.diagnosis.classes import EffectClass
from uavbatt.diagnosis.close import ClosedLoop
from uavbatt.diagnosis.diagnosis import Diagnosis
from uavbatt.diagnosis.refit.residual import Residual
from uavbatt.diagnosis.search.blocks import EvidenceBlock
from uavbatt.diagnosis.words import CHECK, GUESS, MEANING, QUANTITY, SHARES
from uavbatt.files import without_none
from uavbatt.report import plot
from uavbatt.report.page import (
    Html,
    answer,
    bullets,
    details,
    element,
    figure,
    grid,
    number,
    page,
    paragraph,
    percent,
    scrolled,
    section,
    sentence,
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
TOGETHER = "Several things are missing in the battery file together, and they have names."
MAY_HIDE = "If something small is missing all the same, it is most likely this, and no larger than the interval says:"
ROOM_FOR_NAMES = 120.0  # px on the left of the bars: the longest name of a block
COLOURS = (plot.BLUE, plot.RED, plot.GREEN, plot.PINK, plot.AMBER, plot.SKY)


def diagnosis_report(diagnosis: Diagnosis, closed: ClosedLoop, old: BatteryFile, new: BatteryFile) -> str:
    """Return the whole page as HTML.

    closed : errors on held-out records before and after the diagnosis; old, new : the battery file before and after
    """
    mood, words = ANSWERS[diagnosis.verdict]
    several = len(diagnosis.classes) > 1
    words = TOGETHER if several and diagnosis.verdict == "effect_found" else words
    may_hide = paragraph(MAY_HIDE if diagnosis.may_hide else "")
    return page(
        f"{old.battery.name}: what the battery file lacks",
        "uavbatt diagnose",
        answer(paragraph(strong(words)), may_hide, *(_suspect(c, several) for c in diagnosis.classes), mood=mood),
        section("Doubts", bullets(diagnosis.reasons)),
        *([section("Where the evidence lies", evidence_figure(diagnosis.blocks))] if diagnosis.blocks else []),
        section("Error before and after", _errors(closed, diagnosis.floor_V), _worse(closed)),
        section("Residuals, measured minus modelled", *_residuals(diagnosis)),
        section("Change of the battery file", *_changes(diagnosis, difference(old, new))),
        section("Notes", bullets(_notes(diagnosis, old))),
        footer="A small residual after the fix proves little: do the check first.",
    )


def _notes(diagnosis: Diagnosis, old: BatteryFile) -> list[str]:
    notes = []
    if not diagnosis.problem.evidence.has_temperature:
        notes.append("No temperature was measured: only clear effects are told, and none that shows only in it.")
    if diagnosis.guess_below_soc is not None:
        notes.append(f"{sentence(GUESS.format(diagnosis.guess_below_soc))}.")
    if old.status == "edited":
        notes.append(f"The {old.caveat}.")
    if diagnosis.hidden:
        bounds = (f"{h.name} {h.lo:.3g} to {h.hi:.3g} {unit_words(h.unit)}".rstrip() for h in diagnosis.hidden)
        notes.append(f"Sizes that could be hidden in these records (95 %): {'; '.join(bounds)}.")
    return notes


def _suspect(one: EffectClass, several: bool) -> Html:
    """Return the part on one class of effects; `several`: other classes have been found too."""
    rows = []
    for quantity, i in one.parameters.items():
        scale, unit = (100.0, "%") if quantity in SHARES else (1.0, unit_words(i.unit))
        decimals = _decimals(scale * (i.hi - i.lo) / 2.0)
        value, lo, hi = (number(scale * v, decimals) for v in (i.value, i.lo, i.hi))
        rows.append((QUANTITY.get(quantity, quantity), value, f"{lo} to {hi}", unit, quantity))
    cause, these = "One cause" if several else "The cause", "among these" if one.members[1:] else "this"
    sure = f"{cause} is {these} with a probability of {percent(one.probability)}."
    head = ("if it is so", "value", "95 % interval", "unit", "in the file")
    return element("div", *suspect(one.members, "", sure, "records"), table(head, rows, text_columns=(0, 3, 4)))


def suspect(members: Sequence[str], course: str, sure: str, told_by: str, *size: str) -> list[Html]:
    """Return the part on a class of effects: its meaning, its rivals, its probability, and what to check.

    course : how the first of its `members` developed, if known; told_by : `records` or `flights`; size : sentences
    """
    name, *others = members
    return [
        paragraph(strong(sentence(MEANING[name])), f" ({name}){f': {course}' if course else ''}."),
        *map(paragraph, size),
        paragraph(f"These {told_by} cannot tell it from:" if others else ""),
        bullets(f"{MEANING[m]} ({m})" for m in others),
        paragraph(sure),
        paragraph(strong("What to check")),
        bullets(f"{sentence(CHECK[m])} ({m})." for m in members),
    ]


def evidence_figure(blocks: tuple[EvidenceBlock, ...]) -> Html:
    """Draw the chi-square saved in each part of the flights as bars; below zero a part contradicts the effect."""
    names, saved = [b.name for b in blocks], np.array([b.saved for b in blocks])

    def draw(axes: Axes) -> None:
        colours = [plot.BLUE if value >= 0.0 else plot.RED for value in saved]
        axes.barh(range(len(names)), saved, color=colours, height=0.6)
        axes.set_yticks(range(len(names)), names)
        axes.invert_yaxis()
        axes.axvline(0.0, color=plot.INK, linewidth=0.7)

    listing = ", ".join(f"{b.name} {b.saved:.0f}" for b in blocks)
    chart = plot.panel(
        draw, f"Evidence by part of the flights: {listing}", x="chi-square saved", y="", left=ROOM_FOR_NAMES
    )
    return figure(chart, "Evidence")


def _decimals(half_width: float) -> int:
    """Return the decimals that show half an interval with two digits: 0.991 between 0.988 and 0.995 is not 0.99."""
    return 0 if half_width <= 0.0 else int(np.clip(1 - np.floor(np.log10(half_width)), 0, 5))


def _errors(closed: ClosedLoop, floor_V: float) -> Html:
    b, a = closed.before, closed.after
    errors = (
        ("voltage RMSE", 1000.0 * b.voltage_rmse_V, 1000.0 * a.voltage_rmse_V, "mV", 0),
        ("temperature RMSE", b.temp_rmse_K, a.temp_rmse_K, "K", 2),
        ("remaining time, mean error", b.remaining_mae_s, a.remaining_mae_s, "s", 0),
        ("truth inside the 90 % interval", 100.0 * b.coverage, 100.0 * a.coverage, "%", 0),
    )
    rows = [(label, number(before, n), number(after, n), unit) for label, before, after, unit, n in errors]
    caption = (
        f"Each of {len(closed.held_out)} records predicted with the values that the others give; the battery's own "
        f"model leaves about {number(1000.0 * floor_V, 0, 'mV')}."
    )
    return table(("", "before", "after", "unit"), rows, caption, text_columns=(0, 3))


def _worse(closed: ClosedLoop) -> Html:
    words = f"Held-out records are predicted worse with it ({closed.worse}): do the check before you fly by it."
    return paragraph(strong(words) if closed.worse else "")


def _residuals(diagnosis: Diagnosis) -> list[Html]:
    before, after = diagnosis.residual_before, diagnosis.residual_after

    def volts(one: Residual) -> Array:
        return one.voltage_V

    def warmth(one: Residual) -> Array:
        return one.temp_K

    # Both panels have the same scale.
    limits_mV = max(_reach(before, volts, 1000.0), 2.5 * 1000.0 * diagnosis.floor_V)
    out = [
        _panel("Voltage before", before, volts, (1000.0, "mV"), limits_mV, 1000.0 * diagnosis.floor_V),
        _panel("Voltage after", after, volts, (1000.0, "mV"), limits_mV, 1000.0 * diagnosis.floor_V),
    ]
    if any(np.isfinite(r.temp_K).any() for r in before):
        limits_K = max(_reach(before, warmth, 1.0), 1.0)
        out += [
            _panel("Temperature before", before, warmth, (1.0, "K"), limits_K),
            _panel("Temperature after", after, warmth, (1.0, "K"), limits_K),
        ]
    return [grid(*out)]


def _reach(records: Sequence[Residual], column: Callable[[Residual], Array], scale: float) -> float:
    """Return half the height of a panel that holds nearly all residuals, in the panel's unit."""
    columns = [column(r) for r in records]
    largest = [float(np.nanpercentile(np.abs(y), 97)) if np.isfinite(y).any() else 0.0 for y in columns]
    return scale * max(largest) * 1.2


def _panel(
    title: str,
    records: Sequence[Residual],
    column: Callable[[Residual], Array],
    shown: tuple[float, str],
    limit: float,
    floor: float | None = None,
) -> Html:
    """Draw the residuals of the first six records; `limit` and `floor` are in the unit of `shown` (factor, unit)."""
    scale, unit = shown

    def draw(axes: Axes) -> None:
        if floor is not None:
            axes.axhspan(-floor, floor, facecolor=plot.SHADE, linewidth=0, label="floor")
        plot.zero_line(axes)
        for i, r in enumerate(records[: len(COLOURS)]):
            minutes = (r.time_s - r.time_s[0]) / 60.0
            axes.plot(minutes, scale * column(r), color=COLOURS[i], linewidth=1.0, label=Path(r.name).stem)
        axes.set_ylim(-limit, limit)

    alt = f"{title}: measured minus modelled against time, {len(records)} records"
    names = [*(["floor"] if floor is not None else []), *(Path(r.name).stem for r in records[: len(COLOURS)])]
    return figure(plot.panel(draw, alt, x="time (min)", y=unit, height=plot.height_under(names)), title)


def _changes(diagnosis: Diagnosis, lines: Sequence[str]) -> list[Html]:
    if not lines:
        return [paragraph("None.")]
    text = scrolled(element("pre", "\n".join(lines)), "Changed lines of the battery file")
    parts = [details(f"{len(lines)} lines", text) if len(lines) > 40 else text]
    if any(len(c.members) > 1 for c in diagnosis.classes):
        parts.insert(0, paragraph("Where several causes are possible, the file takes the one that is named first."))
    return parts


def difference(old: BatteryFile, new: BatteryFile) -> tuple[str, ...]:
    """Return the lines of the battery file that change, marked + and -, without hash and date."""
    before, after = _text(old).splitlines(), _text(new).splitlines()
    changes = difflib.unified_diff(before, after, "before", "after", lineterm="", n=1)
    return tuple(changes)


def _text(file: BatteryFile) -> str:
    content: dict[str, Any] = msgspec.to_builtins(file)
    for key in ("content_sha256", "date", "tool_version"):
        content["certificate"].pop(key, None)
    return tomli_w.dumps(without_none(content))
