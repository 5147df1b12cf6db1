"""From scenario to physics: defaults agree, the exposure is not a part of the device, and the Earth has its key."""

from dataclasses import MISSING, fields

import numpy as np

from simulator import Renderer, Scenario
from simulator.build import detector_parameters, shutter_of
from simulator.detector.parameters import DetectorParameters
from simulator.scenario.schema import DetectorSection

SMALL = ["detector.width=128", "detector.height=96", "study.trials=1"]


def test_defaults_are_those_of_the_schema():
    for column in fields(DetectorParameters):
        if column.default is not MISSING:
            assert column.default == DetectorSection.model_fields[column.name].default, column.name


def test_parameters_are_those_of_the_scenario():
    scenario = Scenario.load("tc211", ["detector.cosmic_rays.rate_cm2_s=3", "detector.video.noise_dn=2"])
    device = detector_parameters(scenario.detector)
    assert all(getattr(device, column.name) == getattr(scenario.detector, column.name) for column in fields(device))
    assert shutter_of(scenario.detector).kind == scenario.detector.shutter


def test_an_exposure_asked_for_is_that_of_the_scenario():
    """The frame of another exposure is, to the byte, that of a scenario with this exposure; nothing is built anew."""
    keys = [
        *SMALL,
        "detector.shutter=rolling",
        "detector.cosmic_rays.rate_cm2_s=500",
        "pointing.jitter.rms_arcsec=[9,9,9]",
    ]
    asked, truth = Renderer(Scenario.load("cubesat_ideal", keys)).frame(3, exposure_s=0.3)
    alone, other = Renderer(Scenario.load("cubesat_ideal", [*keys, "detector.exposure_s=0.3"])).frame(3)
    assert np.array_equal(asked.image, alone.image)
    assert np.array_equal(truth.mean_electrons, other.mean_electrons)
    assert (asked.exposure_s, asked.parameters) == (alone.exposure_s, alone.parameters)


def test_still_light_grows_with_the_exposure():
    renderer = Renderer(Scenario.load("cubesat_ideal", [*SMALL, "sky.magnitude_limit=-2", "sky.planets=false"]))
    scene = renderer.scene(0)
    rate_e_s, _ = renderer.focal_plane.background_rate_e_s(scene)
    for exposure_s in (0.1, 0.4):
        np.testing.assert_allclose(renderer.expose(scene, exposure_s).mean_e, exposure_s * rate_e_s, rtol=1e-14)


def test_the_earth_may_be_in_the_way_of_random_attitudes():
    """Over the whole sky the Earth hides (1 − cos ρ)/2 = 27 % of directions from 800 km: with it some frames lose
    stars, without it, the default, none does."""
    base = [*SMALL, "study.sampling=sky", "orbit.altitude_km=800", "pointing.error_deg=0"]
    assert Scenario.load("cubesat_ideal", base).study.sky_without_earth
    without = Renderer(Scenario.load("cubesat_ideal", base))
    with_earth = Renderer(Scenario.load("cubesat_ideal", [*base, "study.sky_without_earth=false"]))
    stars = np.array([[len(r.expose(r.scene(k)).sources) for k in range(60)] for r in (without, with_earth)])
    hidden = np.mean(stars[1] < stars[0])
    assert 0.27 - 0.17 < hidden < 0.27 + 0.25  # 3 σ of 60 trials, and fields that the limb crosses
    assert np.all(stars[1] <= stars[0])
