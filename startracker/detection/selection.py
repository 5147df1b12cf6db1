"""Which objects are star candidates: size, shape, sharpness, surroundings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from startracker.detection.background import Background
from startracker.detection.classify import FAINTER, REASONS, STAR, Criteria, classify_sources
from startracker.detection.forms import centres
from startracker.detection.matched import quantiles
from startracker.detection.plane import sample_plane
from startracker.detection.scan import UNFILTERED
from startracker.detection.sources import Searched, Sources, is_saturated
from startracker.detection.spots import Spots
from startracker.detection.thresholds import QUIET_QUANTILE
from startracker.detection.values import Image
from startracker.settings import DetectionSettings

__all__ = ["FAINTER", "select_spots"]

_QUIET_STEP_PX = 16


def select_spots(
    table: Sources,
    settings: DetectionSettings,
    saturation_known: bool,
    image: Image,
    background: Background,
    half: NDArray[np.float32] | None = None,
    excess: float = 1.0,
) -> Spots:
    """Candidates out of a table of objects: those that a star can be, the brightest first.

    Parameters
    ----------
    table : array, shape (N,)
        Of `startracker.detection.sources`, brightest first (`startracker.detection.forms.brightest_first`).
    settings : DetectionSettings
        Limits.
    saturation_known : bool
        Where it is not, a flat top at the highest value of all objects is taken for saturation.
    image, background
        What the objects were found in.
    half, excess : array and float, optional
        The matched filter (`startracker.detection.scan`), where one was used, and how far the noise after it exceeds
        the background's.

    Returns
    -------
    Spots
        With the number of objects left out by reason; those that were not examined (`classify_sources`) count as
        "fainter than the brightest".
    """
    if not len(table):
        return Spots.none()
    searched = Searched(image, background.level_plane, background.noise_plane, UNFILTERED if half is None else half)
    quiet = 0.0
    if settings.isolation > 0.0:
        # where there are branches, the noise of the tiles is theirs
        noise = sample_plane(background.noise_plane, _QUIET_STEP_PX, _QUIET_STEP_PX)
        quiet = excess * settings.threshold_sigma * quantiles(noise, (QUIET_QUANTILE,))[0]
    criteria = Criteria(
        settings.min_pixels if half is None else 1,
        settings.max_pixels,
        float(settings.max_axis_ratio),
        settings.reject_hits,
        quiet,
        float(settings.isolation),
        max(settings.max_stars, 0),
    )
    saturated = is_saturated(table, saturation_known)
    kind = classify_sources(table, saturated, searched, criteria)
    counts = np.bincount(kind, minlength=len(REASONS) + 1)[1:].tolist()
    rejected = {reason: count for reason, count in zip(REASONS, counts, strict=True) if count}
    chosen = (kind == STAR).nonzero()[0]
    stars = table.take(chosen)
    return Spots(
        stars["x_peak"].copy(),
        stars["y_peak"].copy(),
        stars["flux"].copy(),
        stars["pixels"].copy(),
        saturated[chosen],
        stars["edge"].copy(),
        centres(stars),
        np.zeros((len(stars), 2)),
        rejected,
    )
