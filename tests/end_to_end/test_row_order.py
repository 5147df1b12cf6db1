"""One photograph as PNG and as FITS, whose first row is the bottom or the top of the picture: the same attitude, roll
and parity, the same camera, and world coordinates that belong to the pixels of each file."""

import json

import numpy as np
import pytest
from astropy.io import fits
from astropy.wcs import WCS
from PIL import Image

from simulator.checks import load_scenario
from simulator.cli import _run
from simulator.fits import read_fits, write_fits
from simulator.renderer import Renderer
from startracker import Attitude, Camera, load_catalog, read_image
from startracker.geometry.distortion import Distortion
from startracker.wcs import wcs_header

CAMERA = Camera.from_fov(16.0, 640, 481)
ATTITUDE = Attitude.from_radec_roll(84.0, 2.0, 25.0)
ASYMMETRIC = slice(0, 200), slice(0, 300)
"""Pixels of the top left corner, to which a map of bad pixels refers."""


@pytest.fixture(scope="module")
def pixels():
    """An 8-bit picture of Orion's belt, the top row first."""
    stars = load_catalog("hipparcos").brighter_than(7.0)
    directions, _ = stars.space_motion()
    vectors = ATTITUDE.apply(directions)
    near = np.flatnonzero(vectors[:, 2] > np.cos(CAMERA.half_diagonal_rad))
    xy = CAMERA.project(vectors[near])
    image = np.random.default_rng(1).normal(20.0, 1.5, (481, 640))
    rows, columns = np.mgrid[0:481, 0:640]
    for (x, y), v in zip(xy, stars.v_mag[near], strict=True):
        if CAMERA.contains(np.array([[x, y]]))[0]:
            image += 15.0 * 10 ** (-0.4 * (v - 7.0)) * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 2.5)
    return np.clip(image, 0, 255).astype(np.uint8)


def write(folder, kind, pixels):
    """The picture as a file, and whether its stored rows are reversed."""
    path = folder / ("sky.png" if kind == "png" else f"sky-{kind}.fits")
    if kind == "png":
        Image.fromarray(pixels).save(path)
        return path, False
    unit = fits.PrimaryHDU(pixels if kind == "TOP-DOWN" else pixels[::-1])
    if kind != "silent":
        unit.header["ROWORDER"] = kind
    unit.writeto(path)
    return path, kind != "TOP-DOWN"


KINDS = ["png", "silent", "BOTTOM-UP", "TOP-DOWN"]


def solved(capsys, *arguments):
    capsys.readouterr()
    assert _run(["solve", "--json", *map(str, arguments)]) == 0
    return json.loads(capsys.readouterr().out)


def test_one_picture_has_one_attitude_and_the_world_coordinates_of_its_file(pixels, capsys, tmp_path):
    """Bit for bit the same answer. The header of each file gives its own pixels, counted from its first row, the
    catalogue's positions within a tenth of a pixel (0.0025°), and the file that is written is solved alike."""
    reference = None
    for kind in KINDS:
        path, is_reversed = write(tmp_path, kind, pixels)
        wcs = tmp_path / f"wcs-{kind}.fits"
        answer = solved(capsys, path, "--wcs", wcs)
        got = {k: answer[k] for k in ("ra_deg", "dec_deg", "roll_deg", "parity", "quaternion", "stars")}
        reference = reference or got
        assert got == reference
        assert got["parity"] == 1
        assert got["roll_deg"] == pytest.approx(25.0, abs=0.05)
        stored = np.asarray(fits.getdata(path) if kind != "png" else pixels)
        with fits.open(wcs) as units:
            header, data = units[0].header, units[0].data
        np.testing.assert_array_equal(data, stored)
        assert header["ROWORDER"] == ("BOTTOM-UP" if is_reversed else "TOP-DOWN")
        stars = load_catalog("hipparcos")
        directions, _ = stars.space_motion()
        row = {int(number): k for k, number in enumerate(stars.id)}
        xy = np.array([[star["x"], star["y"]] for star in got["stars"]])
        xy[:, 1] = 480.0 - xy[:, 1] if is_reversed else xy[:, 1]
        seen = directions[[row[star["catalog_id"]] for star in got["stars"]]]
        ra, dec = np.radians(WCS(header).all_pix2world(xy, 0)).T
        found = np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=1)
        assert np.degrees(np.median(np.linalg.norm(found - seen, axis=1))) < 0.0025
        again = solved(capsys, wcs)
        assert {k: again[k] for k in got} == got


