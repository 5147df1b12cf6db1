"""Separation of error series into classes: each class alone, at exactly known power, and all of them together.

Leakage is the rms found in another class over the injected rms. Statistical limits are stated at each test.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from simulator.study.axes import CAMERA_AXES
from simulator.study.datasheet.accuracy import _sum_of_classes
from simulator.study.datasheet.classes import CLASSES, Separated, _figures, separate
from simulator.study.datasheet.scan import (
    PASSES,
    SAME_PIXELS,
    STEP_PX,
    ScanGeometry,
    phase_shifts_px,
    scan_attitudes,
    scan_geometry,
)
from simulator.study.intervals import moment_intervals
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera

GEOMETRY = scan_geometry(1024, 1024)
FIELDS = 60
MANY_FIELDS = 1500
RNG_SEED = 20
SHAPE = (PASSES, FIELDS, GEOMETRY.frames, 1)


def separated(passes: np.ndarray) -> Separated:
    return separate(np.asarray(passes), GEOMETRY)


def repeated(series: np.ndarray) -> np.ndarray:
    """The same errors in all passes."""
    return np.broadcast_to(series, SHAPE)


def sine(cycles_per_frame: float, rng: np.random.Generator) -> np.ndarray:
    """Unit rms, with a random phase in each field."""
    phase = rng.random((FIELDS, 1, 1))
    steps = np.arange(GEOMETRY.frames)[None, :, None]
    return math.sqrt(2.0) * np.sin(2.0 * math.pi * (cycles_per_frame * steps + phase))


def along_px(axis: int, faster: np.ndarray | float = 1.0) -> np.ndarray:
    """Positions (passes, 1, frames, 1) along an axis in which the pixel's harmonics are waves, pixels."""
    steps = STEP_PX[axis] * faster * np.arange(GEOMETRY.frames)[None, :, None]
    return np.asarray(steps + phase_shifts_px(GEOMETRY)[:, None, :, axis, None])


def uneven_pixels(rng: np.random.Generator, fields: int = FIELDS, sigma_px: float = 0.9) -> np.ndarray:
    """Centroid error across the direction of motion by random gains: Σ g(u) u δ along the scan, unit rms."""
    half, frames = 5, GEOMETRY.frames
    out = np.empty((frames, fields))
    gain = rng.normal(size=(fields, 40, 70)).astype(np.float32)
    for k in range(frames):
        x, y = 7.0 + k * STEP_PX[0], 7.0 + k * STEP_PX[1]
        rows, columns = np.mgrid[int(y) - half : int(y) + half + 2, int(x) - half : int(x) + half + 2]
        weight = np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2.0 * sigma_px**2)) * (rows - y)
        out[k] = gain[:, rows, columns].reshape(fields, -1) @ weight.ravel()
    # of independent gains: the sum of the squared weights, over all positions in a pixel
    return out.T[:, :, None] / math.sqrt(math.pi * sigma_px**4 / 2.0)


def alone(found: Separated, name: str) -> None:
    """The class has the injected rms of one, within its interval; every other one less than a tenth of it."""
    figure = found.figures[name][0]
    assert figure.low <= 1.0 <= figure.high
    for other in set(CLASSES) - {name}:
        assert abs(found.figures[other][0].value) < 0.1, other


def test_a_constant_error_is_bias() -> None:
    found = separated(np.full(SHAPE, -2.0))
    assert found.figures["bias"][0] == pytest.approx((-2.0, -2.0, -2.0))
    for name in ("fov_spatial", "pixel_spatial", "temporal_noise"):
        assert found.figures[name][0].value == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("multiple", [1, 2, 3])
@pytest.mark.parametrize("axis", [0, 1])
def test_an_interpolation_error_is_pixel_spatial(axis: int, multiple: int) -> None:
    phase = np.random.default_rng(RNG_SEED).random((FIELDS, 1, 1))
    found = separated(math.sqrt(2.0) * np.sin(2.0 * math.pi * multiple * (along_px(axis) + phase)))
    total = found.figures["total"][0].value
    # frames that are not whole cycles: half a cycle more or less of at least 8 in a scan
    assert total == pytest.approx(1.0, abs=0.01)
    assert found.figures["pixel_spatial"][0].value == pytest.approx(total, abs=0.01)
    for name in ("bias", "fov_spatial", "temporal_noise"):
        assert abs(found.figures[name][0].value) < 0.05


