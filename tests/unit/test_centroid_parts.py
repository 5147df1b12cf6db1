"""Parts of the centroiders against numerical derivatives, closed formulas and cases that are written down."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import least_squares
from scipy.special import ndtr
from scipy.stats import multivariate_normal

from startracker.centroid import effective_psf, psf_fit
from startracker.centroid.asymmetry import _are_single, _averaged, _fit_weighted, _parts, _pooled
from startracker.centroid.bias import SMALLEST_SIGMA_PX
from startracker.centroid.effective_psf import _as_model, _Basis, _clean_stars
from startracker.centroid.frame import SYSTEMATIC_PX, _covariances, collect, prepare
from startracker.centroid.psf_fit import _accepted, _fill_starts, _half_of, _reach_of, _start_values
from startracker.centroid.psf_kernel import Starts, fit_stars, group_stars, weighted_moments
from startracker.centroid.psf_model import gaussian_psf
from startracker.centroid.psf_shape import _gaussian_slopes, _is_ellipse, fit_gaussian, frame_psf
from startracker.centroid.psf_sums import fill_window, interpolate
from startracker.centroid.skewness import REFERENCE_CONTRAST
from startracker.centroid.window import Peaks, Pixels
from startracker.detection import Background, Spots
from startracker.detection.tiles import as_plane
from startracker.errors import InputError
from startracker.settings import CentroidSettings


def pixels_of(image, noise=5.0, level=0.0, inverse_gain=0.0):
    image = np.asarray(image, np.float32)
    planes = (as_plane(np.full(image.shape, value, np.float32)) for value in (level, noise))
    return Pixels(image, *planes, inverse_gain, 0.0)


# ---------------------------------------------------------------------- the Gaussian of a frame
NODES, WEIGHTS = np.polynomial.legendre.leggauss(3)


def gaussian(x, y, shape, nodes=NODES, weights=WEIGHTS):
    """Light of a unit Gaussian at the origin in pixels (N,), integrated by a product rule over each."""
    xx, yy, xy = shape
    determinant = xx * yy - xy**2
    total = 0.0
    for u, p in zip(nodes / 2.0, weights / 2.0, strict=True):
        for v, q in zip(nodes / 2.0, weights / 2.0, strict=True):
            a, b = x + u, y + v
            square = (yy * a * a + xx * b * b - 2.0 * xy * a * b) / determinant
            total = total + p * q * np.exp(-0.5 * square) / (2.0 * math.pi * math.sqrt(determinant))
    return total


@pytest.mark.parametrize("shape", [(0.6, 0.9, 0.0), (1.5, 0.7, 0.4), (0.8, 1.2, -0.3)])
def test_slopes_of_a_gaussian_in_pixels(shape):
    """By x, y, ln F, xx, yy and xy, against differences of the same integral."""
    wide, high, left, top = 7, 5, -3.2, -1.7
    out = np.zeros((6, wide * high + 3))
    _gaussian_slopes((left, top), wide, high, shape, out, np.empty((6, 3 * wide)))
    x, y = left + np.tile(np.arange(wide), high), top + np.repeat(np.arange(high), wide)
    step, expected = 1e-5, []
    for axis in range(2):
        move = step * np.eye(2)[axis]
        ends = [gaussian(x - sign * move[0], y - sign * move[1], shape) for sign in (1.0, -1.0)]
        expected.append((ends[0] - ends[1]) / (2.0 * step))
    expected.append(gaussian(x, y, shape))
    for k in range(3):
        change = step * np.eye(3)[k]
        ends = [gaussian(x, y, np.array(shape) + sign * change) for sign in (1.0, -1.0)]
        expected.append((ends[0] - ends[1]) / (2.0 * step))
    np.testing.assert_allclose(out[:, : wide * high], expected, atol=1e-9)
    assert not out[:, wide * high :].any()


def test_an_ellipse_has_two_positive_axes():
    """Of at least the smallest width, 0.1 px, in the geometric mean."""
    assert _is_ellipse(1.0, 1.0, 0.9)
    assert not _is_ellipse(1.0, 1.0, 1.0)
    assert not _is_ellipse(-1.0, -1.0, 0.0)
    assert not _is_ellipse(0.0, 1.0, 0.0)


def field(shape, count=9, flux=1e5, size=120, seed=1, noise=0.0):
    """Stars 36 px apart at random phases: image, positions and fluxes."""
    rng = np.random.default_rng(seed)
    side = math.ceil(math.sqrt(count))
    corner = np.stack(np.divmod(np.arange(count), side), axis=1) * 36.0 + 20.0
    xy, light = corner + rng.uniform(-0.5, 0.5, (count, 2)), flux * np.linspace(1.0, 0.5, count)
    y, x = np.mgrid[:size, :size]
    image = noise * rng.normal(size=(size, size))
    for (at_x, at_y), f in zip(xy, light, strict=True):
        image += f * gaussian(x - at_x, y - at_y, shape)
    return image, xy, light


def starts_of(xy, off=0.0):
    n = len(xy)
    return Starts(xy[:, 0] + off, xy[:, 1] - off, np.zeros(n, np.int64), np.full(n, np.inf))


@pytest.mark.parametrize("shape", [(0.7, 1.0, 0.25), (1.4, 0.9, -0.3), (0.8, 0.8, 0.0)])
def test_the_ellipse_of_stars_without_noise(shape):
    """Found to a thousandth of a px² from a round start and positions that are 0.3 px off."""
    image, xy, _ = field(shape)
    found, errors = fit_gaussian(pixels_of(image), starts_of(xy, 0.3), np.arange(9), 5, (1.0, 1.0, 0.0))
    np.testing.assert_allclose(found, shape, atol=1.5e-3)
    assert max(errors) < 2e-3
    weighed, _ = fit_gaussian(pixels_of(image), starts_of(xy, 0.3), np.arange(9), 5, (1.0, 1.0, 0.0), 10.0)
    np.testing.assert_allclose(weighed, shape, atol=1.5e-3)


def test_the_scatter_of_the_stars_is_the_error_of_their_ellipse():
    """Over forty frames: errors of the variances as stated, to 5/√80; the orientation of a round image is left out as
    far as noise explains it; one star of another image hardly counts."""
    ratios, tilts = [], []
    for seed in range(40):
        image, xy, _ = field((0.8, 1.0, 0.0), flux=4000.0, seed=seed, noise=5.0)
        found, errors = fit_gaussian(pixels_of(image, 5.0), starts_of(xy), np.arange(9), 4, (1.0, 1.0, 0.0))
        ratios.append((np.array(found[:2]) - [0.8, 1.0]) / errors)
        tilts.append(abs(found[2]))
    # of nine stars the error itself is known to a quarter: the ratio scatters by some more than 1
    assert 0.7 < np.std(ratios) < 1.6
    assert np.mean(np.array(tilts) == 0.0) > 0.9
    image, xy, _ = field((0.8, 1.0, 0.3), noise=5.0)
    y, x = np.mgrid[:120, :120]
    image += 3e4 * gaussian(x - xy[4, 0], y - xy[4, 1], (5.0, 5.0, 0.0))
    found, _ = fit_gaussian(pixels_of(image, 5.0), starts_of(xy), np.arange(9), 5, (1.0, 1.0, 0.0))
    np.testing.assert_allclose(found, (0.8, 1.0, 0.3), atol=0.02)


def test_orientations_that_are_left_out():
    """Of images narrower than 0.11 px² along an axis; that of two stars is kept as it is."""
    for shape, count, kept in (
        ((0.6, 0.105, 0.08), 9, False),
        ((0.6, 0.13, 0.08), 9, True),
        ((0.8, 1.0, 0.2), 2, True),
    ):
        image, xy, _ = field(shape, count)
        found, _ = fit_gaussian(pixels_of(image), starts_of(xy), np.arange(count), 4, (0.5, 0.5, 0.0))
        assert (found[2] != 0.0) is kept, shape


def test_stars_that_cannot_be_fitted():
    """Nothing but noise has no shape; stars beyond the image, or without a position, are left out."""
    empty = pixels_of(np.zeros((60, 60)))
    assert all(
        math.isnan(v) for v in fit_gaussian(empty, starts_of(np.full((3, 2), 30.0)), np.arange(3), 4, (1, 1, 0))[0]
    )
    image, xy, _ = field((0.8, 1.0, 0.3))
    wrong = np.concatenate([xy, [[np.nan, 20.0], [-30.0, 20.0], [119.6, 400.0]]])
    found, _ = fit_gaussian(pixels_of(image), starts_of(wrong), np.arange(12), 5, (1.0, 1.0, 0.0))
    np.testing.assert_allclose(found, (0.8, 1.0, 0.3), atol=2e-3)


def spots_at(xy, flux, saturated=()):
    x, y = np.rint(xy).astype(np.int64).T
    flags = np.isin(np.arange(len(xy)), saturated)
    return Spots(x.copy(), y.copy(), np.array(flux, float), np.full(len(x), 12), flags, np.zeros(len(x), bool))


def frame_of(image, noise=2.0, **settings):
    image = np.asarray(image, np.float32)
    flat = Background(np.zeros_like(image), np.full_like(image, noise))
    return prepare(image, flat, CentroidSettings(**settings), 1.0)


@pytest.mark.parametrize(("length", "angle", "is_line"), [(0.0, 0.0, False), (6.0, 0.5, True), (6.0, 2.0, True)])
def test_elongated_images_are_lines_where_these_fit_better(length, angle, is_line):
    """A round Gaussian of 0.8 px² that moved by 6 px, and one that did not: the variance along it grows by L²/12."""
    rng = np.random.default_rng(2)
    corner = np.stack(np.divmod(np.arange(9), 3), axis=1) * 36.0 + 20.0
    xy = corner + rng.uniform(-0.5, 0.5, (9, 2))
    y, x = np.mgrid[:120, :120]
    image = np.zeros((120, 120))
    for part in (np.arange(16) + 0.5) / 16 - 0.5:
        for at_x, at_y in xy:
            dx, dy = part * length * math.cos(angle), part * length * math.sin(angle)
            image += 1e5 / 16 * gaussian(x - at_x - dx, y - at_y - dy, (0.8, 0.8, 0.0))
    psf = frame_psf(frame_of(image), spots_at(xy, np.full(9, 1e5)), starts_of(xy), (1.0, 1.0), 6.0)
    xx, yy, tilt = psf.shape
    axis = np.array([math.cos(angle), math.sin(angle)])
    matrix = np.array([[xx, tilt], [tilt, yy]])
    assert axis @ matrix @ axis == pytest.approx(0.8 + length**2 / 12.0, rel=0.06)
    across = np.array([-axis[1], axis[0]])
    assert across @ matrix @ across == pytest.approx(0.8, rel=0.03)
    # a line has flat sides: in the middle it is flatter than the Gaussian of its variances
    ellipse = gaussian_psf(xx, yy, tilt, radius_px=psf.radius_px)
    middle = [model.shares(np.zeros(1), np.zeros(1)).item() for model in (psf, ellipse)]
    assert (middle[0] < 0.95 * middle[1]) is is_line


def test_widths_of_a_frame_without_stars_to_measure():
    """Those given, and no narrower than pixels show."""
    image, xy, light = field((0.8, 1.0, 0.0))
    for sigmas, expected in (((1.3, 0.9), (1.69, 0.81)), ((0.0, 2.0), (SMALLEST_SIGMA_PX**2, 4.0))):
        psf = frame_psf(frame_of(image), spots_at(xy, light, range(len(xy))), starts_of(xy), sigmas, 6.0)
        assert psf.shape == pytest.approx((*expected, 0.0))


# ---------------------------------------------------------------------- what a fit is worth
def fit_row(chi2=100.0, freedom=100.0, hot=1e9, variance=0.01):
    """x, y, flux, variances and covariance, χ², its freedom, and that of a hot pixel."""
    return [10.0, 20.0, 500.0, variance, 2.0 * variance, 0.5 * variance, chi2, freedom, hot]


ODDS = 2.0 * math.log(0.1)


@pytest.mark.parametrize(
    ("row", "blends", "outcome", "factor"),
    [
        (fit_row(), True, "fit", 1.0),
        (fit_row(156.0), True, "fit", 1.0),  # 1 + 4 √(2/100) = 1.566
        (fit_row(157.0), True, "fit", 1.57),
        (fit_row(157.0), False, "fit", 1.0),
        (fit_row(100.0, hot=100.0 + ODDS + 1e-6), True, "fit", 1.0),
        (fit_row(100.0, hot=100.0 + ODDS - 1e-6), True, "none", 1.0),
        (fit_row(100.0, hot=0.0), False, "fit", 1.0),
        (fit_row(variance=0.66), True, "fit", 1.0),  # 3 × 0.66 against 2
        (fit_row(variance=0.67), True, "none", 1.0),
        (fit_row(variance=0.67), False, "fit", 1.0),
        ([np.nan, *fit_row(hot=157.0)[1:]], True, "moment", 1.0),
        ([np.nan, *fit_row(hot=156.0)[1:]], True, "none", 1.0),
        ([np.nan, *fit_row(hot=0.0)[1:]], False, "moment", 1.0),
    ],
)
def test_fits_that_are_accepted(row, blends, outcome, factor):
    """A star image of 2 px² together, and a hot pixel a tenth as likely as a star."""
    moments, group = np.array([[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]] * 2), np.array([0, 0])
    fits = np.array([fit_row(), row])
    found = _accepted(fits, moments, group, blends, 2.0, ODDS)
    np.testing.assert_array_equal(found[0], fits[0, :6])
    if outcome == "none":
        assert math.isnan(found[1, 0])
    elif outcome == "moment":
        np.testing.assert_array_equal(found[1], moments[1])
    else:
        np.testing.assert_allclose(found[1], fits[1, :6] * [1, 1, 1, factor, factor, factor])
    assert group.tolist() == [0, 3 if outcome == "moment" else 0]


def test_where_fits_begin():
    """At the moment, unless it is none, or 1.5 px off the brightest pixel of a star that is not saturated; a flat top
    of 30 pixels has a radius of 3.1, and a ceiling of 0.9 of its height over the sky."""
    image = np.full((40, 50), 100.0)
    image[20, 30] = 1100.0
    x, y = np.array([30.0, 31.6, 30.0, np.nan, 33.0]), np.array([20.9, 20.0, 21.6, 20.0, 20.0])
    starts = Starts(x.copy(), y.copy(), np.zeros(5, np.int64), np.full(5, np.inf))
    saturated = np.array([False, False, False, False, True])
    peaks = Peaks(np.full(5, 30), np.full(5, 20), np.full(5, 30), saturated)
    _fill_starts(pixels_of(image, level=100.0), peaks, starts)
    assert starts.x.tolist() == [30.0, 30.0, 30.0, 30.0, 33.0]
    assert starts.y.tolist() == [20.9, 20.0, 20.0, 20.0, 20.0]
    assert starts.half.tolist() == [0, 0, 0, 0, 4]
    assert starts.ceiling.tolist() == [math.inf] * 4 + [pytest.approx(1000.0)]
    moments = np.column_stack([x, y, np.ones((5, 4))])
    again = _start_values(pixels_of(image, level=100.0), peaks, moments)
    np.testing.assert_array_equal(again.x, starts.x)
    assert math.isnan(moments[3, 0])  # the moments stay


@pytest.mark.parametrize(
    ("sigma2", "radius", "window", "half"), [(1.0, 9.0, 5, 3), (1.0, 9.0, 9, 4), (0.2, 9.0, 5, 2), (4.0, 4.9, 5, 4)]
)
def test_half_width_of_the_windows(sigma2, radius, window, half):
    """2½ widths, at least that of the settings, and no more than the image reaches: a pixel less than its radius."""
    psf = gaussian_psf(sigma2, sigma2, radius_px=radius)
    assert _half_of(frame_of(np.zeros((9, 9)), window_px=window), psf) == half
    assert _reach_of(psf) == min(8, math.floor(psf.radius_px - 1.0))


# ---------------------------------------------------------------------- what all centroiders share
def test_light_of_neighbours_in_the_covariance():
    """The share of a neighbour's light in the window, times half a window; not of one that was fitted together, and of
    none beyond four widths."""
    half, sigma = 3, (0.9, 1.2)
    table = np.array([[20.2, 30.0, 100.0, 0.01, 0.02, 0.003], [24.0, 29.0, 300.0, 0.01, 0.02, 0.0]])
    far = table.copy()
    far[1, 0] = 20.2 + 3 + 4.0 * 1.2
    shares = []
    for low, at, s in ((20.0, 24.0, 0.9), (30.0, 29.0, 1.2)):
        ends = np.array([low - 3.5 - at, low + 3.5 - at]) / s
        shares.append(ndtr(ends[1]) - ndtr(ends[0]))
    more = (half * shares[0] * shares[1] * 3.0) ** 2
    found = _covariances(table, sigma, half, np.array([0, 1]), 0.005)
    expected = [[0.01 + 2.5e-5 + more, 0.003], [0.003, 0.02 + 2.5e-5 + more]]
    np.testing.assert_allclose(found[0], expected, rtol=1e-5)
    assert more > 1e-4
    alone = [[0.01 + 2.5e-5, 0.003], [0.003, 0.02 + 2.5e-5]]
    np.testing.assert_allclose(_covariances(table, sigma, half, np.array([7, 7]), 0.005)[0], alone)
    np.testing.assert_allclose(_covariances(far, sigma, half, np.array([0, 1]), 0.005)[0], alone)


def test_centroids_of_a_table():
    """Brightest first; a row without a number is left out, and an error of more than half a window on both axes."""
    limit = 2.0 * 2.5**2 - 2.0 * SYSTEMATIC_PX**2
    rows = np.array(
        [
            [10.0, 10.0, 5.0, 0.01, 0.02, 0.0],
            [40.0, 10.0, 9.0, 0.01, 0.02, 0.005],
            [70.0, 10.0, 7.0, 0.01, np.nan, 0.0],
            [10.0, 50.0, 8.0, 0.5 * limit, 0.4999 * limit, 0.0],
            [40.0, 50.0, 6.0, 0.5 * limit, 0.5001 * limit, 0.0],
        ]
    )
    spots = spots_at(rows[:, :2], rows[:, 2], saturated=(1,))
    found = collect(rows, (1.0, 1.0), spots, 2)
    assert found.flux.tolist() == [9.0, 8.0, 5.0]
    assert found.saturated.tolist() == [True, False, False]
    np.testing.assert_array_equal(found.xy, rows[[1, 3, 0], :2])
    np.testing.assert_allclose(found.covariance[0], [[0.01 + 2.5e-5, 0.005], [0.005, 0.02 + 2.5e-5]])
    exact = collect(rows[:1], (1.0, 1.0), spots_at(rows[:1, :2], rows[:1, 2]), 2, systematic_px=0.0)
    assert exact.covariance[0, 0, 0] == 0.01


def test_a_gain_from_the_background():
    """As if its noise were photon noise: level over variance, and with a level below the noise one over it."""
    image = np.zeros((40, 40), np.float32)
    for level, noise, gain in ((100.0, 5.0, 4.0), (2.0, 5.0, 0.2)):
        flat = Background(np.full_like(image, level), np.full_like(image, noise))
        assert prepare(image, flat, None, None).pixels.inverse_gain == pytest.approx(1.0 / gain)
    assert prepare(image, flat, None, 2.5).pixels.inverse_gain == pytest.approx(0.4)
    for settings, gain, words in (
        ({"psf_sigma_px": 0.09}, 1.0, "psf_sigma_px is 0.09"),
        ({}, 0.0, "the gain is 0.0"),
        ({}, math.inf, "the gain is inf"),
    ):
        with pytest.raises(InputError, match=words):
            prepare(image, flat, CentroidSettings(**settings), gain)
    assert prepare(image, flat, CentroidSettings(window_px=3), 1.0).half == 1


# ---------------------------------------------------------------------- a star image from stars
def test_splines_of_an_image_integrated_over_pixels():
    """They sum to one inside the radius, to the covered part of the pixel at its end; each is its spline's integral."""
    basis = _Basis(3.2)
    assert basis.radius_px == 3.5
    inside = basis(np.linspace(-3.0, 3.0, 25))
    np.testing.assert_allclose(inside.sum(axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(basis(np.array([3.25, -3.75, 4.0])).sum(axis=1), [0.75, 0.25, 0.0], atol=1e-12)
    np.testing.assert_allclose(basis(np.array([0.3]))[0], basis(np.array([-0.3]))[0][::-1], atol=1e-12)
    fine = (np.arange(4000) + 0.5) / 4000 - 0.5
    tiny = basis(0.3 + fine) - 0.0  # means over pixels of means over pixels: the running mean of the first
    np.testing.assert_allclose(tiny.mean(axis=0), [basis(0.3 + fine)[:, k].mean() for k in range(basis.count)])
    # twice as many splines as pixels, besides three at the ends
    assert basis.count == 2 * 7 + 3


def test_a_table_is_normalised_to_its_light():
    table = np.random.default_rng(3).uniform(0.1, 1.0, (81, 81))
    model = _as_model(table, (1.0, 1.0, 0.0))
    assert model.table.sum() == pytest.approx(64.0)
    assert (model.oversampling, model.shape) == (8, (1.0, 1.0, 0.0))


def test_clean_stars_of_frames():
    """Alone within twice the radius, off the border, not saturated; brightest first, and of the best frame the
    Gaussian."""
    first, xy, light = field((0.8, 1.0, 0.0), noise=2.0)
    second, other, fainter = field((1.2, 0.7, 0.0), count=4, flux=3e4, seed=5, noise=2.0)
    frames = [frame_of(first), frame_of(second)]
    spots = [spots_at(xy, light, saturated=(2,)), spots_at(other, fainter)]
    stars, psf = _clean_stars(frames, spots, 5.0, 4, 400)
    assert len(stars) == 12
    assert (np.diff(stars[:, 0]) <= 0.0).all()
    assert stars[:, 1].tolist() == [0.0] * 8 + [1.0] * 4
    expected = np.concatenate([np.delete(xy, 2, axis=0), other])
    assert np.abs(stars[:, None, 2:] - expected).max(axis=2).min(axis=1).max() < 0.1
    assert psf.shape[0] < psf.shape[1]
    assert len(_clean_stars(frames, spots, 5.0, 4, 10)[0]) == 10
    beside = spots_at(np.concatenate([xy, xy[:1] + 9.0]), np.append(light, 1.0))
    assert len(_clean_stars(frames[:1], [beside], 5.0, 4, 400)[0]) == 8
    assert len(_clean_stars(frames[:1], [beside], 4.4, 3, 400)[0]) == 9
    with pytest.raises(InputError, match="7 stars stand alone"):
        _clean_stars(frames[:1], [spots_at(xy[:7], light[:7])], 5.0, 4, 400)


def test_clean_stars_keep_a_window_and_one_pixel_from_the_border(monkeypatch):
    monkeypatch.setattr(effective_psf, "_LEAST_STARS", 1)
    image, xy, light = field((0.8, 1.0, 0.0), noise=2.0)
    frame, spots, last = frame_of(image), spots_at(xy, light), np.array(image.shape[::-1]) - 1.0
    left = [np.sum((np.minimum(xy, last - xy) > half + 1.0).all(axis=1)) for half in range(4, 40)]
    assert len(set(left)) > 3
    for half, count in zip(range(4, 40), left, strict=True):
        if count:
            assert len(_clean_stars([frame], [spots], 5.0, half, 400)[0]) == count


# ---------------------------------------------------------------------- fits of stars
PSF = gaussian_psf(0.8, 1.1, 0.2, radius_px=9.0)


def scene(*stars, size=40, noise=5.0, seed=1):
    rng, (y, x) = np.random.default_rng(seed), np.mgrid[:size, :size]
    image = noise * rng.normal(size=(size, size))
    for at_x, at_y, flux in stars:
        image += flux * PSF.shares(x - at_x, y - at_y)
    return image


def starts_at(*stars, half=4, off=0.3, ceiling=np.inf):
    xy = np.array(stars)[:, :2]
    return Starts(xy[:, 0] + off, xy[:, 1] - off, np.full(len(xy), half), np.full(len(xy), ceiling))


@pytest.mark.parametrize("gain", [0.0, 0.5])
@pytest.mark.parametrize("stars", [1, 2])
def test_a_fit_is_the_least_squares_of_its_window(stars, gain):
    """Position, flux, their covariance, χ² and its freedom, of one star and of two 4 px apart; the variance of a pixel
    is that of the model where it follows it."""
    true = np.array([[20.2, 19.6, 2000.0], [23.9, 21.1, 1500.0]])[:stars]
    image = scene(*true)
    image[18, 22] = np.nan
    pixels = pixels_of(image, 5.0, inverse_gain=gain)
    found = fit_stars(pixels, PSF.samples, starts_at(*true), np.zeros(stars, np.int64), True)
    y, x = np.mgrid[:40, :40]
    inside = np.zeros((40, 40), bool)
    for at_x, at_y, _ in true:
        inside |= (np.abs(x - round(at_x + 0.3)) <= 4) & (np.abs(y - round(at_y - 0.3)) <= 4)
    inside &= np.isfinite(image)
    x, y, value = x[inside], y[inside], image[inside].astype(np.float32)

    def model(p):
        return sum(f * PSF.shares(x - a, y - b) for a, b, f in p.reshape(-1, 3))

    variance = 25.0 + gain * np.maximum(model(found[:, :3].ravel()), 0.0)
    best = least_squares(
        lambda p: (value - model(p)) / np.sqrt(variance), found[:, :3].ravel(), x_scale=np.tile([0.1, 0.1, 50.0], stars)
    )
    covariance = np.linalg.inv(best.jac.T @ best.jac)
    sigma = np.sqrt(np.diag(covariance))
    # a step of 0.02 standard errors ends it, and the table is interpolated to 1e-4 px
    assert (np.abs(found[:, :3].ravel() - best.x) < 0.03 * sigma + np.tile([2e-4, 2e-4, 1.0], stars)).all()
    for k in range(stars):
        block = covariance[3 * k : 3 * k + 2, 3 * k : 3 * k + 2]
        np.testing.assert_allclose(found[k, [3, 4, 5]], block[[0, 1, 0], [0, 1, 1]], rtol=0.02, atol=2e-6)
    np.testing.assert_allclose(found[:, 6], 2.0 * best.cost, rtol=2e-3)
    assert (found[:, 7] == inside.sum() - 3 * stars).all()
    if stars == 1:
        squares = value**2 / 25.0
        assert found[0, 8] == pytest.approx(squares.sum() - squares.max(), rel=1e-5)
    else:
        assert np.isnan(found[:, 8]).all()


def test_variances_that_stay():
    """Of the third step, and the flux of a star is then that of these weights: near the other one, and not the same."""
    pixels, start = pixels_of(scene((20.2, 19.6, 9000.0)), 5.0, inverse_gain=0.5), starts_at((20.2, 19.6, 9000.0))
    alone = np.zeros(1, np.int64)
    follow, stay = (fit_stars(pixels, PSF.samples, start, alone, reweigh)[0] for reweigh in (True, False))
    assert 0.0 < np.abs(follow[:2] - stay[:2]).max() < 5e-3
    np.testing.assert_allclose(follow[3:5], stay[3:5], rtol=0.05)


@pytest.mark.parametrize(
    ("stars", "changes", "fails"),
    [
        ([(20.2, 19.6, 2000.0)], {}, False),
        ([(20.2, 19.6, -2000.0)], {}, True),  # no light at all
        ([(26.0, 19.6, 9000.0)], {"at": (20.2, 19.6)}, True),  # it leaves its window
        ([(20.2, 19.6, 2000.0)], {"ceiling": -50.0}, True),  # nothing is left
        ([(0.2, 0.4, 2000.0)], {}, False),
        ([(-3.0, 20.0, 9e5)], {"at": (-3.0, 20.0), "half": 3}, True),  # a single column
    ],
)
def test_fits_that_fail(stars, changes, fails):
    at = changes.get("at", stars[0][:2])
    start = starts_at((*at, 1.0), **{name: value for name, value in changes.items() if name != "at"})
    found = fit_stars(pixels_of(scene(*stars), 5.0), PSF.samples, start, np.zeros(1, np.int64), True)[0]
    assert bool(np.isnan(found[0])) is fails


def test_pixels_at_the_ceiling_are_left_out():
    image = scene((20.2, 19.6, 5000.0))
    pixels = pixels_of(image)
    clipped = fit_stars(pixels, PSF.samples, starts_at((20.2, 19.6), ceiling=500.0), np.zeros(1, np.int64), True)[0]
    assert clipped[7] == 81 - 3 - np.count_nonzero(image[15:24, 16:25].astype(np.float32) >= 500.0)
    assert np.abs(clipped[:2] - [20.2, 19.6]).max() < 0.05
    pixels = pixels_of(scene((20.2, 19.6, 5000.0), (23.9, 21.1, 3000.0)))
    together = starts_at((20.2, 19.6), (23.9, 21.1))
    together.ceiling[1] = 500.0
    both = fit_stars(pixels, PSF.samples, together, np.zeros(2, np.int64), True)
    whole = fit_stars(pixels, PSF.samples, starts_at((20.2, 19.6), (23.9, 21.1)), np.zeros(2, np.int64), True)
    assert (both[:, 7] < whole[:, 7]).all()  # the lower ceiling is that of both


def test_groups_of_stars():
    """Within the larger reach on both axes, chained, eight at most."""
    x, y = np.array([0.0, 10.0, 10.0, 31.0]), np.array([0.0, 0.0, 10.01, 0.0])
    assert group_stars(x, y, np.array([10, 5, 10, 20])).tolist() == [0, 0, 2, 3]
    assert group_stars(x, y, np.array([10, 5, 11, 21])).tolist() == [0, 0, 0, 0]
    chain = group_stars(5.0 * np.arange(12), np.zeros(12), np.full(12, 5))
    assert np.bincount(chain).max() == 8
    assert len(set(chain.tolist())) == 2


@pytest.mark.parametrize("correct", [True, False])
def test_a_weighted_moment_and_its_error(correct):
    """The sum of weighted offsets of light, less that of the star image, is zero at the position; its error is that of
    the sum through the derivative."""
    image = scene((20.2, 19.6, 3000.0))
    image[18, 23] = np.nan
    pixels, start, shape = pixels_of(image, 5.0, inverse_gain=0.5), starts_at((20.2, 19.6)), (0.9, 1.0, 0.1)
    samples = PSF.samples._replace(table=PSF.table)
    x, y, flux, var_x, var_y, cov = weighted_moments(pixels, samples, start, shape, correct)[0]
    rows, columns = np.mgrid[15:24, 16:25]
    good = np.isfinite(image[15:24, 16:25])
    value = image[15:24, 16:25].astype(np.float32)[good].astype(float)
    inverse = np.linalg.inv([[0.9, 0.1], [0.1, 1.0]])

    def sums(at, light, image_at=None):
        """Weighted moments about a position, of a star image at its own if that is another."""
        away = np.stack([columns[good] - at[0], rows[good] - at[1]])
        w = np.exp(-0.5 * np.einsum("in,ij,jn->n", away, inverse, away))
        here = at if image_at is None else image_at
        share = PSF.shares(columns[good] - here[0], rows[good] - here[1])
        return w, w * away, share, (w @ light) / (w @ share)

    w, first, share, amount = sums((x, y), value)
    assert flux == pytest.approx(amount, rel=1e-3)
    rest = first @ value - (flux * first @ share if correct else 0.0)
    jacobian = []
    for axis in range(2):
        step = 1e-3 * np.eye(2)[axis]
        ends = [first @ PSF.shares(columns[good] - (x + s * step[0]), rows[good] - (y + s * step[1])) for s in (1, -1)]
        jacobian.append((ends[0] - ends[1]) / 2e-3)
    derivative = flux * np.transpose(jacobian)
    # the last step was below 2e-4 px
    assert np.abs(np.linalg.solve(derivative, rest)).max() < 2.5e-4
    noise = (first * (25.0 + 0.5 * np.maximum(value, 0.0))) @ first.T
    expected = np.linalg.inv(derivative) @ noise @ np.linalg.inv(derivative).T
    np.testing.assert_allclose([var_x, var_y, cov], expected[[0, 1, 0], [0, 1, 1]], rtol=0.01, atol=1e-6)
    assert (w > 0.0).all()


@pytest.mark.parametrize("distance", [-3.3, 0.0, 0.41, 2.999])
def test_weights_of_a_cubic_convolution(distance):
    """Keys' kernel of a = −½ at the four points about a place, and its derivative."""

    def keys(u):
        u = abs(u)
        return (1.5 * u - 2.5) * u * u + 1.0 if u <= 1.0 else ((-0.5 * u + 2.5) * u - 4.0) * u + 2.0 if u < 2.0 else 0.0

    weights = np.empty((2, 8))
    first = interpolate(81, 8, distance, weights, 1)
    place = distance * 8 + 40
    assert first == math.floor(place)
    points = first + np.arange(-1, 3)
    np.testing.assert_allclose(weights[1, :4], [keys(place - p) for p in points], atol=1e-12)
    slopes = [(keys(place + 1e-6 - p) - keys(place - 1e-6 - p)) / 2e-6 for p in points]
    np.testing.assert_allclose(weights[1, 4:], slopes, atol=1e-5)


# ---------------------------------------------------------------------- displacement by an asymmetric image
@pytest.mark.parametrize("mean", [(0.0, 0.0), (0.02, -0.01), (0.3, 0.2)])
def test_displacement_is_averaged_over_a_grid_of_its_scatter(mean):
    """Bayes' rule by densities of scipy; 0.25 is what the module states of star images, 1.1 ± 0.36 of aberrations."""
    mean, variance, width = np.array(mean), 4e-4, 0.8
    models = [(0.25, 0.0)] + [(0.1875, (share * width) ** 2) for share in (0.05, 0.1, 0.2, 0.4)]
    evidence = [prior * multivariate_normal.pdf(mean, cov=(variance + tau2) * np.eye(2)) for prior, tau2 in models]
    weight = np.array(evidence) / sum(evidence)
    kept = [tau2 / (tau2 + variance) for _, tau2 in models]
    expected = weight @ kept * mean
    second = sum(
        w * (k * variance * np.eye(2) + np.outer(k * mean, k * mean)) for w, k in zip(weight, kept, strict=True)
    )
    within = weight @ kept * variance * np.eye(2)
    covariance = second - np.outer(expected, expected) + 0.36**2 * np.outer(expected, expected) + 0.21 * within
    found = _averaged(mean, variance, width, 7.0)
    np.testing.assert_allclose(found[0], 1.1 * expected, rtol=1e-10)
    np.testing.assert_allclose(found[1], covariance, rtol=1e-9, atol=1e-18)
    assert found[2] == pytest.approx(1.0 - weight[0])
    assert found[3] == 7.0


def test_mean_displacement_of_stars_that_scatter():
    """DerSimonian & Laird's estimate of the scatter on two axes, and none for two stars or where noise explains it."""
    variance = np.array([0.01, 0.02, 0.04])
    calm = np.array([[0.1, 0.0], [0.12, 0.01], [0.08, -0.01]])
    mean, error = _pooled(calm, variance)
    np.testing.assert_allclose(mean, np.average(calm, axis=0, weights=1.0 / variance))
    assert error == pytest.approx(1.0 / 175.0)
    wild = np.array([[1.0, 0.0], [-1.0, 0.5], [0.0, -1.0]])
    centre = np.average(wild, axis=0, weights=1.0 / variance)
    q = sum(np.sum((wild[n] - centre) ** 2) / variance[n] for n in range(3))
    scatter = (q / 2.0 - 2.0) / (175.0 - (100.0**2 + 50.0**2 + 25.0**2) / 175.0)
    mean, error = _pooled(wild, variance)
    np.testing.assert_allclose(mean, np.average(wild, axis=0, weights=1.0 / (variance + scatter)))
    assert error == pytest.approx(1.0 / np.sum(1.0 / (variance + scatter)))
    assert _pooled(wild[:2], variance[:2])[1] == pytest.approx(1.0 / 150.0)


def test_a_star_far_from_the_median_is_not_single():
    """2·variance·6.9 is where the square of the distance ends, and a scatter of all stars widens it."""
    assert list(_are_single(np.array([[0.0, 0.0]] * 5 + [[0.37, 0.0], [0.0, 0.38]]), np.full(7, 0.01))) == [
        *[True] * 6,
        False,
    ]
    ring = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0], [3.0, 0.0]])
    assert list(_are_single(ring, np.full(5, 0.01))) == [True] * 5


