"""Unphysical and impossible scenarios: refused with the reason, and let pass only where that can make sense."""

# ruff: noqa: E501, ISC004 - messages stand as they are printed
import pytest

from simulator.mission.secular import sun_synchronous_limit_km
from simulator.scenario import Scenario, ScenarioError

GOOD = """\
name: demo
epoch: 2026-03-21T12:00:00Z
optics: {focal_length_mm: 50, aperture_mm: 25}
detector: {width: 512, height: 512, pixel_pitch_um: 10, exposure_s: 0.1}
"""

UNPHYSICAL = [
    (
        ["optics.aperture_mm=125"],
        "optics.aperture_mm: 125 mm at a focal length of 50 mm is f/0.4, but no lens in air is faster than f/0.5; "
        "use at most 100 mm",
    ),
    (
        ["detector.full_well_e=10", "detector.read_noise_e=20"],
        "detector.full_well_e: 10 e⁻ is less than the read noise of 20 e⁻; no signal could be detected",
    ),
    (["orbit.altitude_km=-5"], "orbit.altitude_km: -5 km is inside the Earth; use 150 km or more"),
    (
        ["orbit.altitude_km=100"],
        "orbit.altitude_km: 100 km is within the atmosphere, where orbits decay; use 150 km or more",
    ),
    (
        ["detector.pixel_pitch_um=[0.3, 10]"],
        "detector.pixel_pitch_um: 0.3 µm is less than a wavelength of light; use 0.4 µm or more",
    ),
    (
        ["optics.focal_length_mm=0.2", "optics.aperture_mm=0.1"],
        "optics.focal_length_mm: 0.2 mm with a detector of 7.24 mm diagonal has a field of 173.7°, more than the "
        "170° of a pinhole; use a longer focal length",
    ),
    (
        ["optics.focal_length_mm=500", "optics.psf.sigma_px=0.3"],
        "optics.psf.sigma_px: 0.3 px is narrower than the diffraction limit at f/20 and 600 nm; use 0.504 px or more",
    ),
    (
        ["optics.focal_length_mm=500", "optics.psf.first_dark_ring_px=1"],
        "optics.psf.first_dark_ring_px: 1 px is narrower than the diffraction limit at f/20 and 600 nm; use 1.46 px or more",
    ),
    (
        ["detector.temperature_c=200"],
        "detector.temperature_c: no silicon detector works at 200 °C; use -230 to 150 °C",
    ),
    (
        ["detector.dark_current_e_s=1e6"],
        "detector.exposure_s: in 0.1 s at 20 °C the dark current alone generates 6.48e+04 e⁻ and fills the well of "
        "30000 e⁻; shorten the exposure or cool the detector",
    ),
    (
        ["detector.exposure_s=7000"],
        "detector.exposure_s: 7000 s is longer than the orbit of 6052 s; use a shorter exposure",
    ),
    (
        ["detector.gain_e_per_dn=0.001", "detector.read_noise_e=12"],
        "detector.gain_e_per_dn: 0.001 e⁻/DN limits the range of the converter to 4.09 e⁻, below the read noise of 12 e⁻; "
        "increase it or adc_bits",
    ),
    (
        ["detector.gain_e_per_dn=50000"],
        "detector.gain_e_per_dn: 50000 e⁻/DN gives less than one DN for a full well of 30000 e⁻; decrease it",
    ),
]

