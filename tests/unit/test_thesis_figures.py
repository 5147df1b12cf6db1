"""Figures as YAML files: what is drawn, as often as its values say, in the colours of the study."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib import axes
from mpl_toolkits.mplot3d import Axes3D

import simulator.theses
from simulator.study.style import BLUE, GREEN, ORANGE
from simulator.theses import figures
from simulator.theses.figures import draw
from simulator.theses.tables import read_yaml

ROOT = Path(simulator.theses.__path__[0])
FILES = sorted(ROOT.glob("*/figures/*.yaml"))


@pytest.fixture
def drawn(monkeypatch):
    """The axes of a figure from its plan and values."""

    def of(plan, **values):
        monkeypatch.setattr(figures, "_plans", lambda _name: {"fig": {"size": [4, 3], **plan}})
        return draw("any/file/fig", values).axes

    return of


def test_values_colours_and_texts_are_filled_in(drawn):
    plan = {
        "draw": [{"plot": ["$x", "$found.y[0]", "--"], "color": "BLUE", "label": "{count:,} stars"}],
        "set": {"title": "of {name}", "ylim": [0, "$top"]},
        "legend": {"loc": "upper left"},
    }
    (ax,) = drawn(plan, x=[1, 2], found=type("F", (), {"y": [[3, 4]]}), count=1200, name="it", top=9)
    (line,) = ax.lines
    assert (line.get_color(), line.get_linestyle(), line.get_label()) == (BLUE, "--", "1,200 stars")
    np.testing.assert_array_equal(line.get_xydata(), [[1, 3], [2, 4]])
    assert (ax.get_title(), ax.get_ylim()) == ("of it", (0.0, 9.0))
    assert ax.get_legend() is not None


def test_calls_are_repeated_in_their_styles(drawn):
    plan = {"draw": [{"axhline": ["$y"], "each": "lines", "styles": [{"color": "ORANGE"}, {"color": "GREEN"}]}]}
    (ax,) = drawn(plan, lines=[{"y": 1}, {"y": 2}, {"y": 3}])
    assert [line.get_color() for line in ax.lines] == [ORANGE, GREEN, ORANGE]


def test_panels_are_repeated_and_share_what_is_in_every_one(drawn):
    panel = {"each": "panels", "draw": [{"plot": ["$x", "$x"]}], "set": {"xlabel": "{name}"}}
    plan = {"grid": [1, 2], "panels": [panel], "every": {"draw": [{"circle": [[0, 0], 1]}], "set": {"ylabel": "y"}}}
    found = drawn(plan, panels=[{"x": [1], "name": "a"}, {"x": [2], "name": "b"}])
    assert [ax.get_xlabel() for ax in found] == ["a", "b"]
    assert [(ax.get_ylabel(), len(ax.patches)) for ax in found] == [("y", 1), ("y", 1)]


def test_a_value_that_is_not_there_is_an_error(drawn):
    with pytest.raises(KeyError, match="missing"):
        drawn({"draw": [{"plot": ["$missing"]}]})


@pytest.mark.parametrize("file", FILES, ids=lambda file: f"{file.parts[-3]}-{file.stem}")
def test_every_figure_has_what_a_figure_needs(file):
    for plan in read_yaml(str(file.relative_to(ROOT).with_suffix(""))).values():
        assert plan.keys() <= {"size", "grid", "axes", "suptitle", "panels", "every", "figure_legend", "with", *_PANEL}
        for panel in [*plan.get("panels", [plan]), plan.get("every", {})]:
            for call in panel.get("draw", []):
                method = next(iter(call))
                known = hasattr(axes.Axes, method) or hasattr(Axes3D, method)
                assert known or method in ("circle", "rectangle"), method


_PANEL = ("draw", "set", "legend", "projection", "each")
