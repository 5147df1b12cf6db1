"""Fits of trails, their common motion and the camera's turn: against SciPy, plain loops, and closed formulas."""

import math

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.special import ndtr

from startracker.centroid.result import Centroids
from startracker.detection.tiles import as_plane
from startracker.geometry.camera import Camera
from startracker.trails import Trails, mid_exposure
from startracker.trails import motion as motion_module
from startracker.trails.fit import (
    _first_fit,
    _shift,
    _strongest_beside,
    best_stretches,
    fit_trail,
    light_along,
    measure_trails,
)
from startracker.trails.model import LINE, POSITION, SHAPE, _decay, window_pixels
from startracker.trails.motion import (
    CommonMotion,
    Signal,
    _fitted,
    _is_inside,
    _lengthened,
    _Straight,
    _straightened,
    _weighted_motion,
    _without_blur,
    find_motion,
    lengths_of,
    within,
)
from startracker.trails.turn import Turn, _bows, _widening, axes_of, fit_turn, weighted_step

SIZE = (60, 70)
NOISE = 3.0
PLANE = as_plane(np.full(SIZE, NOISE, np.float32))
TRAIL = np.array([32.3, 28.6, 3000.0, 2.0, 0.4, 9.0, 1.1])


def light(p, x, y):
    dx, dy, cos, sin = x - p[0], y - p[1], math.cos(p[4]), math.sin(p[4])
    s, t = dx * cos + dy * sin, dy * cos - dx * sin
    along = ndtr((s + p[5]) / p[6]) - ndtr((s - p[5]) / p[6])
    return p[2] / (2.0 * p[5]) * along * np.exp(-0.5 * (t / p[6]) ** 2) / (p[6] * math.sqrt(2.0 * math.pi)) + p[3]


def image_of(*trails, seed=None):
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    image = sum((light(np.array(p), x, y) for p in trails), np.zeros(SIZE))
    if seed is not None:
        image = image + np.random.default_rng(seed).normal(0.0, NOISE, SIZE)
    return image.astype(np.float32)


# ---------------------------------------------------------------------- one trail
@pytest.mark.parametrize("size", [POSITION, SHAPE, LINE])
@pytest.mark.parametrize("flux", [0.0, 2500.0])
def test_a_fit_is_the_minimum_that_scipy_finds(size, flux):
    """To 0.01 in χ², and so to 0.1 standard errors; the covariance is that of the slopes there."""
    image, start = image_of(TRAIL, seed=1), TRAIL.copy()
    start[:2] += 0.4, -0.3
    start[2] = flux
    if size > POSITION:
        start[4] += 0.02
    if size > SHAPE:
        start[5] += 0.5
    if size == LINE:
        start[6] = 1.2
    p, covariance, chi2, freedom = fit_trail(image, PLANE, start, size, 2.0, 0.0)
    pixels, usable = window_pixels(image, PLANE, start, 2.0)
    x, y, value, _ = pixels[:, np.isfinite(pixels[3])]

    def rest(free):
        return (value - light(np.concatenate([free, start[size:]]), x, y)) / NOISE

    best = least_squares(rest, p[:size], x_scale=np.sqrt(np.diag(covariance)), method="lm")
    assert freedom == usable - size - np.count_nonzero(np.abs(best.fun) > 5.0)
    assert chi2 * freedom == pytest.approx(2.0 * best.cost, abs=0.03)
    sigma = np.sqrt(np.diag(np.linalg.inv(best.jac.T @ best.jac)))
    assert (np.abs(p[:size] - best.x) < 0.1 * sigma).all()
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), sigma, rtol=0.02)
    np.testing.assert_array_equal(p[size:], start[size:])
    assert ((p - TRAIL)[:size] ** 2 < 16.0 * sigma**2).all()


def test_photon_noise_and_a_hot_pixel():
    """A pixel beyond 5 σ is left out: one degree of freedom less, and the position as without it."""
    image = image_of(TRAIL, seed=2)
    whole = fit_trail(image, PLANE, TRAIL, POSITION, 2.0, 0.0)
    hot = image.copy()
    hot[28, 32] += 40.0 * NOISE
    found = fit_trail(hot, PLANE, TRAIL, POSITION, 2.0, 0.0)
    assert found[3] == whole[3] - 1
    assert found[2] < 1.3
    off = (found[0] - whole[0])[:3]
    assert off @ np.linalg.solve(whole[1][:3, :3], off) < 1.0
    # with photon noise: the variance of a pixel is 9 and half its light
    p, covariance, *_ = fit_trail(image, PLANE, TRAIL, POSITION, 2.0, 0.5)
    pixels, _ = window_pixels(image, PLANE, TRAIL, 2.0)
    x, y, _, _ = pixels[:, np.isfinite(pixels[3])]
    slopes = [(light(p + step, x, y) - light(p - step, x, y)) / (2.0 * step.sum()) for step in 1e-3 * np.eye(7)[:4]]
    normal = (slopes / (NOISE**2 + 0.5 * (light(p, x, y) - p[3]))) @ np.transpose(slopes)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), np.sqrt(np.diag(np.linalg.inv(normal))), rtol=0.01)