@pytest.mark.parametrize("kind", KINDS)
def test_one_camera_file_and_one_map_of_bad_pixels_serve_all(kind, pixels, capsys, tmp_path):
    """Known camera: the attitude of the true one. A map in PNG has the top row first; one in FITS without ROWORDER
    belongs to the stored pixels of the image."""
    camera, bad = tmp_path / "camera.yaml", np.zeros(pixels.shape, np.uint8)
    CAMERA.to_yaml(camera)
    bad[ASYMMETRIC] = 1
    path, is_reversed = write(tmp_path, kind, pixels)
    maps = {"png": tmp_path / "map.png", "stored": tmp_path / "map.fits"}
    Image.fromarray(bad).save(maps["png"])
    fits.PrimaryHDU(bad[::-1] if is_reversed or kind == "png" else bad).writeto(maps["stored"])
    whole = solved(capsys, path, "--camera", camera)
    off = Attitude(np.array(whole["quaternion"])).rotation_vector_to(ATTITUDE)
    assert np.degrees(np.linalg.norm(off)) < 0.01  # a third of a pixel about the boresight, over 400 px
    for name in maps.values():
        masked = solved(capsys, path, "--camera", camera, "--bad-pixels", name)
        assert masked["parity"] == 1
        assert not any(star["x"] < 298 and star["y"] < 198 for star in masked["stars"])
    assert any(star["x"] < 298 and star["y"] < 198 for star in whole["stars"])


def test_our_own_frames_have_the_top_row_first_and_say_so(capsys, tmp_path):
    """Written, read and written again they are the same bits, with or without the card (frames of earlier releases);
    `read_image` gives the same rows; a file whose rows a program has reversed, and says so, is the same frame."""
    frame, truth = Renderer(load_scenario("cubesat_ideal")).frame(3)
    path = tmp_path / "frame.fits"
    write_fits(path, frame, truth)
    with fits.open(path) as units:
        header, stored = units[0].header, units[0].data.copy()
    assert header["ROWORDER"] == "TOP-DOWN"
    np.testing.assert_array_equal(stored, frame.image)
    np.testing.assert_array_equal(read_fits(path).image, frame.image)
    np.testing.assert_array_equal(read_image(path).image, frame.image.astype(np.float32))
    for key in ("ROWORDER", "CHECKSUM", "DATASUM"):
        header.remove(key)
    fits.PrimaryHDU(stored, header).writeto(tmp_path / "old.fits")
    header["ROWORDER"] = "BOTTOM-UP"
    fits.PrimaryHDU(stored[::-1], header).writeto(tmp_path / "reversed.fits")
    answers = [solved(capsys, tmp_path / name) for name in ("frame.fits", "old.fits", "reversed.fits")]
    for name in ("old.fits", "reversed.fits"):
        np.testing.assert_array_equal(read_fits(tmp_path / name).image, frame.image)
    assert answers[0]["quaternion"] == answers[1]["quaternion"] == answers[2]["quaternion"]


def test_world_coordinates_of_reversed_rows_with_distortion():
    """SIP polynomials of odd and even terms: every pixel has the direction of the same pixel of the other order."""
    camera = Camera(1500.0, 1490.0, 300.0, 250.0, 640, 480, Distortion(k1=-0.2, p1=2e-3, p2=-3e-3))
    one, other = (WCS(fits.Header(wcs_header(camera, ATTITUDE, row_order=o))) for o in ("TOP-DOWN", "BOTTOM-UP"))
    xy = np.random.default_rng(2).uniform([0, 0], [639, 479], (200, 2))
    flipped = np.stack([xy[:, 0], 479.0 - xy[:, 1]], axis=1)
    np.testing.assert_allclose(other.all_pix2world(flipped, 0), one.all_pix2world(xy, 0), rtol=0, atol=1e-9)
    sky = one.all_pix2world(xy, 0)
    np.testing.assert_allclose(other.sip.foc2pix(other.sip.pix2foc(flipped, 0), 0), flipped, rtol=0, atol=0.02)
    # the inverse polynomials, of their own sign
    np.testing.assert_allclose(other.all_world2pix(sky, 0), flipped, rtol=0, atol=1e-3)
