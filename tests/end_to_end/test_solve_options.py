"""Options of ``boresight solve`` on a drawn field of known attitude: account, pixels, WCS, picture, parity, maps."""

import json
from dataclasses import replace

import numpy as np
import pytest
from astropy.io import fits
from astropy.wcs import WCS
from PIL import Image

from simulator.cli import _run
from startracker import Attitude, Camera, load_catalog
from startracker.geometry.attitude import direction_to_radec

CAMERA = Camera.from_fov(16.0, 640, 480)
ATTITUDE = Attitude.from_radec_roll(84.0, 2.0, 25.0)
WIDE = 0.02
"""Degrees: some pixels, as the focal length is fitted to drawn stars with noise."""


@pytest.fixture(scope="module")
def sky(tmp_path_factory):
    """An 8-bit picture of Orion's belt: stars to V = 7 with noise."""
    stars = load_catalog("hipparcos").brighter_than(7.0)
    directions, _ = stars.space_motion()
    vectors = ATTITUDE.apply(directions)
    near = np.flatnonzero(vectors[:, 2] > np.cos(CAMERA.half_diagonal_rad))
    xy = CAMERA.project(vectors[near])
    image = np.random.default_rng(1).normal(20.0, 1.5, (480, 640))
    rows, columns = np.mgrid[0:480, 0:640]
    for (x, y), v in zip(xy, stars.v_mag[near], strict=True):
        if CAMERA.contains(np.array([[x, y]]))[0]:
            image += 15.0 * 10 ** (-0.4 * (v - 7.0)) * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 2.5)
    file = tmp_path_factory.mktemp("sky") / "belt.png"
    Image.fromarray(np.clip(image, 0, 255).astype(np.uint8)).save(file)
    return file


@pytest.fixture
def solve(capsys):
    def run(*arguments):
        capsys.readouterr()
        code = _run(["solve", *map(str, arguments)])
        return code, *capsys.readouterr()

    return run


def test_explain_tells_the_stages_in_their_order(sky, solve):
    code, out, _ = solve(sky, "--explain")
    assert code == 0
    first, *lines = out.splitlines()
    assert "solved" in first
    stages = [line[2:18].split()[0] for line in lines if line[2] != " "]
    assert stages == ["image", "background", "detection", "centroids", "identification", "attitude"]
    _, quiet, _ = solve(sky)
    assert len(quiet.splitlines()) == 1


def test_pixels_and_wcs_agree_with_the_truth_and_each_other(sky, solve, tmp_path):
    wcs = tmp_path / "belt.fits"
    code, out, _ = solve(sky, "--json", "--pixel", "0,0", "--pixel", "639,100.5", "--wcs", wcs)
    assert code == 0
    answer = json.loads(out)
    xy = np.array([[0.0, 0.0], [639.0, 100.5]])
    told = np.array([[p["ra_deg"], p["dec_deg"]] for p in answer["pixels"]])
    true = np.degrees(np.stack(direction_to_radec(ATTITUDE.inverse.apply(CAMERA.unproject(xy))), axis=1))
    assert told == pytest.approx(true, abs=WIDE)
    with fits.open(wcs) as units:
        read = WCS(units[0].header).all_pix2world(xy, 0)
        assert units[0].data.shape == (480, 640)
    assert read == pytest.approx(told, abs=1.0 / 3600.0)
    assert {step["stage"] for step in answer["steps"]} >= {"image", "identification"}


def test_a_picture_with_grid_and_figures(sky, solve, tmp_path):
    picture = tmp_path / "belt.png"
    code, _, err = solve(sky, "--annotate", picture, "--grid", "--constellations")
    assert (code, err) == (0, "")
    with Image.open(picture) as drawn:
        assert drawn.size[0] > 1000


def test_parity(sky, solve, tmp_path):
    mirrored = tmp_path / "mirrored.png"
    with Image.open(sky) as image:
        image.transpose(Image.Transpose.FLIP_LEFT_RIGHT).save(mirrored)
    for file, side, other, sign in ((sky, "seen", "mirrored", 1), (mirrored, "mirrored", "seen", -1)):
        code, out, _ = solve(file, "--json", "--parity", side)
        assert (code, json.loads(out)["parity"]) == (0, sign)
        assert json.loads(out)["ra_deg"] == pytest.approx(84.0, abs=WIDE)
        assert solve(file, "--parity", other)[0] == 1