IMPOSSIBLE = [
    (
        ["orbit.ltan_h=6", "orbit.raan_deg=10"],
        "--set orbit.raan_deg: the node is already defined by orbit.ltan_h; set one of them to null",
    ),
    (
        ["orbit.altitude_km=7000"],
        "--set orbit.altitude_km: orbit.inclination_deg: no orbit at 7000 km is sun-synchronous, only up to 5974 km; give the inclination "
        "in degrees",
    ),
    (
        ["orbit.altitude_km=-7000"],
        "--set orbit.altitude_km: -7000 km is below the Earth's centre; use 150 km or more",
    ),
    (
        ["orbit.altitude_km=-5", "orbit.propagator=sgp4"],
        "--set orbit.altitude_km: -5 km is inside the Earth; use 150 km or more (not supported by sgp4)",
    ),
    (
        ["epoch=2053-01-01"],
        "--set epoch: 2053-01-01 is outside the ephemeris DE421; use 1899-07-30 to 2052-10-07",
    ),
    (
        ["pointing.mounting=[0, 0, 0, 0]"],
        "--set pointing.mounting: a quaternion of zeros is not a rotation; use [0, 0, 0, 1] for no rotation",
    ),
    (
        ["optics.psf={model: airy, sigma_px: 1}"],
        "--set optics.psf: optics.psf.sigma_px: model: airy does not use sigma_px; "
        "use first_dark_ring_px, or model: gaussian",
    ),
    (
        ["optics.psf.sigma_px=1", "optics.psf.first_dark_ring_px=2"],
        "--set optics.psf.sigma_px: the width is already defined by first_dark_ring_px; set one of them to null",
    ),
    (
        ["detector.offset_dn=5000"],
        "--set detector.offset_dn: 5000 DN uses the full range of the converter, 4095 DN (12 bits); "
        "decrease it or increase adc_bits",
    ),
    (
        ["tracker.magnitude_limit=-3"],
        "--set tracker.magnitude_limit: no star is brighter than V = -3 (Sirius: −1.46); 6.5 is usual",
    ),
    (
        ["tracker.centroid.window_px=4"],
        "--set tracker.centroid.window_px: must be odd, so that a pixel is at the centre, not 4; use 3 or 5",
    ),
    (
        [
            "tracker.identifier=pyramid",
            "tracker.identification.min_stars=9",
            "tracker.identification.max_stars=8",
        ],
        "--set tracker.identification.max_stars: 8 is less than tracker.identification.min_stars (9)",
    ),
    (
        ["tracker.detection.max_pixels=2"],
        "--set tracker.detection.max_pixels: 2 is less than tracker.detection.min_pixels (3)",
    ),
    (
        ["tracker.detection.max_stars=2"],
        "--set tracker.detection.max_stars: 2 is less than tracker.identification.min_stars (3)",
    ),
]


def told(overrides):
    with pytest.raises(ScenarioError) as caught:
        Scenario.parse(GOOD, overrides, name="x.yaml")
    return str(caught.value).splitlines()


@pytest.mark.parametrize(("overrides", "reason"), UNPHYSICAL, ids=lambda v: v[0] if isinstance(v, list) else "")
def test_unphysical_is_refused_unless_allowed(overrides, reason):
    key, message = reason.split(": ", 1)
    (line,) = told(overrides)
    assert line.endswith(f"{message}; or set allow_unphysical: true")
    assert key in line
    assert Scenario.parse(GOOD, [*overrides, "allow_unphysical=true"]).unphysical == (reason,)


@pytest.mark.parametrize(("overrides", "line"), IMPOSSIBLE, ids=lambda v: v[0] if isinstance(v, list) else "")
def test_impossible_is_refused_always(overrides, line):
    assert told(overrides) == [line]
    assert told([*overrides, "allow_unphysical=true"]) == [line]


def test_the_line_is_that_of_the_key():
    with pytest.raises(ScenarioError, match=r"^x\.yaml:3:31: optics\.aperture_mm: 125 mm"):
        Scenario.parse(GOOD.replace("aperture_mm: 25", "aperture_mm: 125"), name="x.yaml")


def test_a_physical_scenario_has_nothing_to_report_even_where_all_is_allowed():
    assert Scenario.parse(GOOD + "allow_unphysical: true\n").unphysical == ()


def test_limit_of_sun_synchronous_orbits():
    # The well-known ceiling (i = 180°) is printed rounded, as 5,975 km; with J2 = 1.0826e-3 and R = 6378 km it moves 0.3 km.
    assert sun_synchronous_limit_km() == pytest.approx(5975.0, abs=1.5)


@pytest.mark.parametrize(
    "override",
    ["optics.aperture_mm=100", "orbit.altitude_km=150", "detector.pixel_pitch_um=0.4", "detector.offset_dn=4094"],
)
def test_just_within_the_limits(override):
    Scenario.parse(GOOD, [override])
