"""Every command judges one specification with the same words: run, sequence, sweep, design, coverage, datasheet."""

import json

import pytest

from simulator.cli import _run
from simulator.study.datasheet import run as datasheet_run
from simulator.study.datasheet.sheet import Amounts

pytestmark = pytest.mark.system

CAMERA = """\
base: cubesat_ideal
name: judged
detector: {width: 256, height: 256}
optics: {focal_length_mm: 8, aperture_mm: 5.6}
pointing: {rate_deg_s: [0.02, 0.0, 0.0]}
sequence: {frames: 60, step_s: 5}
specification:
  roll_deg: null
  pitch_deg: null
  yaw_deg: null
  across_deg: LIMIT
  about_boresight_deg: 1.0
  percentile: 50
"""
AMOUNTS = Amounts(2, 40, 4, 3, 1, 3, 8, 3, 200)
"""A small datasheet with the trials of the run."""

# with 50 % 6 frames can show that a requirement is met: 0.5^6 = 0.016; the sequence has 7 independent ones


@pytest.mark.parametrize(
    ("limit_deg", "expected"), [pytest.param(0.02, "met", marks=pytest.mark.slow), (1.0e-5, "not met")]
)
@pytest.mark.usefixtures("no_drawing")
def test_all_commands_give_the_same_verdict(tmp_path, monkeypatch, capsys, limit_deg, expected):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "judged.yaml").write_text(CAMERA.replace("LIMIT", f"{limit_deg:g}"))

    def printed():
        return " ".join(capsys.readouterr().out.split())

    assert _run(["run", "judged.yaml", "--trials", "40", "--out", "run"]) == 0
    text = printed()
    assert f"Specification: {expected}" in text
    summary = json.loads((tmp_path / "run/summary.json").read_text())
    assert summary["verdict"]["verdict"] == expected
    assert " ".join(summary["verdict"]["text"].split()) in text
    assert list(summary["specification"]) == ["across", "about_boresight"]
    page = (tmp_path / "run/report.html").read_text()
    assert summary["verdict"]["text"] in page

    assert _run(["run", "judged.yaml", "--sequence", "--out", "sequence"]) == 0
    assert f"Specification: {expected}" in printed()
    sequence = json.loads((tmp_path / "sequence/sequence.json").read_text())
    assert sequence["verdict"]["verdict"] == expected
    assert sequence["verdict"]["text"] in (tmp_path / "sequence/sequence.html").read_text()
    assert sequence["specification"]["across"]["frames"] <= 60

    sweep = ["sweep", "judged.yaml", "--over", "optics.aperture_mm=5.6,5.7", "--trials", "40", "--out", "sweep"]
    assert _run(sweep) == 0
    table = json.loads((tmp_path / "sweep/sweep.json").read_text())
    assert [point["verdict"]["verdict"] for point in table["points"]] == [expected] * 2
    # the first point is the run
    assert table["points"][0]["verdict"]["text"] == summary["verdict"]["text"]
    assert f"{expected} at 2 points" in " ".join((tmp_path / "sweep/sweep.html").read_text().split()).replace(
        f'<b class="{"good" if expected == "met" else "bad"}">{expected}</b>', expected
    )
    printed()

    over = ["--over", "optics.aperture_mm", "--from", "5.6", "--to", "5.7", "--steps", "2", "--boresights", "200"]
    loose = ["--stars", "3", "--availability", "0.5", "--path", "--verify", "40", "--out", "design"]
    assert _run(["study", "design", "judged.yaml", *over, *loose]) == (0 if expected == "met" else 1)
    design = json.loads((tmp_path / "design/design.json").read_text())
    assert design["points"][0]["met"] is (expected == "met")
    assert design["points"][0]["specification"]["across"]["verdict"] == expected
    if expected == "met":
        assert design["answer"] == 5.6
        # the same trials as those of the run
        assert design["verification"]["verdict"]["text"] == summary["verdict"]["text"]
        assert "Specification: met: smallest margin" in printed()

    assert _run(["study", "coverage", "judged.yaml", "--path", "--boresights", "200", "--out", "coverage"]) == 0
    assert f"Specification: {expected} (predicted)" in printed()
    assert json.loads((tmp_path / "coverage/coverage.json").read_text())["verdict"]["verdict"] == expected

    monkeypatch.setattr(datasheet_run, "QUICK", AMOUNTS)
    printed()
    assert _run(["datasheet", "judged.yaml", "--quick", "--workers", "1", "--out", "datasheet"]) == 0
    (column,) = json.loads((tmp_path / "datasheet/datasheet.json").read_text())["columns"]
    # the same trials as those of the run
    assert column["verdict"] == summary["verdict"]
    assert {name: found["text"] for name, found in column["specification"].items()} == {
        name: found["text"] for name, found in summary["specification"].items()
    }
    assert summary["verdict"]["text"] in (tmp_path / "datasheet/datasheet.html").read_text()
    assert " ".join(summary["verdict"]["text"].split()) in printed()


