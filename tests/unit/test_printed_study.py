"""Rows that compare a printed value with a computed one, and the study's table and files."""

import io
import json

import pytest
from rich.console import Console

from simulator.theses.printed import (
    MARKS,
    NOTHING,
    PrintedStudy,
    Row,
    Section,
    compare,
    new_figure,
    run_sections,
    verdict_of,
)
from startracker.errors import InputError


@pytest.mark.parametrize(
    ("printed", "computed", "verdict"),
    [
        ("5.50", 5.504, "exact"),
        ("5.50", 5.506, "close"),
        ("5.50", 5.8, "differs"),
        ("1,266", 1266.4, "exact"),
        ("1,266", 1261.0, "close"),
        ("2.1e-14", 2.149e-14, "exact"),
        ("2.1e-14", 2.151e-14, "close"),
        ("−1.47", -1.4702, "exact"),
        ("0", 0.4, "exact"),
        ("0", 1.0, "differs"),
        ("13", 13.5, "exact"),  # half of the last digit counts
        ("63.76", 63.765, "exact"),
    ],
)
def test_verdict_follows_the_printed_digits(printed, computed, verdict):
    assert verdict_of(printed, computed) == verdict


def test_how_close_is_close():
    assert verdict_of("100", 108.0) == "differs"
    assert verdict_of("100", 108.0, close=0.1) == "close"


def test_what_is_no_number_is_told():
    with pytest.raises(ValueError, match="'about 30' is not a number"):
        verdict_of("about 30", 31.4)


@pytest.mark.parametrize(
    ("printed", "value", "unit", "shown"),
    [
        ("5.5", 5.405, "mV", "5.405 mV"),
        ("8.6", 8.6, "°", "8.600°"),
        ("1,266", 1261.0, "", "1,261"),
        ("253440", 253440.0, "bits", "253440 bits"),
        ("248", 247.5, "kbits", "247.50 kbits"),
        ("2.65e-6", 2.65e-6, "lx", "2.6500e-06 lx"),
    ],
)
def test_computed_value_has_two_digits_more(printed, value, unit, shown):
    row = compare("here", "it", printed, value, unit=unit)
    assert row.computed == shown
    assert row.printed.startswith(printed)


@pytest.mark.parametrize("verdict", ["exact", "close", "differs", "input missing", "open"])
def test_a_row_without_a_printed_value_is_not_printed(verdict):
    for printed in ("", NOTHING):
        with pytest.raises(ValueError, match="is inconsistent with verdict"):
            Row("1", "a", printed, "2", verdict)
    with pytest.raises(ValueError, match="is inconsistent with verdict"):
        Row("1", "a", "2", "2", "not printed")
    assert Row("1", "a", NOTHING, "2", "not printed").verdict in MARKS


def study():
    def draw():
        figure, ax = new_figure()
        ax.plot([1, 2], label="a")
        ax.legend()
        return figure

    rows = [
        compare("(A.12)", "a [θ_E0] & more", "5.50", 5.504, unit="mV"),
        Row("3.3", "b", "x", "y", "differs", "why not"),
    ]
    return run_sections("t1995", "A Title 1995", {"one": lambda: Section("One", rows, {"fig_1": draw})})


def test_table_shows_every_cell_and_counts_the_verdicts():
    stream = io.StringIO()
    study().print(Console(file=stream, width=120))
    told = stream.getvalue()
    for text in (
        "A Title 1995",
        "One",
        "a [θ_E0] & more",
        "5.50 mV",
        "5.5040 mV",
        "why not",
        "1 exact, 0 close, 1 differs, 0 not printed, 0 input missing, 0 open",
    ):
        assert text in told


def test_files(tmp_path):
    assert study().write(tmp_path / "new") == ["t1995.json", "fig_1.png"]
    told = json.loads((tmp_path / "new" / "t1995.json").read_text())
    assert told["verdicts"] == {"exact": 1, "close": 0, "differs": 1, "not printed": 0, "input missing": 0, "open": 0}
    assert told["sections"]["one"]["rows"][1] == {
        "where": "3.3",
        "quantity": "b",
        "printed": "x",
        "computed": "y",
        "verdict": "differs",
        "why": "why not",
    }
    assert told["sections"]["one"]["figures"] == ["fig_1.png"]
    picture = (tmp_path / "new" / "fig_1.png").read_bytes()
    assert picture.startswith(b"\x89PNG")
    study().write(tmp_path / "again")
    assert (tmp_path / "again" / "fig_1.png").read_bytes() == picture  # the same figure is the same file


def test_notebook_table_is_escaped():
    html = study().sections["one"]._repr_html_()
    assert "a [θ_E0] &amp; more" in html
    assert html.count("<tr>") == 3


def test_only_one_section_is_computed_and_a_wrong_name_is_told():
    called = []
    registry = {name: lambda name=name: called.append(name) or Section(name, []) for name in ("a", "b")}
    done = run_sections("t", "T", registry, "b", progress=lambda name: called.append(f"now {name}"))
    assert isinstance(done, PrintedStudy)
    assert called == ["now b", "b"]
    with pytest.raises(InputError, match="unknown section 'c'; use one of a, b"):
        run_sections("t", "T", registry, "c")
