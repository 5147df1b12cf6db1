"""The WCS header against astropy's own reading of it (astropy.wcs, WCSLIB and its SIP; 7.0 and later).

Tolerance: 0.01 px and 1″ as asked of the header; TAN alone is exact, so 1e-6 px there. The SIP fit is good to 0.002 px
by construction.
"""

import numpy as np
import pytest
from astropy.io.fits import Header
from astropy.wcs import WCS

from startracker import Attitude, Camera, InputError, wcs_header
from startracker.geometry.attitude import direction_to_radec, radec_to_direction
from startracker.geometry.distortion import Distortion

CAMERAS = {
    "pinhole": Camera.from_fov(10.0, 512, 512),
    "off centre": Camera(900.0, 910.0, 200.0, 260.0, 512, 420),
    "mirrored": Camera(900.0, 910.0, 200.0, 260.0, 512, 420, parity=-1),
    "barrel": Camera.from_fov(20.0, 1024, 768, Distortion(k1=-0.2, k2=0.05)),
    "decentred": Camera(1500.0, 1500.0, 500.0, 390.0, 1024, 768, Distortion(k1=0.1, p1=0.003, p2=-0.002), -1),
    "wide": Camera.from_fov(50.0, 1024, 768, Distortion(k1=-0.15)),
    "all coefficients": Camera(
        1400.0, 1408.0, 500.0, 395.0, 1024, 768, Distortion(-0.2, 0.06, 0.002, -0.0015, -0.01), -1
    ),
    "off the image": Camera(1500.0, 1500.0, -40.0, 800.0, 1024, 768, Distortion(-0.1, 0.02, 0.001, 0.0005)),
}
ATTITUDES = [(85.0, 8.6, 0.0), (0.0, 0.0, 123.0), (250.0, -70.0, 300.0), (12.0, 89.99, 45.0), (40.0, -90.0, 10.0)]


@pytest.mark.parametrize("pointing", ATTITUDES)
@pytest.mark.parametrize("name", CAMERAS)
def test_pixels_and_sky_as_astropy_has_them(name, pointing):
    camera, attitude = CAMERAS[name], Attitude.from_radec_roll(*pointing)
    header = wcs_header(camera, attitude)
    wcs = WCS(Header(header))
    rng = np.random.default_rng(1)
    xy = rng.uniform([-0.5, -0.5], [camera.width - 0.5, camera.height - 0.5], (200, 2))
    directions = attitude.inverse.apply(camera.unproject(xy))
    ra, dec = direction_to_radec(directions)
    # 0-based, as our pixels are
    there = wcs.all_pix2world(xy, 0)
    found = radec_to_direction(*np.radians(there).T)
    assert np.linalg.norm(found - directions, axis=1).max() < min(np.radians(1 / 3600), 0.01 * camera.pixel_rad)
    back = wcs.all_world2pix(np.degrees(np.stack([ra, dec], axis=1)), 0, tolerance=1e-6)
    limit = 1e-6 if camera.distortion.is_zero else 0.01
    assert np.abs(back - xy).max() < limit
    if not camera.distortion.is_zero:  # the header's own way back, without iteration
        ideal = wcs.wcs_world2pix(np.degrees(np.stack([ra, dec], axis=1)), 0)
        u, v = (ideal - np.array([camera.cx, camera.cy])).T
        for axis, way in enumerate(("AP", "BP")):
            order = header[f"{way}_ORDER"]
            shift = sum(
                header.get(f"{way}_{p}_{q}", 0.0) * u**p * v**q for p in range(order + 1) for q in range(order + 1 - p)
            )
            assert np.abs(ideal[:, axis] + shift - xy[:, axis]).max() < 0.01


def test_the_tangent_point_is_the_boresight_and_up_is_the_roll():
    camera = CAMERAS["pinhole"]
    attitude = Attitude.from_radec_roll(85.0, 8.6, 40.0)
    wcs = WCS(Header(wcs_header(camera, attitude)))
    ra, dec = wcs.all_pix2world([[camera.cx, camera.cy]], 0)[0]
    assert (ra, dec) == pytest.approx((85.0, 8.6), abs=1e-10)
    ra_up, dec_up = np.radians(wcs.all_pix2world([[camera.cx, camera.cy - 1.0]], 0)[0])
    east = (ra_up - np.radians(85.0)) * np.cos(dec_up)
    north = dec_up - np.radians(8.6)
    assert np.degrees(np.arctan2(east, north)) == pytest.approx(40.0, abs=1e-2)


