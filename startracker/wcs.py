"""World coordinate system of a solved image: a TAN header, with SIP polynomials where the lens distorts.

A fisheye has FITS' zenithal equidistant projection (ARC) in place of the gnomonic one, or, where it is equisolid, the
equal-area one (ZEA): with r = θ and r = 2 sin(θ/2) these are the ideal lenses themselves, and reach 90° and beyond.

The tangent point is the boresight at the principal point (FITS counts pixels from 1 and our first pixel's centre is
(0, 0)). The header maps pixels to the directions the solution's stars were given in: ICRS when the solution took the
aberration off, apparent directions otherwise.

Source: Calabretta & Greisen 2002, A&A 395, 1077; Shupe et al. 2005, ASP Conf. 347, 491 (SIP).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from startracker.attitude import Attitude
from startracker.camera import Camera

__all__ = ["wcs_header"]

FloatArray = NDArray[np.float64]

_GRID = 41
_WANTED_PX = 0.002
_ORDERS = (3, 5, 7, 9)
_CODES = {"pinhole": "TAN", "fisheye": "ARC", "equidistant": "ARC", "equisolid": "ZEA"}


def wcs_header(camera: Camera, attitude: Attitude) -> dict[str, Any]:
    """FITS header cards of the image's world coordinates.

    Parameters
    ----------
    camera : Camera
        With its distortion and parity.
    attitude : Attitude
        ICRS to camera.

    Returns
    -------
    dict
        Keyword to value; ``astropy.io.fits.Header(wcs_header(...))`` and ``astropy.wcs.WCS`` take it as it is.

    Notes
    -----
    With (ξ, η) the tangent-plane coordinates to the east and north and u, v pixels from the principal point,
    (ξ, η) = CD · (u + A(u, v), v + B(u, v)). A and B are fitted to the camera's inverse distortion, the order (3, 5, 7
    or 9) raised until the largest error is below 0.002 px; AP and BP are the way back.
    """
    matrix = attitude.as_matrix()
    ra, dec = math.radians(attitude.ra_deg), math.radians(attitude.dec_deg)
    east = np.array([-math.sin(ra), math.cos(ra), 0.0])
    north = np.array([-math.sin(dec) * math.cos(ra), -math.sin(dec) * math.sin(ra), math.cos(dec)])
    axes = np.stack([east, north]) @ matrix[:2].T  # camera x and y in the tangent plane
    scale = np.diag([camera.parity / camera.fx, 1.0 / camera.fy])
    cd = np.degrees(axes @ scale)
    distorted = not camera.distortion.is_zero
    code = _CODES[camera.projection] + ("-SIP" if distorted else "")
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
    if distorted:
        header.update(_sip(camera))
    return header


def _sip(camera: Camera) -> dict[str, Any]:
    """SIP coefficients of a camera's distortion, forward and back."""
    x = np.linspace(-0.5, camera.width - 0.5, _GRID)
    y = np.linspace(-0.5, camera.height - 0.5, _GRID)
    seen = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    vectors = camera.unproject(seen)
    seen, vectors = seen[np.isfinite(vectors).all(axis=1)], vectors[np.isfinite(vectors).all(axis=1)]
    centre = np.array([camera.cx, camera.cy])
    ideal = _plane(camera, vectors) * np.array([camera.parity * camera.fx, camera.fy])
    away = seen - centre
    # A(0,1) and the like stay zero: the linear part is the CD matrix's. Lens polynomials have no second order unless
    # decentred, but SIP orders are complete.
    header: dict[str, Any] = {}
    for names, points, shift in (("AB", away, ideal - away), (("AP", "BP"), ideal, away - ideal)):
        powers, coefficients = _fit(points, shift)
        for axis, name in enumerate(names):
            header[f"{name}_ORDER"] = int(powers.max())
            for (p, q), value in zip(powers, coefficients[:, axis], strict=True):
                header[f"{name}_{p}_{q}"] = float(value)
    return header


def _plane(camera: Camera, vectors: FloatArray) -> FloatArray:
    """Points (N, 2) of the ideal projection, in focal lengths."""
    if camera.projection == "pinhole":
        return np.asarray(vectors[:, :2] / vectors[:, 2:])
    side = np.hypot(vectors[:, 0], vectors[:, 1])
    return np.asarray(vectors[:, :2] * (np.arctan2(side, vectors[:, 2]) / np.maximum(side, 1e-300))[:, None])


def _fit(points: FloatArray, shift: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Powers (T, 2) and coefficients (T, 2) of the polynomial of least order that is good to 0.002 px."""
    size = float(np.abs(points).max())
    scaled = points / size
    for order in _ORDERS:
        powers = np.array([(p, q) for p in range(order + 1) for q in range(order + 1 - p) if p + q >= 1])
        terms = scaled[:, :1] ** powers[:, 0] * scaled[:, 1:] ** powers[:, 1]
        solution, *_ = np.linalg.lstsq(terms, shift, rcond=None)
        if np.abs(terms @ solution - shift).max() < _WANTED_PX:
            break
    return powers, solution / size ** powers.sum(axis=1)[:, None]
