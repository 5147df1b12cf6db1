"""``boresight validate``, ``show`` and ``schema``: what they print, and their exit status; and the checks of names."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from simulator.build import build_damage
from simulator.checks import NAME_CHECKS, load_scenario
from simulator.cli.scenario_commands import schema, show, validate
from simulator.scenario import Scenario, ScenarioError

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = ["sunsat", "cubesat", "cubesat_ideal", "tc211"]


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_scenarios_name_what_exists(name):
    assert load_scenario(ROOT / f"scenarios/{name}.yaml").name == name


def test_validate_prints_a_line_for_each(capsys):
    good = ROOT / "scenarios/cubesat_ideal.yaml"
    assert validate([good, good]) == 0
    assert capsys.readouterr().out == f"{good}: ok\n" * 2


def test_validate_repeats_what_is_unphysical_and_allowed(capsys):
    assert validate([ROOT / "scenarios/sunsat.yaml"]) == 0
    assert "sunsat.yaml: unphysical, but allowed: optics.aperture_mm: 120 mm" in capsys.readouterr().out


def test_validate_goes_on_after_a_bad_file(tmp_path, capsys):
    bad = tmp_path / "bad.yaml"
    bad.write_text("name: x\nsed: 1\n")
    assert validate([bad, ROOT / "scenarios/cubesat_ideal.yaml"]) == 2
    printed = capsys.readouterr()
    assert f"{bad}:2:1: sed: unknown key; did you mean 'seed'?" in printed.err
    assert printed.out.endswith("cubesat_ideal.yaml: ok\n")


@pytest.mark.parametrize("name", SHIPPED)
def test_show_loads_again_to_the_same(name, tmp_path, capsys):
    path = ROOT / f"scenarios/{name}.yaml"
    assert show(path, ["study.trials=7"]) == 0
    printed = capsys.readouterr().out
    assert "# Focal length. [mm]" in printed
    again = tmp_path / "again.yaml"
    again.write_text(printed, encoding="utf-8")
    assert Scenario.load(again) == load_scenario(path, ["study.trials=7"])


def test_show_of_a_mistake(capsys):
    assert show("cubesat_ideal", ["study.trails=7"]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err == "--set study.trails: unknown key; did you mean 'study.trials'?\n"


def test_schema_is_json(capsys):
    assert schema() == 0
    assert json.loads(capsys.readouterr().out)["title"] == "boresight scenario"


@pytest.mark.parametrize("path", sorted(NAME_CHECKS))
def test_unknown_names_are_told_where_they_stand(path):
    with pytest.raises(ScenarioError) as caught:
        load_scenario("cubesat_ideal", [f"{path}=nosuchthing"])
    (line,) = str(caught.value).splitlines()
    assert line.startswith(f"--set {path}: ")
    assert "nosuchthing" in line


def test_missing_curve_file_is_told(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ScenarioError, match=r"^--set optics\.transmission: .*glass\.csv"):
        load_scenario("cubesat_ideal", ["optics.transmission=glass.csv"])


def test_a_quaternion_is_a_mounting():
    scenario = load_scenario("cubesat_ideal", ["pointing.mounting=[0, 0, 0, 1]"])
    assert scenario.pointing.mounting == (0.0, 0.0, 0.0, 1.0)


def test_the_commands_load_nothing_heavy():
    code = "import sys, simulator.cli.scenario_commands; print({'pydantic', 'numpy', 'ruamel'} & set(sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT, env={**os.environ}
    )
    assert done.stdout == "set()\n"


def test_show_of_an_aged_camera_has_derived_values(tmp_path, capsys):
    """The increase of the mean dark current against the coefficients of the damage, at the detector's temperature.
    Telegraph pixels are in the lower level. 99,000 interactions with exponentially distributed currents scatter by
    √2/√99,000 = 0.45 %: four of these, and the three digits that are printed."""
    pytest.importorskip("aep8")
    assert show("aged") == 0
    printed = capsys.readouterr().out
    again = tmp_path / "again.yaml"
    again.write_text(printed, encoding="utf-8")
    aged = load_scenario("aged")
    assert Scenario.load(again) == aged
    derived = printed[printed.index("# Derived values:") :]
    assert "after 5 years behind 3 mm of aluminium (nominal estimate), detector at 20 °C" in derived
    means = [float(found) for found in re.findall(r"mean ([\d.e+]+),", derived)]
    damage, detector = build_damage(aged), aged.detector
    warmth = 2.0 ** ((detector.temperature_c - detector.dark_reference_c) / detector.dark_doubling_c)
    expected = (damage.dark_current_e_s + damage.displacement.mean_e_s) * warmth
    assert means[0] - means[1] == pytest.approx(expected, rel=0.02)
    assert show("cubesat_ideal") == 0
    assert "Derived" not in capsys.readouterr().out


def test_show_names_where_each_value_is_written(tmp_path, capsys):
    own = tmp_path / "own.yaml"
    own.write_text("base: cubesat\noptics: {aperture_mm: 12}\n")
    assert show(own, ["detector.width=300"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert f"  aperture_mm: 12.0  # {own}:2" in lines
    assert "  width: 300  # --set detector.width" in lines
    assert any(re.fullmatch(r"  faint_magnitude_limit: 12.0  # cubesat.yaml:\d+", line) for line in lines)
    assert any(re.fullmatch(r"  focal_length_mm: 25.0  # cubesat_ideal.yaml:\d+", line) for line in lines)
    assert "  obscuration: 0.0" in lines  # a default
    assert Scenario.parse("\n".join(lines)) == Scenario.load(own, ["detector.width=300"])