@pytest.mark.parametrize("period_px", [1.66, 4.0, 13.0])
def test_the_period_that_separates_the_spatial_classes(period_px: float) -> None:
    """Fraction sinc(1/p) of the power of a period p along the columns: half of it at 1.66 pixels. The covariance of the
    sampled waves scatters by about 1/√(60 · 45) of the power, and three of these."""
    phase = np.random.default_rng(RNG_SEED).random((FIELDS, 1, 1))
    found = separated(math.sqrt(2.0) * np.sin(2.0 * math.pi * (along_px(0) / period_px + phase)))
    power = found.figures["fov_spatial"][0].value ** 2
    assert power == pytest.approx(float(np.sinc(1.0 / period_px)), abs=3.0 / math.sqrt(FIELDS * GEOMETRY.frames))


@pytest.mark.parametrize("period_px", [40.0, 100.0, 400.0, 1000.0])
def test_an_error_of_long_period_is_fov_spatial(period_px: float) -> None:
    series = sine(GEOMETRY.step_px / period_px, np.random.default_rng(RNG_SEED))
    found = separated(repeated(series))
    figure = found.figures["fov_spatial"][0]
    # over 60 random phases the mean square of the fields scatters by √(1/2)/√60; four of these, on the rms
    assert figure.value == pytest.approx(1.0, abs=4.0 * math.sqrt(0.5 / FIELDS) / 2.0)
    # by the bias, which is estimated from the same fields
    assert found.figures["pixel_spatial"][0].value == pytest.approx(0.0, abs=1e-6)
    assert found.figures["temporal_noise"][0].value < 1e-9
    # the mean over the fields: 1/√60 for a period longer than the scan, within four standard deviations
    assert abs(found.figures["bias"][0].value) < 4.0 / math.sqrt(FIELDS)


def test_noise_is_temporal_noise() -> None:
    """The covariances scatter about zero by up to 1/√M over M frames: 0.06² for 1,500 fields."""
    found = separated(np.random.default_rng(RNG_SEED).normal(size=(PASSES, MANY_FIELDS, *SHAPE[2:])))
    alone(found, "temporal_noise")
    count = MANY_FIELDS * GEOMETRY.frames
    assert found.figures["temporal_noise"][0].value == pytest.approx(1.0, abs=4.0 / math.sqrt(2.0 * count))
    assert found.differences.size == count


def test_uneven_pixels_are_pixel_spatial() -> None:
    """Also at low spatial frequencies, where a spectrum alone would call them FOV spatial. With at least 7 independent
    values a field the covariance with other pixels scatters by 1/√(7 · 1,500), 0.1² of the power."""
    rng = np.random.default_rng(RNG_SEED)
    own, others = uneven_pixels(rng, MANY_FIELDS), uneven_pixels(rng, MANY_FIELDS)
    found = separated(np.stack([own, own, others, others]))
    alone(found, "pixel_spatial")
    with_the_same_pixels = separated(np.stack([own, own, own, own]))
    assert with_the_same_pixels.figures["fov_spatial"][0].value > 0.5


def test_all_classes_together_are_separated_and_add_up() -> None:
    rng = np.random.default_rng(RNG_SEED)
    noise = 0.8 * rng.normal(size=SHAPE)
    own, others = 0.5 * uneven_pixels(rng), 0.5 * uneven_pixels(rng)
    smooth = 2.0 * rng.normal(size=(FIELDS, 1, 1)) + 0.5 * sine(GEOMETRY.step_px / 60.0, rng)
    periodic = 0.4 * math.sqrt(2.0) * np.sin(2.0 * math.pi * (along_px(0) + rng.random((FIELDS, 1, 1))))
    found = separated(np.stack([own, own, others, others]) + smooth + periodic + noise + 1.5)
    true = {
        "bias": 1.5,
        "fov_spatial": math.hypot(2.0, 0.5),
        "pixel_spatial": math.hypot(0.5, 0.4),
        "temporal_noise": 0.8,
    }
    for name, value in true.items():
        figure = found.figures[name][0]
        assert figure.low < value < figure.high, name
    total = found.figures["total"][0]
    added = math.sqrt(sum(found.figures[name][0].value ** 2 for name in CLASSES))
    assert total.low < added < total.high


def test_spectra_integrate_to_the_powers() -> None:
    rng = np.random.default_rng(RNG_SEED)
    found = separated(rng.normal(size=SHAPE))
    spectra = found.spectra
    width = spectra.cycles_per_px[1]
    count = FIELDS * GEOMETRY.frames
    assert float(spectra.noise.sum() * width) == pytest.approx(1.0, abs=4.0 * math.sqrt(2.0 * 1.5 / count))
    assert spectra.cycles_per_px[-1] == pytest.approx(0.5 / GEOMETRY.step_px, abs=width)


