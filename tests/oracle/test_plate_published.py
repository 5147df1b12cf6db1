"""Yee 1999, section 4.2.3: the Vega image. Centroids of Table 4.14, matched stars and their places of Table 4.5.

Printed: the centre (278.45703°, 37.24007°) for a tolerance of 1″, and Table 4.5's computed places. The centroids carry
five decimals (1e-7°), the printed places five: each agrees within 2e-5° and the centre within 1e-5°.
"""

import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.wcs import WCS

from startracker.errors import InputError
from startracker.estimation import plate_constants, solve_plate
from startracker.estimation.plate import first_center_deg

XY = np.array(
    [
        [16.13144, 74.39691],
        [-162.81865, 95.40933],
        [-73.08759, 69.96350],
        [-15.73050, 143.07092],
        [79.27619, -113.87619],
    ]
)
CATALOG = np.array(
    [
        [279.23415, 38.78361],
        [283.62542, 36.89889],
        [281.19292, 37.60500],
        [281.08458, 39.67000],
        [274.96499, 36.06445],
    ]
)
COMPUTED = np.array(
    [
        [279.23476, 38.80490],
        [283.61611, 36.89968],
        [281.21146, 37.60544],
        [281.07801, 39.65362],
        [274.96173, 36.05834],
    ]
)


def test_vega_image():
    plate = solve_plate(XY, CATALOG)
    assert plate.iterations == 3
    assert plate.center_deg == pytest.approx([278.45703, 37.24007], abs=1e-5)
    assert np.abs(plate.sky_deg(XY) - COMPUTED).max() < 2e-5
    assert np.abs(plate.residual_deg - (COMPUTED - CATALOG)).max() < 2e-5
    assert np.linalg.det(plate.matrix) < 0  # x right, y up: as seen in the sky


def test_yees_constants_are_the_same_plate():
    plate = solve_plate(XY, CATALOG)
    a, b, c, d, e, f = plate.constants
    x, y = XY[0]
    xi, eta = plate.matrix @ XY[0] + plate.offset
    assert xi - x == pytest.approx(a * x + b * y + c, abs=1e-12)
    assert eta - y == pytest.approx(d * x + e * y + f, abs=1e-12)


@pytest.mark.parametrize("change", [[1, -1], [-1, 1], [0.01, 0.01], [2.0, 3.0]])
def test_signs_and_units_do_not_matter(change):
    plate, other = solve_plate(XY, CATALOG), solve_plate(XY * change, CATALOG)
    assert other.center_deg == pytest.approx(plate.center_deg, abs=1e-8)
    assert other.residual_deg == pytest.approx(plate.residual_deg, abs=1e-8)


@pytest.mark.parametrize("center", [(0.001, 10.0), (359.9, -35.0), (120.0, 88.5), (33.0, -89.9), (200.0, 45.0)])
def test_against_a_world_coordinate_system(center):
    # astropy's TAN projection with a rotated, sheared matrix: solved from its own points to rounding
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = ["RA---TAN", "DEC--TAN"]
    wcs.wcs.crval, wcs.wcs.crpix = center, [1, 1]
    wcs.wcs.cd = [[-0.018, 0.009], [0.0095, 0.017]]
    xy = np.random.default_rng(3).uniform(-200, 200, (9, 2))
    sky = np.column_stack(wcs.all_pix2world(xy[:, 0], xy[:, 1], 0))
    plate = solve_plate(xy, sky, tolerance_deg=1e-9)
    found, true = SkyCoord(*plate.center_deg, unit="deg"), SkyCoord(*center, unit="deg")
    assert found.separation(true).deg < 1e-9
    extra = np.array([[100.0, -30.0], [-250.0, 250.0]])
    want = wcs.all_pix2world(extra, 0)
    got = plate.sky_deg(extra)
    assert SkyCoord(*got.T, unit="deg").separation(SkyCoord(*want.T, unit="deg")).deg.max() < 1e-9


def test_same_centre_as_the_estimator():
    # the estimator projects about the stars' mean, 2° from the centre: residuals of 0.02° times its square, 1e-3, and
    # the places on the plate times the difference to the nearest rotation
    plate = solve_plate(XY, CATALOG)
    observed = np.column_stack([XY @ plate.matrix.T, np.ones(5)])  # east, north, out
    ra, dec = np.radians(CATALOG).T
    reference = np.column_stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    axis = plate_constants(observed, reference, 1e-4).matrix[2]
    found = np.degrees([np.arctan2(axis[1], axis[0]) % (2 * np.pi), np.arcsin(axis[2])])
    assert found == pytest.approx([278.45703, 37.24007], abs=2e-4)


def test_first_centre_is_near():
    assert first_center_deg(XY, CATALOG) == pytest.approx([278.457, 37.240], abs=1.5)


@pytest.mark.parametrize(
    ("xy", "sky", "match"),
    [
        (XY[:2], CATALOG[:2], "need three stars; got 2"),
        (XY, CATALOG[:4], "must both be"),
        (XY * np.nan, CATALOG, "finite"),
        (np.column_stack([np.arange(5.0), 2 * np.arange(5.0)]), CATALOG, "not collinear"),
        (np.zeros((5, 2)), CATALOG, "not collinear"),
        (XY, CATALOG * [[1], [-1], [1], [-1], [1]] + [[0], [180], [0], [180], [90]], "90°|converge"),
    ],
)
def test_unusable_input(xy, sky, match):
    with pytest.raises(InputError, match=match):
        solve_plate(xy, sky)
