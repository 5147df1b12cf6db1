"""Parts of the stimulator: geometry against OpenCV, levels against brute force, files and commands."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import Image

from simulator.cli.application import run_application
from simulator.live.stimulator import (
    Curve,
    DisplayGeometry,
    Pattern,
    Photometry,
    Stimulator,
    nominal_geometry,
    read_stimulator,
    stimulator_yaml,
)
from startracker import Attitude, Camera, Distortion, InputError

RNG = np.random.default_rng(11)
CAMERA = Camera(5000, 5000, 650.3, 500.7, 1280, 1024, Distortion(k1=-0.08, k2=0.02))
ALIGNMENT = Attitude.from_rotation_vector((0.01, -0.02, 0.3), "collimator", "camera")
CURVES = {"red": Curve(2.3), "green": Curve(2.2), "blue": Curve(None, (64, 128, 255), (0.05, 0.2, 1.0))}
LIGHT = Photometry((1280, 1024), {"red": 1.0, "green": 0.2, "blue": 1.9}, CURVES, 0.98, RNG.normal(0, 0.02, 14), 1e-4)
DISPLAY = Stimulator(DisplayGeometry(CAMERA, (3.0, -2.0)), LIGHT, ALIGNMENT)


def test_geometry_is_that_of_opencv_with_a_tilted_plane():
    pixels = RNG.uniform(0, 1, (200, 2)) * [1280, 1024]
    directions = DISPLAY.geometry.to_directions(pixels)
    matrix = np.array([[5000, 0, 650.3], [0, 5000, 500.7], [0, 0, 1.0]])
    lens = np.array([-0.08, 0.02, *[0.0] * 10, *np.radians([3.0, -2.0])])
    expected, _ = cv2.projectPoints(directions, np.zeros(3), np.zeros(3), matrix, lens)
    assert expected[:, 0] == pytest.approx(pixels, abs=1e-9)
    assert DISPLAY.geometry.to_pixels(directions) == pytest.approx(pixels, abs=1e-9)


def test_patterns_have_their_dots_and_as_many_squares_of_each_level():
    pattern = Pattern(800, 640, ("green",), spacing_px=48, dot_px=5, levels=(20, 60, 120, 190, 255))
    dots = pattern.image("dots")
    assert dots.shape == (640, 800, 3)
    assert not dots[..., [0, 2]].any()
    count, labels = cv2.connectedComponents((dots[..., 1] > 0).astype(np.uint8))
    assert count - 1 == len(pattern.lattice) + 3
    assert np.bincount(labels.ravel())[1:].tolist() == [25] * (count - 1)
    levels, number = np.unique(pattern.image("ramp-green")[..., 1], return_counts=True)
    assert levels.tolist() == [0, 20, 60, 120, 190, 255]
    assert np.ptp(number[1:]) <= pattern.square_px**2  # one square more or less
    assert not pattern.image("black").any()


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"colours": ("cyan",)}, "colours must be"),
        ({"spacing_px": 51}, "even"),
        ({"spacing_px": 200}, "too few dots"),
        ({"dot_px": 25}, "spacing of at least"),
        ({"levels": (0, 10, 20, 30, 255)}, "ramp needs"),
    ],
)
def test_impossible_patterns_are_refused(keys, message):
    with pytest.raises(InputError, match=message):
        Pattern(1280, 1024, **keys)


def one_colour(gamma=2.2):
    return Photometry((64, 64), {"green": 0.0}, {"green": Curve(gamma)})


def test_levels_are_the_nearest_by_brute_force():
    light, wanted = one_colour(), RNG.uniform(0, 1.05, 500)
    pixels = np.full((500, 2), 31)
    levels = light.quantised(pixels, wanted, np.arange(500), "none")
    table = (np.arange(256) / 255) ** 2.2
    expected = np.argmin(np.abs(table - np.minimum(wanted, 1.0)[:, None]), axis=1)
    assert levels.rgb[:, 1].tolist() == expected.tolist()
    assert levels.flux == pytest.approx(table[expected])


def test_spatial_dithering_keeps_the_flux_of_a_star_within_its_faintest_step():
    light, star = one_colour(), np.repeat(np.arange(40), 9)
    wanted = RNG.exponential(0.05, 360)
    pixels = np.full((360, 2), 31)
    error = {}
    for dithering in ("none", "spatial"):
        levels = light.quantised(pixels, wanted, star, dithering)
        error[dithering] = np.bincount(star, levels.flux - wanted)
    faintest = np.array([wanted[star == k].min() for k in range(40)])
    step = 2.2 * faintest ** (1 - 1 / 2.2) / 255 + (1 / 255) ** 2.2  # dL/dlevel there, and the first step
    assert (np.abs(error["spatial"]) < step).all()
    assert np.abs(error["none"]).mean() > 3 * np.abs(error["spatial"]).mean()


def test_temporal_dithering_has_the_right_mean():
    light, wanted = one_colour(), np.array([0.003, 0.07, 0.4])
    pixels, pictures = np.array([[1, 2], [30, 40], [63, 5]]), 400
    rows = [light.quantised(pixels, wanted, np.arange(3), "temporal", n).flux for n in range(pictures)]
    step = 2.2 * wanted ** (1 - 1 / 2.2) / 255
    # multiples of the golden section deviate from uniformity by less than (1 + ln n) / n (discrepancy)
    assert np.mean(rows, axis=0) == pytest.approx(wanted, abs=(step * (1 + np.log(pictures)) / pictures).max() * 2)
    assert np.std(rows, axis=0).min() > 0


def test_a_star_has_its_flux_at_its_position_and_others_are_counted():
    white = LIGHT.white_magnitude
    at = np.array([[300.3, 200.7], [640.0, 512.0], [900.2, 700.1]])
    shown = DISPLAY.spots(at, np.array([white + 3.0, white - 2.0, white + 18.0]), np.arange(3))
    assert shown.clipped.tolist() == [False, True, False]
    assert shown.faint.tolist() == [False, False, True]
    assert shown.shown_magnitude[0] == pytest.approx(white + 3.0, abs=1e-3)
    near = np.abs(shown.pixels - at[0]).max(axis=1) < 5
    flux = DISPLAY.photometry.flux(shown.pixels[near], shown.rgb[near])
    assert flux.sum() == pytest.approx(10 ** (-0.4 * (white + 3.0)), rel=1e-3)
    # errors of single levels are half a step, 2.2 / 255 / 2 of a pixel's light, at up to two pixels from the middle
    assert flux @ shown.pixels[near] / flux.sum() == pytest.approx(at[0], abs=0.01)


def test_picture_follows_the_attitude():
    attitude = Attitude.from_radec_roll(50, 20, 30)
    pixels = np.array([[100.0, 100.0], [1200.0, 900.0]])
    seen = DISPLAY.geometry.to_directions(pixels) @ ALIGNMENT.as_matrix().T
    behind = -seen[:1]
    directions = np.concatenate([seen, behind]) @ attitude.as_matrix()
    shown = DISPLAY.picture(attitude, directions, np.full(3, 5.0))
    assert shown.star.tolist() == [0, 1]
    assert shown.position == pytest.approx(pixels, abs=1e-9)


def test_file_is_read_as_written(tmp_path):
    text = stimulator_yaml(replace(DISPLAY, uncertainty={"focal_px": 0.1}), ["a line"])
    path = tmp_path / "stimulator.yaml"
    path.write_text(text)
    assert stimulator_yaml(read_stimulator(path), ["a line"]) == text


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("tilt_deg:", "tilt:", "missing key 'tilt_deg'"),
        ("white_factor: 0.98", "white_factor: bright", "is not a stimulator file"),
        ("gamma: 2.3", "gamma: 23", "gamma from 0.2 to 6"),
        ("fx: 5000.0", "fx: -1", "focal length must be positive"),
        ("dithering: spatial", "dithering: often", "dithering must be"),
        ("collimator:", "collimator: [", "is not YAML"),
    ],
)
def test_wrong_files_are_refused_in_one_line(tmp_path, old, new, message):
    path = tmp_path / "stimulator.yaml"
    text = stimulator_yaml(DISPLAY, [])
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=message) as raised:
        read_stimulator(path)
    assert "\n" not in str(raised.value)


def test_nominal_geometry_is_focal_length_over_pitch():
    assert nominal_geometry((1280, 1024), 12.0, 60.0).collimator.fx == pytest.approx(5000.0)
    with pytest.raises(InputError, match="positive"):
        nominal_geometry((1280, 1024), 0.0, 60.0)


# ---------------------------------------------------------------------- commands


def test_pattern_command_writes_pictures_pixel_by_pixel(tmp_path, capsys):
    folder = tmp_path / "patterns"
    assert run_application(["stimulate", "pattern", str(folder), "--size", "640x560", "--spacing", "48"]) == 0
    pattern = Pattern(640, 560, spacing_px=48)
    for name in pattern.names:
        with Image.open(folder / f"{name}.png") as picture:
            assert np.array_equal(np.asarray(picture), pattern.image(name))
    assert "dots.png" in capsys.readouterr().out


def test_preview_draws_the_display_and_lists_its_limits(tmp_path, capsys):
    stimulator, out = tmp_path / "stimulator.yaml", tmp_path / "sky.png"
    stimulator.write_text(stimulator_yaml(DISPLAY, []))
    asked = ["stimulate", "preview", "cubesat", "--stimulator", str(stimulator), "--out", str(out)]
    assert run_application([*asked, "--pointing", "83,0,0"]) == 0
    text = capsys.readouterr().out
    assert "stars on the display" in text
    assert "magnitude" in text
    with Image.open(out) as picture:
        assert picture.size == (1280, 1024)
        assert np.count_nonzero(np.asarray(picture).any(axis=2)) > 200


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["preview", "cubesat", "--stimulator", "none.yaml"], "none.yaml: cannot be read"),
        (["pattern", "x", "--size", "wide"], "--size: must be WIDTHxHEIGHT"),
        (["calibrate", "none", "--camera", "c.yaml", "--focal-mm", "60", "--pitch-um", "12", "--exposure-s", "1"],
         "none: is not a folder"),
    ],
)  # fmt: skip
def test_mistakes_are_one_line(tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert run_application(["stimulate", *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
