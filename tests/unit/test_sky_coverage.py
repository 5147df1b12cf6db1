"""Stars in a field: the kernels against looking at every star, attitudes and exclusion against exact geometry."""

import json
import math
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest

from simulator.build import build_focal_plane, build_scenes
from simulator.checks import load_scenario
from simulator.constants import EARTH_RADIUS_KM
from simulator.optics.illumination import star_illumination
from simulator.randomness import stream
from simulator.sky.earth import occulted
from simulator.study.coverage import sensitivity
from simulator.study.coverage.boresights import (
    Exclusion,
    along_path,
    everything_excluded,
    exclusion_of,
    sky_grid,
    whole_sky,
)
from simulator.study.coverage.field_counts import accumulate_information, circle, outline, solid_angle_sr
from simulator.study.coverage.maps import coverage_figures
from simulator.study.coverage.prediction import predict
from simulator.study.coverage.sensitivity import build_sensitivity, nominal_rate_rad_s
from simulator.study.coverage.survey import count_stars, coverage
from simulator.study.result_files import write_study
from startracker.catalog import load_catalog
from startracker.catalog.guide import field_of
from startracker.catalog.sky_view import voxel_grid
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.geometry.distortion import Distortion

CAMERAS = {
    "narrow": Camera.from_fov(6.0, 512, 512),
    "oblong": Camera.from_fov(40.0, 640, 360),
    "barrel": Camera(700.0, 700.0, 400.0, 300.0, 800, 600, Distortion(k1=-0.2, k2=0.03)),
    "mirrored and off its centre": Camera(900.0, 880.0, 100.0, 500.0, 800, 600, parity=-1),
    "fisheye": Camera(300.0, 300.0, 399.5, 299.5, 800, 600, projection="equidistant"),
}
LIMITS = np.array([3.0, 4.5, 5.5])


@pytest.mark.parametrize("name", CAMERAS)
def test_counts_are_those_of_brute_force(name):
    camera, stars, looks = CAMERAS[name], load_catalog("bsc5").brighter_than(5.5), whole_sky(40, rolls=2)
    counts = count_stars(stars, outline(camera), looks, LIMITS)
    directions = stars.directions(2000.0)
    assert counts.shape == (80, 3)
    for matrix, found in zip(looks.matrices, counts, strict=True):
        seen = directions @ matrix.T
        front = np.arccos(np.clip(seen[:, 2], -1, 1)) <= camera.half_diagonal_rad + 0.01  # the lens model holds there
        xy = camera.project(seen)
        margin = 0.006 * camera.width  # the outline is straight between azimuths half a degree apart
        for limit, number in zip(LIMITS, found, strict=True):
            chosen = front & (stars.v_mag <= limit)
            low, high = (int(np.sum(camera.contains(xy[chosen], m))) for m in (-margin, margin))
            assert low <= number <= high
    assert counts[:, 2].max() > 3


def test_a_circular_field_counts_exactly():
    stars, looks = load_catalog("bsc5").brighter_than(5.5), whole_sky(300)
    counts = count_stars(stars, circle(8.0), looks, LIMITS)[:, 2]
    cosine = stars.directions(2000.0) @ looks.directions.T
    assert np.array_equal(counts, np.sum(cosine >= math.cos(math.radians(8.0)), axis=0))


def test_the_solid_angle_of_an_outline():
    assert solid_angle_sr(circle(30.0)) == pytest.approx(2 * math.pi * (1 - math.cos(math.radians(30.0))), rel=1e-12)
    # a pyramid of half angles a and b: 4 arcsin(sin a sin b)
    half = math.radians(20.0)
    square = Camera.from_fov(40.0, 500, 500)
    assert solid_angle_sr(outline(square)) == pytest.approx(4 * math.asin(math.sin(half) ** 2), rel=2e-4)
    for camera in CAMERAS.values():
        assert solid_angle_sr(outline(camera)) == pytest.approx(field_of(camera)[1], rel=4e-3)


def test_boresights_fill_the_sky_evenly():
    grid = sky_grid(10_000)
    assert np.linalg.norm(grid, axis=1) == pytest.approx(1.0, abs=1e-12)
    assert np.abs(grid.mean(axis=0)).max() < 1e-4
    rng = np.random.default_rng(1)
    for axis in rng.standard_normal((20, 3)):
        radius = rng.uniform(0.2, 2.0)
        share = np.mean(grid @ (axis / np.linalg.norm(axis)) >= math.cos(radius))
        assert share == pytest.approx((1 - math.cos(radius)) / 2, abs=1.5e-3)  # points on the rim, √N of them, half in


