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
_REVERSED: dict[type[ast.cmpop], ast.cmpop] = {
    ast.Lt: ast.GtE(),
    ast.LtE: ast.Gt(),
    ast.Gt: ast.LtE(),
    ast.GtE: ast.Lt(),
}
_ROUNDING = 1e-9
"""A decimal number up to this in a comparison, a `max` or a `min` is a guard against rounding or a division by zero."""
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
        The expression, and what replaces it.
    """

    path: Path
    line: int
    start: int
    end: int
    before: str
    after: str
    text: str
    """The line of the source."""

    def planted(self, source: bytes) -> bytes:
        """The file's text with the fault."""
        return source[: self.start] + b"(" + self.after.encode() + b")" + source[self.end :]

    @property
    def change(self) -> str:
        """What becomes what."""
        return f"{_short(self.before)} → {_short(self.after)}"

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.change}"


def faults_of(path: Path, source: bytes) -> list[Fault]:
    """All faults that can be planted in a Python file, in the order of the file."""
    starts, lines = [0], source.splitlines(keepends=True)
    for line in lines:
        starts.append(starts[-1] + len(line))
    found = []
    tree = ast.parse(source)
    roles = _Roles(tree)
    for node in _expressions(tree):
        start = starts[node.lineno - 1] + node.col_offset
        end = starts[(node.end_lineno or node.lineno) - 1] + (node.end_col_offset or 0)
        for changed in _changes(node, roles):
            text = lines[node.lineno - 1].decode().strip()
            found.append(Fault(path, node.lineno, start, end, ast.unparse(node), ast.unparse(changed), text))
    return found


class _Roles:
    """Constants that need a change of another kind, or none, because of the role that they have."""

    def __init__(self, tree: ast.AST) -> None:
        self.indices: set[ast.expr] = set()
        """Positions along an axis: one beyond the last reads past the array, which no test can be asked to notice in a
        kernel, so that a neighbour within the array replaces it."""
        self.repeats: set[ast.expr] = set()
        """How often a loop without a variable runs, commonly until it converges: once more changes nothing by design,
        a single time is the mistake that matters."""
        self.guards: set[ast.expr] = set()
        """Guards against rounding: a tenth more changes nothing by design."""
        self.checks: set[ast.expr] = set()
        """``strict`` of `zip`: like an assertion, a check of the program itself, which never fails in a right one."""
        self.decimals = set(_names_of_decimals(tree))
        """Names of constants of the module that are decimal numbers."""
        for node in ast.walk(tree):
            match node:
                case ast.Subscript(slice=ast.Tuple(elts=parts)):
                    self.indices.update(part for part in parts if _is_count(part))
                case ast.Subscript(slice=part) if _is_count(part):
                    self.indices.add(part)
                case ast.Call(func=ast.Name(id="zip"), keywords=[ast.keyword(arg="strict", value=value)]):
                    self.checks.add(value)
                case ast.For(target=ast.Name(id="_"), iter=ast.Call(func=ast.Name(id="range"), args=[count])):
                    self.repeats.add(count)
                case ast.Compare(left=left, comparators=others):
                    self.guards.update(part for part in _parts([left, *others]) if _is_rounding(part))
                case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name), args=parts) if name in _EXCHANGED:
                    self.guards.update(part for part in _parts(parts) if _is_rounding(part))


def _parts(nodes: list[ast.expr]) -> Iterator[ast.expr]:
    """Expressions and the terms of their sums and products."""
    for node in nodes:
        yield node
        if isinstance(node, ast.BinOp):
            yield from _parts([node.left, node.right])


def _is_count(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and type(node.value) is int


def _is_rounding(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, float) and abs(node.value) <= _ROUNDING


def _names_of_decimals(tree: ast.AST) -> Iterator[str]:
    for node in ast.iter_child_nodes(tree):
        match node:
            case ast.Assign(targets=[ast.Name(id=name)], value=value) if _is_decimal(value, set()):
                yield name
            case ast.Assign(targets=[ast.Tuple(elts=names)], value=ast.Tuple(elts=values)):
                pairs = zip(names, values, strict=False)
                yield from (n.id for n, v in pairs if isinstance(n, ast.Name) and _is_decimal(v, set()))


def _is_decimal(node: ast.expr, names: set[str]) -> bool:
    value = node.operand if isinstance(node, ast.UnaryOp) else node
    if isinstance(value, ast.Name):
        return value.id in names
    return isinstance(value, ast.Constant) and isinstance(value.value, float) and value.value != 0.0


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


def _changes(node: ast.expr, roles: _Roles) -> Iterator[ast.expr]:
    match node:
        case ast.Compare(ops=[operator], left=left, comparators=[right]) if type(operator) in _COMPARISONS:
            changed = copy.deepcopy(node)
            # next to no value is exactly a decimal number other than zero: whether the bound itself belongs to the
            # range cannot be observed there, on which side the range lies can
            decimal = type(operator) in _REVERSED and any(_is_decimal(side, roles.decimals) for side in (left, right))
            changed.ops = [(_REVERSED if decimal else _COMPARISONS)[type(operator)]]
            yield changed
        case ast.BoolOp(op=operator, values=values):
            yield ast.BoolOp(ast.Or() if isinstance(operator, ast.And) else ast.And(), values)
            yield from values if len(values) == 2 else ()
        case ast.BinOp(op=operator) if type(operator) in _ARITHMETIC and not _is_of_types(node):
            yield ast.BinOp(node.left, _ARITHMETIC[type(operator)], node.right)
        case ast.UnaryOp(op=ast.USub() | ast.Not(), operand=operand):
            yield operand
        case ast.Constant() if node in roles.guards or node in roles.checks:
            return
        case ast.Constant(value=value) if node in roles.repeats:
            yield from (ast.Constant(1),) if value != 1 else ()
        case ast.Constant(value=int(value)) if node in roles.indices:
            yield ast.Constant(value - 1 if value > 0 else 1)
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
