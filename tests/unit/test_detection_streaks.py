"""Trails drawn here from their formula, found and measured by `startracker.trails`.

A streak is drawn as the mean of many star images along a line, each a Gaussian integrated over pixels (erf): it shares
no code with the fit. The bound of the position is the Cramér–Rao bound from numerical derivatives of such drawings.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from all_detectors import GENERAL
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import erf

from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.study.star_tracker import build_tracker
from simulator.study.trials.trial import solve_frame
from startracker.centroid.result import Centroids
from startracker.detection import Background, estimate
from startracker.geometry.camera import Camera
from startracker.settings import DetectionSettings
from startracker.trails import Trails, find_trails, mid_exposure
from startracker.trails.turn import fit_turn

FloatArray = NDArray[np.float64]

CUBESAT = Path(__file__).resolve().parents[2] / "scenarios" / "cubesat_ideal.yaml"
SIGMA, NOISE, SIZE = 0.9, 12.0, 512


def drawn(shape: tuple[int, int], x: float, y: float, along: FloatArray, flux: float) -> FloatArray:
    """One streak: eight star images a pixel."""
    image = np.zeros(shape)
    steps = max(8, math.ceil(8.0 * math.hypot(*along)))
    reach = 0.5 * np.abs(along) + 6.0
    x0, x1 = max(0, int(x - reach[0])), min(shape[1], int(x + reach[0]) + 2)
    y0, y1 = max(0, int(y - reach[1])), min(shape[0], int(y + reach[1]) + 2)
    part = (np.arange(steps) + 0.5) / steps - 0.5
    scale = math.sqrt(2.0) * SIGMA
    edges_x = erf((np.arange(x0, x1 + 1) - 0.5 - (x + part * along[0])[:, None]) / scale)
    edges_y = erf((np.arange(y0, y1 + 1) - 0.5 - (y + part * along[1])[:, None]) / scale)
    image[y0:y1, x0:x1] = 0.25 * flux / steps * np.einsum("ki,kj->ij", np.diff(edges_y), np.diff(edges_x))
    return image


def motion_line(xy: FloatArray, motion: tuple[float, float, float]) -> FloatArray:
    """What a turn of the camera draws at a place of the image."""
    a, b, c = motion
    dx, dy = xy - 0.5 * (SIZE - 1)
    return np.array([a - c * dy, b + c * dx])


def field(
    seed: int, length: float, degrees: float, snr: FloatArray, turn: float = 0.0, gradient: float = 0.0
) -> tuple[NDArray[np.float32], FloatArray, FloatArray, tuple[float, float, float]]:
    """Trails of these signal-to-noise ratios (with a filter along them), apart from each other and from the border.

    The noise of a filter of the streak's shape is about NOISE √(length · 2 √π σ).
    """
    rng = np.random.default_rng(seed)
    motion = (length * math.cos(math.radians(degrees)), length * math.sin(math.radians(degrees)), turn)
    image = 300.0 + NOISE * rng.standard_normal((SIZE, SIZE)) + gradient * np.arange(SIZE)[None, :]
    flux = snr * NOISE * math.sqrt((length + 4.0 * SIGMA) * 2.0 * math.sqrt(math.pi) * SIGMA)
    margin = 0.5 * length * 1.1 + 8.0
    places: list[FloatArray] = []
    while len(places) < len(snr):
        place = rng.uniform(margin, SIZE - 1 - margin, 2)
        unit = motion_line(place, motion)
        unit = unit / np.hypot(*unit)
        apart = [
            abs((place - other) @ np.array([-unit[1], unit[0]])) > 14.0
            or np.hypot(*(place - other)) > 1.3 * length + 14
            for other in places
        ]
        if all(apart):
            places.append(place)
    for place, light in zip(places, flux, strict=True):
        image += drawn(image.shape, *place, motion_line(place, motion), light)
    return image.astype(np.float32), np.array(places), flux, motion


def nearest(found: Trails, place: FloatArray) -> int:
    return int(np.argmin(np.hypot(*(found.centroids.xy - place).T)))


@pytest.mark.parametrize(
    ("length", "degrees", "turn"),
    [(24, 0, 0.0), (24, 100, 0.0), (40, 20, 0.01), (70, 45, 0.0), (70, 90, 0.02), (110, 133, -0.01), (140, 175, 0.0)],
)
def test_all_streaks_found_none_false(length: float, degrees: float, turn: float) -> None:
    """At ten times the noise the threshold of 5 misses one in 10⁶; with the search's losses none of these."""
    snr = np.array([60.0, 40.0, 30.0, 25.0, 20.0, 15.0, 12.0, 12.0])
    for seed in range(3):
        image, places, flux, motion = field(seed, length, degrees, snr, turn, gradient=0.1)
        found = find_trails(image, estimate(image, 64))
        assert found is not None
        apart = [np.hypot(*(found.centroids.xy[nearest(found, place)] - place)) for place in places]
        assert max(apart) < 0.2 * length + 3.0
        assert len(found.centroids) - len(places) <= 1  # noise above 5 σ: 0.06 a frame
        got = found.motion * np.sign(found.motion[:2] @ np.array(motion[:2]))
        assert np.hypot(*(got[:2] - motion[:2])) < 1.0 + 0.02 * length
        assert abs(got[2] - turn) < 0.01
        bright = nearest(found, places[0])
        # four standard errors: the noise, 1/52 with a free sky, and 3 % for the width that this frame tells
        assert found.centroids.flux[bright] == pytest.approx(flux[0], rel=0.15)


