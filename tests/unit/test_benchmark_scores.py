"""The benchmark judges answers rightly: right, wrong, raised; and says so in its tables."""

import math

import numpy as np
import pytest

from benchmarks import identification
from benchmarks.database import megabytes
from benchmarks.report import OK, RATE_COLUMNS, SHORT, SHORT_OF_STARS, rate_row, write_markdown
from benchmarks.scenes import Case, SceneMaker
from benchmarks.score import IDENTIFIED, NO_MATCH, ROW, WRONG, accuracy, judge, run_case
from benchmarks.solvers import Answer
from startracker.geometry.attitude import rotation_vector_to_matrix
from startracker.identification import METHODS

CASE = Case("scores", target=0.99)


@pytest.fixture(scope="module")
def maker():
    return SceneMaker(CASE)


def _turned(maker, scene, vector):
    return judge(maker, scene, Answer("solved", rotation_vector_to_matrix(np.array(vector)) @ scene.matrix), 0)


def test_the_truth_is_right_and_its_error_nothing(maker):
    row = _turned(maker, maker.scene(0), [0.0, 0.0, 0.0])
    assert row["outcome"] == IDENTIFIED
    np.testing.assert_allclose(row["error"], 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("vector_px_deg", "outcome"),
    [
        ((4.5, 0, 0), IDENTIFIED),
        ((4, 4, 0), WRONG),
        ((0, 5.5, 0), WRONG),
        ((0, 0, 0.9), IDENTIFIED),
        ((0, 0, 1.1), WRONG),
    ],
)
def test_five_pixels_or_a_degree_are_wrong(maker, vector_px_deg, outcome):
    scene = next(s for s in map(maker.scene, range(100)) if s.true_stars > 10)
    x, y, roll = vector_px_deg
    pixel = maker.camera.pixel_rad
    assert _turned(maker, scene, [x * pixel, y * pixel, math.radians(roll)])["outcome"] == outcome


def test_half_a_turn_is_wrong(maker):
    assert _turned(maker, maker.scene(0), [0.0, 0.0, math.pi])["outcome"] == WRONG


def test_any_answer_to_random_points_is_wrong():
    maker = SceneMaker(Case("no sky", sky=False, false_stars=8))
    scene = maker.scene(0)
    assert judge(maker, scene, Answer("solved", scene.matrix), 0)["outcome"] == WRONG
    assert judge(maker, scene, Answer("no_match"), 0)["outcome"] == NO_MATCH


def test_oracle_error_is_near_its_bound(maker):
    """rms of 300 scenes over the rms bound: each has 2 cross axes, so the ratio is good to 1/√(4·300) = 2.9 %; and
    the scenes weigh unevenly: 4 × 4 %."""
    rows = []
    for index in range(300):
        scene = maker.scene(index)
        rows.append(judge(maker, scene, Answer("solved", scene.matrix), index))
    rms = accuracy(np.array(rows, ROW))
    assert rms["oracle"][0] / rms["bound"][0] == pytest.approx(1.0, abs=0.16)
    assert rms["bound_focal"][0] > rms["bound"][0]
    assert rms["bound_focal"][1] == pytest.approx(rms["bound"][1], rel=1e-3)  # scale and roll do not mix
    np.testing.assert_allclose(rms["solver"], 0.0, atol=1e-12)


def _rows(outcomes, true_stars):
    rows = np.zeros(len(outcomes), ROW)
    rows["outcome"], rows["true_stars"] = outcomes, true_stars
    return rows


@pytest.mark.parametrize(
    ("outcomes", "true_stars", "verdict"),
    [
        ([IDENTIFIED] * 100, [9] * 100, OK),
        ([IDENTIFIED] * 97 + [NO_MATCH] * 3, [9] * 100, SHORT),
        ([IDENTIFIED] * 97 + [NO_MATCH] * 3, [9] * 97 + [3] * 3, SHORT_OF_STARS),
        ([IDENTIFIED] * 99 + [WRONG], [9] * 100, SHORT),
        ([IDENTIFIED] * 99 + ["raised"], [9] * 100, SHORT),
    ],
)
def test_verdicts(outcomes, true_stars, verdict):
    row = rate_row(CASE, "any", _rows(outcomes, true_stars))
    assert len(row) == len(RATE_COLUMNS)
    assert row[-1] == verdict


def test_an_exception_is_counted_and_does_not_end_the_run(monkeypatch):
    def broken(*_):
        raise ZeroDivisionError

    monkeypatch.setitem(METHODS, "broken", broken)
    rows = run_case("broken", CASE, 2, seed=1, pool=None)
    assert list(rows["outcome"]) == ["raised", "raised"]


def test_the_long_run_goes_on_where_it_stopped(tmp_path, monkeypatch, capsys):
    done = []

    def run(_name, _case, n, _seed, _pool, start):
        done.append((start, n))
        rows = _rows([IDENTIFIED] * n, [9] * n)
        rows["index"] = np.arange(start, start + n)
        return rows

    monkeypatch.setattr(identification, "run_case", run)
    assert identification.million("any", 15_000, 1, None, tmp_path) == 0
    assert identification.million("any", 30_000, 1, None, tmp_path) == 0
    assert done == [(0, 10_000), (10_000, 5_000), (15_000, 10_000), (25_000, 5_000)]
    assert "100.000 % identified" in capsys.readouterr().out


def test_the_command_line_makes_a_page(tmp_path, capsys):
    page = tmp_path / "page.md"
    words = ["--case", "six brightest", "--identifier", "match_groups", "--n", "3", "--failures", "--out", str(page)]
    assert identification.main(words) == 0
    assert "six brightest" in capsys.readouterr().out
    text = page.read_text()
    assert "| 10deg 6.5, six brightest alone, 0.3 px | match_groups | 3 | 100.00 |" in text
    assert "guide stars" in text


def test_markdown_is_moved_into_place_whole(tmp_path):
    write_markdown(tmp_path / "a.md", "Heading", ["note"], [("Title", ["x", "y"], [["1", "2"]])])
    assert "| x | y |\n|---|---|\n| 1 | 2 |" in (tmp_path / "a.md").read_text()
    assert [path.name for path in tmp_path.iterdir()] == ["a.md"]


def test_arrays_are_counted_once():
    whole = np.zeros(1000)
    assert megabytes({"a": whole, "b": [whole, whole[:10]]}) == pytest.approx(0.008)


def test_the_command_explains_itself(capsys):
    with pytest.raises(SystemExit) as ended:
        identification.parser().parse_args(["--help"])
    assert ended.value.code == 0
    assert "--random-points" in capsys.readouterr().out
