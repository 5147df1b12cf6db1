"""The scenario's list of heads: what they override, and one line with its place for every mistake."""

import json

import pytest

from simulator import Scenario
from simulator.checks import load_scenario
from simulator.scenario.errors import ScenarioError
from simulator.scenario.output import json_schema
from simulator.study.sequence.head_camera import scenario_of_head

HEADS = """base: cubesat_ideal
name: pair
heads:
  - name: a
    mounting: orbit_normal
  - {HEAD}
"""
SECOND = (
    "{name: b, mounting: zenith, alignment_sigma_arcsec: 60, optics: {focal_length_mm: 20}, detector: {exposure_s: 1}}"
)


def write(tmp_path, head):
    file = tmp_path / "pair.yaml"
    file.write_text(HEADS.replace("{HEAD}", head))
    return file


def test_a_head_has_its_own_values_and_otherwise_the_scenarios(tmp_path):
    scenario = Scenario.load(write(tmp_path, SECOND))
    first, second = (scenario_of_head(scenario, head) for head in scenario.heads)
    assert first == scenario.changed({"heads": (), "pointing.mounting": "orbit_normal"})
    assert (second.optics.focal_length_mm, second.detector.exposure_s) == (20.0, 1.0)
    assert second.pointing.mounting == "zenith"
    assert (
        second.changed(
            {
                "optics.focal_length_mm": scenario.optics.focal_length_mm,
                "detector.exposure_s": scenario.detector.exposure_s,
                "pointing.mounting": "orbit_normal",
            }
        )
        == first
    )


def test_written_and_read_again(tmp_path):
    scenario = Scenario.load(write(tmp_path, SECOND))
    for comments in (True, False):
        assert Scenario.parse(scenario.to_yaml(comments)) == scenario
    assert hash(Scenario.parse(scenario.to_yaml())) == hash(scenario)


def test_editors_check_the_keys_that_heads_override(tmp_path):
    jsonschema = pytest.importorskip("jsonschema")
    resolved = json.loads(json.dumps(Scenario.load(write(tmp_path, SECOND)).resolved()))
    jsonschema.validate(resolved, json_schema())
    resolved["heads"][1]["optics"] = {"focal": 1}
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(resolved, json_schema())


def test_files_of_heads_are_relative_to_the_scenario_file(tmp_path, monkeypatch):
    (tmp_path / "curve.csv").write_text("wavelength_nm,value\n400,0.5\n900,0.5\n")
    file = write(tmp_path, "{name: b, mounting: zenith, detector: {quantum_efficiency: curve.csv}}")
    monkeypatch.chdir("/")
    scenario = load_scenario(file)
    assert scenario.heads[1].detector == {"quantum_efficiency": str(tmp_path / "curve.csv")}
    assert scenario.files()["heads[1].detector.quantum_efficiency"] == tmp_path / "curve.csv"


MISTAKES = {
    "{name: b, mounting: zenit}": "6:15: heads[1].mounting: 'zenit' is not one of the mountings",
    "{name: a, mounting: zenith}": "6:6: heads[1].name: 'a' is the name of another head",
    "{name: b}": "6:5: heads: must be a list of {name, mounting, misalignment_arcsec, alignment_sigma_arcsec, …}; "
    "item 2: mounting is missing",
    "{name: b, mounting: zenith, dely_s: 1}": "item 2: unknown key 'dely_s'; did you mean 'delay_s'?",
    "{name: b, mounting: zenith, delay_s: -1}": "item 2: delay_s must be a number of at least 0, not -1",
    "{name: b, mounting: [0, 0, 0, 0]}": "6:15: heads[1].mounting: the quaternion is zero",
    "{name: b, mounting: zenith, time_offset_s: 3}": "6:33: heads[1].time_offset_s: 3 s is not within",
    "{name: b, mounting: zenith, optics: {focal_length: 3}}": "6:42: heads[1].optics.focal_length: unknown key; did",
    "{name: b, mounting: zenith, optics: {focal_length_mm: -3}}": "heads[1].optics.focal_length_mm: must be a number",
    "{name: b, mounting: zenith,\n     optics: {aperture_mm: 1000}}": "7:15: heads[1].optics.aperture_mm: ",
    "{name: b, mounting: zenith, tracker: {identifier: no}}": "6:43: heads[1].tracker.identifier: ",
    "{name: b, mounting: zenith, optics: {psf: 3}}": "6:42: heads[1].optics.psf: must be a section with keys, not 3",
    "{name: b, mounting: zenith, optics: 3}": "item 2: optics must be a section with keys or null, not 3",
    "{name: b, mounting: zenith, tracker: {in_flight_calibration: {use: true}}}": "is not available for a head",
    "3": "6:5: heads: must be a list of",
}


@pytest.mark.parametrize("head", list(MISTAKES))
def test_mistakes(tmp_path, head):
    with pytest.raises(ScenarioError) as caught:
        load_scenario(write(tmp_path, head))
    (line,) = str(caught.value).splitlines()
    assert MISTAKES[head] in line


def test_mistakes_of_values_set_in_python(tmp_path):
    scenario = Scenario.load(write(tmp_path, SECOND))
    with pytest.raises(ValueError, match=r"heads\[0\].optics.aperture: unknown key"):
        scenario.changed({"heads": [{"name": "a", "mounting": "zenith", "optics": {"aperture": 1}}]})
    for key in ("sequence.operation.use", "tracker.in_flight_calibration.use"):
        with pytest.raises(ValueError, match="not available with heads"):
            scenario.changed({key: True})
