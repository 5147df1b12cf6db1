"""First moment over a small window, corrected for its bias (Greyling 1995, section 4.3)."""

from __future__ import annotations

import numpy as np

from startracker.centroid.frame import collect, measure_moments, prepare
from startracker.centroid.psf_fit import weighted_table
from startracker.centroid.result import Centroids
from startracker.core import IntArray
from startracker.detection.background import Background
from startracker.detection.spots import Spots
from startracker.detection.values import Image
from startracker.settings import CentroidSettings

_WIDEST_FOR_3_PX = 1.1


def first_moment(
    image: Image,
    background: Background,
    spots: Spots,
    settings: CentroidSettings | None = None,
    gain_e_per_dn: float | None = None,
) -> Centroids:
    """Centroids by the first moment of the signal over a window around the brightest pixel.

    The moment over a truncated window is smaller than the offset of the star (Greyling 1995, Table 4.1). For a Gaussian
    integrated over pixels the deficit along x depends on x only, and is corrected exactly, axis by axis, by solving
    m(d) = m for the offset d (see `startracker.centroid.bias`), also for windows cut off by the border of the image.
    Smear widens the Gaussian along its direction, so each axis has its own width. If the offset exceeds half a pixel,
    the window is moved and measured again; so it does not matter which of two equal pixels was taken as the brightest.

    For a faint star the outer pixels of the window contribute more noise than light. The 3 × 3 pixels around its middle
    are used instead if their corrected moment is more accurate and star images are not wider than σ = 1.1 px (a wider
    one may be a short streak, whose middle pixels do not determine its position).

    The covariance follows from photon and background noise in the moments, times the slope of the correction, plus a
    floor of 0.005 px and, for a star with neighbours, the largest shift that their light in its window can cause. A
    saturated star is measured without correction in a window enlarged by its radius, with 0.05 px and a quarter of the
    difference of its two widths (bleeding) added to its error.

    Images smeared by 3 to 5 px are not Gaussian and do not fit into a window of five pixels: errors are up to twice the
    stated ones. The centroiders that fit the star image do not have this limitation.

    Parameters
    ----------
    image : array, shape (H, W)
        DN.
    background : Background
        Level and noise, of the same shape.
    spots : Spots
        Candidates.
    settings : CentroidSettings
        Window, correction and width; if the width is None it is measured in the frame (`measure_psf_sigma`).
    gain_e_per_dn : float, optional
        Conversion for the photon noise; None: the background's noise is assumed to be the photon noise of its level.

    Returns
    -------
    Centroids
        Brightest first. A candidate with a pixel in its window that is not finite gets its `weighted_moment`, which
        ignores such pixels. Candidates without a positive signal, or whose moment no star in the window can have, are
        dropped.

    Raises
    ------
    InputError
        Window not odd or below 3, width or gain not positive, shapes that differ.
    """
    frame = prepare(image, background, settings, gain_e_per_dn)
    if not len(spots):
        return Centroids.none()
    table, sigmas = measure_moments(frame, spots)
    if frame.settings.bias_correction and frame.half > 1 and max(sigmas) < _WIDEST_FOR_3_PX:
        closer, _ = measure_moments(frame._replace(half=1), spots)
        better = (closer[:, 3:5].sum(axis=1) < table[:, 3:5].sum(axis=1)) & ~spots.saturated
        table[better] = closer[better]
    lost = np.flatnonzero(~np.isfinite(table[:, 0]))
    if _any_gap(frame.pixels.image, spots.x_peak[lost], spots.y_peak[lost], frame.half):
        table[lost] = weighted_table(frame, spots, table, sigmas)[0][lost]
    return collect(table, sigmas, spots, frame.half)


def _any_gap(image: Image, xs: IntArray, ys: IntArray, half: int) -> bool:
    """Whether one of the windows has pixels that are not finite, but fewer than half of them."""
    for x, y in zip(xs, ys, strict=True):
        gaps = ~np.isfinite(image[max(y - half, 0) : y + half + 1, max(x - half, 0) : x + half + 1])
        if 0 < 2 * np.count_nonzero(gaps) < gaps.size:
            return True
    return False
