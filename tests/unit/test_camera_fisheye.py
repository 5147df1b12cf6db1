"""Fisheye cameras: there and back, fields of view, where they end, what they refuse, their files."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from startracker.errors import InputError
from startracker.geometry.camera import Camera
from startracker.geometry.distortion import Distortion
from startracker.geometry.fisheye import limit_rad

LENS = Distortion(k1=-0.03, k2=0.004, k3=-0.001, k4=1e-4)


@settings(deadline=None)
@given(
    st.tuples(st.floats(-0.1, 0.3), st.floats(-0.03, 0.1), st.floats(-0.01, 0.03), st.floats(-0.003, 0.01)),
    st.floats(10.0, 20000.0),
    st.floats(0.5, 2.0),
    st.sampled_from([1, -1]),
    st.integers(0, 99),
)
def test_there_and_back_over_a_field_of_180_degrees(k, focal, aspect, parity, seed):
    assume(limit_rad(k) > math.radians(95.0))
    lens = Distortion(k1=k[0], k2=k[1], k3=k[2], k4=k[3])
    camera = Camera(focal, focal * aspect, 5000.0, 4000.0, 10000, 8000, lens, parity, "fisheye")
    rng = np.random.default_rng(seed)
    theta, turn = np.radians(np.append(rng.uniform(0.0, 90.0, 40), [1e-9, 0.0, 85.0, 90.0])), rng.uniform(0, 7, 44)
    vectors = np.stack([np.sin(theta) * np.cos(turn), np.sin(theta) * np.sin(turn), np.cos(theta)], axis=1)
    pixels = camera.project(vectors)
    again = camera.unproject(pixels)
    np.testing.assert_allclose(np.linalg.norm(again, axis=1), 1.0, atol=1e-15)
    # 1e-9 px at the largest images of real cameras, some 5,000 px from the centre; rounding grows with the image
    limit = 1e-9 * max(1.0, np.abs(pixels).max() / 5000.0)
    np.testing.assert_allclose(camera.project(again), pixels, rtol=0, atol=limit)


def test_a_lens_of_which_newtons_steps_went_to_and_fro():
    k = (0.0, 0.06777054942782072, 0.0, -0.002066145703859815)
    lens = Distortion(k1=k[0], k2=k[1], k3=k[2], k4=k[3])
    camera = Camera(1000.0, 1000.0, 5000.0, 4000.0, 10000, 8000, lens, 1, "fisheye")
    theta = np.linspace(0.0, 0.999 * limit_rad(k), 20001)
    vectors = np.stack([np.sin(theta), np.zeros_like(theta), np.cos(theta)], axis=1)
    pixels = camera.project(vectors)
    np.testing.assert_allclose(camera.project(camera.unproject(pixels)), pixels, rtol=0, atol=1e-9)


@pytest.mark.parametrize("projection", ["equidistant", "equisolid", "fisheye"])
def test_fields_of_view(projection):
    camera = Camera.from_fov(170.0, 1000, 500, projection=projection)
    assert camera.fov_deg == pytest.approx(170.0, abs=1e-10)
    edges = camera.unproject([[-0.5, camera.cy], [camera.width - 0.5, camera.cy]])
    assert np.degrees(np.arctan2(np.abs(edges[:, 0]), edges[:, 2])) == pytest.approx([85.0, 85.0], abs=1e-10)
    corner = camera.unproject([[-0.5, -0.5]])[0]
    assert camera.half_diagonal_rad == pytest.approx(math.acos(corner[2]), abs=1e-14)
    assert camera.half_diagonal_rad > math.radians(90.0)
    top = camera.unproject([[camera.cx, -0.5]])[0]
    assert camera.fov_y_deg == pytest.approx(2.0 * math.degrees(math.acos(top[2])), abs=1e-9)
    lens = Camera(camera.fx, camera.fx, camera.cx, camera.cy, 1000, 500, Distortion(k1=0.05), projection="fisheye")
    assert lens.fov_deg < 165.0  # the polynomial is part of a fisheye's projection


def test_where_the_model_ends():
    # d/dθ θ (1 − θ²/6) = 0 at θ = √2, where r = (2/3)√2
    camera = Camera(100.0, 100.0, 199.5, 199.5, distortion=Distortion(k1=-1.0 / 6.0), projection="fisheye")
    assert camera.limit_rad == pytest.approx(math.sqrt(2.0), abs=1e-12)
    assert camera.half_diagonal_rad == camera.limit_rad  # the corners see nothing
    edge = 100.0 * 2.0 / 3.0 * math.sqrt(2.0)
    rays = camera.unproject([[199.5 + edge - 1e-6, 199.5], [199.5 + edge + 1e-6, 199.5], [0.0, 0.0]])
    assert np.isfinite(rays).all(axis=1).tolist() == [True, False, False]
    assert np.isnan(rays[1:]).all()
    past = math.sqrt(2.0) + 1e-6
    assert np.isnan(
        camera.project([[math.sin(past), 0.0, math.cos(past)], [0, 0, -1.0], [np.nan, 0, 1], [0, 0, 0]])
    ).all()
    assert camera.fov_deg == pytest.approx(2.0 * math.degrees(camera.limit_rad))
    whole = Camera(100.0, 100.0, 399.5, 399.5, projection="equisolid")
    assert np.isfinite(whole.project([[0.0, 1e-3, -1.0]])).all()
    assert np.isnan(whole.project([[0.0, 0.0, -1.0]])).all()  # straight back is everywhere on a circle
    assert np.isnan(whole.unproject([[399.5 + 200.1, 399.5]])).all()


def test_pinhole_sees_what_it_saw():
    assert Camera.from_fov(10.0, 64, 64).limit_rad == math.radians(89.9)


def test_mirrored_and_off_centre():
    camera = Camera(300.0, 310.0, 200.0, 150.0, 640, 480, LENS, -1, "fisheye")
    np.testing.assert_allclose(camera.project([[0, 0, 2.0]]), [[200.0, 150.0]], atol=0)
    assert camera.project([[0.1, 0.0, 1.0]])[0, 0] < 200.0
    np.testing.assert_array_equal(camera.unproject([[200.0, 150.0]]), [[0, 0, 1.0]])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"projection": "fish"}, "projection must be pinhole, fisheye, equidistant or equisolid"),
        ({"projection": "fisheye", "distortion": Distortion(p1=0.1)}, "fisheye has no coefficient p1; it has k1, k2"),
        ({"projection": "fisheye", "distortion": Distortion(k5=0.1)}, "no coefficient k5"),
        ({"projection": "equisolid", "distortion": Distortion(k1=0.1)}, "no coefficient k1; it has none"),
    ],
)
def test_refusals(arguments, message):
    with pytest.raises(InputError, match=message):
        Camera(100.0, 100.0, 50.0, 50.0, **arguments)


@pytest.mark.parametrize("fov_deg", [0.0, 360.0, math.nan])
def test_fields_that_cannot_be(fov_deg):
    with pytest.raises(InputError, match="between 0° and 360°"):
        Camera.from_fov(fov_deg, 100, 100, projection="equidistant")


def test_files(tmp_path):
    camera = Camera(300.0, 310.0, 200.0, 150.0, 640, 480, LENS, -1, "fisheye")
    path = tmp_path / "camera.yaml"
    camera.to_yaml(path)
    assert Camera.from_yaml(path) == camera
    assert [f.name for f in tmp_path.iterdir()] == ["camera.yaml"]
    path.write_text("fx: 300\nfy: 300\ncx: 99.5\ncy: 99.5\nprojection: 3\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"camera\.yaml: projection must be"):
        Camera.from_yaml(path)


def test_a_file_that_cannot_be_written_leaves_what_was_there(tmp_path, monkeypatch):
    camera, path = Camera.from_fov(10.0, 64, 64), tmp_path / "camera.yaml"
    path.write_text("old", encoding="utf-8")

    def refuse(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", refuse)
    with pytest.raises(InputError, match=r"cannot be written \(No space left"):
        camera.to_yaml(path)
    assert path.read_text(encoding="utf-8") == "old"
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(InputError, match="cannot be written"):
        camera.to_yaml(tmp_path / "no" / "camera.yaml")
