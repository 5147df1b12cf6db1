"""Solving photographs whose focal length is known roughly or not at all; the camera is fitted along."""

from __future__ import annotations

import contextlib
import functools
import math
import os
import tempfile
import time
import zipfile

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker import centroid as centroiding
from startracker import detection as detecting
from startracker.attitude import Attitude
from startracker.camera import Camera
from startracker.catalog import cache, load_catalog
from startracker.catalog.guide import GuideDatabase
from startracker.errors import InputError
from startracker.identification import free_scale
from startracker.identification.free_scale import FOV_BANDS_DEG, FreeFit
from startracker.identification.quads import QuadIndex, build_quads
from startracker.observer import Observer
from startracker.registry import lookup
from startracker.settings import CentroidSettings, DetectionSettings, IdentificationSettings
from startracker.solution import MatchedStars, Solution, Status

__all__ = ["solve_unknown_fov"]

FloatArray = NDArray[np.float64]

_MAGNITUDE_LIMIT = 9.0
_REFERENCE = Camera.from_fov(4.0, 1024, 1024)  # the finest: doubles closer than 28″ are one
_CACHE_KEY = "quads-1"


def solve_unknown_fov(
    source: ArrayLike,
    width: int | None = None,
    height: int | None = None,
    *,
    flux: ArrayLike | None = None,
    fov_deg: float | None = None,
    fov_error: float = 0.05,
    parity: int | None = None,
    catalog: str = "hipparcos",
    detector: str = "components",
    centroider: str = "moment",
    detection: DetectionSettings | None = None,
    centroid: CentroidSettings | None = None,
    identification: IdentificationSettings | None = None,
    observer: Observer | None = None,
    saturation_dn: float | None = None,
    gain_e_per_dn: float | None = None,
) -> Solution:
    """Attitude, focal length, radial distortion and parity of a photograph of the sky.

    Parameters
    ----------
    source : array_like
        An image (H, W); or, with `width` and `height` given, centroids (N, 2) in pixels.
    width, height : int, optional
        Size of the image that the centroids are from.
    flux : array_like, shape (N,), optional
        Signal of the centroids; without it their order counts as the order of brightness.
    fov_deg : float, optional
        Field across the width as far as it is known; None: anything from 3° to 72°.
    fov_error : float
        Relative error of `fov_deg`, at most.
    parity : int, optional
        +1 as seen, −1 mirrored; None: both are tried.
    catalog, detector, centroider, detection, centroid, identification
        As for `StarTracker`.
    observer : Observer, optional
        As for `StarTracker.solve`.
    saturation_dn, gain_e_per_dn : float, optional
        Of the detector, where known.

    Returns
    -------
    Solution
        With the fitted `camera`; `fov_deg` and `parity` are the measured ones. Never raises for what the image shows.

    Raises
    ------
    InputError
        For an unknown name, a field of view, parity or size that cannot be.
    """
    start = time.perf_counter()
    if fov_deg is not None and not 0.5 <= fov_deg <= 120.0:
        raise InputError(f"a field of view must be between 0.5° and 120° here; got {fov_deg}°")
    if not 0.0 < fov_error < 1.0:
        raise InputError(f"fov_error must be a relative error between 0 and 1; got {fov_error}")
    if parity not in (None, 1, -1):
        raise InputError(f"parity must be 1, -1 or None; got {parity}")
    times: dict[str, float] = {}
    if (width is None) != (height is None):
        raise InputError("centroids need both the width and the height of their image")
    if width is None or height is None:
        from startracker.tracker import find_stars

        stars, failed = find_stars(
            source,
            lookup("detectors", detecting.METHODS, detector),
            lookup("centroiders", centroiding.METHODS, centroider),
            detection or DetectionSettings(),
            centroid or CentroidSettings(),
            saturation_dn,
            gain_e_per_dn,
        )
        times.update(stars.times_ms)
        if failed is not None:
            return failed
        xy, signal = stars.xy, stars.flux
        height, width = np.shape(source)
    else:
        from startracker.tracker import clean_centroids

        if not (width > 0 and height > 0):
            raise InputError(f"an image needs a size; got {width}×{height}")
        xy, signal = clean_centroids(source, flux, Camera.from_fov(10.0, int(width), int(height)))
    begun = time.perf_counter()
    settings = identification or IdentificationSettings()
    solution = _identify(xy, signal, int(width), int(height), fov_deg, fov_error, parity, catalog, settings, observer)
    times["identification"] = (time.perf_counter() - begun) * 1e3
    times["total"] = (time.perf_counter() - start) * 1e3
    solution.times_ms.update(times)
    return solution


