"""The undistorted camera and its attitude against astropy's TAN world coordinates (astropy 8.0, WCSLIB).

A gnomonic projection about the boresight is what a pinhole makes (Calabretta & Greisen 2002, A&A 395, 1077). The CD
matrix is written down here from the roll alone: with up = N cos ψ + E sin ψ and x = −up × boresight,

    east  = −(cos ψ · dx + sin ψ · dy) / f,   north = (sin ψ · dx − cos ψ · dy) / f

Tolerance: WCSLIB goes through degrees and native spherical angles, rounded to 1e-13 rad beside the boresight and to
1e-16/sin θ at it; 1e-8 px is that times 5e3 px with a margin of ten.
"""

import numpy as np
import pytest
from astropy.wcs import WCS

from startracker.geometry.attitude import Attitude, radec_to_direction
from startracker.geometry.camera import Camera


def tan_wcs(camera, ra_deg, dec_deg, roll_deg):
    psi = np.radians(roll_deg)
    scale = np.degrees([camera.parity / camera.fx, 1 / camera.fy])
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = ["RA---TAN", "DEC--TAN"]
    wcs.wcs.crval = [ra_deg, dec_deg]
    wcs.wcs.crpix = [camera.cx + 1, camera.cy + 1]  # FITS counts from 1
    wcs.wcs.cd = np.array([[-np.cos(psi), -np.sin(psi)], [np.sin(psi), -np.cos(psi)]]) * scale
    wcs.wcs.lonpole = 180.0  # its default at a pole, 0, would turn the image over
    wcs.wcs.set()
    return wcs


@pytest.mark.parametrize("parity", [1, -1])
@pytest.mark.parametrize(
    ("ra_deg", "dec_deg", "roll_deg"),
    [
        (0.0, 0.0, 0.0),
        (83.6, 22.0, 37.0),
        (359.999, -45.0, 180.0),
        (120.0, 89.5, 300.0),
        (10.0, -90.0, 12.0),
        (200.0, 90.0, 90.0),
    ],
)
def test_pixels_and_sky(ra_deg, dec_deg, roll_deg, parity):
    camera = Camera(4200.0, 4000.0, 700.3, 480.9, 1400, 1000, parity=parity)
    attitude = Attitude.from_radec_roll(ra_deg, dec_deg, roll_deg)
    wcs = tan_wcs(camera, ra_deg, dec_deg, roll_deg)
    pixels = np.random.default_rng(11).uniform([-0.5, -0.5], [1399.5, 999.5], (200, 2))

    ra, dec = wcs.wcs_pix2world(pixels, 0).T
    sky = radec_to_direction(np.radians(ra), np.radians(dec))
    np.testing.assert_allclose(camera.project(attitude.apply(sky)), pixels, rtol=0, atol=1e-8)

    ours = attitude.inverse.apply(camera.unproject(pixels))
    np.testing.assert_allclose(ours, sky, rtol=0, atol=1e-8 / 4000)
