"""Geometry of a display from photographs of its dots, by least squares on their centroids.

Unknowns: focal length over pitch, principal point, k1, k2 and tilt of the display, and a rotation of each photograph.
A tilt is a shift of the principal point and a rotation, except for what the distortion makes of it; weak priors
(assumed: tolerances of a bench) hold what the photographs do not determine.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from simulator.live.stimulator.geometry import DisplayGeometry, with_parity
from simulator.live.stimulator.patterns import Pattern
from simulator.live.stimulator.photographs import Dots, Photograph
from startracker.core import ARCSEC_RAD, FloatArray
from startracker.errors import InputError
from startracker.geometry.attitude import rotation_vector_to_matrix
from startracker.geometry.distortion import Distortion
from startracker.geometry.lens import prior_of
from startracker.geometry.lens_fit import noise_floor

PARAMETERS = ("ln_f", "cx", "cy", "k1", "k2", "tilt_x_deg", "tilt_y_deg")
_CENTRE_SHARE, _TILT_DEG, _FOCAL_SHARE = 0.05, 3.0, 0.1
"""Standard deviations of the priors: principal point over the width, tilt; and step of the focal length, without a
prior."""
_WORST_PX = 0.5


@dataclass(frozen=True, eq=False)
class GeometryFit:
    """Result of `fit_geometry`.

    Parameters
    ----------
    geometry : DisplayGeometry
    rotations : list of (3, 3)
        Collimator to camera of each photograph.
    covariance : (P, P)
        Of `PARAMETERS` and the rotation vectors, scaled by χ²/ν where that exceeds 1.
    residuals : list of (N, 2)
        Measured minus predicted centroids, camera pixels.
    floor_px : float
        Noise on one axis in addition to the stated centroid errors.
    """

    geometry: DisplayGeometry
    rotations: list[FloatArray]
    covariance: FloatArray
    residuals: list[FloatArray]
    floor_px: float

    @property
    def rms_px(self) -> float:
        """√(mean(dx² + dy²)), camera pixels."""
        return float(np.sqrt(np.mean(np.sum(np.concatenate(self.residuals) ** 2, axis=1))))

    @property
    def sigma(self) -> dict[str, float]:
        """Standard error of each of `PARAMETERS`."""
        return dict(zip(PARAMETERS, np.sqrt(np.diag(self.covariance)).tolist(), strict=False))

    def errors(self, stars: int = 9) -> tuple[FloatArray, FloatArray]:
        """Uncertainties of directions and attitudes that follow from the calibration.

        Parameters
        ----------
        stars : int
            Of a lattice `stars` × `stars` over the display.

        Returns
        -------
        rms standard error (2,) of the directions seen by the camera of the first photograph on either axis across
        them, arcsec; covariance (3, 3) of the attitude of a tracker that sees all of them, camera axes, rad².
        """
        axes = (np.linspace(0, size - 1, stars) for size in self.geometry.size)
        pixels = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        truth = self.geometry.to_directions(pixels) @ self.rotations[0].T
        sigma = np.sqrt(np.diag(self.covariance)[:10])
        moves = np.empty((10, len(pixels), 3))
        for k in range(10):
            step = np.where(np.arange(10) == k, sigma, 0.0)
            geometry = _moved(self.geometry, step[:7])
            matrix = rotation_vector_to_matrix(step[7:]) @ self.rotations[0]
            moves[k] = (geometry.to_directions(pixels) @ matrix.T - truth) / sigma[k]
        spread = np.einsum("kni,kl,lni->ni", moves, self.covariance[:10, :10], moves)
        # v moves by δ × v for a rotation δ: the rotation that fits the moves best
        cross = np.stack([np.cross(axis, truth) for axis in np.eye(3)], axis=-1).reshape(-1, 3)
        turn = np.linalg.lstsq(cross, moves.reshape(10, -1).T, rcond=None)[0]
        return np.sqrt(spread[:, :2].mean(axis=0)) / ARCSEC_RAD, turn @ self.covariance[:10, :10] @ turn.T


def fit_geometry(
    pattern: Pattern, nominal: DisplayGeometry, photographs: Sequence[Photograph], dots: Sequence[Dots]
) -> GeometryFit:
    """Fit the geometry to the dots of one or several photographs by calibrated cameras.

    The errors of the cameras' own calibration are not included: a relative error of their focal length is one of the
    display's.

    Raises
    ------
    InputError
        If no geometry near the nominal one fits.
    """
    from scipy.optimize import least_squares

    nominal = with_parity(nominal, dots[0].parity)
    positions = [pattern.position(one.lattice) for one in dots]
    start = [rotation_onto(nominal, at, p, one) for at, p, one in zip(positions, photographs, dots, strict=True)]
    mean, prior = np.zeros(len(PARAMETERS)), _priors(nominal)
    scale = np.concatenate([np.where(np.isfinite(prior), prior, _FOCAL_SHARE), np.full(3 * len(dots), 1e-3)])
    sigmas = [np.sqrt(one.variance_px2) for one in dots]

    def state(unknowns: FloatArray) -> tuple[DisplayGeometry, list[FloatArray]]:
        turns = (unknowns * scale)[len(PARAMETERS) :].reshape(-1, 3)
        geometry = _moved(nominal, (unknowns * scale)[: len(PARAMETERS)])
        return geometry, [rotation_vector_to_matrix(turn) @ r for turn, r in zip(turns, start, strict=True)]

    def misses(geometry: DisplayGeometry, rotations: list[FloatArray]) -> list[FloatArray]:
        return [
            one.xy - p.camera.project(geometry.to_directions(at) @ r.T)
            for one, p, at, r in zip(dots, photographs, positions, rotations, strict=True)
        ]

    def residual(unknowns: FloatArray, floor: float) -> FloatArray:
        parts = [
            (miss / np.hypot(s, floor)[:, None]).ravel()
            for miss, s in zip(misses(*state(unknowns)), sigmas, strict=True)
        ]
        held = ((unknowns * scale)[: len(PARAMETERS)] - mean) / prior
        return np.asarray(np.nan_to_num(np.concatenate([*parts, held]), nan=1e3))

    fit, floor = least_squares(residual, np.zeros(len(scale)), args=(1.0,), method="lm"), 0.0
    for _ in range(2):
        left = np.concatenate(misses(*state(fit.x)))
        floor = noise_floor(left, np.concatenate(sigmas) ** 2, len(scale))
        fit = least_squares(residual, fit.x, args=(floor,), method="lm")
    freedom = max(2 * len(left) + int(np.isfinite(prior).sum()) - len(scale), 1)
    inflation = max(1.0, float(np.sum(fit.fun**2)) / freedom)
    covariance = np.linalg.inv(fit.jac.T @ fit.jac) * np.outer(scale, scale) * inflation
    result = GeometryFit(*state(fit.x), covariance, misses(*state(fit.x)), floor)
    if result.rms_px > _WORST_PX:
        raise InputError(
            f"{photographs[0].name}: the dots fit no collimator near the nominal one (rms {result.rms_px:.2f} px); "
            "check the camera file, the display's size, its pitch and the focal length"
        )
    return result


def aligned(
    geometry: DisplayGeometry, pattern: Pattern, photograph: Photograph, dots: Dots
) -> tuple[FloatArray, FloatArray, float]:
    """Rotation (3, 3) of a calibrated collimator to another camera, standard errors (3,), rad, and residual rms, px.

    Raises
    ------
    InputError
        If the dots do not fit the calibrated geometry.
    """
    from scipy.optimize import least_squares

    at = pattern.position(dots.lattice)
    rays, first = geometry.to_directions(at), rotation_onto(geometry, at, photograph, dots)
    sigma = np.sqrt(dots.variance_px2)

    def miss(turn: FloatArray) -> FloatArray:
        return dots.xy - photograph.camera.project(rays @ (rotation_vector_to_matrix(1e-3 * turn) @ first).T)

    def residual(turn: FloatArray, floor: float) -> FloatArray:
        return np.asarray((miss(turn) / np.hypot(sigma, floor)[:, None]).ravel())

    fit = least_squares(residual, np.zeros(3), args=(0.0,), method="lm")
    floor = noise_floor(miss(fit.x), sigma**2, 3)
    fit = least_squares(residual, fit.x, args=(floor,), method="lm")
    rms = float(np.sqrt(np.mean(np.sum(miss(fit.x) ** 2, axis=1))))
    if dots.parity != geometry.collimator.parity or rms > _WORST_PX:
        raise InputError(
            f"{photograph.name}: the dots do not fit the calibrated display (residual {rms:.2f} px); "
            "check the camera file, or calibrate the display again"
        )
    sigmas = 1e-3 * np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac)))
    return np.asarray(rotation_vector_to_matrix(1e-3 * fit.x) @ first), sigmas, rms


def rotation_onto(geometry: DisplayGeometry, at: FloatArray, photograph: Photograph, dots: Dots) -> FloatArray:
    """Rotation (3, 3), collimator to camera, that fits directions best (Kabsch)."""
    from scipy.spatial.transform import Rotation

    seen = photograph.camera.unproject(dots.xy)
    return np.asarray(Rotation.align_vectors(seen, geometry.to_directions(at))[0].as_matrix())


def _priors(nominal: DisplayGeometry) -> FloatArray:
    camera = nominal.collimator
    centre = _CENTRE_SHARE * camera.width
    powers = (prior_of(name, camera)[1] for name in ("k1", "k2"))
    return np.array([math.inf, centre, centre, *powers, _TILT_DEG, _TILT_DEG])


def _moved(geometry: DisplayGeometry, step: FloatArray) -> DisplayGeometry:
    """The geometry with `step` added to `PARAMETERS`."""
    camera, (ln_f, cx, cy, k1, k2, one, two) = geometry.collimator, step.tolist()
    lens = Distortion(k1=camera.distortion.k1 + k1, k2=camera.distortion.k2 + k2)
    focal = camera.fx * math.exp(ln_f)
    moved = replace(camera, fx=focal, fy=focal, cx=camera.cx + cx, cy=camera.cy + cy, distortion=lens)
    return DisplayGeometry(moved, (geometry.tilt_deg[0] + one, geometry.tilt_deg[1] + two))
