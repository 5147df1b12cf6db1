"""Rolling shutter and frame transfer against brute force: a camera that is clocked step by step.

Rolling: at each of 4,000 moments the star's instantaneous image is added to the rows that are open then. Ours keeps one
window for the whole image of a star, which shears it by velocity · line_time a row; over the two or three rows that
matter, and a slope of 0.6 peak/σ, that bounds the difference. Transfer: every charge packet is moved by hand.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simulator.optics.jitter import Jitter, draw_jitter, load_spectrum
from simulator.optics.psf import build_psf
from simulator.optics.psf_model import PsfModel
from simulator.optics.shutter import frame_transfer_smear, rolling_paths
from simulator.optics.smear import star_paths
from simulator.optics.splat import render_stars
from simulator.randomness import stream
from startracker.errors import InputError
from startracker.geometry.camera import Camera

CAMERA = Camera.from_fov(10.0, 256, 256)
PSF = build_psf(PsfModel(model="gaussian", sigma_px=1.2), 2.0, (10.0, 10.0))
EXPOSURE_S = 0.2


def clocked(star, rate, line_time_s, steps=4000):
    """The image row by row: at each moment of row y's own window the whole image is drawn and row y of it kept."""
    t = ((np.arange(steps) + 0.5) / steps - 0.5) * EXPOSURE_S
    image = np.zeros((256, 256))
    middle = np.round(star_paths(CAMERA, star, rate, EXPOSURE_S)[0][0, :, 1].mean()).astype(int)
    for row in range(max(middle - 45, 0), min(middle + 45, 256)):
        when = t + (row - 127.5) * line_time_s
        turned = Rotation.from_rotvec(-np.multiply.outer(when, rate)).apply(star[0])
        image[row] = render_stars((256, 256), CAMERA.project(turned)[None], np.full(steps, 1 / steps), [1e5], PSF)[row]
    return image


