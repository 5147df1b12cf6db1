"""Turn of an attitude by what its tracker cannot know, from the truth: displaced star images, error of the time."""

from __future__ import annotations

import numpy as np

from simulator.frame import FrameTruth
from simulator.renderer import Renderer
from simulator.study.trials.bounds import pixel_slopes
from startracker.arrays import FloatArray, IntArray


def systematic_turn_deg(renderer: Renderer, truth: FrameTruth, stars: IntArray) -> FloatArray:
    """Error of the attitude about the camera's axes (3,), degrees, without any noise.

    (Σ JᵀJ)⁻¹ Σ Jᵀd of displacements d from the positions of the calibrated camera, with equal weights, minus the rate
    times the error of the time. Zero for a camera without systematic errors.

    Parameters
    ----------
    renderer, truth
        Renderer of the scenario, and a frame's truth.
    stars : (N,) int array
        Rows of the true sources that the tracker used.
    """
    plane, sources = renderer.focal_plane.at(truth.t_s), truth.sources
    turn = -truth.rate_camera_rad_s * truth.time_tag_error_s
    if (plane.true_camera is not plane.camera or not plane.displacement.is_off) and len(stars) > 1:
        directions = truth.attitude.apply(sources.direction[stars])
        slopes = pixel_slopes(plane.camera, directions)
        displaced = sources.xy[stars] - plane.camera.project(directions)
        normal = np.einsum("nji,njk->ik", slopes, slopes)
        turn = turn + np.linalg.lstsq(normal, np.einsum("nji,nj->i", slopes, displaced), rcond=None)[0]
    return np.asarray(np.degrees(turn))


def explained_deg(renderer: Renderer, truth: FrameTruth, stars: IntArray, bound_deg: FloatArray) -> FloatArray:
    """Standard deviations (3,), degrees, that noise and known systematic errors explain about the camera's axes; the
    bound (3,) of the noise itself for a camera without systematic errors."""
    turn_deg = systematic_turn_deg(renderer, truth, stars)
    return np.hypot(bound_deg, turn_deg) if turn_deg.any() else bound_deg
