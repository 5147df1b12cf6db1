"""Numbers of the published tables of the sky, one by one."""

from simulator.constants import RADIUS_KM
from simulator.sky.instants import B_V


def test_equatorial_radii_are_those_of_the_iau():
    """IAU working group, Archinal et al. 2018, Celest. Mech. Dyn. Astron. 130, 22; Sun: IAU 2015 Resolution B3; Earth:
    WGS 84."""
    assert RADIUS_KM == {
        "Mercury": 2440.53,
        "Venus": 6051.8,
        "Earth": 6378.137,
        "Moon": 1737.4,
        "Mars": 3396.19,
        "Jupiter": 71_492.0,
        "Saturn": 60_268.0,
        "Uranus": 25_559.0,
        "Neptune": 24_764.0,
        "Sun": 695_700.0,
    }


def test_colours_of_bodies_are_those_of_allen():
    """Cox 2000, *Allen's Astrophysical Quantities*, sections 12 and 14."""
    planets = {"Mercury": 0.93, "Venus": 0.82, "Earth": 0.20, "Mars": 1.36, "Jupiter": 0.83, "Saturn": 1.04}
    assert B_V == planets | {"Uranus": 0.56, "Neptune": 0.41, "Moon": 0.92, "Sun": 0.65}
