"""Places of pixels and pixels of places.

The tangent plane's formulas (Calabretta & Greisen 2002, eqs. 54 and 55 with the rotation written out) are the oracle
for a pinhole; both are exact, so that the tolerance is rounding. The size of the aberration is v/c · sin θ.
"""

from dataclasses import replace

import numpy as np
import pytest

from startracker import Attitude, Camera, InputError, Observer, Solution, Status
from startracker.geometry.distortion import Distortion
from startracker.solution import MatchedStars

CAMERAS = {
    "pinhole": Camera.from_fov(20.0, 800, 600),
    "mirrored": replace(Camera.from_fov(20.0, 800, 600), parity=-1),
    "distorted": Camera(900.0, 905.0, 380.0, 310.0, 800, 600, Distortion(-0.2, 0.05, 0.001, -0.002)),
    "fisheye": Camera(260.0, 260.0, 399.5, 299.5, 800, 600, projection="equidistant"),
}


def solved(camera, attitude):
    return Solution(Status.SOLVED, "", attitude, np.eye(3), MatchedStars.none(), camera=camera)


def test_a_pinhole_is_the_gnomonic_projection():
    camera, ra0, dec0 = CAMERAS["pinhole"], np.radians(200.0), np.radians(35.0)
    solution = solved(camera, Attitude.from_radec_roll(200.0, 35.0, 0.0))
    xy = np.random.default_rng(1).uniform([0, 0], [799, 599], (50, 2))
    # without roll: east to the left, north up
    xi, eta = -(xy[:, 0] - camera.cx) / camera.fx, -(xy[:, 1] - camera.cy) / camera.fy
    below = np.cos(dec0) - eta * np.sin(dec0)
    ra = ra0 + np.arctan2(xi, below)
    dec = np.arctan2(np.sin(dec0) + eta * np.cos(dec0), np.hypot(xi, below))
    assert solution.radec_of(xy) == pytest.approx(np.degrees(np.stack([ra, dec], axis=1)), abs=1e-10)


@pytest.mark.parametrize("name", CAMERAS)
def test_there_and_back(name):
    camera = CAMERAS[name]
    solution = solved(camera, Attitude.from_radec_roll(10.0, -80.0, 123.0))
    observer = Observer(velocity_km_s=np.array([10.0, -25.0, 12.0]))
    xy = np.random.default_rng(2).uniform([-0.5, -0.5], [799.5, 599.5], (200, 2))
    for given in (None, observer):
        places = solution.radec_of(xy, given)
        assert solution.pixel_of(*places.T, given) == pytest.approx(xy, abs=1e-8)
    assert solution.radec_of(xy[0]).shape == (1, 2)
    assert solution.pixel_of(10.0, -80.0) == pytest.approx(np.array([[camera.cx, camera.cy]]), abs=1e-8)


def test_the_aberration_is_taken_off_by_its_known_size():
    solution = solved(CAMERAS["pinhole"], Attitude.from_radec_roll(90.0, 0.0, 0.0))
    speed = 29.78
    observer = Observer(velocity_km_s=np.array([speed, 0.0, 0.0]))  # across the boresight, towards RA 0
    centre = np.array([[399.5, 299.5]])
    seen, catalogued = solution.radec_of(centre)[0], solution.radec_of(centre, observer)[0]
    # stars are seen ahead of where they are: towards RA 0, so the catalogue's RA is larger
    assert catalogued[0] - seen[0] == pytest.approx(np.degrees(speed / 299_792.458), rel=1e-4)
    assert catalogued[1] == pytest.approx(0.0, abs=1e-9)


def test_what_is_outside_and_what_is_wrong():
    solution = solved(CAMERAS["distorted"], Attitude.from_radec_roll(10.0, 20.0, 0.0))
    assert np.isnan(solution.pixel_of([190.0, 10.0], [-20.0, 80.0])).all()
    with pytest.raises(InputError, match=r"shape \(N, 2\)"):
        solution.radec_of([1.0, 2.0, 3.0])
    with pytest.raises(InputError, match=r"not solved.*too_few_stars: 2 stars"):
        Solution(Status.TOO_FEW_STARS, "2 stars").pixel_of(1.0, 2.0)


def test_what_a_solution_says_of_itself():
    """The larger error across the boresight, and proper names of the stars that have one."""
    camera, sigma = CAMERAS["pinhole"], np.radians(np.array([2.0, 3.0, 40.0]) / 3600.0)
    stars = MatchedStars(
        np.array([[100.0, 200.0], [300.0, 400.0]]),
        np.array([5, 6]),
        np.array(["HIP 32350", "Alp CMa"]),
        np.array([6.0, -1.44]),
        np.zeros(2),
        np.zeros((2, 2)),
    )
    attitude = Attitude.from_radec_roll(200.0, 35.0, 10.0)
    solution = Solution(Status.SOLVED, "", attitude, np.diag(sigma**2), stars, stars.xy, camera=camera)
    assert "RA 200.0000°, Dec +35.0000°, roll 10.00°, 2 stars, σ 3.0″/40.0″, aberration not corrected" in repr(solution)
    chart = solution._chart()
    assert "Sirius" in chart
    assert "HIP 32350" in chart
    assert replace(solution, centroids=np.empty((0, 2)))._chart() == ""
    assert replace(solution, camera=None)._chart() == ""
