"""Camera model against OpenCV's (5.0.0, ``projectPoints``; data/distortion_opencv.json, written by
build_distortion_opencv.py).

Both evaluate the same polynomial in double precision: pixels of a thousand to ten thousand focal lengths carry
10⁴ · 2⁻⁵² · a dozen operations = 3e-11 px. Tolerance 1e-9 px.
"""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

from startracker.geometry.camera import Camera
from startracker.geometry.distortion import Distortion

HERE = Path(__file__).parent
STORED = json.loads((HERE / "data" / "distortion_opencv.json").read_text(encoding="utf-8"))
NAMES = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")  # OpenCV's order


def camera_of(entry):
    coefficients = dict(zip(NAMES, entry["k1_k2_p1_p2_k3_k4_k5_k6"], strict=True))
    return Camera(entry["fx"], entry["fy"], entry["cx"], entry["cy"], distortion=Distortion(**coefficients))


@pytest.mark.parametrize("name", STORED["cameras"])
def test_pixels_of_vectors(name):
    entry = STORED["cameras"][name]
    np.testing.assert_allclose(camera_of(entry).project(entry["vectors"]), entry["pixels"], rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", STORED["cameras"])
def test_vectors_of_pixels(name):
    entry = STORED["cameras"][name]
    camera, vectors = camera_of(entry), np.array(entry["vectors"])
    found = camera.unproject(entry["pixels"])
    expected = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    # a pixel of 1e-9 over the smallest focal length, times the stretch of the inverse (below 10 here)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)


def test_the_distortions_are_not_small():
    # a test of no distortion would pass with none at all
    for entry in STORED["cameras"].values():
        vectors = np.array(entry["vectors"])
        pinhole = Camera(entry["fx"], entry["fy"], entry["cx"], entry["cy"]).project(vectors)
        assert np.abs(pinhole - entry["pixels"]).max() > 0.1  # a hundred million times the tolerance


@pytest.mark.slow
def test_data_are_what_opencv_gives_today():
    pytest.importorskip("cv2", reason="install boresight[oracles] to rebuild the data")
    spec = importlib.util.spec_from_file_location("build_distortion_opencv", HERE / "build_distortion_opencv.py")
    builder = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(builder)
    rebuilt = builder.build()["cameras"]
    assert rebuilt.keys() == STORED["cameras"].keys()
    for name, entry in rebuilt.items():
        for key, value in entry.items():
            np.testing.assert_allclose(value, STORED["cameras"][name][key], rtol=0, atol=1e-9)
