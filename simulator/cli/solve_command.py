"""``boresight solve``: photographs, frames and centroid lists to attitudes."""

from __future__ import annotations

import io
import json
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.cli.checks import writable
from simulator.fits import catalog_attitude, read_fits
from simulator.frame import Frame
from simulator.paths import write_atomically
from startracker.blind import solve_unknown_fov
from startracker.camera import Camera
from startracker.errors import BoresightError, InputError
from startracker.image import read_image
from startracker.observer import Observer
from startracker.solution import Solution
from startracker.tracker import StarTracker
from startracker.wcs import wcs_header

_FITS_SUFFIXES = (".fits", ".fit", ".fts")
_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp", *_FITS_SUFFIXES)


_CALIBRATED_PX = 0.7
"""A list of centroids that fits worse than this is not from a camera of exactly the field given."""


@dataclass(frozen=True)
class SolveRequest:
    """What the command line asked for."""

    images: list[Path]
    fov_deg: float | None
    camera: Path | None
    method: str | None
    catalog: str
    magnitude_limit: float
    centroids: Path | None
    size: str | None
    lost_in_space: bool
    as_json: bool
    wcs: Path | None
    annotate: Path | None


@dataclass(frozen=True, eq=False)
class _Job:
    """One thing to solve: pixels or centroids, with whatever is known of the camera."""

    name: str
    width: int
    height: int
    camera: Camera | None
    image: NDArray[Any] | None = None
    xy: NDArray[np.float64] | None = None
    flux: NDArray[np.float64] | None = None
    saturation_dn: float | None = None
    frame: Frame | None = None


def solve_images(request: SolveRequest) -> int:
    """Solve all; exit status 0 when each is solved, 1 when some are not, 2 for bad input."""
    _check(request)
    solver = _Solver(request)
    status = 0
    for source in _sources(request):
        try:
            job = solver.load(source)
            solution = solver.solve(job)
        except BoresightError as error:
            print(error, file=sys.stderr)
            status = 2
            continue
        if request.as_json:
            print(json.dumps({"image": job.name, **_as_dict(solution)}, allow_nan=False))
        else:
            print(f"{job.name}: {_as_text(solution)}")
        if not solution.solved:
            status = max(status, 1)
        _write_outputs(request, job, solution)
    return status


def _check(request: SolveRequest) -> None:
    if not request.images and request.centroids is None:
        raise InputError("solve: name an image, a folder of images, or --centroids FILE.csv")
    if request.images and request.centroids is not None:
        raise InputError("solve: give images or --centroids, not both")
    if request.fov_deg is not None and request.camera is not None:
        raise InputError("--fov and --camera: give one of the two; a camera file holds its field of view")
    if request.fov_deg is not None and not 0.1 <= request.fov_deg <= 120:
        raise InputError(f"--fov: must be between 0.1 and 120 degrees, not {request.fov_deg:g}")
    if not math.isfinite(request.magnitude_limit):
        raise InputError("--magnitude-limit: must be a number")
    if (
        request.method is not None
        and request.fov_deg is None
        and request.camera is None
        and request.centroids is not None
    ):
        raise InputError("--method: needs --camera or --fov; without them the field of view is found out first")
    if request.centroids is not None and request.camera is None and request.size is None:
        raise InputError("--centroids: needs --camera, or --size WxH (and --fov where it is known)")
    for path in (request.wcs, request.annotate):
        writable(path)
        if path is not None and (len(request.images) > 1 or any(p.is_dir() for p in request.images)):
            raise InputError(f"{path}: --wcs and --annotate take one image at a time")


def _sources(request: SolveRequest) -> Iterator[Path]:
    if request.centroids is not None:
        yield request.centroids
    for path in request.images:
        if path.is_dir():
            found = sorted(p for p in path.iterdir() if p.suffix.lower() in _SUFFIXES)
            if not found:
                raise InputError(f"{path}: holds no image ({', '.join(_SUFFIXES)})")
            yield from found
        else:
            yield path