def test_attitudes_have_the_roll_they_tell():
    looks = whole_sky(50, rolls=3)
    for k in (0, 7, 149):
        same = Attitude.from_radec_roll(looks.ra_deg[k], looks.dec_deg[k], looks.roll_deg[k])
        assert same.as_matrix() == pytest.approx(looks.matrices[k], abs=1e-12)
    turns = np.diff(looks.roll_deg.reshape(-1, 3), axis=1) % 360.0
    assert turns == pytest.approx(np.full((50, 2), 120.0), abs=1e-9)
    assert looks.directions[0] == pytest.approx(looks.directions[2], abs=1e-12)


@pytest.mark.parametrize(
    "overrides",
    [
        [],
        ["pointing.mounting=zenith", "pointing.offset_deg=[3, -20, 5]", "study.sampling=orbit"],
        ["pointing.target=[83.8, -5.4, 30]"],
        ["pointing.target=Moon"],
    ],
)
def test_the_path_is_that_of_the_trials(overrides):
    scenario = load_scenario("cubesat_ideal", ["pointing.error_deg=0", "sky.magnitude_limit=3", *overrides])
    looks = along_path(scenario, 5)
    scenes = build_scenes(scenario)
    for index in (0, 4):
        scene = scenes.scene(index, lambda stage, i=index: stream(scenario.seed, stage, i), 0.01, 0.1)
        assert looks.t_s[index] == scene.t_s
        assert looks.matrices[index] == pytest.approx(scene.pointing.camera.as_matrix(), abs=1e-10)


def test_random_attitudes_have_a_path_where_they_hold_a_target():
    scenario = load_scenario("cubesat_ideal", ["study.sampling=sky", "pointing.target=[83.8, -5.4, 30]"])
    looks = along_path(scenario, 3)
    assert looks.ra_deg == pytest.approx(np.full(3, 83.8), abs=1e-9)
    assert looks.dec_deg == pytest.approx(np.full(3, -5.4), abs=1e-9)


@pytest.mark.parametrize(
    "keys",
    [
        ["study.sampling=orbit"],
        ["study.sampling=orbit", "pointing.mounting=zenith", "pointing.offset_deg=[3, -20, 5]"],
        ["study.sampling=orbit", "pointing.rate_deg_s=[0.1, -0.2, 0.3]"],
        ["pointing.target=[83.8, -5.4, 30]", "pointing.rate_deg_s=[0.1, -0.2, 0.3]"],
    ],
)
def test_the_nominal_rate_is_that_of_the_scenes(keys):
    """In camera axes, without the pointing error; the orbit's rate is about the body's negative pitch axis."""
    scenario = load_scenario("cubesat_ideal", ["pointing.error_deg=0", "sky.magnitude_limit=3", *keys])
    scene = build_scenes(scenario).scene(0, lambda stage: stream(scenario.seed, stage, 0), 0.01, 0.1)
    expected = scene.pointing.rate_camera_rad_s
    # the period is the mean one, from node to node
    assert nominal_rate_rad_s(scenario) == pytest.approx(expected, abs=3e-3 * np.linalg.norm(expected) + 1e-15)
    assert np.linalg.norm(expected) > 0.0


def test_a_prediction_is_for_the_camera_and_stars_of_the_scenario_alone():
    scenario = load_scenario("cubesat_ideal", ["specification.yaw_deg=1"])
    own = coverage(scenario, 20)
    assert own.judgement is not None
    assert own.left_out
    for given in ({"magnitude_limit": 5.0}, {"snr": 7.0}, {"circle_deg": 8.0}):
        other = coverage(scenario, 20, **given)
        assert other.judgement is None
        assert other.left_out == ()
        assert other.summary()["verdict"] is None


@pytest.mark.parametrize(("least", "wanted"), [(1, 2), (2, 2), (3, 3), (7, 7)])
def test_an_attitude_needs_two_stars_or_as_many_as_asked_for(least, wanted):
    scenario = load_scenario("cubesat_ideal", ["tracker.magnitude_limit=4.5"])
    looks = whole_sky(60, scenario=scenario, exclusion=Exclusion(sun_deg=50.0))
    found = predict(scenario, looks, least)
    assert {1, 2, 3} <= set(found.counts.tolist())
    assert len(found.evidence.covariance_rad2) == np.sum((found.counts >= wanted) & looks.allowed)
    assert found.evidence.attitudes == looks.allowed.sum() < 60


