"""Pixel → unit vector → pixel for any camera whose distortion is one to one over its image.

Tolerance 1e-9 px, a hundred thousandth of the best centroid: Newton's last step is below 1e-14 of a normalised
coordinate, times 2e4 px of focal length and the slope of the lens there.
"""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from startracker.geometry.camera import Camera
from startracker.geometry.distortion import Distortion

lenses = st.builds(
    Distortion,
    k1=st.floats(-0.4, 0.4),
    k2=st.floats(-0.2, 0.2),
    p1=st.floats(-3e-3, 3e-3),
    p2=st.floats(-3e-3, 3e-3),
    k3=st.floats(-0.05, 0.05),
    k4=st.floats(-0.2, 0.2),
)


def one_to_one(lens, reach):
    """Whether the radial part rises everywhere up to where it meets `reach` (distorted), with a margin for the rest."""
    r = np.linspace(1e-6, 2.0 * reach + 0.5, 2000)
    radial = (1 + lens.k1 * r**2 + lens.k2 * r**4 + lens.k3 * r**6) / (1 + lens.k4 * r**2)
    distorted = r * radial
    needed = np.flatnonzero(distorted > 1.1 * reach)
    return needed.size > 0 and np.diff(distorted[: needed[0] + 1]).min() / (r[1] - r[0]) > 0.2


# field of view in degrees, width, fy / fx, parity
cameras = st.tuples(st.floats(1.0, 70.0), st.integers(32, 4096), st.floats(0.5, 2.0), st.sampled_from([1, -1]))


@settings(deadline=None)  # the first call compiles
@given(cameras, lenses, st.integers(0, 99))
def test_forward_and_inverse_agree_inside_the_image(numbers, lens, seed):
    fov_deg, width, aspect, parity = numbers
    focal = width / 2 / math.tan(math.radians(fov_deg) / 2)
    camera = Camera(focal, focal * aspect, 0.52 * width, 0.3 * width, width, width, lens, parity)
    reach = np.hypot(0.53 * width / focal, 0.71 * width / focal / aspect)
    assume(one_to_one(lens, reach))
    rng = np.random.default_rng(seed)
    edge = width - 0.5
    corners = [[-0.5, -0.5], [edge, -0.5], [-0.5, edge], [edge, edge]]
    pixels = np.concatenate([rng.uniform(-0.5, edge, (40, 2)), corners])
    vectors = camera.unproject(pixels)
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1.0, atol=1e-15)
    np.testing.assert_allclose(camera.project(vectors), pixels, rtol=0, atol=1e-9)
    # the root on the lens' near side, not another one
    assert np.abs(vectors[:, :2] / vectors[:, 2:]).max() < 2.0 * reach + 0.5


@settings(deadline=None)
@given(lenses, st.floats(0.1, 50.0))
def test_length_of_a_vector_does_not_matter(lens, length):
    camera = Camera.from_fov(20.0, 100, 100, lens)
    vector = np.array([[0.05, -0.1, 0.9]])
    np.testing.assert_allclose(camera.project(length * vector), camera.project(vector), atol=1e-10)


@pytest.mark.parametrize("parity", [1, -1])
def test_angles_between_pixels_do_not_depend_on_where_the_image_begins(parity):
    one = Camera(500.0, 500.0, 100.0, 80.0, 300, 200, Distortion(k1=-0.1), parity)
    two = Camera(500.0, 500.0, 110.0, 75.0, 300, 200, Distortion(k1=-0.1), parity)
    pixels = np.array([[10.0, 20.0], [200.0, 150.0]])
    a, b = one.unproject(pixels), two.unproject(pixels + np.array([10.0, -5.0]))
    np.testing.assert_allclose(a, b, atol=1e-15)
