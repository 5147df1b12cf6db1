"""A sequence with calibration in flight: its columns and summary, compared with the true camera."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.study.sequence.true_defects import compare_defects
from startracker.calibration import InFlightCalibration
from startracker.core import FloatArray
from startracker.geometry.lens import value_of
from startracker.tracker import StarTracker
from startracker.tracking import CalibratedSession, GyroNoise, RateNoise

_LISTED_DEFECTS = 200


def lens_columns(names: tuple[str, ...]) -> dict[str, tuple[str, float]]:
    """Name of the column and factor on the value of each parameter of `startracker.geometry.lens.PARAMETERS`."""
    known = {
        "f": ("focal_length_ppm", 1e6),
        "aspect": ("aspect_ppm", 1e6),
        "cx": ("principal_point_x_px", 1.0),
        "cy": ("principal_point_y_px", 1.0),
    }
    return {name: known.get(name, (f"distortion_{name}", 1.0)) for name in names}


class CalibratedCamera:
    """The camera of a sequence, calibrated in flight by ``tracker.in_flight_calibration``.

    Parameters
    ----------
    scenario : Scenario
        The scenario.
    renderer : Renderer
        Renderer of the scenario, which knows the true camera.
    tracker : StarTracker
        The tracker, with the camera as calibrated on the ground.
    """

    def __init__(self, scenario: Scenario, renderer: Renderer, tracker: StarTracker) -> None:
        self.scenario, self.renderer, self.tracker = scenario, renderer, tracker
        self.calibration = InFlightCalibration(
            renderer.camera,
            scenario.tracker.in_flight_calibration,
            psf_width_px=tracker.centroid.psf_sigma_px,
            background_tile_px=tracker.detection.background_tile_px,
        )
        self._known = lens_columns(self.calibration.lens.names)

    def session(self, noise: GyroNoise | RateNoise) -> CalibratedSession:
        """Session that updates the calibration."""
        return CalibratedSession(self.tracker, self.calibration, noise, exposure_s=self.renderer.exposure_s)

    def true_change(self, t_s: float) -> FloatArray:
        """True change (P,) of the parameters of the lens since the calibration on the ground."""
        true, ground = self.renderer.focal_plane.at(t_s).true_camera, self.renderer.camera
        return np.array([value_of(name, true) - value_of(name, ground) for name in self._known])

    @property
    def true_width_px(self) -> float:
        """True width of the star images at the centre of the field; NaN unless they are Gaussian."""
        optics, detector = self.scenario.optics, self.scenario.detector
        if optics.psf.model != "gaussian" or optics.psf.sigma_px is None:
            return math.nan
        return math.hypot(optics.psf.sigma_px, detector.charge_diffusion_um / detector.pitch_um[0])

    def columns(self, t_s: float, *, tracked: bool) -> dict[str, Any]:
        """Columns of a frame at a time, seconds after the epoch; to be called after the tracker.

        `tracked` says whether the tracker was given the frame.
        """
        lens, psf, last = self.calibration.lens, self.calibration.psf, self.calibration.last if tracked else None
        row: dict[str, Any] = {}
        for (column, factor), value, sigma, true in zip(
            self._known.values(), lens.change, lens.sigma, self.true_change(t_s), strict=True
        ):
            row |= {column: factor * value, f"sigma_{column}": factor * sigma, f"true_{column}": factor * true}
        row |= {
            "psf_width_px": psf.width_px,
            "sigma_psf_width_px": psf.sigma_px,
            "true_psf_width_px": self.true_width_px,
        }
        row["lens_updated"] = last is not None and last.accepted
        row["lens_distance2"] = last.distance2 if last is not None else math.nan
        row["lens_freedom"] = last.freedom if last is not None else 0
        row["defective_px"] = int(self.calibration.defects.mask.sum())
        return {name: float(v) if isinstance(v, np.floating) else v for name, v in row.items()}

    def summarise(self, columns: dict[str, NDArray[Any]]) -> dict[str, Any]:
        """Estimates at the end of the sequence compared with the truth, and the map of defective pixels."""
        lens, defects = self.calibration.lens, self.calibration.defects
        error = lens.change - self.true_change(float(columns["t_s"][-1]))
        constants = lens.time_constant_s
        parameters = {}
        for i, (column, _) in enumerate(self._known.values()):
            parameters[column] = {
                "value": float(columns[column][-1]),
                "sigma": float(columns[f"sigma_{column}"][-1]),
                "true": float(columns[f"true_{column}"][-1]),
                "error_sigmas": float(error[i] / lens.sigma[i]),
                "time_constant_s": float(constants[i]) if math.isfinite(constants[i]) else None,
            }
        freedom = len(error)
        distance2 = float(error @ np.linalg.solve(lens.covariance, error))
        low, high = (float(chdtri(freedom, p)) for p in (0.975, 0.025))
        updated = np.asarray(columns["lens_updated"], dtype=bool)
        section = self.scenario.tracker.in_flight_calibration
        return {
            "frames_used": int(updated.sum()),
            "frames_beyond_gate": int(np.sum(~updated & np.isfinite(columns["lens_distance2"]))),
            "restarts": lens.restarts,
            "parameters": parameters,
            "chi2": {
                "value": distance2,
                "freedom": freedom,
                "bounds95": [low, high],
                "within": low <= distance2 <= high,
            },
            "noise_factor": lens.noise_factor,
            "psf_width_px": {
                "value": _finite(columns["psf_width_px"][-1]),
                "sigma": _finite(columns["sigma_psf_width_px"][-1]),
                "true": _finite(columns["true_psf_width_px"][-1]),
            },
            "defective_pixels": {
                **compare_defects(self.renderer, defects.mask, section.defect_sigma),
                "xy": defects.xy[:_LISTED_DEFECTS].tolist(),
            },
        }


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
