"""A bench of known truth (`synthetic_bench`: OpenCV, formulas, one Gaussian image per display pixel) is calibrated from
its photographs, and a tracker before it finds the attitudes that were commanded."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.stats import chi2
from synthetic_bench import Bench

from simulator.cli.application import run_application
from simulator.live.stimulator import (
    Curve,
    Exposures,
    Pattern,
    Photograph,
    align_display,
    calibrate_display,
    nominal_geometry,
    read_stimulator,
    stimulator_yaml,
)
from simulator.live.stimulator.geometry_fit import fit_geometry
from simulator.live.stimulator.photographs import find_dots
from startracker import Attitude, Camera, Distortion, InputError, Observer, StarTracker, load_catalog
from startracker.core import ARCSEC_RAD

PATTERN = Pattern(1280, 1024)
BENCH = Bench(black=2e-4)
DOTS_S, SQUARES_S = 0.01, 0.016
ZERO_POINT = 2.5 * math.log10(BENCH.zero_e_s / BENCH.gain)
TAKEN = Exposures(SQUARES_S, BENCH.gain, ZERO_POINT)
AT_REST = Observer(2000.0, np.zeros(3))


def camera_of(bench):
    k1, k2, p1, p2 = bench.camera_lens
    return Camera(*bench.camera_matrix, *bench.camera_size, Distortion(k1=k1, k2=k2, p1=p1, p2=p2))


def photograph(bench, name, rng, exposure_s=None):
    on, shown = name != "off", "black" if name == "off" else "dots" if name.startswith("dots") else name
    seconds = exposure_s or (DOTS_S if shown == "dots" else SQUARES_S)
    image = bench.photograph(PATTERN.image(shown), seconds, rng, on=on)
    return Photograph(name, image.astype(np.float32), camera_of(bench), bench.saturation_dn)


def photographs(bench, seed):
    rng = np.random.default_rng(seed)
    return {name: photograph(bench, name, rng) for name in (*PATTERN.names, "off")}


NOMINAL = nominal_geometry((1280, 1024), pitch_um=12.0, focal_mm=60.0)  # 1.3 % from the truth


@pytest.fixture(scope="module")
def taken():
    found = photographs(BENCH, 1)
    found["dots-2"] = photograph(replace(BENCH, turn=(-0.01, 0.015, -0.3)), "dots", np.random.default_rng(2))
    return found


@pytest.fixture(scope="module")
def calibration(taken):
    return calibrate_display(PATTERN, NOMINAL, taken, TAKEN)


def lattice():
    axes = (np.linspace(20, size - 20, 9) for size in BENCH.size)
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)


def test_each_parameter_of_the_geometry_is_recovered_within_its_error(calibration):
    shape, sigma = calibration.stimulator.geometry, calibration.geometry.sigma
    camera, lens = shape.collimator, shape.collimator.distortion
    found = [math.log(camera.fx), camera.cx, camera.cy, lens.k1, lens.k2, *shape.tilt_deg]
    truth = [math.log(BENCH.focal_px), *BENCH.centre, BENCH.k1, BENCH.k2, *BENCH.tilt_deg]
    for (name, error), one, true in zip(sigma.items(), found, truth, strict=True):
        assert abs(one - true) < 4.0 * error, name  # 1 of 16,000 for each of seven
    # and the errors are those of an exact calibration: √(2 × 528 centroids) of some thousandths of a pixel
    assert sigma["ln_f"] < 1e-5
    assert sigma["cx"] < 0.5
    assert sigma["tilt_x_deg"] < 0.01


def test_directions_agree_with_opencv_within_the_stated_error(calibration):
    rotation = calibration.geometry.rotations[0]
    seen = calibration.stimulator.geometry.to_directions(lattice()) @ rotation.T
    true = camera_of(BENCH).unproject(BENCH.seen(BENCH.directions(lattice())))
    error = (seen - true)[:, :2] / ARCSEC_RAD
    across, _ = calibration.geometry.errors()
    # the 81 errors share ten parameters: their mean square over its expectation is at most χ²₁ / 1 at 4 σ
    assert np.sqrt(np.mean(error**2, axis=0)) == pytest.approx(0.0, abs=4.0 * across.max())
    assert across.max() < 0.1


def test_each_parameter_of_the_brightness_is_recovered_within_its_error(calibration):
    fit = calibration.photometry
    bias = 2e-5  # the mean of U over a square is below U in its middle: (0.12 (24/1280)² + 0.12 (24/1024)²) / 24 × 1.09
    for colour, magnitude in BENCH.magnitude.items():
        assert fit.photometry.curve[colour].gamma == fit.gamma[colour], "a power law describes it"
        assert fit.gamma[colour] == pytest.approx(BENCH.gamma[colour], abs=4 * fit.gamma_sigma[colour])
        error = fit.photometry.magnitude[colour] - magnitude
        assert abs(error) < 4 * fit.magnitude_sigma[colour] + bias
        assert fit.magnitude_sigma[colour] < 1e-3
        assert fit.gamma_sigma[colour] < 1e-3
    assert fit.photometry.white_factor == pytest.approx(BENCH.white_factor, abs=4 * fit.white_factor_sigma + bias)
    true = BENCH.uniformity(lattice()) / BENCH.uniformity((np.array(BENCH.size) - 1)[None] / 2)
    ratio = fit.photometry.relative(lattice()) / true
    assert np.sqrt(np.mean((ratio - 1) ** 2)) < 4 * fit.uniformity_sigma + bias
    assert fit.uniformity_sigma < 1e-3


def test_black_level_is_recovered(calibration):
    # the noise of both photographs in 101² pixels, over the glow
    glow = glow_e(SQUARES_S)
    noise = math.sqrt(2 * (BENCH.sky_e * SQUARES_S + glow + BENCH.read_noise_e**2 + BENCH.gain**2 / 12)) / 101
    assert calibration.photometry.photometry.black == pytest.approx(BENCH.black, rel=4 * noise / glow + 1e-3)
    assert noise / glow < 0.05


@pytest.mark.slow
def test_a_display_without_a_power_law_gets_a_table():
    def srgb(x):  # IEC 61966-2-1
        return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)

    bench = replace(BENCH, curve=srgb)
    fit = calibrate_display(PATTERN, NOMINAL, photographs(bench, 3), TAKEN).photometry
    levels = np.array(PATTERN.levels)
    exact = Curve(None, PATTERN.levels, srgb(levels / 255))
    every = np.arange(10, 256)  # below: the first two levels are not on the straight line to black that sRGB has there
    assert exact.table[every] == pytest.approx(srgb(every / 255), rel=7e-3)
    # 457 squares seen, 20 levels; 33² pixels with the square's light, whose background is from two rows around
    repeats, lit, ring = 457 // 20, 33**2, 37**2 - 33**2
    noise = lit * (1 + lit / ring) * (BENCH.sky_e * SQUARES_S + glow_e(SQUARES_S) + 36 + BENCH.gain**2 / 12)
    for colour, magnitude in bench.magnitude.items():
        curve, top = fit.photometry.curve[colour], 10 ** (-0.4 * magnitude) * BENCH.zero_e_s * SQUARES_S * 24**2
        assert curve.gamma is None
        error = np.sqrt((top * srgb(levels / 255) + noise) / repeats) / top
        assert (np.abs(curve.table[levels] - srgb(levels / 255)) < 4 * np.hypot(error, error[-1])).all()
        assert fit.photometry.magnitude[colour] == pytest.approx(magnitude, abs=4 * fit.magnitude_sigma[colour] + 2e-5)


def test_a_tracker_before_the_display_finds_the_commanded_attitudes(calibration):
    stimulator = calibration.stimulator
    stars = load_catalog("hipparcos").brighter_than(6.5)
    directions, rng, exposure_s = stars.directions(2000.0), np.random.default_rng(4), 0.2
    tracker = StarTracker(camera_of(BENCH), magnitude_limit=6.0)
    position = {one.magnitude: one.position_arcsec for one in stimulator.limits([2.0, 4.0, 6.0], positions=100)}
    assert max(position.values()) < 0.5
    total, count, residuals = 0.0, 0, []
    for pointing in ((83, 0, 20), (200, -60, 100), (300, 40, 300), (10, 10, 0), (150, 20, 70), (270, -25, 210)):
        attitude = Attitude.from_radec_roll(*pointing)
        shown = stimulator.picture(attitude, directions, stars.v_mag)
        assert not shown.clipped.any()
        assert not shown.faint.any()
        image = np.zeros((1024, 1280, 3), np.uint8)
        image[shown.pixels[:, 1], shown.pixels[:, 0]] = shown.rgb
        frame = BENCH.photograph(image, exposure_s, rng)
        solution = tracker.solve(frame, observer=AT_REST, saturation_dn=65535.0, gain_e_per_dn=BENCH.gain)
        assert solution.solved
        error = solution.attitude.rotation_vector_to(attitude)
        # tracker, calibration, and the display's own centroids: those of the faintest stars, as many as were used
        used = (solution.stars.fitted.xy - BENCH.camera_matrix[2:]) / BENCH.camera_matrix[0]
        lever = np.diag([1.0, 1.0, 1.0 / np.mean(np.sum(used**2, axis=1))])
        quantised = (max(position.values()) * ARCSEC_RAD) ** 2 / len(used) * lever
        covariance = solution.covariance + calibration.geometry.errors()[1] + quantised
        total, count = total + error @ np.linalg.solve(covariance, error), count + 3
        residuals += list(magnitude_residuals(frame, shown, exposure_s))
    assert total < chi2.isf(1e-4, count), "attitudes differ by more than tracker, calibration and display state"
    residuals = np.array(residuals)
    assert len(residuals) > 100
    assert np.sum(residuals**2) < chi2.isf(1e-4, len(residuals)), "brightness differs by more than the photon noise"


def magnitude_residuals(frame, shown, exposure_s, half=8):
    """Brightness of isolated stars by an aperture, minus the one wanted, in standard errors."""
    xy = BENCH.seen(BENCH.directions(shown.position))
    background = BENCH.sky_e * exposure_s + glow_e(exposure_s)
    pixel = background + BENCH.read_noise_e**2 + BENCH.gain**2 / 12
    for k, (x, y) in enumerate(np.rint(xy).astype(int)):
        apart = np.abs(xy - xy[k]).max(axis=1)
        apart[k] = np.inf
        wanted = 10 ** (-0.4 * shown.magnitude[k]) * BENCH.zero_e_s * exposure_s
        if apart.min() < 2 * half + 1 or not (half <= x < 1024 - half and half <= y < 1024 - half) or wanted < 2000:
            continue
        box = frame[y - half : y + half + 1, x - half : x + half + 1] - BENCH.offset_dn
        electrons = box.sum() * BENCH.gain - background * box.size
        yield (electrons - wanted) / math.sqrt(wanted + pixel * box.size)


def glow_e(exposure_s):
    """Electrons of the display's black level in a pixel."""
    white = BENCH.flux(np.array(BENCH.size)[None] / 2, np.array([[255, 255, 255]]))[0]
    fx, fy, *_ = BENCH.camera_matrix
    return BENCH.black * white * BENCH.zero_e_s * exposure_s * BENCH.focal_px**2 / (fx * fy)


