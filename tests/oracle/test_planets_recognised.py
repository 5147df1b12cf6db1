"""Planets among the detections: recognised by their ephemeris, and neither stars nor part of the attitude."""

import numpy as np
import pytest

from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.sky.instants import bodies_seen_from
from simulator.study.trials.trial import TrialRunner
from startracker import Attitude, Camera, Observer, StarTracker
from startracker.catalog.bodies import NO_BODIES, body_directions
from startracker.core import ARCSEC_RAD, DAYS_PER_JULIAN_YEAR, J2000_JD_TT
from startracker.ephemeris import astrometric_au, barycentric, timescale
from startracker.observer import aberrate
from startracker.tracking.candidates import Sky


def near_earth(year):
    """An observer 7000 km from the Earth's centre, and Skyfield's time."""
    time = timescale().tt_jd(J2000_JD_TT + DAYS_PER_JULIAN_YEAR * (year - 2000.0))
    earth = barycentric("Earth", time)
    offset = np.array([7000.0, 0.0, 0.0]) / 149_597_870.7
    return Observer(year, earth.velocity.km_per_s + np.array([0.0, 7.5, 0.0]), earth.xyz.au + offset), time


@pytest.mark.parametrize("year", [1900.3, 1995.0, 2000.0, 2026.4, 2053.7])
def test_directions_are_those_of_skyfield(year):
    """The table's cubics: 0.2 km for the Moon, that is 0.1″; the acceleration of Mercury during its light time: 5 km,
    at 0.6 au 0.012″."""
    observer, time = near_earth(year)
    found = body_directions(observer)
    for name, direction in found.items():
        offset = astrometric_au([name], time, observer.position_au)
        expected = aberrate(offset / np.linalg.norm(offset), observer.velocity_km_s)[0]
        limit = 0.1 if name == "Moon" else 0.015
        assert np.linalg.norm(direction - expected) < limit * ARCSEC_RAD, name


@pytest.mark.parametrize(
    ("planet", "epoch"),
    [("Jupiter", "2026-01-10"), ("Mars", "2027-02-19"), ("Venus", "2026-06-01"), ("Saturn", "2026-10-04")],
)
def test_a_planet_of_a_frame_is_recognised(planet, epoch):
    keys = (f"epoch={epoch}T00:00:00Z", f"pointing.target={planet}", "study.sampling=sky")
    runner = TrialRunner(Scenario.load("cubesat_ideal", [*keys, "pointing.target_offset_deg=[-2.0, 1.5]"]))
    for index in range(3):
        frame, truth = runner.renderer.frame(index)
        solution = runner.tracker.solve(frame)
        assert solution.solved
        names = solution.bodies.name.tolist()
        assert planet in names
        source = truth.sources.image_xy[truth.sources.name == planet][0]
        k = names.index(planet)
        # a disk of up to 60″, 1.3 px, with a phase; overexposed
        assert np.hypot(*(solution.bodies.xy[k] - source)) < 1.5
        assert np.array_equal(solution.centroids[solution.bodies.centroid[k]], solution.bodies.xy[k])
        assert np.hypot(*(solution.stars.xy - solution.bodies.xy[k]).T).min() > 3.0
        assert f"not used: {planet}" in " ".join(step.text for step in solution.steps)


def planet_beside_a_guide_star(tracker, camera):
    """Directions of a planet at 0.3 to 3 px from a guide star, the observer, and the star's row."""
    for year in np.arange(2010.0, 2040.0, 0.01):
        observer, _ = near_earth(float(year))
        guide = tracker.guide.apparent_to(observer)
        for name, direction in body_directions(observer).items():
            if name not in ("Jupiter", "Saturn", "Mars", "Uranus"):
                continue
            away = np.linalg.norm(guide.directions - direction, axis=1)
            row = int(np.argmin(away))
            if 1.0 < away[row] / camera.pixel_rad < 2.0:
                return direction, observer, guide, row, name
    raise AssertionError