def test_what_cannot_be_fitted():
    image = image_of(TRAIL)
    cases = {
        "dark": (-image, TRAIL * [1, 1, 0, 1, 1, 1, 1], LINE),
        "outside": (image, TRAIL + np.array([200.0, 0, 0, 0, 0, 0, 0]), POSITION),
        "nothing usable": (np.full(SIZE, np.nan, np.float32), TRAIL, POSITION),
    }
    for name, (given, start, size) in cases.items():
        p, covariance, chi2, freedom = fit_trail(given, PLANE, start, size, 0.0, 0.0)
        assert (chi2, freedom) == (math.inf, 0), name
        assert not covariance.any()
        np.testing.assert_array_equal(p[[0, 1, 4, 5, 6]], start[[0, 1, 4, 5, 6]])
    few = np.full(SIZE, np.nan, np.float32)
    few[28, 30:34] = image[28, 30:34]
    assert fit_trail(few, PLANE, TRAIL, POSITION, 0.0, 0.0)[2] == math.inf  # four pixels for four unknowns
    few[28, 30:35] = image[28, 30:35]
    assert fit_trail(few, PLANE, TRAIL, POSITION, 0.0, 0.0)[3] <= 1


def test_width_and_length_stay_within_limits():
    """A point is not a shorter than half a pixel, and no image four times as wide as it began."""
    narrow = TRAIL.copy()
    narrow[5], narrow[6] = 0.5, 1.1
    start = narrow.copy()
    start[5] = 3.0
    p, *_ = fit_trail(image_of(TRAIL * [1, 1, 1, 1, 1, 1e-3, 1], seed=3), PLANE, start, SHAPE, 2.0, 0.0)
    assert p[5] == 0.5
    wide, start = TRAIL.copy(), TRAIL.copy()
    wide[6], start[6] = 4.0, 0.7
    p, *_ = fit_trail(image_of(wide, seed=4), PLANE, start, LINE, 12.0, 0.0)
    assert p[6] <= 2.8


# ---------------------------------------------------------------------- light along a line
@pytest.mark.parametrize("angle", [0.0, 0.6, 2.2])
def test_light_along_a_line_is_that_of_a_plain_loop(angle):
    """Five pixels across, weighted; clipped at −4 and +8 times the noise; what is not a number or outside is dark."""
    image = image_of(TRAIL, seed=5)
    image[20:24, 30] = 1e4
    image[30:33, 36] = -1e4
    image[26, 31:34] = np.nan
    p = np.array([9.2, 28.4, 0.0, 0.0, angle, 5.0, 1.3])
    total = light_along(image, PLANE, p, 14)
    weights = np.exp(-0.5 * (np.arange(-2, 3) / 1.8) ** 2)
    weights /= np.linalg.norm(weights)
    expected = [0.0]
    for s in range(-14, 15):
        light_here = 0.0
        for t in range(-2, 3):
            x = round(p[0] + s * math.cos(angle) - t * math.sin(angle))
            y = round(p[1] + s * math.sin(angle) + t * math.cos(angle))
            if 0 <= x < SIZE[1] and 0 <= y < SIZE[0] and np.isfinite(image[y, x]):
                light_here += weights[t + 2] * min(max(image[y, x] / NOISE, -4.0), 8.0)
        expected.append(expected[-1] + light_here)
    np.testing.assert_allclose(total, expected, atol=1e-4)


def test_the_last_column_and_row_count():
    image = np.full(SIZE, NOISE, np.float32)
    corner = np.array([SIZE[1] - 1.0, SIZE[0] - 1.0, 0.0, 0.0, 0.25 * math.pi, 5.0, 1.0])
    inside, first = light_along(image, PLANE, corner, 3), np.array([0.0, 0.0, *corner[2:]])
    np.testing.assert_allclose(inside[::-1], inside[-1] - light_along(image, PLANE, first, 3), atol=1e-5)
    assert inside[3] > 0.0
    assert inside[4] > inside[3] + 0.5  # the corner itself
    assert inside[7] == inside[6]


def test_the_best_stretch_contains_the_middle():
    rng = np.random.default_rng(6)
    reach = 15
    for _ in range(20):
        total = np.concatenate([[0.0], np.cumsum(rng.normal(size=2 * reach + 1))])
        lengths = np.array([1, 2, 5, 8, 16, 30, 31])
        best, middle = best_stretches(total, lengths)
        for n, length in enumerate(lengths):
            scores = {}
            for first in range(2 * reach + 2 - length):
                if first <= reach <= first + length - 1:
                    scores[first] = (total[first + length] - total[first]) / math.sqrt(length)
            first = max(scores, key=lambda k: scores[k])
            assert best[n] == pytest.approx(scores[first])
            assert middle[n] == first + 0.5 * (length - 1) - reach


