"""Sections of the datasheet from frames whose errors are known: no frame is rendered."""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import ndtri

from simulator import Scenario
from simulator.study.axes import CAMERA_AXES
from simulator.study.datasheet import sky
from simulator.study.datasheet.accuracy import _against_bound, _classes, _noise_levels, _whole
from simulator.study.datasheet.classes import CLASSES, separate
from simulator.study.datasheet.dependence import residuals, robustness, temperature
from simulator.study.datasheet.frames import BOUND_EVERY, DatasheetFrames, _border_distances_px
from simulator.study.datasheet.performance import acquisition, exclusion, rates, tracking
from simulator.study.datasheet.scan import PASSES, scan_geometry
from simulator.study.datasheet.sheet import LEVELS, Amounts, Estimate, Quantity, select
from simulator.study.datasheet.tables import accuracy_table

SCENARIO = Scenario.load("scenarios/sunsat.yaml")
AMOUNTS = Amounts(*[40] * len(dataclasses.fields(Amounts)))
GEOMETRY = scan_geometry(1024, 1024)


class Camera:
    """A task runner whose frames have known errors: a function of the task gives the columns."""

    def __init__(self, columns_of):
        self.columns_of, self.tasks = columns_of, []

    def run(self, tasks):
        self.tasks += tasks
        return [self.columns_of(task) for task in tasks]

    def trials(self, scenario, count, method="trials", *more):
        task = SimpleNamespace(scenario=scenario, method=method, arguments=(0, count, *more))
        return self.run([task])[0]


def errors_of(task, sizes_arcsec=(3.0, 4.0, 12.0)):
    """Errors of constant magnitude, and alternating sign, about each axis; three quarters of the attitudes right."""
    count = task.arguments[1]
    sign = np.where(np.arange(count) % 2, 1.0, -1.0) / 3600.0
    right = np.arange(count) % 4 != 0
    columns = {f"error_{axis}_deg": size * sign for axis, size in zip(CAMERA_AXES, sizes_arcsec, strict=True)}
    columns["error_deg"] = np.stack([columns[f"error_{axis}_deg"] for axis in CAMERA_AXES], axis=1)
    columns |= {"right": right, "solved": right, "stars_misidentified": np.zeros(count, dtype=int)}
    wrong = np.arange(count) % 8 == 0
    return columns | {"misidentified": wrong, "inconsistent": np.zeros(count, dtype=bool), "wrong": wrong}


def test_series_have_rms_and_availability_at_each_condition():
    """The rms per axis across the boresight of 3″ and 4″ is √12.5″; the sign does not count."""
    camera = Camera(errors_of)
    series = [temperature(SCENARIO, camera, AMOUNTS), *robustness(SCENARIO, camera, AMOUNTS)]
    base_c, base = SCENARIO.detector.temperature_c, SCENARIO.detector
    expected = {
        "temperature": [base_c + step for step in (-20.0, 0.0, 20.0, 40.0)],
        "false_stars": [0, 5, 20, 50],
        "particles": [base.cosmic_rays.rate_cm2_s + more for more in (0.0, 10.0, 100.0, 1000.0)],
        "hot_pixels": [base.hot_pixel_fraction + more for more in (0.0, 1e-3, 1e-2, 5e-2)],
    }
    assert {part.name: [point["value"] for point in part.points] for part in series} == expected
    for part in series:
        for point in part.points:
            assert point["available"][0] == 0.75
            assert point["cross_rms_arcsec"][0] == pytest.approx(math.sqrt(12.5), rel=1e-12)
            assert point["about_rms_arcsec"][0] == pytest.approx(12.0, rel=1e-12)
            assert point["method"] == "30 correct of 40 trials"
    given = {
        "temperature_c": [task.scenario.detector.temperature_c for task in camera.tasks[:4]],
        "rate_cm2_s": [task.scenario.detector.cosmic_rays.rate_cm2_s for task in camera.tasks[8:12]],
        "hot": [task.scenario.detector.hot_pixel_fraction for task in camera.tasks[12:]],
    }
    assert list(given.values()) == [expected["temperature"], expected["particles"], expected["hot_pixels"]]
    assert [task.arguments for task in camera.tasks[4:8]] == [(0, 40, n) for n in expected["false_stars"]]
    assert all(task.scenario.detector.hot_pixel_dark_e_s > 0.0 for task in camera.tasks[12:])


