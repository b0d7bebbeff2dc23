"""A self-contained HTML page: opens offline, prints, follows the reader's light or dark setting, works without script.

Everything that is not `Html` is text and gets escaped, so that a file name or a column of a log cannot become markup.
As a second protection, the page's security policy forbids all fetching, and every script but the page's own.
"""

from __future__ import annotations

import base64
import hashlib
import math
import re
from collections.abc import Iterable, Sequence
from html import escape
from importlib import resources
from pathlib import Path
from typing import Literal

from uavbatt import __version__, output
from uavbatt.errors import printable
from uavbatt.files import atomic_write

ADVISORY = "Advisory: this page commands nothing and replaces no reserve."
UNKNOWN = "not known"
DASH = "–"
Mood = Literal["good", "bad", "unsure", "plain"]
MOODS: dict[str, Mood] = {
    "pass": "good", "fail": "bad", "not enough data": "unsure",
    "certified": "good", "fitted": "unsure", "generic": "unsure", "edited": "bad",
    "serious": "bad", "warning": "unsure", "note": "plain",
    "ok": "good", "straggler": "unsure", "outlier": "bad",
}  # fmt: skip
SIGNS: dict[Mood, str] = {"good": "✓", "bad": "✗", "unsure": "?", "plain": "·"}
POLICY = "default-src 'none'; style-src 'unsafe-inline'"
_SCRIPT = re.compile(r"<script>(.*?)</script>", re.DOTALL)  # data (`type="application/json"`) are no script
_TAG = re.compile(r"<[^>]*>")
LONG_WORDS = 24  # letters in a cell, from which its column is kept wide enough to be read
_NO_ID = re.compile(r"[^a-z0-9]+")


class Html(str):
    """Html is markup, which goes into the page unchanged."""

    __slots__ = ()


def safe(value: str) -> Html:
    """Return markup unchanged, and everything else escaped."""
    return value if isinstance(value, Html) else Html(escape(printable(value), quote=True))


def together(parts: Iterable[str], glue: str = "\n") -> Html:
    """Join parts one after the other, each made safe."""
    return Html(glue.join(safe(p) for p in parts))


def element(tag: str, *content: str, css: str = "") -> Html:
    """Return `<tag class="css">content</tag>`, the content made safe."""
    attribute = f' class="{escape(css)}"' if css else ""
    return Html(f"<{tag}{attribute}>{together(content, '')}</{tag}>")


def filled(tag: str, *content: str, css: str = "") -> Html:
    """Return the same as `element`; nothing without content."""
    return element(tag, *content, css=css) if any(content) else Html("")


def paragraph(*content: str, css: str = "") -> Html:
    """Return a paragraph; nothing without words."""
    return filled("p", *content, css=css)


def strong(text: str) -> Html:
    """Return emphasised text."""
    return element("strong", text)


def bullets(items: Iterable[str], css: str = "") -> Html:
    """Return a list of `items`; nothing when there is nothing to list."""
    return filled("ul", *(element("li", item) for item in items), css=css)


def badge(verdict: str, words: str = "") -> Html:
    """Return a verdict with a sign and a colour, so that it can be read without the colour."""
    mood = MOODS.get(verdict, "plain")
    return element("span", f"{SIGNS[mood]} {words or verdict}", css=f"badge {mood}")


def answer(*content: str, mood: str = "") -> Html:
    """Return the box at the top of a page, in the colour of a mood (`good`, `bad`, `unsure`) or without one."""
    return element("div", *content, css=f"answer {mood}".rstrip())


def section(title: str, *content: str, css: str = "") -> Html:
    """Return a part of the page under its own heading, to which `contents` can link; nothing without content."""
    if not any(content):
        return Html("")
    heading = Html(f'<h2 id="{_anchor(title)}">{safe(title)}</h2>')
    return element("section", heading, *content, css=css)


def contents(*titles: str) -> Html:
    """Return links to the sections of a long page."""
    links = (Html(f'<li><a href="#{_anchor(title)}">{safe(title)}</a></li>') for title in titles)
    return Html(f'<nav aria-label="Contents"><ul class="contents">{together(links, "")}</ul></nav>')


def _anchor(title: str) -> str:
    """Return the anchor of a heading; two headings never have the same anchor."""
    return (
        f"{_NO_ID.sub('-', title.lower()).strip('-')[:40]}-{hashlib.sha256(printable(title).encode()).hexdigest()[:4]}"
    )


def grid(*figures: str) -> Html:
    """Put figures side by side where the screen is wide enough; nothing without figures."""
    return filled("div", *figures, css="grid")


def facts(pairs: Iterable[tuple[str, str]]) -> Html:
    """Return a list of names with their values."""
    inner = together((together((element("dt", k), element("dd", v)), "") for k, v in pairs), "")
    return element("dl", inner, css="facts")


def details(summary: str, *content: str) -> Html:
    """Return content that the reader can open; on paper it is always open. Nothing without content."""
    return element("details", element("summary", summary), *content) if any(content) else Html("")


