"""Displacement of stars of different brightness by an asymmetric star image, measured in the frame itself.

If a symmetric model is fitted to an asymmetric image (coma, jitter within an exposure), the position depends on the
weights of the pixels. The weights are equal for a faint star, whose noise is that of the background, and decrease
towards the middle for a bright star, whose noise is its own photon noise. So faint stars are displaced relative to the
stars that define positions (`startracker.centroid.skewness.REFERENCE_CONTRAST`), all in the same direction, and the
residuals of the positions do not show it: a coma of 0.1 waves at f/4 moves faint stars by 0.15 px.

Every bright star shows the size of the effect, because its pixels can be fitted with either weights. Let u_n be the
position of star n with equal weights minus that with the weights of the reference, and v_n the variance of this
difference due to noise. The common difference is the weighted mean of the u_n; their scatter beyond v_n, from the
stars' sub-pixel positions, is estimated as in DerSimonian & Laird (1986, *Controlled Clinical Trials* 7, 177). The mean
is averaged over two models (Hoeting et al. 1999, *Statistical Science* 14, 382): the image is symmetric, or the
difference is Gaussian with a standard deviation τ on a grid. A star of another contrast c, the ratio of photon to
background noise (variances) in its brightest pixel, is displaced by g(c) times the difference, with g = 1 for faint
stars and 0 at the reference.

If an asymmetric image is not improbable, all stars are fitted again with the ellipse that the weights of the reference
give, which is the one of calibrations, and the difference is measured with that ellipse in all bright stars: in images
of half a pixel it depends on the position within the pixel, by as much as itself.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np

from startracker._compiled import kernel
from startracker.centroid.frame import MODEL_STARS, brightest_alone
from startracker.centroid.psf_kernel import Starts
from startracker.centroid.psf_model import PsfModel, Samples, gaussian_psf
from startracker.centroid.psf_shape import LARGEST_HALF_PX, fit_gaussian
from startracker.centroid.psf_sums import fill_window
from startracker.centroid.skewness import REFERENCE_CONTRAST, Shape
from startracker.centroid.window import Pixels, read_pixels
from startracker.core import BoolArray, FloatArray, IntArray
from startracker.geometry.linalg import factorise, substitute

_Star: TypeAlias = tuple[float, float, float]
"""Position x, y, px, and flux, DN, of a star."""

EXAMINED = 27
"""Number of the brightest stars that are examined; of these the isolated ones are used."""
_SYMMETRIC = 0.25
"""Prior probability that star images are symmetric."""
EXAMINED_ASYMMETRIC = 0.25
"""Probability of an asymmetric image above which all stars are fitted with the ellipse of the reference's weights, and
positions are corrected."""
_DIFFERENCES = (0.05, 0.1, 0.2, 0.4)
"""Grid of τ in widths of the star image, including the pixel: 0.05 to 0.2 waves of coma cause 0.08 to 0.4 widths."""
_ACTUAL, _MODEL_ERROR = 1.1, 0.36
"""Mean and standard deviation of the ratio of the actual displacement of faint stars to the measured one. For 24 random
lenses (coma of 0.05 to 0.3 waves, half of them with astigmatism, trefoil or up to 60 µm of defocus, f/1.4 to f/4) the
ratio is 0.7 to 1.25; coma of 0.2 waves at f/2 and of 0.3 at f/4 has 1.3 to 1.5. The deviation covers both."""
_UNKNOWN_REFERENCE = 0.6
"""Displacement of the stars, in widths of the fitted image, if the ellipse of the reference cannot be fitted: 0.5 to
1.4 for coma of 0.2 and 0.3 waves at f/4, where faint stars only show the core of their image."""
_LARGEST_AWAY = 6.9
"""ln 1000: exceeded by one star in a thousand."""
_STEPS = 2
_LONGEST_STEP_PX, _FARTHEST_PX = 0.5, 2.0
_MOST_WINDOWS = 6
_WIDE = 4.0
"""Ratio of the variances with which the fit of the reference's ellipse starts to those of the frame's ellipse."""
_LEAST_SIGMA_PX = 0.01
"""Standard error below which a brighter star gets no larger weight in the mean displacement, as in the attitude."""
_PIXEL = 1.0 / 12.0
_FAINT, _BRIGHT, _CONTRASTS = 0.03, 1e5, 80


class Difference(NamedTuple):
    """Position of faint stars minus that of stars of the reference contrast.

    Parameters
    ----------
    mean : (2,)
        Pixels; zero if the image is symmetric.
    covariance : (2, 2)
        Covariance of the mean, px².
    asymmetric : float
        Probability that the star image is asymmetric.
    dark : float
        Variance of a background pixel, DN².
    """

    mean: FloatArray
    covariance: FloatArray
    asymmetric: float
    dark: float


def measure_difference(
    pixels: Pixels, psf: PsfModel, table: FloatArray, unfit: BoolArray, half: int, most: int = MODEL_STARS
) -> Difference:
    """Difference in position between faint stars and those of the reference, from the brightest stars of a frame.

    Parameters
    ----------
    psf : PsfModel
        The fitted star image.
    table : (N, 6)
        Fits, see `startracker.centroid.psf_kernel.FITTED`.
    unfit : bool (N,)
        Stars that are saturated or at the border.
    half : int
        Half width of the fits' windows.
    most : int
        Largest number of stars; nine to recognise an asymmetric image, all that are examined to measure it.
    """
    stars = _examined(table, unfit, most)
    found = np.full((len(stars), 4), np.nan)
    _measure(pixels, psf.samples, table, stars, half, found)
    found = found[np.isfinite(found).all(axis=1) & (np.abs(found[:, :2]).max(axis=1, initial=0.0) < _FARTHEST_PX)]
    if not len(found):
        return Difference(np.zeros(2), np.zeros((2, 2)), 0.0, 1.0)
    found = found[_are_single(found[:, :2], found[:, 2])]
    xx, yy, _ = psf.shape
    mean, variance = _pooled(found[:, :2], found[:, 2])
    return _averaged(mean, variance, math.sqrt(0.5 * (xx + yy) + _PIXEL), float(found[:, 3].mean()))


def _examined(table: FloatArray, unfit: BoolArray, most: int) -> IntArray:
    x, y, flux = np.ascontiguousarray(table[:, :3].T)
    stars: IntArray = brightest_alone(x, y, flux, unfit, EXAMINED, most)
    # Two windows of a tracked frame may contain the same star.
    apart = np.abs(table[stars, None, :2] - table[None, stars, :2]).max(axis=2)
    repeated: BoolArray = np.triu(apart < 1.0, 1).any(axis=0)
    return stars[~repeated]


def _are_single(differences: FloatArray, variance: FloatArray) -> BoolArray:
    """Mask (N,) of stars whose difference (N, 2) is near the median of all; that of an unresolved pair is not.

    The squared distance over twice the variance is distributed exponentially, with a median of ln 2; a larger median
    shows scatter in addition to the noise.
    """
    away = np.square(differences - np.median(differences, axis=0)).sum(axis=1) / (2.0 * variance)
    scatter = max(float(np.median(away)) / math.log(2.0), 1.0)
    near: BoolArray = away <= _LARGEST_AWAY * scatter
    return near


def _pooled(differences: FloatArray, variance: FloatArray) -> tuple[FloatArray, float]:
    """Weighted mean (2,) of differences (N, 2), and its variance on one axis.

    The differences have known variances (N,) on one axis and an additional scatter, which is estimated from their χ².
    """
    weight = 1.0 / variance
    total = float(weight.sum())
    mean = weight @ differences / total
    # DerSimonian & Laird's Q minus its expectation, with 2 (N − 1) degrees of freedom for two axes; `information` is
    # the factor by which the variance of the scatter raises it.
    excess = float(weight @ np.square(differences - mean).sum(axis=1)) - 2.0 * (len(variance) - 1)
    information = 2.0 * (total - float(weight @ weight) / total)
    if excess > 0.0 and len(variance) > 2:
        weight = 1.0 / (variance + excess / information)
        total = float(weight.sum())
        mean = weight @ differences / total
    return mean, 1.0 / total


def _averaged(mean: FloatArray, variance: float, width: float, dark: float) -> Difference:
    """Average over the models of the module's docstring for a mean (2,) whose variance on one axis is given."""
    square = float(mean @ mean)
    # The symmetric model is the first of the grid, τ = 0.
    tau2 = np.array([0.0, *((share * width) ** 2 for share in _DIFFERENCES)])
    prior = np.array([_SYMMETRIC, *[(1.0 - _SYMMETRIC) / len(_DIFFERENCES)] * len(_DIFFERENCES)])
    # Likelihood of the mean under each model, a two-dimensional Gaussian of variance v + τ² on either axis.
    log_weight = np.log(prior) - np.log(variance + tau2) - 0.5 * square / (variance + tau2)
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    # A model with τ shrinks the mean by τ² / (v + τ²), the posterior mean for a Gaussian prior.
    kept = tau2 / (variance + tau2)
    average = float(weight @ kept)
    within = float(weight @ kept) * variance
    between = float(weight @ (kept - average) ** 2) + (_MODEL_ERROR * average) ** 2
    covariance = _ACTUAL**2 * within * np.eye(2) + between * np.outer(mean, mean)
    return Difference(_ACTUAL * average * mean, covariance, float(1.0 - weight[0]), dark)