@pytest.mark.parametrize(("rejected", "stars"), [({}, 4), ({"hot pixel": 3}, 4), ({"hot pixel": 1, "edge": 9}, 0)])
def test_odds_of_a_hot_pixel_are_those_of_the_frame(monkeypatch, rejected, stars):
    """Of detections: those that were rejected as hot against those that were not, one each more; ten times less, as
    those that are surely hot are rejected."""
    given = []
    nothing = np.zeros(stars, bool)
    kind = type("Spots", (SimpleNamespace,), {"__len__": lambda _: stars})
    spots = kind(rejected=rejected, saturated=nothing, edge=nothing)
    starts = SimpleNamespace(x=np.zeros(stars), y=np.zeros(stars), half=np.ones(stars, int))
    psf = SimpleNamespace(samples=None, shape=(0.7, 0.5, 0.1), sigma_px=0.8)
    monkeypatch.setattr(psf_fit, "group_stars", lambda x, y, reach: reach)
    monkeypatch.setattr(psf_fit, "fit_stars", lambda *_: np.full((stars, 8), 9.0))
    monkeypatch.setattr(psf_fit, "_accepted", lambda *a: given.extend(a[4:]))
    psf_fit._fit_image(SimpleNamespace(pixels=None), spots, np.zeros((stars, 6)), psf, starts, reweigh=True)
    odds = (1 + rejected.get("hot pixel", 0)) / (1 + stars) / 10.0
    assert given == pytest.approx([1.2, 2.0 * math.log(odds)])


