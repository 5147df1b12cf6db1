"""Every value of a frame and of its truth in a FITS file: written, named and read back; no frame is rendered."""

from dataclasses import fields, replace

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table

from simulator.fits import read_fits, write_fits
from simulator.frame import Frame, FrameTruth, TrueSources
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.geometry.distortion import Distortion
from startracker.observer import Observer

LENS = Distortion(k1=-0.011, k2=0.012, p1=0.0013, p2=-0.0014, k3=0.0015, k4=0.0016, k5=0.0017, k6=-0.0018)
CAMERA = Camera(1500.0, 1600.0, 14.5, 11.25, 32, 24, LENS, -1, "pinhole", 2.5e-5)
OBSERVER = Observer(2026.25, np.array([11.0, -22.0, 3.5]), np.array([0.5, -0.75, 0.125]))
PRIOR = Attitude.from_radec_roll(10.0, 20.0, 30.0)
PARAMETERS = {
    "detector.pixel_pitch_um": "5.5 6", "optics.aperture_mm": 17.8, "detector.adc_bits": 12, "sky.aberration": False,
}  # fmt: skip


def a_frame(**changes):
    image = np.arange(24 * 32, dtype=np.uint16).reshape(24, 32)
    given = Frame(
        image=image, camera=CAMERA, observer=OBSERVER, utc="2026-03-21T12:34:56.789012", exposure_s=0.125,
        saturation_dn=4000.0, gain_e_per_dn=7.25, offset_dn=96.0, read_noise_e=9.5, prior=PRIOR, prior_deg=1.5,
        scenario="a name", seed=77, index=12, parameters=PARAMETERS,
    )  # fmt: skip
    return replace(given, **changes)


def a_truth():
    directions = np.array([[1.0, 0.0, 0.0], [0.0, 0.6, 0.8]])
    sources = TrueSources(
        id=np.array([32349, 0]), name=np.array(["Alp CMa", "Mars"]), kind=np.array(["star", "planet"]),
        xy=np.array([[1.0, 2.0], [3.0, 4.0]]), image_xy=np.array([[1.25, 2.5], [3.75, 4.125]]), direction=directions,
        v_mag=np.array([-1.5, 0.5]), b_v=np.array([0.0, 1.375]), electrons=np.array([1e6, 2e5]),
        variable=np.array([True, False]),
    )  # fmt: skip
    return FrameTruth(
        attitude=Attitude.from_radec_roll(40.0, -50.0, 60.0),
        mounting=Attitude.from_rotation_vector([0.1, 0.2, 0.3], "body", "camera"),
        rate_camera_rad_s=np.array([0.001, -0.002, 0.003]),
        t_s=123.5,
        sources=sources,
        mean_electrons=np.full((24, 32), 2.5),
        time_tag_error_s=0.25,
    )


def test_a_frame_is_read_as_it_was_written(tmp_path):
    """Everything known on board; the scenario's keys stay in the header."""
    frame, path = a_frame(), tmp_path / "a.fits"
    write_fits(path, frame)
    found = read_fits(path)
    assert np.array_equal(found.image, frame.image)
    assert found.image.dtype.isnative
    assert found.camera == CAMERA
    for column in fields(Frame):
        if column.name not in ("image", "camera", "observer", "prior", "parameters"):
            assert getattr(found, column.name) == getattr(frame, column.name), column.name
    assert found.observer.epoch_jyear == OBSERVER.epoch_jyear
    assert found.observer.velocity_km_s.tolist() == OBSERVER.velocity_km_s.tolist()
    assert found.observer.position_au.tolist() == OBSERVER.position_au.tolist()
    assert found.prior.quat.tolist() == PRIOR.quat.tolist()
    with fits.open(path) as units:
        header = units[0].header
        assert len(units) == 1
        assert {name: header[name] for name in PARAMETERS} == PARAMETERS


