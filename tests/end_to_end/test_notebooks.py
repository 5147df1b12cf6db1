"""Every notebook ships with the outputs of a run, and runs again from its first cell to its last with the same ones."""

import re
from pathlib import Path

import pytest
from run_notebooks import executed, valid

pytestmark = pytest.mark.system

FOLDER = Path(__file__).resolve().parents[2] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
LARGEST_BYTES = 1_500_000
VARIES = "varies"
"""Tag of cells that print times of this machine."""
_NUMBER = re.compile(r"[-−+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
_COLUMN = re.compile(r"-{3,}| {2,}")
"""Rules and spaces of tables, as long as the last digits of the numbers need."""
_PICTURES = ("image/png", "image/jpeg")

each_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
LONG = {"accuracy", "greyling1995", "missions", "physics", "tracker", "yee1999"}
"""Notebooks of seven seconds and more of computing, whose functions have tests of their own."""


def code_cells(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def shown(cell):
    """Kinds of what a cell shows, in order; streams joined, as they may be cut anywhere."""
    kinds = [sorted(out.get("data", {})) or ["text"] for out in cell.outputs]
    return [kind for k, kind in enumerate(kinds) if kind != ["text"] or kind not in kinds[:k]]


def printed(cell):
    """Text that a cell prints, and the descriptions of the objects that it shows."""
    stream = "".join(out.text for out in cell.outputs if out.output_type == "stream")
    return "\n".join([stream, *(out.data["text/plain"] for out in cell.outputs if out.output_type == "execute_result")])


def words(cell):
    """Text that a cell prints, without its numbers and the widths of its columns."""
    return _COLUMN.sub(" ", _NUMBER.sub("#", printed(cell)))


@each_notebook
def test_notebook_ships_executed(path):
    notebook = valid(path)
    cells = code_cells(notebook)
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1)), "run make notebooks"
    for cell in cells:
        assert not [out for out in cell.outputs if out.output_type == "error"]
        assert "Traceback" not in printed(cell)
        assert "Warning" not in printed(cell)
        assert " object at 0x" not in printed(cell)
    assert path.stat().st_size < LARGEST_BYTES


@each_notebook
def test_notebook_teaches(path):
    """Steps with headings, a question or an exercise, a slider with its figure beside it."""
    notebook = valid(path)
    text = "\n".join(cell.source for cell in notebook.cells if cell.cell_type == "markdown")
    assert len(re.findall(r"^## ", text, re.MULTILINE)) >= 3
    assert re.search(r"\*\*Question[.:]\*\*", text)
    assert "**Exercise" in text
    sliders = [cell for cell in code_cells(notebook) if "with_sliders(" in cell.source]
    assert sliders
    for cell in sliders:
        assert any("image/png" in out.get("data", {}) for out in cell.outputs), "a figure is there without a kernel"


@pytest.mark.parametrize(
    "path",
    [pytest.param(path, id=path.stem, marks=[pytest.mark.slow] * (path.stem in LONG)) for path in NOTEBOOKS],
)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of the notebook client's own event loop
def test_notebook_runs_as_stored(path):
    stored, again = valid(path), executed(path)
    for old, new in zip(code_cells(stored), code_cells(again), strict=True):
        assert shown(old) == shown(new), f"run make notebooks; the outputs differ of:\n{new.source}"
        if VARIES in old.metadata.get("tags", ()):
            continue
        assert words(old) == words(new), f"run make notebooks:\n{new.source}"
        before, after = ([float(n.replace("−", "-")) for n in _NUMBER.findall(printed(c))] for c in (old, new))
        assert after == pytest.approx(before, rel=0.05, abs=0.02), f"run make notebooks:\n{new.source}"
    pictures = [out for cell in code_cells(again) for out in cell.outputs if set(_PICTURES) & set(out.get("data", {}))]
    assert len(pictures) >= 2
