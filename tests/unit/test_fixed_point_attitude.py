"""The 64-bit attitude against floating-point plate constants, over thousands of simulated fields."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from startracker.estimation import solve_plate
from startracker.fixed_point.attitude import NotSolved, plate_attitude, unit
from startracker.fixed_point.formats import CENTROID, FixedPointOverflow
from startracker.fixed_point.vectors import DIRECTION

XY = [
    [16.13144, 74.39691],
    [-162.81865, 95.40933],
    [-73.08759, 69.96350],
    [-15.73050, 143.07092],
    [79.27619, -113.87619],
]
SKY_DEG = [[279.23415, 38.78361], [283.62542, 36.89889], [281.19292, 37.605], [281.08458, 39.67], [274.96499, 36.06445]]


def directions(ra_deg, dec_deg):
    ra, dec = np.radians(ra_deg), np.radians(dec_deg)
    return np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=-1)


def fixed(vectors):
    return DIRECTION.encode(vectors, rounded=True)


def field(rng, count, fov_deg, noise_px):
    """Centroids (M, 2) with y up, unit vectors of the stars, and the camera's matrix (y down)."""
    focal_px = 256 / math.tan(math.radians(fov_deg / 2))
    camera = Rotation.random(rng=rng).as_matrix()
    xy = rng.uniform(-256, 256, (count, 2))
    seen = np.column_stack([xy[:, 0], -xy[:, 1], np.full(count, focal_px)])
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    return xy + rng.normal(0, noise_px, xy.shape), seen @ camera, camera


def float_attitude(xy, vectors):
    """Boresight, roll and x axis by the floating-point plate: nearest rotation to its map."""
    sky = np.degrees(np.column_stack([np.arctan2(vectors[:, 1], vectors[:, 0]), np.arcsin(vectors[:, 2])]))
    plate = solve_plate(xy, sky, 1e-11)
    m = plate.matrix * [1.0, -1.0]
    turn = math.atan2(m[1, 0] - m[0, 1], m[0, 0] + m[1, 1])
    center = directions(*plate.center_deg)
    ra = math.radians(plate.tangent_deg[0])
    east = np.array([-math.sin(ra), math.cos(ra), 0.0])
    north = np.cross(center, east)
    x = math.cos(turn) * east + math.sin(turn) * north
    up = math.sin(turn) * east - math.cos(turn) * north
    return plate.center_deg, math.degrees(math.atan2(up @ east, up @ north)) % 360, np.array([x, -up, center])


def well_spread(xy):
    least, most = np.linalg.eigvalsh(np.cov(xy.T))
    return least * most > 2e-3 * (least + most) ** 2


def test_vega():
    answer = plate_attitude(CENTROID.encode(XY), fixed(directions(*np.transpose(SKY_DEG))))
    assert answer.ra / 2**22 == pytest.approx(278.45703, abs=1e-5)
    assert answer.dec / 2**22 == pytest.approx(37.24007, abs=1e-5)
    assert np.issubdtype(answer.matrix.dtype, np.integer)


def test_within_an_arcsecond_of_floating_point():
    rng = np.random.default_rng(20)
    worst, solved = 0.0, 0
    for number in range(800):
        fov_deg = (2.0, 9.0, 20.0, 30.0)[number % 4]
        xy, vectors, _ = field(rng, int(rng.integers(3, 13)), fov_deg, 0.1)
        if not well_spread(xy):
            continue
        answer = plate_attitude(CENTROID.encode(xy), fixed(vectors))
        center, roll, matrix = float_attitude(xy, vectors)
        computed = DIRECTION.decode(answer.matrix)
        off = np.linalg.norm(computed - matrix, axis=1).max() * 206265.0
        around = [(answer.ra / 2**22 - center[0]) * math.cos(math.radians(center[1])), answer.dec / 2**22 - center[1]]
        around.append((answer.roll / 2**22 - roll) * math.cos(math.radians(center[1])))
        off = max(off, *(abs((a + 180) % 360 - 180) * 3600 for a in around[:2]))
        worst, solved = max(worst, off), solved + 1
    assert solved > 760
    assert worst < 1.0