def correct_asymmetry(
    found: Difference, pixels: Pixels, psf: PsfModel, table: FloatArray, unfit: BoolArray
) -> FloatArray:
    """Subtract the displacement relative to reference stars from the positions of fits (N, 6), in place.

    The part of its error that differs between stars is added to their covariances. Stars in `unfit` are saturated or at
    the border: the pixels that are left of their images displace them by an unknown amount. They keep their positions,
    and the whole displacement of faint stars is added to their covariances.

    Returns
    -------
    (2, 2) array
        Covariance of the error that all positions then share, px².
    """
    xx, yy, xy = psf.shape
    fitted = np.isfinite(table[:, :6]).all(axis=1) & (table[:, 2] > 0.0)
    square = found.covariance
    whole = square + np.outer(found.mean, found.mean)
    table[fitted & unfit, 3:6] += whole[[0, 1, 0], [0, 1, 1]]
    stars = np.flatnonzero(fitted & ~unfit)
    if not len(stars):
        return np.zeros((2, 2))
    # Peak signal of a Gaussian star, DN, whose variances include that of the pixel.
    light = table[stars, 2] / (2.0 * math.pi * math.sqrt((xx + _PIXEL) * (yy + _PIXEL) - xy * xy))
    contrast = (light * pixels.inverse_gain + (pixels.flat_error * light) ** 2) / found.dark
    part = displaced_part(contrast)
    weight = 1.0 / np.maximum(table[stars, 3] + table[stars, 4], 2.0 * _LEAST_SIGMA_PX**2)
    # Stars are weighted as in the attitude: what they share on average is the common error, the rest is their own.
    middle = float(weight @ part / weight.sum())
    table[stars, :2] -= part[:, None] * found.mean
    apart = np.square(part - middle)
    for column, (i, j) in enumerate(((0, 0), (1, 1), (0, 1)), start=3):
        table[stars, column] += apart * square[i, j]
    return middle**2 * square


