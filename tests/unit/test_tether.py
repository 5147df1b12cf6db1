"""The tether: its light against the integral over a Lambert cylinder, its energy, its place and its blur."""

import numpy as np
import pytest

from simulator.build import build_camera
from simulator.optics.tether import Tether, cylinder_share, tether_points
from simulator.renderer import render
from simulator.scenario import Scenario, ScenarioError
from startracker.geometry.camera import Camera

CAMERA = Camera(fx=1110.0, fy=1110.0, cx=255.5, cy=239.5, width=512, height=480)


def unit(*vector):
    return np.array(vector) / np.linalg.norm(vector)


@pytest.mark.parametrize("lamp", [unit(0.1, 0.2, -1.0), unit(1.0, 0.3, 0.2), unit(0.2, 0.9, 0.9), unit(-0.4, 0.1, 1.0)])
def test_a_lambert_cylinder_summed_over_its_surface(lamp):
    axis, direction, diameter, albedo = unit(0.3, 0.8, 0.2), unit(0.1, -0.2, 1.0), 0.002, 0.5
    across = unit(*np.cross(axis, unit(1.0, 0.0, 0.0)))
    angle = (np.arange(40_000) + 0.5) / 40_000 * 2.0 * np.pi
    normal = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * np.cross(axis, across)
    both = np.clip(normal @ lamp, 0.0, None) * np.clip(normal @ -direction, 0.0, None)
    summed = albedo / np.pi * both.mean() * np.pi * diameter  # mean over the circumference
    assert cylinder_share(axis, lamp, direction[None], diameter, albedo)[0] == pytest.approx(summed, rel=1e-6)


def test_what_is_scattered_into_all_directions_is_the_albedo_s_share_of_what_falls_in():
    axis, lamp = unit(0.0, 1.0, 0.0), unit(0.6, 0.5, 0.2)
    rng = np.random.default_rng(5)
    n = 400_000
    directions = rng.normal(size=(n, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    share = cylinder_share(axis, lamp, directions, 0.001, 0.7)
    falls_in = 0.001 * np.linalg.norm(np.cross(lamp, axis))  # projected area of a metre
    scattered = 4.0 * np.pi * share.mean()
    assert scattered == pytest.approx(0.7 * falls_in, abs=4.0 * 4.0 * np.pi * share.std() / np.sqrt(n))


def test_pieces_run_from_end_to_end_and_add_up():
    section = Tether(diameter_mm=1.0, near_m=(0.3, 0.2, 0.5), far_m=(0.5, -4.0, 300.0))
    lamp = unit(0.2, 0.1, -1.0)
    points = tether_points(section, CAMERA, 18.0, lamp)
    near, far = (unit(*end) for end in (section.near_m, section.far_m))
    step = CAMERA.pixel_rad
    assert np.linalg.norm(points.direction[0] - near) < step
    assert np.linalg.norm(points.direction[-1] - far) < step
    # every piece is on the plane through lens and tether
    normal = unit(*np.cross(section.near_m, section.far_m))
    assert np.abs(points.direction @ normal).max() < 1e-12
    # the same light from equal pieces of length
    ends = np.linspace(0.0, 1.0, 200_001) ** 3  # fine where it is near
    place = np.array(section.near_m) + ends[:, None] * (np.array(section.far_m) - section.near_m)
    middle, length = 0.5 * (place[1:] + place[:-1]), np.linalg.norm(np.diff(place, axis=0), axis=1)
    distance = np.linalg.norm(middle, axis=1)
    axis = unit(*(np.array(section.far_m) - section.near_m))
    share = cylinder_share(axis, lamp, middle / distance[:, None], 1e-3, section.albedo) * length / distance**2
    assert points.share.sum() == pytest.approx(share.sum(), rel=1e-4)
    # a point at depth z is a disk of angular radius aperture / 2 z
    assert points.blur_rad[0] == pytest.approx(0.009 / 0.5, rel=0.01)
    assert points.blur_rad[-1] == pytest.approx(0.009 / 300.0, rel=0.2)


def test_the_rendered_tether_carries_that_light_where_it_should():
    scenario = Scenario.load("oedipus")
    bare = Scenario.load("oedipus", ["tether.diameter_mm=0"])
    with_tether, without = (render(one, 12, at_s=6.0)[1].mean_electrons for one in (scenario, bare))
    tether = with_tether - without
    assert tether.max() > 3.0
    camera = build_camera(scenario)
    line = camera.project(np.array([scenario.tether.near_m, scenario.tether.far_m]) / 1.0)
    rows, columns = np.nonzero(tether > 0.5 * tether.max())
    along = unit(*(line[1] - line[0]))
    off = np.abs((columns - line[0, 0]) * along[1] - (rows - line[0, 1]) * along[0])
    assert off.max() < 14.0  # half width of the blur where it enters the field
    assert np.all(tether >= -1e-9)


def test_in_the_shadow_of_the_earth_only_the_moon_lights_it_and_without_bodies_nothing():
    dark = render(Scenario.load("oedipus", ["sky.planets=false"]), 12, at_s=6.0)[1].mean_electrons
    bare = render(Scenario.load("oedipus", ["tether.diameter_mm=0"]), 12, at_s=6.0)[1].mean_electrons
    np.testing.assert_allclose(dark, bare, atol=1e-9)
    sunlit = render(Scenario.load("oedipus", ["sky.earth=false"]), 12, at_s=6.0)[1].mean_electrons
    moonlit = render(Scenario.load("oedipus"), 12, at_s=6.0)[1].mean_electrons
    assert (sunlit - bare).max() > 1e3 * (moonlit - bare).max()


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["tether.near_m=[0.1, 0.1, -1.0]"], "both ends must be in front of the lens"),
        (["tether.near_m=[0.0155556, -0.0049573, 1.0]"], "is collinear with the lens"),
        (["pointing.target=[10, 20, 30]", "pointing.spin.rate_deg_s=3"], "cannot hold a pointing.target"),
    ],
)
def test_what_cannot_be_is_refused(overrides, message):
    with pytest.raises(ScenarioError, match=message):
        Scenario.load("oedipus", overrides)
