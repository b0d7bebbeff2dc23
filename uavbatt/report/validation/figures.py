"""The drawings of the gate and of the samples' consistency."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from uavbatt.report import plot
from uavbatt.report.page import Html, celsius, figure, number, sentence
from uavbatt.report.validation.page_values import Array, Consistency
from uavbatt.report.validation.tables import nearest, plain_reason, shown_as
from uavbatt.validation.gating.gate import Claim
from uavbatt.validation.judging.finding import NAMES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = {"pass": plot.GREEN, "fail": plot.RED, "not enough data": plot.AMBER}


def judged(claims: Sequence[Claim], ambient_C: float) -> list[Claim]:
    """List the claims at `ambient_C` [°C] that compare a bias and its interval with a limit."""
    return [c for c in claims if c.ambient_C == ambient_C and math.isfinite(c.limit) and np.isfinite(c.bias).any()]


def claim_figures(claims: Sequence[Claim]) -> list[Html]:
    """Draw each quantity that was judged at many instants, and all that are judged once (times) together."""
    many = [c for c in claims if c.at.size > 1]
    once = [c for c in claims if c.at.size == 1]
    return [*(_over_instants(c) for c in many), *([_single(once)] if once else [])]


def _points(axes: Axes, at: Array, bias: Array, half: Array, colour: str) -> None:
    half_widths = np.nan_to_num(half)
    axes.errorbar(at, bias, yerr=half_widths, fmt="o", color=colour, markersize=4.5, capsize=4, linewidth=1.6)


def _over_instants(claim: Claim) -> Html:
    scale, unit, _ = shown_as(claim.unit)
    limit = claim.limit * scale

    def draw(axes: Axes) -> None:
        axes.axhspan(-limit, limit, facecolor=plot.SHADE, linewidth=0, label=f"allowed, ±{limit:g} {unit}")
        plot.zero_line(axes)
        colour = COLOURS.get(claim.verdict, plot.INK)
        _points(axes, claim.at / 60.0, claim.bias * scale, claim.half_width * scale, colour)
        axes.plot([], [], "o-", color=colour, markersize=4.5, label="bias with its interval")
        reach = 1.15 * max(limit, float(np.nanmax(np.abs(claim.bias) + np.nan_to_num(claim.half_width))) * scale)
        axes.set_ylim(-reach, reach)

    alt = f"{claim.claim} per instant with its interval against the limit of ±{limit:g} {unit}: {claim.verdict}."
    chart = plot.panel(draw, alt, x="time from the start of the discharge (min)", y=f"model − tests ({unit})")
    return figure(
        chart,
        f"{sentence(claim.claim)}, {celsius(claim.ambient_C)}: {claim.verdict}",
        sentence(plain_reason(claim)) + ".",
    )


def over_ambient(claims: Sequence[Claim]) -> Html:
    """Draw the bias nearest to the limit at each ambient temperature, with its interval where there is one."""
    with_limit = [c for c in claims if c.unit == "V" and math.isfinite(c.limit) and np.isfinite(c.bias).any()]
    if not with_limit:
        return Html("")
    limit, middle = with_limit[0].limit * 1000.0, [nearest(c) for c in with_limit]

    def draw(axes: Axes) -> None:
        axes.axhspan(-limit, limit, facecolor=plot.SHADE, linewidth=0, label=f"allowed, ±{limit:g} mV")
        plot.zero_line(axes)
        for verdict, marker in (("pass", "o"), ("fail", "X"), ("not enough data", "D")):
            mine = [(c, i) for c, i in zip(with_limit, middle, strict=True) if c.verdict == verdict]
            if mine:
                at, bias, half = np.array([[c.ambient_C, c.bias[i] * 1e3, c.half_width[i] * 1e3] for c, i in mine]).T
                axes.errorbar(at, bias, yerr=np.nan_to_num(half), fmt=marker, color=COLOURS[verdict], markersize=5,
                              capsize=2.5, linewidth=1.2, label=verdict)  # fmt: skip

    alt = f"Largest bias of the voltage at {len(with_limit)} ambient temperatures against the limit of ±{limit:g} mV."
    chart = plot.panel(draw, alt, x="ambient temperature (°C)", y="model less tests (mV)", legend_columns=4)
    note = "At the instant that uses the most of the limit. No bar: a single run, its dispersion is not known."
    return figure(chart, "Voltage bias over ambient temperature", note)


def _single(claims: Sequence[Claim]) -> Html:
    """Draw claims with one bias each as bars of the allowed range, where 1 is the limit."""
    height = 90.0 + 52.0 * len(claims)

    def draw(figure_: Figure) -> None:
        axes = figure_.add_axes((0.37, 56.0 / height, 0.6, 1.0 - 68.0 / height))
        axes.axvspan(-1.0, 1.0, facecolor=plot.SHADE, linewidth=0)
        axes.axvline(0.0, color=plot.INK, linewidth=0.7)
        for i, c in enumerate(claims):
            colour = COLOURS.get(c.verdict, plot.INK)
            half = float(np.nan_to_num(c.half_width[0])) / c.limit
            bias = float(c.bias[0]) / c.limit
            axes.errorbar([bias], [i], xerr=[half], fmt="o", color=colour, markersize=4.5, capsize=4, linewidth=1.6)
        axes.set_yticks(range(len(claims)), [f"{plot.literal(c.claim)}\n(±{c.limit:g} {c.unit})" for c in claims])
        axes.set_ylim(len(claims) - 0.4, -0.6)
        parts = [(abs(float(c.bias[0])) + float(np.nan_to_num(c.half_width[0]))) / c.limit for c in claims]
        reach = 1.2 * max(1.0, *parts)
        axes.set_xlim(-reach, reach)
        axes.set_xlabel("bias in parts of the limit")
        axes.grid(False, axis="y")

    words = "; ".join(
        f"{c.claim}: {number(float(c.bias[0]), 1, sign=True)} ± {number(float(c.half_width[0]), 1, c.unit)}"
        for c in claims
    )
    return figure(plot.drawing(draw, words, height), "Times, model less tests", words + ".")


def mandel(levels: Sequence[Consistency], quantity: str) -> list[Html]:
    """Draw h and k of each sample, one stem an instant, grouped by sample as in ISO 5725-2."""
    mine = [c for c in levels if c.quantity == quantity]
    if not mine:
        return []
    h = np.array([c.h for c in mine]).T
    k = np.array([c.k for c in mine]).T
    few = len(mine[0].samples) < 3
    h_said = "With two samples |h| is 0.707 for any data: it has no meaning." if few else ""
    k_said = "Above the 5 % line a sample is a straggler, above the 1 % line an outlier in scatter."
    return [
        _stems(h, mine, quantity, "h", _limits([c.h_critical for c in mine], both=True), h_said),
        _stems(k, mine, quantity, "k", _limits([c.k_critical for c in mine], both=False), k_said),
    ]


def _limits(pairs: Sequence[tuple[float, float]], both: bool) -> list[tuple[float, str]]:
    """Return the critical values to draw: at 5 % and 1 %, on both sides for h."""
    five, one = (float(np.nanmedian([p[i] for p in pairs])) if np.isfinite([p[i] for p in pairs]).any() else math.nan
                 for i in (0, 1))  # fmt: skip
    signs = (1.0, -1.0) if both else (1.0,)
    return [(s * v, n) for v, n in ((five, "5 %"), (one, "1 %")) if math.isfinite(v) for s in signs]


def _stems(
    values: Array, levels: Sequence[Consistency], quantity: str, letter: str, limits: list[tuple[float, str]], note: str
) -> Html:
    """Draw `values[sample, instant]` as stems, the instants of one sample side by side."""
    samples, count = levels[0].samples, len(levels)
    looks = {"5 %": (plot.FAINT, "--"), "1 %": (plot.RED, "-")}

    def draw(axes: Axes) -> None:
        for j in range(len(samples)):
            x = j * (count + 2) + np.arange(count)
            axes.vlines(x, 0.0, np.nan_to_num(values[j]), color=plot.BLUE, linewidth=3.0)
            axes.plot(x, values[j], "o", color=plot.BLUE, markersize=3.0)
        labelled: set[str] = set()
        for value, name in limits:
            label = f"critical, {name}" if name not in labelled else "_"
            labelled.add(name)
            axes.axhline(value, color=looks[name][0], linewidth=1.2, linestyle=looks[name][1], label=label)
        plot.zero_line(axes)
        middle = [j * (count + 2) + (count - 1) / 2.0 for j in range(len(samples))]
        axes.set_xticks(middle, [plot.literal(f"sample {s}") for s in samples])
        axes.grid(False, axis="x")

    name = NAMES[quantity]
    means = "the sample means" if letter == "h" else "the scatter within samples"
    first, last = levels[0].time_s / 60.0, levels[-1].time_s / 60.0
    alt = f"Mandel's {letter} of the {name} for {len(samples)} samples at {count} instants."
    x = f"one stem an instant, {first:g} to {last:g} min"
    chart = plot.panel(draw, alt, x=x, y=f"Mandel's {letter}", height=plot.LOW)
    return figure(chart, f"Mandel's {letter}: consistency of {means}, {name}", note)
