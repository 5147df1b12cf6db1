"""A sequence with the sensor's rules of operation: exposure control, and the resulting columns and summary.

`startracker.tracking.operation` decides from the images alone; this module applies the exposures, and compares the map
of defective pixels and the magnitudes with the truth.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.frame import Frame, FrameTruth
from simulator.mission.motion import MotionState
from simulator.optics.jitter_series import JitterMotion
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.study.sequence.true_defects import compare_defects
from simulator.study.trackers import Session, Tracker
from startracker.core import FloatArray
from startracker.solution import Solution, Status
from startracker.tracking.operation import SensorOperation, Verdict, image_magnitudes, saturated_near

DISCARDED = "discarded"
"""Status of a frame whose brightest stars are over-exposed."""
SUSPENDED = "suspended"
"""Status of a frame with the Sun, and of those not taken until it has passed."""
_FEWEST_FOR_SLOPE = 8


class OperatedCamera:
    """The camera of a sequence, operated by the rules of ``sequence.operation``.

    Parameters
    ----------
    scenario : Scenario
        The scenario.
    renderer : Renderer
        Renderer of the scenario, used with the exposures set by the rules.
    tracker : StarTracker or FlightEngine
        The tracker, with its settings and catalogue.
    """

    def __init__(self, scenario: Scenario, renderer: Renderer, tracker: Tracker) -> None:
        self.scenario = scenario
        self.renderer, settings = renderer, scenario.sequence.operation
        self.rules = SensorOperation(settings, tracker.detection, renderer.camera, renderer.exposure_s)
        reference = renderer.focal_plane.photometer.electrons_per_s(0.0, settings.reference_b_v)
        self._zero_point = 2.5 * math.log10(float(reference))
        catalog = tracker.guide.catalog
        self._b_v = dict(zip(catalog.id.tolist(), catalog.b_v.tolist(), strict=True))
        self.verdict = Verdict("", "", None)
        self.exposure_s = self.rules.exposure_s
        """Exposure of the current frame."""
        self.colours: list[FloatArray] = []
        """B − V and magnitude error of every measured star, (N, 2) per frame."""

    def expose(
        self, k: int, state: MotionState, since_s: float, session: Session, jitter: JitterMotion | None
    ) -> tuple[Frame, FrameTruth] | None:
        """Frame and truth at the exposure set by the rules, with their verdict; None while suspended."""
        self.exposure_s = self.rules.exposure_s
        if self.rules.suspended(since_s):
            self.verdict = Verdict("sun", "suspended until the Sun has passed", None)
            return None
        session.exposure_s = self.exposure_s
        frame, truth = self.renderer.frame(
            k,
            at_s=state.t_s,
            attitude=state.camera,
            rate_camera_rad_s=state.rate_camera_rad_s,
            jitter=jitter,
            exposure_s=self.exposure_s,
        )
        self.verdict = self.rules.judge(frame.image, since_s, frame.saturation_dn, session.rate_rad_s)
        return frame, truth

    def dropped(self, solution: Solution, session: Session) -> dict[str, Any]:
        """Columns of a missing frame not caused by a rule."""
        self.verdict = Verdict("", "", None)
        return self.columns(None, solution, session)

    def refused(self) -> dict[str, Any]:
        """Status and reason of a frame that is not passed to the tracker."""
        status = {"sun": SUSPENDED, "stale": str(Status.STALE)}.get(self.verdict.rule, DISCARDED)
        return {"status": status, "reason": self.verdict.reason}

    def columns(self, frame: Frame | None, solution: Solution, session: Session) -> dict[str, Any]:
        """Columns of a frame; also updates the maps of the sensor. To be called after the tracker."""
        row: dict[str, Any] = {
            "exposure_s": self.exposure_s,
            "rule": self.verdict.rule,
            "saturated_px": max(self.verdict.saturated_px, default=0),
            "cleared_px": self.verdict.cleared_px,
            "magnitude_stars": 0,
            "magnitude_error_mean": math.nan,
            "magnitude_error_rms": math.nan,
        }
        if frame is not None and self.verdict.image is not None and solution.solved:
            self.rules.learn(frame.image, self.verdict, session.filter_attitude, solution.stars)
            errors = self._magnitude_errors(frame, solution)
            if len(errors):
                self.colours.append(errors)
                row |= {
                    "magnitude_stars": len(errors),
                    "magnitude_error_mean": float(errors[:, 1].mean()),
                    "magnitude_error_rms": float(np.sqrt(np.mean(errors[:, 1] ** 2))),
                }
        row["blemished_px"] = int(self.rules.blemishes.sum())
        return row

    def _magnitude_errors(self, frame: Frame, solution: Solution) -> FloatArray:
        """B − V and measured magnitude minus V, (N, 2), of identified stars that are not saturated."""
        stars = solution.stars
        read = image_magnitudes(stars.flux, frame.gain_e_per_dn, frame.exposure_s, self._zero_point)
        b_v = np.array([self._b_v.get(int(number), math.nan) for number in stars.catalog_id])
        good = np.isfinite(read) & np.isfinite(b_v) & ~saturated_near(frame.image, stars.xy, frame.saturation_dn)
        return np.stack([b_v[good], (read - stars.v_mag)[good]], axis=1)


def summarise_operation(camera: OperatedCamera, columns: dict[str, NDArray[Any]], step_s: float) -> dict[str, Any]:
    """Number of actions of each rule, exposures, and comparison of the map of defective pixels and the magnitudes with
    the truth.

    The colour slope is that of a straight line through all errors, magnitudes per magnitude of B − V: the error of a
    single relation for all stars. Without it the standard deviation of the errors is ``std_without_colour``.
    """
    status, rule = columns["status"], columns["rule"]
    exposures = columns["exposure_s"]
    return {
        "discarded": int(np.sum(status == DISCARDED)),
        "suspended_s": float(np.sum(status == SUSPENDED)) * step_s,
        "sun_frames": int(np.sum((rule == "sun") & np.isfinite(columns["render_ms"]))),
        "moon_frames": int(np.sum(rule == "moon")),
        "exposure_s": {"first": float(exposures[0]), "shortest": float(exposures.min()), "last": float(exposures[-1])},
        "blemishes": compare_defects(camera.renderer, camera.rules.blemishes, camera.rules.settings.blemish_sigma),
        "magnitudes": _magnitudes(camera.colours),
    }


def _magnitudes(measured: list[FloatArray]) -> dict[str, float | int | None]:
    errors = np.concatenate(measured) if measured else np.empty((0, 2))
    slope = without = None
    if len(errors) >= _FEWEST_FOR_SLOPE and float(np.ptp(errors[:, 0])) > 0.0:
        line = np.polyfit(errors[:, 0], errors[:, 1], 1)
        slope = float(line[0])
        without = float(np.std(errors[:, 1] - np.polyval(line, errors[:, 0])))
    known = bool(len(errors))
    return {
        "stars": len(errors),
        "mean": float(errors[:, 1].mean()) if known else None,
        "rms": float(np.sqrt(np.mean(errors[:, 1] ** 2))) if known else None,
        "colour_slope": slope,
        "std_without_colour": without,
    }
