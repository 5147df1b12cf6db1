"""Verification of an attitude against all stars: what it converges to, and where it gives up."""

import math

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from startracker.catalog import load_catalog
from startracker.catalog.guide import GuideDatabase
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.identification.acceptance import verify
from startracker.identification.observed import Observed
from startracker.identification.verification import is_known, rotation_cosine

CAMERA = Camera.from_fov(20.0, 512, 512)
ATTITUDE = Attitude.from_radec_roll(83.0, 0.0, 40.0)


@pytest.fixture(scope="module")
def guide():
    return GuideDatabase.build(load_catalog("hipparcos"), CAMERA, 5.5)


def seen(guide, noise_px, focal=1.0, count=20, seed=1):
    """Stars of a field, with errors, through a camera of another focal length, and their guide stars."""
    camera = Camera(CAMERA.fx * focal, CAMERA.fy * focal, CAMERA.cx, CAMERA.cy, 512, 512)
    index, _, _ = guide.in_field(ATTITUDE.as_matrix(), -20.0)
    index = index[:count]
    xy = camera.project(guide.directions[index] @ ATTITUDE.as_matrix().T)
    xy = xy + np.random.default_rng(seed).normal(0.0, noise_px, xy.shape)
    sigma = np.linspace(0.7, 1.3, len(index)) * noise_px * CAMERA.pixel_rad
    return Observed(CAMERA.unproject(xy), None, sigma), index


def fitted(observed, directions, step, free):
    """Attitude and ln of the focal length of the pairs at a multiple of the stated errors, with a prior of 1 % for the
    latter."""
    vectors, sigma = observed.vectors, observed.sigma_rad * step

    def residuals(p):
        predicted = directions @ (Rotation.from_rotvec(p[:3]).as_matrix() @ ATTITUDE.as_matrix()).T
        plane = vectors[:, :2] / vectors[:, 2:] * math.exp(-p[3] if free else 0.0)
        corrected = np.column_stack([plane, np.ones(len(plane))])
        corrected /= np.linalg.norm(corrected, axis=1)[:, None]
        prior = [p[3] / 0.01] if free else []
        return np.concatenate([((corrected - predicted) / sigma[:, None]).ravel(), prior])

    found = least_squares(residuals, np.zeros(4 if free else 3), x_scale=1e-4, xtol=1e-12, ftol=1e-12)
    return Rotation.from_rotvec(found.x[:3]).as_matrix() @ ATTITUDE.as_matrix(), found.x[3] if free else 0.0


@pytest.mark.parametrize("free", [False, True])
def test_an_attitude_converges_to_the_least_squares_of_its_pairs(guide, free):
    """From some pixels off. The focal length is 0.8 % longer, of which the prior takes its part."""
    observed, index = seen(guide, 2.0, 1.008 if free else 1.0)
    start = Rotation.from_rotvec([0.003, -0.002, 0.004]).as_matrix() @ ATTITUDE.as_matrix()
    found, operations = verify(start, observed, guide, 3.0, 1.0 if free else None)
    assert found.pairs.tolist() == [[k, g] for k, g in enumerate(index)]
    answers = [fitted(observed, guide.directions[index], step, free) for step in (3.0, 1.0, 0.8)]
    turns = [Attitude.from_matrix(matrix).angle_to(Attitude.from_matrix(found.matrix)) for matrix, _ in answers]
    best = int(np.argmin(turns))
    # the slopes of the directions are linear in ln f: 0.008² of the field's 0.17 rad, and rounds end when pairs stay
    assert turns[best] < 2e-5
    if free:
        assert math.log(found.focal) == pytest.approx(answers[best][1], abs=1.5e-4)
        assert len({round(value, 4) for _, value in answers}) == 3  # the prior counts
    else:
        assert found.focal == 1.0
    assert operations > 10_000


def test_attitudes_that_are_given_up(guide):
    """With fewer than three stars of a field in the gate, or five if the focal length is free."""
    observed, _ = seen(guide, 0.2)
    away = Attitude.from_radec_roll(250.0, -60.0, 0.0).as_matrix()
    assert verify(away, observed, guide, 1.0)[0] is None
    for count, free, there in ((2, None, False), (3, None, True), (4, 1.0, False), (5, 1.0, True)):
        few = Observed(observed.vectors[:count], None, observed.sigma_rad[:count])
        assert (verify(ATTITUDE.as_matrix(), few, guide, 3.0, free)[0] is not None) is there


def test_attitudes_that_are_known():
    """Within a rotation of any of them."""
    one = ATTITUDE.as_matrix()
    for angle in (0.0, 0.3, 2.0):
        other = Rotation.from_rotvec([0.0, angle, 0.0]).as_matrix() @ one
        assert rotation_cosine(one, other) == pytest.approx(math.cos(angle), abs=1e-12)
    known = np.array([Rotation.from_rotvec([0.0, angle, 0.0]).as_matrix() @ one for angle in (1.0, 0.3, 2.0)])
    assert is_known(one, known, math.cos(0.31))
    assert not is_known(one, known, math.cos(0.29))
    assert not is_known(one, known[:0], -0.9)
