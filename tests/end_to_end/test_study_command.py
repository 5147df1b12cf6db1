"""``boresight study`` as a user meets it."""

import json

import pytest

from simulator.cli import _run
from simulator.cli.study_command import STUDIES
from simulator.study.budget.effects import EFFECTS
from simulator.study.trials.trial import TrialRunner

pytestmark = pytest.mark.system

SMALL = ["--set", "detector.width=256", "--set", "detector.height=256"]


def test_a_wrong_name_is_told_with_those_that_there_are(capsys):
    assert _run(["study", "nope"]) == 2
    told = capsys.readouterr().err
    assert len(told.strip().splitlines()) == 1
    assert all(name in told for name in ("nope", *STUDIES))


def test_coverage_leaves_its_files_and_says_the_minimum(tmp_path, capsys):
    out = tmp_path / "c"
    assert (
        _run(
            ["study", "coverage", "cubesat_ideal", *SMALL, "--boresights", "300", "--sun-deg", "30", "--out", str(out)]
        )
        == 0
    )
    summary = json.loads((out / "coverage.json").read_text())
    printed = capsys.readouterr().out
    assert f"fewest {summary['stars']['min']} at RA {summary['poorest'][0]['ra_deg']:.2f}°" in printed
    assert (out / "map.png").stat().st_size > 10_000
    assert sorted(p.name for p in out.iterdir()) == sorted(
        ["coverage.json", "coverage.parquet", "counts.png", "magnitudes.png", "map.png"]
    )


