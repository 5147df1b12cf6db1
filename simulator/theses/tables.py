"""Tables of printed values as YAML files, completed with computed values.

A file is a list of rows. ``where``, ``quantity``, ``printed``, ``computed``, ``verdict`` and ``why`` are the columns of
`Row`, each a format string over the section's values by name (``{disk_um:.2f}``). Instead of ``computed`` and
``verdict`` a row may have one value:

``value``
    A number, or a list of numbers for a list of printed ones, compared by `verdict_of`, with ``unit``, ``form`` and
    ``close`` as in `compare`. ``cut: true``: also exact if the printed digits are those of the truncated computed
    number, as printed by Matlab.

``verdict: exact if NAME else differs`` depends on a value. A row with ``each: NAME`` is repeated for every mapping of
that list, whose entries are added to the values; ``rows`` repeats several rows together. A row with ``when: NAME`` is
omitted if that value is empty.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from decimal import Decimal
from functools import lru_cache
from importlib.resources import files
from string import Formatter
from typing import Any

from simulator.theses.printed import Row, Verdict, compare, verdict_of, with_unit

Values = dict[str, Any]

_ORDER: tuple[Verdict, ...] = ("exact", "close", "differs")
_CUT_OFF = "printed digits truncated, not rounded"


def table_rows(name: str, values: Mapping[str, Any]) -> list[Row]:
    """Rows of a table.

    Parameters
    ----------
    name : str
        Folder and name of the file, such as ``"greyling1995/path"``.
    values : dict
        Values used by its rows.

    Raises
    ------
    KeyError
        If a row uses an unknown value.
    """
    rows = []
    for entry in _entries(name):
        items: Sequence[Mapping[str, Any]] = values[entry["each"]] if "each" in entry else [{}]
        for item in items:
            known = {**values, **item}
            chosen = (cells for cells in entry.get("rows", [entry]) if "when" not in cells or known[cells["when"]])
            rows += [_row(cells, known) for cells in chosen]
    return rows


@lru_cache(maxsize=32)
def _entries(name: str) -> list[dict[str, Any]]:
    folder, file = name.split("/")
    return list(read_yaml(f"{folder}/data/{file}"))


def read_yaml(name: str) -> Any:
    """Content of a file of this package, such as ``"greyling1995/data/path"``."""
    from ruamel.yaml import YAML

    return YAML(typ="safe").load((files("simulator.theses") / f"{name}.yaml").read_text(encoding="utf-8"))


def _row(cells: Mapping[str, Any], values: Mapping[str, Any]) -> Row:
    where, quantity, why = (cells.get(key, "").format_map(values) for key in ("where", "quantity", "why"))
    printed = cells["printed"]
    if "value" not in cells:
        computed = cells["computed"].format_map(values)
        return Row(where, quantity, printed.format_map(values), computed, _verdict(cells["verdict"], values), why)
    computed = value_of(cells["value"], values)
    known = {key: cells[key] for key in ("unit", "close", "form") if key in cells}
    if isinstance(computed, Sequence):
        texts = printed if isinstance(printed, list) else value_of(printed, values)
        return _several(where, quantity, texts, computed, why=why, **known)
    text = printed.format_map(values)
    row = compare(where, quantity, text, float(computed), why=why, **known)
    return exact_when_cut(row, text, float(computed)) if cells.get("cut") else row


def value_of(name: str, values: Mapping[str, Any]) -> Any:
    """A value by name, or a part of one, such as ``curve.at_deg`` or ``found[0]``; functions are called."""
    found = Formatter().get_field(name, (), values)[0]
    return found() if callable(found) else found


def _verdict(text: str, values: Mapping[str, Any]) -> Any:
    if " if " not in text:
        return text.format_map(values)
    true, _, rest = text.partition(" if ")
    name, _, false = rest.partition(" else ")
    return true if value_of(name, values) else false


def exact_when_cut(row: Row, printed: str, computed: float) -> Row:
    """The row, with verdict exact if the printed digits are those of the truncated computed number."""
    step = 10.0 ** int(Decimal(printed).as_tuple().exponent)
    if row.verdict == "exact" or math.floor(computed / step + 1e-9) != round(float(printed) / step):
        return row
    return replace(row, verdict="exact", why=f"{row.why}; {_CUT_OFF}" if row.why else _CUT_OFF)


def worst(verdicts: Sequence[Verdict]) -> Verdict:
    """The worst of several verdicts of a comparison."""
    return max(verdicts, key=_ORDER.index)


def _several(
    where: str, quantity: str, printed: Sequence[str], computed: Sequence[float], *, unit: str = "",
    close: float = 0.05, why: str = "",
) -> Row:  # fmt: skip
    """Row of several numbers in the same unit; its verdict is the worst of their verdicts."""
    pairs = list(zip(printed, computed, strict=True))
    verdict = worst([verdict_of(text, float(value), close) for text, value in pairs])
    shown = [f"{value:.{max(-int(Decimal(text).as_tuple().exponent), 0)}f}" for text, value in pairs]
    return Row(where, quantity, with_unit(", ".join(printed), unit), with_unit(", ".join(shown), unit), verdict, why)