@pytest.mark.parametrize("exposure_s", [0.05, 0.4])
def test_a_pixel_without_a_star_has_the_sky_and_the_dark_current_of_its_exposure(exposure_s):
    """75 S10 everywhere; 8 e⁻/s at the reference temperature; noise of both and of the readout."""
    keys = [f"detector.exposure_s={exposure_s}", "sky.background_s10=75", "detector.dark_current_e_s=8"]
    keys += ["detector.temperature_c=25", "detector.dark_reference_c=25", "detector.read_noise_e=3", "detector.prnu=0"]
    keys += ["detector.dsnu=0", "detector.adc_bits=16", "detector.full_well_e=20000", "detector.offset_dn=100"]
    scenario = load_scenario("cubesat_ideal", [*keys, "detector.gain_e_per_dn=0.25"])
    found, plane = build_sensitivity(scenario), build_focal_plane(scenario)
    pixel = found.pixel
    assert pixel.sky_e == pytest.approx(75.0 * plane.s10_e_s_pixel * exposure_s, rel=1e-9)
    assert pixel.dark_e == pytest.approx(8.0 * exposure_s, rel=1e-9)
    expected = math.sqrt(pixel.sky_e + pixel.dark_e + 9.0 + 0.25**2 / 12.0)
    assert pixel.noise_e == pytest.approx(expected, rel=1e-3)
    assert pixel.top_e == pytest.approx((65535 - 100) * 0.25)  # below the full well
    higher = build_sensitivity(scenario.changed({"detector.gain_e_per_dn": 1.0})).pixel
    assert higher.top_e == 20_000.0


def test_the_illumination_of_a_field_is_its_mean():
    """Of cos θ of stars across a field of 60°: a plain mean over 200 × 150 points of the image; the grid of 16 × 16 is
    good to 1e-3."""
    keys = ["optics.focal_length_mm=6", "optics.aperture_mm=3", "optics.vignetting.natural=true"]
    scenario = load_scenario("cubesat_ideal", [*keys, "optics.distortion={k1: 0}"])
    plane = build_focal_plane(scenario)
    camera = plane.camera
    x, y = np.meshgrid((np.arange(200) + 0.5) / 200 * camera.width, (np.arange(150) + 0.5) / 150 * camera.height)
    seen = camera.unproject(np.stack([x.ravel(), y.ravel()], axis=1) - 0.5)
    mean = np.mean(star_illumination(plane.true_camera, plane.vignetting, seen))
    assert mean < 0.97
    found = build_sensitivity(scenario).gathered_s / scenario.detector.exposure_s
    assert found == pytest.approx(mean, rel=1e-3)


@pytest.mark.parametrize("pitch_um", [(5.0, 2.5), (2.5, 5.0), (5.0, 5.0)])
def test_images_of_the_prediction_hold_the_light_of_a_star(pitch_um):
    """Four standard deviations on either side along both axes: all but 2e-4 of it, also of a moving star."""
    keys = [f"detector.pixel_pitch_um=[{pitch_um[0]}, {pitch_um[1]}]", "optics.psf.sigma_px=1.6"]
    scenario = load_scenario("cubesat_ideal", [*keys, "optics.psf.model=gaussian"])
    plane = build_focal_plane(scenario)
    for rate in (np.zeros(3), np.array([0.01, -0.02, 0.1])):
        images, along_x, along_y = sensitivity._images(plane, rate, 0.2)
        assert images.sum(axis=(1, 2)) == pytest.approx(np.ones(16), abs=2e-4)
        assert along_x.shape == along_y.shape == images.shape


