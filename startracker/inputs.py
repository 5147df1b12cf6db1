"""Images and lists of star positions from users, checked and converted to arrays of one type."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker._compiled import kernel
from startracker.arguments import real_array, real_number, switch
from startracker.core import FloatArray, IntArray
from startracker.detection.artefacts import mask_extremes
from startracker.detection.values import Image, as_pixels, whole_range
from startracker.display import fields_repr
from startracker.errors import InputError
from startracker.observer import Observer, observer_of
from startracker.sorting import order_of_columns

STATED_PRIOR_DEG = 1.0
"""Largest error, degrees, of a prior that is given without one."""


class GivenImage(NamedTuple):
    """An image and its known properties; None for those that are unknown.

    Parameters
    ----------
    image : array_like, shape (H, W)
        Pixels as given, not yet checked.
    observer : Observer, optional
        Epoch, position and velocity at mid-exposure.
    saturation_dn, gain_e_per_dn : float, optional
        Properties of the detector.
    exposure_s : float, optional
        Exposure time.
    """

    image: Any
    observer: Observer | None = None
    saturation_dn: float | None = None
    gain_e_per_dn: float | None = None
    exposure_s: float | None = None


def given_image(
    image: Any,
    observer: Observer | None = None,
    time: Any = None,
    saturation_dn: float | None = None,
    gain_e_per_dn: float | None = None,
) -> GivenImage:
    """Image with the properties of its own attributes; arguments take precedence over these.

    Parameters
    ----------
    image : array_like, or an object with the attribute `image`
        If it is an object, its attributes `observer`, `saturation_dn`, `gain_e_per_dn` and `exposure_s` are read if it
        has them, such as a frame of the simulator or `startracker.LoadedImage`.
    observer, time, saturation_dn, gain_e_per_dn
        As in `StarTracker.solve`.

    Raises
    ------
    InputError
        For an observer of another type, both an observer and a time, or a saturation or gain that is not a number.
    """
    observer = observer_of(observer, time)
    exposure_s = None
    if hasattr(image, "image") and not isinstance(image, np.ndarray):
        observer = getattr(image, "observer", None) if observer is None else observer
        saturation_dn = getattr(image, "saturation_dn", None) if saturation_dn is None else saturation_dn
        gain_e_per_dn = getattr(image, "gain_e_per_dn", None) if gain_e_per_dn is None else gain_e_per_dn
        image, exposure_s = image.image, getattr(image, "exposure_s", None)
    if saturation_dn is not None:
        saturation_dn = real_number("saturation_dn", saturation_dn, finite=False)
    if gain_e_per_dn is not None:
        gain_e_per_dn = real_number("gain_e_per_dn", gain_e_per_dn, finite=False)
    return GivenImage(image, observer, saturation_dn, gain_e_per_dn, exposure_s)


def prior_of(image: Any, prior: Any, prior_deg: Any, lost_in_space: bool = False) -> tuple[Any, Any]:
    """Prior attitude and its largest error, degrees: those given, or else those of the image's attributes.

    Raises
    ------
    InputError
        For a prior that is given although the image is to be solved lost in space.
    """
    if switch("lost_in_space", lost_in_space):
        if prior is not None:
            raise InputError("prior and lost_in_space=True exclude each other; omit one of them")
        return None, STATED_PRIOR_DEG
    if prior is None and not isinstance(image, np.ndarray):
        prior = getattr(image, "prior", None)
        prior_deg = getattr(image, "prior_deg", None) if prior_deg is None else prior_deg
    return prior, STATED_PRIOR_DEG if prior_deg is None else prior_deg


SATURATED_SHARE = 0.05
"""Fraction of saturated pixels above which an unsolved image gets the status `saturated`."""


def plain(values: ArrayLike) -> NDArray[Any]:
    """A masked array (`numpy.ma`) with NaN in its masked elements; anything else unchanged.

    Raises
    ------
    InputError
        For rows of different lengths.
    """
    if not isinstance(values, np.ma.MaskedArray):
        try:
            return np.asarray(values)
        except ValueError as error:
            raise InputError(f"not an array of numbers: {' '.join(str(error).split())}") from None
    if values.dtype.kind not in "buif" or not np.ma.is_masked(values):
        return np.asarray(values.data)
    kind = np.float64 if values.dtype.itemsize > 2 else np.float32  # which represent every value exactly
    return np.asarray(np.ma.filled(values.astype(kind), np.nan))


@dataclass(frozen=True, eq=False)
class CheckedImage:
    """A usable image.

    Its pixels are uint16 or float32, with NaN where they are not finite or where light cannot cause the value; `masked`
    is the number of the latter. Also its range, the saturated fraction and the saturation level, DN, and whether it
    contains NaN (`gaps`).
    """

    pixels: Image
    lowest: float
    highest: float
    saturated_share: float
    saturation_dn: float
    masked: int = 0
    gaps: bool = False

    __repr__ = fields_repr


def shape_fault(given: tuple[int, ...], shape: tuple[int, int] | None) -> str:
    """Reason why an image of a shape is not one of a camera of `shape`, (rows, columns); empty if it is."""
    if len(given) != 2:
        return f"an image must have two dimensions (rows, columns); got {given}"
    if shape is not None and given != shape:
        size = f"the image is {given[1]}×{given[0]} pixels, the camera {shape[1]}×{shape[0]}"
        return f"{size}: give the camera that took it"
    return ""


def check_image(
    image: ArrayLike, shape: tuple[int, int] | None, saturation_dn: float | None
) -> tuple[CheckedImage | None, str]:
    """Check an image; returns None and the reason if it cannot be used.

    The saturation level is the given one, or the largest value of an unsigned type, or the image's maximum.
    """
    try:
        as_given = np.asanyarray(image)
        given = plain(as_given)
        if given.dtype.kind not in "buif":
            return None, f"an image needs real numbers; got {given.dtype}"
    except (TypeError, ValueError):
        return None, "an image must be an array of numbers"
    if fault := shape_fault(given.shape, shape):
        return None, fault
    pixels = as_pixels(given)
    if not given.size:
        return None, "no pixel of the image is a finite number"
    level = saturation_dn
    if level is None and as_given.dtype.kind == "u":
        level = float(np.iinfo(as_given.dtype).max)
    if pixels.dtype.kind == "u" and level is not None:  # always finite, and their range takes a quarter of the time
        lowest, highest, full = whole_range(pixels, math.ceil(max(min(2.0**16, level), 0.0)))
        return CheckedImage(pixels, float(lowest), float(highest), full / pixels.size, level), ""
    plane = given if given.dtype.kind in "ui" else pixels
    lowest, highest = float(np.float32(plane.min())), float(np.float32(plane.max()))
    gaps = not (math.isfinite(lowest) and math.isfinite(highest))  # NaN makes both NaN
    if gaps:
        pixels = np.where(np.isfinite(pixels), pixels, np.float32(np.nan))
        lowest, highest = float(np.fmin.reduce(pixels, axis=None)), float(np.fmax.reduce(pixels, axis=None))
        if not math.isfinite(highest):
            return None, "no pixel of the image is a finite number"
    pixels, masked = mask_extremes(pixels, lowest, highest)
    if masked:
        lowest, highest = float(np.fmin.reduce(pixels, axis=None)), float(np.fmax.reduce(pixels, axis=None))
    if level is None:
        level = highest if highest > 0 else math.inf
    full = int(np.count_nonzero(pixels >= level)) if highest >= level else 0
    return CheckedImage(pixels, lowest, highest, full / pixels.size, level, masked, gaps or masked > 0), ""


_LATTICE = 32
"""Samples of an image along each axis, about a thousand, of which an explanation is made."""


def lattice_steps(shape: tuple[int, ...]) -> tuple[int, int]:
    """Rows and columns from one sample of an image to the next."""
    return max(1, shape[0] // _LATTICE), max(1, shape[1] // _LATTICE)


def image_sample(image: NDArray[Any]) -> NDArray[Any]:
    """Copy of the values on a lattice, for an explanation that is read after the caller has changed the image."""
    rows, columns = lattice_steps(image.shape)
    # The samples are the centres of the lattice's cells, away from the border.
    return image[rows // 2 :: rows, columns // 2 :: columns].flatten()


def saturation_message(share: float, level: float) -> str:
    """Reason text for a saturated image."""
    return f"{100 * share:.0f} % of the pixels are at or above {level:g}: saturated; shorten the exposure"


SAME_STAR_PX = 0.75
"""Distance, px, below which two centroids are the same star detected twice."""
_NO_FLUX = np.empty(0)


def usable_centroids(
    xy: ArrayLike, flux: ArrayLike | None, width: int, height: int
) -> tuple[FloatArray, FloatArray | None, IntArray]:
    """Usable centroids (M, 2), brightest first, their flux, and their indices in the list.

    Usable are finite positions on an image of this size, without duplicates. A star whose flux is not a positive number
    counts as the faintest.
    """
    try:
        points = np.array(real_array("centroids", plain(xy), finite=False), order="C")
        signal = _NO_FLUX if flux is None else real_array("fluxes", plain(flux), finite=False).reshape(-1)
    except (TypeError, ValueError):  # an InputError is one, and says less
        raise InputError("centroids and fluxes must be numbers: xy with the shape (N, 2), flux with (N,)") from None
    if points.size == 0:
        points = points.reshape(0, 2)
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError(f"centroids must have the shape (N, 2), columns x and y; got {points.shape}")
    if flux is not None and len(signal) != len(points):
        raise InputError(f"there are {len(points)} centroids, but {len(signal)} fluxes")
    usable, brightness, rows = _usable(points, signal, width, height)
    known = flux is not None and len(brightness) == len(rows)
    return usable, brightness if known else None, rows


def stated_variance(sigma_px: ArrayLike | None, given: int, rows: IntArray) -> FloatArray | None:
    """Variance (M,), px², of the usable centroids; None if no standard errors are stated.

    `sigma_px` holds one standard error per given centroid, or one for all; `rows` (M,) are the indices of the usable
    ones.

    Raises
    ------
    InputError
        For a shape that does not fit, or an error that is not positive and finite.
    """
    if sigma_px is None:
        return None
    sigma = real_array("sigma_px, the standard error of each centroid on one axis,", sigma_px, finite=False)
    if sigma.shape not in ((), (given,)):
        raise InputError(f"there are {given} centroids, but sigma_px has the shape {sigma.shape}")
    if sigma.size and not (sigma.min() > 0.0 and sigma.max() < math.inf):  # NaN, too
        raise InputError("sigma_px must be positive and finite, pixels")
    chosen: FloatArray = sigma[rows] if sigma.ndim else np.full(len(rows), sigma)
    return chosen * chosen


@kernel
def _usable(points: FloatArray, flux: FloatArray, width: int, height: int) -> tuple[FloatArray, FloatArray, IntArray]:
    """Usable points (M, 2) of all (N, 2), their flux, and their indices; see `usable_centroids`.

    They are on the image as in `Camera.contains`, brightest first, without duplicates. The flux is empty if none is
    positive.
    """
    rows, count, faintest = np.empty(len(points), np.int64), 0, math.inf
    for n in range(len(points)):
        x, y = points[n, 0], points[n, 1]
        if -0.5 <= x < width - 0.5 and -0.5 <= y < height - 0.5:
            rows[count] = n
            count += 1
            if len(flux) > 0 and flux[n] > 0.0:
                faintest = min(faintest, flux[n])
    sorts, keys = faintest < math.inf, np.empty((3, count))
    for k in range(count):
        value = flux[rows[k]] if sorts else 0.0
        # Stars without a positive flux are sorted behind all others, at half the faintest flux.
        keys[0, k] = -value if 0.0 < value < math.inf else -0.5 * faintest
        keys[1, k], keys[2, k] = points[rows[k], 1], points[rows[k], 0]
    # Ties are ordered by position, so that the order of the input does not matter.
    order, xy = order_of_columns(keys) if sorts else np.arange(count), np.empty((count, 2))
    for k in range(count):
        xy[k, 0], xy[k, 1] = keys[2, order[k]], keys[1, order[k]]
    alone, signal, chosen, left = _first_of_each(xy), np.empty(count), np.empty(count, np.int64), 0
    for k in range(count):
        if alone[k]:
            xy[left, 0], xy[left, 1] = xy[k, 0], xy[k, 1]
            signal[left], chosen[left] = -keys[0, order[k]], rows[order[k]]
            left += 1
    return xy[:left], signal[: left if sorts else 0], chosen[:left]


@kernel
def _first_of_each(points: FloatArray) -> NDArray[np.bool_]:
    """Mask (N,) of points without an earlier point within `SAME_STAR_PX` on both axes."""
    alone, x = np.ones(len(points), np.bool_), np.empty((1, len(points)))
    for n in range(len(points)):
        x[0, n] = points[n, 0]
    order = order_of_columns(x)
    for first in range(len(points)):  # sorted by x, so that neighbours in x follow
        i = order[first]
        for second in range(first + 1, len(points)):
            j = order[second]
            if points[j, 0] - points[i, 0] >= SAME_STAR_PX:
                break
            if abs(points[i, 1] - points[j, 1]) < SAME_STAR_PX:
                alone[max(i, j)] = False
    return alone