@pytest.mark.usefixtures("no_drawing")
def test_coverage_says_which_angle_excludes_everything(tmp_path, capsys):
    """A camera that looks down, and a baffle whose angles were left as they are by default."""
    down = ["--path", "--boresights", "20", "--set", "pointing.offset_deg=[90,0,0]"]
    asked = ["study", "coverage", "cubesat_ideal", *SMALL, *down, "--set", "optics.baffle.pst=vane"]
    assert _run([*asked, "--out", str(tmp_path / "c")]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    earth = "excluded by the Earth, within 25° of its limb (optics.baffle.earth_exclusion_deg, the default)"
    assert f"100.00 % of the time {earth}" in printed
    assert "excluded by the Moon, within 20° of its centre (optics.baffle.moon_exclusion_deg, the default)" in printed
    others = "the options --sun-deg, --moon-deg and --earth-deg set other angles"
    assert f"everything is excluded by optics.baffle.earth_exclusion_deg, the default; {others}" in printed
    angles = json.loads((tmp_path / "c" / "coverage.json").read_text())["exclusion_deg"]
    assert angles == {"sun": 35.0, "moon": 20.0, "earth": 25.0}
    more = ["--earth-deg", "10", "--set", "optics.baffle.moon_exclusion_deg=12"]
    assert _run([*asked, *more, "--out", str(tmp_path / "d")]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "within 10° of its limb (--earth-deg)" in printed
    assert "within 12° of its centre (optics.baffle.moon_exclusion_deg, as set)" in printed


@pytest.mark.usefixtures("no_drawing")
def test_design_answers_by_its_exit_status(tmp_path, capsys):
    common = [
        "study",
        "design",
        "cubesat_ideal",
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
        "--verify",
        "0",
        "--set",
        "optics.focal_length_mm=8",
        "--set",
        "optics.aperture_mm=6",
    ]
    assert _run([*common, *asked, "--from", "1", "--to", "12", "--out", str(tmp_path / "d")]) == 0
    best = json.loads((tmp_path / "d" / "design.json").read_text())["best"]["value"]
    assert f"Smallest aperture predicted to meet the specification: {best:.4g} mm" in capsys.readouterr().out
    assert _run([*common, *asked, "--from", "0.1", "--to", "0.2", "--out", str(tmp_path / "e")]) == 1
    assert "No aperture in this range" in capsys.readouterr().out


@pytest.mark.usefixtures("no_drawing")
def test_a_design_that_its_verification_contradicts_fails(tmp_path, capsys, monkeypatch):
    """Every frame is off by some hundred times what was predicted."""
    command = ["study", "design", "cubesat_ideal", *SMALL, "--over", "optics.aperture_mm", "--boresights", "200"]
    command += ["--from", "14", "--to", "18", "--steps", "2", "--stars", "2", "--availability", "0.2", "--verify", "20"]
    command += ["--set", "optics.focal_length_mm=20", "--set", "optics.aperture_mm=16"]
    assert _run([*command, "--out", str(tmp_path / "good")]) == 0
    assert "The verification does not contradict the prediction" in " ".join(capsys.readouterr().out.split())
    assert json.loads((tmp_path / "good" / "design.json").read_text())["verification"]["contradicted"] is False
    honest = TrialRunner.run

    def off(self, index):
        row = honest(self, index)
        return row | ({"error_roll_deg": 0.4, "error_yaw_deg": 0.2} if row["status"] == "solved" else {})

    monkeypatch.setattr(TrialRunner, "run", off)
    assert _run([*command, "--out", str(tmp_path / "bad")]) == 1
    printed = " ".join(capsys.readouterr().out.split())
    assert "The verification contradicts the prediction at aperture 14 mm: roll: 99.7 % below 0.4000°" in printed
    assert "No aperture up to 18 mm is confirmed." in printed
    told = json.loads((tmp_path / "bad" / "design.json").read_text())["verification"]
    assert told["contradicted"] is True
    assert told["verdict"]["verdict"] == "not met"
    assert json.loads((tmp_path / "bad" / "design.json").read_text())["answer"] is None
    assert any("yaw" in reason for reason in told["contradictions"])


@pytest.mark.usefixtures("no_drawing")
def test_the_budget_is_written_for_the_report(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("simulator.study.budget.error_budget.EFFECTS", EFFECTS[:2])  # each is a run of its own
    out = tmp_path / "b"
    small = [*SMALL, "--set", "optics.focal_length_mm=8", "--set", "optics.aperture_mm=6"]
    assert _run(["study", "budget", "cubesat_ideal", *small, "--trials", "3", "--out", str(out)]) == 0
    assert set(json.loads((out / "budget.json").read_text())) >= {"effects", "classes", "rms_deg", "scenario"}
    assert "Error budget of cubesat" in capsys.readouterr().out
    assert sorted(p.name for p in out.iterdir()) == ["budget.json", "budget.png"]


@pytest.mark.parametrize(
    "arguments",
    [
        ["coverage", "cubesat_ideal", "--sun-deg", "200"],
        ["coverage", "cubesat_ideal", "--boresights", "0"],
        ["coverage", "cubesat_ideal", "--path", "--set", "study.sampling=sky"],
        ["coverage", "nowhere.yaml"],
        ["design", "cubesat_ideal", "--over", "aperture", "--from", "1", "--to", "2"],
        ["design", "cubesat_ideal", "--over", "field", "--from", "2", "--to", "1"],
        ["design", "cubesat_ideal", "--over", "field", "--from", "1", "--to", "2", "--verify", "-1"],
        ["budget", "cubesat_ideal", "--trials", "1"],
    ],
)
def test_a_mistake_is_one_clear_line_and_leaves_nothing(arguments, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert _run(["study", *arguments]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


@pytest.mark.usefixtures("no_drawing")
def test_results_of_another_study_are_not_replaced(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("simulator.study.budget.error_budget.EFFECTS", EFFECTS[:1])
    small = ["cubesat_ideal", *SMALL, "--set", "optics.focal_length_mm=8", "--set", "optics.aperture_mm=6"]
    over = ["--over", "optics.aperture_mm", "--from", "4", "--to", "8", "--steps", "2", "--verify", "0"]
    for name, options, amount, others in [
        ("coverage", ["--boresights", "40"], "40 boresights", [["--boresights", "30"], ["--snr", "9"]]),
        ("design", [*over, "--boresights", "40"], "40 boresights", [["--boresights", "30"], ["--stars", "2"]]),
        ("budget", ["--trials", "3"], "3 trials", [["--trials", "2"], ["--set", "optics.psf.sigma_px=0.77"]]),
    ]:
        out = tmp_path / name
        command = ["study", name, *small, *options, "--out", str(out)]
        assert _run(command) == 0
        before = {path.name: path.read_bytes() for path in out.iterdir()}
        for other in (*others, ["--set", "seed=9"]):
            assert _run([*command, *other]) == 2
            told = capsys.readouterr().err
            assert len(told.strip().splitlines()) == 1
            assert f"(scenario 'cubesat_ideal', seed 1, {amount}, boresight " in told
            assert told.strip().endswith("choose another --out, or replace them with --force")
            assert {path.name: path.read_bytes() for path in out.iterdir()} == before
        assert _run(command) == 0
        if name == "coverage":
            assert _run([*command, *others[0], "--force"]) == 0