def test_a_trail_moves_along_and_across_itself():
    p = np.array([10.0, 20.0, 0.0, 0.0, math.atan2(3.0, 4.0), 5.0, 1.0])
    _shift(p, 5.0, 0.0)
    np.testing.assert_allclose(p[:2], [14.0, 23.0])
    _shift(p, 0.0, 5.0)
    np.testing.assert_allclose(p[:2], [11.0, 27.0])


@pytest.mark.parametrize("aside", [-5.0, 3.0])
def test_the_strongest_trail_beside_another(aside):
    """On either side, from 2 to 7 px: its middle, a light that is not yet known, and its signal-to-noise ratio."""
    other = TRAIL.copy()
    _shift(other, 3.0, aside)
    best, score = _strongest_beside(image_of(other * [1, 1, 0.5, 0, 1, 1, 1], seed=7), PLANE, TRAIL)
    away = (other - best)[:2] @ [[-math.sin(0.4)], [math.cos(0.4)]]
    assert abs(away[0]) < 0.8
    assert np.hypot(*(other - best)[:2]) < 3.0
    assert (best[2], best[3]) == (0.0, 0.0)
    np.testing.assert_array_equal(best[4:], TRAIL[4:])
    assert score > 20.0
    for far in (1.0e-9, 11.0):
        third = TRAIL.copy()
        _shift(third, 0.0, far)
        assert _strongest_beside(image_of(third * [1, 1, 0.02, 0, 1, 1, 1], seed=8), PLANE, TRAIL)[1] < 6.0


def test_first_fits_begin_where_the_light_is():
    """4 px along and 2.5 widths aside of its start; too faint, and too far: none."""
    image = image_of(TRAIL, seed=9)
    start = TRAIL * [1, 1, 0, 0, 1, 1, 1]
    for along, aside in ((0.0, 0.0), (4.0, 0.0), (0.0, 2.5 * 1.1), (0.0, -2.5 * 1.1)):
        moved = start.copy()
        _shift(moved, along, aside)
        p, covariance, chi2, _ = _first_fit(image, PLANE, moved, 0.0, 5.0)
        assert np.hypot(*(p - TRAIL)[:2]) < 0.5, (along, aside)
        assert chi2 < 1.3
    ratio = p[2] / math.sqrt(covariance[2, 2])
    assert _first_fit(image, PLANE, start, 0.0, 0.98 * ratio)[2] < math.inf
    assert _first_fit(image, PLANE, start, 0.0, 1.02 * ratio)[2] == math.inf
    moved = start.copy()
    _shift(moved, 5.5, 0.0)
    assert _first_fit(image, PLANE, moved, 0.0, 5.0)[2] == math.inf  # more than a quarter of its length away


def test_all_trails_of_a_frame():
    """Two that overlap and one that another runs beside, 4 px away, of half its light; the rest is noise."""
    lines = [TRAIL, TRAIL + np.array([12.0, -1.0, -800.0, -2.0, 0, 0, 0]), TRAIL * [1, 1, 0.5, 0, 1, 1, 1]]
    _shift(lines[2], 2.0, -6.0)
    image = image_of(*lines, seed=10)
    starts = np.array(lines[:2]) * [1, 1, 0, 0, 1, 1, 1]
    rest = image.copy()
    found = measure_trails(rest, PLANE, starts, 0.0, 5.0, 9)
    assert len(found.table) == 3
    for p, wanted in zip(found.table, lines, strict=True):
        assert np.hypot(*(p - wanted)[:2]) < 0.6
        assert p[2] == pytest.approx(wanted[2], rel=0.2)
    assert found.alone.all()
    assert (found.freedom > 100).all()
    assert (found.chi2 < 1.4).all()
    assert np.std(rest - 2.0) < 1.15 * NOISE
    assert len(measure_trails(image.copy(), PLANE, starts, 0.0, 5.0, 1).table) == 2  # one, and the one beside it
    faint = image_of(TRAIL * [1, 1, 0.06, 0, 1, 1, 1], seed=11)
    found = measure_trails(faint, PLANE, starts[:1], 0.0, 3.0, 9)
    assert (len(found.table), found.alone.tolist()) == (1, [False])
    assert found.table[0, 4] == TRAIL[4]


def test_the_exponential():
    u = np.linspace(0.0, 18.0, 500)
    np.testing.assert_allclose([_decay(v) for v in u], np.exp(-u), rtol=1.4e-5)
    assert 0.0 <= _decay(700.0) < 1e-7


# ---------------------------------------------------------------------- the common motion
def signal_of(width=100, height=80):
    shape = (height, width)
    return Signal(np.zeros(shape, np.float32), as_plane(np.ones(shape, np.float32)), 0.0)


