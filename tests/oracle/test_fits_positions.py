"""A rendered frame's FITS file as astropy reads it: positions of catalogue stars by the WCS, units, dates, truth.

The WCS was up to 0.07 px off while aberration was taken off at its centre alone: it also changes the scale, by up to
1e-4, and bends wide fields by up to 2.8″ at 30° from the centre.
"""

import math

import erfa
import numpy as np
import pytest
from astropy.io import fits
from astropy.nddata import CCDData
from astropy.table import Table
from astropy.time import Time
from astropy.wcs import WCS
from astropy.wcs.utils import proj_plane_pixel_scales

from simulator.fits import read_fits, write_fits
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from startracker import Attitude, Camera, wcs_header
from startracker.catalog import load_catalog
from startracker.geometry.attitude import direction_to_radec
from startracker.observer import aberrate

LENSES = {
    "cubesat_ideal": (),
    "ideal, 13 degrees": ("optics.distortion.k1=0",),
    "ideal, 60 degrees": ("optics.distortion.k1=0", "optics.focal_length_mm=4.9", "optics.aperture_mm=4"),
    "equidistant": ("optics.distortion.k1=0", "optics.projection=equidistant", "optics.focal_length_mm=9"),
}


def frame_of(*overrides, index=3):
    base = ("study.sampling=sky", "sky.magnitude_limit=7", "sky.planets=false")
    renderer = Renderer(Scenario.load("cubesat_ideal", [*base, *overrides]))
    return renderer.frame(index)


@pytest.mark.parametrize("lens", LENSES)
def test_catalogue_stars_fall_on_their_pixels(lens, tmp_path):
    frame, truth = frame_of(*LENSES[lens])
    path = tmp_path / "frame.fits"
    write_fits(path, frame, truth)
    with fits.open(path) as units:
        wcs = WCS(units[0].header)
        assert units[0].header["WCSNAME"] == "astrometric"
    catalog = load_catalog("hipparcos")
    inside = frame.camera.contains(truth.sources.xy)
    star = np.searchsorted(np.sort(catalog.id), truth.sources.id[inside])
    rows = np.argsort(catalog.id)[star]
    # parallax and the bending of light by the Sun belong to each star: below 0.05″, 0.001 px
    far = catalog.parallax_rad[rows] < np.radians(0.04 / 3600)
    ra, dec = direction_to_radec(catalog.directions(frame.observer.epoch_jyear)[rows[far]])
    found = wcs.all_world2pix(np.degrees(np.stack([ra, dec], axis=1)), 0, tolerance=1e-6)
    assert far.sum() > 30
    # the polynomials are good to 0.002 px, or left out where aberration bends less than that
    assert np.abs(found - truth.sources.xy[inside][far]).max() < 0.004
    table = Table.read(path, hdu="TRUTH")[inside][far]
    assert np.abs(np.degrees(ra) - table["ra"]).max() < 0.1 / 3600 / np.cos(dec).min()
    assert np.abs(np.degrees(dec) - table["dec"]).max() < 0.1 / 3600


@pytest.mark.parametrize("lens", LENSES)
def test_the_apparent_form_gives_directions_as_observed(lens, tmp_path):
    """Pixel to direction by astropy's WCS, against the truth: both forms in pixels at the truth's own positions."""
    frame, truth = frame_of(*LENSES[lens])
    inside = frame.camera.contains(truth.sources.xy)
    seen, xy = truth.sources.direction[inside], truth.sources.xy[inside]
    scale = 1.0 / frame.camera.pixel_rad
    found = {}
    for form in ("astrometric", "apparent"):
        path = tmp_path / f"{form}.fits"
        write_fits(path, frame, truth, wcs=form)
        with fits.open(path) as units:
            header = units[0].header
            assert header["WCSNAME"] == form
            assert {"astrometric": "removed", "apparent": "with aberration"}[form] in header.comments["WCSNAME"]
            ra, dec = np.radians(WCS(header).all_pix2world(xy, 0)).T
        found[form] = np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=1)
        table = Table.read(path, hdu="TRUTH")[inside]
    assert np.linalg.norm(found["apparent"] - seen, axis=1).max() * scale < 0.005
    ra, dec = np.radians(table["ra"]), np.radians(table["dec"])
    still = np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=1)
    assert np.linalg.norm(found["astrometric"] - still, axis=1).max() * scale < 0.005
    # between the forms is the aberration by ERFA, up to 26″ (to 0.01 px as both, 0.5″ at most)
    velocity = frame.observer.velocity_km_s / 299_792.458
    moved = erfa.ab(found["astrometric"], velocity, 1e6, math.sqrt(1.0 - velocity @ velocity))
    assert np.linalg.norm(moved - found["apparent"], axis=1).max() * scale < 0.01
    assert np.linalg.norm(found["astrometric"] - found["apparent"], axis=1).max() > np.radians(3.0 / 3600)