def test_another_camera_is_aligned_by_one_photograph(calibration):
    turned = replace(BENCH, turn=(0.004, 0.02, -0.6))
    moved, _ = align_display(calibration.stimulator, PATTERN, photograph(turned, "dots", np.random.default_rng(5)))
    seen = calibration.stimulator.geometry.to_directions(lattice()) @ moved.alignment.as_matrix().T
    true = camera_of(BENCH).unproject(turned.seen(turned.directions(lattice())))
    error = np.degrees(np.mean(np.cross(true, seen), axis=0)) * 3600
    stated = math.hypot(moved.uncertainty["attitude_x_arcsec"], calibration.geometry.errors()[0].max())
    assert np.abs(error[:2]).max() < 4 * stated


def test_a_mirrored_display_is_recognised():
    bench = replace(BENCH, parity=-1)
    dots = photograph(bench, "dots", np.random.default_rng(6))
    found = fit_geometry(PATTERN, NOMINAL, [dots], [find_dots(dots, PATTERN)])
    assert found.geometry.collimator.parity == -1
    seen = found.geometry.to_directions(lattice()) @ found.rotations[0].T
    true = camera_of(bench).unproject(bench.seen(bench.directions(lattice())))
    assert np.abs(seen - true).max() < 0.5 * ARCSEC_RAD