def test_lines_of_a_motion_and_how_well_their_length_is_known():
    covariance = np.array([[0.04, 0.01, 1e-4], [0.01, 0.09, 2e-4], [1e-4, 2e-4, 1e-5]])
    motion = CommonMotion(np.array([10.0, -4.0, 0.05]), covariance, np.array([49.5, 39.5]), 1.0, None)
    xy = np.array([[10.0, 70.0], [49.5, 39.5]])
    lines, variance = motion.lines_at(xy)
    for at, line, found in zip(xy - [49.5, 39.5], lines, variance, strict=True):
        np.testing.assert_allclose(line, [10.0 - 0.05 * at[1], -4.0 + 0.05 * at[0]])
        unit = line / np.hypot(*line)
        slope = np.array([unit[0], unit[1], unit[1] * at[0] - unit[0] * at[1]])
        assert found == pytest.approx(slope @ covariance @ slope)
    still = motion._replace(motion=np.zeros(3)).lines_at(xy)
    assert not still[0].any()
    assert np.isfinite(still[1]).all()


def test_which_trails_are_whole():
    """By the ends of their lines, with a margin; the borders are half a pixel outside the last pixels' centres."""
    table = np.array([[20.0, 30.0, 0, 0, math.atan2(3.0, 4.0), 10.0, 1.0]])
    np.testing.assert_allclose(lengths_of(table), [[16.0, 12.0]])
    signal = signal_of()
    for x, y, margin, inside in (
        (10.0, 40.0, 2.0, True), (9.99, 40.0, 2.0, False), (89.0, 40.0, 2.0, True), (89.01, 40.0, 2.0, False),
        (50.0, 8.0, 2.0, True), (50.0, 7.99, 2.0, False), (50.0, 71.0, 2.0, True), (50.0, 71.01, 2.0, False),
        (8.0, 40.0, 0.0, True),
    ):  # fmt: skip
        table[0, :2] = x, y
        assert within(signal, table, np.array([margin])).tolist() == [inside]
        # with the 4 px of lines that may go on beyond
        table[0, :2] += np.sign([x - 49.5, y - 39.5]) * (margin - 4.0) * (np.abs([x - 49.5, y - 39.5]) > 20.0)
        assert _is_inside(signal, table[0]) is inside
    assert signal.middle.tolist() == [49.5, 39.5]


def test_the_motion_is_shorter_by_the_blur_of_both_ends():
    """In the median, never longer, and at most by six widths of the star image."""
    middle, motion = np.array([50.0, 40.0]), np.array([12.0, 16.0, 0.0])
    for lengths, sigma, expected in (
        ((16.0, 17.0, 19.0), 1.0, 17.0), ((21.0, 22.0, 23.0), 1.0, 20.0), ((5.0, 6.0, 7.0), 1.0, 14.0),
        ((5.0, 6.0, 7.0), 2.0, 8.0),
    ):  # fmt: skip
        fits = np.array([[10.0 * k, 20.0, 0, 0, 0, 0.5 * length, sigma] for k, length in enumerate(lengths)])
        found = _without_blur(motion, fits, middle)
        np.testing.assert_allclose(found, motion * expected / 20.0)


def test_the_length_with_which_all_lines_agree():
    """The light along three lines is best at 12 px, or one step less: the motion of 10 px is stretched; a fourth of
    another direction has no say; if another length is as good there is none."""
    lengths = np.arange(8, 25)
    score = 10.0 - 0.5 * np.abs(lengths - 12.0)
    trails = np.array([[10.0, 0.0], [12.0, 0.2], [8.0, 0.0], [0.0, 10.0]])
    scores = np.vstack([score, score, score, score[::-1] * 3.0])
    straight = _Straight(np.zeros((4, 7)), lengths, scores, np.zeros((4, 17)))
    motion = np.array([10.0, 0.0, 0.0])
    found = _lengthened(motion, np.zeros((4, 2)), trails, straight)
    np.testing.assert_allclose(found, [11.0, 0.0, 0.0])
    twice = np.where(lengths > 22, 9.9, score)
    flat = straight._replace(scores=np.vstack([twice] * 4))
    assert _lengthened(motion, np.zeros((4, 2)), trails, flat) is None
    negative = straight._replace(scores=np.vstack([score, score, score, -50.0 * score]))
    np.testing.assert_allclose(_lengthened(motion, np.zeros((4, 2)), trails, negative), [11.0, 0.0, 0.0])


