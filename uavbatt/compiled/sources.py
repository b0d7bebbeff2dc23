"""The sources of compiled code: the definitions that it is made of, found by following names, without their docstrings.

It is made of the functions decorated with `compiled`, of all that `jit` tells numba, and of every definition in this
package that these name, and those in turn: functions, constants, records. A changed docstring or comment, or a
function that no compiled code names, leaves what was compiled as it is.
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOM, TELLS_NUMBA, DECORATOR = "compiled", "jit", "compiled"
EVERYTHING, UNNAMED = "*", ""


class Module(NamedTuple):
    """A module taken apart: its statements by the name that they define, and the full names of what it imports."""

    statements: dict[str, list[ast.stmt]]
    imported: dict[str, str]


class Place(NamedTuple):
    """A definition in the file of a module; EVERYTHING in it, or its statements that define no name (UNNAMED)."""

    file: Path
    name: str


def digest(package: Path) -> str:
    """Return the SHA-256 of the definitions that compiled code is made of; `package` is the folder of this package."""
    parts = {f"{place.file.relative_to(package)} {ast.dump(part)}" for place, part in parts_of(package)}
    return hashlib.sha256("\n".join(sorted(parts)).encode()).hexdigest()


def parts_of(package: Path) -> Iterator[tuple[Place, ast.stmt]]:
    """Yield each statement that compiled code is made of, with its place."""
    to_follow, followed, named = list(_begin(package)), set[Place](), set[ast.stmt]()
    while to_follow:
        place = to_follow.pop()
        if place in followed:
            continue
        followed.add(place)
        module = taken_apart(place.file)
        names = module.statements if place.name == EVERYTHING else (place.name, UNNAMED)
        for part in (part for name in names for part in module.statements.get(name, ())):
            if part not in named:
                named.add(part)
                to_follow += _named_in(part, place.file, package)
                yield place, part
        if place.name in module.imported:
            to_follow += _imported(module.imported[place.name], package)


@cache
def taken_apart(file: Path) -> Module:
    """Return the statements and the imports of a source file, which is read once in a process."""
    statements: dict[str, list[ast.stmt]] = {}
    imported: dict[str, str] = {}
    for part in ast.parse(file.read_bytes()).body:
        inner = part.body if isinstance(part, ast.If) else []  # of `if TYPE_CHECKING`
        for node in (part, *inner):
            if isinstance(node, ast.ImportFrom):
                imported |= {name.asname or name.name: f"{node.module}.{name.name}" for name in node.names}
        if not isinstance(part, ast.Import | ast.ImportFrom) and not _is_docstring(part):
            for name in _defined_by(part):
                statements.setdefault(name, []).append(_without_docstrings(part))
    return Module(statements, imported)


def _without_docstrings(part: ast.stmt) -> ast.stmt:
    if isinstance(part, ast.FunctionDef | ast.ClassDef):
        part.body = [_without_docstrings(inner) for inner in part.body if not _is_docstring(inner)]
    return part


def _is_docstring(part: ast.stmt) -> bool:
    return isinstance(part, ast.Expr) and isinstance(part.value, ast.Constant) and isinstance(part.value.value, str)


def _defined_by(part: ast.stmt) -> list[str]:
    """Return the names that a statement defines; UNNAMED where it is no definition."""
    if isinstance(part, ast.FunctionDef | ast.ClassDef):
        return [part.name]
    if not isinstance(part, ast.Assign | ast.AnnAssign):
        return [UNNAMED]
    stored = [node.id for node in ast.walk(part) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)]
    return stored or [UNNAMED]


def _begin(package: Path) -> Iterator[Place]:
    """Yield where compiled code begins: what tells numba of the model, and the functions that are decorated."""
    for file in sorted((package / ROOM).glob("*.py")):
        yield Place(file, EVERYTHING if file.stem == TELLS_NUMBA else UNNAMED)
        for name, (part, *_) in taken_apart(file).statements.items():
            decorators = part.decorator_list if isinstance(part, ast.FunctionDef) else []
            if any(isinstance(one, ast.Name) and one.id == DECORATOR for one in decorators):
                yield Place(file, name)


def _named_in(part: ast.stmt, file: Path, package: Path) -> Iterator[Place]:
    """Yield the places of all that a statement names, as `name` or, of a module, as `module.name`."""
    module, owners = taken_apart(file), set[ast.Name]()
    for node in ast.walk(part):  # an attribute comes before the name that it is of
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            owner = module.imported.get(node.value.id, "")
            if owner and _file_of(owner, package) is not None:
                owners.add(node.value)
                yield from _imported(f"{owner}.{node.attr}", package)
        elif isinstance(node, ast.Name) and node not in owners:
            yield Place(file, node.id)


def _imported(full_name: str, package: Path) -> Iterator[Place]:
    """Yield the place of an import: a whole module, a definition in one, nothing where it is of another package."""
    whole, (module, _, name) = _file_of(full_name, package), full_name.rpartition(".")
    file = _file_of(module, package)
    if whole is not None:
        yield Place(whole, EVERYTHING)
    elif file is not None:
        yield Place(file, name)


@cache
def _file_of(module: str, package: Path) -> Path | None:
    """Return the source file of a module of this package; None for any other name."""
    top, *inner = module.split(".")
    place = package.joinpath(*inner)
    files = (place.with_suffix(".py"), place / "__init__.py") if top == package.name and inner else ()
    return next((file for file in files if file.is_file()), None)
