"""Camera: pixel conventions, fields of view, the edges of what projects, files."""

import math

import numpy as np
import pytest

from startracker.errors import InputError
from startracker.geometry.camera import Camera
from startracker.geometry.distortion import Distortion, project_pinhole, undistort

LENS = Distortion(k1=-0.1, k2=0.02, p1=1e-3, p2=-5e-4)


# ---------------------------------------------------------------- conventions
def test_boresight_is_at_the_centre_between_pixels_of_an_even_image():
    camera = Camera.from_fov(10.0, 512, 256)
    assert (camera.cx, camera.cy) == (255.5, 127.5)
    np.testing.assert_array_equal(camera.project([[0, 0, 1]]), [[255.5, 127.5]])


def test_axes_run_with_columns_and_rows():
    camera = Camera(1000.0, 500.0, 10.0, 20.0)
    # 1/1000 to +x is one column to the right, 1/500 to +y one row down
    np.testing.assert_allclose(
        camera.project([[1e-3, 0, 1], [0, 2e-3, 1], [2e-3, 4e-3, 2]]), [[11, 20], [10, 21], [11, 21]]
    )


def test_field_of_view_spans_the_full_width_edge_to_edge():
    camera = Camera.from_fov(10.0, 512, 256)
    assert camera.fx == pytest.approx(256 / math.tan(math.radians(5.0)), rel=1e-15)
    edges = camera.unproject([[-0.5, 127.5], [511.5, 127.5]])
    assert math.degrees(math.acos(edges[0] @ edges[1])) == pytest.approx(10.0, abs=1e-10)
    assert camera.fov_deg == pytest.approx(10.0, abs=1e-12)
    assert camera.fov_y_deg == pytest.approx(2 * math.degrees(math.atan(math.tan(math.radians(5.0)) / 2)), abs=1e-12)
    assert camera.pixel_rad == pytest.approx(1 / camera.fx)


def test_field_of_view_with_the_principal_point_off_centre():
    camera = Camera(100.0, 100.0, 0.0, 0.0, 101, 51)
    assert camera.fov_deg == pytest.approx(math.degrees(math.atan(0.005) + math.atan(1.005)), abs=1e-12)
    assert camera.fov_y_deg == pytest.approx(math.degrees(math.atan(0.005) + math.atan(0.505)), abs=1e-12)


@pytest.mark.parametrize("lens", [Distortion(), LENS])
def test_half_diagonal_reaches_the_farthest_corner(lens):
    camera = Camera(800.0, 800.0, 100.0, 300.0, 640, 480, lens)
    corners = camera.unproject([[-0.5, -0.5], [639.5, -0.5], [-0.5, 479.5], [639.5, 479.5]])
    assert camera.half_diagonal_rad == pytest.approx(np.arccos(corners[:, 2]).max(), abs=1e-15)
    inside = camera.unproject(np.random.default_rng(1).uniform([-0.5, -0.5], [639.5, 479.5], (200, 2)))
    assert np.arccos(inside[:, 2]).max() <= camera.half_diagonal_rad


def test_size_left_out_is_taken_around_the_principal_point():
    camera = Camera(100.0, 100.0, 255.5, 99.5)
    assert (camera.width, camera.height) == (512, 200)


def test_mirrored_image_reverses_its_columns():
    straight, mirrored = (Camera(900.0, 900.0, 300.0, 200.0, 640, 480, LENS, parity=p) for p in (1, -1))
    vectors = straight.unproject([[10.0, 20.0], [500.0, 300.0]])
    expected = straight.project(vectors) * [-1, 1] + [2 * 300.0, 0]
    np.testing.assert_allclose(mirrored.project(vectors), expected, atol=1e-10)
    np.testing.assert_allclose(mirrored.unproject(mirrored.project(vectors)), vectors, atol=1e-14)


def test_what_lies_beside_or_behind_the_camera_does_not_project():
    camera = Camera.from_fov(60.0, 100, 100, LENS)
    pixels = camera.project([[1, 0, 0], [0, 0, -1], [0.1, 0.1, -1], [np.nan, 0, 1], [0, 0, 1]])
    assert np.isnan(pixels[:4]).any(axis=1).all()
    np.testing.assert_array_equal(pixels[4], [49.5, 49.5])


def test_no_vectors_no_pixels():
    for lens in (Distortion(), LENS):
        camera = Camera.from_fov(60.0, 100, 100, lens)
        assert camera.project(np.zeros((0, 3))).shape == (0, 2)
        assert camera.unproject(np.zeros((0, 2))).shape == (0, 3)


def test_contains_counts_whole_pixels():
    camera = Camera.from_fov(10.0, 100, 50)
    points = np.array([[-0.5, 0], [-0.51, 0], [99.49, 0], [99.5, 0], [0, -0.5], [0, 49.5], [np.nan, 0]])
    assert camera.contains(points).tolist() == [True, False, True, False, True, False, False]
    assert camera.contains(points, margin_px=1.0).tolist() == [True] * 6 + [False]


