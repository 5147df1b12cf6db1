"""Tables of printed values as YAML files, filled in with what was computed."""

from pathlib import Path

import pytest
from ruamel.yaml import YAML

import simulator.theses
from simulator.theses import tables
from simulator.theses.printed import MARKS

FILES = sorted(Path(simulator.theses.__path__[0]).glob("*/data/*.yaml"))


@pytest.fixture
def rows(monkeypatch):
    """`table_rows` of a text."""

    def of(text, **values):
        monkeypatch.setattr(tables, "_entries", lambda _name: YAML(typ="safe").load(text))
        return tables.table_rows("any", values)

    return of


def test_texts_are_filled_in(rows):
    text = """
- where: Fig. 1
  quantity: size of {name}
  printed: about 5
  computed: "{size[0]:.1f} to {size[1]:.1f}"
  verdict: close
  why: by {n:,} frames
"""
    (row,) = rows(text, name="it", size=(4.96, 6.0), n=1200)
    assert (row.where, row.quantity, row.computed, row.why) == ("Fig. 1", "size of it", "5.0 to 6.0", "by 1,200 frames")


@pytest.mark.parametrize(("holds", "verdict"), [(True, "exact"), (False, "differs"), ([], "differs")])
def test_a_verdict_depends_on_a_value(rows, holds, verdict):
    text = "- {where: a, quantity: b, printed: c, computed: d, verdict: exact if holds else differs}"
    assert rows(text, holds=holds)[0].verdict == verdict


def test_numbers_are_judged_by_the_printed_digits(rows):
    text = "- {where: a, quantity: b, printed: '1.89', value: found.um, unit: µm, form: .4f, cut: true, why: c}"
    found = {um: rows(text, found=type("F", (), {"um": um}))[0] for um in (1.893, 1.8954, 1.9)}
    assert [row.verdict for row in found.values()] == ["exact", "exact", "close"]
    assert [row.why for row in found.values()] == ["c", "c; printed digits truncated, not rounded", "c"]
    assert found[1.8954].computed == "1.8954 µm"


def test_the_worst_of_several_numbers_counts(rows):
    text = "- {where: a, quantity: b, printed: ['1.0', '20'], value: both, unit: °}"
    (row,) = rows(text, both=[1.04, 20.6])
    assert (row.printed, row.computed, row.verdict) == ("1.0, 20°", "1.0, 21°", "close")


def test_rows_are_repeated_and_left_out(rows):
    text = """
- each: stars
  rows:
  - {where: a, quantity: "{name} 1", printed: "–", computed: x, verdict: not printed}
  - {where: a, quantity: "{name} 2", printed: "–", computed: x, verdict: not printed, when: known}
"""
    made = rows(text, stars=[{"name": "p", "known": ""}, {"name": "q", "known": "yes"}])
    assert [row.quantity for row in made] == ["p 1", "q 1", "q 2"]


def test_a_value_that_is_not_computed_is_an_error(rows):
    with pytest.raises(KeyError, match="missing"):
        rows("- {where: a, quantity: b, printed: c, computed: '{missing}', verdict: close}")


@pytest.mark.parametrize("file", FILES, ids=lambda file: f"{file.parts[-3]}-{file.stem}")
def test_every_table_has_what_a_row_needs(file):
    entries = YAML(typ="safe").load(file.read_text(encoding="utf-8"))
    for cells in (cells for entry in entries for cells in entry.get("rows", [entry])):
        assert {"where", "quantity", "printed"} <= cells.keys()
        assert ("value" in cells) != ({"computed", "verdict"} <= cells.keys())
        known = {"where", "quantity", "printed", "computed", "verdict", "why", "each", "when"}
        assert cells.keys() <= known | {"value", "unit", "form", "close", "cut"}
        verdict = cells.get("verdict", "exact")
        assert verdict.startswith("{") or {verdict.split(" if ")[0], verdict.split(" else ")[-1]} <= MARKS.keys()
