"""Stars of a frame that the camera's turn has drawn out so far that no pixel of them stands out of the noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from startracker.centroid.result import Centroids
from startracker.detection.background import Background, as_image
from startracker.detection.matched import DEFAULT_SIGMA_PX
from startracker.detection.smear import agrees, common_motion, motion_at
from startracker.detection.streak_kernels import (
    ANGLE,
    FLUX,
    HALF,
    SIGMA,
    SKY,
    X,
    Y,
    bin_residual,
    fit_streak,
    keep_apart,
    line_response,
    subtract_streak,
)
from startracker.detection.streak_lines import (
    CLIP,
    COARSE_SIGMA,
    LOOKED_AT,
    SHORTEST_PX,
    candidate_lines,
    find_peaks,
    smooth_bins,
)
from startracker.detection.values import Image
from startracker.settings import DetectionSettings

__all__ = ["Streaks", "find_streaks"]

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.float32]

_LARGEST_MAP_PX = 1200
"""Larger images are searched in larger squares: the search costs as much, and finds brighter streaks only."""
_FITTED = 20
_WIDTH_STREAKS = 5
_PIXEL_VARIANCE = 1.0 / 12.0
_FEWEST = 4
_SHORTEST_MOTION_PX = 5.0
"""These lines were fitted, each above the noise as a whole: shorter ones than those of bare objects mean something."""
_WHOLE_PX = 25.0
"""Objects shorter than this are whole streaks; longer streaks come in pieces, of which a bank of lines makes more."""
_SWEEPS = 2
_FREE_SNR = 30.0
_WORST_CHI2 = 3.0
_MODEL_ERROR = 0.01
"""Share of a streak's light by which the model may be wrong without its being something else."""
_SYSTEMATIC_PX = 0.005
_CUT_PX = 4.0
"""A streak that ends nearer to the border may go on beyond."""
_LENGTH_ERROR_PX, _STRETCH, _TURN_PX = 0.3, 0.01, 0.1
"""What else streaks may differ by: a flat image stretches towards its corners by the square of the angle."""
_CAUCHY = 2.4
"""Residual in standard errors at which a streak has half its weight (95 % efficiency)."""
_LIGHT = np.array([FLUX, SKY])
_PLACE = np.array([X, Y, FLUX, SKY])
_SHAPE = np.array([X, Y, FLUX, ANGLE, HALF, SKY])
_ALL = np.array([X, Y, FLUX, ANGLE, HALF, SIGMA, SKY])


@dataclass(frozen=True, eq=False)
class Streaks:
    """Stars drawn out along the motion of the frame.

    Parameters
    ----------
    centroids : Centroids
        Middles of the streaks, where the stars stood in the middle of the exposure; brightest first.
    motion : (3,)
        (a, b, c): during the exposure what is at (x, y) from the image's middle moved by (a − c y, b + c x), pixels;
        forwards or backwards is not known.
    """

    centroids: Centroids
    motion: FloatArray


