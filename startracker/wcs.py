"""World coordinate system of a solved image: a TAN header, with SIP polynomials for lens distortion.

A fisheye uses FITS' zenithal equidistant projection (ARC) or, if it is equisolid, the equal-area one (ZEA): with r = θ
and r = 2 sin(θ/2) these are the ideal projections, and extend to 90° and beyond.

The tangent point is the boresight at the principal point (FITS counts pixels from 1; here the first pixel's centre is
(0, 0)). The header maps pixels to directions of the attitude's source frame. With the observer's velocity these
directions are apparent ones; aberration is then removed and the header maps to astrometric (catalogue) positions at the
epoch. Aberration by β = v/c is a conformal map that scales angles about a position n by 1/(γ (1 + β·n)) relative to the
catalogue (the square root of the ratio of solid angles); the remaining distortion, ½ β θ² at θ from the tangent point
(0.3″ at 10°, 2.8″ at 30°), is included with the lens distortion in the SIP polynomials.

Source: Calabretta & Greisen 2002, A&A 395, 1077; Shupe et al. 2005, ASP Conf. 347, 491 (SIP); for the aberration of
angles Klioner 2003, AJ 125, 1580, eq. 8, and McKinley 1980, Am. J. Phys. 48, 612.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import lstsq

from startracker.arguments import of_kind, real_array, text
from startracker.core import ARCSEC_RAD, SPEED_OF_LIGHT_KM_S, FloatArray
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude, camera_attitude, matrix_to_quat
from startracker.geometry.camera import Camera
from startracker.observer import aberrate

Rays = Callable[[FloatArray], FloatArray]

_GRID = 31
_WANTED_PX = 0.002
_WORST_PX = 0.05
_ORDERS = (3, 5, 7, 9, 11, 13)
_STANDARD_ORDER = 9
"""Highest order of SIP; astropy reads higher ones, which are used only if 1″ requires them."""
_SIP_TERM = re.compile(r"(A|B|AP|BP)_\d+_(\d+)")
_CODES = {"pinhole": "TAN", "fisheye": "ARC", "equidistant": "ARC", "equisolid": "ZEA"}


def wcs_header(
    camera: Camera,
    attitude: Attitude,
    velocity_km_s: ArrayLike | None = None,
    form: Literal["astrometric", "apparent"] = "astrometric",
    row_order: Literal["TOP-DOWN", "BOTTOM-UP"] = "TOP-DOWN",
) -> dict[str, Any]:
    """FITS header cards of the world coordinate system of an image.

    Parameters
    ----------
    camera : Camera
        With its distortion and parity.
    attitude : Attitude
        ICRS to camera.
    velocity_km_s : array_like, shape (3,), optional
        Barycentric velocity of the observer, ICRS axes, if the attitude refers to apparent directions (a true attitude,
        or one solved with an observer): the header then gives astrometric positions. Omit it for a solution without an
        observer, which refers to catalogue positions already.
    form : {"astrometric", "apparent"}
        What the header gives if the velocity is known: ``astrometric`` catalogue positions, without aberration, or
        ``apparent`` directions as the observer sees them, with it.
    row_order : {"TOP-DOWN", "BOTTOM-UP"}
        Rows of the image that has the header: as the camera counts them, or in reverse, as a FITS file has them whose
        first row is the bottom of the picture.

    Returns
    -------
    dict
        Keyword to value; accepted by ``astropy.io.fits.Header`` and ``astropy.wcs.WCS``.

    Notes
    -----
    With (ξ, η) the tangent-plane coordinates to the east and north and u, v pixels from the principal point,
    (ξ, η) = CD · (u + A(u, v), v + B(u, v)). A and B are fitted to the camera's inverse distortion, the order (3, 5, 7
    or 9) being raised until the maximum error is below 0.002 px; AP and BP are the inverse. If 9, the highest order of
    SIP, is not accurate to 1″, 11 and 13 are tried, which astropy reads and some programs do not. CSYER1 and CSYER2 are
    the maximum error of A and B over the image, degrees, evaluated between the points of the fit. There are no
    polynomials for an ideal lens if aberration distorts the field by less than 0.002 px. WCSNAME is the form if the
    velocity was given; the axes are those of the ICRS in both forms.

    Raises
    ------
    InputError
        If the distortion is so strong that the error of order 13 is above 1″ or 0.05 px, whichever is larger, or that
        part of the image has no direction.
    """
    of_kind("camera", camera, Camera)
    attitude = camera_attitude("attitude", attitude)
    if text("form", form) not in ("astrometric", "apparent"):
        raise InputError(f"form must be astrometric or apparent; got {form!r}")
    if velocity_km_s is not None:
        velocity_km_s = real_array("velocity_km_s", velocity_km_s, (3,), unit="km/s")
    scale: float = 1.0
    rays: Rays | None = None
    if velocity_km_s is not None and form == "astrometric":
        apparent, velocity = attitude, np.asarray(velocity_km_s, dtype=float)
        attitude, scale = _catalogued(apparent, velocity)
        turn = attitude.as_matrix() @ apparent.as_matrix().T
        rays = functools.partial(_still, turn=turn, velocity_km_s=apparent.as_matrix() @ velocity)
    matrix = attitude.as_matrix()
    ra, dec = math.radians(attitude.ra_deg), math.radians(attitude.dec_deg)
    east = np.array([-math.sin(ra), math.cos(ra), 0.0])
    north = np.array([-math.sin(dec) * math.cos(ra), -math.sin(dec) * math.sin(ra), math.cos(dec)])
    axes = np.stack([east, north]) @ matrix[:2].T  # camera x and y in the tangent plane
    cd = np.degrees(axes @ np.diag([camera.parity * scale / camera.fx, scale / camera.fy]))
    sip = _sip(camera, rays, scale)
    code = _CODES[camera.projection] + ("" if sip is None else "-SIP")
    header: dict[str, Any] = {
        "WCSAXES": 2,
        "CTYPE1": f"RA---{code}",
        "CTYPE2": f"DEC--{code}",
        "CUNIT1": "deg",
        "CUNIT2": "deg",
        "CRPIX1": camera.cx + 1.0,
        "CRPIX2": camera.cy + 1.0,
        "CRVAL1": attitude.ra_deg,
        "CRVAL2": attitude.dec_deg,
        "CD1_1": float(cd[0, 0]),
        "CD1_2": float(cd[0, 1]),
        "CD2_1": float(cd[1, 0]),
        "CD2_2": float(cd[1, 1]),
        "LONPOLE": 180.0,
        "RADESYS": "ICRS",
    }
    if velocity_km_s is not None:
        header["WCSNAME"] = form
    if sip is not None:
        cards, error_px = sip
        error_deg = math.degrees(error_px * camera.pixel_rad)
        header |= {"CSYER1": error_deg, "CSYER2": error_deg, **cards}
    return _bottom_up(header, camera.height) if row_order == "BOTTOM-UP" else header


def _bottom_up(header: dict[str, Any], height: int) -> dict[str, Any]:
    """The same world coordinates for reversed rows.

    v becomes −v, and with it the sign of those terms of A that are odd in v and of those of B that are even.
    """
    turned = header | {"CRPIX2": height + 1.0 - header["CRPIX2"]}
    turned |= {key: -header[key] for key in ("CD1_2", "CD2_2")}
    for key, value in header.items():
        if match := _SIP_TERM.fullmatch(key):
            odd = int(match[2]) % 2 == 1
            turned[key] = -value if odd == (match[1] in ("A", "AP")) else value
    return turned


def _catalogued(apparent: Attitude, velocity_km_s: FloatArray) -> tuple[Attitude, float]:
    """Attitude whose boresight is the catalogue position of the apparent boresight, and a scale.

    The attitude is rotated by the smallest angle. The scale is the ratio of catalogue to apparent angles, γ (1 + β·n).
    """
    seen = apparent.boresight
    catalogued = aberrate(seen[None, :], -velocity_km_s)[0]
    axis = np.cross(catalogued, seen)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    turn = np.eye(3) + cross + cross @ cross / (1.0 + float(catalogued @ seen))  # rotates catalogued to seen
    beta = velocity_km_s / SPEED_OF_LIGHT_KM_S
    scale = (1.0 + float(beta @ catalogued)) / math.sqrt(1.0 - float(beta @ beta))
    return Attitude(matrix_to_quat(apparent.as_matrix() @ turn)), scale


def _still(vectors: FloatArray, turn: FloatArray, velocity_km_s: FloatArray) -> FloatArray:
    """Catalogue directions (N, 3), in axes of the catalogued attitude, for apparent `vectors` (N, 3) in camera axes."""
    return np.asarray(aberrate(vectors, -velocity_km_s) @ turn.T)


def _sip(camera: Camera, rays: Rays | None, scale: float) -> tuple[dict[str, Any], float] | None:
    """SIP coefficients of distortion and aberration, forward and inverse, and the largest error of the forward ones,
    px.

    None if there is nothing to correct.
    """
    if camera.distortion.is_zero:
        if rays is None:
            return None
        away, ideal = _both_ways(camera, np.linspace(-1.0, 1.0, 9), rays, scale)
        if np.abs(ideal - away).max() < _WANTED_PX:
            return None
    away, ideal = _both_ways(camera, _nodes(_GRID), rays, scale)
    between = _both_ways(camera, np.linspace(-1.0, 1.0, 2 * _GRID), rays, scale)
    # The linear terms stay zero: they are in the CD matrix. Lens polynomials have no second order unless decentred, but
    # SIP orders are complete.
    header: dict[str, Any] = {}
    errors = []
    for names, one, other in (("AB", 0, 1), (("AP", "BP"), 1, 0)):
        points, shift = (away, ideal)[one], (away, ideal)[other] - (away, ideal)[one]
        check, truth = between[one], between[other] - between[one]
        powers, coefficients, error = _fit(points, shift, check, truth, 0.9 * ARCSEC_RAD / camera.pixel_rad)
        errors.append(error)
        for axis, name in enumerate(names):
            header[f"{name}_ORDER"] = int(powers.max())
            for (p, q), value in zip(powers, coefficients[:, axis], strict=True):
                header[f"{name}_{p}_{q}"] = float(value)
    limit = max(_WORST_PX, ARCSEC_RAD / camera.pixel_rad)
    if max(errors) > limit:
        raise InputError(
            f"the error of a WCS of this lens is {max(errors):.3g} px at order {_ORDERS[-1]} (limit {limit:.2g} "
            "px): the distortion is too strong over this field; crop the image or use the camera file itself"
        )
    return header, errors[0]


def _nodes(count: int) -> FloatArray:
    """Chebyshev points from −1 to 1, for a uniform fit error up to the borders."""
    return -np.cos(np.pi * np.arange(count) / (count - 1))


def _both_ways(camera: Camera, steps: FloatArray, rays: Rays | None, scale: float) -> tuple[FloatArray, FloatArray]:
    """Distorted and ideal positions (N, 2) of a grid over the image, px from the principal point.

    An ideal pixel is `scale` times the angle of a camera pixel.
    """
    x, y = (side * (steps + 1.0) / 2.0 - 0.5 for side in (camera.width, camera.height))
    seen = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    vectors = camera.unproject(seen)
    good = np.isfinite(vectors).all(axis=1)
    if not good.all() and camera.projection == "pinhole":
        raise InputError(
            f"{100.0 * float(np.mean(~good)):.2g} % of the image is beyond the fold of the lens model: a WCS needs a "
            "direction for every pixel; crop the image"
        )
    plane = _plane(camera, vectors[good] if rays is None else rays(vectors[good]))
    ideal = plane * np.array([camera.parity * camera.fx, camera.fy]) / scale
    return seen[good] - np.array([camera.cx, camera.cy]), ideal


def _plane(camera: Camera, vectors: FloatArray) -> FloatArray:
    """Points (N, 2) of the ideal projection, in focal lengths."""
    if camera.projection == "pinhole":
        return np.asarray(vectors[:, :2] / vectors[:, 2:])
    side = np.hypot(vectors[:, 0], vectors[:, 1])
    radius = np.arctan2(side, vectors[:, 2])
    if camera.projection == "equisolid":
        radius = 2.0 * np.sin(radius / 2.0)
    return np.asarray(vectors[:, :2] * (radius / np.maximum(side, 1e-300))[:, None])


def _fit(
    points: FloatArray,
    shift: FloatArray,
    check: FloatArray,
    truth: FloatArray,
    enough_px: float,
) -> tuple[NDArray[np.int64], FloatArray, float]:
    """Powers (T, 2), coefficients (T, 2) and largest error of the lowest-order polynomial that is accurate to 0.002 px.

    It is fitted to the shifts at `points` and tested at `check`; orders above those of SIP are used only until
    `enough_px` is reached.
    """
    size = float(np.abs(points).max())
    best: tuple[NDArray[np.int64], FloatArray, float] | None = None
    for order in _ORDERS:
        powers = np.array([(p, q) for p in range(order + 1) for q in range(order + 1 - p) if p + q >= 1])
        # Points are scaled to ±1, which keeps high powers well conditioned, and the coefficients are scaled back.
        solution, *_ = lstsq(_terms(points / size, powers), shift, lapack_driver="gelsy", check_finite=False)
        error = float(np.abs(_terms(check / size, powers) @ solution - truth).max())
        if best is None or error < best[2]:
            best = powers, solution / size ** powers.sum(axis=1)[:, None], error
        if error < _WANTED_PX or (order >= _STANDARD_ORDER and error < enough_px):
            break
    assert best is not None
    return best


def _terms(points: FloatArray, powers: NDArray[np.int64]) -> FloatArray:
    highest = int(powers.max())
    x, y = (np.vander(points[:, axis], highest + 1, increasing=True) for axis in (0, 1))
    return np.asarray(x[:, powers[:, 0]] * y[:, powers[:, 1]])
