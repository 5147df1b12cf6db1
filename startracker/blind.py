"""Solving photographs whose focal length is known roughly or not at all; the camera is fitted along."""

from __future__ import annotations

import contextlib
import functools
import math
import os
import tempfile
import zipfile
import zlib
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker import centroid as centroiding
from startracker import detection as detecting
from startracker.attitude import Attitude
from startracker.camera import Camera
from startracker.catalog import cache, load_catalog
from startracker.catalog.guide import GuideDatabase
from startracker.catalog.stars import StarCatalog
from startracker.errors import InputError
from startracker.front_end import Clock, clean_centroids, find_stars
from startracker.identification import free_scale
from startracker.identification.free_scale import FOV_BANDS_DEG, FreeFit
from startracker.identification.quads import QuadIndex, build_quads
from startracker.observer import Observer
from startracker.registry import lookup
from startracker.settings import CentroidSettings, DetectionSettings, IdentificationSettings
from startracker.solution import MatchedStars, Solution, Status

__all__ = ["solve_unknown_fov"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_MAGNITUDE_LIMIT = 9.0
_REFERENCE = Camera.from_fov(4.0, 1024, 1024)  # the finest: doubles closer than 28″ are one
_CACHE_KEY = "quads-1"


def solve_unknown_fov(
    source: ArrayLike,
    width: int | None = None,
    height: int | None = None,
    *,
    flux: ArrayLike | None = None,
    fov_deg: float | None = None,
    fov_error: float = 0.05,
    parity: int | None = None,
    catalog: str | StarCatalog = "hipparcos",
    detector: str = "components",
    centroider: str = "moment",
    detection: DetectionSettings | None = None,
    centroid: CentroidSettings | None = None,
    identification: IdentificationSettings | None = None,
    observer: Observer | None = None,
    saturation_dn: float | None = None,
    gain_e_per_dn: float | None = None,
) -> Solution:
    """Attitude, focal length, radial distortion and parity of a photograph of the sky.

    Parameters
    ----------
    source : array_like
        An image (H, W); or, with `width` and `height` given, centroids (N, 2) in pixels.
    width, height : int, optional
        Size of the image that the centroids are from.
    flux : array_like, shape (N,), optional
        Signal of the centroids; without it their order counts as the order of brightness.
    fov_deg : float, optional
        Field across the width as far as it is known; None: anything from 3° to 72°.
    fov_error : float
        Relative error of `fov_deg`, at most.
    parity : int, optional
        +1 as seen, −1 mirrored; None: both are tried.
    catalog, detector, centroider, detection, centroid, identification
        As for `StarTracker`.
    observer : Observer, optional
        As for `StarTracker.solve`.
    saturation_dn, gain_e_per_dn : float, optional
        Of the detector, where known.

    Returns
    -------
    Solution
        With the fitted `camera`; `fov_deg` and `parity` are the measured ones. Never raises for what the image shows.

    Raises
    ------
    InputError
        For an unknown name, a field of view, parity or size that cannot be.
    """
    if fov_deg is not None and not 0.5 <= fov_deg <= 120.0:
        raise InputError(f"a field of view must be between 0.5° and 120° here; got {fov_deg}°")
    if not 0.0 < fov_error < 1.0:
        raise InputError(f"fov_error must be a relative error between 0 and 1; got {fov_error}")
    if parity not in (None, 1, -1):
        raise InputError(f"parity must be 1, -1 or None; got {parity}")
    if (width is None) != (height is None):
        raise InputError("centroids need both the width and the height of their image")
    clock = Clock()
    signal: FloatArray | None
    if width is None or height is None:
        found = find_stars(
            source,
            lookup("detectors", detecting.METHODS, detector),
            lookup("centroiders", centroiding.METHODS, centroider),
            detection or DetectionSettings(),
            centroid or CentroidSettings(),
            clock,
            saturation_dn=saturation_dn,
            gain_e_per_dn=gain_e_per_dn,
        )
        if found.status is not None:
            return Solution(found.status, found.reason, times_ms=clock.times_ms())
        height, width = np.shape(source)
        xy, signal = found.xy, found.flux
    else:
        if not (width > 0 and height > 0):
            raise InputError(f"an image needs a size in pixels; got {width}×{height}")
        xy, signal = clean_centroids(source, flux, Camera.from_fov(10.0, int(width), int(height)))
    search = FreeSearch(
        xy, signal, int(width), int(height), catalog, identification or IdentificationSettings(), observer
    )
    solution = search.run(_bands(fov_deg, fov_error), (1, -1) if parity is None else (parity,))
    clock.lap("identification")
    return replace(solution, times_ms=clock.times_ms())


def _bands(fov_deg: float | None, fov_error: float) -> tuple[tuple[float, float, float], ...]:
    """Least, assumed and largest field of each search."""
    if fov_deg is None:
        return FOV_BANDS_DEG
    return ((fov_deg * (1.0 - fov_error), fov_deg, fov_deg * (1.0 + fov_error)),)


@dataclass(eq=False)
class FreeSearch:
    """One image's stars and the search for them with the focal length free.

    Parameters
    ----------
    xy : (N, 2)
        Centroids, brightest first.
    flux : (N,), optional
        All positive.
    width, height : int
        Of the image.
    catalog : str or StarCatalog
    settings : IdentificationSettings
        For the false-alarm rate.
    observer : Observer, optional
    """

    xy: FloatArray
    flux: FloatArray | None
    width: int
    height: int
    catalog: str | StarCatalog
    settings: IdentificationSettings
    observer: Observer | None
    trials: int = 0

    def run(self, bands: tuple[tuple[float, float, float], ...], sides: tuple[int, ...]) -> Solution:
        """Search band by band and side by side until something is accepted beyond doubt."""
        xy, needed = self.xy, free_scale.FEWEST_MATCHED
        if len(xy) < needed:
            status = Status.TOO_FEW_STARS if len(xy) else Status.NO_STARS
            reason = f"{len(xy)} stars seen, {needed} are needed where the focal length is not known"
            return Solution(status, reason, centroids=xy)
        sky = all_stars(self.catalog).seen_by(self.observer)
        limit = math.log(self.settings.false_alarm_rate)
        best: FreeFit | None = None
        for low, middle, high in bands:
            guide = sky.brightest(_depth(len(xy), self.width, self.height, low))
            for side in sides:
                assumed = replace(Camera.from_fov(middle, self.width, self.height), parity=side)
                found = free_scale.candidates(xy, assumed, quad_index(self.catalog), low / middle, high / middle)
                for camera, pattern, centre, extent in found:
                    self.trials += 1
                    fit = self._try(camera, pattern, centre, extent, sky.directions, guide)
                    if fit is None or (best is not None and fit.log_evidence <= best.log_evidence):
                        continue
                    best = fit
                    if self._log_chance(best) < limit - 7.0:
                        return self._answer(best, sky)
        if best is None:
            reason = f"{len(xy)} stars seen; of {self.trials} patterns alike in the sky none brings {needed} to agree"
            return Solution(Status.NO_MATCH, reason, centroids=xy)
        chance = self._log_chance(best)
        if chance < limit:
            return self._answer(best, sky)
        says = f"the best of {self.trials} patterns explains {len(best.pairs)} of {len(xy)} stars"
        if chance < 0.0:
            reason = f"{says}: by chance with probability {math.exp(chance):.0e}"
            return Solution(Status.AMBIGUOUS, f"{reason}, above the limit", centroids=xy)
        return Solution(Status.NO_MATCH, f"{says}: no better than chance", centroids=xy)

    def _log_chance(self, fit: FreeFit) -> float:
        return math.log(max(self.trials, 1)) - fit.log_evidence

    def _magnitudes(self) -> FloatArray | None:
        return None if self.flux is None else -2.5 * np.log10(self.flux)

    def _try(
        self,
        camera: Camera,
        pattern: IntArray,
        centre: FloatArray,
        extent: float,
        directions: FloatArray,
        guide: GuideDatabase,
    ) -> FreeFit | None:
        xy, (stars, chosen) = self.xy, pattern
        matrix = free_scale.attitude_of(camera, xy[stars], directions[chosen])
        off = camera.project(directions[chosen] @ matrix.T) - xy[stars]
        if not np.hypot(off[:, 0], off[:, 1]).max() < 2.0 + 0.03 * extent:  # NaN too
            return None
        away = np.hypot(*(xy - centre).T)
        grown = free_scale.grow(camera, matrix, xy, guide, centre, 2.0 + 0.012 * np.maximum(away, extent))
        if grown is None:
            return None
        camera, matrix, covariance, rms, _ = grown
        value, pairs = free_scale.weigh(camera, matrix, xy, self._magnitudes(), guide, anchors=4)
        return FreeFit(camera, matrix, pairs, covariance, rms, value) if len(pairs) else None

    def _answer(self, fit: FreeFit, sky: GuideDatabase) -> Solution:
        """Solution of an accepted fit: once more with all stars of the catalogue that bright."""
        xy, chance = self.xy, self._log_chance(fit)
        used, chosen = fit.pairs[:, 0], fit.pairs[:, 1]
        residual = xy[used] - fit.camera.project(sky.directions[chosen] @ fit.matrix.T)
        stars = MatchedStars(
            xy[used],
            sky.catalog.id[chosen],
            sky.catalog.star_name[chosen],
            sky.v_mag[chosen],
            np.full(len(used), np.nan) if self.flux is None else self.flux[used],
            residual,
        )
        exponent = math.floor(min(chance, 0.0) / math.log(10.0))
        reason = f"{len(used)} of {len(xy)} stars fit, {self.trials} patterns tried; chance 1e{exponent}"
        return Solution(
            Status.SOLVED,
            reason,
            Attitude.from_matrix(fit.matrix),
            fit.covariance,
            stars,
            xy,
            _field_deg(fit.camera),
            fit.camera.parity,
            camera=fit.camera,
        )


def _field_deg(camera: Camera) -> float:
    """Angle across the width, edge to edge, distortion included."""
    left, right = camera.unproject([[-0.5, camera.cy], [camera.width - 0.5, camera.cy]])
    return math.degrees(math.acos(min(1.0, float(left @ right))))


def _depth(stars: int, width: int, height: int, fov_deg: float) -> int:
    """Brightest stars of the sky that reach three times as deep as the image's stars, where they are evenly spread."""
    side = math.radians(fov_deg)
    field = side * side * min(height / width, 1.0)
    return max(500, int(3.0 * (stars + 5) * 4.0 * math.pi / field))


@functools.cache
def all_stars(catalog: str | StarCatalog) -> GuideDatabase:
    """Guide stars to V = 9 for every field, brightest first."""
    return GuideDatabase.build(
        load_catalog(catalog) if isinstance(catalog, str) else catalog, _REFERENCE, _MAGNITUDE_LIMIT
    )


@functools.cache
def quad_index(catalog: str | StarCatalog) -> QuadIndex:
    """Patterns of the whole sky; made in about two seconds, then kept in the user's cache folder (45 MB)."""
    stars = all_stars(catalog)
    # the stars' number and places are part of the name: another edition of the catalogue is another index
    mark = zlib.crc32(np.ascontiguousarray(stars.directions).tobytes())
    file = cache.folder() / f"{_CACHE_KEY}-{mark:08x}.npz"
    try:
        with np.load(file, allow_pickle=False) as stored:
            return QuadIndex.of(stored["codes"], stored["quads"], stored["baseline_rad"])
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        pass
    codes, quads, baseline_rad = build_quads(stars.directions)
    temporary = ""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=file.parent, suffix=".tmp", delete=False) as stream:
            temporary = stream.name
            np.savez(stream, allow_pickle=False, codes=codes, quads=quads, baseline_rad=baseline_rad)
        os.replace(temporary, file)
    except OSError:  # the cache only saves time
        with contextlib.suppress(OSError):
            os.unlink(temporary)
    return QuadIndex.of(codes, quads, baseline_rad)
