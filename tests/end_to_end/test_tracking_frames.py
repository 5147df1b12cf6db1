"""Rendered frames, tracked: windows in place of the frame, and as good an attitude."""

import math

import numpy as np
import pytest

from simulator import Scenario
from simulator.renderer import Renderer
from startracker.geometry.attitude import Attitude
from startracker.tracker import StarTracker
from startracker.tracking import RateNoise, TrackingSession

FRAMES, DT = 10, 0.5


@pytest.mark.parametrize("rate_deg_s", [0.0, 1.0, 2.0])
def test_short_sequence_of_the_cubesat(rate_deg_s):
    """At 2°/s a star's image is a streak of 8 px."""
    rate = f"[{0.5 * rate_deg_s}, {0.7 * rate_deg_s}, {-0.5 * rate_deg_s}]"
    scenario = Scenario.load(
        "scenarios/cubesat_ideal.yaml",
        overrides=[
            "detector.width=512",
            "detector.height=512",
            "sky.magnitude_limit=7.5",
            "detector.exposure_s=0.05",
            f"pointing.rate_deg_s={rate}",
        ],
    )
    renderer = Renderer(scenario)
    tracker = StarTracker(renderer.camera, magnitude_limit=6.5, identifier="adaptive")
    session = TrackingSession(tracker, RateNoise(1e-6), exposure_s=scenario.detector.exposure_s)
    _, first = renderer.frame(0)
    attitude, modes, single, tracked = first.attitude, [], [], []
    for k in range(FRAMES):
        frame, truth = renderer.frame(k, at_s=first.t_s + k * DT, attitude=attitude)
        given = {
            "observer": frame.observer,
            "saturation_dn": frame.saturation_dn,
            "gain_e_per_dn": frame.gain_e_per_dn,
        }
        alone = tracker.solve(frame.image, **given)
        found = session.update(frame.image, k * DT, **given)
        assert found.solved or not alone.solved
        if found.solved:
            error = truth.attitude.rotation_vector_to(found.attitude)
            assert np.linalg.norm(error) < math.radians(0.2)
            assert error @ np.linalg.solve(found.covariance, error) < 35.0  # chi-square of three above that: 1e-7
            modes.append(session.state.mode)
            if k >= 3:
                assert session.state.windows > 0
                assert session.state.matched >= 0.6 * alone.matched
                tracked.append(error[:2])
                single.append(truth.attitude.rotation_vector_to(alone.attitude)[:2])
        # the first frame's rate: another trial's has another pointing error, and would shake the camera
        attitude = Attitude.from_rotation_vector(first.rate_camera_rad_s * DT, "camera", "camera") @ attitude
    assert modes[0] == "lost_in_space"
    assert modes[3:] == ["tracking"] * (FRAMES - 3)
    # fourteen values each: their rms is known to 1/√28
    assert np.sqrt(np.mean(np.square(tracked))) < np.sqrt(np.mean(np.square(single))) * (1.0 + 3.0 / math.sqrt(28.0))