def test_cards_of_the_camera_give_the_scale_that_other_programs_compute(tmp_path):
    """206.265 × pixel size / focal length, arcseconds per pixel, is that of the WCS as astropy reads it."""
    frame, truth = frame_of("detector.pixel_pitch_um=[5.5, 6.25]")
    write_fits(tmp_path / "frame.fits", frame, truth)
    header = fits.getheader(tmp_path / "frame.fits")
    assert (header["XPIXSZ"], header["APTDIA"]) == (5.5, 17.8)
    assert header["YPIXSZ"] == pytest.approx(6.25, rel=1e-12)
    scale = [math.degrees(header[f"{axis}PIXSZ"] / 1000.0 / header["FOCALLEN"]) for axis in "XY"]
    # the WCS is astrometric: aberration changes its scale by up to v/c = 1e-4
    assert proj_plane_pixel_scales(WCS(header)) == pytest.approx(scale, rel=1.05e-4)
    write_fits(tmp_path / "again.fits", read_fits(tmp_path / "frame.fits"))
    assert "FOCALLEN" not in fits.getheader(tmp_path / "again.fits")


@pytest.mark.parametrize("velocity", [(30.0, 0.0, 0.0), (-10.0, 25.0, 15.0), (0.0, 0.0, 300.0)])
@pytest.mark.parametrize(
    "camera",
    [
        Camera.from_fov(5.0, 512, 512),
        Camera.from_fov(70.0, 1024, 768),
        Camera.from_fov(120.0, 1000, 800, projection="equidistant"),
        Camera.from_fov(120.0, 1000, 800, projection="equisolid"),
        Camera(900.0, 910.0, 200.0, 260.0, 512, 420, parity=-1),
    ],
)
def test_aberration_of_every_pixel(camera, velocity):
    attitude, velocity = Attitude.from_radec_roll(85.0, 48.6, 33.0), np.array(velocity)
    xy = np.random.default_rng(1).uniform(-0.5, [camera.width - 0.5, camera.height - 0.5], (400, 2))
    still = aberrate(attitude.inverse.apply(camera.unproject(xy)), -velocity)
    with np.errstate(invalid="ignore"):
        header = fits.Header(wcs_header(camera, attitude, velocity))
    position = np.degrees(np.stack(direction_to_radec(still), axis=1))
    found = WCS(header).all_world2pix(position, 0, tolerance=1e-6)
    assert np.abs(found - xy).max() < 0.004
    assert "WCSNAME" not in wcs_header(camera, attitude)


def test_a_rolling_shutter_says_where_stars_are_rendered(tmp_path):
    turn = ("detector.shutter=rolling", "detector.line_time_us=20", "detector.exposure_s=0.002")
    renderer = Renderer(Scenario.load("cubesat_ideal", ["study.sampling=sky", "sky.background=false", *turn]))
    frame, truth = renderer.frame(
        0, attitude=Attitude.from_radec_roll(84.0, 0.0, 10.0), rate_camera_rad_s=(0.0, 0.5, 0.0)
    )
    path = tmp_path / "frame.fits"
    write_fits(path, frame, truth)
    table = Table.read(path, hdu="TRUTH")
    assert [str(table[name].unit) for name in ("x_image", "electrons", "ra")] == ["pix", "ct", "deg"]
    order = np.argsort(-np.asarray(table["electrons"]))[:150]
    rows, columns = np.mgrid[-9:10, -9:10]
    checked, late = 0, []
    for k in order:
        x, y = table["x_image"][k], table["y_image"][k]
        alone = np.hypot(table["x_image"] - x, table["y_image"] - y) < 25.0
        if not (20 < x < 1003 and 20 < y < 1003) or alone.sum() > 1:
            continue
        i, j = round(x), round(y)
        light = truth.mean_electrons[j - 9 : j + 10, i - 9 : i + 10]
        centre = i + (light * columns).sum() / light.sum(), j + (light * rows).sum() / light.sum()
        assert centre == pytest.approx((x, y), abs=0.01)
        checked += 1
        late.append(np.hypot(table["x"][k] - x, table["y"][k] - y))
    assert checked > 5
    assert max(late) > 5.0  # what the position at mid-exposure is off


def test_dates_and_units(tmp_path):
    frame, truth = frame_of("detector.exposure_s=0.5")
    path = tmp_path / "frame.fits"
    write_fits(path, frame, truth, noiseless_plane=True)
    with fits.open(path) as units:
        header = units[0].header
        assert header["BUNIT"] == "adu"
        assert units["MEAN_E"].header["BUNIT"] == "electron"
        middle = Time(frame.utc, scale="utc")
        times = {name: Time(header[f"DATE-{name}"], scale="utc") for name in ("BEG", "OBS", "AVG", "END")}
        for name, offset_s in (("BEG", -0.25), ("OBS", 0.0), ("AVG", 0.0), ("END", 0.25)):
            assert (times[name] - middle).to_value("s") == pytest.approx(offset_s, abs=2e-6)
            assert header[f"MJD-{name}"] == pytest.approx(times[name].mjd, abs=1e-10)
        assert header["TIMESYS"] == "UTC"
    assert CCDData.read(path, hdu="MEAN_E").unit == "electron"
    assert CCDData.read(path).unit == "adu"
    assert read_fits(path).utc == frame.utc
