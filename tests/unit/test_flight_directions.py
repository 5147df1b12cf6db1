"""Directions of the flight build: the grid table beside Camera, aberration and proper motion beside ERFA, and C beside
Python."""

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
from startracker.flight.apparent import MOST_YEARS, FlightObserver, apparent, guide_motion
from startracker.flight.directions import (
    FASTEST,
    GRID_MODULES,
    aberrated,
    directions,
    grid_arrays,
    grid_constants,
    grid_tables,
    plane_of,
    project,
    quaternion_of,
    slopes_of,
    turned,
    unit,
    vectors_of,
)
from startracker.geometry.attitude import matrix_to_quat
from startracker.geometry.camera import Camera
from startracker.geometry.distortion import Distortion

pytestmark = pytest.mark.system

ONE = 1 << 30
CAMERAS = {
    "pinhole": Camera(4870.0, 4860.0, 515.0, 508.0, 1024, 1024),
    "distorted": Camera.from_fov(20.0, 1024, 768, Distortion(k1=-0.2, k2=0.05, p1=1e-3, p2=-5e-4)),
    "rational": Camera(1500.0, 1510.0, 640.0, 500.0, 1280, 1024, Distortion(k1=0.2, k2=0.1, k4=0.5, k5=0.1)),
    "mirrored": Camera.from_fov(40.0, 1024, 1024, Distortion(k1=-0.1), "pinhole"),
    "equidistant": Camera(900.0, 905.0, 520.0, 380.0, 1024, 768, projection="equidistant"),
    "equisolid": Camera(800.0, 800.0, 520.0, 380.0, 1024, 768, projection="equisolid", parity=-1),
    "fisheye": Camera(900.0, 900.0, 511.5, 511.5, 1024, 1024, Distortion(k1=0.05, k2=-0.02), projection="fisheye"),
}
needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc on this machine")


def tables_of(camera):
    return grid_tables(SimpleNamespace(camera=camera))


@pytest.mark.parametrize("name", CAMERAS)
def test_the_table_gives_the_directions_of_the_camera(name):
    """0.002 px, the bound of the documentation: the export's 0.001 px is met at the sampled quarters of the cells."""
    camera = CAMERAS[name]
    rng = stream(1, "grid")
    edge = np.array([[-0.5, -0.5], [camera.width - 0.51, camera.height - 0.51], [-0.5, camera.height - 0.51]])
    xy = np.concatenate([rng.uniform((-0.5, -0.5), (camera.width - 0.51, camera.height - 0.51), (20_000, 2)), edge])
    tables = tables_of(camera)
    found = directions(xy, tables)
    assert np.abs(camera.project(found) - xy).max() < 0.002
    assert np.abs((found**2).sum(axis=1) - 1.0).max() < 2e-8
    plane, inside = plane_of(np.rint(xy * 65536).astype(np.int64), tables)
    assert inside.all()
    assert (np.abs(plane) <= tables.half + 200).all()  # 0.003 px


def test_slopes_are_the_derivatives_of_the_position():
    camera = CAMERAS["fisheye"]
    tables = tables_of(camera)
    xy = stream(2, "slopes").uniform(1.0, 1022.0, (500, 2))
    slopes = slopes_of(np.rint(xy * 65536).astype(np.int64), tables) / 65536.0

    def exact(points):
        v = camera.unproject(points)
        return camera.fx * v[:, :2] / v[:, 2:]

    for axis in range(2):
        step = 1e-3 * np.eye(2)[axis]
        derivative = (exact(xy + step) - exact(xy - step)) / 2e-3
        # the error of the table, 0.002 px, over half a cell
        assert np.abs(slopes[:, :, axis] - derivative).max() < 2e-3


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


def test_aberration_beside_erfa():
    """0.001″: the roundings of 2.30 are 0.0004″. ERFA's gravitational term is below 0.5 µas."""
    rng = stream(3, "aberration")
    sky = unit(np.rint(rng.normal(size=(500, 3)) * ONE).astype(np.int64))
    for _ in range(20):
        velocity = np.rint(rng.uniform(-1.0, 1.0, 3) * rng.choice([1.1e-4, FASTEST / ONE]) * ONE).astype(np.int64)
        seen, beta = aberrated(sky, velocity) / ONE, velocity / ONE
        exact = erfa.ab(sky / ONE, beta, 1.0, np.sqrt(1.0 - beta @ beta))
        assert np.degrees(np.linalg.norm(seen - exact, axis=1)).max() * 3600.0 < 0.001


def test_proper_motion_beside_erfa():
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
        seen = apparent(start, guide_motion(guide), FlightObserver(np.zeros(3, np.int64), years << 16)) / ONE
        seen /= np.linalg.norm(seen, axis=1, keepdims=True)
        assert np.degrees(np.linalg.norm(seen - exact, axis=1)).max() * 3600.0 < 0.01
        assert np.degrees(np.linalg.norm(guide.directions - exact, axis=1)).max() * 3600.0 > 7.0 * abs(years)


