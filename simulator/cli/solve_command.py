"""``boresight solve``: photographs, frames and centroid lists to attitudes."""

from __future__ import annotations

import json
import math
import sys
import tempfile
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulator.cli.centroid_list import parse_pixel, parse_size, read_centroids
from simulator.cli.checks import picture_format, utc_time, writable
from simulator.cli.image_files import FITS_SUFFIXES, OutputFiles, image_files, is_our_frame, shown_name, spooled
from simulator.cli.requests import PARITIES, SolveRequest
from simulator.cli.solve_output import as_dict, as_text, write_picture, write_wcs
from simulator.fits import read_fits
from simulator.frame import Frame
from startracker.blind import solve_unknown_fov
from startracker.detection import mask_pixels
from startracker.errors import BoresightError, InputError
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.images.reading import RowOrder, read_image
from startracker.observer import Observer
from startracker.solution import Solution, Status
from startracker.trace import Step
from startracker.tracker import StarTracker

_SMALLEST_PX = 16
_CALIBRATED_PX = 0.7
"""A list of centroids that fits worse than this is not from a camera of exactly the field given."""
_LIMITS = (6.5, 8.0, 9.5)
"""Magnitudes of the faintest guide stars that are tried with a known camera: those of star cameras first. Hipparcos is
complete to about V = 7.3 to 9."""
_PRIOR_DEG = 0.2
"""Error of an attitude found with fewer guide stars."""


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
    colours: NDArray[Any] | None = None
    """Of a colour photograph, for its picture."""
    observer: Observer | None = None
    """That of the frame, or one on the Earth at the time given."""
    row_order: RowOrder = "TOP-DOWN"
    """Of the file."""

    def pixels(self) -> NDArray[Any]:
        """The image; black where a list of centroids was solved."""
        return np.zeros((self.height, self.width), np.uint8) if self.image is None else np.asarray(self.image)


def main(request: SolveRequest) -> int:
    """Solve all; exit status 0 when each is solved, 1 when some are not, 2 for bad input."""
    _check(request)
    with tempfile.TemporaryDirectory() as folder:
        images = spooled(request.images or (), Path(folder))
        several = len(images) > 1 or any(path.is_dir() for path in images)
        files = _Files(OutputFiles(request.wcs, several, ".fits"), OutputFiles(request.annotate, several, ".png"))
        status = 0
        solver = _Solver(request)
        for source in [request.centroids] if request.centroids else image_files(images):
            try:
                solved = _solve(source, solver, files)
            except BoresightError as error:
                print(str(error).replace(f"{folder}/", ""), file=sys.stderr)
                status = 2
                continue
            status = max(status, 0 if solved else 1)
    return status


class _Files(NamedTuple):
    wcs: OutputFiles
    annotate: OutputFiles


def _solve(source: Path, solver: _Solver, files: _Files) -> bool:
    """Solve one image, print its answer and write its files; returns whether it is solved."""
    request = solver.request
    job = solver.load(source)
    solution = solver.solve(job)
    points = _points(request)
    if request.as_json:
        answer = as_dict(solution, points, job.observer)
        print(json.dumps({"image": job.name, **answer, "notes": list(job.notes)}, allow_nan=False))
    else:
        if request.explain:
            solution = replace(solution, steps=(*(Step("file", note) for note in job.notes), *solution.steps))
        print(f"{job.name}: {as_text(solution, points, job.observer, explain=request.explain)}")
    wcs, picture = files.wcs.path(source), files.annotate.path(source)
    if wcs is not None:
        write_wcs(wcs, solution, job.pixels(), job.observer, job.row_order)
    if picture is not None:
        options = {
            "catalog": request.catalog,
            "grid": request.grid,
            "constellations": request.constellations,
            "deep_sky": request.deep_sky,
        }
        shown = job.pixels() if job.colours is None else job.colours
        if request.colour and shown.ndim == 2 and solution.matched:
            from startracker.annotation.annotate import star_coloured

            shown = star_coloured(shown, solution, request.catalog)
        write_picture(picture, solution, shown, job.observer, **options)
    return solution.solved


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
    if request.magnitude_limit is not None and not math.isfinite(request.magnitude_limit):
        raise InputError("--magnitude-limit: must be a number")
    if request.centroids is not None and request.camera is None and request.size is None:
        raise InputError("--centroids: needs --camera, or --size WxH (and --fov where it is known)")
    if request.parity is not None and request.parity not in PARITIES:
        raise InputError(f"--parity: must be {', '.join(PARITIES)}, not '{request.parity}'")
    if request.annotate is None and (request.grid or request.constellations or request.colour):
        raise InputError("--grid, --constellations and --colour: require --annotate OUT.png")
    _points(request)
    if len(images) == 1 and not images[0].is_dir():
        if request.wcs is not None and not request.wcs.is_dir():
            writable(request.wcs)
        if request.annotate is not None and not request.annotate.is_dir():
            picture_format(request.annotate)