def test_share_of_the_displacement_by_contrast():
    """The module's integrals in polar coordinates, where x² averages to r²/2 and x⁴ to 3 r⁴/8."""

    def displaced(contrast):
        def integral(power_2, power_4):
            def along_r(r):
                light = math.exp(-0.5 * r * r)
                return (power_2 * r**2 / 2.0 + power_4 * 3.0 * r**4 / 8.0) * light**2 / (1.0 + contrast * light) * r

            return quad(along_r, 0.0, 8.0, epsrel=1e-10)[0]

        return integral(-3.0, 1.0) / integral(1.0, 0.0)

    assert displaced(0.0) == pytest.approx(-1.5)
    at, share = _parts()
    reference = displaced(REFERENCE_CONTRAST)
    for k in (0, 1, 20, 40, 60, 80):
        expected = (displaced(math.expm1(at[k])) - reference) / (-1.5 - reference)
        assert share[k] == pytest.approx(expected, abs=1e-5)
    assert (at[0], share[0]) == (0.0, 1.0)
    assert np.interp(math.log1p(REFERENCE_CONTRAST), at, share) == pytest.approx(0.0, abs=1e-2)


SIDE = 13


def light_of(samples, x, y, flux=1.0):
    """Light (N,) of a star in a window that begins at pixel (0, 0)."""
    slopes, lines = np.empty((3, SIDE * SIDE)), np.empty((6, SIDE))
    fill_window(samples, -x, -y, SIDE, SIDE, slopes, lines)
    return flux * slopes[0]