def test_what_is_not_known_is_not_written(tmp_path):
    path = tmp_path / "a.fits"
    bare = a_frame(observer=Observer(2026.25), prior=None, prior_deg=0.0, parameters={})
    write_fits(path, bare)
    found = read_fits(path)
    assert found.prior is None
    assert found.prior_deg == 0.0
    assert found.observer.velocity_km_s is None
    assert found.observer.position_au is None
    header = fits.getheader(path)
    for key in ("OBS_VX", "OBS_PX", "PRI_QX", "PRI_DEG", "FOCALLEN", "APTDIA", "XPIXSZ", "YPIXSZ", "ATT_RA"):
        assert key not in header, key


def test_cards_of_the_lens_are_millimetres(tmp_path):
    """1,500 px of 5.5 µm are 8.25 mm; rows of 1,600 px for the same focal length are 5.15625 µm high."""
    write_fits(tmp_path / "a.fits", a_frame())
    header = fits.getheader(tmp_path / "a.fits")
    assert header["FOCALLEN"] == pytest.approx(8.25, rel=1e-12)
    assert header["APTDIA"] == 17.8
    assert header["XPIXSZ"] == 5.5
    assert header["YPIXSZ"] == pytest.approx(5.15625, rel=1e-12)
    assert (header["ROWORDER"], header["BUNIT"], header["TIMESYS"]) == ("TOP-DOWN", "adu", "UTC")


def test_the_exposure_across_a_leap_second_has_its_length(tmp_path):
    """Half a second before and after the end of 2016, which had a 61st second."""
    write_fits(tmp_path / "a.fits", a_frame(utc="2016-12-31T23:59:60.500", exposure_s=2.0))
    header = fits.getheader(tmp_path / "a.fits")
    assert header["DATE-BEG"] == "2016-12-31T23:59:59.500000"
    assert header["DATE-OBS"] == header["DATE-AVG"] == "2016-12-31T23:59:60.500"
    assert header["DATE-END"] == "2017-01-01T00:00:00.500000"


def test_the_truth_is_a_table_of_sources_with_attitude_and_motion(tmp_path):
    truth, path = a_truth(), tmp_path / "a.fits"
    write_fits(path, a_frame(), truth, noiseless_plane=True)
    table, sources = Table.read(path, hdu="TRUTH"), truth.sources
    expected = {
        "id": sources.id, "v_mag": sources.v_mag, "b_v": sources.b_v, "electrons": sources.electrons,
        "variable": sources.variable, "x": sources.xy[:, 0], "y": sources.xy[:, 1],
        "x_image": sources.image_xy[:, 0], "y_image": sources.image_xy[:, 1], "direction": sources.direction,
    }  # fmt: skip
    for name, values in expected.items():
        assert np.array_equal(np.asarray(table[name]), values), name
    assert [str(name).strip() for name in table["name"]] == ["Alp CMa", "Mars"]
    assert [str(kind).strip() for kind in table["kind"]] == ["star", "planet"]
    # the scenario has no aberration, so directions are astrometric already
    assert np.asarray(table["ra"]) == pytest.approx([0.0, 90.0], abs=1e-9)
    assert np.asarray(table["dec"]) == pytest.approx([0.0, np.degrees(np.arctan2(0.8, 0.6))], abs=1e-9)
    header = fits.getheader(path, "TRUTH")
    assert [header[f"ATT_Q{axis}"] for axis in "XYZW"] == pytest.approx(truth.attitude.quat, abs=1e-15)
    assert [header[f"MNT_Q{axis}"] for axis in "XYZW"] == pytest.approx(truth.mounting.quat, abs=1e-15)
    assert [header[f"ATT_{name}"] for name in ("RA", "DEC", "ROLL")] == pytest.approx([40.0, -50.0, 60.0])
    assert [header[f"RATE_{axis}"] for axis in "XYZ"] == [0.001, -0.002, 0.003]
    assert (header["T_S"], header["TAG_ERR"]) == (123.5, 0.25)
    assert np.array_equal(fits.getdata(path, "MEAN_E"), truth.mean_electrons)
    assert str(table["electrons"].unit) == "ct"
    assert [str(table[name].unit) for name in ("x", "ra", "v_mag")] == ["pix", "deg", "mag"]


