"""First moment over a small window, freed of its bias (Greyling 1995, section 4.3)."""

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
    """Centroids by the first moment of the signal over a window about the brightest pixel.

    The moment of a truncated window falls short of the offset (Greyling 1995, Table 4.1). For a star image that is a
    Gaussian integrated over pixels the shortfall along x depends on x alone, and is undone exactly, axis by axis, by
    solving m(d) = m for the offset d (see `startracker.centroid.bias`), windows cut off by the image's border included.
    Smear widens the Gaussian along its axis: widths are per axis. When the offset exceeds half a pixel the window is
    moved and measured again, so that it does not matter which of two equal pixels was taken for the brightest.

    Of a faint star the outer pixels of the window bring more noise than light: the 3 × 3 about its middle are taken
    where the corrected moment of these is the more certain one and star images are not wider than σ = 1.1 px (a wider
    one may be a short streak, whose middle pixels do not determine its position).

    The covariance is that of the moments under photon and background noise, times the slope of the correction, plus
    a floor of 0.005 px and, for a star with neighbours, the shift their light in its window can cause at most. A
    saturated star is measured over a window grown by its radius, uncorrected, with 0.05 px and a quarter of the
    difference of its two widths (bleeding) added.

    Images smeared by 3 to 5 px are not Gaussian, and a window of five pixels does not hold them: errors are up to
    twice those stated. The fits of the star image know what they are.

    Parameters
    ----------
    image : array, shape (H, W)
        DN.
    background : Background
        Level and noise, of the same shape.
    spots : Spots
        Candidates.
    settings : CentroidSettings
        Window, correction and width; a width of None is measured from the frame (`measure_psf_sigma`).
    gain_e_per_dn : float, optional
        Conversion for the photon noise; None: the background's noise is taken for the photon noise of its level.

    Returns
    -------
    Centroids
        Brightest first. A candidate with a pixel in the window that is not finite gets its `weighted_moment`, which
        leaves such pixels out. Candidates without a positive signal, or whose moment no star in the window explains,
        are left out.

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
    """Whether a pixel in one of the windows is not finite, though most of that window is."""
    for x, y in zip(xs, ys, strict=True):
        gaps = ~np.isfinite(image[max(y - half, 0) : y + half + 1, max(x - half, 0) : x + half + 1])
        if 0 < 2 * np.count_nonzero(gaps) < gaps.size:
            return True
    return False