def bound(length: float, degrees: float, flux: float) -> FloatArray:
    """Cramér–Rao bound of (x, y), px²: numerical derivatives by x, y and flux."""
    along = length * np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees))])
    side = int(length) + 30
    centre = 0.5 * side + 0.3
    step = 0.02

    def model(x: float, y: float) -> FloatArray:
        return drawn((side, side), x, y, along, flux).ravel()

    rows = [
        (model(centre + step, centre) - model(centre - step, centre)) / (2 * step),
        (model(centre, centre + step) - model(centre, centre - step)) / (2 * step),
        model(centre, centre) / flux,
    ]
    return np.asarray(np.linalg.inv(np.array(rows) @ np.array(rows).T)[:2, :2] * NOISE**2)


@pytest.mark.parametrize(("length", "degrees", "snr"), [(30, 15, 20), (60, 60, 40), (120, 135, 50), (120, 45, 20)])
def test_positions_reach_the_bound_and_say_how_good_they_are(length: float, degrees: float, snr: float) -> None:
    """Across the streak: rms within 4 standard errors (of N samples: 1/√2N) of the bound, and the variance as stated.

    Along it a faint streak cannot reach the bound, which knows nothing of the noise's other maxima: there the stated
    variance must be right, Σ e²/v within 4 standard errors √(2/N) of 1 from above. Its tails are heavier than normal,
    and the length is the frame's own, known to some tenths of a pixel: 15 % more is allowed.
    """
    unit = np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees))])
    side = np.array([-unit[1], unit[0]])
    across, along, stated, best = [], [], [], None
    for seed in range(12):
        image, places, flux, _ = field(100 + seed, length, degrees, np.full(6, float(snr)))
        found = find_trails(image, Background(np.full_like(image, 300.0), np.full_like(image, NOISE)))
        assert found is not None
        best = bound(length, degrees, flux[0])
        for place in places:
            k = nearest(found, place)
            error = found.centroids.xy[k] - place
            if np.hypot(*error) > 0.3 * length:
                continue
            across.append(error @ side)
            along.append(error @ unit)
            stated.append((side @ found.centroids.covariance[k] @ side, unit @ found.centroids.covariance[k] @ unit))
    count = len(across)
    assert best is not None
    assert count >= 66
    limit = math.sqrt(side @ best @ side)
    got = math.sqrt(np.mean(np.square(across)))
    assert abs(got / limit - 1.0) < 4.0 / math.sqrt(2 * count)
    limits = 1.0 + 4.0 * math.sqrt(2.0 / count)
    assert np.mean(np.square(across) / np.array(stated)[:, 0]) < limits
    assert np.mean(np.square(along) / np.array(stated)[:, 1]) < 1.15 * limits
    assert np.mean(np.square(along)) > 0.5 * (unit @ best @ unit)


