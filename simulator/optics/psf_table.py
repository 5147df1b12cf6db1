"""Tables of a PSF from the intensity in the image plane: pixel integrals at many phases, with conserved flux.

A phase is the position of a star within a pixel, in steps of 1/`phases` of a pixel.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.optics import pupil
from simulator.optics.pixel_response import transfer
from startracker.core import FloatArray

TAPS = 4
"""Points of the Lagrange interpolation between phases; the kernel in `simulator.optics.splat` is unrolled for four."""

TAPER_PX = 4.0
"""Width of the taper at the end of the wings of a star, pixels along columns."""

STRIDES = (6, 4, 3, 2)
"""Possible factors by which the number of phases is reduced."""

_KNOTS = 11
"""Points of the quadrature over the phases in `join`."""

_SAMPLES_PER_LAMBDA_N = 2.4
"""Samples of the intensity per λN; two are sufficient for the pattern, and the rest is for the interpolation filter."""


def sample_grid(half_px: float, lambda_n_px: float) -> FloatArray:
    """Positions (pixels) at which a pattern band-limited to 1/λN must be sampled for a stamp."""
    step = lambda_n_px / _SAMPLES_PER_LAMBDA_N
    count = math.ceil((half_px + 2.0 + 8.0 * lambda_n_px) / step)
    return np.asarray(np.arange(-count, count + 1) * step, dtype=float)


def pixel_matrix(
    positions_px: FloatArray,
    samples_px: FloatArray,
    lambda_n_px: float,
    diffusion_px: float,
    size_px: float,
    contrast: float = 0.0,
) -> FloatArray:
    """Matrix (positions, samples) that integrates a sampled pattern over pixels along one axis.

    K(x) = h ∫ s sinc(sf) exp(−2π²σ²f²) w(f) exp(2πifx) df: band-limited interpolation of samples with spacing h,
    convolved with a pixel of size s (with the response of `simulator.optics.pixel_response` if it has a contrast) and
    with the Gaussian of charge diffusion. The window w is 1 in the band of the pattern, up to 1/λN, and falls to 0
    before the band of its aliases, at 1/h − 1/λN.
    """
    step = samples_px[1] - samples_px[0]
    passed, stopped = 1.0 / lambda_n_px, 1.0 / step - 1.0 / lambda_n_px
    reach = float(np.abs(positions_px).max() + np.abs(samples_px).max())
    nodes, weights = pupil.legendre(math.ceil(math.pi * reach * stopped / 2.0) + 40)
    f = stopped * (nodes + 1.0) / 2.0
    t = np.clip((f - passed) / (stopped - passed), 0.0, 1.0)
    window = 1.0 - t**3 * (10.0 - 15.0 * t + 6.0 * t * t)
    spectrum = (
        stopped
        * weights
        * size_px
        * transfer(size_px * f, contrast)
        * np.exp(-2.0 * (np.pi * diffusion_px * f) ** 2)
        * window
        * step
    )
    # cos(a − b) = cos a cos b + sin a sin b: the kernel is a product of matrices, and no table of all differences is
    # needed.
    a, b = 2.0 * np.pi * np.outer(positions_px, f), 2.0 * np.pi * np.outer(samples_px, f)
    return np.asarray((np.cos(a) * spectrum) @ np.cos(b).T + (np.sin(a) * spectrum) @ np.sin(b).T)


def offsets(half: int, phases: int, stride: int = 1) -> NDArray[np.int64]:
    """Offsets of pixels from the star for a stamp at all phases, in steps of 1/`phases` of a pixel; the table uses
    every `stride`-th phase."""
    margin = (phases // stride // 2 + TAPS // 2) * stride
    return np.arange(-half * phases - margin, half * phases + margin + 1)


def polyphase(fine: FloatArray, half: int, phases: int, stride: int = 1) -> FloatArray:
    """Core table [b, a, j, i] from pixel integrals `fine` (rows, columns) at `offsets`."""
    margin = phases // stride // 2 + TAPS // 2
    # For a star shifted by a phases, pixel i has the offset i·phases − a.
    index = np.arange(-half, half + 1)[None, :] * phases - np.arange(-margin, margin + 1)[:, None] * stride
    where = index + half * phases + margin * stride
    return np.ascontiguousarray(fine[where[:, None, :, None], where[None, :, None, :]])


def coarsest(fine: FloatArray, phases: int, tolerance: float) -> int:
    """Largest factor of `STRIDES` by which the number of phases can be reduced; it divides half of the phases.

    The error of four-point Lagrange interpolation at steps h is at most 3/128 h⁴ |f⁗| on each axis, where h⁴ f⁗ is
    estimated by fourth differences. The error stays below `tolerance` × the peak.
    """
    fourth = max(float(np.abs(np.diff(fine, 4, axis=axis)).max()) for axis in (0, 1))
    allowed = tolerance * float(fine.max())
    fit = (n for n in STRIDES if phases // 2 % n == 0 and 2.0 * 3.0 / 128.0 * fourth * n**4 <= allowed)
    return next(fit, 1)


def join(
    core: FloatArray,
    phases: int,
    wing: FloatArray,
    step_px: float,
    aspect: float,
    total: float | None = None,
    even: bool = True,
) -> tuple[FloatArray, FloatArray]:
    """Normalise stamps to the same light at every phase, and determine the total light of stamp and wings.

    The core is scaled (by about 1e-5) to the same sum at all phases, and has that sum between phases as well, since the
    interpolation weights sum to 1. The sum of the wings over pixels varies with the phase by about 1e-5; the rendering
    kernel adds the wings first and scales the stamp to the total returned here.

    Parameters
    ----------
    core : (P, P, M, M) array
        Scaled in place, if `even`.
    phases : int
        Phases per pixel.
    wing : (W,) array
        Fraction of the light in a pixel by its distance.
    step_px : float
        Step of the wings' table.
    aspect : float
        Pitch along columns over pitch along rows.
    total : float, optional
        Light of core and wings to the end of the wings' table; the wings are scaled by 1 + α/r² accordingly. By default
        they are not scaled.
    even : bool
        Whether the light of a star is the same at all phases; false for pixels with a response across them.

    Returns
    -------
    wing : (W,) array
        The wings.
    drawn : (W,) array
        Light of stamp and wings, with the taper, of a star rendered to a radius, in steps of `step_px`: the mean over
        all phases; valid from `least_radius` on, below which no wings are rendered. NaN if not `even`.
    """
    half = core.shape[3] // 2
    radius = least_radius(half, aspect)
    held = _even_sums(core, phases, even)
    r: FloatArray = np.arange(len(wing), dtype=np.float64) * step_px
    area = 2.0 * np.pi * r * aspect  # of rings, pixels per column
    knots, weights = pupil.legendre(_KNOTS)

    def beyond(light: FloatArray) -> float:
        """Sum outside the stamp, averaged over phases; it is so smooth that a few phases give it to 1e-9."""
        sums = outside(knots / 2.0, half, light, 1.0 / step_px, 1.0 / aspect, radius)
        return float(weights @ sums @ weights) / 4.0

    if total is not None:
        # The stamp, the wings near it (summed over pixels) and the far wings (integrated over rings) must add up to the
        # total; α scales the wings accordingly, mostly near the stamp.
        far = 1.0 - fade(r, radius)
        bent = wing / np.maximum(r, half / 2.0) ** 2
        plain, extra = (beyond(light) + float(np.trapezoid(far * light * area, r)) for light in (wing, bent))
        alpha = (total - held - plain) / extra
        wing = wing + max(alpha, -0.5 * (half / 2.0) ** 2) * bent
    # Light to a radius R with its taper: integration by parts turns it into the mean of the light inside, weighted by
    # the slope of `fade`.
    inside = np.concatenate([[0.0], np.cumsum((wing[1:] * area[1:] + wing[:-1] * area[:-1]) * step_px / 2.0)])
    nodes, slopes = pupil.legendre(8)
    t = (nodes + 1.0) / 2.0
    rims = np.interp(np.append(r, radius)[:, None] + TAPER_PX * t, r, inside) @ (slopes * 3.0 * t * (1.0 - t))
    drawn = held + beyond(wing) + rims[:-1] - rims[-1]
    return wing, drawn if even else np.full_like(drawn, math.nan)


def _even_sums(core: FloatArray, phases: int, even: bool) -> float:
    """Mean of the stamps' sums over a pixel; if `even`, the stamps of all phases are scaled to it in place."""
    middle = core.shape[0] // 2
    sums = core.sum(axis=(2, 3))
    period = slice(middle - phases // 2, middle + phases // 2 + 1)
    # Mean over one pixel; both ends, which are the same phase, have half weight, so that mirrored tables are identical.
    mean = np.full(phases + 1, 1.0 / phases)
    mean[[0, -1]] /= 2.0
    held = float(mean @ sums[period, period] @ mean)
    if even:
        core *= (held / sums)[:, :, None, None]
    return held


def least_radius(half: int, aspect: float) -> float:
    """Minimum radius (pixels along columns) of a star with wings: the circle about the stamp."""
    return math.hypot(half + 1.0, (half + 1.0) / aspect)


def fade(r: FloatArray, radius: float) -> FloatArray:
    """1 to `radius`, 0 from `radius` + `TAPER_PX` on, smooth (3t² − 2t³) between."""
    return np.asarray(smooth_step(np.clip((radius + TAPER_PX - r) / TAPER_PX, 0.0, 1.0)))


def smooth_step(t: Any) -> Any:
    """3t² − 2t³ of a number or an array, from 0 to 1 with t."""
    return t * t * (3.0 - 2.0 * t)


def outside(
    at_px: FloatArray, half: int, wing: FloatArray, wing_per_px: float, row_px: float, radius: float
) -> FloatArray:
    """Light of the wings outside the stamp, [b, a], of stars `at_px[a]` right of and `at_px[b]` below its centre."""
    end_x, end_y = math.ceil(radius + TAPER_PX) + 1, math.ceil((radius + TAPER_PX) / row_px) + 1
    columns, rows = np.arange(-end_x, end_x + 1), np.arange(-end_y, end_y + 1)
    beyond = (np.abs(rows) > half)[:, None] | (np.abs(columns) > half)
    sums = np.empty((len(at_px), len(at_px)))
    for b, y in enumerate(at_px):
        for a, x in enumerate(at_px):
            # Distances in pixels along columns, also if pixels are not square; the table is interpolated linearly.
            r = np.hypot((columns - x), ((rows - y) * row_px)[:, None])[beyond]
            position = r * wing_per_px
            m = np.minimum(position.astype(np.int64), len(wing) - 2)
            sums[b, a] = np.sum(fade(r, radius) * (wing[m] + (position - m) * (wing[m + 1] - wing[m])))
    return sums
