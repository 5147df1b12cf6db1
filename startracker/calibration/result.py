"""Results of a calibration, and their text: the camera file and a table for the terminal."""

from __future__ import annotations

import io
import math
from dataclasses import dataclass, field
from datetime import date
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from startracker._version import __version__
from startracker.core import ARCSEC_RAD, FloatArray
from startracker.display import described
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.geometry.lens import prior_of


@dataclass(frozen=True, eq=False)
class CalibratedField:
    """One image of a calibration."""

    name: str
    attitude: Attitude
    """ICRS to camera."""
    covariance: FloatArray
    """Covariance of the rotation-vector error in camera axes, rad², marginalised over the camera's parameters, (3,
    3)."""
    xy: FloatArray
    """Measured centroids, pixels, (M, 2)."""
    catalog_id: NDArray[np.int64]
    """Number of each star in the catalogue, (M,)."""
    v_mag: FloatArray
    """V magnitudes, (M,)."""
    residual_px: FloatArray
    """Measured minus predicted, (M, 2)."""
    sigma_px: FloatArray
    """Standard error on one axis used in the fit, (M,)."""
    rejected: int
    """Number of centroids with a catalogue star in the widest gate whose position differs by more than 3.7 robust σ, or
    whose brightness differs."""
    centroids: int
    """Number of all centroids of the image."""
    refraction: FloatArray
    """Fitted stretch (`startracker.geometry.lens_fit.stretch`), (2,); zero if not fitted."""

    def __repr__(self) -> str:
        stars = f"{len(self.xy)} stars, {self.rejected} rejected"
        return described("CalibratedField", self.name, repr(self.attitude), stars, f"residual {self.rms_px:.3f} px rms")

    @property
    def rms_px(self) -> float:
        """√(mean(dx² + dy²)), px: both axes together, as reported by tetra3."""
        return float(np.sqrt(np.mean(np.sum(self.residual_px**2, axis=1))))


@dataclass(frozen=True, eq=False)
class Calibration:
    """A camera fitted to the stars of one or several images.

    Parameters
    ----------
    camera : Camera
    names : tuple of str
        Fitted parameters, of `startracker.geometry.lens.PARAMETERS`; the others were not significant and have their
        values in `startracker.geometry.lens.plain`.
    covariance : (P, P)
        Covariance of the fitted parameters, with errors scaled by √(χ²/ν) and the effect of the distortion `field_px`.
    fields : tuple of CalibratedField
    plain_residual_px : list of (M, 2)
        Residuals of the same stars with a single focal length and no distortion.
    floor_px : float
        Noise on one axis in addition to the centroid errors, estimated from the residuals (model, blends, atmosphere).
    chi2, freedom : float, int
        χ² including this floor, and degrees of freedom.
    epoch_jyear : float
        Epoch of the star positions.
    unsolved : mapping of str to str
        Reasons of unused images, by name.
    notes : tuple of str
        Notes for the user.
    field_px : float
        Estimated rms value, on each axis, of a smooth distortion that the lens model does not describe.
    """

    camera: Camera
    names: tuple[str, ...]
    covariance: FloatArray
    fields: tuple[CalibratedField, ...]
    plain_residual_px: tuple[FloatArray, ...]
    floor_px: float
    chi2: float
    freedom: int
    epoch_jyear: float
    unsolved: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    field_px: float = 0.0

    WELL_MEASURED_PX: ClassVar[float] = 0.2

    def __repr__(self) -> str:
        fields = f"{len(self.fields)} images" if len(self.fields) != 1 else "1 image"
        fit = f"{fields}, {self.stars} stars, residual {self.rms_px:.3f} px rms", f"fitted {' '.join(self.names)}"
        return described("Calibration", repr(self.camera), *fit)

    @property
    def residual_px(self) -> FloatArray:
        """Residuals of all images (M, 2)."""
        return np.concatenate([f.residual_px for f in self.fields])

    @property
    def rms_px(self) -> float:
        """√(mean(dx² + dy²)) of all stars, pixels."""
        return float(np.sqrt(np.mean(np.sum(self.residual_px**2, axis=1))))

    @property
    def rms_arcsec(self) -> float:
        """`rms_px` as an angle at the centre of the field, arc seconds."""
        return self.rms_px * self.camera.pixel_rad / ARCSEC_RAD

    @property
    def sigma_px(self) -> FloatArray:
        """Standard errors (M,) on one axis used in the fit."""
        return np.concatenate([f.sigma_px for f in self.fields])

    @property
    def weighted_rms_px(self) -> float:
        """`rms_px` with the weights of the fit, which is not dominated by the noise of faint stars."""
        weight = self.sigma_px**-2.0
        return float(np.sqrt(np.sum(weight * np.sum(self.residual_px**2, axis=1)) / np.sum(weight)))

    def well_measured(self) -> NDArray[np.bool_]:
        """Stars (M,) with a stated error of at most `WELL_MEASURED_PX`, independent of their residual."""
        return np.asarray(self.sigma_px <= self.WELL_MEASURED_PX)

    @property
    def stars(self) -> int:
        """Number of stars used in all images."""
        return sum(len(f.xy) for f in self.fields)

    @property
    def rejected(self) -> int:
        """Number of stars rejected in all images."""
        return sum(f.rejected for f in self.fields)

    def values(self) -> dict[str, tuple[float, float, str]]:
        """Value, standard error and unit of each parameter of the camera file; the error is 0 for a parameter that was
        not fitted."""
        camera, names = self.camera, list(self.names)
        table: dict[str, tuple[float, float, str]] = {}
        stretch = np.zeros(len(names))
        for name, sign in (("fx", -0.5), ("fy", 0.5)):
            gradient = stretch.copy()
            gradient[names.index("f")] = 1.0
            if "aspect" in names:
                gradient[names.index("aspect")] = sign
            focal = getattr(camera, name)
            table[name] = (focal, focal * math.sqrt(gradient @ self.covariance @ gradient), "px")
        for name in ("cx", "cy", "k1", "k2", "k3", "k4", "p1", "p2"):
            value = getattr(camera if name in ("cx", "cy") else camera.distortion, name)
            if name in names:
                k = names.index(name)
                table[name] = (value, math.sqrt(self.covariance[k, k]), "px" if name[0] == "c" else "")
            elif name in ("cx", "cy"):
                table[name] = (value, 0.0, "px")
        return table

    def held_by_prior(self) -> list[str]:
        """Fitted parameters that are determined mainly by the prior."""
        variance = np.diag(self.covariance)
        sigma = [prior_of(name, self.camera)[1] for name in self.names]
        return [n for n, v, s in zip(self.names, variance, sigma, strict=True) if math.isfinite(s) and v > 0.5 * s * s]