def test_streaks_by_a_roll_have_their_rms_length_over_the_field():
    """Second moments of the images: those of the Gaussian and the pixel, and L²/12 of streaks L = r θ about the middle,
    with ⟨r²⟩ = (w² + h²)/12; 0.5 % of an arc of 0.04 rad and of the light beyond 4 σ."""
    keys = ["optics.psf.sigma_px=1.2", "optics.psf.model=gaussian", "optics.distortion={k1: 0}"]
    keys += ["detector.width=1024", "detector.height=768", "optics.focal_length_mm=200", "optics.aperture_mm=100"]
    plane = build_focal_plane(load_scenario("cubesat_ideal", keys))
    images, _, _ = sensitivity._images(plane, np.array([0.0, 0.0, 0.2]), 0.2)
    at = np.arange(images.shape[1]) - images.shape[1] // 2
    total = images.sum(axis=(1, 2))
    moments = []
    for axis in (1, 2):
        line = images.sum(axis=axis) / total[:, None]
        mean = line @ at
        moments.append(line @ at**2 - mean**2)
    length2 = 0.04**2 * (1024**2 + 768**2) / 12.0
    assert np.mean(sum(moments)) == pytest.approx(2.0 * (1.2**2 + 1.0 / 12.0) + length2 / 12.0, rel=5e-3)


@pytest.mark.parametrize(
    ("keys", "given", "angles", "sources"),
    [
        ([], None, (0.0, 0.0, 0.0), {}),
        (["optics.baffle.sun_exclusion_deg=50"], None, (0.0, 0.0, 0.0), {}),  # there is no baffle
        (
            ["optics.baffle.pst=vane", "optics.baffle.sun_exclusion_deg=50"],
            None,
            (50.0, 20.0, 25.0),
            {"sun": ", as set", "moon": ", the default", "earth": ", the default"},
        ),
        (
            ["optics.baffle.pst=vane", "specification.sun_exclusion_deg=45"],
            {"earth": 5.0, "sun": None, "moon": 0.0},
            (45.0, 0.0, 5.0),
            {"sun": "specification.sun_exclusion_deg", "earth": "--earth-deg"},
        ),
    ],
)
def test_exclusion_angles_are_those_given_then_specified_then_of_the_baffle(keys, given, angles, sources):
    found = exclusion_of(load_scenario("cubesat_ideal", keys), given)
    assert (found.sun_deg, found.moon_deg, found.earth_deg) == angles
    assert set(found.sources) == set(sources)
    for body, source in sources.items():
        assert found.sources[body].endswith(source)


def test_a_summary_is_of_what_was_asked_for():
    scenario = load_scenario("cubesat_ideal", ["study.sampling=orbit"])
    path, sky = (coverage(scenario, 40, path=path, rolls=2, magnitude_limit=5.0) for path in (True, False))
    assert (path.boresights.kind, len(path.boresights), path.boresights.rolls) == ("path", 40, 1)
    assert (sky.boresights.kind, len(sky.boresights), sky.boresights.rolls) == ("sky", 80, 2)
    for result, over in ((path, "time along the mission's path"), (sky, "the whole sky")):
        told, counts = result.summary(), np.sort(result.counts)
        assert (told["over"], told["attitudes"], told["magnitude_limit"]) == (over, len(counts), 5.0)
        assert told["magnitude_limit_from"] == "given"
        stars = told["stars"]
        assert (stars["min"], stars["max"]) == (counts[0], counts[-1])
        assert stars["mean"] == pytest.approx(counts.mean())
        assert stars["std"] == pytest.approx(math.sqrt(np.sum((counts - counts.mean()) ** 2) / (len(counts) - 1)))
        # the smallest count that is not exceeded by p % of the attitudes
        expected = {
            f"p{p:g}": counts[max(math.ceil(p / 100.0 * len(counts)) - 1, 0)]
            for p in (0.1, 1.0, 5.0, 25.0, 50.0, 75.0, 95.0, 99.0)
        }
        assert stars["percentiles"] == expected
        assert told["field_deg2"] == pytest.approx(math.degrees(1.0) ** 2 * told["field_sr"])
        evenly = told["stars_over_sky"] * told["field_sr"] / (4.0 * math.pi)
        assert told["stars_if_spread_evenly"] == pytest.approx(evenly)
        assert told["poorest_attitudes"] == np.sum(counts == counts[0])
        assert [told["availability"][str(k)] for k in (1, 12)] == [np.mean(counts >= 1), np.mean(counts >= 12)]
        for name in ("availability", "availability_where_allowed"):  # nothing is excluded
            assert told[name] == {str(k): np.mean(counts >= k) for k in range(1, 13)}, name
        limits = [point["magnitude_limit"] for point in told["magnitude_curve"]]
        assert limits == pytest.approx(np.arange(2.0, 6.01, 0.25))
        assert [point["mean"] for point in told["magnitude_curve"]] == sorted(
            point["mean"] for point in told["magnitude_curve"]
        )


