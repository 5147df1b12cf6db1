"""The WCS header against astropy's own reading of it (astropy.wcs, WCSLIB and its SIP; 7.0 and later).

Tolerance: 0.01 px and 1″ as asked of the header; TAN alone is exact, so 1e-6 px there. The SIP fit is good to 0.002 px
by construction.
"""

import numpy as np
import pytest
from astropy.io.fits import Header
from astropy.wcs import WCS

from startracker import Attitude, Camera, wcs_header
from startracker.attitude import direction_to_radec, radec_to_direction
from startracker.distortion import Distortion

CAMERAS = {
    "pinhole": Camera.from_fov(10.0, 512, 512),
    "off centre": Camera(900.0, 910.0, 200.0, 260.0, 512, 420),
    "mirrored": Camera(900.0, 910.0, 200.0, 260.0, 512, 420, parity=-1),
    "barrel": Camera.from_fov(20.0, 1024, 768, Distortion(k1=-0.2, k2=0.05)),
    "decentred": Camera(1500.0, 1500.0, 500.0, 390.0, 1024, 768, Distortion(k1=0.1, p1=0.003, p2=-0.002), -1),
    "wide": Camera.from_fov(50.0, 1024, 768, Distortion(k1=-0.15)),
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
