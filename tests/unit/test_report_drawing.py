"""Pages drawn by another process: the same, and one clear line where it fails."""

import operator
import pickle

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from simulator.study.pages import drawing
from simulator.study.pages.drawing import drawn_apart
from simulator.study.trials.columns import Columns
from startracker.errors import BoresightError


@pytest.fixture(autouse=True)
def another_process(process_of_pages, monkeypatch):
    monkeypatch.setattr(drawing, "in_a_process", process_of_pages)


def test_the_page_comes_back_as_it_was_drawn():
    assert drawn_apart(operator.methodcaller("upper"), "ö" * 200_000) == "Ö" * 200_000
    assert drawn_apart(operator.methodcaller("encode"), "°") == "°".encode()


def test_a_process_that_fails_says_why_in_one_line():
    with pytest.raises(BoresightError, match=r"^the page could not be drawn: AttributeError: .*nowhere"):
        drawn_apart(operator.attrgetter("nowhere"), "page")


def test_columns_go_to_another_process_without_what_was_read(tmp_path):
    pq.write_table(pa.table({"index": np.arange(100_000)}), tmp_path / "trials.parquet")
    columns = Columns(tmp_path / "trials.parquet")
    whole = columns["index"]
    posted = pickle.dumps(columns)
    assert len(posted) < 0.1 * whole.nbytes
    assert np.array_equal(pickle.loads(posted)["index"], whole)