def test_arguments_are_left_alone():
    camera, pixels = Camera.from_fov(60.0, 100, 100, LENS), np.array([[3.0, 4.0]])
    camera.project(camera.unproject(pixels))
    np.testing.assert_array_equal(pixels, [[3.0, 4.0]])


# ---------------------------------------------------------------- distortion
def distort(xy, k):
    return project_pinhole(np.column_stack([xy, np.ones(len(xy))]), k, 1.0, 1.0, 0.0, 0.0)


def test_distortion_by_hand():
    # Brown–Conrady at (0.3, −0.2), r² = 0.13
    lens = Distortion(k1=0.1, k2=0.2, p1=0.01, p2=0.02, k3=0.3, k4=0.4, k5=0.5, k6=0.6)
    radial = (1 + 0.1 * 0.13 + 0.2 * 0.13**2 + 0.3 * 0.13**3) / (1 + 0.4 * 0.13 + 0.5 * 0.13**2 + 0.6 * 0.13**3)
    x = 0.3 * radial + 2 * 0.01 * 0.3 * -0.2 + 0.02 * (0.13 + 2 * 0.09)
    y = -0.2 * radial + 0.01 * (0.13 + 2 * 0.04) + 2 * 0.02 * 0.3 * -0.2
    np.testing.assert_allclose(distort(np.array([[0.3, -0.2]]), lens.as_array()), [[x, y]], rtol=1e-15)


def test_kernels_against_numpy_and_scipy():
    from scipy.optimize import root

    lens = Distortion(k1=-0.2, k2=0.05, p1=2e-3, p2=-1e-3, k3=0.01, k4=0.1)
    k1, k2, p1, p2, k3, k4, _, _ = lens.as_array()

    def twin(xy):
        x, y = xy
        r2 = x**2 + y**2
        radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2)
        return np.array([x, y]) * radial + [
            2 * p1 * x * y + p2 * (r2 + 2 * x**2),
            p1 * (r2 + 2 * y**2) + 2 * p2 * x * y,
        ]

    points = np.random.default_rng(3).uniform(-0.5, 0.5, (50, 2))
    forward = distort(points, lens.as_array())
    np.testing.assert_allclose(forward, [twin(p) for p in points], atol=1e-15)
    back = undistort(forward, lens.as_array())
    for found, target in zip(back[:10], forward, strict=False):
        solved = root(lambda p, target=target: twin(p) - target, target, tol=1e-15).x
        np.testing.assert_allclose(found, solved, atol=1e-13)


def test_beyond_the_fold_of_the_lens_there_is_no_way_back():
    # x (1 − 0.5 x²) has its largest value, 0.5443, at x = 0.8165
    lens = Distortion(k1=-0.5).as_array()
    assert np.isnan(undistort(np.array([[0.56, 0.0]]), lens)).all()
    # and twice folded, x < −1.414, it has roots of the wrong sign, which are not the answer
    assert np.isnan(undistort(np.array([[1.6, 0.0], [0.0, -2.5], [3.0, 3.0]]), lens)).all()
    np.testing.assert_allclose(distort(undistort(np.array([[0.54, 0.0]]), lens), lens), [[0.54, 0.0]], atol=1e-14)
    assert np.isnan(undistort(np.array([[np.nan, 0.0]]), lens)).all()
    # a lens that rises again, past its fold at r = 0.68, would offer a direction there
    rising = Distortion(k1=-1.0, k2=0.4).as_array()
    far = np.array([[1.6, 0.0], [0.0, 2.0]])
    assert np.isnan(undistort(distort(far, rising), rising)).all()
    # and one with decentring lets Newton's steps jump across the fold to the far side of the centre
    decentred = Distortion(k1=-0.77795263, k2=-0.4664447, p1=-0.00503182, p2=0.00277436, k3=0.01114338).as_array()
    assert np.isnan(undistort(np.array([[-1.76970036, 0.76169249]]), decentred)).all()
    # and a pixel out there has no direction, with its NaN in every component
    assert np.isnan(Camera(100.0, 100.0, 99.5, 99.5, distortion=Distortion(k1=-0.5)).unproject([[190.0, 99.5]])).all()


def test_strong_lenses_are_undone_though_newton_would_start_past_their_fold():
    # this lens folds at r = 2.0, where it has brought its points out to 4.0
    lens = Distortion(k1=0.25, k2=0.125, k3=-0.03125).as_array()
    points = np.array([[0.3, 1.4], [-1.9, 0.1], [0.0, 1.99]])
    seen = distort(points, lens)
    assert np.hypot(*seen.T).min() > 2.4
    np.testing.assert_allclose(undistort(seen, lens), points, rtol=0, atol=1e-11)  # slope 0.1 at the last


