"""Text of foreign origin (file names, cells, logs, battery files) as a person may see it.

A control byte in a file name clears a screen, an escape sequence rewrites what stood there, a direction mark turns a
name round: none of them reaches a terminal or a page.
"""

from __future__ import annotations

import unicodedata


def printable(text: str) -> str:
    """`text` without what would break a page: control, surrogate and direction-changing characters become U+FFFD."""
    return "".join("\ufffd" if unicodedata.category(c) in ("Cc", "Cf", "Cs") and c not in "\n\t" else c for c in text)


def terminal_line(text: object) -> str:
    """`text` as one line of a terminal."""
    return printable(str(text).replace("\n", " ").replace("\t", " "))