def test_noiseless_stars_give_the_camera():
    rng = np.random.default_rng(21)
    for count in (3, 5, 16):
        xy, vectors, camera = field(rng, count, 9.0, 0.0)
        answer = plate_attitude(CENTROID.encode(xy), fixed(vectors))
        assert np.abs(DIRECTION.decode(answer.matrix) - camera).max() < 1e-7  # 0.02″; centroids have 2⁻¹⁶ pixels


def test_centre_that_stands_at_once():
    """Stars about the centre: the mean direction is the answer, and the map still has to be fitted to the last bit."""
    turn = Rotation.from_euler("z", 33.3, degrees=True).as_matrix()
    xy = np.array([[220.0, 73.0], [-9.0, 10.0], [-220.0, -73.0], [9.0, -10.0]])  # slender, so that one fit is not exact
    seen = np.column_stack([xy[:, 0], -xy[:, 1], np.full(4, 3000.0)])
    camera = turn @ Rotation.from_euler("yx", [20.0, 40.0], degrees=True).as_matrix()
    answer = plate_attitude(CENTROID.encode(xy), fixed(seen / np.linalg.norm(seen, axis=1, keepdims=True) @ camera))
    assert np.abs(DIRECTION.decode(answer.matrix) - camera).max() < 2e-8


def test_stars_in_a_line_turn_and_scale_alone():
    rng = np.random.default_rng(22)
    _, _, camera = field(rng, 3, 9.0, 0.0)
    focal_px = 3250.0
    xy = np.array([[-200.0, -100.0], [-20.0, -10.0], [160.0, 80.0]])
    seen = np.column_stack([xy[:, 0], -xy[:, 1], np.full(3, focal_px)])
    vectors = seen / np.linalg.norm(seen, axis=1, keepdims=True) @ camera
    answer = plate_attitude(CENTROID.encode(xy), fixed(vectors))
    assert np.abs(DIRECTION.decode(answer.matrix) - camera).max() < 1e-7


@pytest.mark.parametrize(("ra_deg", "dec_deg"), [(0.0, 89.999), (359.9999, -89.9), (180.0, 0.0), (90.0, -45.0)])
def test_everywhere_on_the_sky(ra_deg, dec_deg):
    z = directions(ra_deg, dec_deg)
    east = np.array([-math.sin(math.radians(ra_deg)), math.cos(math.radians(ra_deg)), 0.0])
    north = np.cross(z, east)
    xy = np.array([[100.0, 50.0], [-120.0, 80.0], [10.0, -140.0], [60.0, -20.0]])  # x to the west: as seen in the sky
    vectors = z + (xy[:, 1:] * north - xy[:, :1] * east) / 3000.0
    answer = plate_attitude(CENTROID.encode(xy), fixed(vectors / np.linalg.norm(vectors, axis=1, keepdims=True)))
    assert np.abs(DIRECTION.decode(answer.matrix[2]) - z).max() * 206265 < 0.02
    assert answer.dec / 2**22 == pytest.approx(dec_deg, abs=0.02 / 3600)
    roll_deg = (answer.roll / 2**22 + 180) % 360 - 180
    ra_off = ((answer.ra / 2**22 - ra_deg + 180) % 360 - 180) * math.cos(math.radians(dec_deg))
    assert abs(ra_off) * 3600 < 0.02
    assert abs(roll_deg) * math.cos(math.radians(dec_deg)) < 1e-6


def test_refusals():
    xy = CENTROID.encode(XY)
    sky = fixed(directions(*np.transpose(SKY_DEG)))
    with pytest.raises(NotSolved, match="3 to 16"):
        plate_attitude(xy[:2], sky[:2])
    with pytest.raises(NotSolved, match="mirror"):
        plate_attitude(xy * [1, -1], sky)
    with pytest.raises(NotSolved, match="different positions"):
        plate_attitude(np.repeat(xy[:1], 5, axis=0), sky)
    with pytest.raises(NotSolved, match="60°"):
        plate_attitude(xy, np.vstack([sky[:4], -sky[4:]]))
    with pytest.raises(FixedPointOverflow, match="centroid"):
        plate_attitude(xy * 4, sky)
    with pytest.raises(TypeError):
        plate_attitude(np.array(XY), sky)
    with pytest.raises(NotSolved, match="cancel"):
        unit([0, 0, 1])
    with pytest.raises(FixedPointOverflow):
        unit([1 << 37, 0, 0])
