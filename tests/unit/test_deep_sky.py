"""The table of deep-sky objects: complete, and each in the constellation that it states."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord, get_constellation

from startracker.catalog.names import KINDS, deep_sky_directions, deep_sky_objects

OBJECTS = deep_sky_objects()


def test_every_messier_object_is_there_once():
    designations = [item.designation for item in OBJECTS]
    assert designations[:110] == [f"M{n}" for n in range(1, 111)]
    assert len(set(designations)) == len(designations) > 170
    others = [item.other for item in OBJECTS if item.other]
    assert len(set(others)) == len(others)
    assert {item.kind for item in OBJECTS} == set(KINDS)


def test_every_object_is_in_its_constellation():
    # astropy has the boundaries of Roman (1987, PASP 99, 695)
    at = SkyCoord([item.ra_deg for item in OBJECTS], [item.dec_deg for item in OBJECTS], unit=u.deg)
    stated = [item.constellation for item in OBJECTS]
    assert [*get_constellation(at, short_name=True)] == stated


def test_directions_and_labels():
    orion = next(item for item in OBJECTS if item.designation == "M42")
    assert orion.label == "M42 Orion Nebula"
    assert orion.ra_deg == pytest.approx(83.82, abs=0.02)  # 5h 35.3m; Simbad: 5h 35m 17s, -5° 23′ 28″
    assert orion.dec_deg == pytest.approx(-5.39, abs=0.02)
    vectors = deep_sky_directions()
    np.testing.assert_allclose(np.hypot(*vectors[:, :2].T), np.cos(np.radians([o.dec_deg for o in OBJECTS])))
    near_equator = next(item for item in OBJECTS if item.designation == "M2")
    assert near_equator.dec_deg == pytest.approx(-0.8167, abs=1e-3)  # the sign of "-0 49"