def test_hot_pixels_are_at_most_all_pixels():
    everywhere = SCENARIO.changed({"detector.hot_pixel_fraction": 0.99, "detector.hot_pixel_dark_e_s": 300.0})
    hot = robustness(everywhere, Camera(errors_of), AMOUNTS)[2]
    assert [point["value"] for point in hot.points] == pytest.approx([0.99, 0.991, 1.0, 1.0])


def test_thermo_elastic_error_is_the_mean_change_of_the_same_trials():
    """A lens warmer by 10 K shifts by 5″ about x: of the trials that both cases solve with the right stars."""

    def columns_of(task):
        columns = errors_of(task)
        if task.method == "trials" and task.scenario.optics.thermal.temperature_c == base_c + 10.0:
            columns["error_cross_x_deg"] = columns["error_cross_x_deg"] + 5.0 / 3600.0
            columns["error_cross_x_deg"][1] = 9.0  # of a misidentified star
            columns["stars_misidentified"][1] = 1
        return columns

    scenario = SCENARIO.changed({"optics.thermal.expansion_ppm_k": 20.0})
    base_c = scenario.optics.thermal.temperature_c
    found = residuals(scenario, Camera(columns_of), AMOUNTS)
    means = [select(found, "thermo_elastic_mean", axis) for axis in CAMERA_AXES]
    assert [each.estimate.value for each in means] == pytest.approx([5.0, 0.0, 0.0], abs=1e-9)
    assert means[0].method.endswith("; 29 pairs of trials")
    rms = [select(found, "aberration_residual_rms", axis).estimate.value for axis in CAMERA_AXES]
    assert rms == pytest.approx([3.0, 4.0, 12.0], rel=1e-12)
    for level in LEVELS:
        assert select(found, "aberration_residual", "cross_y", level).estimate.value == pytest.approx(4.0, rel=1e-12)


def test_thermo_elastic_error_of_the_mounting_is_that_of_a_sine():
    scenario = SCENARIO.changed(
        {"pointing.thermo_elastic.amplitude_arcsec": [10.0, -6.0, 0.0], "optics.thermal.expansion_ppm_k": 0.0}
    )
    found = residuals(scenario, Camera(errors_of), AMOUNTS)
    sizes = [select(found, "thermo_elastic_mounting_rms", axis).estimate for axis in CAMERA_AXES]
    assert [size.value for size in sizes] == pytest.approx([10.0 / math.sqrt(2.0), 6.0 / math.sqrt(2.0), 0.0])
    assert all(size.low == size.value == size.high for size in sizes)
    assert select(found, "thermo_elastic_mean", "cross_x").estimate == (0.0, 0.0, 0.0)
    assert select(residuals(SCENARIO, Camera(errors_of), AMOUNTS), "thermo_elastic_mounting_rms", "cross_x") is None


def test_acquisition_counts_outcomes_and_frames():
    """Of 40 frames over the whole sky 30 are right and 5 wrong; ⌈ln 0.003 / ln 0.25⌉ = 5 frames of one interval each;
    half as many with a prior."""
    camera = Camera(errors_of)
    found = {each.name: each for each in acquisition(SCENARIO, camera, AMOUNTS)}
    assert [(task.scenario.tracker.prior, task.arguments[1]) for task in camera.tasks] == [(False, 40), (True, 20)]
    assert all(task.scenario.study.sampling == "sky" for task in camera.tasks)
    assert found["acquisition_probability_lost_in_space"].estimate.value == 0.75
    assert found["acquisition_wrong_lost_in_space"].estimate.value == 0.125
    assert found["acquisition_misidentified_lost_in_space"].estimate.value == 0.125
    assert found["acquisition_inconsistent_lost_in_space"].estimate.value == 0.0
    time = found["acquisition_time_lost_in_space"].estimate
    assert time.value == pytest.approx(5 * SCENARIO.sequence.step_s)
    assert time.low < time.value < time.high  # more frames for the lower end of the probability
    assert "30 correct" in found["acquisition_probability_lost_in_space"].method