@pytest.mark.parametrize("rate_deg_s", [(0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (-0.7, 0.5, 3.0)])
@pytest.mark.parametrize("pixel", [(60.0, 30.0), (130.0, 220.0)])
def test_rolling_shutter(rate_deg_s, pixel):
    line_time_s = 100e-6
    star, rate = CAMERA.unproject([pixel]), np.radians(rate_deg_s)
    xy, weights, exposed = rolling_paths(CAMERA, star, rate, EXPOSURE_S, line_time_s, PSF.feature_px)
    ours = render_stars((256, 256), xy, weights, 1e5 * exposed, PSF)
    brute = clocked(star, rate, line_time_s)
    speed = np.linalg.norm(np.diff(xy[0], axis=0), axis=1).sum() / EXPOSURE_S
    # speed · line_time = 0.3 % of shear, over 2.5 σ, at a slope of 0.6 of the peak a σ
    assert np.abs(ours - brute).max() < 1.5 * speed * line_time_s * brute.max()
    # what the shear leaves: light and centroid
    assert ours.sum() == pytest.approx(brute.sum(), rel=2e-5)
    grid = np.arange(256)
    for axis in (0, 1):
        profile, truth = ours.sum(axis=axis), brute.sum(axis=axis)
        assert profile @ grid / profile.sum() == pytest.approx(truth @ grid / truth.sum(), abs=2e-4)
    # and it is not what a global shutter shows
    still = render_stars((256, 256), *star_paths(CAMERA, star, rate, EXPOSURE_S, PSF.feature_px), [1e5], PSF)
    assert np.abs(still - brute).max() > 0.02 * brute.max()


def test_slow_stars_within_1e4_of_the_clocked_image():
    """0.5 px/s and 20 µs: a shear of 1e-5."""
    star, rate = CAMERA.unproject([(60.0, 30.0)]), np.radians([0.02, 0.0, 0.1])
    xy, weights, exposed = rolling_paths(CAMERA, star, rate, EXPOSURE_S, 20e-6, PSF.feature_px)
    ours = render_stars((256, 256), xy, weights, 1e5 * exposed, PSF)
    brute = clocked(star, rate, 20e-6, 1000)
    assert np.abs(ours - brute).max() < 1e-4 * brute.max()


def test_a_star_that_runs_with_the_shutter_is_exposed_for_longer():
    star, rate = CAMERA.unproject([(127.5, 127.5)]), np.array([np.radians(2.0), 0.0, 0.0])
    xy, _, exposed = rolling_paths(CAMERA, star, rate, EXPOSURE_S, 1e-3)
    down_px_s = (xy[0, -1, 1] - xy[0, 0, 1]) / (EXPOSURE_S * exposed[0])
    assert down_px_s != 0.0
    # the nodes stop short of the ends, by the same share on both sides
    nodes = np.polynomial.legendre.leggauss(len(xy[0]))[0]
    assert exposed[0] == pytest.approx(1.0 / (1.0 - down_px_s / nodes[-1] * 1e-3), rel=1e-4)


def test_no_line_time_is_a_global_shutter():
    stars, rate = CAMERA.unproject([(60.0, 30.0), (200.0, 10.0)]), np.radians([0.5, 0.3, 10.0])
    xy, weights, exposed = rolling_paths(CAMERA, stars, rate, EXPOSURE_S, 0.0)
    expected, same = star_paths(CAMERA, stars, rate, EXPOSURE_S)
    np.testing.assert_allclose(xy, expected, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(weights, same)
    np.testing.assert_array_equal(exposed, 1.0)


def test_rolling_shutter_under_jitter():
    """Every moment by hand: the camera as it is turned when the row the star stands in has run for u."""
    rms = 3.0 * np.degrees(CAMERA.pixel_rad) * 3600.0
    section = Jitter(rms_arcsec=(rms, rms, rms), corner_hz=5.0)
    path = draw_jitter(section, load_spectrum(section), stream(8, "jitter", 0))
    stars, rate, line_time_s = CAMERA.unproject([(60.0, 30.0), (200.0, 240.0)]), np.radians([0.3, 0.2, 1.0]), 200e-6
    xy, weights, _ = rolling_paths(CAMERA, stars, rate, EXPOSURE_S, line_time_s, 0.5, jitter=path)
    assert weights.sum() == pytest.approx(1.0)
    u = exposure_nodes_like(weights) * EXPOSURE_S / 2
    for star, track in zip(stars, xy, strict=True):
        t = u + (track[:, 1] - 127.5) * line_time_s
        turned = (Rotation.from_rotvec(-path.at(t)) * Rotation.from_rotvec(-np.multiply.outer(t, rate))).apply(star)
        np.testing.assert_allclose(track, CAMERA.project(turned), rtol=0, atol=1e-3)  # of the spline, 1e-5 · 60 px
    same, _, exposed = rolling_paths(CAMERA, stars, rate, EXPOSURE_S, 0.0, 0.5, jitter=path)
    np.testing.assert_allclose(same, star_paths(CAMERA, stars, rate, EXPOSURE_S, 0.5, jitter=path)[0], atol=1e-3)
    np.testing.assert_array_equal(exposed, 1.0)


def exposure_nodes_like(weights):
    """Nodes of panels of Gauss and Legendre, from their number and weights alone."""
    for panels in range(1, 50):
        nodes, single = np.polynomial.legendre.leggauss(len(weights) // panels)
        if len(nodes) * panels == len(weights) and np.allclose(np.tile(single, panels) / (2 * panels), weights):
            middles = (2 * np.arange(panels) + 1) / panels - 1
            return (middles[:, None] + nodes / panels).ravel()
    raise AssertionError(len(weights))


@pytest.mark.parametrize("rate_rad_s", [0.55, -0.55, 1.4])
def test_stars_nearly_and_more_than_as_fast_as_the_shutter(rate_rad_s):
    """804 and 2,047 px/s against 1,000 rows/s: every row sees the star while that is in it."""
    star = CAMERA.unproject([(127.5, 127.5)])
    exposure_s, line_time_s = 0.01, 1e-3
    xy, weights, exposed = rolling_paths(CAMERA, star, [rate_rad_s, 0.0, 0.0], exposure_s, line_time_s, PSF.feature_px)
    ours = render_stars((256, 256), xy, weights, 1e5 * exposed, PSF)
    t = (np.arange(40_000) + 0.5) / 40_000 * 0.3 - 0.15
    place = CAMERA.project(np.stack([0 * t, np.sin(rate_rad_s * t), np.cos(rate_rad_s * t)], axis=1))
    open_then = np.abs(t - (place[:, 1] - 127.5) * line_time_s) <= exposure_s / 2
    seen_s = open_then.sum() * (t[1] - t[0])
    assert exposed[0] * exposure_s == pytest.approx(seen_s, abs=2e-5)
    assert ours.sum() == pytest.approx(1e5 * exposed[0], rel=1e-6)
    assert weights @ xy[0, :, 1] == pytest.approx(place[open_then, 1].mean(), abs=0.02)


def test_a_star_that_keeps_up_with_the_shutter_is_left_out():
    star = CAMERA.unproject([(127.5, 127.5), (20.0, 30.0)])
    rate = 1000.0 / CAMERA.fx
    xy, _, exposed = rolling_paths(CAMERA, star, [rate, 0.0, 0.0], 0.01, 1e-3)
    assert np.isnan(xy[0]).all()
    assert exposed[0] == 1.0
    assert rolling_paths(CAMERA, np.empty((0, 3)), [0, 0, 0], 0.1, 1e-5)[0].shape == (0, 1, 2)


def moved_by_hand(flux, exposure_s, line_time_s, direction, phases):
    """Wells as a list of packets, each shift done one at a time, light falling on them all the while."""
    rows = len(flux)
    light = flux if direction == "up" else flux[::-1]
    wells = np.zeros((rows, flux.shape[1]))
    if phases == "both":
        for _ in range(rows):
            wells = np.vstack([wells[1:], np.zeros((1, flux.shape[1]))])  # row 0 leaves, an empty one comes in
            wells += light * line_time_s
        # the last shift of the clearing is the start of the exposure: its own row belongs to that
        wells -= light * line_time_s
    wells += light * exposure_s
    read = []
    for _ in range(rows):
        read.append(wells[0])
        wells = np.vstack([wells[1:], np.zeros((1, flux.shape[1]))])
        wells += light * line_time_s
    image = np.array(read)
    return image if direction == "up" else image[::-1]


@pytest.mark.parametrize("direction", ["up", "down"])
@pytest.mark.parametrize("phases", ["both", "after"])
def test_frame_transfer(direction, phases):
    mean = np.random.default_rng(2).uniform(0.0, 5.0, (37, 11))
    mean[20, 4] = 1e5
    exposure_s, line_time_s = 0.2, 104e-6
    smear = frame_transfer_smear(mean, exposure_s, line_time_s, direction, phases)
    brute = moved_by_hand(mean / exposure_s, exposure_s, line_time_s, direction, phases)
    np.testing.assert_allclose(mean + smear, brute, rtol=0, atol=1e-9)
    if phases == "after":  # trails lie on the side away from the output
        trail = smear[:, 4] > 1.0
        assert (np.flatnonzero(trail) > 20).all() if direction == "up" else (np.flatnonzero(trail) < 20).all()
    else:
        everything = line_time_s / exposure_s * (mean.sum(axis=0) - mean)
        np.testing.assert_allclose(smear, everything, rtol=1e-12)


def test_transfer_leaves_its_argument_alone_and_refuses():
    mean = np.ones((4, 3))
    frame_transfer_smear(mean, 1.0, 1e-3, "up")
    np.testing.assert_array_equal(mean, 1.0)
    assert not frame_transfer_smear(mean, 1.0, 0.0, "down").any()
    with pytest.raises(InputError, match="'up' or 'down', not 'left'"):
        frame_transfer_smear(mean, 1.0, 1e-3, "left")
    with pytest.raises(InputError, match="'both' before and after"):
        frame_transfer_smear(mean, 1.0, 1e-3, "up", "before")
