"""Faint stars beyond the catalogue: their number, their place on the sky, and the noise that they add to a frame.

Published: Tycho-2 (Høg et al. 2000, A&A 355, L27) has 150 stars in a square degree on average at galactic latitude 0
and 25 at the poles, and 50 at ±30° (ESA's summary of its principal characteristics), 2,539,913 in all; the Galaxy
model of Bahcall & Soneira (1980, ApJS 44, 73, eq. B1) in V, good to 15 % of its own counts above 20°. Campbell's
theorem for the variance of a pixel.
"""

import functools
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import erf

from simulator import Renderer, Scenario
from simulator.sky.background import star_contrast, starlight_s10
from simulator.sky.celestial_frames import GALACTIC
from simulator.sky.faint_stars import FaintSky, StarField
from simulator.sky.spectra import SOLAR_B_V
from simulator.sky.star_counts import count_between, draw_magnitudes, light_between_s10
from startracker import Attitude
from startracker.geometry.attitude import direction_to_radec, radec_to_direction

DARK = ["sky.planets=false", "sky.earth=false", "sky.background=false", "pointing.error_deg=0"]
SQUARE_DEGREE = np.radians(1.0) ** 2


@functools.cache
def whole_sky():
    """Random directions (N, 3), their galactic longitude and latitude in degrees, and the contrast of faint stars."""
    directions = np.random.default_rng(3).standard_normal((100_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    longitude, latitude = direction_to_radec(directions @ GALACTIC.T)
    return directions, np.degrees(longitude), np.degrees(latitude), star_contrast(directions)


# ---------------------------------------------------------------------- numbers
def test_the_contrast_has_a_mean_of_one():
    contrast = whole_sky()[3]
    assert contrast.mean() == pytest.approx(1.0, abs=4.0 * contrast.std() / np.sqrt(len(contrast)))


@pytest.mark.parametrize(("low", "high", "published"), [(0, 4, 150.0), (27, 33, 50.0), (80, 90, 25.0)])
def test_the_density_by_galactic_latitude_is_that_of_tycho(low, high, published):
    _, _, latitude, contrast = whole_sky()
    band = (np.abs(latitude) >= low) & (np.abs(latitude) <= high)
    # the published figures are rounded averages, to one or two digits
    assert contrast[band].mean() * 2_539_913 / 41_252.96 == pytest.approx(published, rel=0.15)


def bahcall_soneira(v_mag, longitude_deg, latitude_deg):
    """Stars in a square degree down to V, |b| ≥ 20°."""
    lon, b = np.radians(longitude_deg), np.radians(np.abs(latitude_deg))
    mu = 0.03 if v_mag <= 12.0 else 0.0075 * (v_mag - 12.0) + 0.03
    gamma = 0.36 if v_mag <= 12.0 else 0.04 * (12.0 - v_mag) + 0.36
    sigma = 1.45 - 0.20 * np.cos(b) * np.cos(lon)
    disk = 925.0 * 10 ** (0.035 * (v_mag - 15.75)) / (1.0 + 10 ** (-0.132 * (v_mag - 15.75))) ** 3.0
    disk = disk / (np.sin(b) * (1.0 - mu / np.tan(b) * np.cos(lon))) ** (3.0 - 5.0 * gamma)
    halo = 1050.0 * 10 ** (0.087 * (v_mag - 17.5)) / (1.0 + 10 ** (-0.180 * (v_mag - 17.5))) ** 2.5
    return disk + halo / (1.0 - np.cos(b) * np.cos(lon)) ** sigma


@pytest.mark.parametrize(("v_mag", "most"), [(9.0, 1.6), (10.0, 1.8), (11.0, 2.1)])
def test_the_density_follows_a_model_of_the_galaxy(v_mag, most):
    """Above 20° the model has fewer stars than catalogues count: at V = 8 it has 0.74 of those of Hipparcos. The ratio
    is the same from 20° to the poles to a third, and its mean is within the difference of the counts."""
    _, longitude, latitude, contrast = whole_sky()
    ratios = []
    for low, high in ((20, 30), (30, 45), (45, 60), (60, 90)):
        band = (np.abs(latitude) >= low) & (np.abs(latitude) < high)
        ours = contrast[band].mean() * count_between(4.0, v_mag)
        ratios.append(ours / bahcall_soneira(v_mag, longitude[band], latitude[band]).mean())
    assert max(ratios) / min(ratios) < 1.34
    assert 1.0 < np.mean(ratios) < most


def test_magnitudes_have_the_counts():
    v_mag = draw_magnitudes(np.random.default_rng(1).random(400_000), 9.0, 12.0)
    for low, high in ((9.0, 9.5), (9.5, 10.0), (10.0, 11.0), (11.0, 12.0)):
        expected = 400_000 * count_between(low, high) / count_between(9.0, 12.0)
        assert np.sum((v_mag > low) & (v_mag <= high)) == pytest.approx(expected, abs=4.0 * np.sqrt(expected))
    light = 10.0 ** (-0.4 * (v_mag - 10.0))
    mean = light_between_s10(9.0, 12.0) / count_between(9.0, 12.0)
    assert light.mean() == pytest.approx(mean, abs=4.0 * light.std() / np.sqrt(len(light)))
    assert count_between(4.0, 11.0) * 41_252.96 == pytest.approx(1_048_084 - 558, rel=1e-6)


# ---------------------------------------------------------------------- the sky
def test_the_whole_sky_has_its_stars_evenly():
    sky = FaintSky(7, 8.0, 9.0)
    field = sky.near([0.0, 0.0, 1.0], np.pi)
    expected = 139_375 - 48_559
    assert len(field.v_mag) == pytest.approx(expected, rel=0.01 + 4.0 / np.sqrt(expected))  # cells against the map: 1 %
    assert np.linalg.norm(field.direction, axis=1) == pytest.approx(np.ones(len(field.v_mag)), abs=1e-12)
    # in caps of 12° the number is that of the contrast within, to the Poisson noise and the size of the cells
    for centre in radec_to_direction(np.radians([20.0, 150.0, 266.0, 90.0]), np.radians([-80.0, 10.0, -29.0, 89.9])):
        inside = field.direction @ centre > np.cos(np.radians(12.0))
        around = whole_sky()[0] @ centre > np.cos(np.radians(12.0))
        area = 2.0 * np.pi * (1.0 - np.cos(np.radians(12.0))) / SQUARE_DEGREE
        mean = whole_sky()[3][around].mean() * area * expected / 41_252.96
        assert inside.sum() == pytest.approx(mean, rel=0.1, abs=4.0 * np.sqrt(mean))


def test_a_field_always_has_the_same_stars():
    one, other = FaintSky(7, 9.0, 11.0), FaintSky(7, 9.0, 11.0)
    centre, beside = radec_to_direction(np.radians([30.0, 36.0]), np.radians([5.0, 5.0]))
    other.near(-centre, 0.3)
    first, second = one.near(centre, 0.15), other.near(beside, 0.15)
    held, seen = (  # well within both caps
        field.direction[np.minimum(field.direction @ beside, field.direction @ centre) > np.cos(0.149)]
        for field in (first, second)
    )
    assert len(held) > 50
    assert {tuple(v) for v in held.tolist()} == {tuple(v) for v in seen.tolist()}
    assert not np.isin(FaintSky(8, 9.0, 11.0).near(centre, 0.15).direction, first.direction).any()


# ---------------------------------------------------------------------- frames
def share_squared(sigma):
    """Mean of Σ pᵢ² over the sub-pixel positions, of the shares of a Gaussian star in pixels: ∫ p(x)² dx, squared."""
    x = np.linspace(-8.0, 8.0, 4001)
    share = 0.5 * (erf((x + 0.5) / (sigma * np.sqrt(2.0))) - erf((x - 0.5) / (sigma * np.sqrt(2.0))))
    return np.trapezoid(share**2, x) ** 2


def test_the_grain_of_a_frame_is_that_of_campbell():
    """Mean n F and variance n F² Σ p² of a pixel, over the magnitudes, n stars in the solid angle of a pixel."""
    keys = [*DARK, "sky.magnitude_limit=-2", "sky.faint_magnitude_limit=11"]
    renderer = Renderer(Scenario.load("cubesat_ideal", keys))
    camera, plane = renderer.camera, replace(renderer.focal_plane, faint_sky=FaintSky(1, 10.0, 11.0))
    renderer.focal_plane = plane
    v_mag = draw_magnitudes((np.arange(4000) + 0.5) / 4000, 10.0, 11.0)
    electrons = plane.photometer.electrons_per_s(v_mag, SOLAR_B_V, 0.0) * 0.2
    seen, expected = [], []
    for ra, dec in ((0.0, 60.0), (150.0, 20.0), (200.0, -10.0), (60.0, -40.0)):
        attitude = Attitude.from_radec_roll(ra, dec, 0.0)
        mean_e = renderer.frame(0, at_s=0.0, attitude=attitude)[1].mean_electrons
        nodes = np.stack([a.ravel() for a in np.meshgrid(*2 * [np.arange(16, 1024, 32.0)])], axis=1)
        contrast = star_contrast(attitude.inverse.apply(camera.unproject(nodes))).mean()
        stars = contrast * count_between(10.0, 11.0) / (camera.fx * camera.fy) / SQUARE_DEGREE
        seen.append((mean_e.mean(), mean_e.var()))
        expected.append((stars * electrons.mean(), stars * np.mean(electrons**2) * share_squared(0.9)))
    total, predicted = np.mean(seen, axis=0), np.mean(expected, axis=0)
    # 4 × 165 square degrees hold N = 7,000 stars: 1/√N = 1.2 % of the mean and, with ⟨F⁴⟩/⟨F²⟩² = 1.3, 1.4 % of the
    # variance; the solid angle of a pixel falls by 2 % on average, the step from cell to cell is as large
    np.testing.assert_allclose(total, predicted, rtol=0.08)


class OneStar:
    """A faint sky of one star."""

    def __init__(self, direction):
        self.direction = direction

    def near(self, direction, radius_rad, shift_rad):
        return StarField(self.direction[None], np.array([5.0]))


@pytest.mark.parametrize("aberration", [True, False])
def test_they_appear_where_a_catalogue_star_would(aberration):
    """The aberration of a direction u is v/c less its part along u, to v²/c² (1e-8): some 20″ of the 45″ of a pixel."""
    keys = [*DARK, "sky.magnitude_limit=-2", f"sky.aberration={str(aberration).lower()}"]
    renderer = Renderer(Scenario.load("cubesat_ideal", keys))
    attitude = Attitude.from_radec_roll(80.0, 15.0, 30.0)
    star = radec_to_direction(np.radians([80.4]), np.radians([15.6]))[0]
    renderer.focal_plane = replace(renderer.focal_plane, faint_sky=OneStar(star))
    frame, truth = renderer.frame(0, at_s=0.0, attitude=attitude, rate_camera_rad_s=np.zeros(3))
    moved = star + aberration * np.asarray(frame.observer.velocity_km_s) / 299_792.458
    expected = frame.camera.project(attitude.apply(moved / np.linalg.norm(moved)))[0]
    image = truth.mean_electrons
    rows, columns = np.indices(image.shape)
    seen = np.array([(image * columns).sum(), (image * rows).sum()]) / image.sum()
    np.testing.assert_allclose(seen, expected, atol=1e-3)


def test_they_are_background_and_not_truth():
    small = [*DARK, "detector.width=256", "detector.height=256"]
    faint = [*small, "sky.faint_magnitude_limit=12"]
    plain, grainy, again = (Renderer(Scenario.load("cubesat_ideal", k)).frame(2) for k in (small, faint, faint))
    assert np.array_equal(plain[1].sources.id, grainy[1].sources.id)
    assert np.all(grainy[1].mean_electrons - plain[1].mean_electrons > -1e-9)
    assert grainy[1].mean_electrons.sum() > plain[1].mean_electrons.sum() + 1000.0
    assert grainy[0].image.tobytes() == again[0].image.tobytes()
    off = Renderer(Scenario.load("cubesat_ideal", [*small, "sky.faint_magnitude_limit=null"])).frame(2)
    assert off[0].image.tobytes() == plain[0].image.tobytes()


def test_their_light_is_taken_from_the_measured_background():
    """The map of starlight, less the mean light of the stars drawn: as many S10 as they have, where it has more."""
    directions, _, latitude, contrast = whole_sky()
    some = np.abs(latitude) > 5.0
    plain = starlight_s10(directions[some], "hipparcos", 9.0)
    less = starlight_s10(directions[some], "hipparcos", 9.0, 12.0)
    taken = plain - less
    own = light_between_s10(9.0, 12.0) * contrast[some]
    assert np.all(taken <= own * 1.05 + 0.5)  # bilinear between the nodes of either map
    assert np.all(less > 0.0)
    bright = plain > 2.0 * own
    assert bright.mean() > 0.3
    np.testing.assert_allclose(taken[bright].mean(), own[bright].mean(), rtol=0.03)


def test_the_limit_is_beyond_that_of_the_catalogue():
    from startracker.errors import InputError

    with pytest.raises(InputError, match="faint_magnitude_limit"):
        Scenario.load("cubesat_ideal", ["sky.faint_magnitude_limit=8"])
    with pytest.raises(InputError, match="faint_magnitude_limit"):
        Scenario.load("cubesat_ideal", ["sky.faint_magnitude_limit=17"])