def find_streaks(
    image: Image,
    background: Background,
    settings: DetectionSettings | None = None,
    saturation_dn: float | None = None,
    gain_e_per_dn: float | None = None,
    known: FloatArray | None = None,
) -> Streaks | None:
    """Find and measure the streaks that all stars of a frame have drawn alike.

    The image is divided by its noise and summed along lines of 8 px to 0.3 of its smaller side in all directions. The
    lines that stand out are fitted, each for itself; where four of them, and most of the brightest, agree in one
    motion of the camera (`startracker.detection.smear`), the image is searched again for streaks of this motion, down
    to `threshold_sigma` along the whole streak. The model of a streak is a line convolved with a Gaussian; neighbours
    that overlap are measured with each other's light taken off.

    Parameters
    ----------
    image : array, shape (H, W)
        DN; not finite: left out.
    background : Background
        Of the same shape.
    settings : DetectionSettings, optional
        `threshold_sigma`, `max_stars`, `psf_sigma_px` (None: measured).
    saturation_dn, gain_e_per_dn : float, optional
        Saturated pixels are left out; the gain tells the photon noise.
    known : array, shape (N, 4), optional
        Middle x and y and half the length along x and y of streaks found before, brightest first, which tell the motion
        if they can. Those shorter than 25 px are measured as they are, longer ones looked for anew.

    Returns
    -------
    Streaks or None
        None where there is no common motion: no streaks, too few, or of different directions.

    Notes
    -----
    Across the streak a position is as good as its signal-to-noise ratio: σ / SNR. Along, only the two ends tell, and
    their error is √(2π) σ / r px, with r the signal of a pixel's length of the streak over the noise of a pixel, as
    long as r is well above 1. Below, the error grows as of a jump in noise (Hinkley 1970); the covariance has both.
    Streaks that the border cuts have no middle and are left out.
    """
    settings = settings or DetectionSettings()
    pixels = as_image(image)
    given = settings.psf_sigma_px
    sigma = math.hypot(DEFAULT_SIGMA_PX if given is None else given, math.sqrt(_PIXEL_VARIANCE))
    residual = np.where(np.isfinite(pixels), pixels - background.level, np.float32(np.nan))
    full = np.zeros(pixels.shape, np.bool_) if saturation_dn is None else pixels >= saturation_dn
    frame = _Frame(residual, background.noise, full, 0.0 if gain_e_per_dn is None else 1.0 / gain_e_per_dn)
    lines = np.empty((0, 4)) if known is None else known
    found = _motion(frame, lines[:_FITTED], sigma, given is None)
    if found is not None and 2.0 * np.median(np.hypot(*lines[:, 2:].T)) < _WHOLE_PX:
        return _streaks(frame, lines[:, :2], *found, settings)
    unit = max(1, math.ceil(max(pixels.shape) / _LARGEST_MAP_PX))
    bins = bin_residual(pixels, background.level, background.noise, 2 * unit)
    if min(bins.shape) < 2.0 * SHORTEST_PX:
        return None
    bins /= _excess(bins)
    if found is None:
        found = _motion(frame, candidate_lines(bins, unit)[:_FITTED], sigma, given is None)
    if found is None:
        return None
    motion, sigma = found
    starts = _along_motion(bins, 2.0 * unit, motion, settings.threshold_sigma, sigma)
    return _streaks(frame, starts, motion, sigma, settings)


@dataclass(frozen=True, eq=False)
class _Frame:
    residual: FloatImage
    noise: FloatImage
    saturated: NDArray[np.bool_]
    inverse_gain: float

    @property
    def middle(self) -> FloatArray:
        return 0.5 * (np.array(self.residual.shape[::-1], dtype=float) - 1.0)

    def fit(self, start: FloatArray, free: NDArray[np.int64], slack: float) -> tuple[FloatArray, FloatArray, float]:
        """Parameters, covariance and χ² a degree of freedom; infinite where there is no fit."""
        made, covariance, chi2, _ = fit_streak(
            self.residual, self.noise, self.saturated, start, free, slack, self.inverse_gain
        )
        good = np.isfinite(made).all() and np.isfinite(covariance).all() and bool((np.diag(covariance) > 0).all())
        return made, covariance, chi2 if good else math.inf


