"""``boresight study greyling1995`` as a user meets it."""

import json

import pytest

from simulator.cli import _run
from simulator.theses import greyling1995

pytestmark = pytest.mark.system


@pytest.mark.parametrize("name", ["path", "photometry"])
def test_one_section_prints_its_table_and_leaves_its_files(name, tmp_path, capsys):
    assert _run(["study", "greyling1995", "--section", name, "--out", str(tmp_path / "g")]) == 0
    told = json.loads((tmp_path / "g" / "greyling1995.json").read_text())
    assert list(told["sections"]) == [name]
    rows, figures = told["sections"][name]["rows"], told["sections"][name]["figures"]
    assert sorted(p.name for p in (tmp_path / "g").iterdir()) == sorted(["greyling1995.json", *figures])
    assert all((tmp_path / "g" / figure).stat().st_size > 10_000 for figure in figures)
    printed = capsys.readouterr().out
    assert all(row["verdict"] in printed for row in rows)
    assert all(row["why"] for row in rows if row["verdict"] == "differs")
    counts = ", ".join(f"{n} {verdict}" for verdict, n in told["verdicts"].items())
    assert counts in printed


def test_a_wrong_section_is_told_with_those_that_there_are(tmp_path, capsys):
    assert _run(["study", "greyling1995", "--section", "nope", "--out", str(tmp_path)]) == 2
    told = capsys.readouterr().err
    assert len(told.strip().splitlines()) == 1
    assert all(name in told for name in ("nope", *greyling1995.SECTIONS))


@pytest.mark.slow
def test_the_whole_study(tmp_path, capsys):
    assert _run(["study", "greyling1995", "--out", str(tmp_path)]) == 0
    told = json.loads((tmp_path / "greyling1995.json").read_text())
    assert list(told["sections"]) == list(greyling1995.SECTIONS)
    figures = [figure for section in told["sections"].values() for figure in section["figures"]]
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(["greyling1995.json", *figures])
    rows = [row for section in told["sections"].values() for row in section["rows"]]
    assert all(row["why"] for row in rows if row["verdict"] == "differs")
    assert f"{told['verdicts']['differs']} differs" in capsys.readouterr().out
