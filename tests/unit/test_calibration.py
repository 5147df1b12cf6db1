"""Calibration: derivatives, what is refused, the file, the figure, the command."""

import math
from dataclasses import replace
from datetime import date

import numpy as np
import pytest

from simulator.cli import _run
from startracker import Attitude, Camera, InputError
from startracker.calibration import StarField, calibrate
from startracker.calibration.consensus import focal_lengths
from startracker.calibration.plot import residual_figure, residual_picture
from startracker.calibration.procedure import _notes
from startracker.calibration.result import camera_yaml, rounded, summary
from startracker.catalog import load_catalog
from startracker.geometry.attitude import rotation_vector_to_matrix
from startracker.geometry.distortion import Distortion
from startracker.geometry.lens import PARAMETERS, change_lens, is_one_to_one, sensitivity
from startracker.geometry.lens_fit import Matches, stretch

LENSES = {
    "pinhole": Camera(900.0, 905.0, 520.0, 370.0, 1024, 768, Distortion(k1=-0.2, k2=0.05, k3=-0.01, p1=2e-3, p2=-1e-3)),
    "mirrored": Camera(900.0, 905.0, 520.0, 370.0, 1024, 768, Distortion(k1=0.1), parity=-1),
    "fisheye": Camera(
        300.0, 301.0, 520.0, 370.0, 1024, 768, Distortion(k1=0.05, k2=-0.01, k3=2e-3, k4=-1e-4), projection="fisheye"
    ),
}


def vectors_of(camera):
    rng = np.random.default_rng(3)
    reach = 0.5 if camera.projection == "pinhole" else 1.6
    angle, turn = reach * np.sqrt(rng.uniform(0, 1, 40)), rng.uniform(0, 2 * math.pi, 40)
    angle[0] = 1e-9
    return np.stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], axis=1)


@pytest.mark.parametrize("name", LENSES)
def test_derivatives_are_those_of_finite_steps(name):
    camera = LENSES[name]
    vectors = vectors_of(camera)
    places, moves, by_vector = sensitivity(camera, vectors)
    np.testing.assert_allclose(places, camera.project(vectors), rtol=0, atol=1e-9)
    for parameter in PARAMETERS[camera.projection]:
        step = 1e-4
        ahead = change_lens(camera, {parameter: step}).project(vectors)
        behind = change_lens(camera, {parameter: -step}).project(vectors)
        # second differences of e^x over 1e-4: 2e-9 of the value; pixels carry 1e-13 / 1e-4
        np.testing.assert_allclose(moves[parameter], (ahead - behind) / (2 * step), rtol=1e-7, atol=1e-5)
    for axis in np.eye(3):
        step = 1e-6
        ahead, behind = (camera.project(vectors @ rotation_vector_to_matrix(s * step * axis).T) for s in (1, -1))
        turned = np.einsum("nij,nj->ni", by_vector, np.cross(vectors, axis))
        np.testing.assert_allclose(turned, (ahead - behind) / (2 * step), rtol=0, atol=1e-4)


def test_a_folding_lens_is_not_one_to_one():
    camera = Camera.from_fov(60.0, 1000, 800)
    assert is_one_to_one(camera)
    assert is_one_to_one(replace(camera, distortion=Distortion(k1=-0.2)))
    # turns back at r = √(1/3 · 0.6) = 0.745 with an image of 0.497, inside the corner at 0.74
    assert not is_one_to_one(replace(camera, distortion=Distortion(k1=-0.6)))


def test_stretch_shortens_one_axis():
    moved = stretch(np.array([[0.1, 0.2, 0.97]]), np.array([1e-3, 0.0]))
    np.testing.assert_allclose(moved, [[0.1001, 0.1998, 0.97]])
    # a turn of the axes by 45° turns (a, 0) into (0, a)
    np.testing.assert_allclose(stretch(np.array([[0.1, 0.1, 1.0]]), np.array([0.0, 1e-3])), [[0.1001, 0.1001, 1.0]])


def field_of(camera, attitude, count=60, noise_px=0.1, name="image", seed=8):
    table = load_catalog("hipparcos").brighter_than(8.0)
    directions = table.directions(table.epoch_jyear)
    matrix = attitude.as_matrix()
    near = np.flatnonzero(directions @ matrix[2] > math.cos(min(1.02 * camera.half_diagonal_rad, 3.0)))
    xy = camera.project(directions[near] @ matrix.T)
    keep = np.flatnonzero(camera.contains(xy) & np.isfinite(xy).all(axis=1))[:count]
    rng = np.random.default_rng(seed)
    measured = xy[keep] + rng.normal(0, noise_px, (len(keep), 2))
    flux = 10.0 ** (-0.4 * table.v_mag[near[keep]])
    return StarField(name, measured, camera.width, camera.height, flux, np.full(len(keep), noise_px**2))


@pytest.fixture(scope="module")
def made():
    truth = Camera.from_fov(20.0, 1000, 800, Distortion(k1=-0.15))
    attitudes = (Attitude.from_radec_roll(85.0, 5.0, 10.0), Attitude.from_radec_roll(280.0, 38.0, 120.0))
    return truth, [field_of(truth, a, name=f"sky {k}") for k, a in enumerate(attitudes)]