def test_bright_streaks_that_differ_a_little_are_measured_each_for_itself() -> None:
    """Lengths differ by 3 % from the frame's motion, as in the corners of a flat image: within 4 stated errors."""
    rng = np.random.default_rng(3)
    image = 300.0 + NOISE * rng.standard_normal((SIZE, SIZE))
    places = [(90.0 + 110.0 * i + rng.uniform(-9, 9), 100.0 + 150.0 * j) for i in range(4) for j in range(3)]
    for k, (x, y) in enumerate(places):
        along = (1.0 + 0.03 * (-1) ** k) * np.array([15.0, 42.0])
        image += drawn(image.shape, x, y, along, 2e5 / (1.0 + k))
    frame = image.astype(np.float32)
    found = find_trails(frame, Background(np.full_like(frame, 300.0), np.full_like(frame, NOISE)))
    assert found is not None
    assert len(found.centroids) == len(places)
    for place in places:
        k = nearest(found, np.array(place))
        error = found.centroids.xy[k] - place
        assert error @ np.linalg.solve(found.centroids.covariance[k], error) < 16.0


@pytest.mark.parametrize("length", [6.0, 10.0, 16.0])
@pytest.mark.parametrize("degrees", [0.0, 63.0])
def test_bright_streaks_are_as_long_as_they_are(length: float, degrees: float) -> None:
    """Light of a bright trail is above the noise up to three widths beyond its ends, so that all lines appear longer
    than the fits: with the length of the light no motion was found among bright trails of 6 to 10 px."""
    image, places, _, motion = field(3, length, degrees, np.geomspace(1000.0, 200.0, 14))
    light = np.maximum(image - 300.0, 0.0)
    image += np.random.default_rng(1).normal(size=image.shape).astype(np.float32) * np.sqrt(light)
    known = np.column_stack([places, np.tile(0.5 * np.array(motion[:2]), (len(places), 1))])
    found = find_trails(image, estimate(image), gain_e_per_dn=1.0, known=known)
    assert found is not None
    assert len(found.centroids) == len(places)
    # an end is known to √(2π) σ / r px, r the signal of a pixel's length over the noise: below 0.1 px for the faintest
    # trail, and the motion is the mean of 12
    assert np.hypot(*found.motion[:2]) == pytest.approx(length, abs=0.06)


def test_no_streaks_in_noise_and_in_a_still_field() -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        image = 100.0 + NOISE * rng.standard_normal((SIZE, SIZE))
        noise = image.astype(np.float32)
        assert find_trails(noise, estimate(noise, 64)) is None
        for _ in range(40):
            place = rng.uniform(5, SIZE - 6, 2)
            image += drawn(image.shape, *place, np.zeros(2), float(10 ** rng.uniform(2.5, 5.5)))
        image = np.minimum(image, 4000.0)
        image[rng.integers(0, SIZE, 60), rng.integers(0, SIZE, 60)] += rng.uniform(100, 3000, 60)  # hot pixels
        still = image.astype(np.float32)
        assert find_trails(still, estimate(still, 64), DetectionSettings(), 4000.0) is None


def test_pixels_that_tell_nothing_do_no_harm() -> None:
    """NaN, saturation and hot pixels on a streak: the positions stay within 5 of their standard errors."""
    image, places, _, _ = field(3, 80.0, 30.0, np.array([90.0, 50.0, 40.0, 30.0, 25.0]))
    x, y = np.rint(places[1]).astype(int)
    image[y, x] = np.nan
    image[int(places[2][1]), int(places[2][0])] += 3000.0
    found = find_trails(image, estimate(image, 64), DetectionSettings(), saturation_dn=380.0, gain_e_per_dn=2.0)
    assert found is not None
    for place in places:
        k = nearest(found, place)
        error = found.centroids.xy[k] - place
        assert error @ np.linalg.solve(found.centroids.covariance[k], error) < 25.0


def test_streaks_cut_by_the_border_are_left_out() -> None:
    """Nobody can know where their middle is."""
    image, places, _, motion = field(5, 80.0, 0.0, np.full(6, 40.0))
    image += drawn(image.shape, 20.0, 250.0, np.array(motion[:2]), 20_000.0).astype(np.float32)
    found = find_trails(image, estimate(image, 64))
    assert found is not None
    assert all(np.hypot(*(found.centroids.xy - place).T).min() < 3.0 for place in places)
    cut = (np.abs(found.centroids.xy[:, 1] - 250.0) < 3.0) & (found.centroids.xy[:, 0] < 60.0)
    assert not cut.any()


def test_streaks_of_many_directions_are_no_motion() -> None:
    rng = np.random.default_rng(8)
    image = 300.0 + NOISE * rng.standard_normal((SIZE, SIZE))
    for degrees in np.arange(0.0, 180.0, 18.0):
        along = 70.0 * np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees))])
        image += drawn(image.shape, *rng.uniform(60, SIZE - 60, 2), along, 15_000.0)
    assert find_trails(image.astype(np.float32), estimate(image, 64)) is None