def _points(request: SolveRequest) -> NDArray[np.float64]:
    """Pixels (N, 2) asked for."""
    return np.array([parse_pixel(text) for text in request.pixels or ()]).reshape(-1, 2)


def _observer_at(utc: str) -> Observer:
    from astropy.time import Time
    from erfa import ErfaWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ErfaWarning)  # of dates after the table of leap seconds
        return Observer.on_earth(Time(utc_time("--time", utc)))


class _Solver:
    """Loads and solves; trackers are kept, as building one costs more than a solve."""

    def __init__(self, request: SolveRequest) -> None:
        self.request = request
        self.camera = Camera.from_yaml(request.camera) if request.camera else None
        self.bad_pixels = read_image(request.bad_pixels) if request.bad_pixels else None
        self.trackers: dict[tuple[Camera, float], StarTracker] = {}
        self.observer = _observer_at(request.time) if request.time else None

    def load(self, path: Path) -> _Job:
        if self.request.centroids is not None:
            return self._load_centroids(path)
        if path.suffix.lower() in FITS_SUFFIXES and is_our_frame(path):
            frame = read_fits(path)
            height, width = frame.image.shape
            camera = self.camera or self._from_fov(width, height) or frame.camera
            frame = replace(frame, image=self._without_bad_pixels(frame.image, "TOP-DOWN"))
            return _Job(
                shown_name(path),
                width,
                height,
                camera,
                frame.image,
                saturation_dn=frame.saturation_dn,
                frame=frame,
                observer=frame.observer,
            )
        # a camera file and a map of bad pixels know the sensor's own rows and columns
        upright = self.camera is None and self.bad_pixels is None
        loaded = read_image(path, bayer=self.request.bayer, upright=upright, colours=self.request.annotate is not None)
        height, width = loaded.image.shape
        known = self.camera or self._from_fov(width, height)
        if self.camera is not None and (self.camera.width, self.camera.height) != (width, height):
            raise InputError(
                f"{path}: has {width}×{height} pixels, but the camera file {self.request.camera} is for "
                f"{self.camera.width}×{self.camera.height}"
            )
        is_fits = "NAXIS" in loaded.header
        image = self._without_bad_pixels(loaded.image, loaded.row_order if is_fits else None)
        return _Job(
            shown_name(path),
            width,
            height,
            known,
            image,
            saturation_dn=loaded.saturation_dn,
            notes=loaded.notes,
            colours=loaded.colours,
            observer=self.observer,
            row_order=loaded.row_order,
        )

    def _without_bad_pixels(self, image: NDArray[Any], row_order: RowOrder | None) -> NDArray[Any]:
        """NaN where the map of --bad-pixels is not zero.

        `row_order` is that of the image's file if that is FITS. A map in FITS that does not state its own order belongs
        to the stored pixels of such an image.
        """
        if self.bad_pixels is None:
            return image
        bad = self.bad_pixels.image != 0.0
        silent = self.bad_pixels.row_order == "BOTTOM-UP" and "ROWORDER" not in self.bad_pixels.header
        if silent and row_order == "TOP-DOWN":
            bad = bad[::-1]
        if bad.shape != image.shape:
            has, needs = ("×".join(map(str, shape[::-1])) for shape in (bad.shape, image.shape))
            raise InputError(
                f"{self.request.bad_pixels}: has {has} pixels, the image {needs}: --bad-pixels needs its map"
            )
        return mask_pixels(image, bad)

    def _from_fov(self, width: int, height: int) -> Camera | None:
        return Camera.from_fov(self.request.fov_deg, width, height) if self.request.fov_deg else None

    def _load_centroids(self, path: Path) -> _Job:
        if self.camera is not None:
            width, height = self.camera.width, self.camera.height
        else:
            width, height = parse_size(self.request.size or "")
        xy, flux = read_centroids(path)
        camera = self.camera or self._from_fov(width, height)
        return _Job(str(path), width, height, camera, xy=xy, flux=flux, observer=self.observer)

    def solve(self, job: _Job) -> Solution:
        """Solve by what is known of the camera.

        A calibrated camera is taken at its word. A field of view given by hand is good to a few per cent: a
        photograph's focal length is fitted, and only where that fails, as it needs more stars, the number is taken
        for exact; a list of centroids the other way round. Without either everything is determined.
        """
        if min(job.width, job.height) < _SMALLEST_PX:
            reason = f"{job.width}×{job.height} pixels hold no star field"
            return Solution(Status.BAD_IMAGE, reason, steps=(Step("image", reason),))
        request = self.request
        by_hand = request.fov_deg is not None
        camera = job.camera
        if camera is None:
            for option, name in (("--method", request.method), ("--estimator", request.estimator)):
                if name is not None:
                    raise InputError(
                        f"{job.name}: {option} needs --camera or --fov; without them the field of view is found first, "
                        "by four-star patterns, and fitted together with the attitude"
                    )
            return self._without_camera(job)
        if not by_hand or request.method is not None or request.estimator is not None:
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
                observer=job.observer,
            )
        assert job.image is not None
        return solve_unknown_fov(
            job.image,
            fov_deg=request.fov_deg,
            parity=request.sides,
            catalog=request.catalog,
            saturation_dn=job.saturation_dn,
            observer=job.observer,
        )

    def _with_camera(self, job: _Job, camera: Camera) -> Solution:
        """Solve with a known camera, with guide stars as faint as those of the picture: deeper as long as its list has
        more stars than the field has guide stars, and more of them are matched."""
        request = self.request
        if request.sides is not None and job.frame is None:
            camera = replace(camera, parity=request.sides)
        given = request.magnitude_limit
        first, *deeper = _LIMITS if given is None else (given,)
        tracker = self._tracker(camera, first)
        if job.frame is not None:
            return tracker.solve(job.frame, lost_in_space=request.lost_in_space)
        best = self._solved_by(tracker, job, None)
        for limit in deeper:
            if best.solved and _guide_stars_in_field(tracker, best) >= len(best.centroids):
                break
            tracker = self._tracker(camera, limit)
            found = self._solved_by(tracker, job, best.attitude)
            if best.solved and found.matched <= best.matched:
                break
            best = found if found.solved or not best.solved else best
        return best

    def _tracker(self, camera: Camera, limit: float) -> StarTracker:
        if (camera, limit) not in self.trackers:
            self.trackers[camera, limit] = StarTracker(
                camera,
                catalog=self.request.catalog,
                magnitude_limit=limit,
                identifier=self.request.method or "adaptive",
                estimator=self.request.estimator or "field_fit",
            )
        return self.trackers[camera, limit]

    @staticmethod
    def _solved_by(tracker: StarTracker, job: _Job, prior: Attitude | None) -> Solution:
        near: dict[str, Any] = {} if prior is None else {"prior": prior, "prior_deg": _PRIOR_DEG}
        if job.xy is not None:
            return tracker.solve_centroids(job.xy, job.flux, observer=job.observer, **near)
        assert job.image is not None
        return tracker.solve(job.image, saturation_dn=job.saturation_dn, observer=job.observer, **near)


def _guide_stars_in_field(tracker: StarTracker, solution: Solution) -> int:
    """Number of guide stars on the image of a solution."""
    assert solution.attitude is not None
    assert solution.camera is not None
    return len(tracker.guide.in_field(solution.attitude.as_matrix(), 0.0, solution.camera)[0])


def _after(tried: Solution, chosen: Solution, how: str) -> Solution:
    """The chosen answer, its account preceded by that of the other way that was tried."""
    earlier = tuple(step for step in tried.steps if step.stage != "hint")
    return replace(chosen, steps=(*earlier, Step("camera", f"now with the field given {how}"), *chosen.steps))


def _residual_px(solution: Solution) -> float:
    """Root mean square residual; infinite where there is no solution."""
    if not solution.matched:
        return math.inf
    return float(np.sqrt(np.mean(np.sum(solution.stars.fitted.residual_px**2, axis=1))))