def test_astrometric_places_are_those_without_the_aberration_of_the_observer(tmp_path):
    """Moving at 30 km/s at right angles to a star: it is seen arctan(v/c) = 20.64″ ahead of where it is."""
    moving = Observer(2026.25, np.array([0.0, 30.0, 0.0]), None)
    truth = a_truth()
    write_fits(tmp_path / "a.fits", a_frame(observer=moving, parameters={}), truth)
    table = Table.read(tmp_path / "a.fits", hdu="TRUTH")
    assert (360.0 - table["ra"][0]) * 3600.0 == pytest.approx(np.degrees(30.0 / 299_792.458) * 3600.0, rel=1e-6)
    write_fits(tmp_path / "b.fits", a_frame(observer=moving, parameters={"sky.aberration": False}), truth)
    assert Table.read(tmp_path / "b.fits", hdu="TRUTH")["ra"][0] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("wanted", [False, True])
def test_extensions_are_those_asked_for(wanted, tmp_path):
    path = tmp_path / "a.fits"
    write_fits(path, a_frame(), a_truth(), noiseless_plane=wanted)
    with fits.open(path) as units:
        assert [unit.name for unit in units][1:] == ["TRUTH", "MEAN_E"][: 1 + wanted]
    write_fits(path, a_frame(), replace(a_truth(), mean_electrons=None, time_tag_error_s=0.0), noiseless_plane=True)
    with fits.open(path) as units:
        assert [unit.name for unit in units][1:] == ["TRUTH"]
        assert "TAG_ERR" not in units["TRUTH"].header


@pytest.mark.parametrize(
    ("card", "value", "words"),
    [
        ("GAIN", 0.0, "GAIN in its header cannot be 0"),
        ("RDNOISE", -1.0, "RDNOISE in its header cannot be -1"),
        ("EXPTIME", -0.1, "EXPTIME in its header cannot be -0.1"),
        ("PRI_DEG", 0.0, "PRI_DEG in its header cannot be 0"),
        ("PRI_DEG", 181.0, "PRI_DEG in its header cannot be 181"),
        ("JEPOCH", 3001.0, "JEPOCH in its header cannot be 3001"),
        ("CAM_ROW", -1e-6, "CAM_ROW in its header cannot be -1e-06"),
        ("SEED", "x", "SEED in its header must be a number, not 'x'"),
        ("SATURATE", True, "SATURATE in its header must be a number, not True"),
        ("CAM_PROJ", 3, "CAM_PROJ in its header must be a text, not 3"),
        ("CAM_K8", None, None),
    ],
)
def test_values_that_cannot_be_are_named(card, value, words, tmp_path):
    path = tmp_path / "a.fits"
    write_fits(path, a_frame())
    with fits.open(path) as units:
        header, image = units[0].header.copy(), units[0].data.copy()
    for key in ("CHECKSUM", "DATASUM"):
        del header[key]
    if value is not None:
        header[card] = value
    fits.PrimaryHDU(image, header).writeto(path, overwrite=True)
    if words is None:
        assert read_fits(path).camera == CAMERA
        return
    with pytest.raises(InputError, match=words) as caught:
        read_fits(path)
    assert str(caught.value).count(str(path)) == 1


def test_rows_from_the_bottom_are_turned_over(tmp_path):
    path = tmp_path / "a.fits"
    write_fits(path, a_frame())
    with fits.open(path) as units:
        header, image = units[0].header.copy(), units[0].data.copy()
    for key in ("CHECKSUM", "DATASUM"):
        del header[key]
    header["ROWORDER"] = "BOTTOM-UP"
    fits.PrimaryHDU(image[::-1], header).writeto(path, overwrite=True)
    assert np.array_equal(read_fits(path).image, a_frame().image)