class _Solver:
    """Loads and solves; trackers are kept, as building one costs more than a solve."""

    def __init__(self, request: SolveRequest) -> None:
        self.request = request
        self.camera = Camera.from_yaml(request.camera) if request.camera else None
        self.trackers: dict[Camera, StarTracker] = {}

    def load(self, path: Path) -> _Job:
        if self.request.centroids is not None:
            return self._load_centroids(path)
        if path.suffix.lower() in _FITS_SUFFIXES and _is_our_frame(path):
            frame = read_fits(path)
            height, width = frame.image.shape
            camera = self.camera or self._from_fov(width, height) or frame.camera
            return _Job(str(path), width, height, camera, frame.image, saturation_dn=frame.saturation_dn, frame=frame)
        loaded = read_image(path)
        height, width = loaded.image.shape
        known = self.camera or self._from_fov(width, height)
        if self.camera is not None and (self.camera.width, self.camera.height) != (width, height):
            raise InputError(
                f"{path}: has {width}×{height} pixels, but the camera file {self.request.camera} is for "
                f"{self.camera.width}×{self.camera.height}"
            )
        return _Job(str(path), width, height, known, loaded.image, saturation_dn=loaded.saturation_dn)

    def _from_fov(self, width: int, height: int) -> Camera | None:
        return Camera.from_fov(self.request.fov_deg, width, height) if self.request.fov_deg else None

    def _load_centroids(self, path: Path) -> _Job:
        if self.camera is not None:
            width, height = self.camera.width, self.camera.height
        else:
            width, height = parse_size(self.request.size or "")
        xy, flux = read_centroids(path)
        return _Job(str(path), width, height, self.camera or self._from_fov(width, height), xy=xy, flux=flux)

    def solve(self, job: _Job) -> Solution:
        """Solve by what is known of the camera.

        A calibrated camera is taken at its word. A field of view given by hand is good to a few per cent: a
        photograph's focal length is fitted, and only where that fails, as it needs more stars, the number is taken
        for exact; a list of centroids the other way round. Without either everything is found out.
        """
        request = self.request
        by_hand = request.fov_deg is not None
        camera = job.camera
        if camera is None:
            return self._without_camera(job)
        if not by_hand or request.method is not None:
            return self._with_camera(job, camera)
        if job.xy is None:
            solution = self._without_camera(job)
            return solution if solution.solved else self._with_camera(job, camera)
        solution = self._with_camera(job, camera)
        if _residual_px(solution) <= _CALIBRATED_PX:
            return solution
        fitted = self._without_camera(job)
        return fitted if _residual_px(fitted) < _residual_px(solution) else solution

    def _without_camera(self, job: _Job) -> Solution:
        request = self.request
        if job.xy is not None:
            return solve_unknown_fov(
                job.xy, job.width, job.height, flux=job.flux, fov_deg=request.fov_deg, catalog=request.catalog
            )
        assert job.image is not None
        return solve_unknown_fov(
            job.image, fov_deg=request.fov_deg, catalog=request.catalog, saturation_dn=job.saturation_dn
        )

    def _with_camera(self, job: _Job, camera: Camera) -> Solution:
        request = self.request
        tracker = self.trackers.get(camera)
        if tracker is None:
            tracker = StarTracker(
                camera,
                catalog=request.catalog,
                magnitude_limit=request.magnitude_limit,
                identifier=request.method or "match_groups",
            )
            self.trackers[camera] = tracker
        if job.xy is not None:
            return tracker.solve_centroids(job.xy, job.flux)
        assert job.image is not None
        frame = job.frame
        if frame is None:
            return tracker.solve(job.image, saturation_dn=job.saturation_dn)
        return tracker.solve(
            frame.image,
            prior=None if request.lost_in_space else frame.prior,
            prior_deg=frame.prior_deg,
            observer=frame.observer,
            saturation_dn=frame.saturation_dn,
            gain_e_per_dn=frame.gain_e_per_dn,
        )


def _residual_px(solution: Solution) -> float:
    """Root mean square residual; infinite where there is no solution."""
    if not solution.matched:
        return math.inf
    return float(np.sqrt(np.mean(np.sum(solution.stars.residual_px**2, axis=1))))


def _is_our_frame(path: Path) -> bool:
    try:
        with path.open("rb") as stream:
            return b"CAM_FX  =" in stream.read(80 * 36 * 8)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error