@pytest.mark.usefixtures("no_drawing")
def test_a_lens_error_within_the_specification_is_reported_and_fails_no_command(tmp_path, monkeypatch, capsys):
    """1 µm of decentring on each axis before 8 mm turns the attitude by 36″ of the 72″ specified, five and more of its
    standard deviations: inconsistent, with the lens as its cause, and neither wrong nor a contradiction."""
    monkeypatch.chdir(tmp_path)
    lens = "optics: {focal_length_mm: 8, aperture_mm: 5.6, thermal: {decentring_um_k: [1.0, 1.0], temperature_c: 21}}"
    text = CAMERA.replace("LIMIT", "0.02").replace("optics: {focal_length_mm: 8, aperture_mm: 5.6}", lens)
    assert "decentring" in text
    (tmp_path / "judged.yaml").write_text(text.replace("frames: 60", "frames: 20"))

    def printed():
        return " ".join(capsys.readouterr().out.split())

    assert _run(["run", "judged.yaml", "--trials", "20", "--out", "run"]) == 0
    shown, summary = printed(), json.loads((tmp_path / "run/summary.json").read_text())
    assert (summary["misidentified"], summary["wrong"], summary["identification_rate"]) == (0, 0, 1.0)
    assert summary["inconsistent"] >= 15
    assert summary["inconsistency"]["likely_cause"] == "displaced"
    assert summary["verdict"]["verdict"] == "met"
    assert f"none wrong, {summary['inconsistent']} inconsistent" in shown
    assert summary["inconsistency"]["text"] in shown
    assert summary["inconsistency"]["text"] in (tmp_path / "run/report.html").read_text()

    assert _run(["run", "judged.yaml", "--sequence", "--single", "--out", "sequence"]) == 0
    sequence = json.loads((tmp_path / "sequence/sequence.json").read_text())
    for found in (sequence, sequence["single"]):
        assert (found["misidentified"], found["wrong"]) == (0, 0)
        assert found["inconsistent"] > 0
    assert sequence["inconsistency"]["likely_cause"] == "displaced"
    assert sequence["inconsistency"]["text"] in printed()
    assert sequence["inconsistency"]["text"] in (tmp_path / "sequence/sequence.html").read_text()

    over = ["--over", "optics.aperture_mm", "--from", "5.6", "--to", "5.7", "--steps", "2", "--boresights", "200"]
    loose = ["--stars", "3", "--availability", "0.5", "--path", "--verify", "20", "--out", "design"]
    assert _run(["study", "design", "judged.yaml", *over, *loose]) == 0
    verification = json.loads((tmp_path / "design/design.json").read_text())["verification"]
    assert verification["contradictions"] == []
    assert verification["inconsistent"] == summary["inconsistent"]

    sweep = ["sweep", "judged.yaml", "--over", "specification.inconsistent_rate=0.05,0.99", "--trials", "20"]
    assert _run([*sweep, "--out", "sweep"]) == 0
    points = json.loads((tmp_path / "sweep/sweep.json").read_text())["points"]
    # where consistency is specified it is judged: 20 of 20 do not show that fewer than 99 % are inconsistent
    loose_verdict = "undecided" if summary["inconsistent"] == 20 else "met"
    assert [point["statistics"]["inconsistent_rate_verdict"] for point in points] == ["not met", loose_verdict]
    assert points[0]["verdict"]["verdict"] == "not met"
    assert {point["statistics"]["inconsistent"] for point in points} == {summary["inconsistent"]}
    assert f"({summary['inconsistent']} inconsistent)" in printed()
