"""Rules that a newcomer relies on: one class for one name, files that are read in one sitting, plain docstrings."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "uavbatt"
FILES = sorted(PACKAGE.rglob("*.py"))
LONGEST_FILE = 300  # lines
NO_SUBJECT = {"What", "Whether", "Who", "Whose", "Where", "How", "Why", "When"}  # the subject of the sentence is hidden

Definition = ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


def definitions(node: ast.AST) -> Iterator[Definition]:
    """Classes, functions and methods, without those inside functions and private classes."""
    for inner in ast.iter_child_nodes(node):
        if isinstance(inner, Definition):
            yield inner
        is_private = isinstance(inner, ast.ClassDef) and inner.name.startswith("_")
        if not (is_private or isinstance(inner, ast.FunctionDef | ast.AsyncFunctionDef)):
            yield from definitions(inner)


def all_definitions() -> Iterator[tuple[str, Definition]]:
    for path in FILES:
        for node in definitions(ast.parse(path.read_text("utf-8"))):
            yield f"{path.relative_to(PACKAGE)}:{node.lineno} {node.name}", node


def test_no_two_public_classes_have_one_name() -> None:
    places = defaultdict(list)
    for place, node in all_definitions():
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            places[node.name].append(place)
    assert [found for found in places.values() if len(found) > 1] == []


def test_a_file_is_read_in_one_sitting() -> None:
    assert [path.name for path in FILES if len(path.read_text("utf-8").splitlines()) > LONGEST_FILE] == []


def test_all_that_is_public_has_a_docstring() -> None:
    def is_open(node: Definition) -> bool:
        return not node.name.startswith("_") and not any("overload" in ast.unparse(d) for d in node.decorator_list)

    assert [place for place, node in all_definitions() if is_open(node) and not ast.get_docstring(node)] == []


def test_a_docstring_begins_with_its_subject_or_its_verb() -> None:
    first = ((place, (ast.get_docstring(node) or "-").split()[0]) for place, node in all_definitions())
    assert [f"{place}: {word} ..." for place, word in first if word in NO_SUBJECT] == []