def test_the_greatest_rate_is_that_up_to_which_frames_are_right():
    def columns_of(task):
        count, rate = task.arguments[1], task.arguments[2]
        sign = np.where(np.arange(count) % 2, 1.0, -1.0) / 3600.0
        parts = {
            f"{name}_deg": (size + rate) * sign for name, size in (("along", 1.0), ("across", 2.0), ("about", 7.0))
        }
        parts["along_deg"] = parts["along_deg"] + 0.5 / 3600.0
        return parts | {"right": np.full(count, rate <= 3.3)}

    greatest, points = rates(SCENARIO, Camera(columns_of), AMOUNTS)
    assert greatest.estimate.value == pytest.approx(3.3, rel=1e-6)
    assert [point["rate_deg_s"] for point in points] == [0.0, 0.1, 0.3, 1.0, 2.0, 4.0, 8.0]
    assert [point["available"][0] for point in points] == [1.0] * 5 + [0.0] * 2
    for point in points:
        rate = point["rate_deg_s"]
        assert point["along_mean_arcsec"][0] == pytest.approx(0.5, rel=1e-9)
        assert point["along_rms_arcsec"][0] == pytest.approx(math.hypot(1.0 + rate, 0.5), rel=1e-9)
        assert point["across_rms_arcsec"][0] == pytest.approx(2.0 + rate, rel=1e-9)
        assert point["about_rms_arcsec"][0] == pytest.approx(7.0 + rate, rel=1e-9)


def test_the_angle_from_the_earth_is_that_from_its_limb():
    def columns_of(task):
        return {"right": np.full(task.arguments[1], task.arguments[3] >= 20.0)}

    scenario = SCENARIO.changed({"optics.baffle.pst": "vane", "sky.planets": True})
    methods = {each.name: each.method for each in exclusion(scenario, Camera(columns_of), AMOUNTS)}
    assert methods["smallest_angle_earth"].startswith("boresight of its limb: at least 95 % of 40 frames correct")
    assert methods["smallest_angle_sun"].startswith("boresight: at least 95 % of 40 frames correct")


def test_noise_and_its_bound_by_axis():
    """Noise of 2″ with a bound of 1.6″ in each third frame: a ratio of 1.25, and normal percentiles."""
    rng, fields = np.random.default_rng(3), 50
    passes = 2.0 * rng.normal(size=(PASSES, fields, GEOMETRY.frames, 3)) * np.array([1.0, 2.0, 5.0])
    bound = np.full(passes.shape[1:], np.nan)
    bound[:, ::3] = 1.6 * np.array([1.0, 2.0, 5.0])
    found = separate(passes, GEOMETRY)
    against = _against_bound(passes, bound, 0)
    levels = _noise_levels(found, 0)
    used = fields * len(range(0, GEOMETRY.frames, 3))
    for axis, scale in zip(CAMERA_AXES, (1.0, 2.0, 5.0), strict=True):
        assert select(against, "noise_bound_rms", axis).estimate.value == pytest.approx(1.6 * scale, rel=1e-12)
        ratio = select(against, "noise_over_bound", axis).estimate
        assert ratio.value == pytest.approx(1.25, rel=4.0 / math.sqrt(2.0 * used))  # 4 σ of a standard deviation
        assert ratio.low < ratio.value < ratio.high
        for level in LEVELS[:2]:  # density at the percentiles of 13,000 values: 2 %
            size = select(levels, "temporal_noise", axis, level).estimate
            assert size.value == pytest.approx(2.0 * scale * ndtri(0.5 + level / 200.0), rel=0.03)
            assert size.low < size.value < size.high
            worst = select(levels, "temporal_noise_worst_field", axis, level).estimate
            assert worst.value > size.value * 0.95
        noisiest = int(np.argmax(found.field_powers["temporal_noise"][:, CAMERA_AXES.index(axis)]))
        worst = np.abs(found.differences[noisiest, :, CAMERA_AXES.index(axis)])
        largest = select(levels, "temporal_noise_worst_field", axis, 99.7).estimate.value
        assert largest == pytest.approx(worst.max(), rel=1e-12)
    assert select(levels, "temporal_noise", "cross_x", 68.0).method.startswith(
        f"percentile of {fields * GEOMETRY.frames} d"
    )
    assert _against_bound(passes, np.full(passes.shape[1:], np.nan), 0) == []