def test_the_command_calibrates_a_folder_of_photographs(taken, calibration, tmp_path, capsys):
    photos = tmp_path / "photos"
    photos.mkdir()
    for name, one in taken.items():
        cv2.imwrite(str(photos / f"{name}.png"), one.image.astype(np.uint16))
    camera_of(BENCH).to_yaml(tmp_path / "camera.yaml")
    (photos / "pattern.yaml").write_text("width: 1280\nheight: 1024\ncolours: [red, green, blue]\n")
    out = tmp_path / "stimulator.yaml"
    asked = ["calibrate", str(photos), "--camera", str(tmp_path / "camera.yaml"), "--focal-mm", "60"]
    asked += ["--pitch-um", "12", "--exposure-s", str(SQUARES_S), "--gain", str(BENCH.gain), "--out", str(out)]
    assert run_application(["stimulate", *asked]) == 2
    assert "--zero-point" in capsys.readouterr().err
    assert run_application(["stimulate", *asked, "--zero-point", str(ZERO_POINT)]) == 0
    assert capsys.readouterr().out.splitlines()[:-1] == calibration.summary()
    assert stimulator_yaml(read_stimulator(out), []) == stimulator_yaml(calibration.stimulator, [])
    flat = tmp_path / "flat.png"
    cv2.imwrite(str(flat), np.full((1024, 1024), 3000, np.uint16))
    aligning = ["align", str(out), str(photos / "dots-2.png"), "--camera", str(tmp_path / "camera.yaml")]
    aligning += ["--pattern", str(photos / "pattern.yaml"), "--flat", str(flat)]
    assert run_application(["stimulate", *aligning]) == 0
    assert read_stimulator(out).alignment.as_matrix() == pytest.approx(calibration.geometry.rotations[1], abs=1e-6)


