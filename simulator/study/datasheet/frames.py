"""Frames of a datasheet: ordinary trials, controlled scans, given rates and sequences, each rendered and solved.

Every function of `DatasheetFrames` returns columns that only depend on the scenario and on its arguments.
"""

from __future__ import annotations

import copy
import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from simulator.build import build_detector
from simulator.constants import EARTH_RADIUS_KM
from simulator.detector.chain import Detector
from simulator.frame import Frame, FrameTruth
from simulator.randomness import stream
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.scene import Scene
from simulator.study.axes import AXES, CAMERA_AXES
from simulator.study.datasheet.scan import PASSES, SAME_PIXELS, ScanGeometry, scan_attitudes
from simulator.study.sequence.frames import SequenceRunner
from simulator.study.specification.measured import JUDGED_COLUMNS
from simulator.study.specification.outcome import identified
from simulator.study.trials.bounds import attitude_bound_deg, matched_sources, star_information
from simulator.study.trials.trial import (
    TrialRunner,
    attitude_errors_deg,
    misidentified,
    solve_frame,
)
from startracker.core import Columns, FloatArray
from startracker.geometry.attitude import Attitude, direction_to_radec
from startracker.solution import Solution

BORDER_PX = 3.0
"""Distance from the border of the detector within which a star may be missing in some of the passes as it enters or
leaves the field: its light reaches up to two pixels beyond, the shifts of the passes one."""

BOUND_EVERY = 3
"""The bound of the noise is computed for each third frame of a scan."""

_SCAN_INDEX, _RATE_INDEX, _BODY_INDEX = 10_000_000, 20_000_000, 30_000_000
"""First indices of the random streams of scans, of given rates, and near bodies, beyond those of the trials."""

_MOST_FRAMES = 1000
"""Frames of a pass, for the indices."""

GROSS_PX = 10.0
"""Error across the boresight, pixels, beyond which an attitude is not one of the field's stars and does not count in
errors: where the catalogues of sky and tracker differ, misidentified stars are not known."""

SAME_STAR_RAD = math.radians(1.0 / 60.0)
"""Maximum distance between the positions of a star in the catalogues of the sky and of the tracker."""

_GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))

_TRIAL_COLUMNS = (
    *JUDGED_COLUMNS,
    "orbit_argument_deg",
    "sunlit",
    "stars_in_field",
    "stars_matched",
    "stars_misidentified",
    "nees",
    *(f"error_{axis}_deg" for axis in AXES),
    *(f"bound_{axis}_deg" for axis in CAMERA_AXES),
)
_SEQUENCE_COLUMNS = ("elapsed_s", "mode", "status", "wrong", "restarted", *(f"error_{axis}_deg" for axis in AXES))