def test_the_total_spectrum_is_the_mean_of_two_passes():
    """It integrates to the mean square of single frames: noise of 1 and 2 in the first two passes, 2.5."""
    noise = np.random.default_rng(4).normal(size=(PASSES, 60, GEOMETRY.frames, 1))
    noise[1] *= 2.0
    spectra = separate(noise, GEOMETRY).spectra
    width = float(spectra.cycles_per_px[1])
    count = 60 * GEOMETRY.frames
    # 4 σ of a mean square of normal values, √(2 (1 + 16)) / 2, with 1.5 for the tapers
    tolerance = 4.0 * 1.5 * math.sqrt(34.0) / 2.0 / math.sqrt(count)
    assert float(spectra.total.sum() * width) == pytest.approx(2.5, abs=tolerance)
    assert float(spectra.repeated.sum() * width) == pytest.approx(0.0, abs=tolerance)


def test_classes_and_the_whole_have_normal_percentiles_and_measured_ones():
    figures = {name: [Estimate(float(k + 1), 0.5, 9.0) for k in range(3)] for name in (*CLASSES, "total")}
    found = _classes(SimpleNamespace(figures=figures))
    for k, axis in enumerate(CAMERA_AXES):
        assert select(found, "bias_mean", axis).estimate.value == k + 1
        assert select(found, "temporal_noise_rms", axis).estimate.value == k + 1
        assert select(found, "temporal_noise", axis, 95.0) is None
        for level, factor in ((68.0, 0.99446), (95.0, 1.95996), (99.7, 2.96774)):  # of a normal distribution
            size = select(found, "fov_spatial", axis, level).estimate
            assert size == pytest.approx(((k + 1) * factor, 0.5 * factor, 9.0 * factor), rel=1e-4)
    columns = errors_of(SimpleNamespace(arguments=(0, 400)))
    columns["error_cross_y_deg"][0] = 99.0  # of a wrong attitude
    whole = _whole(columns, 0)
    assert select(whole, "measurement_error_rms", "cross_y").estimate.value == pytest.approx(4.0)
    assert select(whole, "measurement_error", "about_boresight", 95.0).estimate.value == pytest.approx(12.0)
    assert select(whole, "measurement_error_rms", "cross_x").method.startswith("300 trials")


def test_the_table_of_the_accuracy_names_class_and_interpretation_once():
    size = Estimate(1.0, 1.0, 1.0)
    given = [
        Quantity("bias_mean", "Bias, mean", size, "arcsec", axis, interpretation="ensemble") for axis in CAMERA_AXES
    ]
    given += [
        Quantity("fov_spatial", "FOV", size, "arcsec", "cross_y", level, interpretation="mixed") for level in LEVELS
    ]
    table = accuracy_table(SimpleNamespace(sections={"accuracy": given, "residuals": []}))
    exact = "1.00″ (exact)"
    assert table.rows == (
        ("Bias", "x", "ensemble", exact, "", "", ""),
        ("", "y", "", exact, "", "", ""),
        ("", "about", "", exact, "", "", ""),
        ("", "y", "", "", exact, exact, exact),
    )


