"""Fisheye cameras against OpenCV's (5.0.0, ``fisheye.projectPoints``; data/fisheye_opencv.json, written by
build_fisheye_opencv.py), against the exact formulas of the ideal projections, and against astropy's ARC and ZEA.

OpenCV takes the angle from atan of the tangent, which near 89° amplifies rounding by the tangent, 57: pixels of a
thousand focal lengths carry 10³ · 2⁻⁵² · 57 · a dozen operations = 2e-10. Tolerance 1e-9 px.
"""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
from astropy.io.fits import Header
from astropy.wcs import WCS

from startracker import Attitude, Camera, wcs_header
from startracker.geometry.attitude import direction_to_radec
from startracker.geometry.distortion import Distortion

HERE = Path(__file__).parent
STORED = json.loads((HERE / "data" / "fisheye_opencv.json").read_text(encoding="utf-8"))


def camera_of(entry):
    lens = Distortion(**dict(zip(("k1", "k2", "k3", "k4"), entry["k1_k2_k3_k4"], strict=True)))
    return Camera(entry["fx"], entry["fy"], entry["cx"], entry["cy"], distortion=lens, projection="fisheye")


@pytest.mark.parametrize("name", STORED["cameras"])
def test_pixels_of_vectors_as_opencv_has_them(name):
    entry = STORED["cameras"][name]
    np.testing.assert_allclose(camera_of(entry).project(entry["vectors"]), entry["pixels"], rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", STORED["cameras"])
def test_vectors_of_opencv_s_pixels(name):
    entry = STORED["cameras"][name]
    vectors = np.array(entry["vectors"])
    expected = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    # 1e-9 px over 285 px of focal length, and the stretch of the inverse near the edge (below 10)
    np.testing.assert_allclose(camera_of(entry).unproject(entry["pixels"]), expected, rtol=0, atol=4e-11)


def test_no_camera_of_the_data_is_an_ideal_one_but_the_first():
    for name, entry in STORED["cameras"].items():
        ideal = Camera(entry["fx"], entry["fy"], entry["cx"], entry["cy"], projection="equidistant")
        off = np.abs(ideal.project(entry["vectors"]) - entry["pixels"]).max()
        assert off < 1e-9 if name == "equidistant" else off > 1.0


@pytest.mark.parametrize(
    ("projection", "formula"), [("equidistant", lambda t: t), ("equisolid", lambda t: 2.0 * np.sin(t / 2.0))]
)
def test_ideal_projections(projection, formula):
    camera = Camera(300.0, 300.0, 999.5, 999.5, projection=projection)
    theta = np.radians([0.0, 1e-6, 10.0, 45.0, 85.0, 90.0, 110.0, 170.0])
    vectors = np.stack([np.sin(theta) * 0.6, np.sin(theta) * -0.8, np.cos(theta)], axis=1)
    expected = 999.5 + 300.0 * formula(theta)[:, None] * [0.6, -0.8]
    np.testing.assert_allclose(camera.project(vectors), expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(camera.unproject(expected), vectors, rtol=0, atol=1e-12)


SKY = {
    "equidistant": Camera.from_fov(170.0, 1024, 1024, projection="equidistant"),
    "equisolid": Camera.from_fov(120.0, 1024, 768, projection="equisolid"),
    "mirrored": Camera(500.0, 490.0, 500.0, 300.0, 1024, 768, parity=-1, projection="equisolid"),
    "lens": Camera(
        600.0, 600.0, 511.5, 383.5, 1024, 768, Distortion(k1=-0.03, k2=0.004, k3=-0.001), projection="fisheye"
    ),
}


@pytest.mark.parametrize("name", SKY)
@pytest.mark.parametrize("pointing", [(85.0, 8.6, 0.0), (250.0, -70.0, 300.0), (10.0, 90.0, 20.0)])
def test_headers_as_astropy_reads_them(name, pointing):
    """WCSLIB's own ARC and ZEA: exact; with its SIP within the 0.002 px of the fit, 0.01 px asked."""
    camera, attitude = SKY[name], Attitude.from_radec_roll(*pointing)
    wcs = WCS(Header(wcs_header(camera, attitude)))
    xy = np.random.default_rng(5).uniform([0, 0], [camera.width - 1, camera.height - 1], (300, 2))
    vectors = camera.unproject(xy)
    xy, vectors = xy[np.isfinite(vectors[:, 2])], vectors[np.isfinite(vectors[:, 2])]
    there = np.radians(wcs.all_pix2world(xy, 0)).T
    found = np.stack([np.cos(there[1]) * np.cos(there[0]), np.cos(there[1]) * np.sin(there[0]), np.sin(there[1])], 1)
    directions = attitude.inverse.apply(vectors)
    limit_px = 1e-6 if camera.distortion.is_zero else 0.01
    assert np.linalg.norm(found - directions, axis=1).max() < limit_px * camera.pixel_rad * 2.0
    if camera.distortion.is_zero:
        back = wcs.all_world2pix(np.degrees(np.stack(direction_to_radec(directions), axis=1)), 0)
        np.testing.assert_allclose(back, xy, rtol=0, atol=1e-6)


@pytest.mark.slow
def test_data_are_what_opencv_gives_today():
    pytest.importorskip("cv2", reason="install boresight[oracles] to rebuild the data")
    spec = importlib.util.spec_from_file_location("build_fisheye_opencv", HERE / "build_fisheye_opencv.py")
    builder = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(builder)
    rebuilt = builder.build()["cameras"]
    assert rebuilt.keys() == STORED["cameras"].keys()
    for name, entry in rebuilt.items():
        for key, value in entry.items():
            np.testing.assert_allclose(value, STORED["cameras"][name][key], rtol=0, atol=1e-9)