def test_missing_frames_are_bridged_and_poor_fields_left_out() -> None:
    rng = np.random.default_rng(RNG_SEED)
    passes = np.array(repeated(sine(GEOMETRY.step_px / 200.0, rng))) + 0.1 * rng.normal(size=SHAPE)
    passes[0, 0, 5] = np.nan
    passes[1, 1, : GEOMETRY.frames // 2] = np.nan
    found = separated(passes)
    assert (found.fields, found.left_out) == (FIELDS - 1, 1)
    assert found.figures["temporal_noise"][0].value == pytest.approx(0.1, rel=0.05)
    passes[:] = np.nan
    with pytest.raises(ValueError, match="fewer than two fields"):
        separated(passes)


def test_an_interpolation_error_of_stars_that_enter_or_leave_is_pixel_spatial() -> None:
    """Mean error of 12 stars with random phases. Off the middle of a field of 13 degrees stars move by up to 1.3 %
    more, 0.7 pixels over the scan; a fifth of them enters or leaves at a random frame, the same one in all passes."""
    rng = np.random.default_rng(RNG_SEED)
    phase, faster = rng.random((FIELDS, 1, 12)), 1.0 + 0.013 * rng.random((FIELDS, 1, 12))
    waves = np.sin(2.0 * math.pi * (along_px(0, faster) + phase)) + 0.5 * np.sin(2.0 * math.pi * (along_px(1) - phase))
    at, steps = rng.integers(0, GEOMETRY.frames, (FIELDS, 1, 12)), np.arange(GEOMETRY.frames)[None, :, None]
    seen = ((steps < at) == (rng.random((FIELDS, 1, 12)) < 0.5)) | (rng.random((FIELDS, 1, 12)) > 0.2)
    found = separated((waves * seen).sum(axis=-1, keepdims=True) / seen.sum(axis=-1, keepdims=True))
    alone_in = found.figures["total"][0].value
    assert alone_in is not None
    assert found.figures["pixel_spatial"][0].value == pytest.approx(alone_in, rel=0.01)
    assert found.figures["fov_spatial"][0].value == pytest.approx(0.0, abs=0.1 * alone_in)


def test_steps_by_stars_that_enter_or_leave_are_fov_spatial() -> None:
    """A step at a random frame of each field has power at all frequencies."""
    rng = np.random.default_rng(RNG_SEED)
    at = rng.integers(5, GEOMETRY.frames - 5, (FIELDS, 1, 1))
    steps = np.where(np.arange(GEOMETRY.frames)[None, :, None] < at, 0.0, rng.normal(size=(FIELDS, 1, 1)))
    found = separated(repeated(steps))
    total, figure = found.figures["total"][0].value, found.figures["fov_spatial"][0].value
    assert total is not None
    assert figure == pytest.approx(total, rel=0.05)
    assert found.figures["pixel_spatial"][0].value == pytest.approx(0.0, abs=0.1 * total)


def test_a_star_that_enters_earlier_in_some_of_the_passes_is_fov_spatial() -> None:
    """A step one frame earlier in the shifted passes, in frames that are marked as those of another field."""
    rng = np.random.default_rng(RNG_SEED)
    at, steps = rng.integers(5, GEOMETRY.frames - 5, (FIELDS, 1, 1)), np.arange(GEOMETRY.frames)[None, :, None]
    size = rng.normal(size=(FIELDS, 1, 1))
    passes = np.stack([np.where(steps < at - earlier, -size, size) for earlier in (0, 0, 1, 0)])
    found = separate(passes, GEOMETRY, same_field=(steps != at - 1)[..., 0])
    total = found.figures["total"][0].value
    assert found.figures["pixel_spatial"][0].value == pytest.approx(0.0, abs=1e-6)
    assert found.figures["fov_spatial"][0].value == pytest.approx(total, rel=0.05)
    assert separated(passes).figures["pixel_spatial"][0].value > 0.05 * total


def test_a_scan_moves_stars_by_its_steps_and_phase_shifts() -> None:
    """Against the projection of a camera: the image of a star in the middle of the field moves by `STEP_PX`, in the
    passes with other pixels with their shifts; second order in the angle: (40 px)² / (2 · 4500 px) over the scan."""
    camera = Camera.from_fov(fov_deg=13.0, width=1024, height=1024)
    centre = Attitude.from_radec_roll(30.0, 40.0, 70.0)
    star = centre.inverse.apply(np.array([[0.0, 0.0, 1.0]]))
    looks = scan_attitudes(centre, GEOMETRY, (1.0 / camera.fx, 1.0 / camera.fy))
    xy = np.array([[camera.project(look.apply(star))[0] for look in of_pass] for of_pass in looks])
    for of_pass in xy[:SAME_PIXELS]:
        assert np.diff(of_pass, axis=0) == pytest.approx(np.tile(STEP_PX, (GEOMETRY.frames - 1, 1)), abs=1e-3)
    assert xy - xy[0] == pytest.approx(phase_shifts_px(GEOMETRY), abs=1e-3)
    middle = 0.5 * (xy[0, 0] + xy[0, -1])
    assert middle == pytest.approx([camera.cx, camera.cy], abs=1e-3)
    assert GEOMETRY.length_px == pytest.approx(54.0, abs=GEOMETRY.step_px)


@pytest.mark.parametrize("frames", [16, 27, 45])
def test_phase_shifts_run_evenly_through_the_pixel(frames: int) -> None:
    """Over a scan, and over both passes frame by frame, the odd harmonics of the shifts add up to zero."""
    waves = np.exp(2j * math.pi * phase_shifts_px(ScanGeometry(frames)))
    assert waves[:SAME_PIXELS] == pytest.approx(1.0)
    assert np.abs(waves[SAME_PIXELS:].sum(axis=0)).max() < 1e-12
    assert np.abs(waves[SAME_PIXELS:].sum(axis=1)).max() < 1e-12
    assert np.abs((waves[SAME_PIXELS:] ** 2).sum(axis=1)).max() < 1e-12


def test_a_scan_remains_in_a_small_field() -> None:
    small = scan_geometry(192, 80)
    assert small.length_px <= 0.4 * 80 + small.step_px
    assert small.frames < GEOMETRY.frames


def test_an_unresolved_class_is_at_most_half_its_interval() -> None:
    """Noise makes the mean of an unresolved power small or negative; its upper limit is then half the width of the
    interval of the mean over the fields (here of the bootstrap, computed again), and the lower one is zero."""
    found = separated(np.random.default_rng(RNG_SEED).normal(size=SHAPE))
    for name in ("fov_spatial", "pixel_spatial"):
        low, high = moment_intervals(found.field_powers[name])["mean"][0]
        assert low < 0.0
        figure = found.figures[name][0]
        assert figure.high == pytest.approx(math.sqrt(max(high, 0.5 * (high - low))), rel=1e-12)
        assert figure.low == 0.0
    # an injected mean of exactly zero with the scatter of the noise: half the interval's width decides
    shifted = found.field_powers["fov_spatial"] - found.field_powers["fov_spatial"].mean(axis=0) - 0.01
    low, high = moment_intervals(shifted)["mean"][0]
    assert high < 0.5 * (high - low)
    assert _figures({"fov_spatial": shifted}, 0)["fov_spatial"][0].high == pytest.approx(
        math.sqrt(0.5 * (high - low)), rel=1e-12
    )


def test_the_sum_of_the_classes_contains_the_bias() -> None:
    """Bias 3, noise 1: the rms of all frames is √10, and so is the sum of the classes, to 2 % with 60,000 frames; the
    ratio to the trials' rms has their relative half widths in quadrature."""
    rng = np.random.default_rng(RNG_SEED)
    found = separated(3.0 + rng.normal(size=(*SHAPE[:-1], 3)))
    errors = rng.normal(3.0, 1.0, (2000, 3)) / 3600.0
    columns = {f"error_{axis}_deg": errors[:, k] for k, axis in enumerate(CAMERA_AXES)}
    columns["right"] = np.ones(len(errors), dtype=bool)
    by_name = [(q.name, q.axis, q.estimate) for q in _sum_of_classes(found, columns, 0)]
    sums = [estimate for name, _, estimate in by_name if name == "sum_of_classes"]
    ratios = [estimate for name, _, estimate in by_name if name == "sum_over_measured"]
    assert len(sums) == len(ratios) == len(CAMERA_AXES)
    for total, ratio in zip(sums, ratios, strict=True):
        assert total.value == pytest.approx(math.sqrt(10.0), rel=0.02)
        assert ratio.low < 1.0 < ratio.high
        assert ratio.value == pytest.approx(1.0, abs=0.05)