def test_availability_over_orbit_and_year_and_errors_against_stars():
    """Twelve bins, with their middles; the year is that of the seasons, 365.2422 days."""
    count = 240
    phase = (np.arange(count) + 0.5) / count
    right = phase < 0.75
    columns = {
        "right": right,
        "orbit_argument_deg": 360.0 * phase - 360.0,
        "t_s": (phase + 3.0) * 365.2422 * 86_400.0,
        "stars_matched": np.arange(count) % 40 + 5.0,
        "error_cross_x_deg": np.full(count, 3.0 / 3600.0),
        "error_cross_y_deg": np.full(count, 4.0 / 3600.0),
    }
    found = sky.availability(columns)
    assert [point["value"] for point in found["orbit"]] == pytest.approx([15.0 + 30.0 * k for k in range(12)])
    assert [point["value"] for point in found["year"]] == pytest.approx([0.5 + k for k in range(12)])
    for name in ("orbit", "year"):
        assert [point["available"][0] for point in found[name]] == [1.0] * 9 + [0.0] * 3
    points = found["stars"]
    assert len(points) == 8  # of 180 attitudes, at least 15 each
    values = [point["value"] for point in points]
    assert values == sorted(values)
    mean = np.sort(columns["stars_matched"][right])
    assert values == pytest.approx([part.mean() for part in np.array_split(mean, 8)])
    assert all(point["cross_rms_arcsec"] == pytest.approx([math.sqrt(12.5)] * 3) for point in points)
    few = {name: column[:40] for name, column in columns.items()}
    assert len(sky.availability(few)["stars"]) == 2
    assert sky.availability({name: column[:14] for name, column in columns.items()})["stars"] == []
    assert len(sky.availability(few)["orbit"]) == 2


@pytest.mark.parametrize(
    ("sampling", "target", "path"),
    [("sky", None, False), ("sky", [10.0, 20.0, 0.0], True), ("path", None, True), ("path", [10.0, 20.0, 0.0], True)],
)
def test_coverage_is_that_of_the_path_where_the_attitude_follows_one(monkeypatch, sampling, target, path):
    asked = []

    class Boresights(SimpleNamespace):
        def __len__(self):
            return 10

    def covered(_scenario, directions, path=False):
        asked.append((directions, path))
        return SimpleNamespace(
            allowed_counts=np.arange(10),
            boresights=Boresights(excluded={"sun": np.arange(10) < 2}),
            exclusion=SimpleNamespace(sun_deg=30.0, moon_deg=0.0, earth_deg=20.0),
            magnitude_limit=6.25,
            limit_reason="of the camera",
        )

    monkeypatch.setattr(sky, "coverage", covered)
    scenario = SimpleNamespace(study=SimpleNamespace(sampling=sampling), pointing=SimpleNamespace(target=target))
    found = {each.name: each for each in sky.sky_coverage(scenario, AMOUNTS)}
    assert asked == [(40, False), (40, True)][: 1 + path]
    assert found["coverage_sky_3"].estimate.value == 0.7
    assert found["coverage_sky_5"].estimate.value == 0.5
    assert found["coverage_sky_5"].method == "10 directions of the sky; stars to V = 6.25: of the camera"
    assert [found[f"excluded_sky_{body}"].estimate.value for body in ("sun", "moon", "earth")] == [0.2, 0.0, 0.0]
    assert found["excluded_sky_earth"].method.startswith("boresight within 20° of its limb; optics.baffle.earth_")
    assert found["excluded_sky_moon"].method.startswith("boresight within 0°; no baffle in the scenario")
    assert ("coverage_path_3" in found) is path


class Frames:
    """A renderer that records what it is asked for."""

    def __init__(self, renderer):
        self.camera, self.scenes, self.detector = renderer.camera, renderer.scenes, renderer.detector
        self.scene, self.asked = renderer.scene, []

    def frame(self, index, **keys):
        self.asked.append((index, keys))
        sources = SimpleNamespace(image_xy=np.array([[10.0, 20.0]]), id=np.array([7]))
        return SimpleNamespace(image=np.zeros((192, 256))), SimpleNamespace(sources=sources)