def parse_size(text: str) -> tuple[int, int]:
    """Width and height of ``WxH``; `InputError` for anything else."""
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal() and int(width) and int(height)):
        raise InputError(f"--size: must be WIDTHxHEIGHT in pixels, such as 1024x768, not '{text}'")
    return int(width), int(height)


def read_centroids(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Centroids (N, 2) and, where there is a third column, fluxes (N,) of a CSV file.

    The first line may name the columns (x, y, flux in any order); lines that begin with # are left out.

    Raises
    ------
    InputError
        For a file that cannot be read or a line that is not numbers; names the line.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    except UnicodeDecodeError:
        raise InputError(
            f"{path}: is not a text file; --centroids needs a CSV with columns x, y and optionally flux"
        ) from None
    names = ["x", "y", "flux"]
    rows: list[list[float]] = []
    first = True
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        cells = [cell.strip() for cell in line.split(",")]
        if first and any(cell.lower() in ("x", "y") for cell in cells):
            names = [cell.lower() for cell in cells]
            first = False
            continue
        first = False
        try:
            rows.append([float(cell) for cell in cells])
        except ValueError:
            raise InputError(f"{path}:{number}: '{line.strip()}' is not a row of numbers x,y[,flux]") from None
        if len(cells) < 2 or len(cells) != len(rows[0]):
            raise InputError(f"{path}:{number}: has {len(cells)} columns; every row needs x, y and optionally flux")
    if not {"x", "y"} <= set(names):
        raise InputError(f"{path}:1: needs the columns x and y; found {', '.join(names)}")
    if not rows:
        return np.empty((0, 2)), None
    table = np.array(rows)
    column = {name: table[:, i] for i, name in enumerate(names[: table.shape[1]])}
    return np.stack([column["x"], column["y"]], axis=1), column.get("flux")


def _as_dict(solution: Solution) -> dict[str, Any]:
    stars = solution.stars
    return {
        "status": str(solution.status),
        "reason": solution.reason,
        "ra_deg": solution.ra_deg,
        "dec_deg": solution.dec_deg,
        "roll_deg": solution.roll_deg,
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
            }
            for xy, number, name, magnitude, residual in zip(
                stars.xy, stars.catalog_id, stars.name, stars.v_mag, stars.residual_px, strict=True
            )
        ],
        "times_ms": {stage: round(float(value), 3) for stage, value in solution.times_ms.items()},
    }


def _as_text(solution: Solution) -> str:
    if not solution.solved:
        return f"{solution.status}: {solution.reason}"
    field = f"  field {solution.fov_deg:.3f}°" if solution.fov_deg else ""
    rmse = f", residual {solution.rmse_arcsec:.1f}″ rms" if solution.rmse_arcsec is not None else ""
    mirrored = ", mirrored" if solution.parity < 0 else ""
    return (
        f"solved  RA {solution.ra_deg:.4f}°  Dec {solution.dec_deg:+.4f}°  roll {solution.roll_deg:.3f}°{field}  "
        f"({solution.matched} of {len(solution.centroids)} stars identified{rmse}{mirrored}; "
        f"{solution.times_ms.get('total', 0.0):.0f} ms)"
    )


def _write_outputs(request: SolveRequest, job: _Job, solution: Solution) -> None:
    if request.wcs is not None and solution.attitude is not None and solution.camera is not None:
        from astropy.io import fits

        observer = job.frame.observer if job.frame else Observer()
        # with the picture itself: what it holds can be laid over a chart as it is
        pixels = np.zeros((job.height, job.width), np.uint8) if job.image is None else np.asarray(job.image)
        unit = fits.PrimaryHDU(pixels)
        unit.header.update(wcs_header(solution.camera, catalog_attitude(solution.attitude, observer)))
        buffer = io.BytesIO()
        unit.writeto(buffer)
        write_atomically(request.wcs, buffer.getvalue())
    if request.annotate is not None:
        from simulator.study.plots import save_bytes, solved_image

        picture = job.image if job.image is not None else np.zeros((job.height, job.width))
        write_atomically(request.annotate, save_bytes(solved_image(picture, solution)))
