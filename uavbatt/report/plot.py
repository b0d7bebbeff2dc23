"""Charts by matplotlib as inline SVG: colours of the page's palette, text as text, no ids that collide.

A chart is drawn in the colours of the light palette, which are then replaced by variables of the page, so that it
follows the light or dark setting. It is 440 units wide with letters of 15.5 units: 12 px on the narrowest phone (345 px
of page), 17 px if two stand side by side on a desktop. `responsive` draws it again for the whole width. matplotlib is
imported for the first chart; figures are made without pyplot, so that none stays open.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Sequence
from html import escape
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uavbatt.errors import printable
from uavbatt.files import atomic_write
from uavbatt.report.page import Html, element, together

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, FAINT, LINE, PAPER, SHADE = "#1b1f24", "#5b6570", "#d3d9e0", "#ffffff", "#e9edf1"
BLUE, RED, GREEN, PINK, AMBER, SKY = "#0072b2", "#c44601", "#00795a", "#a6447c", "#9a6700", "#56b4e9"
RAMP = (
    "#440154", "#481b6d", "#46337f", "#3f4889", "#365d8d", "#2d708e",
    "#26818e", "#20928c", "#20a386", "#31b57b", "#52c569", "#7ad151",
)  # fmt: skip
VARIABLES = {
    INK: "ink", FAINT: "faint", LINE: "line", PAPER: "paper", SHADE: "shade", BLUE: "blue", RED: "red", GREEN: "green",
    PINK: "pink", AMBER: "amber", SKY: "sky", **{value: f"t{i}" for i, value in enumerate(RAMP)},
}  # fmt: skip

# Sizes in px of the page: two panels stand side by side, a wide one fills the page (68 rem of `page.css`).
WIDTH, HEIGHT = 440.0, 280.0
WIDE, WIDE_HEIGHT = 1100.0, 400.0
TALL, LOW = 340.0, 200.0  # heights of a map and of the chart for a narrow screen; of a row of bars
TITLE_ROW, MOST_LETTERS, PRINTED_DPI = 30.0, 120, 144  # of a picture file: a title row, its longest title
LEFT, RIGHT, BOTTOM, TOP, LEGEND_ROW = 76.0, 14.0, 52.0, 14.0, 23.0
LETTERS = 15.5  # font size [px]
LETTER_WIDTH, SIGN_WIDTH = 0.54 * LETTERS, 3.3 * LETTERS  # widths of a letter in a legend, and of the sign before it
SETTINGS: dict[str, Any] = {
    "svg.fonttype": "none", "svg.hashsalt": "uavbatt", "figure.facecolor": "none", "axes.facecolor": "none",
    "savefig.facecolor": "none", "font.size": LETTERS, "axes.labelsize": LETTERS, "legend.fontsize": LETTERS,
    "xtick.labelsize": LETTERS, "ytick.labelsize": LETTERS, "text.color": INK, "axes.labelcolor": INK,
    "xtick.color": FAINT, "ytick.color": FAINT, "axes.edgecolor": LINE, "axes.grid": True, "grid.color": LINE,
    "grid.linewidth": 0.6, "axes.axisbelow": True, "axes.spines.top": False, "axes.spines.right": False,
    "lines.linewidth": 1.5, "lines.solid_joinstyle": "round", "hatch.linewidth": 0.6, "hatch.color": FAINT,
    "path.simplify": True, "path.simplify_threshold": 0.2, "axes.xmargin": 0.01, "text.usetex": False,
    "axes.unicode_minus": True, "font.family": "sans-serif", "font.sans-serif": ["DejaVu Sans"],
}  # fmt: skip


def literal(text: str) -> str:
    """Return text from a file in a form that is safe in a chart: no mathematics, no control characters, limited
    length."""
    clean = printable(text).replace("\n", " ")
    return (clean if len(clean) <= 40 else clean[:39] + "…").replace("$", r"\$")


def drawing(draw: Callable[[Figure], None], alt: str, height: float, width: float = WIDTH) -> Html:
    """Return a figure of `width` x `height` units that `draw` fills, as inline SVG with `alt` as its description."""
    from matplotlib import style
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with style.context(["default", SETTINGS]):
        figure = Figure(figsize=(width / 72.0, height / 72.0), dpi=72)
        FigureCanvasSVG(figure)
        draw(figure)
        text = StringIO()
        figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
        figure.clear()
    return _inline(text.getvalue(), alt)


def panel(
    draw: Callable[[Axes], None],
    alt: str,
    *,
    x: str,
    y: str,
    height: float = HEIGHT,
    width: float = WIDTH,
    left: float = LEFT,
    right: float = RIGHT,
    legend_columns: int = 3,
    unit_s: float = 0.0,
) -> Html:
    """Draw one pair of axes with its labels and its legend above; the left edges of all panels line up.

    height, width : [px]; left, right : room beside the axes, for the labels there [px]; legend_columns : at most
    unit_s : seconds of a unit of the x axis; with it the page's cursor finds its place in the drawing, and zooms it
    """
    frames: list[str] = []

    def whole(figure: Figure) -> None:
        axes = _axes_with(figure, draw, x, y)
        top = _place_axes(axes, (width, height), (left, right), legend_columns)
        if unit_s > 0.0:
            first, last = (unit_s * limit for limit in axes.get_xlim())
            box = f"{left} {width - right} {top} {height - BOTTOM}"
            frames.append(f' data-seconds="{first:.3f} {last:.3f}" data-unit="{unit_s:g}" data-box="{box}"')
            _name_what_moves(axes)

    chart = drawing(whole, alt, height, width)
    return Html(chart.replace("<svg", f"<svg{frames[0]}", 1)) if frames else chart


def _name_what_moves(axes: Axes) -> None:
    """Mark the parts that the page's script moves on zooming: data, labels beside them, and the time axis."""
    kinds = {"moves": [*axes.lines, *axes.collections, *axes.patches], "words": axes.texts, "ticks": [axes.xaxis]}
    for kind, artists in kinds.items():
        for count, artist in enumerate(artists):
            artist.set_gid(f"{kind}-{count}")