@pytest.fixture(scope="module")
def small():
    keys = ["detector.width=256", "detector.height=192", "sky.magnitude_limit=3", "detector.prnu=0.01"]
    return DatasheetFrames(Scenario.load("cubesat_ideal", keys))


def test_errors_at_a_rate_are_along_and_across_its_axis(small, monkeypatch):
    """Axes a golden angle apart: the error (1, 2, 3) in camera axes, projected on each axis and on the one 90° on."""
    frames = Frames(small.renderer)
    monkeypatch.setattr(small, "renderer", frames)
    monkeypatch.setattr(small, "_measured", lambda _frame, _truth: (np.array([1.0, 2.0, 3.0]), np.array([0]), True))
    found = small.at_rate(2, 3, 1.5)
    turn = np.arange(2, 5) * math.pi * (3.0 - math.sqrt(5.0))
    assert found["along_deg"] == pytest.approx(np.cos(turn) + 2.0 * np.sin(turn))
    assert found["across_deg"] == pytest.approx(2.0 * np.cos(turn) - np.sin(turn))
    assert found["about_deg"] == pytest.approx([3.0] * 3)
    assert found["right"].all()
    rates_rad_s = np.array([keys["rate_camera_rad_s"] for _, keys in frames.asked])
    expected = math.radians(1.5) * np.stack([np.cos(turn), np.sin(turn), np.zeros(3)], axis=1)
    assert rates_rad_s == pytest.approx(expected)
    assert [index for index, _ in frames.asked] == [20_000_002, 20_000_003, 20_000_004]


def test_the_bound_of_a_scan_is_that_of_each_third_frame_of_the_first_pass(small, monkeypatch):
    """Without an attitude there is none; the last two passes have other pixels."""
    first, other = Frames(small.renderer), Frames(small.renderer)
    monkeypatch.setattr(small, "renderer", first)
    monkeypatch.setattr(small, "_with_other_pixels", lambda: other)
    monkeypatch.setattr(small, "_with_noise_only", lambda: first)
    fitted = iter([True] * 3 + [False] + [True] * 1000)
    monkeypatch.setattr(
        small, "_measured", lambda _frame, _truth: (np.array([1.0, 2.0, 3.0]), np.array([0]), next(fitted))
    )
    monkeypatch.setattr("simulator.study.datasheet.frames.attitude_bound_deg", lambda *_: np.array([0.1, 0.2, 0.3]))
    geometry = scan_geometry(256, 192)
    found = small.scan(3, geometry)
    known = [k for k in range(geometry.frames) if k % BOUND_EVERY == 0 and k != 3]
    assert np.flatnonzero(np.isfinite(found["noise_bound_deg"]).all(axis=1)).tolist() == known
    assert found["error_deg"].shape == (PASSES, geometry.frames, 3)
    assert found["stars"].tolist() == [[1] * geometry.frames] * PASSES
    assert found["same_field"].all()
    numbers = [index for index, _ in first.asked + other.asked]
    assert numbers == [10_000_000 + (3 * PASSES + p) * 1000 + k for p in range(PASSES) for k in range(geometry.frames)]
    assert len(first.asked) == len(other.asked) == 2 * geometry.frames


def test_bounds_of_images_are_those_of_the_nearest_source(small, monkeypatch):
    """√(½ trace of the covariance): 0.05 px and √(½ (0.04 + 0.16)) px; without information a hundred pixels."""
    information = np.array([np.eye(2) / 0.05**2, np.diag([1.0 / 0.04, 1.0 / 0.16]), np.zeros((2, 2))])
    monkeypatch.setattr("simulator.study.datasheet.frames.star_information", lambda *_: information)
    places = np.array([[10.0, 10.0], [50.0, 50.0], [200.0, 100.0], [10.0, 90.0]])
    truth = SimpleNamespace(sources=SimpleNamespace(image_xy=places))
    xy = np.array([[51.0, 50.0], [11.0, 91.0], [10.0, 10.5]])
    found = small._bounds_px(truth, np.array([0, 1, 3]), xy)
    # the hundred pixels that bound an image without information weigh 1e-4 of the information of an image of 1 px
    assert found == pytest.approx([math.sqrt(0.1), 100.0, 0.05], rel=1e-4)


