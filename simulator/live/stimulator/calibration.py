"""Calibration of a display from the photographs of its patterns, and the file that holds it."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from simulator.live.stimulator.geometry import DisplayGeometry
from simulator.live.stimulator.geometry_fit import GeometryFit, aligned, fit_geometry
from simulator.live.stimulator.patterns import Pattern
from simulator.live.stimulator.photographs import Photograph, find_dots, square_fluxes
from simulator.live.stimulator.photometry import Curve, Photometry
from simulator.live.stimulator.photometry_fit import Exposures, PhotometryFit, fit_photometry
from simulator.live.stimulator.picture import Stimulator
from startracker._version import __version__
from startracker.arguments import file_path, names_of, of_kind, real_number
from startracker.calibration.result import rounded
from startracker.core import ARCSEC_RAD, FloatArray
from startracker.errors import InputError
from startracker.files import read_yaml
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera


@dataclass(frozen=True, eq=False)
class DisplayCalibration:
    """Result of `calibrate_display`: the stimulator, and the fits it is from."""

    stimulator: Stimulator
    geometry: GeometryFit
    photometry: PhotometryFit

    def summary(self) -> list[str]:
        """Lines of a report: every parameter with its standard error, residuals, what it means for a tracker."""
        shape, light, sigma = self.stimulator.geometry, self.photometry, self.geometry.sigma
        camera, lens = shape.collimator, shape.collimator.distortion
        across, attitude = self.geometry.errors()
        turn = np.sqrt(np.diag(attitude)) / ARCSEC_RAD
        lines = [
            f"display {camera.width}×{camera.height} pixels, field {camera.fov_text}, "
            f"{camera.pixel_rad / ARCSEC_RAD:.2f}″ a pixel" + (", mirrored" if camera.parity < 0 else ""),
            f"  focal length {rounded(camera.fx, camera.fx * sigma['ln_f'])} px",
            f"  principal point {rounded(camera.cx, sigma['cx'])}, {rounded(camera.cy, sigma['cy'])} px",
            f"  k1 {rounded(lens.k1, sigma['k1'])}, k2 {rounded(lens.k2, sigma['k2'])}",
            (
                f"  tilt {rounded(shape.tilt_deg[0], sigma['tilt_x_deg'])}, "
                f"{rounded(shape.tilt_deg[1], sigma['tilt_y_deg'])} degrees"
            ),
            (
                f"  {sum(map(len, self.geometry.residuals))} dots, residuals {self.geometry.rms_px:.4f} camera px rms; "
                f"directions to {across[0]:.3f}″, {across[1]:.3f}″"
            ),
            (
                f"  attitude of a tracker in the camera's position: {turn[0]:.3f}″, {turn[1]:.3f}″ across "
                f"the boresight, {turn[2]:.2f}″ about it, from the calibration alone"
            ),
        ]
        for colour, magnitude in light.photometry.magnitude.items():
            curve = light.photometry.curve[colour]
            gamma = f"gamma {rounded(light.gamma[colour], light.gamma_sigma[colour])}"
            text = gamma if curve.gamma else f"no power law ({gamma} fits worse than the noise): table of its levels"
            lines.append(f"  {colour}: magnitude {rounded(magnitude, light.magnitude_sigma[colour])} a pixel, {text}")
        lines.append(
            f"  all colours give {rounded(light.photometry.white_factor, light.white_factor_sigma)} of their sum; "
            f"uniformity to {100 * light.uniformity_sigma:.3f} %, squares scatter by {100 * light.scatter:.2f} %; "
            f"black level {light.photometry.black:.2g} of white"
        )
        return lines

    def uncertainty(self) -> dict[str, float]:
        """Standard errors by name, for the file."""
        across, attitude = self.geometry.errors()
        turn = np.sqrt(np.diag(attitude)) / ARCSEC_RAD
        light, sigma = self.photometry, dict(self.geometry.sigma)
        focal_px = self.stimulator.geometry.collimator.fx * sigma.pop("ln_f")
        return {
            "focal_px": focal_px,
            **sigma,
            "direction_arcsec": float(np.sqrt(np.mean(across**2))),
            "attitude_x_arcsec": float(turn[0]),
            "attitude_y_arcsec": float(turn[1]),
            "attitude_z_arcsec": float(turn[2]),
            **{f"magnitude_{c}": s for c, s in light.magnitude_sigma.items()},
            **{f"gamma_{c}": s for c, s in light.gamma_sigma.items()},
            "white_factor": light.white_factor_sigma,
            "uniformity": light.uniformity_sigma,
            "scatter": light.scatter,
        }


def calibrate_display(
    pattern: Pattern, nominal: DisplayGeometry, photographs: Mapping[str, Photograph], taken: Exposures
) -> DisplayCalibration:
    """Calibrate a display from photographs of its patterns.

    Parameters
    ----------
    pattern : Pattern
        What the display showed.
    nominal : DisplayGeometry
        Geometry by the data sheets (`nominal_geometry`), to some per cent.
    photographs : mapping
        By the name of the pattern: ``dots`` and all pictures with squares from one position of the camera, further
        photographs of the dots from others as ``dots-2`` …, and optionally ``black`` and ``off``.
    taken : Exposures
        Exposure of the photographs of squares, ``black`` and ``off``.

    Raises
    ------
    InputError
        For a missing or unusable photograph, or a camera that moved between them.
    """
    of_kind("pattern", pattern, Pattern)
    of_kind("nominal", nominal, DisplayGeometry)
    of_kind("taken", taken, Exposures)
    for name, value in taken._asdict().items():
        real_number(name, value)
    for name, one in of_kind("photographs", photographs, (Mapping,)).items():
        of_kind(f"photograph {name}", one, Photograph)
    needed = [name for name in pattern.names if name != "black"]
    if missing := [name for name in needed if name not in photographs]:
        raise InputError(f"photographs of these patterns are missing: {', '.join(missing)}")
    poses = [photographs[name] for name in sorted(photographs) if name == "dots" or name.startswith("dots-")]
    geometry = fit_geometry(pattern, nominal, poses, [find_dots(one, pattern) for one in poses])
    corners = _square_corners(pattern, geometry, poses[0].camera)
    squares = {name: square_fluxes(photographs[name], corners) for name in needed if name != "dots"}
    light = fit_photometry(pattern, squares, taken)
    if "black" in photographs and "off" in photographs:
        black = _black(photographs["black"], photographs["off"], geometry, light, taken)
        light = replace(light, photometry=replace(light.photometry, black=black))
    alignment = Attitude.from_matrix(geometry.rotations[0], "collimator", "camera")
    stimulator = Stimulator(geometry.geometry, light.photometry, alignment)
    whole = DisplayCalibration(stimulator, geometry, light)
    return replace(whole, stimulator=replace(stimulator, uncertainty=whole.uncertainty()))


def align_display(stimulator: Stimulator, pattern: Pattern, photograph: Photograph) -> tuple[Stimulator, list[str]]:
    """The stimulator before another camera, or before one that moved, from one photograph of the dots; and a report.

    Raises
    ------
    InputError
        If the dots are not found or do not fit the calibrated display.
    """
    of_kind("stimulator", stimulator, Stimulator)
    dots = find_dots(of_kind("photograph", photograph, Photograph), of_kind("pattern", pattern, Pattern))
    rotation, sigma, rms = aligned(stimulator.geometry, pattern, photograph, dots)
    arcsec = sigma / ARCSEC_RAD
    errors = {f"attitude_{axis}_arcsec": float(s) for axis, s in zip("xyz", arcsec, strict=True)}
    moved = replace(
        stimulator,
        alignment=Attitude.from_matrix(rotation, "collimator", "camera"),
        uncertainty={**stimulator.uncertainty, **errors},
    )
    return moved, [
        (
            f"{len(dots.lattice)} dots, residual {rms:.3f} px rms; aligned to {arcsec[0]:.3f}″, {arcsec[1]:.3f}″ "
            f"across the boresight and {arcsec[2]:.2f}″ about it"
        )
    ]


def _square_corners(pattern: Pattern, fit: GeometryFit, camera: Camera) -> FloatArray:
    """Corners (N, 4, 2) of the squares in the first photograph; NaN where the camera does not see them."""
    side = pattern.square_px
    corner = np.array([[0, 0], [side, 0], [side, side], [0, side]]) - 0.5
    rays = fit.geometry.to_directions((pattern.squares[:, None] + corner).reshape(-1, 2))
    return camera.project(rays @ fit.rotations[0].T).reshape(-1, 4, 2)


def _black(black: Photograph, off: Photograph, fit: GeometryFit, light: PhotometryFit, taken: Exposures) -> float:
    """Flux of a pixel at level 0 over that of a white one, from the middle of the display."""
    middle = np.array(fit.geometry.size) / 2
    rays = fit.geometry.to_directions(middle + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    at, right, below = black.camera.project(rays @ fit.rotations[0].T)
    area = abs(float(np.linalg.det(np.stack([right - at, below - at]))))
    x, y = np.rint(at).astype(int)
    reach = 50
    box = (slice(max(y - reach, 0), y + reach + 1), slice(max(x - reach, 0), x + reach + 1))
    glow = float(np.mean(black.image[box].astype(float) - off.image[box]))
    flux = glow * area / taken.exposure_s * 10.0 ** (-0.4 * taken.zero_point)
    return float(max(flux, 0.0) / light.photometry.full.sum())


# ---------------------------------------------------------------------- the file


def stimulator_yaml(stimulator: Stimulator, head: list[str], made: date | None = None) -> str:
    """Text of a file for `read_stimulator`; `head` are lines of a report, which become comments."""
    from ruamel.yaml import YAML

    head = list(names_of(head))
    of_kind("made", made, (date, type(None)))
    light = of_kind("stimulator", stimulator, Stimulator).photometry
    data = {
        "collimator": stimulator.geometry.collimator.to_dict(),
        "tilt_deg": [float(tilt) for tilt in stimulator.geometry.tilt_deg],
        "alignment": [float(q) for q in stimulator.alignment.as_quat()],
        "magnitude": {c: float(m) for c, m in light.magnitude.items()},
        "curve": {
            c: {"gamma": float(one.gamma)}
            if one.gamma
            else {"levels": list(one.levels), "relative": list(one.relative)}
            for c, one in light.curve.items()
        },
        "white_factor": float(light.white_factor),
        "uniformity": [float(a) for a in light.uniformity],
        "black": float(light.black),
        "spot_px": stimulator.spot_px,
        "dithering": stimulator.dithering,
        "uncertainty": {key: float(value) for key, value in stimulator.uncertainty.items()},
    }
    stream = io.StringIO()
    YAML().dump(data, stream)
    first = f"stimulator calibrated with boresight {__version__} on {(made or date.today()).isoformat()}"
    return "".join(f"# {line}\n" for line in [first, *head]) + stream.getvalue()


def read_stimulator(path: str | Path) -> Stimulator:
    """Read a file that `stimulator_yaml` wrote.

    Raises
    ------
    InputError
        For a file that cannot be read, with its fault in one line.
    """
    data = read_yaml(file_path("path", path), "give a stimulator file")
    try:
        return _stimulator_of(data, str(path))
    except KeyError as error:
        raise InputError(f"{path}: missing key {error}; boresight stimulate calibrate writes this file") from error
    except (TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{path}: is not a stimulator file ({' '.join(str(error).split())})") from error


def _stimulator_of(data: Any, where: str) -> Stimulator:
    camera = Camera.from_dict(data["collimator"], where)
    tilt_x, tilt_y = (float(tilt) for tilt in data["tilt_deg"])
    quaternion = np.array(data["alignment"], dtype=float)
    if quaternion.shape != (4,) or not math.isclose(float(np.linalg.norm(quaternion)), 1.0, abs_tol=1e-6):
        raise InputError(f"{where}: 'alignment' must be a unit quaternion of four numbers, scalar last")
    photometry = Photometry(
        (camera.width, camera.height),
        {str(c): float(m) for c, m in data["magnitude"].items()},
        {str(c): Curve(**one) for c, one in data["curve"].items()},
        float(data["white_factor"]),
        np.array(data["uniformity"], dtype=float),
        float(data["black"]),
    )
    return Stimulator(
        DisplayGeometry(camera, (tilt_x, tilt_y)),
        photometry,
        Attitude(quaternion, "collimator", "camera"),
        float(data["spot_px"]),
        str(data["dithering"]),
        {str(key): float(value) for key, value in data.get("uncertainty", {}).items()},
    )