def test_rotations_and_quaternions_beside_scipy():
    """A turn by 1e-3 rad is exact to its square, 1e-6; the rows' products to 6e-9: three truncations by
    2⁻³⁰ and that of the length."""
    rng = stream(4, "turns")
    for _ in range(300):
        start = Rotation.random(random_state=rng).as_matrix()
        matrix = np.rint(start * ONE).astype(np.int64)
        angles = np.rint(rng.uniform(-1e-3, 1e-3, 3) * ONE).astype(np.int64)
        after = turned(matrix, angles)
        assert np.abs(after / ONE - Rotation.from_rotvec(-angles / ONE).as_matrix() @ start).max() < 2e-6
        assert np.abs((after / ONE) @ (after / ONE).T - np.eye(3)).max() < 6e-9
        assert np.abs(quaternion_of(matrix) / ONE - matrix_to_quat(start)).max() < 4e-9


class Vector(ctypes.Structure):
    _fields_ = (("x", ctypes.c_int32), ("y", ctypes.c_int32), ("z", ctypes.c_int32))


class Matrix(ctypes.Structure):
    _fields_ = (("row", Vector * 3),)


def matrix_of(values):
    return Matrix((Vector * 3)(*(Vector(*map(int, row)) for row in values)))


def rows_of(matrix):
    return [[row.x, row.y, row.z] for row in matrix.row]


@needs_gcc
@pytest.mark.parametrize("arithmetic", ["fixed", "float"])
def test_c_and_python_are_the_same_bits(tmp_path, arithmetic):
    """Both builds compute directions in integers."""
    camera, rng = CAMERAS["distorted"], stream(5, "bits")
    t = tables_of(camera)
    constants = {"MAX_STARS": 60, "SEARCH_KEPT": 4, **grid_constants(t)}
    lib = library(tmp_path, GRID_MODULES, constants, grid_arrays(t), SANITIZED, arithmetic=arithmetic)
    xy = rng.integers(-(2**17), 1025 << 16, (10_000, 2))
    xy[:6] = [
        [-32768, -32768],
        [-32769, 0],
        [0, (768 << 16) - 32768],
        [(1024 << 16) - 32769, 0],
        [2**31 - 1] * 2,
        [0, 0],
    ]
    plane, inside = plane_of(xy, t)
    vectors, slopes = vectors_of(plane, t), slopes_of(np.clip(xy, 0, 700 << 16), t)
    out, vector, four = (ctypes.c_int32 * 2)(), Vector(), (ctypes.c_int32 * 4)()
    for k, (x, y) in enumerate(xy.tolist()):
        assert lib.tracker_plane_of(x, y, out) == inside[k]
        if inside[k]:
            assert list(out) == plane[k].tolist()
            lib.tracker_vector_of(out, ctypes.byref(vector))
            assert [vector.x, vector.y, vector.z] == vectors[k].tolist()
            lib.tracker_slopes_of(min(max(x, 0), 700 << 16), min(max(y, 0), 700 << 16), four)
            assert list(four) == slopes[k].ravel().tolist()
    sky = unit(rng.integers(-ONE, ONE, (1000, 3)))
    sky[:3] = np.eye(3, dtype=np.int64) * ONE
    for k in range(1000):
        velocity = rng.integers(-FASTEST, FASTEST + 1, 3) * (k % 5 > 0)
        matrix = np.rint(Rotation.random(random_state=rng).as_matrix() * ONE).astype(np.int64)
        if k % 2:  # near the axis
            matrix[2] = sky[k]
            matrix[0] = unit(np.cross((sky[k] >> 2), [1 << 15, 3 << 13, 1])[None])[0]
            matrix[1] = np.cross(matrix[2].astype(float), matrix[0].astype(float)) // ONE
        direction, c_matrix = Vector(*sky[k].tolist()), matrix_of(matrix)
        speed = Vector(*velocity.tolist())
        lib.tracker_aberrate(ctypes.byref(direction), ctypes.byref(speed), ctypes.byref(vector))
        assert [vector.x, vector.y, vector.z] == aberrated(sky[k][None], velocity)[0].tolist()
        motion, years = rng.integers(-(1 << 15), 1 << 15, 3), int(rng.integers(-MOST_YEARS, MOST_YEARS + 1)) << 16
        observer = (ctypes.c_int32 * 4)(*velocity.tolist(), years)
        lib.tracker_apparent(
            ctypes.byref(direction), (ctypes.c_int16 * 3)(*motion.tolist()), observer, ctypes.byref(vector)
        )
        expected = apparent(sky[k][None], motion[None], FlightObserver(velocity, years))[0]
        assert [vector.x, vector.y, vector.z] == expected.tolist()
        ((position,), (ahead,)) = project(matrix, sky[k][None], t)
        assert lib.tracker_project(ctypes.byref(c_matrix), ctypes.byref(direction), out) == ahead
        assert not ahead or list(out) == position.tolist()
        lib.tracker_quaternion_of(ctypes.byref(c_matrix), four)
        assert list(four) == quaternion_of(matrix).tolist()
        angles = rng.integers(-(1 << 28), 1 << 28, 3) >> int(rng.integers(0, 20))
        after = turned(matrix, angles)
        assert lib.tracker_turn(ctypes.byref(c_matrix), *(ctypes.c_int64(int(a)) for a in angles)) == (
            after is not None
        )
        assert after is None or rows_of(c_matrix) == after.tolist()
