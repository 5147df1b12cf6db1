"""Recursive estimate of the lens from the stars of successive frames: a Kalman filter in information form.

The parameters p of the lens (`startracker.geometry.lens.PARAMETERS`) are random walks with the drift q (per √s). The
stars of a frame are measured at x = h(p, θ) + e; the attitude θ of the frame, and the rate of a rolling shutter, are
unknown and marginalised: with the Jacobians H of p and B of θ, weights W and residuals r, the frame contributes

    I = Hᵀ W H − Hᵀ W B (Bᵀ W B)⁻¹ Bᵀ W H   (information)
    b = Hᵀ W r − Hᵀ W B (Bᵀ W B)⁻¹ Bᵀ W r

and with the predicted covariance P the updated one is (P⁻¹ + I)⁻¹, the correction (P⁻¹ + I)⁻¹ b. Attitudes of a filter
are not used: they contain the errors of the lens of earlier frames.

A shift of the principal point is, to first order, a rotation of the camera: only terms of x² distinguish them, with the
tangent x of the angle from the axis. Its error is therefore about x⁻² times that of an attitude from the same stars.

Stars whose errors are constant have a smaller weight, and their effect on the estimate is part of its covariance
(`startracker.calibration.star_memory`). A smooth distortion that the parameters do not describe would be taken for a
change of the lens: a displacement of x² and xy is that of the principal point. It is estimated with the lens, and its
uncertainty is part of the covariance (`startracker.calibration.residual_field`).
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from startracker.arguments import of_kind, real_array, real_number
from startracker.calibration.applied import applied_change
from startracker.calibration.field import IdentifiedStars
from startracker.calibration.lens_equations import LensEquations, lens_equations
from startracker.calibration.residual_field import FrameInformation, ResidualField, field_columns
from startracker.calibration.star_memory import StarMemory
from startracker.core import BoolArray, FloatArray, IntArray
from startracker.display import described, fields_repr
from startracker.errors import InputError
from startracker.geometry.camera import Camera
from startracker.geometry.lens import PARAMETERS, change_lens, corner_radius, is_one_to_one, value_of
from startracker.settings import InFlightSettings
from startracker.settings.checks import settings_or_default

_FEWEST_STARS = 4
_REJECT_SIGMAS = 3.7
"""Residual of a star, in standard errors, above which it is not used; exceeded with probability 1e-3."""
_RAYLEIGH_MEDIAN = math.sqrt(2.0 * math.log(2.0))
_MISFIT = 1e-3
"""Probability of the χ² of a frame's residuals below which its stated errors are increased for this frame."""
_MEMORY = 2000.0
"""Approximate degrees of freedom over which the ratio of actual to stated errors is averaged: it is known to 1.6 %."""
_RESET_AFTER = 5
"""Number of successive frames beyond the gate after which the lens, rather than the frames, is assumed to be wrong."""


@dataclass(frozen=True, eq=False)
class LensUpdate:
    """Result of one frame for the lens."""

    accepted: bool
    """Whether the frame was used."""
    reason: str
    """Reason for rejecting it; empty if it was used."""
    used: BoolArray
    """Mask (M,) of the stars whose residuals fit."""
    distance2: float = math.nan
    """Squared distance of the frame's estimate of the lens from the predicted one, in units of their covariance."""
    freedom: int = 0
    """Its degrees of freedom: for a correct filter it has a χ² distribution with as many, and is smaller for stars that
    are observed repeatedly, which have a smaller weight than their errors in one frame imply."""
    noise_factor: float = 1.0
    """Factor by which the stated errors of the stars were multiplied."""
    attitude_covariance: FloatArray | None = None
    """Second moment (3, 3) of the error that the camera in use before the frame (`LensFilter.applied`) causes in the
    frame's attitude, camera axes, rad²."""

    __repr__ = fields_repr


def initial_sigmas(settings: InFlightSettings, camera: Camera) -> FloatArray:
    """Initial standard deviation of each parameter (P,), in the units of `startracker.geometry.lens.PARAMETERS`."""
    parts = settings.focal_length_ppm, settings.principal_point_px, settings.distortion_px
    return _in_lens_units(settings.parameters, camera, *parts)