def test_other_pixels_and_noise_alone_change_the_detector_only(small):
    other, noise = small._with_other_pixels(), small._with_noise_only()
    assert other.camera is noise.camera is small.renderer.camera
    assert not np.array_equal(other.detector.pattern.prnu, small.renderer.detector.pattern.prnu)
    assert noise.detector.pattern is small.renderer.detector.pattern
    assert (noise.detector.parameters.prnu, noise.detector.parameters.dsnu) == (0.0, 0.0)
    assert small.renderer.detector.parameters.prnu == 0.01


def test_frames_near_a_body_are_the_same_trials_at_every_angle():
    """From the first trial on, at the inverse of what is bisected."""
    scenario = SCENARIO.changed({"optics.baffle.pst": "vane"})
    camera = Camera(lambda task: {"right": np.full(task.arguments[1], task.arguments[3] > 17.0)})
    found = {each.name: each.estimate for each in exclusion(scenario, camera, AMOUNTS)}
    assert all(task.method == "near_body" for task in camera.tasks)
    assert {task.arguments[:2] for task in camera.tasks} == {(0, AMOUNTS.per_rate)}
    assert {task.arguments[2] for task in camera.tasks} >= {"sun", "earth"}
    for body in ("sun", "earth"):
        assert found[f"smallest_angle_{body}"].value == pytest.approx(17.0, rel=1e-3)
        assert not next(task for task in camera.tasks if task.arguments[2] == "sun").scenario.sky.earth


def test_interruptions_divide_the_sequence_evenly():
    """Two of them, at a third and two thirds; the attitude is back one and three frames after they end."""
    step_s = SCENARIO.sequence.step_s
    asked = []

    def columns_of(task):
        count, gaps = task.scenario.sequence.frames, task.scenario.sequence.dropouts
        asked.append([(gap.start_s, gap.duration_s) for gap in gaps])
        elapsed = step_s * np.arange(count)
        status, mode = np.full(count, "solved", dtype=object), np.full(count, "tracking", dtype=object)
        for gap, late in zip(gaps, (0, 2), strict=False):
            inside = (elapsed >= gap.start_s) & (elapsed < gap.start_s + gap.duration_s)
            status[inside], mode[inside] = "no_frame", "none"
            after = np.flatnonzero(inside)[-1] + 1
            status[after : after + late], mode[after : after + late + 1] = "no_match", "prior"
        return {"status": status, "mode": mode, "elapsed_s": elapsed, "wrong": np.zeros(count, bool)}

    amounts = dataclasses.replace(AMOUNTS, sequence=int(60.0 / step_s))
    found = {each.name: each for each in tracking(SCENARIO, Camera(columns_of), amounts, 2.0)}
    assert asked[0] == [(pytest.approx(20.0, abs=step_s), 1.0), (pytest.approx(40.0, abs=step_s), 5.0)]
    recovery = found["recovery_time"].estimate
    assert (recovery.low, recovery.high) == (pytest.approx(step_s), pytest.approx(3.0 * step_s))


def test_distances_from_the_border_are_to_the_outer_edges_of_its_pixels():
    """An image of 80 rows and 100 columns ends at −0.5, 99.5 and 79.5."""
    xy = np.array([[0.0, 40.0], [99.0, 40.0], [50.0, 78.0], [50.0, -1.5], [60.0, 40.0]])
    sources = SimpleNamespace(image_xy=xy, id=np.array([7, 8, 9, 10, 11]))
    found = _border_distances_px(SimpleNamespace(sources=sources), np.array([0, 1, 2, 3, 4]), (80, 100))
    assert found == {7: 0.5, 8: 0.5, 9: 1.5, 10: -1.0, 11: 39.5}
    assert list(_border_distances_px(SimpleNamespace(sources=sources), np.array([4]), (80, 100))) == [11]