def test_what_excludes_everything_is_said():
    alone = SimpleNamespace(excluded={"sun": np.ones(4, bool), "moon": np.array([True, False, False, False])})
    angles = Exclusion(sources={"sun": "--sun-deg", "moon": "--moon-deg"})
    assert everything_excluded(alone, angles) == "everything is excluded by --sun-deg"
    half = np.array([True, True, False, False])
    both = SimpleNamespace(excluded={"sun": half, "earth": ~half})
    assert everything_excluded(both, angles) == "everything is excluded by --sun-deg and earth"


def test_exclusion_is_that_of_the_bodies_places():
    scenario = load_scenario("cubesat_ideal", ["pointing.error_deg=0", "sky.magnitude_limit=3"])
    looks = along_path(scenario, 40, Exclusion(sun_deg=115.0, moon_deg=90.0))
    scenes = build_scenes(scenario)
    seen = {"sun": 0, "moon": 0}
    for index in range(40):
        scene = scenes.scene(index, lambda stage, i=index: stream(scenario.seed, stage, i), 0.01, 0.1)
        for name, limit in (("sun", 115.0), ("moon", 90.0)):
            place = scene.bodies.direction[scene.bodies.name == name.title()][0]
            angle = math.degrees(math.acos(place @ looks.directions[index]))
            if abs(angle - limit) > 0.03:  # interpolation 0.02°, aberration 26″
                assert looks.excluded[name][index] == (angle < limit)
                seen[name] += looks.excluded[name][index]
    assert 0 < seen["sun"] < 40
    assert 0 < seen["moon"] < 40


def test_the_earths_limb_and_the_share_of_the_sky_near_the_sun():
    scenario = load_scenario("cubesat_ideal", ["optics.focal_length_mm=12", "optics.aperture_mm=8"])
    # the camera looks square to the nadir, the horizon is arcsin(R/r) from it
    limb = 90.0 - math.degrees(math.asin(EARTH_RADIUS_KM / (EARTH_RADIUS_KM + 800.0)))
    assert not along_path(scenario, 20, Exclusion(earth_deg=limb - 0.1)).excluded["earth"].any()
    assert along_path(scenario, 20, Exclusion(earth_deg=limb + 0.1)).excluded["earth"].all()
    looks = whole_sky(4000, 1, scenario, Exclusion(sun_deg=40.0, moon_deg=15.0))
    for name, angle in (("sun", 40.0), ("moon", 15.0)):
        assert looks.excluded[name].mean() == pytest.approx((1 - math.cos(math.radians(angle))) / 2, abs=3e-3)
    assert looks.allowed.sum() == np.sum(~(looks.excluded["sun"] | looks.excluded["moon"]))


def test_stars_behind_the_earth_do_not_count():
    looking_down = ["pointing.offset_deg=[30, 0, 0]", "pointing.error_deg=0"]
    scenario = load_scenario("cubesat_ideal", looking_down)
    looks = along_path(scenario, 12)
    stars = load_catalog("bsc5").brighter_than(5.5)
    counts = count_stars(stars, circle(15.0), looks, LIMITS)[:, 2]
    directions = stars.directions(2000.0)
    free = np.array(
        [np.sum((directions @ m[2] >= math.cos(math.radians(15.0))) & ~occulted(directions, -n))
         for m, n in zip(looks.matrices, looks.nadir * 7178.137, strict=True)]
    )  # fmt: skip
    assert np.array_equal(counts, free)
    clear = along_path(load_scenario("cubesat_ideal", [*looking_down, "sky.earth=false"]), 12)
    assert counts.sum() < count_stars(stars, circle(15.0), clear, LIMITS)[:, 2].sum()