def test_a_motion_of_weighted_lengths_and_directions():
    """Exact trails give the motion exactly, either way round; its covariance is that of least squares."""
    rng = np.random.default_rng(12)
    xy = rng.uniform(-40.0, 40.0, (12, 2))
    true = np.array([14.0, -6.0, 0.06])
    trails = np.column_stack([true[0] - true[2] * xy[:, 1], true[1] + true[2] * xy[:, 0]])
    variance = np.tile([0.04, 0.01], (12, 1))
    signs = np.where(rng.random(12) < 0.5, -1.0, 1.0)[:, None]
    motion, covariance = _weighted_motion(xy, signs * trails, variance, true * 1.05)
    np.testing.assert_allclose(motion, true, atol=1e-9)
    design = []
    for (x, y), line in zip(xy, trails, strict=True):
        u, v = line / np.hypot(*line)
        for (a, b), sigma in (((u, v), 0.2), ((-v, u), 0.1)):
            design.append(np.array([a, b, b * x - a * y]) / sigma)
    np.testing.assert_allclose(covariance, np.linalg.inv(np.transpose(design) @ design), rtol=1e-6)
    trails[0] *= 1.5  # one of twelve that is 50 % longer, 35 of its standard errors, hardly moves it
    off = _weighted_motion(xy, trails, variance, true)[0] - true
    assert off @ np.linalg.solve(covariance, off) < 1.0


def test_a_motion_is_found_from_lines_and_not_from_three():
    """Five trails of (14, 6) px, forwards and backwards; of three, or of five directions, there is none."""
    rng = np.random.default_rng(13)
    image = rng.normal(0.0, NOISE, (160, 180)).astype(np.float32)
    y, x = np.mgrid[:160, :180]
    angle, half = math.atan2(6.0, 14.0), 0.5 * math.hypot(14.0, 6.0)
    places = [(30, 30), (90, 40), (150, 30), (40, 110), (120, 120)]
    for at in places:
        image += light(np.array([*at, 3000.0, 0.0, angle, half, 1.2]), x, y).astype(np.float32)
    signal = Signal(image, as_plane(np.full(image.shape, NOISE, np.float32)), 0.0)
    lines = np.array([[*at, 6.5 * sign, 3.0 * sign] for at, sign in zip(places, (1, -1, 1, -1, 1), strict=True)])
    found = find_motion(signal, lines, 0.9, True)
    sign = np.sign(found.motion[0])
    np.testing.assert_allclose(sign * found.motion, [14.0, 6.0, 0.0], atol=0.5)
    assert abs(found.motion[2]) < 0.02
    assert found.sigma == pytest.approx(1.2, abs=0.1)
    assert found.turn is None
    assert find_motion(signal, lines, 0.9, False).sigma == pytest.approx(0.9)
    assert find_motion(signal, lines[:3], 0.9, True) is None
    crossed = lines.copy()
    crossed[:, 2:] = [[6.5, 3.0], [3.0, -6.5], [6.5, -3.0], [0.0, 7.0], [7.0, 0.0]]
    empty = Signal(rng.normal(0.0, NOISE, image.shape).astype(np.float32), signal.noise, 0.0)
    assert find_motion(empty, crossed, 0.9, True) is None


# ---------------------------------------------------------------------- the turn of the camera
CAMERA = Camera.from_fov(20.0, 1024, 1024)
TURN_RAD = 0.5 * np.array([0.04, -0.06, 0.05])
XY = np.array([[100.0, 900.0], [511.5, 511.5], [960.0, 200.0], [300.0, 240.0], [800.0, 850.0]])


def ends(xy, half=TURN_RAD, camera=CAMERA):
    from startracker.geometry.attitude import rotation_vector_to_matrix

    stars = camera.unproject(xy)
    return [camera.project(stars @ rotation_vector_to_matrix(sign * half).T) for sign in (1.0, -1.0)]


def test_lines_of_a_turn_and_the_variance_of_their_lengths():
    covariance = np.diag([1e-8, 4e-8, 1e-6]) + 1e-9
    turn = Turn(TURN_RAD, covariance, CAMERA)
    lines, variance = turn.lines_at(XY)
    begin, end = ends(XY)
    np.testing.assert_allclose(lines, end - begin, atol=1e-9)
    length = np.hypot(*lines.T)
    slopes = []
    for k in range(3):
        step = np.zeros(3)
        step[k] = 1e-5
        up, down = (np.hypot(*np.subtract(*ends(XY, TURN_RAD + sign * step)).T) for sign in (1.0, -1.0))
        slopes.append((up - down) / 2e-5)
    slopes = np.array(slopes).T
    np.testing.assert_allclose(variance, np.einsum("ni,ij,nj->n", slopes, covariance, slopes), rtol=1e-3)
    assert (length > 20.0).all()