def weighted_fit(signal, star, contrast):
    """Whether it succeeds, the position, and its derivatives by the pixels."""
    work, slopes, lines = np.empty((3, SIDE * SIDE)), np.empty((3, SIDE * SIDE)), np.empty((6, SIDE))
    work[0], work[1] = signal, 4.0
    gains, at = np.zeros((2, SIDE * SIDE)), np.zeros(2)
    samples = gaussian_psf(1.2, 0.9, 0.2, radius_px=9.0).samples
    return _fit_weighted(samples, star, (0, 0, SIDE), contrast, work, slopes, lines, gains, at), at, gains


@pytest.mark.parametrize("contrast", [0.0, 30.0])
def test_a_fit_with_the_weights_of_a_contrast(contrast):
    """Without noise it is where the star is, and one axis' position follows that of the star and not the other's."""
    samples = gaussian_psf(1.2, 0.9, 0.2, radius_px=9.0).samples
    done, at, gains = weighted_fit(light_of(samples, 6.2, 5.7, 1000.0), (6.15, 5.73, 990.0), contrast)
    assert done
    np.testing.assert_allclose(at, [6.2, 5.7], atol=2e-5)
    step = 1e-4
    for axis, (dx, dy) in enumerate([(step, 0.0), (0.0, step)]):
        moved = light_of(samples, 6.15 + dx, 5.73 + dy, 990.0) - light_of(samples, 6.15 - dx, 5.73 - dy, 990.0)
        np.testing.assert_allclose(gains @ moved / (2.0 * step), np.eye(2)[axis], atol=1e-5)
    np.testing.assert_allclose(gains @ light_of(samples, 6.15, 5.73), 0.0, atol=1e-12)