def test_information_is_the_sum_over_the_brightest():
    stars, looks, camera = load_catalog("bsc5").brighter_than(5.0), whole_sky(30), Camera.from_fov(50.0, 400, 300)
    directions = stars.directions(2000.0)
    weight = np.random.default_rng(2).uniform(1.0, 9.0, len(stars))
    arguments = (looks.matrices, directions, voxel_grid(directions), outline(camera), weight)
    counts, information = accumulate_information(*arguments, 10, looks.nadir, looks.limb_cosine)
    for matrix, count, found in zip(looks.matrices, counts, information, strict=True):
        seen = directions @ matrix.T
        inside = camera.contains(camera.project(seen), 0.0) & (seen[:, 2] > math.cos(camera.half_diagonal_rad))
        near_rim = inside != (camera.contains(camera.project(seen), 3.0) & (seen[:, 2] > 0.5))
        if near_rim.any():
            continue
        used = np.flatnonzero(inside)[:10]
        assert count == len(used)
        expected = sum(w * (np.eye(3) - np.outer(b, b)) for w, b in zip(weight[used], seen[used], strict=True))
        assert found == pytest.approx(expected, rel=1e-12, abs=1e-9)
    assert counts.max() == 10


def test_results_are_whole_and_the_same_again(tmp_path):
    scenario = load_scenario("cubesat_ideal")
    one, two = (
        coverage(scenario, 400, path=True, magnitude_limit=5.0, exclusion=Exclusion(30.0, 20.0, 10.0)) for _ in range(2)
    )
    assert one.summary() == two.summary()
    assert one.to_table(scenario).equals(two.to_table(scenario))
    files = write_study(tmp_path / "a", "coverage", one.summary(), None, coverage_figures(one), one.to_table(scenario))
    assert files == ("coverage.json", "coverage.parquet", "map.png", "counts.png", "magnitudes.png")
    assert sorted(p.name for p in (tmp_path / "a").iterdir()) == sorted(files)
    summary = json.loads((tmp_path / "a" / "coverage.json").read_text())
    table = pq.read_table(tmp_path / "a" / "coverage.parquet")
    stars = table["stars"].to_numpy()
    allowed = ~np.any(
        [table[f"excluded_{body}"].to_numpy(zero_copy_only=False) for body in ("sun", "moon", "earth")], axis=0
    )
    assert summary["stars"]["min"] == stars[allowed].min()
    assert summary["stars"]["mean"] == pytest.approx(stars[allowed].mean())
    assert summary["availability"]["4"] == pytest.approx(np.mean((stars >= 4) & allowed))
    assert summary["availability_where_allowed"]["4"] == pytest.approx(np.mean(stars[allowed] >= 4))
    low = summary["poorest"][0]
    row = np.flatnonzero(np.abs(table["ra_deg"].to_numpy() - low["ra_deg"]) < 1e-3)
    assert stars[row].min() == stars[allowed].min()
    at_limit = next(p for p in summary["magnitude_curve"] if p["magnitude_limit"] == 5.0)
    assert at_limit["mean"] == summary["stars"]["mean"]


def test_everything_excluded_is_told_not_divided_by(tmp_path):
    scenario = load_scenario("cubesat_ideal")
    result = coverage(scenario, 50, magnitude_limit=4.0, exclusion=Exclusion(sun_deg=180.0))
    write_study(tmp_path, "coverage", result.summary(), None, coverage_figures(result))
    summary = json.loads((tmp_path / "coverage.json").read_text())
    assert summary["excluded_share_any"] == 1.0
    assert summary["stars"]["min"] is None
    assert summary["availability"]["1"] == 0.0


def test_the_limit_is_what_camera_and_tracker_both_know():
    cubesat = coverage(load_scenario("cubesat_ideal"), 20)
    assert cubesat.magnitude_limit == 6.5
    assert "tracker.magnitude_limit" in cubesat.limit_reason
    dim = coverage(load_scenario("cubesat_ideal", ["optics.aperture_mm=4"]), 20)
    assert 5.0 < dim.magnitude_limit < 6.5
    assert dim.limit_reason == "the camera's detection limit"


def test_wrong_numbers_are_told():
    scenario = load_scenario("cubesat_ideal")
    for wrong, words in (
        ({"count": 0}, "at least 1"),
        ({"rolls": 0}, "at least 1"),
        ({"circle_deg": -1.0}, "above 0"),
        ({"magnitude_limit": math.nan}, "must be a number"),
        ({"snr": 0.0}, "must be positive"),
    ):
        with pytest.raises(InputError, match=words):
            coverage(scenario, **({"count": 5} | wrong))
    with pytest.raises(InputError, match="0 to 180"):
        Exclusion(moon_deg=-1.0)
    with pytest.raises(InputError, match="no boresight path"):
        along_path(load_scenario("cubesat_ideal", ["study.sampling=sky"]), 5)
