"""Which objects are star candidates: size, shape, sharpness, surroundings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from startracker.detection.background import Background
from startracker.detection.classify import REASONS, STAR, Marks, Questions, classify_sources
from startracker.detection.forms import is_halo, measure_forms
from startracker.detection.matched import quantiles
from startracker.detection.plane import sample_plane
from startracker.detection.scan import UNFILTERED
from startracker.detection.sources import Searched, Sources, is_saturated, peak_pixels
from startracker.detection.spots import Spots
from startracker.detection.thresholds import LOOKED_AT, LOOKED_AT_MORE, QUIET_QUANTILE
from startracker.detection.values import Image
from startracker.settings import DetectionSettings

__all__ = ["FAINTER", "select_spots"]

_QUIET_STEP_PX = 16
FAINTER = "fainter than the brightest"


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
        With the number of objects left out by reason. Only the brightest objects, six for each star asked for, are
        examined, 36 where these are too few stars or all as sharp as hot pixels, but for streaks only as many as it
        takes; the rest count as "fainter than the brightest".
    """
    if not len(table):
        return Spots.none()
    searched = Searched(image, background.level_plane, background.noise_plane, UNFILTERED if half is None else half)
    fewest, most, quiet = settings.min_pixels if half is None else 1, max(settings.max_stars, 0), 0.0
    if settings.isolation > 0.0:
        # where there are branches, the noise of the tiles is theirs
        noise = sample_plane(background.noise_plane, _QUIET_STEP_PX, _QUIET_STEP_PX)
        quiet = excess * settings.threshold_sigma * quantiles(noise, (QUIET_QUANTILE,))[0]
    asked = Questions(settings.reject_hits, quiet, settings.isolation, most)
    pixels, saturated = table["pixels"], is_saturated(table, saturation_known)
    small, large = pixels < fewest, pixels > settings.max_pixels
    dark = ~(small | large | (table["flux"] > 0.0))
    possible = np.flatnonzero(~(small | large | dark))
    for looked_at in (LOOKED_AT * most, LOOKED_AT_MORE * most):
        index = possible[:looked_at]
        objects = table.take(index)
        forms = measure_forms(objects, settings.max_axis_ratio)
        marks = Marks(saturated[index], is_halo(objects), forms.long)
        kind, told = classify_sources(objects, marks, searched, asked)
        chosen = np.flatnonzero(kind == STAR)
        if len(objects) < looked_at or ((told or not settings.reject_hits) and len(chosen) == most):
            break
    left_out = [int(np.count_nonzero(which)) for which in (small, large & ~small, dark)]
    counts = [*left_out, len(possible) - len(index), *np.bincount(kind, minlength=len(REASONS) + 1)[1:].tolist()]
    rejected: dict[str, int] = {}
    for reason, number in zip(("too small", "too large", "without signal", FAINTER, *REASONS), counts, strict=True):
        if number > 0:
            rejected[reason] = rejected.get(reason, 0) + number
    stars = objects.take(chosen)
    x, y = peak_pixels(stars)
    flux, pixels = (np.ascontiguousarray(stars[name]) for name in ("flux", "pixels"))
    streak = np.zeros((len(chosen), 2))
    return Spots(
        x, y, flux, pixels, marks.saturated[chosen], stars["edge"].copy(), forms.centre[chosen], streak, rejected
    )