def motion_of(half, camera=CAMERA):
    return np.array([2.0 * half[1] * camera.fx, -2.0 * half[0] * camera.fy, 2.0 * half[2]])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_turn_of_exact_trails(sign):
    """From a motion 2 % off; either way round; one outlier is held down; the motion's own error is its prior."""
    begin, end = ends(XY)
    measured, variance = sign * (end - begin), np.full((5, 2), 1e-4)
    motion = motion_of(TURN_RAD) * [1.02, 0.98, 1.0]
    turn = fit_turn(XY, measured, variance, motion, CAMERA)
    start = 0.5 * np.array([-motion[1] / CAMERA.fy, motion[0] / CAMERA.fx, motion[2]])
    error = 0.3 + 0.02 * math.hypot(*motion[:2])
    information = np.diag((np.array([2.0 * CAMERA.fx, 2.0 * CAMERA.fx, 1024.0]) / error) ** 2)
    np.testing.assert_allclose(turn.half, TURN_RAD, atol=2e-6)
    fresh = np.linalg.inv(turn.covariance) - information
    assert (np.linalg.eigvalsh(fresh) > 0.0).all()
    measured[0] *= 1.2
    np.testing.assert_allclose(fit_turn(XY, measured, variance, motion, CAMERA).half, TURN_RAD, atol=2e-5)
    for xy, given in ((np.empty((0, 2)), motion), (XY, motion * 19.9 / math.hypot(*motion[:2]))):
        rows = slice(0, len(xy))
        short = fit_turn(xy, measured[rows], variance[rows], given, CAMERA)
        error = 0.3 + 0.02 * math.hypot(*given[:2])
        np.testing.assert_allclose(short.half, start * given[0] / motion[0])
        expected = np.diag((error / np.array([2.0 * CAMERA.fx, 2.0 * CAMERA.fx, 1024.0])) ** 2)
        np.testing.assert_allclose(short.covariance, expected, rtol=1e-9)
    longer = fit_turn(XY, measured, variance, motion * 20.1 / math.hypot(*motion[:2]), CAMERA)
    assert np.abs(longer.half - start * 20.1 / math.hypot(*motion[:2])).max() > 1e-4


def test_one_step_of_the_weighted_fit():
    """Slopes and values in standard errors with Cauchy's weights, 1/(1 + (r/2.4)²), and what is known before."""
    rng = np.random.default_rng(14)
    design, target, found = rng.normal(size=(6, 2, 3)), rng.normal(size=(6, 2)) * 3.0, np.array([0.1, -0.2, 0.3])
    slopes, values = design.reshape(12, 3), target.reshape(12)
    weights = 1.0 / (1.0 + ((values - slopes @ found) / 2.4) ** 2)
    normal = (slopes * weights[:, None]).T @ slopes
    for information in (0.0, np.diag([1.0, 2.0, 3.0])):
        step, matrix = weighted_step(design, target, found, information)
        np.testing.assert_allclose(matrix, normal + information)
        np.testing.assert_allclose(step, np.linalg.solve(normal + information, slopes.T @ (weights * values)))


def test_axes_along_and_across():
    np.testing.assert_allclose(axes_of(np.array([[3.0, 4.0]])), [[[0.6, 0.8], [-0.8, 0.6]]])
    np.testing.assert_allclose(axes_of(np.array([[[0.0, -2.0]]])), [[[[0.0, -1.0], [1.0, 0.0]]]])
    assert not axes_of(np.zeros((1, 2)))[0, 0].any()


def test_how_far_the_middle_lies_from_the_star():
    """Of the ends along the trail, a third of their height across it; nothing where the camera sees no end."""
    begin, end = ends(XY)
    along = axes_of(end - begin)
    off = np.einsum("nij,nj->ni", along, 0.5 * (begin + end) - XY) * [1.0, 1.0 / 3.0]
    np.testing.assert_allclose(_bows(XY, CAMERA, TURN_RAD[None])[0], np.einsum("ni,nij->nj", off, along), atol=1e-9)
    assert np.abs(off).max() > 0.05
    behind = _bows(XY[:1], CAMERA, np.array([[0.0, 2.0, 0.0]]))
    assert not behind.any()


def test_trails_that_contradict_the_turn_have_wider_errors():
    """Of lengths known to 0.5 px and directions to 0.3 px at the ends, besides 0.1 px and the error of the turn: from 4
    standard errors on, by their square."""
    turn = Turn(TURN_RAD, np.diag([1e-10, 1e-10, 1e-8]), CAMERA)
    lines, by_turn = turn.lines_at(XY)
    variance = np.tile([0.25, 0.09], (5, 1))
    along, across = axes_of(lines)[:, 0], axes_of(lines)[:, 1]
    error = np.sqrt(variance + 0.01 + np.column_stack([by_turn, np.zeros(5)]))
    steps = np.array([[3.9, 0.0], [4.1, 0.0], [0.0, -3.9], [0.0, 5.0], [0.0, 0.0]]) * error
    measured = lines + steps[:, :1] * along + steps[:, 1:] * across
    for sign in (1.0, -1.0):
        found = _widening(turn, XY, sign * measured, variance)
        np.testing.assert_allclose(found, [1.0, 4.1**2, 1.0, 25.0, 1.0], rtol=1e-6)
    slow = turn._replace(half=TURN_RAD * 19.9 / (2.0 * CAMERA.fx * np.hypot(*TURN_RAD[:2])))
    np.testing.assert_array_equal(_widening(slow, XY, measured, variance), np.ones(5))