def displaced_part(contrast: FloatArray) -> FloatArray:
    """Function g: displacement of stars of a contrast, relative to the reference, as a fraction of that of faint
    stars."""
    at, part = _parts()
    return np.interp(np.log1p(contrast), at, part)


@lru_cache(maxsize=1)
def _parts() -> tuple[FloatArray, FloatArray]:
    """Nodes ln(1 + c) and g(c), for a round Gaussian G with a third cumulant along x, to first order.

    A fit with weights 1/(1 + c G) is displaced in proportion to Σ w ∂G ∂³G / Σ w (∂G)². For images computed with coma
    of 0.05 to 0.3 waves at f/1.4 to f/4, g differs from this by at most 0.1 up to the reference.
    """
    u = np.linspace(-6.0, 6.0, 121)
    x, y = np.meshgrid(u, u)
    gaussian = np.exp(-0.5 * (x * x + y * y))
    slope, third = x * gaussian, (x**3 - 3.0 * x) * gaussian

    def displacement(contrast: float) -> float:
        weighted = slope / (1.0 + contrast * gaussian)
        return float((weighted * third).sum() / (weighted * slope).sum())

    contrasts = np.concatenate([[0.0], np.geomspace(_FAINT, _BRIGHT, _CONTRASTS)])
    values, reference = np.array([displacement(c) for c in contrasts]), displacement(REFERENCE_CONTRAST)
    return np.log1p(contrasts), (values - reference) / (values[0] - reference)