def test_near_root_is_found_where_newton_first_meets_a_far_one():
    lens = Distortion(k1=0.91749412, k2=-0.39198052, p1=-0.00779078, p2=0.00462729, k3=0.00702901).as_array()
    seen = np.array([[0.32916217, 1.26018435]])
    found = undistort(seen, lens)
    np.testing.assert_allclose(found, [[0.22113813, 0.86029022]], atol=1e-7)
    np.testing.assert_allclose(distort(found, lens), seen, atol=1e-14)


# ---------------------------------------------------------------- refusals
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0.0, 1.0, 5.0, 5.0), "focal length"),
        ((1.0, -1.0, 5.0, 5.0), "focal length"),
        ((math.nan, 1.0, 5.0, 5.0), "focal length"),
        ((math.inf, 1.0, 5.0, 5.0), "focal length"),
        ((1.0, 1.0, math.nan, 5.0), "principal point"),
        ((1.0, 1.0, 5.0, 5.0, -3, 4), "at least one pixel"),
        ((1.0, 1.0, -5.0, 5.0), "at least one pixel"),
        ((1.0, 1.0, 5.0, 5.0, 10.5, 4), "whole number"),
        ((1.0, 1.0, 5.0, 5.0, 10, 4, Distortion(), 0), "parity"),
    ],
)
def test_cameras_that_cannot_be(arguments, message):
    with pytest.raises(InputError, match=message):
        Camera(*arguments)


@pytest.mark.parametrize("fov_deg", [0.0, 180.0, -5.0, math.nan])
def test_fields_that_cannot_be(fov_deg):
    with pytest.raises(InputError, match="field of view"):
        Camera.from_fov(fov_deg, 512, 512)


# ---------------------------------------------------------------- files
def test_file_round_trip_keeps_every_bit(tmp_path):
    camera = Camera(np.float64(1234.56789012345678), 1e3 / 3, 100.1, np.float32(7.5), 640, 480, LENS, -1)
    camera.to_yaml(tmp_path / "camera.yaml")
    assert Camera.from_yaml(tmp_path / "camera.yaml") == camera
    assert Camera.from_dict(camera.to_dict()) == camera


def test_file_written_by_hand(tmp_path):
    path = tmp_path / "camera.yaml"
    path.write_text("fx: 2000\nfy: 2000.5\ncx: 511.5\ncy: 383.5\ndistortion: {k1: -0.1, p2: 1e-3}\n", encoding="utf-8")
    camera = Camera.from_yaml(path)
    assert camera == Camera(2000.0, 2000.5, 511.5, 383.5, 1024, 768, Distortion(k1=-0.1, p2=1e-3))
    assert Camera(2000.0, 2000.5, 511.5, 383.5, distortion={"k1": -0.1, "p2": 1e-3}) == camera


@pytest.mark.parametrize(
    ("text", "messages"),
    [
        ("fx: 1\nfy: 1\ncx: 5\n", ["missing key 'cy'"]),
        ("fx: 1\nfy: 1\ncx: 5\ncy: 5\nfov: 3\n", ["unknown key 'fov'"]),
        (
            "fx: wide\nfy: 1\ncx: 5\ncy: yes\n",
            ["'fx' must be a finite number, not 'wide'", "'cy' must be a finite number"],
        ),
        (
            "fx: .nan\nfy: true\ncx: 5\ncy: 5\n",
            ["'fx' must be a finite number", "'fy' must be a finite number, not True"],
        ),
        ("fx: 1\nfy: 1\ncx: 5\ncy: 5\ndistortion: {q1: 1, k1: x}\n", ["'distortion.q1'", "'distortion.k1' must be"]),
        ("fx: 1\nfy: 1\ncx: 5\ncy: 5\ndistortion: [1, 2]\n", ["'distortion' must hold"]),
        ("fx: 0\nfy: 1\ncx: 5\ncy: 5\n", ["focal length must be positive"]),
        ("- 1\n- 2\n", ["none of the keys fx, fy, cx, cy"]),
        ("", ["none of the keys"]),
        ("fx: [1\n", ["is not YAML"]),
        ("fx: 1\nfx: 2\nfy: 1\ncx: 5\ncy: 5\n", ["is not YAML", "duplicate key"]),
    ],
)
def test_faults_of_a_file_are_named_all_at_once(tmp_path, text, messages):
    path = tmp_path / "camera.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        Camera.from_yaml(path)
    line = str(caught.value)
    assert all(message in line for message in messages), line
    assert line.startswith(str(path))
    assert "\n" not in line


