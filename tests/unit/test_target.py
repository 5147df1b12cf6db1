"""Holding a target: a direction, a star by any of its names, a body; and where it falls in the image."""

from types import SimpleNamespace

import numpy as np
import pytest

from simulator import Renderer, Scenario
from simulator.mission.parameters import PointingParameters
from simulator.sky.target import attitude_towards, body_direction, find_target
from startracker import InputError, load_catalog
from startracker.geometry.attitude import radec_to_direction


def test_names_of_stars_and_bodies():
    bright = load_catalog("hipparcos").brighter_than(3.0)
    sirius = find_target("Alp CMa", bright)
    assert bright.id[sirius] == 32349  # Sirius' number in the Hipparcos catalogue
    assert find_target("alpCMA", bright) == find_target("HIP 32349", bright) == find_target("32349", bright) == sirius
    assert find_target(" moon", bright) == "Moon"
    with pytest.raises(InputError, match="neither a body"):
        find_target("Nibiru", bright)


@pytest.mark.parametrize(
    ("catalogue", "number", "other"), [("hipparcos", 32349, "HR 2491"), ("bsc5", 2491, "HIP 32349")]
)
def test_a_star_by_its_proper_name_and_by_the_number_of_its_own_catalogue(catalogue, number, other):
    stars = load_catalog(catalogue).brighter_than(3.0)
    prefix = {"hipparcos": "HIP", "bsc5": "hr"}[catalogue]
    for name in ("Sirius", " s i r i u s", "Alp CMa", f"{prefix} {number}", f"{number}"):
        assert stars.id[find_target(name, stars)] == number, name
    with pytest.raises(InputError, match="neither a body"):
        find_target(other, stars)


def test_a_bright_star_that_hipparcos_lacks_has_a_negative_number():
    stars = load_catalog("hipparcos").brighter_than(7.0)
    lacking = int(stars.id[stars.id < 0][0])
    assert stars.id[find_target(str(lacking), stars)] == lacking


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("Sirus", "did you mean 'Sirius'"),
        ("Jupitr", "did you mean 'Jupiter'"),
        ("Alp Orii", "did you mean 'Alp Ori'"),
        ("qqq", "write a name such as Sirius"),
        ("-", "write a name such as Sirius"),
    ],
)
def test_a_name_that_is_not_known_gets_the_closest_one(name, hint):
    with pytest.raises(InputError, match=hint):
        find_target(name, load_catalog("hipparcos").brighter_than(3.0))


def test_a_body_that_is_not_rendered():
    bodies = SimpleNamespace(name=np.array(["Sun", "Moon"]), direction=np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    assert body_direction("Moon", bodies).tolist() == [0.0, 1.0, 0.0]
    with pytest.raises(InputError, match=r"Mars is not rendered; set sky.planets: true$"):
        body_direction("Mars", bodies)
    with pytest.raises(InputError, match=r"Earth is not rendered; set sky.planets: true and sky.earth: true \(within"):
        body_direction("Earth", bodies)


@pytest.mark.parametrize("offset", [(0.0, 0.0), (2.0, -1.5), (-20.0, 30.0)])
@pytest.mark.parametrize("place", [(0.0, 0.0), (123.0, 89.9), (359.9, -60.0)])
def test_offset_is_the_angle_in_the_image(place, offset):
    direction = radec_to_direction(*np.radians(place))
    attitude = attitude_towards(direction, PointingParameters(target_offset_deg=offset, target_roll_deg=33.0))
    x, y, z = attitude.apply(direction)
    assert (x / z, y / z) == pytest.approx(tuple(np.tan(np.radians(offset))), abs=1e-12)


@pytest.mark.parametrize("name", ["Alp CMa", "Jupiter"])
def test_named_target_is_drawn_where_it_was_asked_for(name):
    overrides = [
        f"pointing.target={name}",
        "pointing.error_deg=0",
        "pointing.target_offset_deg=[3, 2]",
        "sky.earth=false",
    ]
    renderer = Renderer(Scenario.load("cubesat_ideal", overrides))
    _, truth = renderer.frame(0)
    brightest = truth.sources.xy[np.argmax(truth.sources.electrons)]
    camera = renderer.camera
    wanted = camera.project(np.array([[np.tan(np.radians(3)), np.tan(np.radians(2)), 1.0]]))[0]
    assert brightest == pytest.approx(wanted, abs=1e-3)
    # held still in inertial space: no rate but the one asked for
    assert np.allclose(truth.rate_camera_rad_s, 0.0)


def test_direction_and_roll():
    overrides = ["pointing.target=[83.6, -5.4, 123]", "pointing.error_deg=0"]
    attitude = Renderer(Scenario.load("cubesat_ideal", overrides)).frame(0)[1].attitude
    assert (attitude.ra_deg, attitude.dec_deg, attitude.roll_deg) == pytest.approx((83.6, -5.4, 123.0), abs=1e-9)