def reference_psf(pixels: Pixels, psf: PsfModel, table: FloatArray, unfit: BoolArray, half: int) -> PsfModel | None:
    """The Gaussian fitted to the brightest stars with the weights of the reference; None if the fit fails.

    The ellipse of an asymmetric image depends on the weights as well: positions from the ellipse of other weights have
    another zero point.
    """
    stars = _examined(table, unfit, EXAMINED)
    x, y = np.ascontiguousarray(table[:, :2].T)
    starts = Starts(x, y, np.full(len(table), half), np.full(len(table), np.inf))
    (xx, yy, xy), fitted = psf.shape, None
    # A narrow start would end at the core of an image with a wide tail, where faint stars have most of their signal.
    for times in (_WIDE, 1.0):
        if fitted is None:
            fitted = _reference_ellipse(pixels, starts, stars, half, (times * xx, times * yy, times * xy))
    if fitted is None:
        return None
    (xx, yy, xy), errors = fitted
    major = 0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy)
    radius = max(psf.radius_px, 2.5 * math.sqrt(major) + 2.0)
    return gaussian_psf(xx, yy, xy, radius_px=radius, width_error=errors)


def unknown_reference(psf: PsfModel, found: Difference) -> FloatArray:
    """Covariance (2, 2), px², of the displacement of all stars if `reference_psf` fails."""
    xx, yy, _ = psf.shape
    return found.asymmetric * _UNKNOWN_REFERENCE**2 * 0.5 * (xx + yy) * np.eye(2)


def _reference_ellipse(
    pixels: Pixels, starts: Starts, stars: IntArray, least: int, shape: Shape
) -> tuple[Shape, tuple[float, float]] | None:
    """Ellipse fitted with the weights of the reference, and the standard errors of its variances; None if the fit
    fails. `least` is the smallest half width of the window, and `shape` that with which the fit starts."""
    found: tuple[Shape, tuple[float, float]] | None = None
    half = min(2 * least, LARGEST_HALF_PX)
    # The window depends on the width that is fitted in it, so both are iterated.
    for _ in range(_MOST_WINDOWS):
        (xx, yy, xy), errors = fit_gaussian(pixels, starts, stars, half, shape, REFERENCE_CONTRAST)
        if not (xx > 0.0 and xx * yy - xy * xy > 0.0):
            break
        shape, found = (xx, yy, xy), ((xx, yy, xy), errors)
        major = 0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy)
        before, half = half, min(max(least, math.ceil(2.5 * math.sqrt(major))), LARGEST_HALF_PX)
        if half == before:
            break
    return found


