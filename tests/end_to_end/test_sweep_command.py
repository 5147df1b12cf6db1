"""`boresight sweep` and `boresight compare` as a user meets them."""

import json
import os
import signal
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from simulator.cli import _run
from simulator.cli.sweep_command import SweepProgress

pytestmark = pytest.mark.system


@pytest.mark.usefixtures("no_drawing")
def test_sweep_refuses_reports_and_compares(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    # 100 mm at 15.09 mm would be f/0.15
    assert _run(["sweep", "tc211", "--over", "optics.aperture_mm=12,15,100", "--trials", "5", "--out", "s"]) == 0
    told = capsys.readouterr()
    assert "Refused: optics.aperture_mm 100" in told.out
    assert "f/0.151" in told.out.replace("\n", " ")
    assert {"sweep.parquet", "points.csv", "sweep.json", "sweep.html", "plots"} == {p.name for p in Path("s").iterdir()}
    assert _run(["compare", "s", "--out", "page.html"]) == 0
    assert "optics.aperture_mm: 12, 15" in capsys.readouterr().out
    assert "s:1" in Path("page.html").read_text()
    assert _run(["compare", "s:0", "s:2"]) == 2
    assert "f/0.151" in capsys.readouterr().err
    assert not Path("comparison.html").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ["--over", "optics.aperture_m=10,20"],
        ["--over", "optics.aperture_mm=10,20", "--lhs", "0"],
        ["--over", "optics.aperture_mm=10,20", "--trials", "0"],
        ["--over", "optics.aperture_mm=100,120"],
        [],
    ],
)
def test_mistakes_are_one_clear_line_and_leave_nothing(arguments, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert _run(["sweep", "tc211", *arguments]) == 2
    told = capsys.readouterr()
    assert len(told.err.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "trials_done", [pytest.param(4, id="between points", marks=pytest.mark.slow), pytest.param(5, id="within a point")]
)
@pytest.mark.usefixtures("no_drawing")
def test_interrupt_keeps_finished_points_and_resume_completes_them(trials_done, tmp_path, monkeypatch, capsys):
    command = ["sweep", "tc211", "--out", "s", "--trials", "4", "--workers", "1", "--over", "optics.aperture_mm=14,16"]
    monkeypatch.chdir(tmp_path)
    update = SweepProgress.update

    def interrupt(self, done, total, point):
        update(self, done, total, point)
        if point.index == 1 and trials_done <= done < 8:
            os.kill(os.getpid(), signal.SIGINT)

    with monkeypatch.context() as patch:
        patch.setattr(SweepProgress, "update", interrupt)
        assert _run(command) == 130
    assert "1 of 2 points are finished and kept" in capsys.readouterr().out
    before = json.loads(Path("s/sweep.json").read_text())
    assert [point["status"] for point in before["points"]] == ["done", "not run"]
    assert pq.read_table("s/sweep.parquet").num_rows == 4
    assert "This sweep was interrupted" in Path("s/sweep.html").read_text()
    assert _run([*command, "--resume"]) == 0
    after = json.loads(Path("s/sweep.json").read_text())
    assert (after["interrupted"], after["trials_run"]) == (False, 4)
    assert after["points"][0] == before["points"][0]
    assert pq.read_table("s/sweep.parquet").num_rows == 8