def test_a_map_of_bad_pixels_and_a_mosaic(sky, solve, tmp_path):
    bad = np.zeros((480, 640), np.uint8)
    bad[:160] = 1
    file = tmp_path / "bad.png"
    Image.fromarray(bad).save(file)
    code, out, _ = solve(sky, "--json", "--bad-pixels", file)
    assert code == 0
    assert min(star["y"] for star in json.loads(out)["stars"]) > 158
    assert solve(sky, "--bayer", "RGGB")[0] == 0  # grey light is a mosaic of equal filters


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (("--pixel", "5"), "X,Y"),
        (("--pixel", "nan,3"), "X,Y"),
        (("--parity", "left"), "mirrored"),
        (("--grid",), "--annotate"),
        (("--bayer", "XYZW"), "RGGB"),
        (("--bad-pixels", "missing.png"), "missing.png"),
    ],
)
def test_mistakes_are_one_clear_line(sky, solve, arguments, word):
    code, out, err = solve(sky, *arguments)
    assert (code, out) == (2, "")
    assert word in err
    assert err.count("\n") == 1


def test_every_estimator_runs_under_its_name(sky, solve, tmp_path):
    CAMERA.to_yaml(tmp_path / "camera.yaml")
    angles = {}
    for name in (None, "field_fit", "svd", "star_pair"):
        chosen = [] if name is None else ["--estimator", name]
        code, out, _ = solve(sky, "--camera", tmp_path / "camera.yaml", "--json", *chosen)
        assert code == 0
        angles[name] = np.array(json.loads(out)["quaternion"])
    assert np.array_equal(angles[None], angles["field_fit"])
    assert not np.array_equal(angles["svd"], angles["field_fit"])
    # two of the stars: their centroids have errors of hundredths of a pixel, of 1.5′
    assert 1e-7 < np.abs(angles["star_pair"] - angles["field_fit"]).max() < 1e-3
    code, _, err = solve(sky, "--camera", tmp_path / "camera.yaml", "--estimator", "svg")
    assert (code, err.strip().endswith("did you mean 'svd'?")) == (2, True)
    code, _, err = solve(sky, "--estimator", "svd")
    assert (code, "--estimator needs --camera or --fov" in err) == (2, True)


def test_a_known_camera_reaches_as_deep_as_the_picture(sky, solve, tmp_path):
    """Stars to V = 7 in a part of the picture with fewer guide stars to V = 6.5 than stars."""
    part, camera = tmp_path / "part.png", tmp_path / "camera.yaml"
    with Image.open(sky) as image:
        image.crop((120, 90, 520, 390)).save(part)
    replace(CAMERA, width=400, height=300, cx=CAMERA.cx - 120, cy=CAMERA.cy - 90).to_yaml(camera)
    deep, shallow = (
        json.loads(solve(part, "--json", "--camera", camera, *limit)[1]) for limit in ((), ("--magnitude-limit", "6.5"))
    )
    assert deep["matched"] > shallow["matched"]
    assert deep["matched"] >= 0.9 * deep["detected"]
    assert max(star["v_mag"] for star in deep["stars"]) > 6.5 >= max(star["v_mag"] for star in shallow["stars"])


def test_the_direction_is_that_of_the_image_centre_wherever_the_principal_point_is(sky, solve, tmp_path):
    """A part of the picture whose camera has its principal point 60 px and 20 px from the middle of that part."""
    part, file = tmp_path / "part.png", tmp_path / "camera.yaml"
    with Image.open(sky) as image:
        image.crop((0, 0, 520, 440)).save(part)
    camera = replace(CAMERA, width=520, height=440)
    camera.to_yaml(file)
    middle = CAMERA.unproject(np.array([[259.5, 219.5]])) @ ATTITUDE.as_matrix()
    ra_deg, dec_deg = np.degrees(np.stack(direction_to_radec(middle[0])))
    answer = json.loads(solve(part, "--json", "--camera", file)[1])
    assert (answer["ra_deg"], answer["dec_deg"]) == pytest.approx((ra_deg, dec_deg), abs=WIDE)
    axis = answer["principal_point"]
    assert (axis["x"], axis["y"]) == (camera.cx, camera.cy)
    assert (axis["ra_deg"], axis["dec_deg"]) == pytest.approx((84.0, 2.0), abs=WIDE)
    assert "(principal point RA 8" in solve(part, "--camera", file)[1]
    blind = json.loads(solve(part, "--json")[1])
    assert (blind["ra_deg"], blind["dec_deg"]) == pytest.approx((ra_deg, dec_deg), abs=WIDE)
    assert "principal point" not in solve(part)[1]