@kernel
def _measure(pixels: Pixels, psf: Samples, table: FloatArray, stars: IntArray, half: int, found: FloatArray) -> None:
    """Fill the differences (N, 4) of stars: x, y, px; variance on one axis, px²; variance of a dark pixel, DN²."""
    side = 2 * half + 1
    count = side * side
    slopes, lines, work = np.empty((3, count)), np.empty((6, max(side, 8))), np.empty((3, count))
    gains, at = np.empty((2, 2, count)), np.empty((2, 2))
    height, width = pixels.image.shape
    for k in range(len(stars)):
        star = table[stars[k], 0], table[stars[k], 1], table[stars[k], 2]
        left, top = round(star[0]) - half, round(star[1]) - half
        if left < 0 or top < 0 or left + side > width or top + side > height:
            continue
        if read_pixels(pixels, left, top, side, side, np.inf, work[0], work[1]) < count:
            continue
        whole = True
        for reference in range(2):
            contrast = REFERENCE_CONTRAST if reference else 0.0
            whole = whole and _fit_weighted(
                psf, star, (left, top, side), contrast, work, slopes, lines, gains[reference], at[reference]
            )
        if not whole:
            continue
        found[k, 0], found[k, 1] = at[0, 0] - at[1, 0], at[0, 1] - at[1, 1]
        fill_window(psf, left - star[0], top - star[1], side, side, slopes, lines)
        # Both positions come from the same pixels, so the noise of their difference is that of the difference of the
        # gains.
        total, dark = 0.0, 0.0
        for n in range(count):
            light = max(star[2] * slopes[0, n], 0.0)
            variance = work[1, n] + light * pixels.inverse_gain + (pixels.flat_error * light) ** 2
            for axis in range(2):
                total += 0.5 * (gains[0, axis, n] - gains[1, axis, n]) ** 2 * variance
            dark += work[1, n] / count
        found[k, 2], found[k, 3] = total, dark


@kernel
def _fit_weighted(
    psf: Samples, star: _Star, window: tuple[int, int, int], contrast: float, work: FloatArray, slopes: FloatArray,
    lines: FloatArray, gains: FloatArray, at: FloatArray,
) -> bool:  # fmt: skip
    """Fit the position of a star with the weights of a contrast.

    `at` (2,) receives the position, px, and `gains` (2, N) its derivatives with respect to the pixels, px/DN. `work`
    (3, N) holds the signal, DN, and the variance in the dark, DN². Returns whether the fit succeeded.
    """
    (x, y, flux), (left, top, side) = star, window
    count, normal, right = side * side, np.empty((3, 3)), np.empty(3)
    for step in range(_STEPS):
        fill_window(psf, left - x, top - y, side, side, slopes, lines)
        peak = 0.0
        for n in range(count):
            peak = max(peak, slopes[0, n])
        normal[:], right[:] = 0.0, 0.0
        for n in range(count):
            slopes[1, n], slopes[2, n] = -flux * slopes[1, n], -flux * slopes[2, n]
            rest = work[0, n] - flux * slopes[0, n]
            work[2, n] = 1.0 / (work[1, n] * (1.0 + contrast * max(slopes[0, n], 0.0) / peak))
            slopes[0, n] *= flux
            for p in range(3):
                scaled = work[2, n] * slopes[p, n]
                right[p] += scaled * rest
                for q in range(p + 1):
                    normal[p, q] += scaled * slopes[q, n]
        if not factorise(normal, len(normal)):
            return False
        # The first step linearises at the position that both weights share, so that the two gains are comparable.
        if step == 0:
            for axis in range(2):
                column = np.zeros(3)
                column[1 + axis] = 1.0
                substitute(normal, len(normal), column)
                for n in range(count):
                    gains[axis, n] = work[2, n] * (
                        column[0] * slopes[0, n] + column[1] * slopes[1, n] + column[2] * slopes[2, n]
                    )
        substitute(normal, len(normal), right)
        longest = max(abs(right[1]), abs(right[2]))
        if not math.isfinite(longest + right[0]):
            return False
        short = min(1.0, _LONGEST_STEP_PX / longest) if longest > 0.0 else 1.0
        x, y = x + short * right[1], y + short * right[2]
        flux *= math.exp(min(max(short * right[0], -_LONGEST_STEP_PX), _LONGEST_STEP_PX))
    at[0], at[1] = x, y
    return True