def table(
    head: Sequence[str], rows: Iterable[Sequence[str]], caption: str = "", *, text_columns: Sequence[int] = (0,)
) -> Html:
    """Return a table that scrolls on a narrow screen, by keyboard too.

    text_columns : the columns that hold text; all others hold numbers
    A screen reader announces a table without a caption by its first columns.
    """
    body = [tuple(cells) for cells in rows]
    css = ["" if i in text_columns else "number" for i in range(len(head))]
    for i in text_columns:
        if i and any(len(_TAG.sub("", cells[i])) > LONG_WORDS for cells in body):
            css[i] = "words"

    def row(cells: Sequence[str], tag: str) -> Html:
        return element("tr", *(_cell(tag, c, kind) for c, kind in zip(cells, css, strict=True)))

    top = element("caption", caption) if caption else Html("")
    lines = element("tbody", *(row(cells, "td") for cells in body))
    whole = element("table", top, element("thead", row(head, "th")), lines)
    return scrolled(whole, f"Table: {caption or ', '.join(name for name in head[:3] if name)}")


def _cell(tag: str, content: str, css: str) -> Html:
    cell = element(tag, content, css=css)
    return Html(cell.replace("<th", '<th scope="col"', 1)) if tag == "th" else cell


def scrolled(content: Html, label: str) -> Html:
    """Return content that scrolls sideways, by keyboard too."""
    attributes = f'role="region" aria-label="{safe(label)}" tabindex="0"'
    return Html(f'<div class="scroll" {attributes}>{content}</div>')


def figure(svg: Html, title: str, caption: str = "") -> Html:
    """Put a drawing under its title and the explanation."""
    return element("figure", element("figcaption", strong(title), paragraph(caption)), svg)


def missing_figure(title: str, why: str) -> Html:
    """Return the title of a figure that cannot be drawn, and why."""
    return figure(paragraph(why, css="quiet"), title)


def number(value: float, decimals: int, unit: str = "", *, sign: bool = False) -> str:
    """Write `value` to `decimals` places with its unit; a dash, never a zero, if it is unknown."""
    if not math.isfinite(value):
        return _unknown(value)
    text = f"{round(value, decimals) + 0.0:{'+' if sign else ''}.{decimals}f}".replace("-", "\u2212")
    return f"{text} {unit}" if unit else text


def percent(share: float) -> str:
    """Write a share of 0 to 1 in whole percent: `45 %`; a dash when not known."""
    return number(100.0 * share, 0, "%")


def duration(seconds: float) -> str:
    """Write seconds in words: `45 s`, `12 min 05 s`; a dash if unknown."""
    if not math.isfinite(seconds):
        return _unknown(seconds)
    minutes, rest = output.clock(seconds).split(":")
    if minutes.endswith("0") and abs(seconds) < 59.5:
        return f"{minutes[:-1]}{int(rest)} s"
    return f"{minutes} min {rest} s"


def clock(seconds: float) -> str:
    """Write seconds as minutes and seconds, `12:05`; a dash if unknown."""
    return output.clock(seconds, _unknown(seconds))


def _unknown(value: float) -> str:
    return "unbounded" if math.isinf(value) else DASH


def celsius(temp_C: float) -> str:
    """Write an ambient temperature with its sign: `+25 °C`, `0 °C`, `−20 °C`."""
    return f"{number(temp_C, 0 if temp_C == round(temp_C) else 1, '°C', sign=temp_C > 0)}"


def page(title: str, kicker: str, *content: str, footer: str = ADVISORY, script: str = "") -> str:
    """Return the whole document: HTML that is also well-formed XML, so that a test can parse it strictly.

    footer : the last sentence, after the name of the program; script : markup of the page's own script, the only one
    that its policy allows
    """
    css = (resources.files("uavbatt.report") / "page.css").read_text("utf-8")
    return "\n".join(
        (
            "<!DOCTYPE html>",
            '<html lang="en">',
            "<head>",
            '<meta charset="utf-8"/>',
            '<meta name="viewport" content="width=device-width, initial-scale=1"/>',
            f'<meta http-equiv="Content-Security-Policy" content="{escape(_policy(script))}"/>',
            '<meta name="color-scheme" content="light dark"/>',
            f"<title>{safe(title)}</title>",
            f"<style>\n{css}</style>",
            "</head>",
            "<body>",
            '<a class="skip" href="#main">Skip to the answer</a>',
            element("header", paragraph(kicker, css="kicker"), element("h1", title)),
            Html(f'<main id="main">{together(content, "")}</main>'),
            element("footer", f"uavbatt {__version__}. {footer}"),
            script,
            "</body>",
            "</html>\n",
        )
    )


def _policy(script: str) -> str:
    """Return the security policy: this script by its hash and inline styles, and nothing else."""
    digests = (base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in _SCRIPT.findall(script))
    allowed = " ".join(f"'sha256-{digest}'" for digest in digests)
    return f"{POLICY}; script-src {allowed}" if allowed else POLICY


def sentence(text: str) -> str:
    """Return the text with a capital letter at its beginning."""
    return text[:1].upper() + text[1:]


def write_page(path: str | Path, html: str) -> None:
    """Write a page to `path` (`-`: standard output), whole or not at all. Raises BadInput when it cannot be written."""
    with atomic_write(path) as file:
        encoding = file.encoding or "utf-8"  # standard output may be ASCII
        file.write(html.encode(encoding, "xmlcharrefreplace").decode(encoding))
