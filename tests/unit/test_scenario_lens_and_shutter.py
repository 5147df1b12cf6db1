"""Keys of projection, vignetting, ghosts, temperature, jitter and shutter: read, written, refused."""

from pathlib import Path

import pytest

from simulator.scenario import Scenario, ScenarioError

CUBESAT = Path(__file__).resolve().parents[2] / "scenarios/cubesat_ideal.yaml"
GHOSTS = "optics.ghosts=[{flux: 1e-4, scale: -0.6, radius_px: 12}, {flux: 1e-5, scale: 2, radius_px: 30}]"


def test_defaults_change_nothing():
    optics, detector = (s := Scenario.load(CUBESAT)).optics, s.detector
    assert (optics.projection, optics.ghosts, detector.shutter) == ("pinhole", (), "global")
    assert optics.thermal.expansion_ppm_k == 0.0
    assert s.pointing.jitter.rms_arcsec == (0.0, 0.0, 0.0)


def test_a_list_of_sections_is_read_and_written():
    scenario = Scenario.load(CUBESAT, [GHOSTS])
    assert [ghost.scale for ghost in scenario.optics.ghosts] == [-0.6, 2.0]
    assert Scenario.parse(scenario.to_yaml()) == scenario
    assert scenario.resolved()["optics"]["ghosts"][1] == {"flux": 1e-5, "scale": 2.0, "radius_px": 30.0}
    assert hash(scenario) != hash(Scenario.load(CUBESAT))


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("optics.ghosts=[{flux: 2, scale: 1, radius_px: 1}]", "must be a list of {flux, scale, radius_px}"),
        ("optics.ghosts=[{flux: 0.1, scale: 1, radius: 1}]", "must be a list of"),
        ("optics.ghosts={flux: 0.1}", "must be a list of"),
        ("optics.projection=fishye", "did you mean 'fisheye'"),
        ("detector.shutter=roling", "did you mean 'rolling'"),
        ("optics.vignetting.mechanical_end_deg=90", "below 90°"),
        ("pointing.jitter.psd=table", "needs a CSV file"),
    ],
)
def test_refusals(override, message):
    with pytest.raises(ScenarioError, match=message):
        Scenario.load(CUBESAT, [override])


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["optics.projection=fisheye", "optics.distortion.p1=0.1"], "has no such coefficient; use k1 to k4"),
        (["optics.projection=equisolid", "optics.distortion.k1=0.1"], "use projection: fisheye"),
        (
            ["optics.vignetting.mechanical_start_deg=9", "optics.vignetting.mechanical_end_deg=8"],
            "is not greater than mechanical_start_deg",
        ),
    ],
)
def test_contradictions(overrides, message):
    with pytest.raises(ScenarioError, match=message):
        Scenario.load(CUBESAT, overrides)


def test_a_fisheye_may_see_everything():
    wide = ["optics.focal_length_mm=2.2", "optics.aperture_mm=1.5", "optics.distortion.k1=0"]
    with pytest.raises(ScenarioError, match="more than the 170° of a pinhole"):
        Scenario.load(CUBESAT, ["optics.focal_length_mm=0.2", "optics.aperture_mm=0.1", "optics.distortion.k1=0"])
    assert Scenario.load(CUBESAT, [*wide, "optics.projection=equidistant"]).optics.projection == "equidistant"
