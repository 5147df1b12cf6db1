"""``boresight solve``: photographs, frames and centroid lists to attitudes."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.cli.checks import picture_format, writable
from simulator.cli.photograph_requests import PARITIES, SolveRequest
from simulator.cli.solve_output import as_dict, as_text, write_picture, write_wcs
from simulator.fits import read_fits
from simulator.frame import Frame
from startracker.blind import solve_unknown_fov
from startracker.camera import Camera
from startracker.detection import mask_pixels
from startracker.errors import BoresightError, InputError
from startracker.image import read_image
from startracker.solution import Solution, Status
from startracker.trace import Step
from startracker.tracker import StarTracker

FITS_SUFFIXES = (".fits", ".fit", ".fts")
_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp", *FITS_SUFFIXES)


_SMALLEST_PX = 16
_CALIBRATED_PX = 0.7
"""A list of centroids that fits worse than this is not from a camera of exactly the field given."""


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
    notes: tuple[str, ...] = ()

    def pixels(self) -> NDArray[Any]:
        """The image; black where a list of centroids was solved."""
        return np.zeros((self.height, self.width), np.uint8) if self.image is None else np.asarray(self.image)


def main(request: SolveRequest) -> int:
    """Solve all; exit status 0 when each is solved, 1 when some are not, 2 for bad input."""
    _check(request)
    points = _points(request)
    solver = _Solver(request)
    status = 0
    for source in [request.centroids] if request.centroids else image_files(request.images or ()):
        try:
            job = solver.load(source)
            solution = solver.solve(job)
        except BoresightError as error:
            print(error, file=sys.stderr)
            status = 2
            continue
        if not solution.solved:
            status = max(status, 1)
        observer = job.frame.observer if job.frame else None
        if request.as_json:
            answer = as_dict(solution, points, observer)
            print(json.dumps({"image": job.name, **answer, "notes": list(job.notes)}, allow_nan=False))
        else:
            if request.explain:
                solution = replace(solution, steps=(*(Step("file", note) for note in job.notes), *solution.steps))
            print(f"{job.name}: {as_text(solution, points, observer, explain=request.explain)}")
        try:
            if request.wcs is not None:
                write_wcs(request.wcs, solution, job.pixels(), observer)
            if request.annotate is not None:
                catalog, options = request.catalog, {"grid": request.grid, "constellations": request.constellations}
                write_picture(request.annotate, solution, job.pixels(), observer, catalog=catalog, **options)
        except BoresightError as error:
            print(error, file=sys.stderr)
            status = 2
    return status


def _check(request: SolveRequest) -> None:
    images = request.images or []
    if not images and request.centroids is None:
        raise InputError("solve: name an image, a folder of images, or --centroids FILE.csv")
    if images and request.centroids is not None:
        raise InputError("solve: give images or --centroids, not both")
    if request.fov_deg is not None and request.camera is not None:
        raise InputError("--fov and --camera: give one of the two; a camera file holds its field of view")
    if request.fov_deg is not None and not 0.1 <= request.fov_deg <= 120:
        raise InputError(f"--fov: must be between 0.1 and 120 degrees, not {request.fov_deg:g}")
    if not math.isfinite(request.magnitude_limit):
        raise InputError("--magnitude-limit: must be a number")
    if request.centroids is not None and request.camera is None and request.size is None:
        raise InputError("--centroids: needs --camera, or --size WxH (and --fov where it is known)")
    if request.parity is not None and request.parity not in PARITIES:
        raise InputError(f"--parity: must be {', '.join(PARITIES)}, not '{request.parity}'")
    if request.annotate is None and (request.grid or request.constellations):
        raise InputError("--grid and --constellations: draw on the picture of --annotate OUT.png; give that too")
    writable(request.wcs)
    picture_format(request.annotate)
    for path in (request.wcs, request.annotate):
        if path is not None and (len(images) > 1 or any(p.is_dir() for p in images)):
            raise InputError(f"{path}: --wcs and --annotate take one image at a time")


def _points(request: SolveRequest) -> NDArray[np.float64]:
    """Pixels (N, 2) asked for."""
    return np.array([parse_pixel(text) for text in request.pixels or ()]).reshape(-1, 2)


def image_files(paths: Sequence[Path]) -> Iterator[Path]:
    """Files, those of folders in their position; `InputError` for a folder without images, when it is reached."""
    for path in paths:
        found = sorted(p for p in path.iterdir() if p.suffix.lower() in _SUFFIXES) if path.is_dir() else [path]
        if not found:
            raise InputError(f"{path}: holds no image ({', '.join(_SUFFIXES)})")
        yield from found


class _Solver:
    """Loads and solves; trackers are kept, as building one costs more than a solve."""

    def __init__(self, request: SolveRequest) -> None:
        self.request = request
        self.camera = Camera.from_yaml(request.camera) if request.camera else None
        self.bad_pixels = read_image(request.bad_pixels).image != 0.0 if request.bad_pixels else None
        self.trackers: dict[Camera, StarTracker] = {}

    def load(self, path: Path) -> _Job:
        if self.request.centroids is not None:
            return self._load_centroids(path)
        if path.suffix.lower() in FITS_SUFFIXES and is_our_frame(path):
            frame = read_fits(path)
            height, width = frame.image.shape
            camera = self.camera or self._from_fov(width, height) or frame.camera
            frame = replace(frame, image=self._without_bad_pixels(frame.image))
            return _Job(str(path), width, height, camera, frame.image, saturation_dn=frame.saturation_dn, frame=frame)
        # a camera file and a map of bad pixels know the sensor's own rows and columns
        upright = self.camera is None and self.bad_pixels is None
        loaded = read_image(path, bayer=self.request.bayer, upright=upright)
        height, width = loaded.image.shape
        known = self.camera or self._from_fov(width, height)
        if self.camera is not None and (self.camera.width, self.camera.height) != (width, height):
            raise InputError(
                f"{path}: has {width}×{height} pixels, but the camera file {self.request.camera} is for "
                f"{self.camera.width}×{self.camera.height}"
            )
        image = self._without_bad_pixels(loaded.image)
        return _Job(str(path), width, height, known, image, saturation_dn=loaded.saturation_dn, notes=loaded.notes)

    def _without_bad_pixels(self, image: NDArray[Any]) -> NDArray[Any]:
        """NaN where the map of --bad-pixels is not zero."""
        if self.bad_pixels is None:
            return image
        if self.bad_pixels.shape != image.shape:
            has, needs = ("×".join(map(str, shape[::-1])) for shape in (self.bad_pixels.shape, image.shape))
            raise InputError(
                f"{self.request.bad_pixels}: has {has} pixels, the image {needs}: --bad-pixels needs its map"
            )
        return mask_pixels(image, self.bad_pixels)

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
        if min(job.width, job.height) < _SMALLEST_PX:
            reason = f"{job.width}×{job.height} pixels hold no star field"
            return Solution(Status.BAD_IMAGE, reason, steps=(Step("image", reason),))
        request = self.request
        by_hand = request.fov_deg is not None
        camera = job.camera
        if camera is None:
            if request.method is not None:
                raise InputError(
                    f"{job.name}: --method needs --camera or --fov; without them the field of view is found first, "
                    "by four-star patterns"
                )
            return self._without_camera(job)
        if not by_hand or request.method is not None:
            return self._with_camera(job, camera)
        if job.xy is None:
            solution = self._without_camera(job)
            return solution if solution.solved else _after(solution, self._with_camera(job, camera), "taken for exact")
        solution = self._with_camera(job, camera)
        if _residual_px(solution) <= _CALIBRATED_PX:
            return solution
        fitted = self._without_camera(job)
        if _residual_px(fitted) < _residual_px(solution):
            return _after(solution, fitted, "fitted")
        return _after(fitted, solution, "taken for exact")

    def _without_camera(self, job: _Job) -> Solution:
        request = self.request
        if job.xy is not None:
            return solve_unknown_fov(
                job.xy,
                job.width,
                job.height,
                flux=job.flux,
                fov_deg=request.fov_deg,
                parity=request.sides,
                catalog=request.catalog,
            )
        assert job.image is not None
        return solve_unknown_fov(
            job.image,
            fov_deg=request.fov_deg,
            parity=request.sides,
            catalog=request.catalog,
            saturation_dn=job.saturation_dn,
        )

    def _with_camera(self, job: _Job, camera: Camera) -> Solution:
        request = self.request
        if request.sides is not None and job.frame is None:
            camera = replace(camera, parity=request.sides)
        tracker = self.trackers.get(camera)
        if tracker is None:
            tracker = StarTracker(
                camera,
                catalog=request.catalog,
                magnitude_limit=request.magnitude_limit,
                identifier=request.method or "adaptive",
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


def _after(tried: Solution, chosen: Solution, how: str) -> Solution:
    """The chosen answer, its account preceded by that of the other way that was tried."""
    earlier = tuple(step for step in tried.steps if step.stage != "hint")
    return replace(chosen, steps=(*earlier, Step("camera", f"now with the field given {how}"), *chosen.steps))


def _residual_px(solution: Solution) -> float:
    """Root mean square residual; infinite where there is no solution."""
    if not solution.matched:
        return math.inf
    return float(np.sqrt(np.mean(np.sum(solution.stars.fitted.residual_px**2, axis=1))))


def is_our_frame(path: Path) -> bool:
    """Whether a FITS file has the camera that `simulator.fits.write_fits` writes."""
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


def parse_pixel(text: str) -> tuple[float, float]:
    """Column and row of ``X,Y``; `InputError` for anything else."""
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        x = y = math.nan
    if not math.isfinite(x + y):
        raise InputError(
            f"--pixel: must be X,Y in pixels from the first pixel's centre, such as 511.5,383.5, not '{text}'"
        )
    return x, y


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