@pytest.fixture(scope="module")
def calibration(made):
    return calibrate(made[1])


def test_the_file_reads_back(calibration, tmp_path):
    text = camera_yaml(calibration, date(2026, 3, 1))
    place = tmp_path / "camera.yaml"
    place.write_text(text, encoding="utf-8")
    assert Camera.from_yaml(place) == calibration.camera
    comments = [line for line in text.splitlines() if line.startswith("#")]
    assert "2026-03-01" in comments[0]
    assert any(f"{calibration.stars} stars" in line for line in comments)
    assert any("k1" in line and "±" in line for line in comments)
    assert len(comments) == len(summary(calibration)) + 1


def test_the_camera_is_found(made, calibration):
    truth, _ = made
    values = calibration.values()
    for name in ("fx", "fy"):
        value, sigma, unit = values[name]
        assert abs(value - getattr(truth, name)) < 4 * sigma
        assert 0 < sigma < 1.0
        assert unit == "px"
    assert abs(values["k1"][0] + 0.15) < 4 * values["k1"][1]
    assert calibration.rms_px == pytest.approx(0.1 * math.sqrt(2), rel=0.15)
    assert calibration.rms_arcsec == pytest.approx(calibration.rms_px * truth.pixel_rad * 206_264.8, rel=1e-3)
    plain = np.concatenate(calibration.plain_residual_px)
    assert np.sum(plain**2) > 4 * np.sum(calibration.residual_px**2)


def test_held_principal_point_is_said(made):
    truth, _ = made
    narrow = replace(Camera.from_fov(8.0, 1000, 800), parity=-1)
    result = calibrate([field_of(narrow, Attitude.from_radec_roll(85.0, 5.0, 10.0), 30, 0.3)])
    assert result.camera.parity == -1
    assert "cx" not in result.names
    assert any("principal point held" in note for note in result.notes)
    told = calibrate([field_of(truth, Attitude.from_radec_roll(85.0, 5.0, 10.0))], parameters=["cx", "cy", "k1"])
    assert told.names == ("f", "cx", "cy", "k1")


def test_only_parameters_held_by_their_prior_are_said_to_be(calibration):
    """60 stars of 0.1 px in each of two fields of 20° determine the fitted terms; 30 of 1 px in one of 8° do not
    determine the principal point within 3 % of the width (30 px), of which the note speaks."""
    assert calibration.held_by_prior() == []
    assert not any("mainly by the prior" in note for note in calibration.notes)
    narrow = field_of(Camera.from_fov(8.0, 1000, 800), Attitude.from_radec_roll(85.0, 5.0, 10.0), 30, 1.0)
    held = calibrate([narrow], parameters=["cx", "cy"])
    assert held.held_by_prior() == ["cx", "cy"]
    assert any(note.startswith("cx and cy: determined mainly by the prior") for note in held.notes)


def test_noise_beyond_the_stated_errors_is_found(made):
    """Errors of 0.2 px stated as 0.05 px: a floor of √(0.2² − 0.05²) = 0.194 px. The median of the squared residuals of
    n = 180 stars is known to 1/(ln 2 √n) = 11 % (an exponential distribution), and the floor to half of it; 3σ."""
    truth, _ = made
    fields = []
    for seed, ra_deg in enumerate((85.0, 280.0, 150.0)):
        field = field_of(truth, Attitude.from_radec_roll(ra_deg, 5.0, 10.0), 60, 0.2, f"sky {seed}", seed)
        fields.append(replace(field, variance_px2=np.full(len(field.xy), 0.05**2)))
    assert calibrate(fields).floor_px == pytest.approx(0.194, rel=0.16)


def test_altitudes_of_a_stretched_field_are_given(calibration):
    """A stretch of κ tan²z / 2 with κ = 58.3″: at altitudes of 30° and 60°, tan²z is 3 and 1/3."""
    half = 0.5 * 58.3 / 206_264.8
    amounts = (np.array([3.0 * half, 0.0]), np.array([0.6 * half / 3.0, 0.8 * half / 3.0]))
    fields = tuple(replace(f, refraction=a) for f, a in zip(calibration.fields, amounts, strict=True))
    assert any(note.endswith("altitudes of about 30°, 60°") for note in _notes(replace(calibration, fields=fields)))


def test_the_focal_length_of_an_image_needs_four_stars(made):
    """Three stars are six observations for an attitude and a focal length, but no independent residual of each axis is
    left: a standard error from two degrees of freedom is not a reason to exclude an image."""
    truth, _ = made
    rng = np.random.default_rng(2)
    xy = rng.uniform([100.0, 100.0], [900.0, 700.0], (4, 2))
    directions = truth.unproject(xy)
    for count, known in ((3, False), (4, True)):
        stars = Matches(xy[:count] + rng.normal(0.0, 0.1, (count, 2)), directions[:count], np.full(count, 0.1))
        found = focal_lengths(truth, [np.eye(3)], [stars])
        assert np.isfinite(found.sigma[0]) == known