def test_positions_at_mid_exposure_and_their_common_error():
    """The bow is taken off; what the turn is not known by moves all stars alike; only own trails are made wider."""
    begin, end = ends(XY)
    lengths, own = end - begin, np.array([True, True, False, True, True])
    stated = np.tile(0.01**2 * np.eye(2), (5, 1, 1))
    lengths[1] *= 1.2
    stars = Centroids(XY, np.ones(5), stated, np.zeros(5, bool), misfit=0.5)
    trails = Trails(stars, motion_of(TURN_RAD), lengths, own)
    found = mid_exposure(trails, CAMERA)
    variance = np.tile([4e-4, 12e-4], (4, 1))
    turn = fit_turn(XY[own], lengths[own], variance, trails.motion, CAMERA)
    np.testing.assert_allclose(XY - found.xy, _bows(XY, CAMERA, turn.half[None])[0], atol=1e-9)
    wider = np.ones(5)
    wider[own] = _widening(turn, XY[own], lengths[own], variance)
    assert wider[1] > 16.0
    assert wider[[0, 3, 4]].tolist() == [1.0, 1.0, 1.0]
    np.testing.assert_allclose(found.covariance, stated * wider[:, None, None])
    sigma, moved = np.sqrt(np.diag(turn.covariance)), []
    for k in range(3):
        step = np.zeros(3)
        step[k] = sigma[k]
        bows = _bows(XY, CAMERA, np.array([turn.half, turn.half + step]))
        moved.append(np.mean(bows[1] - bows[0], axis=0) / sigma[k])
    np.testing.assert_allclose(found.common_px2, np.transpose(moved) @ turn.covariance @ moved, rtol=1e-9)
    assert found.misfit == 0.5
    np.testing.assert_array_equal(stated[1], 0.01**2 * np.eye(2))  # those of the trails stay


# ---------------------------------------------------------------------- lines made straight, and the fit to them
def straight_lines(monkeypatch, lines, moved=(0.0, 0.0), chi2=1.0, score=6.0, flux=None):
    """`_straightened` of lines whose fits and stretches are written down: 1 px to the right of the line's middle and 10
    px long at best."""
    asked = []

    def fit(residual, noise, start, size, slack, inverse_gain):
        asked.append((start.copy(), size, slack))
        made = start.copy()
        made[:2] += moved
        made[2] = 100.0 + len(asked) if flux is None else flux[len(asked) - 1]
        return made, None, chi2, 99

    monkeypatch.setattr(motion_module, "fit_trail", fit)
    monkeypatch.setattr(motion_module, "light_along", lambda *given: given[3])
    stretches = np.array([1.0, score, 2.0]), np.array([0.5, 1.0, -3.0])
    monkeypatch.setattr(motion_module, "best_stretches", lambda total, lengths: stretches)
    lengths = np.array([8, 10, 12])
    return _straightened(signal_of(), np.array(lines, dtype=float), 1.3, lengths), asked


def test_lines_are_made_straight(monkeypatch):
    """Fitted in position and direction from their middle, at least 2 px long, then moved to their best stretch."""
    lines = [[30.0 + 5.0 * k, 40.0, 3.0, 4.0] for k in range(3)] + [[50.0, 50.0, 0.0, -1.0]]
    found, asked = straight_lines(monkeypatch, lines)
    start, size, slack = asked[0]
    np.testing.assert_allclose(start, [30.0, 40.0, 0.0, 0.0, math.atan2(4.0, 3.0), 5.0, 1.3])
    assert (size, slack) == (5, 3.0)
    assert asked[3][0][4:6].tolist() == [math.atan2(-1.0, 0.0), 2.0]
    # brightest first: the last one
    np.testing.assert_allclose(found.table[0, [0, 1, 2, 5]], [50.0, 49.0, 104.0, 5.0], atol=1e-12)
    np.testing.assert_allclose(found.table[3, :2], [30.6, 40.8])
    np.testing.assert_allclose(found.middles[0], [-0.5, 0.0, -4.0])
    np.testing.assert_allclose(found.scores[0], [1.0, 6.0, 2.0])
    assert found.lengths.tolist() == [8, 10, 12]
    assert straight_lines(monkeypatch, lines[:3])[0] is None
    many = [[30.0 + k, 40.0, 3.0, 4.0] for k in range(15)]
    found, asked = straight_lines(monkeypatch, many)
    assert (len(found.table), len(asked)) == (12, 12)


@pytest.mark.parametrize(
    ("given", "there"),
    [
        ({"score": 5.5}, True),
        ({"score": 5.49}, False),
        ({"moved": (0.0, 7.99)}, True),  # half of the line, and 3 px
        ({"moved": (0.0, 8.01)}, False),
        ({"chi2": math.inf}, False),
        ({"chi2": math.nan}, False),
    ],
)
def test_lines_that_stand_out_and_stay(monkeypatch, given, there):
    lines = [[40.0 + 5.0 * k, 40.0, 3.0, 4.0] for k in range(4)]
    assert (straight_lines(monkeypatch, lines, **given)[0] is not None) is there
    cut = [*lines[:3], [40.0, -5.0, 3.0, 4.0]]  # its end is beyond the border
    assert straight_lines(monkeypatch, cut, **given)[0] is None