@pytest.mark.parametrize(("dx", "dy"), [(1.9, 0.0), (0.0, 1.9), (-1.9, 0.0), (0.0, -1.9)])
def test_steps_of_a_fit_with_weights_are_half_a_pixel(dx, dy):
    samples = gaussian_psf(1.2, 0.9, 0.2, radius_px=9.0).samples
    done, at, _ = weighted_fit(light_of(samples, 6.0 + dx, 6.0 + dy, 1000.0), (6.0, 6.0, 1000.0), 0.0)
    assert done
    assert np.abs(at - 6.0).max() <= 1.0 + 1e-12
    assert (at - 6.0) @ np.sign([dx, dy]) > 0.8


def test_a_fit_with_weights_of_pixels_that_are_no_numbers():
    samples = gaussian_psf(1.2, 0.9, 0.2, radius_px=9.0).samples
    signal = light_of(samples, 6.0, 6.0, 1000.0)
    signal[80] = np.nan
    assert not weighted_fit(signal, (6.0, 6.0, 1000.0), 0.0)[0]


@pytest.mark.parametrize("contrast", [0.0, 30.0])
@pytest.mark.parametrize("flux", [600.0, 1300.0])
def test_the_flux_of_a_fit_with_weights_follows(contrast, flux):
    """With the flux of the beginning or a wrong one the second step would be wrong by as much as the flux."""
    samples = gaussian_psf(1.2, 0.9, 0.2, radius_px=9.0).samples
    _, at, _ = weighted_fit(light_of(samples, 6.2, 5.7, 1000.0), (6.0, 5.9, flux), contrast)
    np.testing.assert_allclose(at, [6.2, 5.7], atol=2e-3)