def _excess(bins: FloatImage) -> float:
    """Noise of the bins, at least 1: neighbouring pixels of a photograph are correlated."""
    sample = bins.ravel()[:: max(1, bins.size // 8192) | 1]
    middle, above = np.quantile(sample, (0.5, 0.841345))
    return max(1.0, float(above - middle))


# ---------------------------------------------------------------------- the motion
def _motion(frame: _Frame, lines: FloatArray, sigma: float, measure_sigma: bool) -> tuple[FloatArray, float] | None:
    """The motion that the lines share, and the width of the star image."""
    fits, errors = [], []
    size = np.array(frame.residual.shape[::-1])
    for line in lines:
        start = _with_ends(frame, line, sigma)
        made, covariance, chi2 = frame.fit(start, _ALL, 3.0 + 0.05 * start[HALF])
        if not math.isfinite(chi2) or made[FLUX] ** 2 < COARSE_SIGMA**2 * covariance[2, 2]:
            continue
        if not _within(made, size, _CUT_PX):
            continue
        fits.append(made)
        errors.append(chi2 * np.array([4.0 * covariance[4, 4], 4.0 * made[HALF] ** 2 * covariance[3, 3]]))
    if len(fits) < _FEWEST:
        return None
    order = np.argsort([-made[FLUX] for made in fits], kind="stable")
    table, variance = np.array(fits)[order], np.array(errors)[order]
    xy = table[:, [X, Y]] - frame.middle
    drawn = 2.0 * table[:, HALF, None] * _direction(table)
    motion = common_motion(xy, drawn, _SHORTEST_MOTION_PX, _SHORTEST_MOTION_PX)
    if motion is None:
        return None
    fitting = agrees(drawn, motion_at(xy, motion))
    variance += (_LENGTH_ERROR_PX + _STRETCH * 2.0 * table[:, HALF, None]) ** 2 * np.array([1.0, 0.0]) + _TURN_PX**2
    motion = _weighted_motion(xy[fitting], drawn[fitting], variance[fitting], motion)
    if measure_sigma:
        sigma = float(np.median(table[fitting, SIGMA][:_WIDTH_STREAKS]))
    return motion, sigma


def _direction(table: FloatArray) -> FloatArray:
    return np.column_stack([np.cos(table[:, ANGLE]), np.sin(table[:, ANGLE])])


def _within(made: FloatArray, size: NDArray[np.int64], margin: float) -> bool:
    """Whether both ends of a streak are at least so far inside the image."""
    reach = made[HALF] * np.abs([math.cos(made[ANGLE]), math.sin(made[ANGLE])]) + margin
    return bool(((made[:2] - reach >= 0.0) & (made[:2] + reach <= size - 1.0)).all())


def _weighted_motion(xy: FloatArray, drawn: FloatArray, variance: FloatArray, motion: FloatArray) -> FloatArray:
    """The motion of streaks whose lengths and directions are known to a variance (N, 2), px², outliers held down.

    Directions of long streaks are known far better than their lengths; two streaks in line look like one longer one.
    """
    along = drawn / np.hypot(*drawn.T)[:, None]
    axes = np.stack([along, np.column_stack([-along[:, 1], along[:, 0]])], axis=1)
    ones, zeros = np.ones(len(xy)), np.zeros(len(xy))
    design = np.stack([np.column_stack([ones, zeros, -xy[:, 1]]), np.column_stack([zeros, ones, xy[:, 0]])], axis=1)
    design = (axes @ design) / np.sqrt(variance)[:, :, None]
    for _ in range(8):
        sign = np.where((motion_at(xy, motion) * drawn).sum(axis=1) < 0.0, -1.0, 1.0)[:, None]
        target = (axes @ (sign * drawn)[:, :, None])[:, :, 0] / np.sqrt(variance)
        away = (design @ motion - target) / _CAUCHY
        weight = np.sqrt(1.0 / (1.0 + away**2))
        rows = (design * weight[:, :, None]).reshape(-1, 3)
        motion = np.asarray(np.linalg.lstsq(rows, (target * weight).reshape(-1), rcond=None)[0])
    return motion


def _with_ends(frame: _Frame, line: FloatArray, sigma: float) -> FloatArray:
    """Where along its direction a streak begins and ends: the stretch of the profile with the largest sum / √length."""
    x, y, u, v = line
    half = math.hypot(u, v)
    cos, sin = u / half, v / half
    s = np.arange(-math.ceil(2.0 * half + 8.0), math.ceil(2.0 * half + 8.0) + 1)
    t = np.arange(-2, 3)[:, None]
    weight = np.exp(-0.5 * (t / (sigma + 0.5)) ** 2)
    columns, rows = np.rint(x + s * cos - t * sin).astype(int), np.rint(y + s * sin + t * cos).astype(int)
    height, width = frame.residual.shape
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    rows, columns = np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)
    noise = frame.noise[rows, columns]
    light = np.nan_to_num(frame.residual[rows, columns])
    signal = np.where(inside, np.clip(light / noise, -CLIP, 2.0 * CLIP), 0.0)
    total = np.concatenate([[0.0], np.cumsum((weight * signal).sum(axis=0))])
    middle = len(s) // 2
    first, last = np.arange(middle), np.arange(middle + 1, len(total))
    score = (total[last][None, :] - total[first][:, None]) / np.sqrt(last[None, :] - first[:, None])
    i, j = np.unravel_index(int(np.argmax(score)), score.shape)
    begin, end = s[first[i]] - 0.5, s[last[j] - 1] + 0.5
    centre, length = 0.5 * (begin + end), end - begin
    in_stretch = slice(int(first[i]), int(last[j]))
    flux = float((light * inside)[:, in_stretch].sum())
    return np.array(
        [x + centre * cos, y + centre * sin, max(flux, 1e-9), math.atan2(sin, cos), max(0.5 * length, 2.0), sigma, 0.0]
    )


# ---------------------------------------------------------------------- streaks of one motion
def _along_motion(bins: FloatImage, scale: float, motion: FloatArray, threshold: float, sigma: float) -> FloatArray:
    """Centres (N, 2), px, of streaks of this motion, the most significant first."""
    clipped = np.clip(smooth_bins(bins, max(sigma / scale, 0.3)), -CLIP, CLIP)
    middle_y, middle_x = 0.5 * (np.array(bins.shape) - 1.0)
    response = line_response(clipped, motion, scale, middle_x, middle_y)
    sample = response[response != 0.0]
    if not len(sample):
        return np.empty((0, 2))
    low, middle = np.quantile(sample[:: max(1, len(sample) // 16384)], (0.158655, 0.5))
    limit = float(middle) + threshold * max(float(middle - low), 1e-6)
    y, x = find_peaks(response, limit)
    order = np.argsort(-response[y, x], kind="stable")[: 10 * LOOKED_AT]
    xy = np.column_stack([x, y])[order].astype(np.float64)
    halves = 0.5 * motion_at((xy - [middle_x, middle_y]) * scale, motion) / scale
    kept = keep_apart(clipped, np.column_stack([xy, halves]), 2.0, limit, LOOKED_AT)
    return np.asarray((xy[kept] + 0.5) * scale - 0.5)


def _streaks(
    frame: _Frame, starts: FloatArray, motion: FloatArray, sigma: float, settings: DetectionSettings
) -> Streaks | None:
    centroids = _measure(frame, starts, motion, sigma, settings)
    return Streaks(centroids, motion) if len(centroids) else None


def _measure(
    frame: _Frame, starts: FloatArray, motion: FloatArray, sigma: float, settings: DetectionSettings
) -> Centroids:
    """Fit the streaks one after the other, each with the others' light taken off."""
    fits: list[FloatArray] = []
    results: list[tuple[FloatArray, float]] = []
    for start in starts[: 2 * max(settings.max_stars, 0)]:
        drawn = motion_at((start - frame.middle)[None], motion)[0]
        half, angle = 0.5 * math.hypot(*drawn), math.atan2(drawn[1], drawn[0])
        best = _best_fit(frame, np.array([*start, 1.0, angle, half, sigma, 0.0]))
        if best is None or best[3] < settings.threshold_sigma:
            continue
        made, covariance, chi2, _ = best
        if math.hypot(*(made[:2] - start)) > 0.5 * half:
            continue
        subtract_streak(frame.residual, made, 1.0)
        fits.append(made)
        results.append((covariance, chi2))
    for _ in range(_SWEEPS):
        for k, before in enumerate(fits):
            subtract_streak(frame.residual, before, -1.0)
            bright = before[FLUX] > _FREE_SNR * math.sqrt(results[k][0][2, 2])
            made, covariance, chi2 = frame.fit(before, _SHAPE if bright else _PLACE, 2.0)
            if math.isfinite(chi2):
                results[k] = covariance, chi2
            else:
                made = before
            subtract_streak(frame.residual, made, 1.0)
            fits[k] = made
    return _centroids(frame, fits, results, motion, settings)


def _best_fit(frame: _Frame, start: FloatArray) -> tuple[FloatArray, FloatArray, float, float] | None:
    """Fit of place and light, and its signal-to-noise ratio: the best of three places along a faint streak.

    Noise gives the fit of a long streak several maxima along it, some pixels apart.
    """
    best: tuple[FloatArray, FloatArray, float, float] | None = None
    shift = min(max(0.05 * start[HALF], 2.0), 5.0)
    for step in (0.0, -shift, shift):
        if best is not None and best[3] > _FREE_SNR:
            break
        moved = start.copy()
        moved[[X, Y]] += step * np.array([math.cos(start[ANGLE]), math.sin(start[ANGLE])])
        moved, _, chi2 = frame.fit(moved, _LIGHT, 2.0)
        if not (math.isfinite(chi2) and moved[FLUX] > 0.0):
            continue
        made, covariance, chi2 = frame.fit(moved, _PLACE, 2.0)
        if math.isfinite(chi2):
            snr = float(made[FLUX]) / math.sqrt(covariance[2, 2])
            if best is None or snr > best[3]:
                best = made, covariance, chi2, snr
    return best


def _centroids(
    frame: _Frame,
    fits: list[FloatArray],
    results: list[tuple[FloatArray, float]],
    motion: FloatArray,
    settings: DetectionSettings,
) -> Centroids:
    """The fits that are whole streaks of the frame's motion, with what their positions are worth."""
    rows = []
    for made, (covariance, chi2) in zip(fits, results, strict=True):
        drawn = 2.0 * made[HALF] * np.array([math.cos(made[ANGLE]), math.sin(made[ANGLE])])
        inside = _within(made, np.array(frame.residual.shape[::-1]), made[SIGMA])
        fitting = agrees(drawn[None], motion_at((made[:2] - frame.middle)[None], motion))[0]
        snr = made[FLUX] / math.sqrt(covariance[2, 2])
        if not (
            inside
            and fitting
            and snr > settings.threshold_sigma
            and chi2 < _WORST_CHI2 * (1.0 + (_MODEL_ERROR * snr) ** 2)
        ):
            continue
        rows.append((made, _position_covariance(frame, made, covariance[:2, :2] * max(chi2, 1.0))))
    if not rows:
        return Centroids.none()
    rows.sort(key=lambda row: -row[0][FLUX])
    rows = rows[: max(settings.max_stars, 0)]
    table = np.array([row[0] for row in rows])
    nearest = np.rint(table[:, :2]).astype(np.int64)
    saturated = frame.saturated[nearest[:, 1], nearest[:, 0]]
    return Centroids(table[:, :2].copy(), table[:, FLUX].copy(), np.array([row[1] for row in rows]), saturated)


def _position_covariance(frame: _Frame, made: FloatArray, covariance: FloatArray) -> FloatArray:
    """Least squares' own, plus what a faint streak's ends add: the error of a jump in noise, 26 / rate²."""
    noise = float(frame.noise[round(float(made[Y])), round(float(made[X]))])
    rate = (made[FLUX] / (2.0 * made[HALF] * noise)) ** 2 / (math.sqrt(math.pi) * made[SIGMA])
    along = min(26.0 / rate**2, made[HALF] ** 2 / 3.0)
    direction = np.array([math.cos(made[ANGLE]), math.sin(made[ANGLE])])
    return np.asarray(covariance + along * np.outer(direction, direction) + _SYSTEMATIC_PX**2 * np.eye(2))
