"""What ``boresight solve`` prints and writes: a line or a JSON object, a WCS file, a picture."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.cli.checks import picture_format
from simulator.paths import write_atomically
from startracker import explain as explaining
from startracker.core import FloatArray
from startracker.geometry.camera import Camera
from startracker.images.reading import RowOrder
from startracker.observer import Observer
from startracker.solution import Solution
from startracker.wcs import wcs_header

_CENTRED_PX = 0.5
"""Offset of the principal point above which its direction is printed as well as the direction of the image centre."""
_AT_REST = Observer(2000.0, np.zeros(3))
"""For directions in the frame of the attitude, from which no aberration is removed."""


def as_dict(solution: Solution, pixels: FloatArray, observer: Observer | None) -> dict[str, Any]:
    """Solution in plain values, with the directions of image centre, principal point and `pixels` (N, 2)."""
    stars = solution.stars
    ra_deg, dec_deg = _centre_deg(solution)
    return {
        "status": str(solution.status),
        "reason": solution.reason,
        "ra_deg": ra_deg,
        "dec_deg": dec_deg,
        "roll_deg": solution.roll_deg,
        "principal_point": {
            "x": solution.camera.cx,
            "y": solution.camera.cy,
            "ra_deg": solution.ra_deg,
            "dec_deg": solution.dec_deg,
        }
        if solution.solved and solution.camera
        else None,
        "fov_deg": solution.fov_deg,
        "quaternion": [float(v) for v in solution.attitude.quat] if solution.attitude else None,
        "detected": len(solution.centroids),
        "matched": solution.matched,
        "rmse_arcsec": solution.rmse_arcsec,
        "parity": solution.parity,
        "stars": [
            {
                "x": float(xy[0]),
                "y": float(xy[1]),
                "catalog_id": int(number),
                "name": str(name),
                "v_mag": float(magnitude),
                "residual_px": [float(residual[0]), float(residual[1])],
                "used": bool(used),
            }
            for xy, number, name, magnitude, residual, used in zip(
                stars.xy, stars.catalog_id, stars.name, stars.v_mag, stars.residual_px, stars.used, strict=True
            )
        ],
        "bodies": [
            {"name": name, "x": float(xy[0]), "y": float(xy[1]), "residual_px": [float(r) for r in residual]}
            for name, xy, residual in zip(
                solution.bodies.name.tolist(), solution.bodies.xy, solution.bodies.residual_px, strict=True
            )
        ],
        "pixels": [
            {"x": float(x), "y": float(y), "ra_deg": _number(ra), "dec_deg": _number(dec)}
            for (x, y), (ra, dec) in zip(pixels, _radec_deg(solution, pixels, observer), strict=True)
        ],
        "catalog": solution.catalog.as_dict() if solution.catalog else None,
        "steps": [{"stage": step.stage, "text": step.text} for step in solution.steps],
        "times_ms": {stage: round(float(value), 3) for stage, value in solution.times_ms.items()},
    }


def as_text(solution: Solution, pixels: FloatArray, observer: Observer | None, *, explain: bool) -> str:
    """Solution in a line; a line more for each of `pixels` (N, 2), and the stages' account where asked for."""
    lines = [_summary(solution)]
    if solution.solved:
        for (x, y), (ra, dec) in zip(pixels, _radec_deg(solution, pixels, observer), strict=True):
            direction = f"RA {ra:.5f}°  Dec {dec:+.5f}°" if np.isfinite(ra) else "beyond the lens model's reach"
            lines.append(f"  pixel {x:g},{y:g}  {direction}")
    if explain:
        lines.append(explaining.as_text(solution.steps))
    return "\n".join(lines)


def _summary(solution: Solution) -> str:
    if not solution.solved:
        return f"{solution.status}: {solution.reason}"
    field = f"  field {solution.camera.fov_text}" if solution.camera else ""
    rmse = f", residual {solution.rmse_arcsec:.1f}″ rms" if solution.rmse_arcsec is not None else ""
    mirrored = ", mirrored" if solution.parity < 0 else ""
    bodies = "".join(f", {name}" for name in solution.bodies.name)
    ra_deg, dec_deg = _centre_deg(solution)
    axis = ""
    if solution.camera and _offset_px(solution.camera) > _CENTRED_PX:
        axis = f"principal point RA {solution.ra_deg:.4f}°  Dec {solution.dec_deg:+.4f}°, "
    return (
        f"solved  RA {ra_deg:.4f}°  Dec {dec_deg:+.4f}°  roll {solution.roll_deg:.3f}°{field}  ({axis}"
        f"{solution.matched} of {len(solution.centroids)} stars identified{bodies}{rmse}{mirrored}; "
        f"{solution.times_ms.get('total', 0.0):.0f} ms)"
    )


def _centre(camera: Camera) -> tuple[float, float]:
    """Pixel at the centre of the image."""
    return (camera.width - 1) / 2, (camera.height - 1) / 2


def _offset_px(camera: Camera) -> float:
    """Distance of the principal point from the centre of the image."""
    x, y = _centre(camera)
    return math.hypot(camera.cx - x, camera.cy - y)


def _centre_deg(solution: Solution) -> tuple[float | None, float | None]:
    """Right ascension and declination of the centre of the image, whichever way the camera is known: of its axis there,
    in the frame of the attitude, so that a centred principal point has the direction of the attitude."""
    if solution.attitude is None or solution.camera is None or not _offset_px(solution.camera):
        return solution.ra_deg, solution.dec_deg
    ra_deg, dec_deg = solution.radec_of(_centre(solution.camera), _AT_REST)[0].tolist()
    return ra_deg, dec_deg


def _radec_deg(solution: Solution, pixels: FloatArray, observer: Observer | None) -> FloatArray:
    """Right ascension and declination (N, 2), degrees; NaN where there is no solution."""
    return solution.radec_of(pixels, observer) if solution.solved and len(pixels) else np.full((len(pixels), 2), np.nan)


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def write_wcs(
    path: Path, solution: Solution, image: NDArray[Any], observer: Observer | None, row_order: RowOrder
) -> None:
    """The image with its world coordinates as FITS: what it holds can be laid over a chart as it is.

    The rows have the order of the file that was solved, stated by ROWORDER, so that the header is also that of the
    pixels of a FITS file.

    Nothing is written where the field is not solved. `InputError` where the lens has no WCS.
    """
    if solution.attitude is None or solution.camera is None:
        return
    from astropy.io import fits

    unit = fits.PrimaryHDU(image if row_order == "TOP-DOWN" else image[::-1])
    velocity = None if observer is None else observer.velocity_km_s
    unit.header["ROWORDER"] = (row_order, "whether the first row is the top of the picture")
    unit.header.update(wcs_header(solution.camera, solution.attitude, velocity, row_order=row_order))
    buffer = io.BytesIO()
    unit.writeto(buffer)
    write_atomically(path, buffer.getvalue())


def write_picture(
    path: Path, solution: Solution, image: NDArray[Any], observer: Observer | None, **options: Any
) -> None:
    """The annotated picture in the format of its suffix, of an unsolved field too; `options` as in `annotate`."""
    from startracker.annotation.annotate import annotated_picture

    write_atomically(path, annotated_picture(image, solution, picture_format(path), observer=observer, **options))
