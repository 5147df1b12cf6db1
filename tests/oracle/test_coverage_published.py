"""Sky coverage and the prediction of centroids against figures that were printed before.

Star counts: 558, 1744 and 5326 stars brighter than V = 4, 5 and 6 over the sky (Tycho-2 with UCAC4, every component
counted by itself); a field of any shape holds on the average that many times its share of the sky. Hipparcos
has close doubles as one entry where these have two: 3 to 8 % fewer stars, never more.
Path: Greyling 1995, section 3.3.2: a field of 10° × 10° along the path holds no star at many points down to V = 5, and
at least 3 with a limit "between 6.0 and 7.0".
Centroids of a Gaussian image of σ pixels: variance σ²/F where the star's own light is the noise, 8 π σ⁴ b²/F² where
that of the background is, b its standard deviation a pixel (King 1983, PASP 95, 163, eqs. 6 and 7; Winick 1986). They
hold for pixels small against σ: by 1/(12 σ²) the pixels widen the image, 0.9 % in the variance for σ = 3, twice that
for the second; the wings beyond 4 σ that are cut off carry less than 0.1 %.
"""

import math

import numpy as np
import pytest

from simulator.build import build_camera
from simulator.checks import load_scenario
from simulator.study.coverage.boresights import along_path, whole_sky
from simulator.study.coverage.field_counts import circle, outline, solid_angle_sr
from simulator.study.coverage.sensitivity import build_sensitivity
from simulator.study.coverage.survey import count_stars
from startracker.catalog import load_catalog


@pytest.mark.parametrize("field", ["camera", "circle"])
def test_the_mean_count_is_the_published_count_times_the_share_of_the_sky(field):
    stars = load_catalog("hipparcos")
    shape = outline(build_camera(load_scenario("cubesat_ideal"))) if field == "camera" else circle(9.0)
    counts = count_stars(stars, shape, whole_sky(4000), np.array([4.0, 5.0, 6.0]))
    for k, published in enumerate((558, 1744, 5326)):
        here = counts[:, k]
        own = len(stars.brighter_than((4.0, 5.0, 6.0)[k]))
        expected = own * solid_angle_sr(shape) / (4 * math.pi)
        # exact, but for the 4000 places: at most as uncertain as places drawn at random, 3 std/√N
        error = 3 * here.std() / math.sqrt(len(here))
        assert here.mean() == pytest.approx(expected, abs=error)
        over_sky, error = (x * 4 * math.pi / solid_angle_sr(shape) for x in (here.mean(), error))
        assert 0.91 * published - error < over_sky < published + error


def test_the_thesis_path_has_empty_fields_to_5_and_three_stars_to_6_5():
    scenario = load_scenario("sunsat", ["pointing.error_deg=0"])
    counts = count_stars(
        load_catalog("bsc5"), outline(build_camera(scenario)), along_path(scenario, 1500), np.array([5.0, 6.5])
    )
    assert np.sum(counts[:, 0] == 0) > 10
    assert counts[:, 1].min() >= 3


SIGMA = 3.0
WIDE = [
    "optics.psf.sigma_px=3.0", "pointing.target=[10, 20, 0]", "detector.prnu=0", "detector.dsnu=0",
    "detector.dark_current_e_s=0", "sky.background=false", "detector.full_well_e=1e12", "detector.adc_bits=null",
    "detector.gain_e_per_dn=1", "optics.distortion={k1: 0}",
]  # fmt: skip


def predicted_px(overrides, electrons):
    sensitivity = build_sensitivity(load_scenario("cubesat_ideal", WIDE + overrides))
    return sensitivity, sensitivity.sigma_rad(np.array([electrons]))[0] / sensitivity.camera.pixel_rad


def test_a_bright_star_is_limited_by_its_own_light():
    _, sigma_px = predicted_px(["detector.read_noise_e=0.001"], 1e5)
    variance = (SIGMA**2 + 1 / 12) / 1e5
    assert sigma_px**2 == pytest.approx(variance, rel=0.005)


def test_a_faint_star_is_limited_by_the_background():
    sensitivity, sigma_px = predicted_px(["detector.read_noise_e=100"], 1000.0)
    assert sensitivity.pixel.noise_e == pytest.approx(100.0, rel=1e-6)
    variance = 8 * math.pi * (SIGMA**2 + 1 / 12) ** 2 * 100.0**2 / 1000.0**2
    assert sigma_px**2 == pytest.approx(variance, rel=0.015)  # the star's own light adds 0.3 %


def test_the_faintest_star_has_the_ratio_asked_for():
    # matched filter on a Gaussian: F/b √(Σ p²), Σ p² = 1/(4 π σ²) (Turin 1960)
    sensitivity, _ = predicted_px(["detector.read_noise_e=10"], 1000.0)
    assert sensitivity.least_electrons == pytest.approx(
        5.0 * 10.0 * math.sqrt(4 * math.pi * (SIGMA**2 + 1 / 12)), rel=0.01
    )
    deeper = build_sensitivity(load_scenario("cubesat_ideal", [*WIDE, "detector.read_noise_e=10"]), snr=2.5)
    assert deeper.magnitude_limit - sensitivity.magnitude_limit == pytest.approx(2.5 * math.log10(2.0), abs=1e-9)
