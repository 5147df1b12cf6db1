"""Rolling shutter, and frame transfer under light.

Rolling: row y is exposed from t_y − T/2 to t_y + T/2 with t_y = (y − y_c) · line_time, where y_c is the middle row. The
time and the true attitude of a frame are those at the middle of the exposure of its middle row. A star is exposed at
the moments u = t − t_y(t) of the window of its own row, −T/2 ≤ u ≤ T/2, so that

    t = u + (y(t) − y_c) · line_time

A star that moves with the shutter is exposed for longer, T / |1 − ẏ · line_time|.

Frame transfer without a mechanical shutter: every line of charge is moved through the image, one row per `line_time`,
and collects light in each row on its way. With the flux F(r), electrons per second,

    after the exposure    + line_time · Σ F(rows ahead of r, through which it leaves)
    before it (clearing)  + line_time · Σ F(rows behind r, through which it came)

Source: J. R. Janesick, *Scientific Charge-Coupled Devices* (2001), chapters 1 and 4, for the transfer; M. Meingast,
C. Geyer & S. Sastry, "Geometric models of rolling-shutter cameras", OMNIVIS 2005, for the rolling shutter.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from simulator.optics.drift import Drift, longest_drift_px
from simulator.optics.jitter_series import JitterMotion
from simulator.optics.smear import (
    DEFAULT_FEATURE_PX,
    DEFAULT_MARGIN_PX,
    exposure_nodes,
    longest_path_px,
    path_limit_rad,
    rotation_matrices,
    wander_length_px,
)
from startracker.core import FloatArray
from startracker.errors import InputError
from startracker.geometry.camera import Camera

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

_SETTLED_PX = 1e-9
"""Distance from its row, pixels, at which the iteration for a moment has converged."""
_MOST_STEPS = 30
_LONGEST = 10.0
"""Longest exposure of a star that moves with the shutter, relative to the nominal exposure."""
_TABLE_PER_CYCLE = 24
"""Samples of the jitter per period of its fastest component; a cubic spline between them is accurate to 1e-5."""


def rolling_paths(
    camera: Camera,
    sources: FloatArray | Drift,
    rate_rad_s: ArrayLike,
    exposure_s: float,
    line_time_s: float,
    feature_px: float = DEFAULT_FEATURE_PX,
    margin_px: float = DEFAULT_MARGIN_PX,
    jitter: JitterMotion | None = None,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Pixel positions of stars during the exposure of their rows.

    Parameters
    ----------
    camera, rate_rad_s, exposure_s, feature_px, margin_px, jitter
        As in `simulator.optics.smear.star_paths`.
    sources : (N, 3) array or Drift
        Directions in camera axes at the middle of the exposure of the middle row, or the sources' own motion.
    line_time_s : float
        Delay between the starts of successive rows.

    Returns
    -------
    xy : (N, K, 2) array
        Positions; NaN outside the field and its margin, and for a star whose speed is within a tenth of the shutter's.
    weights : (K,) array
        Fraction of the exposure of each moment; their sum is 1.
    exposed : (N,) array
        Time for which each star is exposed, divided by `exposure_s`: the factor for its electrons.

    Notes
    -----
    The window of the row of the star's centre is used for its whole image. This neglects a shear of the image by
    velocity · line_time (2 % at 1,000 px/s and 20 µs), which is odd about the centre and does not shift the centroid.
    """
    if not isinstance(sources, Drift):
        sources = np.atleast_2d(np.asarray(sources, dtype=float))
    count = len(sources.coefficients if isinstance(sources, Drift) else sources)
    rate = np.asarray(rate_rad_s, dtype=float)
    limit_rad = path_limit_rad(camera, margin_px)
    middle = (camera.height - 1) / 2.0
    reach_s = exposure_s / 2.0 + (middle + margin_px + 1.0) * line_time_s
    shaking = _spline(jitter, reach_s) if jitter is not None else None

    def position(t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pixels (N, K, 2) and cosines (N, K) of the angle off the axis at moments (N, K)."""
        # The camera rotates by +ω t, so directions rotate by −ω t in its axes; each star has its own moments.
        turning = rotation_matrices(-rate * t[..., None])
        if isinstance(sources, Drift):
            vectors = np.einsum("nkij,nkj->nki", turning, sources.at(t))
        else:
            vectors = np.einsum("nkij,nj->nki", turning, sources)
        if shaking is not None:
            vectors = np.einsum("nkij,nkj->nki", rotation_matrices(-shaking(t)), vectors)
        return camera.project(vectors.reshape(-1, 3)).reshape(*t.shape, 2), vectors[..., 2]

    def rows(t: FloatArray) -> FloatArray:
        """Rows (N, K) of the stars at moments (N, K), from the middle of the image."""
        return np.clip(position(t)[0][..., 1] - middle, -middle - margin_px, middle + margin_px)

    def moments(u: FloatArray) -> FloatArray:
        return _moments_in_windows(rows, np.tile(u, (count, 1)), line_time_s)

    # A star that moves with or against the shutter is exposed for a longer or shorter time than the nominal one, and
    # the sampling of its path is chosen for the longest.
    ends = moments(np.array([-0.5, 0.5]) * exposure_s)
    exposed = np.abs(ends[:, 1] - ends[:, 0]) / exposure_s
    held = exposed < _LONGEST  # also false for NaN, where the iteration did not converge
    exposed = np.where(held, exposed, 1.0)
    longest = float(exposed.max(initial=1.0))
    if isinstance(sources, Drift):
        length_px = longest_drift_px(camera, sources, rate, exposure_s * longest, limit_rad)
    else:
        length_px = longest_path_px(camera, sources, -rate * exposure_s * longest, limit_rad)
    cycles = 0.0
    if jitter is not None:
        length_px += wander_length_px(camera, jitter, exposure_s * longest, limit_rad)
        cycles = jitter.max_hz * exposure_s * longest
    nodes, weights = exposure_nodes(length_px, feature_px, cycles)
    xy, cosine = position(moments(nodes * exposure_s / 2.0))
    xy[~(cosine >= np.cos(limit_rad)) | ~held[:, None]] = np.nan
    return xy, weights, exposed


def _moments_in_windows(rows: Callable[[FloatArray], FloatArray], u: FloatArray, line_time_s: float) -> FloatArray:
    """Moments t (N, K) with t = u + rows(t) · line_time for moments `u` (N, K) within the window of a row; NaN if there
    are none.

    The equation is solved by the secant method, whose first step is exact for straight paths.
    """

    def late(t: FloatArray) -> FloatArray:
        """Residual of the equation, seconds."""
        return np.asarray(t - u - rows(t) * line_time_s)

    before, miss = u, late(u)
    t = before - miss
    for _ in range(_MOST_STEPS):
        now = late(t)
        if not (np.abs(now) > _SETTLED_PX * line_time_s).any():
            return t
        # A zero difference of the residuals means that a star has converged, and its step is 0.
        change = np.where(now == miss, 0.0, now * (t - before) / np.where(now == miss, 1.0, now - miss))
        before, miss, t = t, now, t - change
    return np.where(np.abs(late(t)) > _SETTLED_PX * line_time_s, np.nan, t)


def frame_transfer_smear(
    mean_e: FloatArray,
    exposure_s: float,
    line_time_s: float,
    direction: Literal["up", "down"],
    phases: Literal["both", "after"] = "both",
) -> FloatArray:
    """Electrons that moving charge collects in the rows it passes.

    Parameters
    ----------
    mean_e : (H, W) array
        Electrons over the exposure: stars and background.
    exposure_s : float
        Exposure time.
    line_time_s : float
        Time that a line of charge is in each row during the transfer. For a full-frame CCD that is read out under light
        it is the readout time of a line, 1/9.6 kHz for a TC211 (Greyling 1995, section 6.2).
    direction : str
        ``up``: charge leaves past row 0; ``down``: past the last row.
    phases : str
        ``both``: the image was cleared by the same transfer before the exposure, or is exposed continuously;
        ``after``: it was cleared at once, by a drain.

    Returns
    -------
    (H, W) array
        Mean electrons to add.

    Raises
    ------
    InputError
        For an unknown direction or phases.

    Notes
    -----
    Exact for a scene that is static during exposure and transfer; the motion of stars is neglected.
    """
    if direction not in ("up", "down"):
        raise InputError(f"charge moves 'up' or 'down', not {direction!r}")
    if phases not in ("both", "after"):
        raise InputError(f"smear comes 'both' before and after or 'after' the exposure, not {phases!r}")
    ordered = mean_e if direction == "up" else mean_e[::-1]
    gathered = np.zeros_like(ordered, dtype=float)
    np.cumsum(ordered[:-1], axis=0, out=gathered[1:])  # rows ahead
    if phases == "both":
        gathered[:-1] += np.cumsum(ordered[:0:-1], axis=0)[::-1]  # and behind
    gathered *= line_time_s / exposure_s
    return gathered if direction == "up" else np.ascontiguousarray(gathered[::-1])


def _spline(jitter: JitterMotion, reach_s: float) -> CubicSpline:
    """The path from −reach to +reach as a spline, which is faster to evaluate than its cosines if each star has its own
    moments."""
    from scipy.interpolate import CubicSpline

    t = np.linspace(-reach_s, reach_s, 8 + int(np.ceil(2.0 * reach_s * jitter.max_hz * _TABLE_PER_CYCLE)))
    return CubicSpline(t, jitter.at(t))
