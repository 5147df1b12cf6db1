"""The calibrated camera: conversion between pixels and unit vectors.

Pixel centres have integer coordinates, (0, 0) is the centre of the first pixel; points are (x, y) = (column, row).
"""

from __future__ import annotations

import contextlib
import functools
import io
import math
import os
import tempfile
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.arguments import file_path, of_kind, real_array, real_number, text, whole_number
from startracker.core import FloatArray
from startracker.display import described
from startracker.errors import InputError
from startracker.files import read_yaml
from startracker.geometry.distortion import Distortion
from startracker.geometry.fisheye import PROJECTIONS, fisheye_unproject, limit_rad
from startracker.geometry.image_map import EQUISOLID, LENS, LIMIT_RAD, ImageMap, image_map, to_directions, to_pixels


@dataclass(frozen=True)
class Camera:
    """Pinhole camera with Brown–Conrady distortion, or a fisheye.

    Parameters
    ----------
    fx, fy : float
        Focal length in pixels along columns and rows.
    cx, cy : float
        Principal point in pixels.
    width, height : int
        Size in pixels; if omitted, the principal point is taken as the image centre.
    distortion : Distortion or mapping
        Coefficients with OpenCV's names: Brown–Conrady on normalised coordinates for a pinhole, k1 to k4 of the powers
        of the angle for a fisheye (`startracker.geometry.fisheye`).
    parity : int
        +1 for a direct image (east to the left of north), −1 for an image mirrored by the optics or the readout, whose
        columns are reversed first.
    projection : str
        ``pinhole``, ``fisheye`` (Kannala–Brandt as in OpenCV), or ideal: ``equidistant``, ``equisolid``.
    row_time_s : float
        Rolling shutter: delay between the exposure starts of successive rows; 0 for a global shutter. A frame's
        attitude is that at the middle of the exposure of its middle row.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: int = 0
    height: int = 0
    distortion: Distortion = field(default_factory=Distortion)
    parity: int = 1
    projection: str = "pinhole"
    row_time_s: float = 0.0

    def __post_init__(self) -> None:
        if isinstance(self.distortion, dict):
            object.__setattr__(self, "distortion", _distortion(self.distortion))
        of_kind("distortion", self.distortion, Distortion)
        for name in ("fx", "fy", "cx", "cy", "row_time_s"):  # Python numbers, which YAML can represent
            object.__setattr__(self, name, real_number(name, getattr(self, name), finite=False))
        for name in ("width", "height", "parity"):
            object.__setattr__(self, name, whole_number(name, getattr(self, name)))
        if not (self.fx > 0 and self.fy > 0 and math.isfinite(self.fx * self.fy)):
            raise InputError(f"the focal length must be positive; got fx = {self.fx}, fy = {self.fy} pixels")
        if not math.isfinite(self.row_time_s):
            raise InputError(f"row_time_s must be a finite time in seconds; got {self.row_time_s}")
        if not math.isfinite(self.cx + self.cy):
            raise InputError(f"the principal point must be finite; got cx = {self.cx}, cy = {self.cy} pixels")
        self._check_projection()
        if self.parity not in (1, -1):
            raise InputError(f"parity must be 1 or -1; got {self.parity}")
        object.__setattr__(self, "width", self.width or round(2 * self.cx + 1))
        object.__setattr__(self, "height", self.height or round(2 * self.cy + 1))
        if self.width < 1 or self.height < 1:
            raise InputError(f"an image needs at least one pixel; got {self.width}×{self.height}")

    def __repr__(self) -> str:
        lens = [f"{name}={value:g}" for name, value in asdict(self.distortion).items() if value]
        centred = (self.cx, self.cy) == ((self.width - 1) / 2, (self.height - 1) / 2)
        return described(
            "Camera",
            f"{self.fov_deg:.2f}° × {self.fov_y_deg:.2f}°",
            f"{self.width}×{self.height} px",
            f"f {self.fx:.2f} px" if self.fx == self.fy else f"fx {self.fx:.2f} px, fy {self.fy:.2f} px",
            "" if centred else f"centre ({self.cx:.1f}, {self.cy:.1f})",
            *lens,
            "" if self.projection == "pinhole" else self.projection,
            "mirrored" if self.parity < 0 else "",
            f"rolling shutter {1e6 * self.row_time_s:g} µs per row" if self.row_time_s else "",
        )

    def _check_projection(self) -> None:
        if text("projection", self.projection) not in PROJECTIONS:
            raise InputError(
                f"projection must be {', '.join(PROJECTIONS[:-1])} or {PROJECTIONS[-1]}; got {self.projection!r}"
            )
        if self.projection == "pinhole":
            return
        lens = self.distortion
        known = ("k1", "k2", "k3", "k4") if self.projection == "fisheye" else ()
        for key in (f.name for f in fields(Distortion)):
            if getattr(lens, key) and key not in known:
                hint = "it has k1, k2, k3, k4" if known else "it has none; projection: fisheye takes k1 to k4"
                raise InputError(f"the projection {self.projection} has no coefficient {key}; {hint}")

    # ------------------------------------------------------------------ construction
    @classmethod
    def from_fov(
        cls,
        fov_deg: float,
        width: int,
        height: int,
        distortion: Distortion | None = None,
        projection: str = "pinhole",
    ) -> Camera:
        """Camera with square pixels and a centred principal point; `fov_deg` (degrees, or an astropy quantity) is the
        undistorted field of view across the full width, edge to edge."""
        fov_deg = real_number("fov_deg", fov_deg, unit="deg", finite=False)
        width, height = whole_number("width", width), whole_number("height", height)
        most = 180 if text("projection", projection) == "pinhole" else 360
        if not 0 < fov_deg < most:
            raise InputError(f"a field of view must be between 0° and {most}°; got {fov_deg}°")
        half = math.radians(fov_deg) / 2
        if projection == "pinhole":
            reach = math.tan(half)
        else:
            reach = 2 * math.sin(half / 2) if projection == "equisolid" else half
        focal = width / 2 / reach
        return cls(
            focal,
            focal,
            (width - 1) / 2,
            (height - 1) / 2,
            width,
            height,
            Distortion() if distortion is None else distortion,
            projection=projection,
        )

    @classmethod
    def from_yaml(cls, path: str | os.PathLike[str]) -> Camera:
        """Camera from a YAML file whose keys are the parameters of this class; `InputError` reports every fault."""
        return cls.from_dict(read_yaml(file_path("path", path), "give a camera file"), where=str(path))

    @classmethod
    def from_dict(cls, data: Any, where: str = "camera") -> Camera:
        """Camera from plain values, with each wrong key or type named."""
        names = [f.name for f in fields(cls)]
        if not isinstance(data, dict) or not data.keys() & {"fx", "fy", "cx", "cy"}:
            raise InputError(
                f"{where}: is not a camera file: it has none of the keys fx, fy, cx, cy; boresight calibrate writes one"
            )
        distortion = data.get("distortion") or {}
        faults = [f"unknown key '{key}'" for key in data if key not in names]
        faults += [f"missing key '{key}'" for key in ("fx", "fy", "cx", "cy") if key not in data]
        if isinstance(distortion, dict):
            known = [f.name for f in fields(Distortion)]
            faults += [f"unknown key 'distortion.{key}'" for key in distortion if key not in known]
        else:
            faults.append("'distortion' must hold k1, k2, p1, p2, k3 …")
            distortion = {}
        numbers = {k: v for k, v in data.items() if k not in ("distortion", "projection")} | {
            f"distortion.{k}": v for k, v in distortion.items()
        }
        faults += [
            f"'{key}' must be a finite number, not {value!r}" for key, value in numbers.items() if not _is_finite(value)
        ]
        if faults:
            raise InputError(f"{where}: {'; '.join(faults)}")
        try:
            return cls(**{**data, "distortion": Distortion(**distortion)})
        except InputError as error:
            raise InputError(f"{where}: {error}") from error

    def to_dict(self) -> dict[str, Any]:
        """Plain values in the form that `from_dict` reads."""
        data = asdict(self)
        data["distortion"] = {key: float(value) for key, value in data["distortion"].items()}
        return data

    def to_yaml(self, path: str | os.PathLike[str]) -> None:
        """Write a file for `from_yaml`, atomically: a temporary file in the same folder is renamed.

        Raises
        ------
        InputError
            If the file cannot be written.
        """
        from ruamel.yaml import YAML

        written, target, temporary = io.StringIO(), file_path("path", path), ""
        YAML().dump(self.to_dict(), written)
        try:
            with tempfile.NamedTemporaryFile("wb", dir=target.parent, prefix=f".{target.name}.", delete=False) as file:
                temporary = file.name
                file.write(written.getvalue().encode())
            os.chmod(temporary, 0o644)
            os.replace(temporary, target)
        except OSError as error:
            with contextlib.suppress(OSError):
                os.unlink(temporary)
            raise InputError(f"{path}: cannot be written ({error.strerror}); choose another path") from error

    # ------------------------------------------------------------------ derived quantities
    @functools.cached_property
    def fov_deg(self) -> float:
        """Field of view across the full width, edge to edge, along the row of the principal point, with distortion."""
        return self._seen_deg([[-0.5, self.cy], [self.width - 0.5, self.cy]], self.undistorted_fov_deg)

    @property
    def fov_y_deg(self) -> float:
        """Field of view over the full height, degrees, defined as `fov_deg`."""
        undistorted = self._span_deg((self.cy + 0.5) / self.fy, (self.height - 0.5 - self.cy) / self.fy)
        return self._seen_deg([[self.cx, -0.5], [self.cx, self.height - 0.5]], undistorted)

    @property
    def fov_text(self) -> str:
        """Field of view as every command, explanation, picture and report states it: width × height, 0.001°."""
        return f"{self.fov_deg:.3f}° × {self.fov_y_deg:.3f}°"

    @property
    def undistorted_fov_deg(self) -> float:
        """Field of view across the width from the focal length alone, as in `from_fov`.

        The distortion of a pinhole is excluded; the polynomial of a fisheye is its projection and is included.
        """
        return self._span_deg((self.cx + 0.5) / self.fx, (self.width - 0.5 - self.cx) / self.fx)

    def _seen_deg(self, edges: list[list[float]], undistorted_deg: float) -> float:
        """Angle between the directions of two pixels, degrees; the undistorted one if they are beyond the fold of the
        lens model."""
        if self.projection != "pinhole" or self.distortion == Distortion():
            return undistorted_deg
        one, other = self.unproject(edges)
        angle = math.degrees(math.atan2(float(np.linalg.norm(np.cross(one, other))), float(one @ other)))
        return angle if math.isfinite(angle) else undistorted_deg

    def _span_deg(self, low: float, high: float) -> float:
        """Angle, degrees, between two edges at these distances, in focal lengths, on either side of the principal
        point."""
        if self.projection == "pinhole":
            return math.degrees(math.atan(low) + math.atan(high))
        angles = [math.copysign(self._angle_rad(abs(edge)), edge) for edge in (low, high)]
        return math.degrees(angles[0] + angles[1])

    def _angle_rad(self, radius: float) -> float:
        """Off-axis angle, rad, for a radius on a fisheye image; outside the image circle, the angle of its edge."""
        image = self.image_map
        edge = np.array([[radius, 0.0]])
        vector = fisheye_unproject(edge, image[LENS:], bool(image[EQUISOLID]), self.limit_rad)[0]
        return math.atan2(vector[0], vector[2]) if math.isfinite(vector[2]) else self.limit_rad

    @property
    def limit_rad(self) -> float:
        """Largest angle from the boresight that the camera can image: 89.9° for a pinhole, the edge of the image circle
        for a fisheye."""
        return float(self.image_map[LIMIT_RAD])

    @functools.cached_property
    def half_diagonal_rad(self) -> float:
        """Largest angle between the boresight and a corner of the image, distortion included."""
        x, y = (-0.5, self.width - 0.5), (-0.5, self.height - 0.5)
        corners = np.array([[a, b] for a in x for b in y])
        radius = np.hypot((corners[:, 0] - self.cx) / self.fx, (corners[:, 1] - self.cy) / self.fy)
        if self.projection != "pinhole":
            return max(self._angle_rad(float(r)) for r in radius)
        # A corner beyond the fold of the lens model has no direction; the undistorted pinhole is used there.
        cosine = self.unproject(corners)[:, 2]
        angle = np.where(np.isfinite(cosine), np.arccos(np.clip(cosine, -1.0, 1.0)), np.arctan(radius))
        return float(angle.max())

    @functools.cached_property
    def pixel_rad(self) -> float:
        """Angle of one pixel at the centre of the field, radians."""
        return 1.0 / math.sqrt(self.fx * self.fy)

    @functools.cached_property
    def image_map(self) -> ImageMap:
        """The parameters of `project` and `unproject` in the form that kernels read."""
        lens, pinhole = self.distortion, self.projection == "pinhole"
        powers = (lens.k1, lens.k2, lens.k3, lens.k4)
        return image_map(
            # A mirrored image has a negative focal length along the columns.
            (self.parity * self.fx, self.fy),
            (self.cx, self.cy),
            (self.width, self.height),
            self.projection,
            math.radians(89.9) if pinhole else limit_rad(powers),
            lens.as_array() if pinhole else np.array(powers),
        )

    # ------------------------------------------------------------------ projection
    def project(self, vectors: ArrayLike) -> FloatArray:
        """Pixels (N, 2) of camera-frame vectors (N, 3); NaN for directions outside the camera's limit.

        The limit is below 90° from the boresight for a pinhole and the edge of the image circle for a fisheye
        (`limit_rad`). A pinhole's distortion polynomial is only valid near the field; far outside it can fold back into
        the image, so select by angle first (`half_diagonal_rad`).
        """
        v = _rows("vectors", vectors, 3)
        return np.asarray(to_pixels(v, self.image_map))

    def unproject(self, xy: ArrayLike) -> FloatArray:
        """Unit vectors (N, 3) in the camera frame of pixels (N, 2).

        NaN where the distortion cannot be inverted, and outside the image circle of a fisheye.
        """
        p = _rows("pixels", xy, 2)
        return np.asarray(to_directions(p, self.image_map))

    def contains(self, xy: FloatArray, margin_px: float = 0.0) -> NDArray[np.bool_]:
        """Whether pixels (N, 2) lie on the image, enlarged by a margin."""
        xy = _rows("pixels", xy, 2)
        margin_px = real_number("margin_px", margin_px)
        return (
            (xy[:, 0] >= -0.5 - margin_px)
            & (xy[:, 0] < self.width - 0.5 + margin_px)
            & (xy[:, 1] >= -0.5 - margin_px)
            & (xy[:, 1] < self.height - 0.5 + margin_px)
        )


def as_camera(name: str, given: Any) -> Camera:
    """Argument as a camera: a `Camera`, or the name of a file for `Camera.from_yaml`.

    Raises
    ------
    InputError
        For anything else, or a file that is not one of a camera.
    """
    if isinstance(given, str | os.PathLike):
        return Camera.from_yaml(given)
    return of_kind(name, given, Camera, "or the name of a camera file")


def _rows(name: str, given: ArrayLike, columns: int) -> FloatArray:
    """Rows (N, columns) of real numbers, also from a single one of the shape (columns,)."""
    table = real_array(name, given, finite=False)
    table = table[None] if table.ndim < 2 else table
    if table.ndim != 2 or table.shape[1] != columns:
        raise InputError(f"{name} must have the shape (N, {columns}); got {np.shape(given)}")
    return table


def _distortion(values: dict[str, Any]) -> Distortion:
    """Distortion of a mapping from the names of its coefficients."""
    known = [f.name for f in fields(Distortion)]
    if unknown := [name for name in values if name not in known]:
        raise InputError(f"distortion has no coefficient {unknown[0]!r}; it has {', '.join(known)}")
    return Distortion(**values)


def _is_finite(value: Any) -> bool:
    try:
        real_number("value", value)
    except InputError:
        return False
    return True