def test_a_planet_beside_a_star_is_no_star(monkeypatch):
    """The star is too faint to be seen; its planet is identified as it, and turns the attitude, unless recognised."""
    camera = Camera.from_fov(20.0, 512, 512)
    tracker = StarTracker(camera, magnitude_limit=5.5)
    planet, observer, guide, row, name = planet_beside_a_guide_star(tracker, camera)
    direction = np.arctan2(planet[1], planet[0]), np.arcsin(planet[2])
    true = Attitude.from_radec_roll(np.degrees(direction[0]) + 4.0, np.degrees(direction[1]) - 3.0, 20.0)
    index, _, xy = guide.in_field(true.as_matrix(), -5.0, camera)
    others = index != row
    rng = np.random.default_rng(2)
    sigma = 0.05
    points = np.concatenate([xy[others], camera.project(true.apply(planet[None]))])
    points = points + rng.normal(scale=sigma, size=points.shape)
    flux = np.append(10.0 ** (-0.4 * guide.v_mag[index[others]]), 10.0 ** (-0.4 * guide.v_mag[row]))
    star = int(guide.catalog.id[row])
    with monkeypatch.context() as patch:
        patch.setattr("startracker.field_solution.seen_bodies", lambda *_: NO_BODIES)
        unaware = tracker.solve_centroids(points, flux, sigma_px=0.5, observer=observer)
    assert star in unaware.stars.catalog_id.tolist()
    solution = tracker.solve_centroids(points, flux, sigma_px=0.5, observer=observer)
    assert solution.solved
    assert name in solution.bodies.name.tolist()
    assert star not in solution.stars.catalog_id.tolist()
    body = solution.bodies.name.tolist().index(name)
    assert np.array_equal(solution.bodies.xy[body], solution.centroids[solution.bodies.centroid[body]])
    # as if the centroid were not in the list
    alone = tracker.solve_centroids(points[:-1], flux[:-1], sigma_px=0.5, observer=observer)
    assert len(alone.bodies.name) == len(solution.bodies.name) - 1
    assert np.allclose(solution.attitude.as_matrix(), alone.attitude.as_matrix(), atol=1e-12)
    assert np.allclose(solution.covariance, alone.covariance, rtol=1e-9)
    assert set(alone.stars.catalog_id.tolist()) == set(solution.stars.catalog_id.tolist())
    assert solution.matched == len(points) - len(solution.bodies.name)


def test_without_an_observer_there_are_no_bodies():
    camera = Camera.from_fov(20.0, 512, 512)
    tracker = StarTracker(camera, magnitude_limit=5.5)
    index, _, xy = tracker.guide.in_field(Attitude.from_radec_roll(84.0, 0.0, 0.0).as_matrix(), -5.0, camera)
    assert len(index) > 5
    assert tracker.solve_centroids(xy).bodies.name.size == 0
    assert len(NO_BODIES.name) == 0


def test_the_tracker_and_the_renderer_agree_on_planets():
    """Two paths through the ephemeris: the table of the tracker, and Skyfield with light deflection (at most 1.8″)."""
    renderer = Renderer(Scenario.load("cubesat_ideal", ["study.sampling=orbit"]))
    scene = renderer.scene(0)
    found = body_directions(scene.observer)
    clock, sky = renderer.scenes.clock, renderer.scenario.sky
    bodies = bodies_seen_from(clock, scene.t_s, scene.observer.position_au, scene.observer.velocity_km_s, sky)
    for name, direction in zip(bodies.name.tolist(), bodies.direction, strict=True):
        assert np.linalg.norm(direction - found[name]) < 2.0 * ARCSEC_RAD


def test_tracking_expects_no_star_beside_a_planet():
    camera = Camera.from_fov(20.0, 512, 512)
    tracker = StarTracker(camera, magnitude_limit=5.5)
    planet, observer, _, row, _ = planet_beside_a_guide_star(tracker, camera)
    ra, dec = np.degrees(np.arctan2(planet[1], planet[0])), np.degrees(np.arcsin(planet[2]))
    matrix = Attitude.from_radec_roll(ra + 2.0, dec - 1.0, 0.0).as_matrix()
    sky = Sky(tracker.guide, camera.pixel_rad)
    found = sky.expected(matrix, observer, 1000).index.tolist()
    earlier = Observer(observer.epoch_jyear - 0.5, observer.velocity_km_s, observer.position_au)
    before = sky.expected(matrix, earlier, 1000).index.tolist()
    assert row in before
    assert row not in found
    # Moon and Sun may be in the field half a year earlier or now
    assert len(set(before) - set(found)) <= 5
    assert len(sky.expected(matrix, None, 1000).index) >= len(found)
