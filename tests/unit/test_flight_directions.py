"""Directions of the flight build in C: the grid table beside Camera, aberration and proper motion beside ERFA."""

import ctypes
import shutil
from types import SimpleNamespace

import erfa
import numpy as np
import pytest
from flight_c import SANITIZED, library
from scipy.spatial.transform import Rotation

from simulator.randomness import stream
from startracker import load_catalog
from startracker.catalog.guide import GuideDatabase
from startracker.errors import InputError
from startracker.flight.apparent import guide_motion
from startracker.flight.directions import GRID_MODULES, grid_arrays, grid_constants, grid_tables
from startracker.geometry.attitude import matrix_to_quat
from startracker.geometry.camera import Camera
from startracker.geometry.distortion import Distortion

pytestmark = [pytest.mark.system, pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc on this machine")]

ONE = 1 << 30
FASTEST = 1 << 20
"""Largest component of a velocity over that of light, 2.30: 2⁻¹⁰."""
CAMERAS = {
    "pinhole": Camera(4870.0, 4860.0, 515.0, 508.0, 1024, 1024),
    "distorted": Camera.from_fov(20.0, 1024, 768, Distortion(k1=-0.2, k2=0.05, p1=1e-3, p2=-5e-4)),
    "rational": Camera(1500.0, 1510.0, 640.0, 500.0, 1280, 1024, Distortion(k1=0.2, k2=0.1, k4=0.5, k5=0.1)),
    "mirrored": Camera.from_fov(40.0, 1024, 1024, Distortion(k1=-0.1), "pinhole"),
    "equidistant": Camera(900.0, 905.0, 520.0, 380.0, 1024, 768, projection="equidistant"),
    "equisolid": Camera(800.0, 800.0, 520.0, 380.0, 1024, 768, projection="equisolid", parity=-1),
    "fisheye": Camera(900.0, 900.0, 511.5, 511.5, 1024, 1024, Distortion(k1=0.05, k2=-0.02), projection="fisheye"),
}


def tables_of(camera):
    return grid_tables(SimpleNamespace(camera=camera))


class Vector(ctypes.Structure):
    _fields_ = (("x", ctypes.c_int32), ("y", ctypes.c_int32), ("z", ctypes.c_int32))

    def numbers(self):
        return [self.x, self.y, self.z]


class Directions:
    """The compiled functions of a camera, in integers in both arithmetics."""

    def __init__(self, camera, folder, arithmetic="fixed"):
        t = tables_of(camera)
        constants = {"MAX_STARS": 60, "SEARCH_KEPT": 4, **grid_constants(t)}
        self.tables = t
        self.c = library(folder, GRID_MODULES, constants, grid_arrays(t), SANITIZED, arithmetic=arithmetic)

    def plane_of(self, x, y):
        """Tangent-plane position of a pixel of 16 fraction bits; None outside the image."""
        out = (ctypes.c_int32 * 2)()
        return list(out) if self.c.tracker_plane_of(x, y, out) else None

    def image_of(self, plane):
        """Pixel of 16 fraction bits of a tangent-plane position; None outside the image."""
        out = (ctypes.c_int32 * 2)()
        return list(out) if self.c.tracker_image_of((ctypes.c_int32 * 2)(*plane), out) else None

    def vector_of(self, plane):
        out = Vector()
        self.c.tracker_vector_of((ctypes.c_int32 * 2)(*plane), ctypes.byref(out))
        return out.numbers()

    def slopes_of(self, x, y):
        out = (ctypes.c_int32 * 4)()
        self.c.tracker_slopes_of(x, y, out)
        return np.array(out).reshape(2, 2)

    def project(self, matrix, direction):
        """Tangent-plane position of a direction; None if it is too far off-axis."""
        out, rows = (ctypes.c_int32 * 2)(), (ctypes.c_int32 * 9)(*matrix.ravel().tolist())
        return list(out) if self.c.tracker_project(rows, ctypes.byref(Vector(*direction.tolist())), out) else None

    def apparent(self, direction, motion, velocity, years):
        out, observer = Vector(), (ctypes.c_int32 * 4)(*velocity.tolist(), years)
        given = (ctypes.c_int32 * 3)(*direction.tolist()), (ctypes.c_int16 * 3)(*motion.tolist())
        self.c.tracker_apparent(*given, observer, ctypes.byref(out))
        return out.numbers()

    def turned(self, matrix, angles):
        """An attitude after small rotations; None if they are too large."""
        rows = (ctypes.c_int32 * 9)(*matrix.ravel().tolist())
        done = self.c.tracker_turn(rows, *(ctypes.c_int64(angle) for angle in angles.tolist()))
        return np.array(rows, np.int64).reshape(3, 3) if done else None

    def quaternion_of(self, matrix):
        out = (ctypes.c_int32 * 4)()
        self.c.tracker_quaternion_of((ctypes.c_int32 * 9)(*matrix.ravel().tolist()), out)
        return np.array(out)


@pytest.fixture(scope="module")
def distorted(tmp_path_factory):
    return Directions(CAMERAS["distorted"], tmp_path_factory.mktemp("c"))


def unit_vectors(rng, count):
    sky = rng.normal(size=(count, 3))
    return np.rint(sky / np.linalg.norm(sky, axis=1)[:, None] * ONE).astype(np.int64)


@pytest.mark.parametrize("arithmetic", ["fixed", "float"])
@pytest.mark.parametrize("name", CAMERAS)
def test_the_table_gives_the_directions_of_the_camera(name, arithmetic, tmp_path):
    """0.002 px, the bound of the documentation: the export's 0.001 px is met at the sampled quarters of the cells."""
    camera, rng = CAMERAS[name], stream(1, "grid")
    edge = np.array([[-0.5, -0.5], [camera.width - 0.51, camera.height - 0.51], [-0.5, camera.height - 0.51]])
    xy = np.concatenate([rng.uniform((-0.5, -0.5), (camera.width - 0.51, camera.height - 0.51), (3000, 2)), edge])
    built = Directions(camera, tmp_path, arithmetic)
    plane = [built.plane_of(x, y) for x, y in np.rint(xy * 65536).astype(int).tolist()]
    found = np.array([built.vector_of(position) for position in plane]) / ONE
    assert np.abs(camera.project(found) - xy).max() < 0.002
    assert np.abs((found**2).sum(axis=1) - 1.0).max() < 2e-8
    assert (np.abs(plane) <= built.tables.half + 200).all()  # 0.003 px
    # and back: Newton's method ends within 0.001 px in the plane, where a pixel of the edge is up to half as large
    back = [built.image_of(position) for position in plane]
    assert np.abs(np.array(back) / 65536 - xy).max() < 0.003
    beyond = np.array([[3, 3], [-3, 3], [0, 3], [-3, 0]]) * built.tables.half
    assert not any(built.image_of(position) for position in np.clip(beyond, -(1 << 31), (1 << 31) - 1).tolist())


def test_the_edge_of_the_image(distorted):
    """Half a pixel beyond the first and last centres, to the last bit."""
    right, lower = (1024 << 16) - 32768, (768 << 16) - 32768
    for x, y in ((-32768, -32768), (right - 1, lower - 1), (0, 0)):
        assert distorted.plane_of(x, y) is not None
    for x, y in ((-32769, 0), (0, -32769), (right, 0), (0, lower), (2**31 - 1, 2**31 - 1), (-(2**31), 0)):
        assert distorted.plane_of(x, y) is None


def test_slopes_are_the_derivatives_of_the_position(tmp_path):
    camera = CAMERAS["fisheye"]
    built = Directions(camera, tmp_path)
    xy = stream(2, "slopes").uniform(1.0, 1022.0, (500, 2))
    slopes = np.array([built.slopes_of(x, y) for x, y in np.rint(xy * 65536).astype(int).tolist()]) / 65536.0

    def exact(points):
        v = camera.unproject(points)
        return camera.fx * v[:, :2] / v[:, 2:]

    for axis in range(2):
        step = 1e-3 * np.eye(2)[axis]
        derivative = (exact(xy + step) - exact(xy - step)) / 2e-3
        # the error of the table, 0.002 px, over half a cell
        assert np.abs(slopes[:, :, axis] - derivative).max() < 2e-3


def test_projections_are_the_tangents(distorted):
    """To a bit of 16, those of directions to 2⁻³⁰ at a focal length of 2900 px; refused from 45° off-axis on."""
    rng, focal = stream(6, "projections"), distorted.tables.focal
    refused = 0
    for direction in unit_vectors(rng, 2000):
        matrix = np.rint(Rotation.random(random_state=rng).as_matrix() * ONE).astype(np.int64)
        x, y, z = matrix @ direction / ONE**2
        position = distorted.project(matrix, direction)
        refused += position is None
        assert (position is None) == (max(abs(x), abs(y)) > z)
        if position is not None:
            assert np.abs(np.array(position) - focal * np.array([x, y]) / z).max() < 1.0 + 3e-9 * focal
    assert 1000 < refused < 2000


@pytest.mark.parametrize(
    ("camera", "words"),
    [
        (Camera(500.0, 500.0, 511.5, 511.5, 1024, 1024, projection="equidistant"), "45°"),
        (Camera(400.0, 400.0, 511.5, 300.0, 1024, 601), "45°"),
        (Camera(1200.0, 1200.0, 511.5, 511.5, 1024, 1024, Distortion(k1=-1.5)), "ends within"),
        (Camera(40_000.0, 40_000.0, 511.5, 511.5, 1024, 1024), "focal lengths"),
    ],
)
def test_cameras_that_are_refused(camera, words):
    with pytest.raises(InputError, match=words) as refused:
        tables_of(camera)
    assert "\n" not in str(refused.value)


def test_aberration_beside_erfa(distorted):
    """0.001″: the roundings of 2.30 are 0.0004″. ERFA's gravitational term is below 0.5 µas."""
    rng = stream(3, "aberration")
    sky, still = unit_vectors(rng, 200), np.zeros(3, np.int64)
    for _ in range(20):
        velocity = np.rint(rng.uniform(-1.0, 1.0, 3) * rng.choice([1.1e-4, FASTEST / ONE]) * ONE).astype(np.int64)
        seen = np.array([distorted.apparent(direction, still, velocity, 0) for direction in sky]) / ONE
        beta = velocity / ONE
        exact = erfa.ab(sky / ONE, beta, 1.0, np.sqrt(1.0 - beta @ beta))
        assert np.degrees(np.linalg.norm(seen - exact, axis=1)).max() * 3600.0 < 0.001


def test_proper_motion_beside_erfa(distorted):
    """Hipparcos' stars over 25 years by ERFA's ``pmsafe`` without radial velocities: 0.01″, half a step of the table's
    motions, 0.2 mas a year on each axis, for 25 years being 0.0083″, and 0.001″ of roundings."""
    guide = GuideDatabase.build(load_catalog("hipparcos"), CAMERAS["pinhole"], 6.5)
    start = np.rint(guide.directions * ONE).astype(np.int64)
    ra, dec = np.arctan2(*guide.directions.T[1::-1]), np.arcsin(guide.directions[:, 2])
    motion = guide.motion_axes.T
    east = np.column_stack([-np.sin(ra), np.cos(ra), np.zeros_like(ra)])
    north = np.cross(guide.directions, east)
    rates = [(motion * axis).sum(axis=1) for axis in (east, north)]
    for years in (-25, 10, 25):
        epochs = 2451545.0, 0.0, 2451545.0, 365.25 * years
        parallax, at_rest = np.ones_like(ra), np.zeros_like(ra)  # without radial velocity any parallax will do
        moved = erfa.pmsafe(ra, dec, rates[0] / np.cos(dec), rates[1], parallax, at_rest, *epochs)
        exact = erfa.s2c(moved[0], moved[1])
        still, motions = np.zeros(3, np.int64), guide_motion(guide)
        seen = [distorted.apparent(*star, still, years << 16) for star in zip(start, motions, strict=True)]
        seen = np.array(seen) / ONE
        seen /= np.linalg.norm(seen, axis=1, keepdims=True)
        assert np.degrees(np.linalg.norm(seen - exact, axis=1)).max() * 3600.0 < 0.01
        assert np.degrees(np.linalg.norm(guide.directions - exact, axis=1)).max() * 3600.0 > 7.0 * abs(years)


def test_rotations_and_quaternions_beside_scipy(distorted):
    """A turn by 1e-3 rad is exact to its square, 1e-6; the rows' products to 6e-9: three truncations by
    2⁻³⁰ and that of the length. Quaternions of all four forms; a turn that leaves no axis is refused."""
    rng, largest = stream(4, "turns"), set()
    for _ in range(300):
        start = Rotation.random(random_state=rng).as_matrix()
        matrix = np.rint(start * ONE).astype(np.int64)
        angles = np.rint(rng.uniform(-1e-3, 1e-3, 3) * ONE).astype(np.int64)
        after = distorted.turned(matrix, angles)
        assert np.abs(after / ONE - Rotation.from_rotvec(-angles / ONE).as_matrix() @ start).max() < 2e-6
        assert np.abs((after / ONE) @ (after / ONE).T - np.eye(3)).max() < 6e-9
        assert np.abs(distorted.quaternion_of(matrix) / ONE - matrix_to_quat(start)).max() < 4e-9
        largest.add(int(np.abs(matrix_to_quat(start)).argmax()))
    assert largest == {0, 1, 2, 3}
