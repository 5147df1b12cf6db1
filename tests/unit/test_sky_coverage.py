"""Stars in a field: the kernels against looking at every star, attitudes and exclusion against exact geometry."""

import json
import math

import numpy as np
import pyarrow.parquet as pq
import pytest

from simulator.build import build_scenes
from simulator.checks import load_scenario
from simulator.constants import EARTH_RADIUS_KM
from simulator.randomness import stream
from simulator.sky.earth import occulted
from simulator.study.coverage.boresights import Exclusion, along_path, sky_grid, whole_sky
from simulator.study.coverage.field_counts import accumulate_information, circle, outline, solid_angle_sr
from simulator.study.coverage.maps import coverage_figures
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