def _identify(
    xy: FloatArray,
    flux: FloatArray | None,
    width: int,
    height: int,
    fov_deg: float | None,
    fov_error: float,
    parity: int | None,
    catalog: str,
    settings: IdentificationSettings,
    observer: Observer | None,
) -> Solution:
    needed = free_scale.FEWEST_MATCHED
    if len(xy) < needed:
        status = Status.TOO_FEW_STARS if len(xy) else Status.NO_STARS
        reason = f"{len(xy)} stars seen, {needed} are needed where the focal length is not known"
        return Solution(status, reason, centroids=xy)
    bands = FOV_BANDS_DEG
    if fov_deg is not None:
        bands = ((fov_deg * (1.0 - fov_error), fov_deg, fov_deg * (1.0 + fov_error)),)
    magnitude = None if flux is None or not np.all(flux > 0) else -2.5 * np.log10(flux)
    index = quad_index(catalog)
    trials = 0
    best: FreeFit | None = None
    limit = math.log(settings.false_alarm_rate)
    for low, middle, high in bands:
        guide = _stars(catalog, len(xy), width, height, middle).seen_by(observer)
        for side in (1, -1) if parity is None else (parity,):
            from dataclasses import replace

            assumed = replace(Camera.from_fov(middle, width, height), parity=side)
            for camera, pattern, centre, extent in free_scale.candidates(
                xy, assumed, index, low / middle, high / middle
            ):
                trials += 1
                fit = _try(camera, pattern, centre, extent, xy, magnitude, guide)
                if fit is None or (best is not None and fit.log_evidence <= best.log_evidence):
                    continue
                best = fit
                if math.log(trials) - best.log_evidence < limit - 7.0:
                    return _answer(best, xy, flux, guide, trials)
    if best is None:
        reason = f"{len(xy)} stars seen; none of {trials} patterns alike in the sky brings {needed} stars to agree"
        return Solution(Status.NO_MATCH, reason, centroids=xy)
    chance = math.log(trials) - best.log_evidence
    if chance < limit:
        return _answer(best, xy, flux, guide, trials)
    status = Status.AMBIGUOUS if chance < 0 else Status.NO_MATCH
    reason = f"best of {trials} patterns explains {len(best.pairs)} of {len(xy)} stars: chance cannot be ruled out"
    return Solution(status, reason, centroids=xy)


def _try(
    camera: Camera,
    pattern: NDArray[np.int64],
    centre: FloatArray,
    extent: float,
    xy: FloatArray,
    magnitude: FloatArray | None,
    guide: GuideDatabase,
) -> FreeFit | None:
    stars, guides = pattern
    sky = quad_directions(guide, guides)
    matrix = free_scale.attitude_of(camera, xy[stars], sky)
    off = camera.project(sky @ matrix.T) - xy[stars]
    if not np.hypot(off[:, 0], off[:, 1]).max() < 2.0 + 0.03 * extent:  # NaN too
        return None
    away = np.hypot(*(xy - centre).T)
    grown = free_scale.grow(camera, matrix, xy, guide, centre, 2.0 + 0.012 * np.maximum(away, extent))
    if grown is None:
        return None
    camera, matrix, covariance, rms, _ = grown
    value, pairs = free_scale.weigh(camera, matrix, xy, magnitude, guide, anchors=4)
    return FreeFit(camera, matrix, pairs, covariance, rms, value) if len(pairs) else None
