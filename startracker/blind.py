"""Solve photographs whose focal length is roughly known or unknown; the camera is fitted together with the attitude."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from startracker import centroid as centroiding
from startracker import detection as detecting
from startracker.arguments import ABOVE_0, real_array, real_number, whole_number
from startracker.catalog import as_catalog
from startracker.catalog.stars import StarCatalog
from startracker.core import FloatArray, IntArray
from startracker.detection.background import Light
from startracker.errors import InputError
from startracker.explain import attitude_steps, catalogue_step, hints, listed_step, search_step
from startracker.free_search import FreeSearch
from startracker.front_end import Clock, find_stars
from startracker.geometry.camera import Camera, as_camera
from startracker.identification.unknown_scale.free_scale import FOV_BANDS_DEG
from startracker.inputs import GivenImage, given_image, usable_centroids
from startracker.observer import Observer
from startracker.settings import CentroidSettings, DetectionSettings, IdentificationSettings
from startracker.settings.checks import BELOW_1, settings_or_default
from startracker.settings.registry import lookup
from startracker.solution import Solution
from startracker.trace import Step, Steps, Trace


def solve_unknown_fov(
    source: ArrayLike,
    width: int | None = None,
    height: int | None = None,
    *,
    flux: ArrayLike | None = None,
    fov_deg: float | None = None,
    fov_error: float = 0.05,
    parity: int | None = None,
    camera: Camera | None = None,
    variance_px2: ArrayLike | None = None,
    catalog: str | StarCatalog = "hipparcos",
    detector: str = "components",
    centroider: str = "moment",
    detection: DetectionSettings | None = None,
    centroid: CentroidSettings | None = None,
    identification: IdentificationSettings | None = None,
    observer: Observer | None = None,
    saturation_dn: float | None = None,
    gain_e_per_dn: float | None = None,
) -> Solution:
    """Attitude, focal length, radial distortion and parity from a photograph of the sky.

    Parameters
    ----------
    source : array_like
        An image (H, W), or an object that has one, as in `StarTracker.solve`; or, if `width` and `height` are given,
        centroids (N, 2) in pixels.
    width, height : int, optional
        Size of the image from which the centroids were measured.
    flux : array_like, shape (N,), optional
        Signal of the centroids; if omitted they are assumed to be sorted by brightness.
    fov_deg : float or astropy Quantity, optional
        Approximate field of view across the width; None: 3° to 72° is searched.
    fov_error : float
        Maximum relative error of `fov_deg`.
    parity : int, optional
        +1 direct, −1 mirrored; None: both are tried.
    camera : Camera, optional
        Approximate projection, distortion, focal length (to `fov_error`) and parity, instead of `fov_deg` and `parity`.
        Needed for a fisheye of 100° and more.
    variance_px2 : array_like, shape (N,), optional
        Variance of the given centroids on one axis, for the final fit; for an image it is measured.
    catalog, detector, centroider, detection, centroid, identification
        As for `StarTracker`.
    observer : Observer, optional
        As for `StarTracker.solve`.
    saturation_dn, gain_e_per_dn : float, optional
        Properties of the detector, if known.

    Returns
    -------
    Solution
        With the fitted `camera`, `fov_deg` and `parity`. An image that cannot be solved does not raise.

    Raises
    ------
    InputError
        For an unknown name or an invalid field of view, parity or size.
    """
    fov_deg = None if fov_deg is None else real_number("fov_deg", fov_deg, unit="deg", finite=False)
    camera = None if camera is None else as_camera("camera", camera)
    _check_arguments(fov_deg, fov_error, parity, camera)
    clock = Clock()
    given = given_image(source, observer, None, saturation_dn, gain_e_per_dn)
    if width is None and height is None:
        points = _points_of_image(given, detector, centroider, detection, centroid, clock)
    else:
        points = _points_of_list(given.image, flux, variance_px2, width, height)
    if isinstance(points, Solution):
        return points
    if camera is not None and (camera.width, camera.height) != points[:2]:
        raise InputError(f"the camera has {camera.width}×{camera.height} pixels, the image {points[0]}×{points[1]}")
    search = FreeSearch(
        points.xy,
        points.flux,
        points.width,
        points.height,
        catalog if isinstance(catalog, str) else as_catalog(catalog),
        settings_or_default("identification", identification, IdentificationSettings),
        given.observer,
        variance_px2=points.variance_px2,
        rough=camera,
        light=points.light,
    )
    if camera is not None:
        parity, fov_deg = parity or camera.parity, camera.undistorted_fov_deg
    bands, sides = _bands(fov_deg, fov_error), (1, -1) if parity is None else (parity,)
    solution = search.run(bands, sides)
    clock.lap("identification")
    advice = hints(
        solution.status,
        len(points.xy),
        known_camera=False,
        fov_known=fov_deg is not None,
        saturated=points.saturated,
        settings=points.detection,
    )
    stars = as_catalog(catalog).provenance
    tried = search_step(search.trials, bands, sides), Step("identification", solution.reason)
    searched = catalogue_step(stars), *tried
    steps = (*points.steps, *searched, *attitude_steps(solution), *advice)
    return replace(solution, times_ms=clock.times_ms(), steps=steps, catalog=stars)


class _Points(NamedTuple):
    """Centroids of one image, brightest first."""

    width: int
    height: int
    """Size of the image, pixels."""
    xy: FloatArray
    flux: FloatArray | None
    variance_px2: FloatArray | None
    steps: Sequence[Step]
    saturated: int = 0
    """Number of saturated stars."""
    detection: DetectionSettings | None = None
    """Settings with which they were detected; None for a list of centroids."""
    light: Light | None = None
    """The image; None for a list of centroids."""


def _points_of_image(
    given: GivenImage,
    detector: str,
    centroider: str,
    detection: DetectionSettings | None,
    centroid: CentroidSettings | None,
    clock: Clock,
) -> _Points | Solution:
    """Centroids of an image, or a solution with the reason why it cannot be used."""
    settings = settings_or_default("detection", detection, DetectionSettings)
    trace: Trace = []
    found = find_stars(
        given,
        lookup("detectors", detecting.METHODS, detector),
        lookup("centroiders", centroiding.METHODS, centroider),
        settings,
        settings_or_default("centroid", centroid, CentroidSettings),
        clock,
        trace=trace,
    )
    if found.status is not None:
        trace.append(partial(hints, found.status, 0, known_camera=False))
        return Solution(found.status, found.reason, times_ms=clock.times_ms(), steps=Steps(*trace))
    rows, columns = np.shape(given.image)
    xy, flux, variance = found.stars[:3]
    light, steps = found.stars.light, Steps(*trace)
    return _Points(columns, rows, xy, flux, variance, steps, found.saturated, settings, light)


def _check_arguments(fov_deg: float | None, fov_error: float, parity: int | None, camera: Camera | None) -> None:
    """Raise an InputError for an invalid field of view or parity."""
    if fov_deg is not None and not 0.5 <= fov_deg <= 120.0:
        raise InputError(f"a field of view must be between 0.5° and 120° here; got {fov_deg}°")
    real_number("fov_error", fov_error, least=ABOVE_0, most=BELOW_1)
    if parity is not None and whole_number("parity", parity) not in (None, 1, -1):
        raise InputError(f"parity must be 1, -1 or None; got {parity}")
    if camera is not None and fov_deg is not None:
        raise InputError("give a rough camera or a field of view, not both: the camera has its own")


def _points_of_list(
    source: ArrayLike, flux: ArrayLike | None, variance_px2: ArrayLike | None, width: int | None, height: int | None
) -> _Points:
    """Centroids of a given list, cleaned."""
    if width is None or height is None:
        raise InputError("centroids need both the width and the height of their image")
    width, height = whole_number("width", width), whole_number("height", height)
    if width < 1 or height < 1:
        raise InputError(f"an image needs a size in pixels; got {width}×{height}")
    xy, signal, rows = usable_centroids(source, flux, width, height)
    variance = None if variance_px2 is None else _variance_of(rows, np.size(source) // 2, variance_px2)
    return _Points(width, height, xy, signal, variance, (listed_step(np.size(source) // 2, xy, signal),))


def _variance_of(rows: IntArray, given: int, variance_px2: ArrayLike) -> FloatArray:
    """Variances of the usable centroids `rows` of those given."""
    variance = real_array("variance_px2", variance_px2, finite=False).reshape(-1)
    if len(variance) != given:
        raise InputError(f"there are {given} centroids, but {len(variance)} variances")
    if not (np.isfinite(variance) & (variance > 0.0)).all():
        raise InputError("the variances of centroids must be positive numbers (px²)")
    return variance[rows]


def _bands(fov_deg: float | None, fov_error: float) -> tuple[tuple[float, float, float], ...]:
    """Minimum, nominal and maximum field of view of each search, degrees."""
    if fov_deg is None:
        return FOV_BANDS_DEG
    return ((fov_deg * (1.0 - fov_error), fov_deg, fov_deg * (1.0 + fov_error)),)
