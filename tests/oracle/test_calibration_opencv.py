"""The joint fit against OpenCV 5.0.0 and SciPy 1.17 on identical stars (data/calibration_opencv.json, written by
build_calibration_opencv.py).

- Least squares over OpenCV's ``projectPoints`` has the same minimum: both stop where a step gains nothing, SciPy's
  numerical derivatives at a relative 1e-14 of the sum; agreement to 1e-4 of each parameter's standard error.
- ``cv2.calibrateCamera`` of points without noise gives the camera that made them to the rounding of its 32-bit input
  (1e-4 px on 1600), enlarged by the translations that it fits along: 0.02 px is what it reaches itself.
"""

import importlib.util
import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from startracker.geometry import lens_fit as joint
from startracker.geometry.camera import Camera
from startracker.geometry.lens_fit import Matches, fit_jointly

HERE = Path(__file__).parent
STORED = json.loads((HERE / "data" / "calibration_opencv.json").read_text(encoding="utf-8"))
NAMES = ("f", "aspect", "cx", "cy", "k1", "k2", "p1", "p2")


def fitted(entry, which, monkeypatch):
    monkeypatch.setattr(joint, "prior_of", lambda name, camera: (0.0, math.inf))
    matrices = [Rotation.from_rotvec(t).as_matrix() for t in entry["turns"]]
    sigma = np.full(len(entry["directions"][0]), STORED["noise_px"])
    matches = [
        Matches(np.array(xy), np.array(d), sigma) for xy, d in zip(entry[which], entry["directions"], strict=True)
    ]
    focal = entry["truth"][0] * 1.003
    fit = fit_jointly(Camera(focal, focal, 799.5, 599.5, 1600, 1200), matrices, matches, NAMES)
    lens = fit.camera.distortion
    return fit, np.array(
        [fit.camera.fx, fit.camera.fy, fit.camera.cx, fit.camera.cy, lens.k1, lens.k2, lens.p1, lens.p2]
    )


@pytest.mark.parametrize("name", STORED["cameras"])
def test_the_minimum_is_the_same(name, monkeypatch):
    entry = STORED["cameras"][name]
    fit, values = fitted(entry, "measured", monkeypatch)
    sigma = np.array(entry["least_squares_sigma"])
    np.testing.assert_allclose((values - entry["least_squares"]) / sigma, 0.0, atol=1e-4)
    # errors of cx, cy and the coefficients; theirs from derivatives good to 1e-6, times the condition of a narrow field
    np.testing.assert_allclose(np.sqrt(np.diag(fit.covariance))[2:8], sigma[2:8], rtol=1e-3)


@pytest.mark.parametrize("name", STORED["cameras"])
def test_without_noise_the_truth_comes_back(name, monkeypatch):
    entry = STORED["cameras"][name]
    _, values = fitted(entry, "exact", monkeypatch)
    # the input is rounded to 1e-9 px: that share of the errors of 0.2 px
    np.testing.assert_allclose((values - entry["truth"]) / np.array(entry["least_squares_sigma"]), 0.0, atol=1e-6)


def test_calibrate_camera_agrees(monkeypatch):
    entry = STORED["cameras"]["wide"]
    _, values = fitted(entry, "exact", monkeypatch)
    np.testing.assert_allclose(values[:4], entry["calibrate_camera"][:4], rtol=0, atol=0.02)
    np.testing.assert_allclose(values[4:], entry["calibrate_camera"][4:], rtol=0, atol=2e-6)


@pytest.mark.slow
def test_data_are_what_opencv_gives_today():
    pytest.importorskip("cv2", reason="install boresight[oracles] to rebuild the data")
    spec = importlib.util.spec_from_file_location("build_calibration_opencv", HERE / "build_calibration_opencv.py")
    builder = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(builder)
    for name, entry in builder.build()["cameras"].items():
        stored = STORED["cameras"][name]
        np.testing.assert_allclose(entry["measured"], stored["measured"], rtol=0, atol=1e-8)
        sigma = np.array(stored["least_squares_sigma"])
        np.testing.assert_allclose(
            np.array(entry["least_squares"]) / sigma, np.array(stored["least_squares"]) / sigma, atol=1e-4
        )
