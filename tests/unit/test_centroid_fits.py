"""Fits and weighted moment: noise-free stars, borders, bad pixels, neighbours, saturation, smear, input."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import erf

from startracker.centroid import METHODS, maximum_likelihood
from startracker.centroid.frame import MODEL_STARS, brightest_alone
from startracker.centroid.psf_kernel import MOST_TOGETHER, group_stars
from startracker.centroid.psf_model import gaussian_psf
from startracker.centroid.psf_sums import fill_window, interpolate, interpolated, normal_equations, weigh_pixels
from startracker.detection import Background, Spots
from startracker.errors import InputError
from startracker.settings import CentroidSettings

SIGMA = 0.9
NEW = ["weighted_moment", "least_squares", "maximum_likelihood"]
FITS = NEW[1:]


def draw(shape, stars, sigma=SIGMA, path=(0.0, 0.0), samples=1):
    """Pixel-integrated round Gaussians (x, y, flux), moved along a path during the exposure."""
    image = np.zeros(shape)
    for t in (np.arange(samples) + 0.5) / samples - 0.5:
        for x, y, flux in stars:
            at = np.arange(max(shape) + 1) - 0.5
            along_x = 0.5 * np.diff(erf((at[: shape[1] + 1] - x - t * path[0]) / sigma / np.sqrt(2)))
            along_y = 0.5 * np.diff(erf((at[: shape[0] + 1] - y - t * path[1]) / sigma / np.sqrt(2)))
            image += flux / samples * along_y[:, None] * along_x
    return image.astype(np.float32)


def flat(image, noise=5.0):
    return Background(np.zeros_like(image), np.full_like(image, noise))


def spots_of(stars, saturated=(), pixels=12):
    x, y = (np.rint([s[k] for s in stars]).astype(np.int64) for k in (0, 1))
    flags = np.isin(np.arange(len(stars)), saturated)
    return Spots(x, y, np.array([s[2] for s in stars], float), np.full(len(x), pixels), flags, np.zeros(len(x), bool))


def lattice(flux=5e4, step=24, side=6):
    """36 stars at different phases, brightest first."""
    rng = np.random.default_rng(4)
    n = side * side
    corner = np.stack(np.divmod(np.arange(n), side), axis=1) * step + step // 2
    return [
        (x + p, y + q, flux * (1 - 0.001 * k))
        for k, ((x, y), (p, q)) in enumerate(zip(corner, rng.uniform(-0.5, 0.5, (n, 2)), strict=True))
    ]


def errors(found, stars):
    """Errors (N, 2) and flux ratios; every centroid must belong to another star."""
    truth = np.array(stars)
    star = np.abs(found.xy[:, None] - truth[:, :2]).max(axis=2).argmin(axis=1)
    assert len(np.unique(star)) == len(star)
    return found.xy - truth[star, :2], found.flux / truth[star, 2]


@pytest.mark.parametrize("method", NEW)
@pytest.mark.parametrize("sigma", [0.6, 0.9, 1.5])
def test_noise_free_stars_at_any_phase(method, sigma):
    stars = lattice()
    image = draw((144, 144), stars, sigma)
    found = METHODS[method](image, flat(image), spots_of(stars), CentroidSettings(), 1.0)
    error, ratio = errors(found, stars)
    assert len(found) == len(stars)
    assert np.abs(error).max() < 5e-4  # interpolation of the table
    assert ratio == pytest.approx(1, abs=5e-3)


@pytest.mark.parametrize("method", FITS)
def test_a_smeared_star_is_found_at_mid_exposure(method):
    for path in ((4.0, 0.0), (2.8, 2.8), (-1.5, 5.0)):
        stars = lattice()
        image = draw((144, 144), stars, path=path, samples=40)
        error, _ = errors(METHODS[method](image, flat(image), spots_of(stars), CentroidSettings(), 1.0), stars)
        assert np.abs(error).max() < 5e-3  # the systematic floor


@pytest.mark.parametrize("method", NEW)
def test_bad_pixels_are_left_out(method):
    stars = lattice()
    image = draw((144, 144), stars)
    whole = METHODS[method](image, flat(image), spots_of(stars), CentroidSettings(), 1.0)
    x, y = round(stars[0][0]), round(stars[0][1])
    image[y, [x - 1, x + 1]] = np.nan
    image[round(stars[1][1]) - 1, round(stars[1][0])] = np.inf
    found = METHODS[method](image, flat(image), spots_of(stars), CentroidSettings(), 1.0)
    assert len(found) == len(stars)
    error, _ = errors(found, stars)
    assert np.abs(error).max() < 1e-3
    # what is not seen makes the position worse, and the covariance says so
    trace = [c.covariance[np.hypot(*(c.xy - stars[0][:2]).T).argmin()].trace() for c in (whole, found)]
    assert trace[1] > 1.05 * trace[0]


def test_the_plain_moment_measures_a_star_with_a_bad_pixel_by_its_weighted_moment():
    stars = lattice()
    image = draw((144, 144), stars)
    image[round(stars[0][1]), round(stars[0][0]) + 1] = np.nan
    found = METHODS["moment"](image, flat(image), spots_of(stars), CentroidSettings(), 1.0)
    assert len(found) == len(stars)
    assert np.abs(errors(found, stars)[0]).max() < 2e-3


@pytest.mark.parametrize("method", FITS)
@pytest.mark.parametrize("sigma", [0.6, 0.9])
def test_single_pixels_are_no_stars(method, sigma):
    """Faint stars and single pixels in a frame with many hot pixels. For a signal-to-noise ratio r the two hypotheses
    differ by χ² = r² (1 − p²/Σ p²), p the greatest share of a pixel: by 33 ± 11 for σ = 0.6 px and r = 10, 65 ± 16 for
    r = 14."""
    rng, noise = np.random.default_rng(5), 2.0
    bright, faint = lattice()[:18], lattice()[18:]
    faint = [(x, y, 14.0 * noise * np.sqrt(4.0 * np.pi) * sigma) for x, y, _ in faint]  # Σ p² = 1 / (4 π σ²)
    hot = [(round(x) + 12, round(y), 0.0) for x, y, _ in faint[:-6]]
    image = draw((144, 144), [*bright, *faint], sigma)
    for x, y, _ in hot:
        image[y, x] += 14.0 * noise
    image += rng.normal(0.0, noise, image.shape).astype(np.float32)
    spots = replace(spots_of([*bright, *faint, *hot]), rejected={"hot pixel": 1000})
    found = METHODS[method](image, flat(image, noise), spots, CentroidSettings(psf_sigma_px=sigma), 1.0)
    seen = [np.hypot(*(found.xy - at[:2]).T).min() < 1.5 for at in (*bright, *faint, *hot)]
    assert seen == [True] * 36 + [False] * len(hot)


@pytest.mark.parametrize("method", NEW)
def test_border(method):
    stars = [*lattice(), (0.3, 60.2, 3e4), (143.4, 30.0, 2e4), (60.6, 0.1, 1e4)]
    image = draw((144, 144), stars)
    found = METHODS[method](image, flat(image), spots_of(stars), CentroidSettings(), 1.0)
    error, _ = errors(found, stars)
    assert len(found) == len(stars)
    assert np.abs(error).max() < 2e-3


@pytest.mark.parametrize("method", FITS)
@pytest.mark.parametrize("distance", [3.0, 4.0, 6.0])
def test_neighbours_are_fitted_together(method, distance):
    stars = lattice()
    stars += [(stars[k][0] + distance * np.cos(k), stars[k][1] + distance * np.sin(k), 2e4) for k in range(10)]
    image = draw((144, 144), stars)
    settings = CentroidSettings(psf_sigma_px=SIGMA)
    found = METHODS[method](image, flat(image), spots_of(stars), settings, 1.0)
    error, ratio = errors(found, stars)
    assert len(found) == len(stars)
    assert np.abs(error).max() < 2e-3
    assert ratio == pytest.approx(1, abs=0.01)
    if distance < 5:  # what fitting together is for
        moment = METHODS["moment"](image, flat(image), spots_of(stars), settings, 1.0)
        nearest = np.abs(np.array(stars)[:, None, :2] - moment.xy).max(axis=2).min(axis=1)
        assert nearest.max() > 0.05


def test_a_close_neighbour_makes_the_position_less_certain():
    alone = [(40.2, 40.4, 5e3)]
    pair = [*alone, (42.4, 40.4, 5e3)]
    trace = []
    for stars in (alone, pair):
        image = draw((80, 80), stars)
        found = maximum_likelihood(image, flat(image), spots_of(stars), CentroidSettings(psf_sigma_px=SIGMA), 1.0)
        trace.append(found.covariance[np.hypot(*(found.xy - alone[0][:2]).T).argmin()].trace())
    assert trace[1] > 1.2 * trace[0]


def test_long_chains_are_cut():
    x = np.arange(20.0) * 4
    group = group_stars(x, np.zeros(20), np.full(20, 5.0))
    assert np.bincount(group).max() == MOST_TOGETHER
    assert len(set(group_stars(x, np.zeros(20), np.full(20, 3.0)))) == 20


@pytest.mark.parametrize("method", FITS)
@pytest.mark.parametrize("over", [1.5, 10.0, 100.0])
def test_saturated_pixels_are_left_out(method, over):
    stars = lattice()
    peak = 2e4 / (2 * np.pi * SIGMA**2)
    bright = [(x, y, over * 2e4 if k < 6 else 1e4) for k, (x, y, _) in enumerate(stars)]
    drawn = draw((144, 144), bright)
    image = np.minimum(drawn, np.float32(peak))
    full = [k for k in range(6) if (drawn == image)[round(bright[k][1]), round(bright[k][0])] == False]  # noqa: E712
    spots = spots_of(bright, full, 20)
    found = METHODS[method](image, flat(image), spots, CentroidSettings(), 1.0)
    error, ratio = errors(found, bright)
    assert len(full) >= 4
    assert found.saturated.sum() == len(full)
    assert np.abs(error).max() < 0.01
    assert ratio[found.saturated] == pytest.approx(1, abs=0.05)
    # no noise was drawn: what is left is the width taken from the frame, less than the noise would be
    sigma = np.sqrt(np.stack([found.covariance[:, 0, 0], found.covariance[:, 1, 1]], axis=1))
    assert (np.abs(error) < sigma)[found.saturated].all()


def test_what_does_not_look_like_a_star_is_less_certain():
    stars = lattice()
    image = draw((144, 144), stars)
    good = maximum_likelihood(image, flat(image), spots_of(stars), CentroidSettings(), 1.0)
    image[round(stars[0][1]) + 2, round(stars[0][0]) + 1] += 4000  # a cosmic ray
    hit = maximum_likelihood(image, flat(image), spots_of(stars), CentroidSettings(), 1.0)
    star = [np.hypot(*(c.xy - stars[0][:2]).T).argmin() for c in (good, hit)]
    error = hit.xy[star[1]] - stars[0][:2]
    assert hit.covariance[star[1]].trace() > 5 * good.covariance[star[0]].trace()
    assert (error**2).sum() < 9 * hit.covariance[star[1]].trace()


def test_a_star_image_from_a_file(tmp_path):
    path = tmp_path / "psf.npz"
    gaussian_psf(SIGMA**2, SIGMA**2, radius_px=6.0).save(path)
    stars = [(40.3, 40.1, 2e4)]
    image = draw((80, 80), stars)
    found = maximum_likelihood(image, flat(image), spots_of(stars), CentroidSettings(psf=str(path)), 1.0)
    assert np.abs(errors(found, stars)[0]).max() < 5e-4


@pytest.mark.parametrize("method", NEW)
def test_nothing_to_measure(method):
    image = np.zeros((40, 40), np.float32)
    assert len(METHODS[method](image, flat(image), Spots.none(), CentroidSettings(), 1.0)) == 0
    # no light at the place
    assert len(METHODS[method](image, flat(image), spots_of([(20, 20, 1.0)]), CentroidSettings(), 1.0)) == 0
    image[:] = np.nan
    assert len(METHODS[method](image, flat(image), spots_of([(20, 20, 1.0)]), CentroidSettings(), 1.0)) == 0


@pytest.mark.parametrize("method", NEW)
def test_bad_input(method):
    image = np.zeros((40, 40), np.float32)
    spots = spots_of([(20, 20, 1.0)])
    with pytest.raises(InputError, match="window_px"):
        METHODS[method](image, flat(image), spots, CentroidSettings(window_px=4), 1.0)
    with pytest.raises(InputError, match="flat_field_error"):
        METHODS[method](image, flat(image), spots, CentroidSettings(flat_field_error=-0.1), 1.0)
    with pytest.raises(InputError, match="cannot be read"):
        METHODS[method](image, flat(image), spots, CentroidSettings(psf="no such file"), 1.0)


@pytest.mark.parametrize(("tilt", "axes"), [(0.0, 2), (-0.05, 8), (0.2, 0)])
def test_light_in_pixels_is_the_interpolated_table(tilt, axes):
    psf = gaussian_psf(0.8, 1.1, tilt, radius_px=5.0)
    assert len(psf.axes) == axes
    x, y, weights = 40.3, 17.6, np.empty((2, 8))
    j, i = (axis.ravel() for axis in np.mgrid[10:26, 32:51])  # beyond the table on every side
    first = [interpolate(len(psf.table), psf.oversampling, -place, weights, n) for n, place in enumerate((x, y))]
    places = zip(first[0] + i * psf.oversampling, first[1] + j * psf.oversampling, strict=True)
    expected = np.array([interpolated(psf.table, psf.oversampling, *at, weights, 0) for at in places]).T
    out = np.empty((3, len(i)))
    fill_window(psf.samples, 32 - x, 10 - y, 19, 16, out, np.empty((6, 19)))
    np.testing.assert_allclose(out, expected, rtol=1e-11, atol=1e-18)
    assert (expected[0] > 0).sum() in range(50, 130)
    assert (expected == 0.0).all(axis=0).any()


@pytest.mark.parametrize("weigh", [True, False])
@pytest.mark.parametrize("stars", [1, 2])
def test_model_of_stars_in_pixels(weigh, stars):
    random = np.random.default_rng(5)
    shares, flux = random.uniform(-0.1, 0.4, (3 * stars, 56)), np.array([900.0, 500.0])[:stars]
    signal, dark, rows = random.normal(20, 5, 56), random.uniform(4, 9, 56), random.uniform(5, 50, (3, 56))
    kept, expected = rows[2].copy(), shares * np.repeat(flux, 3)[:, None] * np.tile([1, -1, -1], stars)[:, None]
    total = expected[::3].sum(axis=0)
    light = np.maximum(total, 0.0)
    variance = dark + 0.5 * light + (0.01 * light) ** 2 if weigh else kept
    chi2 = weigh_pixels(shares, flux, signal, dark, (0.5, 0.01), weigh, rows)
    np.testing.assert_allclose(shares, expected, rtol=1e-12)
    np.testing.assert_allclose(rows, [1.0 / variance, signal - total, variance], rtol=1e-12, atol=1e-12)
    assert chi2 == pytest.approx(((signal - total) ** 2 / variance).sum(), rel=1e-12)


def test_normal_equations_against_matrix_products():
    random = np.random.default_rng(8)
    slopes, weights, residuals = random.normal(size=(6, 49)), random.uniform(0.1, 2, 49), random.normal(size=49)
    normal, right, eps = np.zeros((6, 6)), np.empty(6), 49 * np.finfo(float).eps
    weights, residuals = weights[:42], residuals[:42]
    normal_equations(slopes, weights, residuals, normal, right)
    rows = slopes[:, :42]
    weighted = rows * weights
    # sums of n terms in any two orders are within n roundings of the sum of the terms' sizes
    assert (np.abs(right - weighted @ residuals) <= eps * (np.abs(weighted) @ np.abs(residuals))).all()
    assert (np.abs(np.tril(normal - weighted @ rows.T)) <= eps * (np.abs(weighted) @ np.abs(rows).T)).all()


def test_stars_alone():
    random = np.random.default_rng(6)
    (x, y), flux, unfit = random.uniform(0, 300, (2, 60)), random.uniform(1, 9, 60), random.random(60) < 0.2
    x[[7, 21]] = np.nan
    near = np.maximum(np.abs(x[:, None] - x), np.abs(y[:, None] - y)) < 16.0
    bright = [n for n in np.argsort(-flux) if not unfit[n] and np.isfinite(x[n])][:18]
    expected = [n for n in bright if near[n].sum() == 1]
    assert brightest_alone(x, y, flux, unfit, 18, MODEL_STARS).tolist() == expected[:MODEL_STARS]
    assert 2 < len(expected) < len(bright)


@pytest.mark.parametrize("method", FITS)
def test_a_blend_is_recognised_among_well_modelled_stars(method):
    """`Centroids.misfit` is the median excess of χ² in its standard errors: a standard normal number where the image is
    right (here below 3.5 by fixed seeds), as the star image is given. One of 36 stars is a pair 1.6 px apart, which its
    window's χ² cannot explain: its covariance is at least three times that of stars as bright."""
    rng = np.random.default_rng(8)
    stars = lattice(flux=2e4)
    x, y, flux = stars[20]
    pair = [(x - 0.8, y, 0.5 * flux), (x + 0.8, y, 0.5 * flux)]
    ideal = draw((144, 144), [*stars[:20], *stars[21:], *pair], SIGMA)
    image = (rng.poisson(ideal) + rng.normal(0.0, 5.0, ideal.shape)).astype(np.float32)
    settings = CentroidSettings(psf_sigma_px=SIGMA)
    found = METHODS[method](image, flat(image, 5.0), spots_of(stars), settings, 1.0)
    assert abs(found.misfit) < 3.5
    away = np.hypot(*(found.xy - (x, y)).T)
    blend, others = away.argmin(), away > 10.0
    trace = np.trace(found.covariance, axis1=1, axis2=2)
    assert trace[blend] > 3.0 * np.median(trace[others])
