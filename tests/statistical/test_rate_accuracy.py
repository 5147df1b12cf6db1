"""How errors grow with the rate of turn: as the Cramér–Rao bound does, also where star images become trails.

A camera of 16 mm f/1.4 with pixels of 5.86 µm turns by 2 to 19 px in an exposure. The bound
(`simulator.study.trials.bounds`) knows the smeared images. Before, bright trails of 6 to 12 px were measured as points,
with errors of up to 18 times the bound, in those frames that have the most bright stars.
"""

import numpy as np
import pytest

from simulator import Scenario
from simulator.study.trials.bounds import attitude_bound_deg, matched_sources
from simulator.study.trials.trial import TrialRunner, solve_frame

CAMERA = (
    "optics.focal_length_mm=16", "optics.aperture_mm=11.43", "detector.pixel_pitch_um=5.86", "detector.width=1936",
    "detector.height=1216", "detector.hot_pixel_fraction=0", "seed=11",
)  # fmt: skip
RATES_DEG_S = (0.25, 0.5, 0.7, 1.0, 1.4, 2.0)
FRAMES = 50


def ratios(axis, rate_deg_s):
    """Errors of attitudes over their bounds, (N, 3), at a rate about the camera's x or y axis (rows or columns)."""
    rate = [0.0, 0.0, 0.0]
    rate[axis] = rate_deg_s
    runner = TrialRunner(Scenario.load("cubesat_ideal", [*CAMERA, f"pointing.rate_deg_s={rate}"]))
    out = []
    for k in range(FRAMES):
        frame, truth = runner.renderer.frame(k)
        solution = solve_frame(runner.tracker, frame)
        error = np.degrees(truth.attitude.rotation_vector_to(solution.attitude))
        used = matched_sources(truth, solution.stars.xy)
        out.append(error / attitude_bound_deg(runner.renderer, truth, used))
    return np.array(out)


@pytest.mark.slow
@pytest.mark.parametrize("axis", [0, 2])
def test_errors_grow_with_the_rate_as_the_bound_does(axis):
    for rate in RATES_DEG_S:
        found = ratios(axis, rate)
        rms = np.sqrt(np.mean(found**2, axis=0))
        # one axis of N attitudes is good to 1/√(2N); 1.2: motion, camera and errors are fitted, and 60 stars of all
        # that are in the field are used
        assert (rms < 1.2 + 3.0 / np.sqrt(2.0 * FRAMES)).all(), rate
        # of 150 normal deviates one exceeds 4.5 once in 1,000 tries
        assert np.abs(found).max() < 1.2 * 4.5, rate