class DatasheetFrames:
    """Frames of one scenario; common data is built once."""

    def __init__(self, scenario: Scenario) -> None:
        self.runner = TrialRunner(scenario)
        self.renderer = self.runner.renderer
        self._noise_only: Renderer | None = None
        self._other_pixels: Renderer | None = None

    def trials(self, first: int, count: int) -> Columns:
        """Ordinary trials: one value each; ``right`` for an attitude with the right stars."""
        rows = [self.runner.run(index) for index in range(first, first + count)]
        columns = {name: np.array([row[name] for row in rows], dtype=float) for name in _TRIAL_COLUMNS}
        solved = np.array([row["status"] == "solved" for row in rows])
        names = ("misidentified", "inconsistent", "wrong", "inconsistent_cause", "status")
        columns |= {name: np.array([row[name] for row in rows]) for name in names}
        return columns | {"solved": solved, "right": identified(columns)}

    def scan(self, field: int, geometry: ScanGeometry) -> Columns:
        """The passes over one field.

        The field is that of trial `field`, at its time and with its angular rate, which smears the images as in the
        mission; the attitudes of successive frames are those of the scan.

        Returns
        -------
        dict
            ``error_deg`` (passes, frames, 3), camera axes, NaN for frames without a correct attitude;
            ``noise_bound_deg`` (frames, 3), Cramér–Rao bound of the noise alone, NaN where it is not computed;
            ``stars`` (passes, frames); ``same_field`` (frames,), whether no star enters or leaves the field between the
            attitudes of the passes.
        """
        scene = self.renderer.scene(field)
        pointing, t_s = scene.pointing, scene.t_s
        self.renderer.scenes.plan([t_s])
        camera = self.renderer.camera
        looks = scan_attitudes(pointing.camera, geometry, (1.0 / camera.fx, 1.0 / camera.fy))
        error_deg = np.full((PASSES, geometry.frames, 3), np.nan)
        bound_deg = np.full((geometry.frames, 3), np.nan)
        seen: list[list[dict[int, float]]] = [[] for _ in range(geometry.frames)]
        for number, of_pass in enumerate(looks):
            renderer = self.renderer if number < SAME_PIXELS else self._with_other_pixels()
            for k, look in enumerate(of_pass):
                index = _SCAN_INDEX + (field * PASSES + number) * _MOST_FRAMES + k
                frame, truth = renderer.frame(
                    index, at_s=t_s, attitude=look, rate_camera_rad_s=pointing.rate_camera_rad_s
                )
                error_deg[number, k], matched, fitted = self._measured(frame, truth)
                seen[k].append(_border_distances_px(truth, matched, frame.image.shape))
                if number == 0 and k % BOUND_EVERY == 0 and fitted:
                    bound_deg[k] = attitude_bound_deg(self._with_noise_only(), truth, matched)
        same = np.array([_same_at_border(passes) for passes in seen])
        stars = np.array([[len(found) for found in passes] for passes in seen]).T
        return {"error_deg": error_deg, "noise_bound_deg": bound_deg, "stars": stars, "same_field": same}

    def at_rate(self, first: int, count: int, rate_deg_s: float) -> Columns:
        """Frames at the attitudes of trials, and a given rate about axes across the boresight, evenly distributed.

        Returns
        -------
        dict
            ``right`` (count,); ``along_deg``, ``across_deg`` and ``about_deg`` (count,), the error about the axis of
            the rotation, across it and about the boresight.
        """
        error_deg = np.full((count, 3), np.nan)
        turns = np.array([k * _GOLDEN_ANGLE for k in range(first, first + count)])
        axes = np.stack([np.cos(turns), np.sin(turns), np.zeros(count)], axis=1)
        for k in range(count):
            scene = self.renderer.scene(first + k)
            frame, truth = self.renderer.frame(
                _RATE_INDEX + first + k,
                at_s=scene.t_s,
                attitude=scene.pointing.camera,
                rate_camera_rad_s=math.radians(rate_deg_s) * axes[k],
            )
            error_deg[k], _, _ = self._measured(frame, truth)
        across = np.stack([-axes[:, 1], axes[:, 0], np.zeros(count)], axis=1)
        return {
            "right": np.isfinite(error_deg).all(axis=1),
            "along_deg": np.sum(error_deg * axes, axis=1),
            "across_deg": np.sum(error_deg * across, axis=1),
            "about_deg": error_deg[:, 2],
        }

    def near_body(self, first: int, count: int, body: str, angle_deg: float) -> Columns:
        """Frames whose boresight is `angle_deg` from the centre of the ``sun`` or the ``moon``, or from the limb of the
        ``earth``, at random azimuths and rolls and at the times of trials: ``right`` (count,)."""
        right = np.zeros(count, dtype=bool)
        for k in range(count):
            scene = self.renderer.scene(first + k)
            rng = stream(self.runner.scenario.seed, f"near {body}", first + k)
            direction, radius_rad = _body_direction(scene, body)
            boresight = _at_angle(direction, radius_rad + math.radians(angle_deg), rng.uniform(0.0, math.tau))
            ra, dec = np.degrees(direction_to_radec(boresight[None]))
            look = Attitude.from_radec_roll(float(ra[0]), float(dec[0]), rng.uniform(0.0, 360.0))
            frame, truth = self.renderer.frame(_BODY_INDEX + first + k, at_s=scene.t_s, attitude=look)
            error_deg, _, _ = self._measured(frame, truth)
            right[k] = np.isfinite(error_deg).all()
        return {"right": right}

    def with_false_stars(self, first: int, count: int, number: int) -> Columns:
        """The identified star images of trials, joined by `number` false ones.

        The false ones are at random positions, with the fluxes of random true ones and their uncertainties, which are
        the bounds of each image; the list is then solved as in the trial. ``right`` (count,), and
        ``error_<axis>_deg`` of the camera's axes.
        """
        error_deg = np.full((count, 3), np.nan)
        tracker, scenario = self.runner.tracker, self.runner.scenario
        for k in range(count):
            frame, truth = self.renderer.frame(first + k)
            seen = tracker.solve(frame.image, saturation_dn=frame.saturation_dn, gain_e_per_dn=frame.gain_e_per_dn)
            stars, rng = seen.stars, stream(scenario.seed, "false stars", first + k)
            rows = matched_sources(truth, stars.xy)
            if seen.attitude is None or not len(rows):
                continue
            size = (frame.image.shape[1], frame.image.shape[0])
            xy = np.concatenate([stars.xy, rng.uniform(-0.5, np.array(size) - 0.5, (number, 2))])
            as_bright = np.concatenate([np.arange(len(stars)), rng.integers(len(stars), size=number)])
            solution = tracker.solve_centroids(
                xy,
                stars.flux[as_bright],
                sigma_px=self._bounds_px(truth, rows, stars.xy)[as_bright],
                prior=frame.prior,
                prior_deg=frame.prior_deg,
                observer=frame.observer,
            )
            error_deg[k], _, _ = self._judged(solution, truth)
        named = {f"error_{axis}_deg": error_deg[:, i] for i, axis in enumerate(CAMERA_AXES)}
        return named | {"right": np.isfinite(error_deg).all(axis=1)}

    def _bounds_px(self, truth: FrameTruth, rows: NDArray[np.int64], xy: FloatArray) -> FloatArray:
        """Bounds (N,) of the images at positions (N, 2), each that of the nearest of the sources in `rows`."""
        # of an image without information, as a saturated one, at most a hundred pixels
        covariance = np.linalg.inv(star_information(self.renderer, truth, rows) + 1e-4 * np.eye(2))
        apart = np.linalg.norm(truth.sources.image_xy[rows][None] - xy[:, None], axis=2)
        return np.asarray(np.sqrt(0.5 * np.trace(covariance, axis1=1, axis2=2))[np.argmin(apart, axis=1)])

    def model_residuals(self, first: int, count: int) -> Columns:
        """Attitude error of trials with perfect star images, ``error_deg`` (count, 3), camera axes.

        The rotation by which the displacements of the stars from their catalogue positions (aberration, parallax, light
        deflection) that the tracker computes from the observer's state differ from those of the simulated sky, as the
        least-squares fit to the stars in the field. Errors of the catalogue's positions and merged doubles do not
        contribute.
        """
        error_deg = np.full((count, 3), np.nan)
        for k in range(count):
            scene = self.renderer.scene(first + k)
            epoch, camera = scene.observer.epoch_jyear, scene.pointing.camera
            guide = self.runner.tracker.guide.apparent_to(scene.observer)
            index, _, _ = guide.in_field(camera.as_matrix())
            fixed, known = scene.stars.directions(epoch), guide.catalog.directions(epoch)[index]
            nearest = np.argmax(known @ fixed.T, axis=1)
            moved = scene.star_directions[nearest] - fixed[nearest]
            same = np.linalg.norm(fixed[nearest] - known, axis=1) < SAME_STAR_RAD
            if same.sum() >= 2:
                seen, apart = scene.star_directions[nearest], guide.directions[index] - known - moved
                error_deg[k] = np.degrees(_rotation(camera.apply(seen[same]), camera.apply(apart[same])))
        return {"error_deg": error_deg}

    def _measured(self, frame: Frame, truth: FrameTruth) -> tuple[FloatArray, NDArray[np.int64], bool]:
        """Error (3,) about the camera's axes, degrees, NaN without a correct attitude; the true stars matched."""
        return self._judged(solve_frame(self.runner.tracker, frame), truth)

    def _judged(self, solution: Solution, truth: FrameTruth) -> tuple[FloatArray, NDArray[np.int64], bool]:
        """As `_measured`, of a solution."""
        matched = matched_sources(truth, solution.stars.fitted.xy)
        if solution.attitude is None:
            return np.full(3, np.nan), matched, False
        errors = attitude_errors_deg(truth.attitude_at_tag, solution.attitude, truth.mounting)
        error_deg = np.array([errors[axis] for axis in CAMERA_AXES])
        wrong_stars = misidentified(truth, solution) if self.runner.same_catalog else 0
        # by the stars, not by the stated covariance: errors that it does not contain are what is measured
        if wrong_stars or np.hypot(*error_deg[:2]) > GROSS_PX * math.degrees(self.renderer.camera.pixel_rad):
            return np.full(3, np.nan), matched, False
        return error_deg, matched, True

    def _with_other_pixels(self) -> Renderer:
        """The same camera with another device: its fixed pattern has another seed, the lens is the same."""
        if self._other_pixels is None:
            scenario = self.runner.scenario
            self._other_pixels = copy.copy(self.renderer)
            other = scenario.seed + 1 if scenario.seed < 2**63 - 1 else 0
            self._other_pixels.detector = build_detector(scenario.with_values(seed=other))
        return self._other_pixels

    def _with_noise_only(self) -> Renderer:
        """The same camera, with a fixed pattern that does not count as noise in the bound."""
        if self._noise_only is None:
            device = self.renderer.detector
            self._noise_only = copy.copy(self.renderer)
            self._noise_only.detector = Detector(replace(device.parameters, prnu=0.0, dsnu=0.0), device.pattern)
        return self._noise_only


