"""Identification of single images with a free focal length, which starts a calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from startracker.blind import solve_unknown_fov
from startracker.calibration.field import SkyPart, StarField, sky_part
from startracker.catalog.stars import StarCatalog
from startracker.core import FloatArray, IntArray
from startracker.geometry.camera import Camera
from startracker.geometry.distortion import Distortion
from startracker.geometry.lens_fit import Matches

_STATED_PX = 0.1
"""Error, px, of centroids given without one; only its uniformity matters."""


@dataclass(frozen=True, eq=False)
class KnownField:
    """An identified image."""

    field: StarField
    camera: Camera
    matrix: FloatArray
    """Its centroids, the camera fitted to it alone, and the corresponding attitude."""
    sky: SkyPart
    """Catalogue stars in its field."""
    pairs: IntArray
    """Index of the centroid and index in `sky` of each identified star, (M, 2)."""

    def sigma(self, floor_px: float = 0.0) -> FloatArray:
        """Standard error (N,) of each centroid on one axis, px, including catalogue errors and a floor."""
        variance = self.field.variance_px2
        own = np.full(len(self.field.xy), _STATED_PX**2) if variance is None else variance
        catalogue = (self.sky.catalog.position_sigma_rad / self.camera.pixel_rad) ** 2
        return np.asarray(np.sqrt(own + catalogue + floor_px**2))

    def matches(self, pairs: IntArray | None = None, floor_px: float = 0.0) -> Matches:
        """Stars for the fit: the identified ones, or other pairs."""
        p = self.pairs if pairs is None else pairs
        return Matches(self.field.xy[p[:, 0]], self.sky.directions[p[:, 1]], self.sigma(floor_px)[p[:, 0]])


def identify_all(
    fields: Sequence[StarField],
    camera: Camera | None,
    fov_deg: float | None,
    catalog: str | StarCatalog,
    table: StarCatalog,
) -> tuple[list[KnownField], dict[str, str]]:
    """Identified images, and reasons for the others by name; the camera of each image is tried for the next one."""
    known: list[KnownField] = []
    unsolved: dict[str, str] = {}
    parity = None
    rough = camera
    for one in fields:
        solution = solve_unknown_fov(
            one.xy,
            one.width,
            one.height,
            flux=one.flux,
            fov_deg=None if rough is not None else fov_deg,
            parity=parity,
            camera=rough,
            variance_px2=one.variance_px2,
            catalog=catalog,
            observer=one.observer,
        )
        if solution.attitude is None or solution.camera is None:
            unsolved[one.name] = solution.reason
            continue
        matrix = solution.attitude.as_matrix()
        sky = sky_part(table, one.observer, matrix, solution.camera)
        row = {(float(x), float(y)): k for k, (x, y) in enumerate(one.xy)}
        row_of = {int(number): j for j, number in enumerate(sky.catalog.id)}
        pairs = [
            (row[float(x), float(y)], row_of[int(number)])
            for (x, y), number in zip(solution.stars.fitted.xy, solution.stars.fitted.catalog_id, strict=True)
            if int(number) in row_of
        ]
        known.append(KnownField(one, solution.camera, matrix, sky, np.array(pairs, dtype=np.int64).reshape(-1, 2)))
        rough, parity = solution.camera, solution.camera.parity  # the same camera: used for the next image
    return known, unsolved


def starting_camera(known: list[KnownField], kind: str) -> Camera:
    """Initial camera: the median of those fitted to each image alone."""
    focal = float(np.median([k.camera.fx for k in known]))
    k1 = float(np.median([k.camera.distortion.k1 for k in known]))
    # r = tan θ (1 + k1 tan²θ) is θ (1 + (k1 + 1/3) θ²) to third order.
    lens = Distortion(k1=k1 if kind == "pinhole" else k1 + 1.0 / 3.0)
    return replace(known[0].camera, fx=focal, fy=focal, distortion=lens, projection=kind)