def rounded(value: float, sigma: float) -> str:
    """Value and standard error with two digits of the error: ``5114.03 ± 0.27``; ``held`` without an error."""
    if not sigma > 0.0:
        return f"{value:.6g} (held)"
    digits = max(0, 1 - int(f"{sigma:.1e}".partition("e")[2]))
    return f"{value:.{digits}f} ± {sigma:.{digits}f}"


def summary(calibration: Calibration) -> list[str]:
    """Lines of a report: parameters with their standard errors, residuals, images, notes."""
    camera = calibration.camera
    lines = [f"{camera.projection}, {camera.width}×{camera.height} pixels, field {camera.fov_text}"]
    for name, (value, sigma, unit) in calibration.values().items():
        lines.append(f"  {name:<3} {rounded(value, sigma)}{' ' + unit if unit else ''}")
    scale = camera.pixel_rad / ARCSEC_RAD
    lines.append(
        f"{calibration.stars} stars, {calibration.rejected} rejected; residuals: "
        f"{_both(calibration.rms_px, scale)} rms, {_both(calibration.weighted_rms_px, scale)} weighted"
    )
    good = calibration.well_measured()
    if 3 <= good.sum() < len(good):
        rms = float(np.sqrt(np.mean(np.sum(calibration.residual_px[good] ** 2, axis=1))))
        limit = calibration.WELL_MEASURED_PX
        lines.append(
            f"  {_both(rms, scale)} rms of the {good.sum()} with a stated error of at most {limit:g} px per axis"
        )
    x, y = np.sqrt(np.mean(calibration.residual_px**2, axis=0))
    lines.append(
        f"  {x:.3f} px along columns, {y:.3f} px along rows; χ²/ν = {calibration.chi2 / calibration.freedom:.2f} "
        f"with {calibration.floor_px:.3f} px in addition to the centroid errors"
    )
    for one in calibration.fields:
        attitude = one.attitude
        lines.append(
            f"  {one.name}: RA {attitude.ra_deg:.4f}° Dec {attitude.dec_deg:+.4f}° roll {attitude.roll_deg:.3f}°, "
            f"{len(one.xy)} stars of {one.centroids} centroids, {one.rejected} rejected, {_both(one.rms_px, scale)} rms"
        )
    lines += [f"    {name}: not used, {reason}" for name, reason in calibration.unsolved.items()]
    lines += [f"note: {note}" for note in calibration.notes]
    return lines


def camera_yaml(calibration: Calibration, made: date | None = None) -> str:
    """Text of a file for `Camera.from_yaml`; other results of the calibration are in comments."""
    from ruamel.yaml import YAML

    stream = io.StringIO()
    YAML().dump(calibration.camera.to_dict(), stream)
    day = (made or date.today()).isoformat()
    head = [
        f"camera calibrated with boresight {__version__} on {day}; star positions at J{calibration.epoch_jyear:.2f}"
    ]
    return "".join(f"# {line}\n" for line in head + summary(calibration)) + stream.getvalue()


def _both(pixels: float, scale: float) -> str:
    return f"{pixels:.3f} px = {pixels * scale:.2f}″"