def test_files_that_are_not_there_or_not_text(tmp_path):
    with pytest.raises(InputError, match=r"no\.yaml: cannot be read .*No such file"):
        Camera.from_yaml(tmp_path / "no.yaml")
    with pytest.raises(InputError, match="cannot be read"):
        Camera.from_yaml(tmp_path)
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00\x9f")
    with pytest.raises(InputError, match="is not YAML"):
        Camera.from_yaml(tmp_path / "binary.yaml")


# ---------------------------------------------------------------- fields of view of real lenses
def angle_deg(one, other):
    return math.degrees(math.atan2(np.linalg.norm(np.cross(one, other)), one @ other))


@pytest.mark.parametrize("parity", [1, -1])
def test_field_of_view_of_a_distorted_lens_is_that_between_the_edges(parity):
    """Along the row and column of the principal point, from edge to edge; without distortion from the focal length."""
    camera = Camera(900.0, 950.0, 200.0, 330.0, 512, 420, LENS, parity)
    left, right = camera.unproject([[-0.5, 330.0], [511.5, 330.0]])
    top, bottom = camera.unproject([[200.0, -0.5], [200.0, 419.5]])
    assert camera.fov_deg == pytest.approx(angle_deg(left, right), rel=1e-12)
    assert camera.fov_y_deg == pytest.approx(angle_deg(top, bottom), rel=1e-12)
    plain_x = math.degrees(math.atan(200.5 / 900.0) + math.atan(311.5 / 900.0))
    plain_y = math.degrees(math.atan(330.5 / 950.0) + math.atan(89.5 / 950.0))
    assert camera.undistorted_fov_deg == pytest.approx(plain_x, rel=1e-12)
    assert camera.fov_deg != pytest.approx(plain_x, rel=1e-4)
    ideal = Camera(900.0, 950.0, 200.0, 330.0, 512, 420, parity=parity)
    assert ideal.fov_deg == pytest.approx(plain_x, rel=1e-12)
    assert ideal.fov_y_deg == pytest.approx(plain_y, rel=1e-12)
    assert ideal.fov_text == f"{plain_x:.3f}° × {plain_y:.3f}°"
    # beyond the fold no pixel has a direction
    folded = Camera(300.0, 310.0, 200.0, 330.0, 512, 420, Distortion(k1=-0.9))
    assert np.isnan(folded.unproject([[511.5, 330.0], [200.0, -0.5]])).all()
    assert folded.fov_deg == pytest.approx(math.degrees(math.atan(200.5 / 300.0) + math.atan(311.5 / 300.0)))
    assert folded.fov_y_deg == pytest.approx(math.degrees(math.atan(330.5 / 310.0) + math.atan(89.5 / 310.0)))
    farthest = math.atan(math.hypot(311.5 / 300.0, 330.5 / 310.0))
    assert folded.half_diagonal_rad == pytest.approx(farthest)


def test_field_of_view_of_a_fisheye_ends_at_its_image_circle():
    lens = Distortion(k1=-0.02)
    camera = Camera(300.0, 310.0, 200.0, 330.0, 512, 420, lens, projection="fisheye")
    left, right = camera.unproject([[-0.5, 330.0], [511.5, 330.0]])
    top, bottom = camera.unproject([[200.0, -0.5], [200.0, 419.5]])
    assert camera.fov_deg == camera.undistorted_fov_deg == pytest.approx(angle_deg(left, right), rel=1e-9)
    assert camera.fov_y_deg == pytest.approx(angle_deg(top, bottom), rel=1e-9)
    corner = camera.unproject([[511.5, -0.5]])[0]
    assert camera.half_diagonal_rad == pytest.approx(math.acos(corner[2]), rel=1e-9)
    # a principal point beside the image: both edges on one side of it
    beside = Camera(300.0, 310.0, -40.0, 330.0, 512, 420, lens, projection="fisheye")
    left, right = beside.unproject([[-0.5, 330.0], [511.5, 330.0]])
    assert beside.fov_deg == pytest.approx(angle_deg(left, right), rel=1e-9)
    small = Camera(20.0, 20.0, 200.0, 330.0, 512, 420, lens, projection="fisheye")
    assert small.fov_deg == pytest.approx(2.0 * math.degrees(small.limit_rad))
    assert small.half_diagonal_rad == pytest.approx(small.limit_rad)


def test_contains_is_enlarged_on_all_sides():
    camera = Camera.from_fov(10.0, 20, 10)
    for margin in (0.0, 2.5, -2.0):
        low, high = -0.5 - margin, np.array([19.5, 9.5]) + margin
        inside = [[low, low], [high[0] - 1e-9, 5.0], [5.0, high[1] - 1e-9]]
        outside = [[low - 1e-9, 5.0], [5.0, low - 1e-9], [high[0], 5.0], [5.0, high[1]], [np.nan, 5.0]]
        assert camera.contains(np.array(inside), margin).all()
        assert not camera.contains(np.array(outside), margin).any()
