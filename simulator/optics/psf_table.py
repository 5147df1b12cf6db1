"""From light in the image plane to the table of a PSF: pixel integrals at many phases, and a seam that keeps flux."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

FloatArray = NDArray[np.float64]

TAPS = 4
"""Points of the Lagrange interpolation between phases; the kernel in `simulator.optics.splat` is written out for
four."""

TAPER_PX = 4.0
"""Width of the rim over which the wings of a star fade out, pixels along columns."""

_KNOTS = 11

_SAMPLES_PER_LAMBDA_N = 2.4
"""Samples of the intensity a λN; two hold all of it, and the rest is room for the interpolating filter."""


def sample_grid(half_px: float, lambda_n_px: float) -> FloatArray:
    """Positions (pixels) at which a pattern without frequencies above 1/λN must be known for a stamp."""
    step = lambda_n_px / _SAMPLES_PER_LAMBDA_N
    count = math.ceil((half_px + 2.0 + 8.0 * lambda_n_px) / step)
    return np.asarray(np.arange(-count, count + 1) * step, dtype=float)


def pixel_matrix(
    positions_px: FloatArray, samples_px: FloatArray, lambda_n_px: float, diffusion_px: float, size_px: float
) -> FloatArray:
    """Matrix (positions, samples) that integrates a sampled pattern over pixels along one axis.

    K(x) = h ∫ s sinc(sf) exp(−2π²σ²f²) w(f) exp(2πifx) df: band-limited interpolation of samples h apart, convolved
    with a pixel (of size s) and a Gaussian of charge diffusion. w is 1 where the pattern has frequencies, to 1/λN, and
    falls to 0 before those of its copies begin, at 1/h − 1/λN.
    """
    step = samples_px[1] - samples_px[0]
    passed, stopped = 1.0 / lambda_n_px, 1.0 / step - 1.0 / lambda_n_px
    reach = float(np.abs(positions_px).max() + np.abs(samples_px).max())
    nodes, weights = np.polynomial.legendre.leggauss(math.ceil(math.pi * reach * stopped / 2.0) + 40)
    f = stopped * (nodes + 1.0) / 2.0
    t = np.clip((f - passed) / (stopped - passed), 0.0, 1.0)
    window = 1.0 - t**3 * (10.0 - 15.0 * t + 6.0 * t * t)
    spectrum = (
        stopped
        * weights
        * size_px
        * np.sinc(size_px * f)
        * np.exp(-2.0 * (np.pi * diffusion_px * f) ** 2)
        * window
        * step
    )
    # cos(a − b) splits into products, so that no table of all differences is needed
    a, b = 2.0 * np.pi * np.outer(positions_px, f), 2.0 * np.pi * np.outer(samples_px, f)
    return np.asarray((np.cos(a) * spectrum) @ np.cos(b).T + (np.sin(a) * spectrum) @ np.sin(b).T)


def offsets(half: int, phases: int, stride: int = 1) -> NDArray[np.int64]:
    """Offsets of pixels from the star that a stamp with its phases needs, in steps of 1/`phases` of a pixel; the table
    takes every `stride`-th phase."""
    margin = (phases // stride // 2 + TAPS // 2) * stride
    return np.arange(-half * phases - margin, half * phases + margin + 1)


def polyphase(fine: FloatArray, half: int, phases: int, stride: int = 1) -> FloatArray:
    """Core table [b, a, j, i] from pixel integrals `fine` (rows, columns) at `offsets`."""
    margin = phases // stride // 2 + TAPS // 2
    # a star a phases to the right leaves pixel i at i·phases − a from it
    index = np.arange(-half, half + 1)[None, :] * phases - np.arange(-margin, margin + 1)[:, None] * stride
    where = index + half * phases + margin * stride
    return np.ascontiguousarray(fine[where[:, None, :, None], where[None, :, None, :]])


def coarsest(fine: FloatArray, phases: int, tolerance: float) -> int:
    """Largest power of two by which the phases of a table may be thinned out.

    Four-point Lagrange interpolation at steps h is off by at most 3/128 h⁴ |f⁗| on each axis; fourth differences give
    h⁴ f⁗. The error stays below `tolerance` × the peak.
    """
    fourth = max(float(np.abs(np.diff(fine, 4, axis=axis)).max()) for axis in (0, 1))
    stride = 1
    while phases % (4 * stride) == 0 and 2 * 3 / 128 * fourth * (2 * stride) ** 4 <= tolerance * float(fine.max()):
        stride *= 2
    return stride


def join(
    core: FloatArray, phases: int, wing: FloatArray, step_px: float, aspect: float, total: float | None = None
) -> tuple[FloatArray, FloatArray]:
    """Make stamps hold the same light at every phase, alone and together with the wings.

    The core is scaled (by some 1e-5) to the same sum at all phases, which it then keeps between them too, since the
    weights of the interpolation add up to 1. The sum of the wings over pixels hangs on the phase only because the
    square stamp is left out of them; with wings the core is scaled once more, by the factors returned, so that the sum
    of both does not.

    Parameters
    ----------
    core : (P, P, M, M) array
        Scaled in place.
    phases : int
        Phases a pixel.
    wing : (W,) array
        Share of the light in a pixel by its distance.
    step_px : float
        Step of the wings' table.
    aspect : float
        Pitch along columns over pitch along rows.
    total : float, optional
        Light that core and wings shall hold to the end of the wings' table; the wings are scaled by 1 + α/r² to hold
        it. Left out, they stay as they are.

    Returns
    -------
    wing : (W,) array
        The wings.
    seam : (P, P) array
        Factor to the core at each phase of a star that is drawn with wings.
    """
    half = core.shape[3] // 2
    middle = core.shape[0] // 2
    radius = least_radius(half, aspect)
    sums = core.sum(axis=(2, 3))
    period = slice(middle - phases // 2, middle - phases // 2 + phases)
    at = (np.arange(core.shape[0]) - middle) / phases
    knots = np.linspace(at[0], at[-1], _KNOTS)

    def beyond(light: FloatArray) -> FloatArray:
        """The sum outside the stamp, by phase: smooth, so that a spline through a few phases gives it to 1e-9."""
        few = outside(knots, half, light, 1.0 / step_px, 1.0 / aspect, radius)
        return np.asarray(RectBivariateSpline(knots, knots, few, kx=5, ky=5)(at, at))

    if total is not None:
        r = np.arange(len(wing)) * step_px
        far = 1.0 - np.array([fade(value, radius) for value in r])
        bent = wing / np.maximum(r, half / 2.0) ** 2
        plain, extra = (
            float(beyond(light)[period, period].mean()) + float(np.trapezoid(far * light * 2.0 * np.pi * r * aspect, r))
            for light in (wing, bent)
        )
        alpha = (total - float(sums[period, period].mean()) - plain) / extra
        wing = wing + max(alpha, -0.5 * (half / 2.0) ** 2) * bent
    held = float(sums[period, period].mean())
    core *= (held / sums)[:, :, None, None]
    around = beyond(wing)
    return wing, 1.0 + (around[period, period].mean() - around) / held


def least_radius(half: int, aspect: float) -> float:
    """Radius (pixels along columns) that a star with wings is drawn to at least: the stamp lies inside."""
    return math.hypot(half + 1.0, (half + 1.0) / aspect)


@njit(cache=True, error_model="numpy")
def fade(r: float, radius: float) -> float:
    """1 to `radius`, 0 from `radius` + `TAPER_PX` on, smooth (3t² − 2t³) between."""
    t = min(max((radius + TAPER_PX - r) / TAPER_PX, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@njit(cache=True, error_model="numpy")
def outside(
    at_px: FloatArray, half: int, wing: FloatArray, wing_per_px: float, row_px: float, radius: float
) -> FloatArray:
    """Light of the wings outside the stamp, [b, a], of stars `at_px[a]` right of and `at_px[b]` below its centre."""
    sums = np.zeros((len(at_px), len(at_px)))
    reach_x, reach_y = math.ceil(radius + TAPER_PX) + 1, math.ceil((radius + TAPER_PX) / row_px) + 1
    last = len(wing) - 2
    for b in range(len(at_px)):
        for a in range(len(at_px)):
            total = 0.0
            for j in range(-reach_y, reach_y + 1):
                dy = (j - at_px[b]) * row_px
                for i in range(-reach_x, reach_x + 1):
                    if abs(i) > half or abs(j) > half:
                        r = math.sqrt((i - at_px[a]) ** 2 + dy * dy)
                        position = r * wing_per_px
                        m = min(int(position), last)
                        total += fade(r, radius) * (wing[m] + (position - m) * (wing[m + 1] - wing[m]))
            sums[b, a] = total
    return sums