def test_middle_of_a_streak_is_set_right_for_the_camera() -> None:
    """Against the track of each star itself, turned in small steps: the middle of its ends, and its mean offset."""
    camera = Camera.from_fov(20.0, 1024, 1024)
    turn = np.array([0.04, -0.06, 0.05])
    xy = np.array([[100.0, 900.0], [511.5, 511.5], [960.0, 200.0]])
    stars = camera.unproject(xy)
    track = []
    for part in np.linspace(-0.5, 0.5, 401):
        track.append(camera.project(stars @ Rotation.from_rotvec(part * turn).as_matrix().T))
    path = np.array(track)
    along = path[-1] - path[0]
    along /= np.hypot(*along.T)[:, None]
    side = np.column_stack([-along[:, 1], along[:, 0]])
    ends = 0.5 * (path[0] + path[-1]) - xy
    expected = (ends * along).sum(axis=1)[:, None] * along + ((path - xy) * side).sum(axis=2).mean(axis=0)[
        :, None
    ] * side
    motion = np.array([turn[1] * camera.fx, -turn[0] * camera.fy, turn[2]])
    stated = np.broadcast_to(0.01**2 * np.eye(2), (3, 2, 2))
    centroids = Centroids(xy, np.ones(3), stated, np.zeros(3, bool))
    lengths = path[-1] - path[0]
    by_motion = Trails(centroids, motion, lengths, np.zeros(3, bool))
    np.testing.assert_allclose(xy - mid_exposure(by_motion, camera).xy, expected, atol=0.04)
    assert np.abs(expected).max() > 0.3
    by_trails = Trails(centroids, motion * (1.0, 1.02, 0.9), -lengths, np.ones(3, bool))
    half, covariance, _ = fit_turn(xy, by_trails.lengths, np.full((3, 2), 4e-4), by_trails.motion, camera)
    assert np.all(np.abs(half - 0.5 * turn) < 3.0 * np.sqrt(np.diag(covariance)) + 1e-5)
    np.testing.assert_allclose(xy - mid_exposure(by_trails, camera).xy, expected, atol=0.01)


@pytest.mark.parametrize(("rate_deg_s", "length"), [(3.0, 48.0), (10.0, 159.0)])
def test_rendered_frames_are_solved(rate_deg_s: float, length: float) -> None:
    """Three frames of the cubesat each, lost in space: within three pixels, and the length that the rate draws."""
    across = math.sqrt(0.5) * rate_deg_s
    overrides = ["study.sampling=sky", "tracker.prior=false", "tracker.identifier=adaptive"]
    scenario = Scenario.load(CUBESAT, [*overrides, f"pointing.rate_deg_s=[{across}, 0, {across}]"], seed=4)
    renderer = Renderer(scenario)
    tracker = build_tracker(scenario, renderer.camera)
    for index in range(3):
        frame, truth = renderer.frame(index)
        found = find_trails(frame.image.astype(np.float32), estimate(frame.image, 64))
        assert found is not None
        assert np.hypot(*found.motion[:2]) == pytest.approx(length, rel=0.03)
        solution = solve_frame(tracker, frame)
        assert solution.attitude is not None
        x, y, _ = truth.attitude.rotation_vector_to(solution.attitude)
        assert math.hypot(x, y) < 3.0 * frame.camera.pixel_rad


@pytest.mark.parametrize("detector", GENERAL)
def test_short_streaks_are_stars_whatever_the_detector(detector: str) -> None:
    """Trails of 8 px, which no detector but the first looks for itself: half a pixel, lost in space."""
    overrides = ["study.sampling=sky", "tracker.prior=false", f"tracker.detector={detector}"]
    scenario = Scenario.load(CUBESAT, [*overrides, "pointing.rate_deg_s=[0.4, 0, 0.3]"], seed=4)
    renderer = Renderer(scenario)
    tracker = build_tracker(scenario, renderer.camera)
    for index in range(4):
        frame, truth = renderer.frame(index)
        solution = solve_frame(tracker, frame)
        assert solution.attitude is not None
        x, y, _ = truth.attitude.rotation_vector_to(solution.attitude)
        assert math.hypot(x, y) < 0.5 * frame.camera.pixel_rad
