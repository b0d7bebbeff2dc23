"""A hook of mkdocs: the pages at the root of the checkout are pages of the site, README its first.

Links are written for readers of the checkout; on the site `docs/x.md` is `x.md`, `../README.md` is `index.md`, and a
link to a file that is no page is its name alone.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
PAGES = {"README.md": "index.md", "CONTRIBUTING.md": "CONTRIBUTING.md", "CHANGELOG.md": "CHANGELOG.md",
         "SECURITY.md": "SECURITY.md"}  # fmt: skip
_LINK = re.compile(r"\[([^\]]+)\]\(([^)#\s]*)(#[^)\s]*)?\)")


def on_files(files: Files, config: Any) -> Files:
    """Add the pages of the root."""
    for name, uri in PAGES.items():
        files.append(File.generated(config, uri, content=(ROOT / name).read_text(encoding="utf-8")))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Write the links of a page as the site has them."""
    at_root = page.file.src_uri in PAGES.values()
    return _LINK.sub(lambda link: _written(link, at_root), markdown)


def _written(link: re.Match[str], at_root: bool) -> str:
    text, target, anchor = link[1], link[2], link[3] or ""
    if not target or "://" in target or target.startswith("mailto:"):
        return link[0]
    file = target if at_root else f"docs/{target}"
    path = (ROOT / file).resolve().relative_to(ROOT).as_posix()
    if path in PAGES:
        return f"[{text}]({PAGES[path]}{anchor})"
    if path.startswith("docs/"):
        return f"[{text}]({path.removeprefix('docs/')}{anchor})"
    return text if text.startswith("`") else f"`{text}`"
