"""Geometry of an annotated picture: grid lines, compass, arcs and the title text. It draws nothing."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from startracker.core import FloatArray
from startracker.solution import Solution

_MINUTE, _SECOND = 1 / 60, 1 / 3600
_DEC_STEPS = (
    *(n * _SECOND for n in (1, 2, 5, 10, 20, 30)),
    *(n * _MINUTE for n in (1, 2, 5, 10, 20, 30)),
    *(1, 2, 5, 10, 20, 30),
)
_RA_STEPS = (
    *(15 * n * _SECOND for n in (1, 2, 5, 10, 20, 30)),
    *(15 * n * _MINUTE for n in (1, 2, 5, 10, 20, 30)),
    *(15 * n for n in (1, 2, 3, 6)),
)
_LINES = 5.0
_POINTS = 400


def nice_step(value_deg: float) -> float:
    """Largest round step (1, 2, 5, 10, 20, 30 seconds, minutes or degrees) that does not exceed a value."""
    fitting = [step for step in _DEC_STEPS if step <= value_deg * (1 + 1e-9)]
    return float(fitting[-1]) if fitting else float(_DEC_STEPS[0])


def polyline(one: FloatArray, other: FloatArray, points: int = 33) -> FloatArray:
    """Points (N, 3) along the great circle between two unit vectors."""
    t = np.linspace(0.0, 1.0, points)[:, None]
    angle = math.acos(min(1.0, max(-1.0, float(one @ other))))
    if angle < 1e-9:
        return np.repeat(one[None, :], points, axis=0)
    return np.asarray((np.sin((1 - t) * angle) * one + np.sin(t * angle) * other) / math.sin(angle))


def compass_arrows(solution: Solution) -> dict[str, FloatArray]:
    """Unit vectors (x, y) on the image that point north and east at its centre."""
    camera = solution.camera
    assert camera is not None
    middle = np.array([[(camera.width - 1) / 2, (camera.height - 1) / 2]])
    ra, dec = solution.radec_of(middle)[0]
    # With a step of one pixel, a pole in the field matters only if it is at the centre.
    step = math.degrees(camera.pixel_rad)
    near = max(math.cos(math.radians(dec)), 1e-6)
    tips = solution.pixel_of([ra, ra + step / near], [min(dec + step, 90.0), dec])
    arrows = tips - middle
    if dec + step > 90.0:
        arrows[0] = middle[0] - solution.pixel_of(ra, dec - step)[0]
    return {name: arrow / np.hypot(*arrow) for name, arrow in zip(("N", "E"), arrows, strict=True)}


def grid_lines(solution: Solution) -> Iterator[tuple[FloatArray, str]]:
    """Pixels (N, 2) of each line of declination and right ascension that crosses the image, and its label.

    About five lines of each kind; NaN where a line is outside the field.
    """
    camera = solution.camera
    assert camera is not None
    assert solution.ra_deg is not None
    x, y = np.linspace(-0.5, camera.width - 0.5, 41), np.linspace(-0.5, camera.height - 0.5, 41)
    field = solution.radec_of(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    field = field[np.isfinite(field).all(axis=1)]
    span = math.sqrt(camera.fov_deg * camera.fov_y_deg)
    low, high = float(field[:, 1].min()), float(field[:, 1].max())
    dec_step = _nearest(_DEC_STEPS, span / _LINES)
    # With a pole in the field every right ascension occurs.
    poles = solution.pixel_of([0.0, 0.0], [90.0, -90.0])
    seen = np.isfinite(poles).all(axis=1) & camera.contains(poles)
    low, high = (-90.0 if seen[1] else low), (90.0 if seen[0] else high)
    offset = (field[:, 0] - solution.ra_deg + 180.0) % 360.0 - 180.0
    west, east = (-180.0, 180.0) if seen.any() else (float(offset.min()), float(offset.max()))
    # Meridians converge towards the poles: their spacing on the image is that of the parallels over cos(declination).
    ra_step = _nearest(
        _RA_STEPS, min((east - west) / _LINES, dec_step / max(math.cos(math.radians((low + high) / 2)), 0.02) * 1.4)
    )
    if seen.any():
        ra_step = 30.0
    along = solution.ra_deg + np.linspace(west, east, _POINTS * (4 if seen.any() else 1))
    for k in range(math.ceil(low / dec_step), math.floor(high / dec_step) + 1):
        if abs(k * dec_step) < 90.0:
            yield solution.pixel_of(along, k * dec_step), dec_text(k * dec_step, dec_step)
    up = np.linspace(low, high, _POINTS)
    first, last = math.ceil((solution.ra_deg + west) / ra_step), math.floor((solution.ra_deg + east) / ra_step)
    # With the pole in the field all right ascensions are drawn, and the first and the last line coincide.
    for k in range(first, last + 1 if east - west < 359.0 else first + round(360.0 / ra_step)):
        yield solution.pixel_of(k * ra_step, up), ra_text(k * ra_step % 360.0, ra_step)


def _nearest(steps: tuple[float, ...], value: float) -> float:
    return min(steps, key=lambda step: abs(math.log(step / max(value, 1e-9))))


def ra_text(ra_deg: float, step_deg: float = _SECOND) -> str:
    """Right ascension in hours, with the resolution that steps of `step_deg` need: "5h 36m"."""
    seconds = round(ra_deg * 240.0) % 86_400
    hours, minutes, rest = seconds // 3600, seconds // 60 % 60, seconds % 60
    if step_deg * 240.0 >= 3600:
        return f"{hours}h"
    return f"{hours}h {minutes:02d}m" + ("" if step_deg * 240.0 >= 60 else f" {rest:02d}s")


def dec_text(dec_deg: float, step_deg: float = _SECOND) -> str:
    """Declination in degrees, with the resolution that steps of `step_deg` need: "−0° 46′"."""
    seconds = round(abs(dec_deg) * 3600.0)
    sign = "" if not seconds else "−" if dec_deg < 0 else "+"
    text = f"{sign}{seconds // 3600}°"
    if step_deg < 1:
        text += f" {seconds // 60 % 60:02d}′"
    return text + (f" {seconds % 60:02d}″" if step_deg < _MINUTE - 1e-9 else "")


def field_text(solution: Solution) -> tuple[str, str]:
    """Title and subtitle: boresight and roll; field of view, number of identified stars and rms residual."""
    camera = solution.camera
    if not solution.solved or camera is None or solution.attitude is None:
        return f"not solved: {solution.status}", solution.reason
    attitude = solution.attitude
    ra, dec = attitude.ra_deg, attitude.dec_deg
    roll = round(attitude.roll_deg, 2) % 360.0
    first = f"RA {ra_text(ra)} ({ra:.4f}°)   Dec {dec_text(dec)} ({dec:+.4f}°)   roll {roll:.2f}°".replace("-", "−")
    scale = math.degrees(camera.pixel_rad) * 3600.0
    rms = f", rms {solution.rmse_arcsec:.1f}″" if solution.rmse_arcsec is not None else ""
    mirrored = ", mirrored" if camera.parity < 0 else ""
    second = (
        f"field {camera.fov_text}, {scale:.4g}″ per pixel{mirrored}; "
        f"{solution.matched} of {len(solution.centroids)} detections identified{rms}"
    )
    return first, second