@pytest.mark.parametrize("projection", ["auto", "fisheye"])
def test_a_fisheye_is_told_from_a_pinhole(projection):
    truth = Camera.from_fov(70.0, 1000, 700, Distortion(k1=0.02), projection="fisheye")
    attitudes = (Attitude.from_radec_roll(85.0, 5.0, 10.0), Attitude.from_radec_roll(280.0, 38.0, 120.0))
    fields = [field_of(truth, a, 90, name=f"sky {k}") for k, a in enumerate(attitudes)]
    result = calibrate(fields, camera=replace(truth, distortion=Distortion()) if projection == "fisheye" else None)
    assert result.camera.projection == "fisheye"
    assert result.camera.fx == pytest.approx(truth.fx, abs=4 * result.values()["fx"][1])
    assert result.rms_px < 0.17


def test_an_image_without_its_stars_is_left_out(made):
    rng = np.random.default_rng(5)
    noise = StarField("noise", rng.uniform(0, 799, (40, 2)), 1000, 800, rng.uniform(1, 2, 40))
    result = calibrate([*made[1], noise], fov_deg=20.0)
    assert list(result.unsolved) == ["noise"]
    assert any("noise: not used" in line for line in summary(result))
    with pytest.raises(InputError, match="no image could be identified; noise"):
        calibrate([noise], fov_deg=20.0)


def test_mistakes_are_one_clear_line(made):
    _, fields = made
    with pytest.raises(InputError, match="at least one image"):
        calibrate([])
    with pytest.raises(InputError, match="must have the same size"):
        calibrate([fields[0], replace(fields[1], width=999)])
    with pytest.raises(InputError, match="the camera has 500×500"):
        calibrate(fields, camera=Camera.from_fov(20.0, 500, 500))
    with pytest.raises(InputError, match="projection must be"):
        calibrate(fields, projection="cylinder")
    with pytest.raises(InputError, match="unknown parameter 'q1'"):
        calibrate(fields, parameters=["q1"])


def test_figure_has_three_panels_with_units(calibration):
    figure = residual_figure(calibration)
    assert len(figure.axes) == 3
    labels = [ax.get_xlabel() + ax.get_ylabel() for ax in figure.axes]
    assert "(px)" in labels[0]
    assert "(arcsec)" in labels[1]
    png = residual_picture(calibration)
    assert png.startswith(b"\x89PNG")
    assert png == residual_picture(calibration)


@pytest.mark.parametrize(
    ("value", "sigma", "text"),
    [
        (5114.0321, 0.27, "5114.03 ± 0.27"),
        (0.1234, 0.00996, "0.123 ± 0.010"),
        (12.0, 31.0, "12 ± 31"),
        (3.5, 0.0, "3.5 (held)"),
    ],
)
def test_errors_have_two_digits(value, sigma, text):
    assert rounded(value, sigma) == text


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["missing.tiff"], "cannot be read"),
        (["x.png", "--fov", "0"], "--fov"),
        (["x.png", "--epoch", "nan"], "--epoch"),
        (["x.png", "--out", "nowhere/camera.yaml"], "does not exist"),
        (["x.png", "--out", "a.png", "--plot", "a.png"], "same file"),
        (["x.png", "--fov", "10", "--camera", "c.yaml"], "one of the two"),
    ],
)
def test_the_command_writes_nothing_for_bad_input(arguments, says, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert _run(["calibrate", *arguments]) == 2
    message = capsys.readouterr().err
    assert says in message
    assert list(tmp_path.iterdir()) == []


def test_the_command_calibrates_a_drawn_sky(tmp_path, capsys):
    from PIL import Image

    truth = Camera.from_fov(16.0, 640, 480, Distortion(k1=-0.4))
    rng = np.random.default_rng(2)
    y, x = np.mgrid[:480, :640]
    for k, attitude in enumerate(
        (Attitude.from_radec_roll(85.0, 3.0, 10.0), Attitude.from_radec_roll(305.0, 40.0, 0.0))
    ):
        field = field_of(truth, attitude, 50, 0.0)
        image = 200.0 + rng.normal(0, 5.0, (480, 640))
        for (px, py), flux in zip(field.xy, field.flux, strict=True):
            image += 4e6 * flux * np.exp(-0.5 * ((x - px) ** 2 + (y - py) ** 2) / 1.2**2)
        Image.fromarray(np.clip(image, 0, 65535).astype(np.uint16)).save(tmp_path / f"sky{k}.png")
    out, plot = tmp_path / "camera.yaml", tmp_path / "residuals.png"
    assert _run(["calibrate", str(tmp_path), "--out", str(out), "--plot", str(plot)]) == 0
    camera = Camera.from_yaml(out)
    assert camera.fx == pytest.approx(truth.fx, rel=5e-4)
    assert camera.distortion.k1 == pytest.approx(-0.4, abs=0.15)
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert "±" in capsys.readouterr().out
