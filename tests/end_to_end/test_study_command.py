"""``boresight study`` as a user meets it."""

import json

import pytest

from simulator.cli import _run
from simulator.cli.study_command import STUDIES
from simulator.study.budget.effects import EFFECTS

SMALL = ["--set", "detector.width=256", "--set", "detector.height=256"]


def test_a_wrong_name_is_told_with_those_that_there_are(capsys):
    assert _run(["study", "nope"]) == 2
    told = capsys.readouterr().err
    assert len(told.strip().splitlines()) == 1
    assert all(name in told for name in ("nope", *STUDIES))


def test_coverage_leaves_its_files_and_says_the_minimum(tmp_path, capsys):
    out = tmp_path / "c"
    assert (
        _run(["study", "coverage", "cubesat", *SMALL, "--boresights", "300", "--sun-deg", "30", "--out", str(out)]) == 0
    )
    summary = json.loads((out / "coverage.json").read_text())
    printed = capsys.readouterr().out
    assert f"fewest {summary['stars']['min']} at RA {summary['poorest'][0]['ra_deg']:.2f}°" in printed
    assert (out / "map.png").stat().st_size > 10_000
    assert sorted(p.name for p in out.iterdir()) == sorted(
        ["coverage.json", "coverage.parquet", "counts.png", "magnitudes.png", "map.png"]
    )


def test_design_answers_by_its_exit_status(tmp_path, capsys):
    common = [
        "study",
        "design",
        "cubesat",
        *SMALL,
        "--over",
        "optics.aperture_mm",
        "--boresights",
        "200",
        "--steps",
        "3",
    ]
    asked = [
        "--stars",
        "2",
        "--availability",
        "0.5",
        "--set",
        "optics.focal_length_mm=8",
        "--set",
        "optics.aperture_mm=6",
    ]
    assert _run([*common, *asked, "--from", "1", "--to", "12", "--out", str(tmp_path / "d")]) == 0
    best = json.loads((tmp_path / "d" / "design.json").read_text())["best"]["value"]
    assert f"Smallest aperture that meets everything: {best:.4g} mm" in capsys.readouterr().out
    assert _run([*common, *asked, "--from", "0.1", "--to", "0.2", "--out", str(tmp_path / "e")]) == 1
    assert "No aperture in this range" in capsys.readouterr().out


def test_the_budget_is_written_for_the_report(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("simulator.study.budget.error_budget.EFFECTS", EFFECTS[:2])  # each is a run of its own
    out = tmp_path / "b"
    small = [*SMALL, "--set", "optics.focal_length_mm=8", "--set", "optics.aperture_mm=6"]
    assert _run(["study", "budget", "cubesat", *small, "--trials", "3", "--out", str(out)]) == 0
    assert set(json.loads((out / "budget.json").read_text())) >= {"effects", "classes", "rms_deg", "scenario"}
    assert "Error budget of cubesat" in capsys.readouterr().out
    assert sorted(p.name for p in out.iterdir()) == ["budget.json", "budget.png"]


@pytest.mark.parametrize(
    "arguments",
    [
        ["coverage", "cubesat", "--sun-deg", "200"],
        ["coverage", "cubesat", "--boresights", "0"],
        ["coverage", "cubesat", "--path", "--set", "study.sampling=sky"],
        ["coverage", "nowhere.yaml"],
        ["design", "cubesat", "--over", "aperture", "--from", "1", "--to", "2"],
        ["design", "cubesat", "--over", "field", "--from", "2", "--to", "1"],
        ["design", "cubesat", "--over", "field", "--from", "1", "--to", "2", "--verify", "-1"],
        ["budget", "cubesat", "--trials", "1"],
    ],
)
def test_a_mistake_is_one_clear_line_and_leaves_nothing(arguments, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert _run(["study", *arguments]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]
