"""A calibration as text: the camera file with its provenance, and a table for the terminal."""

from __future__ import annotations

import io
from datetime import date

import numpy as np

from startracker._version import __version__
from startracker.calibration.result import Calibration
from startracker.core import ARCSEC_RAD


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