def _border_distances_px(truth: FrameTruth, rows: NDArray[np.int64], shape: tuple[int, ...]) -> dict[int, float]:
    """Distance from the border of the image, negative outside, of the stars in given rows of the sources, by number."""
    size = np.array(shape[::-1])
    xy = truth.sources.image_xy[rows]
    inside = np.minimum(xy + 0.5, size - 0.5 - xy).min(axis=1)
    return dict(zip(truth.sources.id[rows].tolist(), inside.tolist(), strict=True))


def _same_at_border(passes: list[dict[int, float]]) -> bool:
    """Whether no star near the border is missing in some of the passes."""
    everywhere = set(passes[0]).intersection(*passes[1:])
    return not any(
        distance < BORDER_PX for found in passes for star, distance in found.items() if star not in everywhere
    )


def _body_direction(scene: Scene, body: str) -> tuple[FloatArray, float]:
    """Direction (3,) of a body's centre, and the angular radius from which angles are counted, rad."""
    if body == "sun":
        return scene.sun_direction, 0.0
    if body == "moon":
        return np.asarray(scene.bodies.direction[np.flatnonzero(scene.bodies.name == "Moon")[0]]), 0.0
    distance = float(np.linalg.norm(scene.r_km))
    return -scene.r_km / distance, math.asin(min(EARTH_RADIUS_KM / distance, 1.0))


def _at_angle(direction: FloatArray, angle_rad: float, azimuth_rad: float) -> FloatArray:
    """Unit vector (3,) at an angle from a direction."""
    across = np.cross(direction, np.eye(3)[int(np.argmin(np.abs(direction)))])
    across /= np.linalg.norm(across)
    around = math.cos(azimuth_rad) * across + math.sin(azimuth_rad) * np.cross(direction, across)
    return np.asarray(math.cos(angle_rad) * direction + math.sin(angle_rad) * around)


def _rotation(seen: FloatArray, apart: FloatArray) -> FloatArray:
    """Error (3,), rad, of the attitude that brings directions seen + apart (N, 3) of a catalogue onto those seen, to
    first order: apart = −θ × seen turned back, [Σ (I − b bᵀ)] θ = Σ b × apart."""
    normal = len(seen) * np.eye(3) - seen.T @ seen
    return np.asarray(np.linalg.solve(normal, np.cross(seen, apart).sum(axis=0)))


def sequence_columns(scenario: Scenario) -> Columns:
    """The frames of a scenario's sequence."""
    rows = [tracked.row for tracked in SequenceRunner(scenario).frames()]
    return {name: np.array([row[name] for row in rows]) for name in _SEQUENCE_COLUMNS}