def drifts(settings: InFlightSettings, camera: Camera) -> FloatArray:
    """Drift of each parameter (P,) per √s."""
    parts = (
        settings.focal_length_drift_ppm_sqrt_h,
        settings.principal_point_drift_px_sqrt_h,
        settings.distortion_drift_px_sqrt_h,
    )
    return _in_lens_units(settings.parameters, camera, *parts) / 60.0


def _in_lens_units(
    names: tuple[str, ...], camera: Camera, focal_ppm: float, centre_px: float, corner_px: float
) -> FloatArray:
    radius, focal_px = corner_radius(camera), 1.0 / camera.pixel_rad
    out = np.empty(len(names))
    for i, name in enumerate(names):
        if name in ("f", "aspect"):
            out[i] = 1e-6 * focal_ppm
        elif name in ("cx", "cy"):
            out[i] = centre_px
        else:
            # A tangential term displaces by r², a radial one k_n by r^(2n+1).
            power = 2 if name[0] == "p" else 2 * int(name[1:]) + 1
            out[i] = corner_px / (focal_px * radius**power)
    return out


class LensFilter:
    """Kalman filter of the lens.

    Parameters
    ----------
    camera : Camera
        The camera as calibrated on the ground.
    settings : InFlightSettings
        Parameters, their initial standard deviations and drifts, and the gate.

    Raises
    ------
    InputError
        For a parameter that the camera's projection does not have.

    Notes
    -----
    Valid for small changes: the model is linearised about the current camera, and an error of 1 px of the predicted
    positions changes the derivatives by less than 1 px over the focal length in pixels.
    """

    def __init__(self, camera: Camera, settings: InFlightSettings | None = None) -> None:
        of_kind("camera", camera, Camera)
        self.settings = settings_or_default("settings", settings, InFlightSettings)
        names = self.settings.parameters
        kind = "pinhole" if camera.projection == "pinhole" else "fisheye"
        missing = [name for name in names if name not in PARAMETERS[kind]]
        if camera.projection == "equidistant":  # a fisheye without coefficients
            missing = [name for name in names if name[0] in "kp"]
        lens = camera.distortion
        if camera.projection == "equisolid" or (kind == "pinhole" and (lens.k4 or lens.k5 or lens.k6)):
            raise InputError("calibration in flight: equisolid projections and rational distortion are not supported")
        if missing or not names:
            raise InputError(
                f"calibration in flight: the projection {camera.projection} has no parameter "
                f"{', '.join(missing) or 'to estimate'}; it has {', '.join(PARAMETERS[kind])}"
            )
        self.ground, self.camera, self.names = camera, camera, names
        """Camera of the ground, estimated camera, and names of the parameters."""
        self.initial_sigma, self.drift = initial_sigmas(self.settings, camera), drifts(self.settings, camera)
        self.filtered: FloatArray = np.diag(self.initial_sigma**2)
        """Covariance (P, P) that determines the gain of the filter, for a known residual field."""
        self.random: FloatArray = self.filtered.copy()
        """Covariance (P, P) of the estimate without the constant errors of stars and the residual field."""
        self.prior_variance: FloatArray = self.initial_sigma**2
        """Variance (P,) of the change of each parameter since the ground in the absence of stars."""
        self.field = ResidualField(len(names), self.settings.field_px)
        """Smooth distortion that the parameters do not describe."""
        self.applied: FloatArray = np.zeros(len(names))
        """Change (P,) of the parameters that is applied to the camera in use (`startracker.calibration.applied`)."""
        self.stars = StarMemory(len(names), self.settings.star_error_px * camera.pixel_rad)
        """Stars observed so far, and the effect of their constant errors."""
        self.frames, self.restarts = 0, 0
        """Numbers of frames used, and of restarts after frames beyond the gate."""
        self._beyond = 0
        self._chi2 = self._freedom = 0.0

    def __repr__(self) -> str:
        sigma = zip(self.names, self.sigma, strict=True)
        stated = " ".join(f"{name} {value:+.3g}±{s:.2g}" for (name, s), value in zip(sigma, self.change, strict=True))
        return described("LensFilter", f"{self.frames} frames", stated)

    @property
    def change(self) -> FloatArray:
        """Change (P,) of the parameters since the calibration on the ground."""
        return np.array([value_of(name, self.camera) - value_of(name, self.ground) for name in self.names])

    @property
    def covariance(self) -> FloatArray:
        """Covariance (P, P) of the parameters, with the constant errors of stars and the residual field."""
        return self._joint[: len(self.names), : len(self.names)]

    @property
    def _joint(self) -> FloatArray:
        """Covariance (P + C, P + C) of the parameters and of the coefficients of the residual field."""
        return self.field.joint(self.random + self.stars.covariance)

    @property
    def camera_in_use(self) -> Camera:
        """The camera with the applied change."""
        return self._changed(self.ground, self.applied) if self.applied.any() else self.ground

    def _changed(self, camera: Camera, change: FloatArray) -> Camera:
        return change_lens(camera, dict(zip(self.names, change.tolist(), strict=True)))

    @property
    def sigma(self) -> FloatArray:
        """Standard deviation (P,) of each parameter."""
        return np.sqrt(self.covariance.diagonal())

    @property
    def noise_factor(self) -> float:
        """Ratio of the actual to the stated errors of the stars, at least 1."""
        return math.sqrt(max(self._chi2 / self._freedom, 1.0)) if self._freedom > 0.0 else 1.0

    @property
    def response_per_s(self) -> FloatArray:
        """Matrix (P, P) R of the steady filter: after a step of the lens its error decays as exp(−R t).

        In the steady state P J P = Q, with the information J per second, and the error decays with P J = Q P⁻¹, which
        needs no J (the stationary Riccati equation; Kalman & Bucy 1961, J. Basic Engineering 83, 95). Before the steady
        state the filter is faster.
        """
        return np.asarray(np.diag(self.drift**2) @ np.linalg.inv(self.filtered))

    @property
    def time_constant_s(self) -> FloatArray:
        """Time (P,) in which the steady filter follows a step of each parameter to 1 − 1/e; infinite without drift."""
        rate = self.response_per_s.diagonal()
        return np.where(rate > 0.0, 1.0 / np.where(rate > 0.0, rate, 1.0), np.inf)

    def predict(self, dt_s: float) -> None:
        """Let the parameters drift for `dt_s` seconds."""
        dt_s = real_number("a step forward in time", dt_s, least=0.0)
        self._widen(self.drift**2 * dt_s)

    def _widen(self, variances: FloatArray) -> None:
        """Add variances (P,) to the parameters."""
        self.filtered = self.filtered + np.diag(variances)
        self.random = self.random + np.diag(variances)
        self.prior_variance = self.prior_variance + variances

    def update(self, matrix: FloatArray, stars: IdentifiedStars) -> LensUpdate:
        """Update with the stars of a frame.

        Parameters
        ----------
        matrix : array, shape (3, 3)
            Approximate attitude, ICRS to camera; the frame's own is fitted.
        stars : IdentifiedStars
            The stars.
        """
        matrix = real_array("matrix", matrix, (3, 3))
        of_kind("stars", stars, IdentifiedStars, "IdentifiedStars.of(solution, tracker)")
        if len(stars) < _FEWEST_STARS:
            return LensUpdate(False, f"fewer than {_FEWEST_STARS} stars", np.zeros(len(stars), np.bool_))
        rows, columns = self.stars.rows(stars.catalog_id), self._field_columns(stars.xy)
        stars = replace(stars, xy=stars.xy - columns @ self.field.mean)
        used, frame = self._fitting(matrix, stars, columns, rows)
        if frame is None:
            return LensUpdate(False, "the residuals of too many stars do not fit", used)
        chosen = stars.select(used)
        chi2, freedom = self._misfit(chosen, frame)
        most = self.noise_factor**2 * float(chdtri(freedom, _MISFIT))
        factor = math.sqrt(chi2 / freedom) / self.noise_factor if chi2 > most else 1.0
        information = FrameInformation(frame.information / factor**2, frame.vector / factor**2)
        distance2, dimensions = self._distance2(information)
        part = frame.attitude_by_lens @ self._error_moment @ frame.attitude_by_lens.T
        found = LensUpdate(True, "", used, distance2, dimensions, factor * self.noise_factor, part)
        limit = float(chdtri(max(dimensions, 1), self.settings.false_rejection))
        if distance2 > limit:
            return self._refused(found)
        share = (found.noise_factor * chosen.sigma_px / (factor * self._effective_px(chosen, rows[used]))) ** 2
        if not self._take(information, frame, factor**2 * frame.noise_information(share), rows[used]):
            return self._refused(found)
        self._beyond, self.frames = 0, self.frames + 1
        self._remember(rows, stars, frame, columns)
        fading = math.exp(-freedom / _MEMORY)
        self._chi2, self._freedom = fading * self._chi2 + min(chi2, most), fading * self._freedom + freedom
        self.applied = applied_change(self.names, self.change, self.covariance, self.prior_variance)
        return found

    def unused(self, matrix: FloatArray, stars: IdentifiedStars, reason: str) -> LensUpdate:
        """Result of a frame that is not used, with the error of its attitude by the camera in use; as for `update`."""
        none, moment = np.zeros(len(stars), np.bool_), None
        if len(stars) >= _FEWEST_STARS:
            frame = lens_equations(self.camera, matrix, stars, self.names, self._field_columns(stars.xy))
            moment = frame.attitude_by_lens @ self._error_moment @ frame.attitude_by_lens.T
        return LensUpdate(False, reason, none, attitude_covariance=moment)

    def _field_columns(self, xy: FloatArray) -> FloatArray:
        """`field_columns` (M, 2, C) of positions; C = 0 without a residual field."""
        return field_columns(self.ground, xy) if self.field.terms else np.zeros((len(xy), 2, 0))

    @property
    def _error_moment(self) -> FloatArray:
        """Second moment (P + C, P + C) of the errors of the camera in use: covariance, plus the square of changes not
        applied."""
        missing = np.concatenate([self.change - self.applied, self.field.mean])
        return self._joint + np.outer(missing, missing)

    def _distance2(self, frame: FrameInformation) -> tuple[float, int]:
        """Squared distance of a frame's estimate of the lens from the predicted one, and its degrees of freedom."""
        size, joint = len(self.names), self.field.joint(self.filtered)
        variance = frame.matrix[:size, :size] + frame.matrix[:size] @ joint @ frame.matrix[:, :size]
        root = np.asarray(np.linalg.cholesky(joint[:size, :size]), dtype=np.float64)
        axes, values, _ = np.linalg.svd(root.T @ variance @ root)  # symmetric, not negative: its eigenvalues
        vector, usable = axes.T @ (root.T @ frame.vector[:size]), values > 1e-12
        return float(np.sum(vector[usable] ** 2 / values[usable])), int(usable.sum())

    def _take(self, information: FrameInformation, frame: LensEquations, noise: FloatArray, rows: IntArray) -> bool:
        """Update the estimates with a frame if the updated lens can be inverted; returns whether it can.

        The covariance of the noise of `frame.vector` is `noise` (P + C, P + C) for the stars in `rows`.
        """
        size = len(self.names)
        root = np.asarray(np.linalg.cholesky(self.filtered), dtype=np.float64)
        # P (1 + I P)⁻¹ in the symmetric form of Cholesky's factor, which stays positive definite.
        inner = np.linalg.inv(np.eye(size) + root.T @ information.matrix[:size, :size] @ root)
        filtered = root @ inner @ root.T
        field = copy.copy(self.field)
        without = self.change - field.by_field @ field.mean + filtered @ field.without(information)[:size]
        field.update(information, filtered)
        moved = self._changed(self.ground, without + field.by_field @ field.mean)
        if not is_one_to_one(moved):
            return False
        gain = filtered / (frame.information[0, 0] / information.matrix[0, 0])
        update = np.eye(size) - filtered @ information.matrix[:size, :size]
        self.camera, self.filtered, self.field = moved, filtered, field
        # Joseph's form of the update, valid for any gain, because the gain ignores the constant errors of stars.
        self.random = update @ self.random @ update.T + gain @ noise[:size, :size] @ gain
        self.stars.follow(update, rows, gain @ frame.by_star[:, :size])
        return True

    def _effective_px(self, stars: IdentifiedStars, rows: IntArray) -> FloatArray:
        """Standard errors (M,), px, by which the stars are weighted.

        The constant error of a star that was observed n times gets the weight of an error of √n times its size in each
        frame.
        """
        constant_px2 = (1.0 + self.stars.sightings(rows)) * self.settings.star_error_px**2
        return np.sqrt((self.noise_factor * stars.sigma_px) ** 2 + constant_px2)

    def _misfit(self, stars: IdentifiedStars, frame: LensEquations) -> tuple[float, int]:
        """χ² of the residuals of a frame with the stated errors, and its degrees of freedom."""
        sigma = np.repeat(np.sqrt(stars.sigma_px**2 + self.settings.star_error_px**2), 2)
        by_lens, residual = frame.by_lens.reshape(len(sigma), -1) / sigma[:, None], frame.residual.ravel() / sigma
        # Errors of the lens are common to the stars: rᵀ (1 + H P Hᵀ)⁻¹ r = rᵀ r − bᵀ P (1 + I P)⁻¹ b.
        information, vector, joint = by_lens.T @ by_lens, by_lens.T @ residual, self._joint
        explained = joint @ np.linalg.solve(np.eye(len(joint)) + information @ joint, vector)
        return float(residual @ residual - vector @ explained), 2 * len(stars) - 3

    def _lens_px2(self, by_lens: FloatArray) -> FloatArray:
        """Variance (M,) on one axis of predicted positions due to the uncertainty of the lens, px²."""
        return np.asarray(np.einsum("mip,mip->m", by_lens @ self._joint, by_lens) / 2.0)

    def _remember(self, rows: IntArray, stars: IdentifiedStars, frame: LensEquations, columns: FloatArray) -> None:
        """Record the residuals of all stars of a frame, including those that were not used."""
        seen, pixel = self.camera.unproject(stars.xy), self.camera.pixel_rad
        every = lens_equations(self.camera, frame.matrix, stars, self.names, columns).by_lens
        lens_px = np.sqrt(self._lens_px2(every))
        residual = seen @ frame.matrix - stars.directions
        self.stars.add_residuals(rows, residual, self.noise_factor * stars.sigma_px * pixel, lens_px * pixel)

    def _refused(self, found: LensUpdate) -> LensUpdate:
        """Reject a frame beyond the gate; after several in succession the initial uncertainty is added to the lens."""
        self._beyond += 1
        reason = f"distance² {found.distance2:.1f} of {found.freedom} degrees of freedom is beyond the gate"
        if self._beyond >= _RESET_AFTER:
            of_field = self.field.by_field @ self.field.covariance @ self.field.by_field.T
            self.filtered, self.random = self.filtered + of_field, self.random + of_field
            self.field.forget()
            self._widen(self.initial_sigma**2)
            self._beyond, self.restarts = 0, self.restarts + 1
            reason += f"; the lens was made uncertain after {_RESET_AFTER} such frames"
        return replace(found, accepted=False, reason=reason)

    def _fitting(
        self, matrix: FloatArray, stars: IdentifiedStars, columns: FloatArray, rows: IntArray
    ) -> tuple[BoolArray, LensEquations | None]:
        """Mask of the stars whose residuals fit, and their equations; None if too few are left."""
        used, effective_px = self.stars.trusted(rows), self._effective_px(stars, rows)
        while used.sum() >= max(_FEWEST_STARS, len(used) // 2):
            chosen = stars.select(used)
            weighed = replace(chosen, sigma_px=effective_px[used])
            frame = lens_equations(self.camera, matrix, weighed, self.names, columns[used])
            expected = (self.noise_factor * chosen.sigma_px) ** 2 + self.settings.star_error_px**2
            sigma = np.sqrt(expected + self._lens_px2(frame.by_lens))
            length = np.hypot(*frame.residual.T) / sigma
            limit = _REJECT_SIGMAS * max(float(np.median(length)) / _RAYLEIGH_MEDIAN, 1.0)
            good = length <= limit
            if good.all():
                return used, frame
            # A misidentified star rotates the whole frame, so only the worst half of the stars beyond the limit is
            # removed each time.
            worst = np.flatnonzero(~good)
            worst = worst[np.argsort(-length[worst])][: (len(worst) + 1) // 2]
            used[np.flatnonzero(used)[worst]] = False
        return used, None