@pytest.mark.parametrize("fov_deg", [60.0, 80.0, 100.0])
def test_the_stated_error_is_what_astropy_finds(fov_deg):
    """Wide fields: the largest error over a dense grid is at most CSYER, and no less than a third of it."""
    camera = Camera.from_fov(fov_deg, 1500, 1000, Distortion(k1=-0.05 if fov_deg > 90 else -0.12))
    attitude = Attitude.from_radec_roll(85.0, 8.6, 33.0)
    header = wcs_header(camera, attitude)
    x, y = np.linspace(-0.5, 1499.5, 61), np.linspace(-0.5, 999.5, 41)
    xy = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    found = radec_to_direction(*np.radians(WCS(Header(header)).all_pix2world(xy, 0)).T)
    error = np.degrees(np.linalg.norm(found - attitude.inverse.apply(camera.unproject(xy)), axis=1)).max()
    # CSYER is in the distorted plane at the scale of the centre; towards the corners a pixel is a smaller angle
    assert error < 1.05 * header["CSYER1"] * np.sqrt(2.0)
    assert error > 0.2 * header["CSYER1"]
    assert header["CSYER1"] == header["CSYER2"]


@pytest.mark.parametrize(
    ("k1", "order", "exact"), [(-0.05, 7, True), (-0.08, 9, True), (-0.1, 9, False), (-0.12, 11, True)]
)
def test_the_order_is_the_lowest_that_is_good_enough(k1, order, exact):
    """The lowest order good to 0.002 px; from the ninth on, SIP's highest, 0.9″ are enough."""
    camera = Camera.from_fov(70.0, 1500, 1000, Distortion(k1=k1))
    header = wcs_header(camera, Attitude.from_radec_roll(85.0, 8.6, 33.0))
    assert header["A_ORDER"] == header["B_ORDER"] == order
    assert (np.radians(header["CSYER1"]) / camera.pixel_rad < 0.002) == exact
    assert 3600.0 * header["CSYER1"] < 0.9


def test_a_lens_that_no_polynomial_follows_is_refused():
    attitude = Attitude.from_radec_roll(85.0, 8.6, 33.0)
    with pytest.raises(InputError, match=r"error of a WCS .* px at order 13"):
        wcs_header(Camera.from_fov(90.0, 1920, 1080, Distortion(-0.25, 0.08, 0.0, 0.0, -0.01)), attitude)
    with pytest.raises(InputError, match="beyond the fold"):
        wcs_header(Camera.from_fov(80.0, 1000, 1000, Distortion(k1=-0.35)), attitude)


@pytest.mark.parametrize("name", ["off centre", "mirrored", "decentred", "off the image"])
def test_reversed_rows_have_the_same_world_coordinates(name):
    """The pixel (x, y) of a file from the top is (x, H − 1 − y) of one from the bottom, SIP's way back included."""
    camera, attitude = CAMERAS[name], Attitude.from_radec_roll(40.0, -30.0, 77.0)
    down, up = (wcs_header(camera, attitude, row_order=order) for order in ("TOP-DOWN", "BOTTOM-UP"))
    rng = np.random.default_rng(2)
    xy = rng.uniform(-0.5, [camera.width - 0.5, camera.height - 0.5], (100, 2))
    turned = np.column_stack([xy[:, 0], camera.height - 1.0 - xy[:, 1]])
    there = WCS(Header(down)).all_pix2world(xy, 0)
    found = radec_to_direction(*np.radians(WCS(Header(up)).all_pix2world(turned, 0)).T)
    assert np.linalg.norm(found - radec_to_direction(*np.radians(there).T), axis=1).max() < 1e-11
    if camera.distortion.is_zero:
        return
    u, v = (xy - np.array([camera.cx, camera.cy])).T
    for way, sign in (("A", 1.0), ("B", -1.0), ("AP", 1.0), ("BP", -1.0)):
        terms = [(p, q) for p in range(14) for q in range(14) if f"{way}_{p}_{q}" in down]
        assert {key for key in up if key.startswith(f"{way}_")} == {key for key in down if key.startswith(f"{way}_")}
        one = sum(down[f"{way}_{p}_{q}"] * u**p * v**q for p, q in terms)
        other = sum(up[f"{way}_{p}_{q}"] * u**p * (-v) ** q for p, q in terms)
        np.testing.assert_allclose(other, sign * one, rtol=1e-9, atol=1e-12)
        assert np.abs(one).max() > 0.1