def _axes_with(figure: Figure, draw: Callable[[Axes], None], x: str, y: str) -> Axes:
    axes = figure.add_axes((0.1, 0.1, 0.8, 0.8))
    draw(axes)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    return axes


def _place_axes(
    axes: Axes, size: tuple[float, float], beside: tuple[float, float], legend_columns: int, above: float = 0.0
) -> float:
    """Put axes in a figure of `size` with room `beside` and `above` them; return the room above."""
    (width, height), (left, right) = size, beside
    names = [n for n in axes.get_legend_handles_labels()[1] if not n.startswith("_")]
    columns = _columns(names, legend_columns, width - left)
    top = TOP + -(-len(names) // columns) * LEGEND_ROW + above
    axes.set_position((left / width, BOTTOM / height, 1 - (left + right) / width, 1 - (BOTTOM + top) / height))
    if names:
        legend_above(axes, columns)
    return top


def save_picture(path: Path, draw: Callable[[Axes], None], title: str, *, x: str, y: str, right: float = RIGHT) -> None:
    """Write one wide panel on white paper under its title: as SVG where the name ends so, else as PNG."""
    from matplotlib import style
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    height = WIDE_HEIGHT + TITLE_ROW
    kind = "svg" if path.suffix.lower() == ".svg" else "png"
    with style.context(["default", SETTINGS]), atomic_write(path, "wb") as stream:
        figure = Figure(figsize=(WIDE / 72.0, height / 72.0), dpi=72)
        FigureCanvasAgg(figure)
        _place_axes(_axes_with(figure, draw, x, y), (WIDE, height), (LEFT, right), legend_columns=6, above=TITLE_ROW)
        figure.text(0.5 * TOP / WIDE, 1.0 - 0.5 * TOP / height, _wrapped(title), va="top")
        metadata: dict[str, Any] = {"Date": None} if kind == "svg" else {"Software": None}
        figure.savefig(stream, format=kind, dpi=PRINTED_DPI, facecolor=PAPER, metadata=metadata)
        figure.clear()


def _wrapped(title: str) -> str:
    clean = printable(title).replace("\n", " ").replace("$", r"\$")
    return clean if len(clean) <= MOST_LETTERS else clean[: MOST_LETTERS - 1] + "…"


def _columns(names: Sequence[str], most: int, room: float) -> int:
    """Return how many columns of names fit beside one another in a legend of `room` units."""
    for columns in range(min(most, len(names)), 1, -1):
        rows = -(-len(names) // columns)
        widest = (max(map(len, names[i : i + rows])) for i in range(0, len(names), rows))
        if sum(LETTER_WIDTH * letters + SIGN_WIDTH for letters in widest) <= room:
            return columns
    return 1


def height_under(names: Sequence[str]) -> float:
    """Return the height of a panel whose legend has these names: more than two rows of them make it taller."""
    rows = -(-len(names) // _columns(names, 3, WIDTH - LEFT))
    return HEIGHT + max(rows - 2, 0) * LEGEND_ROW


def responsive(
    draw: Callable[[Axes], None], alt: str, *, x: str, y: str, right: float = RIGHT, unit_s: float = 0.0
) -> Html:
    """Draw a panel for a narrow screen and one for a wide screen; the page shows the one that fits."""
    narrow = panel(draw, alt, x=x, y=y, height=TALL, right=right, legend_columns=2, unit_s=unit_s)
    wide = panel(draw, alt, x=x, y=y, height=WIDE_HEIGHT, width=WIDE, right=right, legend_columns=6, unit_s=unit_s)
    return together((element("div", narrow, css="narrow"), element("div", wide, css="wide")))


def zero_line(axes: Axes) -> None:
    """Draw the line of the value 0."""
    axes.axhline(0.0, color=INK, linewidth=0.7)


def legend_above(axes: Axes, columns: int) -> None:
    """Put the legend over the axes, out of the data's way."""
    axes.legend(
        loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncols=columns, frameon=False, borderaxespad=0.2, borderpad=0.1,
        handlelength=1.6, handletextpad=0.5, columnspacing=1.2, labelspacing=0.3,
    )  # fmt: skip


def _inline(text: str, alt: str) -> Html:
    """Return matplotlib's SVG file as markup for the middle of a page."""
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->|<!DOCTYPE[^>]*>", "", text, flags=re.DOTALL)
    text = re.sub(r"\bfont: ([\d.]+)px [^;\"]*", r"font-size: \1px", text)
    for value, name in VARIABLES.items():
        text = text.replace(value, f"var(--{name})")
    text = _own_ids(_MOVING.sub(r' class="\1"', text.replace("xlink:href", "href")), alt)
    box = re.search(r'viewBox="[^"]+"', text)
    inner = text[text.index(">") + 1 :]
    described = escape(printable(alt), quote=True)
    opening = f'<svg role="img" aria-label="{described}" {box[0] if box else ""}>'
    return Html(opening + re.sub(r"\s*\n\s*", "\n", inner).strip())


_MOVING = re.compile(r'\sid="(moves|words|ticks)-\d+"')
_AN_ID = re.compile(r'\sid="([^"]*)"')


def _own_ids(text: str, alt: str) -> str:
    """Remove the ids that nothing refers to, and make the others different in every figure."""
    mark = hashlib.sha256((alt + text).encode("utf-8", "replace")).hexdigest()[:8]
    used = set(re.findall(r"url\(#([^)]+)\)", text)) | set(re.findall(r'href="#([^"]+)"', text))
    text = _AN_ID.sub(lambda m: f' id="{mark}{m[1]}"' if m[1] in used else "", text)
    return re.sub(r'(url\(#|href="#)', rf"\g<1>{mark}", text)