def fitted_motion(monkeypatch, lengths, chi2=1.0, camera=None, measure_sigma=True, motion=(20.0, 0.0, 0.0)):
    """`_fitted` of lines along x whose fits have these lengths; widths of 1.0, 1.1, …"""
    asked, made_up = [], iter(range(99))

    def fit(residual, noise, start, size, slack, inverse_gain):
        asked.append((start.copy(), size, slack))
        k = next(made_up)
        made = start.copy()
        made[4], made[5], made[6] = 0.0, 0.5 * lengths[k], 1.0 + 0.1 * k
        return made, np.diag([0.01, 0.01, 9.0, 1.0, 1e-4, 0.04, 0.01]), chi2, 99

    monkeypatch.setattr(motion_module, "fit_trail", fit)
    n = len(lengths)
    table = np.array([[40.0 + k, 20.0 + 5.0 * k, 100.0 - k, 0.0, 0.0, 9.0, 0.7] for k in range(n)])
    straight = _Straight(table, np.array([10, 30]), np.ones((n, 2)), np.tile([2.0, -2.0], (n, 1)))
    return _fitted(signal_of(), np.array(motion), straight, measure_sigma, camera), asked


def test_the_motion_of_fitted_lines(monkeypatch):
    """Begun at the length of the motion, moved to where the stretch of that length is: half-way, 0 px from the line's
    middle. Five of 20 px, and one of another length that has no say."""
    found, asked = fitted_motion(monkeypatch, [20.0, 20.0, 20.0, 20.0, 20.0, 60.0])
    start, size, slack = asked[0]
    np.testing.assert_allclose(start[[0, 1, 5]], [40.0, 20.0, 10.0])
    assert (size, slack) == (LINE, 3.0 + 0.05 * 10.0)
    np.testing.assert_allclose(found.motion, [20.0, 0.0, 0.0], atol=1e-9)
    assert found.sigma == pytest.approx(1.2)  # of the five brightest
    assert fitted_motion(monkeypatch, [20.0] * 6, measure_sigma=False)[0].sigma == 0.7
    # variances: 4 χ² σ²(h), 4 χ² h² σ²(angle), 0.1² besides; of the length (0.3 + 0.01 L)² as well
    xy = np.array([[40.0 + k, 20.0 + 5.0 * k] for k in range(5)]) - [49.5, 39.5]
    variance = np.array([4.0 * 0.04 + 0.01 + (0.3 + 0.2) ** 2, 4.0 * 100.0 * 1e-4 + 0.01])
    design = [row for x, y in xy for row in (np.array([1.0, 0.0, -y]), np.array([0.0, 1.0, x]))]
    weights = np.tile(1.0 / variance, 5)
    normal = (np.transpose(design) * weights) @ design
    np.testing.assert_allclose(found.covariance, np.linalg.inv(normal), rtol=1e-6)
    assert found.turn is None
    assert found.middle.tolist() == [49.5, 39.5]


@pytest.mark.parametrize(
    ("lengths", "chi2", "there"),
    [
        ([20.0] * 4, 1.0, True),
        ([20.0] * 3, 1.0, False),
        ([20.0] * 4, math.inf, False),
        ([20.0] * 4 + [90.0] * 2, 1.0, True),  # two reach beyond the image
        ([20.0] * 3 + [12.0], 1.0, False),
    ],
)
def test_a_motion_needs_four_lines_that_fit(monkeypatch, lengths, chi2, there):
    assert (fitted_motion(monkeypatch, lengths, chi2)[0] is not None) is there


def test_only_long_trails_show_how_the_camera_turned(monkeypatch):
    """From 20 px on, with a camera."""
    camera = Camera.from_fov(20.0, 100, 80)
    for length, there in ((21.0, True), (19.0, False)):
        found, _ = fitted_motion(monkeypatch, [length] * 5, camera=camera, motion=(length, 0.0, 0.0))
        assert (found.turn is not None) is there
    assert fitted_motion(monkeypatch, [21.0] * 5, motion=(21.0, 0.0, 0.0))[0].turn is None


@pytest.mark.parametrize(("snr", "alone"), [(27.0, False), (33.0, True)])
def test_bright_trails_have_their_own_direction(snr, alone):
    """From a signal-to-noise ratio of 30: without noise the ratio of a fit is that of its flux."""
    image = image_of(TRAIL * [1, 1, 1, 0, 1, 1, 1])
    unit = math.sqrt(fit_trail(image, PLANE, TRAIL, POSITION, 2.0, 0.0)[1][2, 2])
    line = TRAIL * [1, 1, snr * unit / TRAIL[2], 0, 1, 1, 1]
    found = measure_trails(image_of(line), PLANE, np.array([line]) * [1, 1, 0, 0, 1, 1, 1], 0.0, 5.0, 9)
    assert found.alone.tolist() == [alone]
