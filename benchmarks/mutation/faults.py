"""Small faults that can be planted in a module: one operator, constant or term of a guard each.

The operators are those of Offutt, Lee, Rothermel, Untch & Zapf 1996 (ACM TOSEM 5, 99), whose "sufficient" set
(relational, logical, arithmetic, unary and absolute-value changes) predicts the result of the complete set. Each
stands for a mistake that people make: a wrong sign, a wrong bound, a guard without its second term.
"""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

_COMPARISONS: dict[type[ast.cmpop], ast.cmpop] = {
    ast.Lt: ast.LtE(),
    ast.LtE: ast.Lt(),
    ast.Gt: ast.GtE(),
    ast.GtE: ast.Gt(),
    ast.Eq: ast.NotEq(),
    ast.NotEq: ast.Eq(),
    ast.Is: ast.IsNot(),
    ast.IsNot: ast.Is(),
    ast.In: ast.NotIn(),
    ast.NotIn: ast.In(),
}
_ARITHMETIC: dict[type[ast.operator], ast.operator] = {
    ast.Add: ast.Sub(),
    ast.Sub: ast.Add(),
    ast.Mult: ast.Div(),
    ast.Div: ast.Mult(),
}
_EXCHANGED = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "any": "all", "all": "any"}
_TEXT_ONLY = ("__repr__", "_repr_html_", "__str__")
"""Functions that only describe an object: their faults are not of the kind that is measured here."""


@dataclass(frozen=True)
class Fault:
    """A change of one expression of a file.

    Parameters
    ----------
    path : Path
        The file, relative to the root of the checkout.
    line : int
        From 1.
    start, end : int
        Of the expression in the file, bytes.
    before, after : str
        The expression, and what takes its place.
    """

    path: Path
    line: int
    start: int
    end: int
    before: str
    after: str

    def planted(self, source: bytes) -> bytes:
        """The file's text with the fault."""
        return source[: self.start] + b"(" + self.after.encode() + b")" + source[self.end :]

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {_short(self.before)} → {_short(self.after)}"


def faults_of(path: Path, source: bytes) -> list[Fault]:
    """All faults that can be planted in a Python file, in the order of the file."""
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    found = []
    for node in _expressions(ast.parse(source)):
        start = starts[node.lineno - 1] + node.col_offset
        end = starts[(node.end_lineno or node.lineno) - 1] + (node.end_col_offset or 0)
        for changed in _changes(node):
            found.append(Fault(path, node.lineno, start, end, ast.unparse(node), ast.unparse(changed)))
    return found


def _expressions(tree: ast.AST) -> Iterator[ast.expr]:
    """Expressions that are executed: no annotations, docstrings, texts, decorators or type aliases."""
    for field, value in ast.iter_fields(tree):
        if field in ("annotation", "returns", "decorator_list", "type_params"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if not isinstance(child, ast.AST) or _is_left_out(child):
                continue
            if isinstance(child, ast.expr):
                yield child
            yield from _expressions(child)


def _is_left_out(node: ast.AST) -> bool:
    if isinstance(node, ast.FunctionDef):
        return node.name in _TEXT_ONLY
    # the parts of an f-string have no positions of their own before Python 3.12, and an error's text is no behaviour
    return isinstance(node, (ast.Import, ast.ImportFrom, ast.JoinedStr, ast.Raise, ast.Assert))


def _changes(node: ast.expr) -> Iterator[ast.expr]:
    match node:
        case ast.Compare(ops=[operator]) if type(operator) in _COMPARISONS:
            changed = copy.deepcopy(node)
            changed.ops = [_COMPARISONS[type(operator)]]
            yield changed
        case ast.BoolOp(op=operator, values=values):
            yield ast.BoolOp(ast.Or() if isinstance(operator, ast.And) else ast.And(), values)
            yield from values if len(values) == 2 else ()
        case ast.BinOp(op=operator) if type(operator) in _ARITHMETIC and not _is_of_types(node):
            yield ast.BinOp(node.left, _ARITHMETIC[type(operator)], node.right)
        case ast.UnaryOp(op=ast.USub() | ast.Not(), operand=operand):
            yield operand
        case ast.Constant(value=float(value)) if value != 0.0:
            yield ast.Constant(1.1 * value)
        case ast.Constant(value=bool(value)):
            yield ast.Constant(not value)
        case ast.Constant(value=int(value)):
            yield ast.Constant(value + 1)
        case ast.Call(func=ast.Name(id=name)) if name in _EXCHANGED:
            yield ast.Call(ast.Name(_EXCHANGED[name]), node.args, node.keywords)
        case ast.Call(func=ast.Attribute(attr=name)) if name in _EXCHANGED:
            changed = copy.deepcopy(node)
            changed.func = ast.Attribute(node.func.value, _EXCHANGED[name])  # type: ignore[attr-defined]
            yield changed
        case ast.IfExp():
            yield node.body
            yield node.orelse


def _is_of_types(node: ast.BinOp) -> bool:
    """Whether a sum concatenates text or lists, whose difference is an error at once."""
    kinds = (ast.JoinedStr, ast.List, ast.Tuple, ast.ListComp)
    return any(
        isinstance(side, kinds) or (isinstance(side, ast.Constant) and isinstance(side.value, str))
        for side in (node.left, node.right)
    )


def _short(text: str) -> str:
    flat = " ".join(text.split())
    return flat if len(flat) <= 60 else f"{flat[:57]}…"