def changed(taken, **photos):
    return calibrate_display(PATTERN, NOMINAL, {**taken, **photos}, TAKEN)


def test_bad_photographs_are_refused_in_one_line(taken):
    rng = np.random.default_rng(7)
    hole = np.where(np.hypot(*np.indices((1024, 1024)) - 512.0) < 120, 100.0, taken["dots"].image)
    moved = photograph(replace(BENCH, turn=(0.012, -0.009 + 0.001, 0.05)), "uniform", rng)
    cases = {
        "saturated": {"dots": photograph(BENCH, "dots", rng, 0.5)},
        "must not move": {"uniform": moved},
        "markers": {"dots": Photograph("dots", hole, camera_of(BENCH))},
        "photograph the pattern dots|dots were found": {"dots": taken["black"]},
        "too faint|where dots says": {"ramp-red": taken["black"]},
        "become brighter|squares": {"ramp-red": taken["uniform"]},
    }  # fmt: skip
    for message, photos in cases.items():
        with pytest.raises(InputError, match=message) as raised:
            changed(taken, **photos)
        assert "\n" not in str(raised.value)
    with pytest.raises(InputError, match="missing: uniform"):
        calibrate_display(PATTERN, NOMINAL, {"dots": taken["dots"]}, TAKEN)
    with pytest.raises(InputError, match="full size"):
        Photograph("dots", taken["dots"].image[:-1], camera_of(BENCH))
    far = nominal_geometry((1280, 1024), pitch_um=12.0, focal_mm=60.0)
    wrong = {n: replace(one, camera=replace(one.camera, distortion=Distortion(k1=0.9))) for n, one in taken.items()}
    with pytest.raises(InputError, match="no collimator near the nominal one"):
        calibrate_display(PATTERN, far, wrong, TAKEN)
