"""Which functions use a function or constant, through compiled functions and other constants."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

_COMPILED = {"kernel", "kernel_part", "kernel_with", "overload", "intrinsic"}
"""Decorators of functions that run as machine code, which a profile of Python does not see."""
_Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True)
class Definition:
    """A function, class or constant at the top of a file, with its lines."""

    path: Path
    name: str
    first: int
    last: int
    is_compiled: bool
    is_constant: bool


class References:
    """The definitions of the packages and who names them.

    Parameters
    ----------
    root : Path
        Of the checkout.
    files : list of Path
        Relative to `root`.
    """

    def __init__(self, root: Path, files: list[Path]) -> None:
        self._trees = {path: ast.parse((root / path).read_bytes()) for path in files}
        self._modules = {".".join(path.with_suffix("").parts).removesuffix(".__init__"): path for path in files}
        self._defined: dict[tuple[Path, str], Definition] = {}
        self._imported: dict[Path, dict[str, tuple[Path, str | None]]] = {}
        bodies: list[tuple[Definition, ast.stmt]] = []
        for path, tree in self._trees.items():
            self._imported[path] = dict(self._imports_of(tree))
            for node in tree.body:
                for name in _names_of(node):
                    definition = _definition(path, name, node)
                    self._defined[path, name] = definition
                    bodies.append((definition, node))
        self._users: dict[Definition, set[Definition]] = {}
        for definition, body in bodies:
            for used in self._named_in(definition.path, body):
                self._users.setdefault(used, set()).add(definition)

    def at(self, path: Path, line: int) -> Definition | None:
        """The definition at the top of a file that contains a line."""
        found = [
            given for (file, _), given in self._defined.items() if file == path and given.first <= line <= given.last
        ]
        return found[0] if found else None

    def function_at(self, path: Path, line: int) -> int | None:
        """First line of the innermost function that contains a line, decorators included."""
        found = None
        for node in ast.walk(self._trees[path]):
            if isinstance(node, _Function) and _first(node) <= line <= (node.end_lineno or node.lineno):
                found = max(found or 0, _first(node))
        return found

    def through(self, start: Definition) -> tuple[set[Definition], set[Definition]]:
        """Compiled functions and constants that contain a definition, itself included, and the other users of these."""
        inside, outside, left = {start}, set(), [start]
        while left:
            for user in self._users.get(left.pop(), set()) - inside:
                if user.is_constant or user.is_compiled:
                    inside.add(user)
                    left.append(user)
                else:
                    outside.add(user)
        return inside, outside

    def _imports_of(self, tree: ast.Module) -> Iterator[tuple[str, tuple[Path, str | None]]]:
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module:
                for alias in node.names:
                    module = f"{node.module}.{alias.name}"
                    if module in self._modules:
                        yield alias.asname or alias.name, (self._modules[module], None)
                    elif node.module in self._modules:
                        yield alias.asname or alias.name, (self._modules[node.module], alias.name)

    def _named_in(self, path: Path, body: ast.stmt) -> Iterator[Definition]:
        for node in ast.walk(body):
            if isinstance(node, ast.Name):
                found = self._resolved(path, node.id)
            elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                module, name = self._imported[path].get(node.value.id, (path, ""))
                found = self._resolved(module, node.attr) if name is None else None
            else:
                continue
            if found is not None:
                yield found

    def _resolved(self, path: Path, name: str) -> Definition | None:
        """The definition of a name in a file, which may have imported it from another one."""
        if (path, name) in self._defined:
            return self._defined[path, name]
        module, original = self._imported[path].get(name, (path, None))
        return None if original is None or module == path else self._resolved(module, original)


def _definition(path: Path, name: str, node: ast.stmt) -> Definition:
    is_function = isinstance(node, _Function)
    decorators = [part for part in getattr(node, "decorator_list", []) if is_function]
    called = {part.func if isinstance(part, ast.Call) else part for part in decorators}
    is_compiled = any(isinstance(part, ast.Name) and part.id in _COMPILED for part in called)
    is_constant = not is_function and not isinstance(node, ast.ClassDef)
    return Definition(path, name, _first(node), node.end_lineno or node.lineno, is_compiled, is_constant)


def _first(node: ast.stmt) -> int:
    return min([node.lineno, *(part.lineno for part in getattr(node, "decorator_list", []))])


def _names_of(node: ast.stmt) -> Iterator[str]:
    """Names that a statement at the top of a file defines."""
    if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
        yield node.name
    elif isinstance(node, (ast.Assign, ast.AnnAssign, ast.AugAssign)):
        for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
            for part in ast.walk(target):
                if isinstance(part, ast.Name):
                    yield part.id
