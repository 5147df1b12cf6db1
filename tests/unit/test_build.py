"""From scenario to physics: defaults agree, the exposure is not a part of the device, and the Earth has its key."""

import math
from dataclasses import MISSING, fields, replace

import erfa
import numpy as np
import pytest
from scipy import constants as scipy_constants

from simulator import Renderer, Scenario, build, constants
from simulator.build import (
    aged_detector,
    build_camera,
    build_detector,
    build_focal_plane,
    build_scenes,
    detector_parameters,
    shutter_of,
)
from simulator.detector.parameters import DetectorParameters, DisplacementDamage, RandomTelegraph
from simulator.environment.damage import Pixel, damage
from simulator.environment.dose import Dose
from simulator.environment.parameters import Environment
from simulator.exposure import Exposure, Shutter
from simulator.frame import FrameTruth, TrueSources
from simulator.light import near_image, path_middles
from simulator.randomness import seed_of, stream
from simulator.renderer import flat_parameters
from simulator.scenario.schema import DetectorSection
from simulator.units import UNITS, unit_suffix
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude

SMALL = ["detector.width=128", "detector.height=96", "study.trials=1"]


def test_defaults_are_those_of_the_schema():
    for column in fields(DetectorParameters):
        if column.default is not MISSING:
            assert column.default == DetectorSection.model_fields[column.name].default, column.name


def test_parameters_are_those_of_the_scenario():
    scenario = Scenario.load("tc211", ["detector.cosmic_rays.rate_cm2_s=3", "detector.video.noise_dn=2"])
    device = detector_parameters(scenario.detector)
    assert all(getattr(device, column.name) == getattr(scenario.detector, column.name) for column in fields(device))
    assert shutter_of(scenario.detector).kind == scenario.detector.shutter


def test_an_exposure_asked_for_is_that_of_the_scenario():
    """The frame of another exposure is, to the byte, that of a scenario with this exposure; nothing is built anew."""
    keys = [
        *SMALL,
        "detector.shutter=rolling",
        "detector.cosmic_rays.rate_cm2_s=500",
        "pointing.jitter.rms_arcsec=[9,9,9]",
    ]
    asked, truth = Renderer(Scenario.load("cubesat_ideal", keys)).frame(3, exposure_s=0.3)
    alone, other = Renderer(Scenario.load("cubesat_ideal", [*keys, "detector.exposure_s=0.3"])).frame(3)
    assert np.array_equal(asked.image, alone.image)
    assert np.array_equal(truth.mean_electrons, other.mean_electrons)
    assert (asked.exposure_s, asked.parameters) == (alone.exposure_s, alone.parameters)


def test_still_light_grows_with_the_exposure():
    renderer = Renderer(Scenario.load("cubesat_ideal", [*SMALL, "sky.magnitude_limit=-2", "sky.planets=false"]))
    scene = renderer.scene(0)
    rate_e_s, _ = renderer.focal_plane.background_rate_e_s(scene)
    for exposure_s in (0.1, 0.4):
        np.testing.assert_allclose(renderer.expose(scene, exposure_s).mean_e, exposure_s * rate_e_s, rtol=1e-14)


def test_the_earth_may_be_in_the_way_of_random_attitudes():
    """Over the whole sky the Earth hides (1 − cos ρ)/2 = 27 % of directions from 800 km: with it some frames lose
    stars, without it, the default, none does."""
    base = [*SMALL, "study.sampling=sky", "orbit.altitude_km=800", "pointing.error_deg=0"]
    assert Scenario.load("cubesat_ideal", base).study.sky_without_earth
    without = Renderer(Scenario.load("cubesat_ideal", base))
    with_earth = Renderer(Scenario.load("cubesat_ideal", [*base, "study.sky_without_earth=false"]))
    stars = np.array([[len(r.expose(r.scene(k)).sources) for k in range(60)] for r in (without, with_earth)])
    hidden = np.mean(stars[1] < stars[0])
    assert 0.27 - 0.17 < hidden < 0.27 + 0.25  # 3 σ of 60 trials, and fields that the limb crosses
    assert np.all(stars[1] <= stars[0])


def test_a_camera_is_its_lens_over_its_pitch():
    keys = ["detector.pixel_pitch_um=[5, 8]", "detector.width=200", "detector.height=101", "optics.focal_length_mm=20"]
    keys += ["optics.principal_point_offset_px=[3, -4]", "detector.line_time_us=30"]
    camera = build_camera(Scenario.load("cubesat_ideal", keys))
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (4000.0, 2500.0, 102.5, 46.0)
    assert (camera.width, camera.height, camera.row_time_s) == (200, 101, 0.0)  # the shutter is global
    rolling = Scenario.load("cubesat_ideal", [*keys, "detector.shutter=rolling"])
    assert build_camera(rolling).row_time_s == pytest.approx(3e-5)
    # the time of a scene covers all rows, and images of 512 px before the first and after the last
    assert build_scenes(rolling).parameters.exposure_margin_s == pytest.approx((101 + 1024) * 3e-5)
    assert build_scenes(Scenario.load("cubesat_ideal", keys)).parameters.exposure_margin_s == 0.0


def test_a_focal_plane_has_the_areas_of_its_aperture_and_its_pixels():
    keys = ["detector.pixel_pitch_um=[5, 8]", "optics.aperture_mm=20", "optics.obscuration=0.5", *SMALL]
    plane = build_focal_plane(Scenario.load("cubesat_ideal", keys))
    assert plane.photometer.aperture_area_cm2 == pytest.approx(math.pi * 1.0 * 0.75, rel=1e-12)
    assert plane.pixel_area_cm2 == pytest.approx(40e-8, rel=1e-12)
    assert plane.aperture_mm == 20.0
    assert plane.displacement.is_off
    assert plane.faint_sky is None
    assert plane.baffle is None
    assert plane.camera is plane.true_camera


@pytest.mark.parametrize(("limit", "faint", "there"), [(9, "null", False), (9, 9, False), (8, 9.5, True)])
def test_faint_stars_are_fainter_than_those_of_the_catalogue(limit, faint, there):
    keys = [*SMALL, f"sky.magnitude_limit={limit}", f"sky.faint_magnitude_limit={faint}"]
    found = build_focal_plane(Scenario.load("cubesat_ideal", keys)).faint_sky
    assert (found is not None) is there
    if found is not None:
        assert (found.brightest, found.faintest) == (8.0, 9.5)


def test_the_lens_is_warmer_by_the_temperature_over_that_of_its_calibration():
    """A swing of 3 K about a mean 10 K above the calibration: at a quarter of the period 13 K."""
    keys = ["optics.thermal.temperature_c=32", "optics.thermal.reference_c=22", "optics.thermal.expansion_ppm_k=20"]
    keys += ["optics.thermal.decentring_um_k=[0.1, -0.2]", "detector.pixel_pitch_um=[5, 8]"]
    keys += ["optics.thermal.swing_k=3", "optics.thermal.swing_period_s=1000", *SMALL]
    scenario = Scenario.load("cubesat_ideal", keys)
    plane, calibrated = build_focal_plane(scenario), build_camera(scenario)
    for t_s, kelvin in ((0.0, 10.0), (250.0, 13.0), (500.0, 10.0), (750.0, 7.0)):
        now = plane.at(t_s)
        assert now.true_camera.fx == pytest.approx(calibrated.fx * (1.0 + 20e-6 * kelvin), rel=1e-12)
        assert now.true_camera.fy == pytest.approx(calibrated.fy * (1.0 + 20e-6 * kelvin), rel=1e-12)
        assert now.true_camera.cx - calibrated.cx == pytest.approx(0.02 * kelvin, abs=1e-9)
        assert now.true_camera.cy - calibrated.cy == pytest.approx(-0.025 * kelvin, abs=1e-9)
        assert now.displacement.camera == now.true_camera
        assert now.camera == calibrated
    constant = build_focal_plane(scenario.changed({"optics.thermal.swing_k": 0.0}))
    assert constant.at(250.0) is constant


@pytest.mark.parametrize(
    ("keys", "earth"),
    [
        (["study.sampling=sky"], False),
        (["study.sampling=sky", "study.sky_without_earth=false"], True),
        (["study.sampling=sky", "pointing.target=[10, 20, 0]"], True),
        (["study.sampling=orbit"], True),
        (["study.sampling=orbit", "sky.earth=false"], False),
    ],
)
def test_the_earth_is_left_out_of_random_attitudes_only(keys, earth):
    assert build_focal_plane(Scenario.load("cubesat_ideal", [*SMALL, *keys])).sky.earth is earth


def test_damage_is_added_to_the_defects_of_the_new_device():
    """Two populations of displacement defects become one with the sum of their currents."""
    device = detector_parameters(Scenario.load("tc211", SMALL).detector)
    new = replace(
        device, displacement=DisplacementDamage(0.5, 100.0), dark_current_e_s=7.0, cti_parallel=1e-5, cti_serial=2e-5
    )
    inner = Dose(1.0, 0.0, 0.0, 2e6)
    aged = damage(inner, inner, Pixel(100.0, 25.0, True), Environment(age_years=1.0, dark_per_krad_e_s=3.0))
    found = build._with_damage(new, aged)
    total = 0.5 + aged.displacement.interactions_per_pixel
    assert found.displacement.interactions_per_pixel == pytest.approx(total, rel=1e-12)
    assert found.displacement.mean_e_s == pytest.approx(50.0 + aged.displacement.mean_e_s, rel=1e-12)
    assert found.dark_current_e_s == pytest.approx(10.0)
    assert found.cti_parallel == pytest.approx(1e-5 + aged.cti_parallel)
    assert found.cti_serial == pytest.approx(2e-5 + aged.cti_serial)
    assert found.telegraph == aged.telegraph
    own = RandomTelegraph(pixel_fraction=0.01, dark_e_s=50.0)
    assert build._with_damage(replace(new, telegraph=own), aged).telegraph == own
    none = damage(*[Dose(0.0, 0.0, 0.0, 0.0)] * 2, Pixel(100.0, 25.0, True), Environment(age_years=1.0))
    assert build._with_damage(replace(new, displacement=DisplacementDamage()), none).displacement.mean_e_s == 0.0


def test_particles_of_the_environment_turn_on_cosmic_rays():
    keys = [*SMALL, "detector.cosmic_rays.rate_cm2_s=7", "detector.cosmic_rays.depth_um=12"]
    rays = aged_detector(Scenario.load("cubesat_ideal", [*keys, "environment.galactic=true"])).cosmic_rays
    assert rays.rate_cm2_s > 0.0
    assert rays.depth_um == 12.0
    assert aged_detector(Scenario.load("cubesat_ideal", keys)).cosmic_rays.rate_cm2_s == 7.0


@pytest.mark.parametrize("corner", ["top_left", "top_right", "bottom_left", "bottom_right"])
def test_charge_is_transferred_towards_the_corner_of_the_readout(corner):
    keys = ["detector.kind=ccd_frame_transfer", "detector.shutter=frame_transfer", f"detector.readout_corner={corner}"]
    keys += ["detector.line_time_us=4", "detector.transfer_smear=after"]
    shutter = shutter_of(Scenario.load("cubesat_ideal", [*SMALL, *keys]).detector)
    assert shutter == Shutter("frame_transfer", pytest.approx(4e-6), "up" if "top" in corner else "down", "after")


def test_another_camera_of_the_seed_has_other_pixels_and_another_calibration():
    scenario = Scenario.load("cubesat_ideal", [*SMALL, "detector.prnu=0.01", "optics.calibration_residual.rms_px=0.1"])
    own, same, other = (build_detector(scenario, seed).pattern.prnu for seed in (None, scenario.seed, 99))
    assert np.array_equal(own, same)
    assert not np.array_equal(own, other)
    assert own.dtype == np.float32
    own, same, other = (build_focal_plane(scenario, seed).displacement.residual for seed in (None, scenario.seed, 99))
    assert np.array_equal(own, same)
    assert not np.array_equal(own, other)


# ---------------------------------------------------------------- exposure and light
def test_an_exposure_is_about_its_middle():
    exposure = Exposure.about(100.0, 0.5, Shutter())
    assert (exposure.start_s, exposure.middle_s, exposure.duration_s) == (99.75, 100.0, 0.5)
    assert exposure.electrons(np.array([4.0, 6.0])).tolist() == [2.0, 3.0]
    image = np.ones((4, 3))
    exposure.add_transfer_smear(image)
    assert np.array_equal(image, np.ones((4, 3)))


def test_sources_near_the_image_are_those_within_their_extent():
    xy = np.array(
        [[-5.0, 5.0], [-5.1, 5.0], [25.0, 5.0], [25.1, 5.0], [5.0, -5.0], [5.0, 15.1], [5.0, 15.0], [np.nan, 5.0]]
    )
    assert near_image(xy, np.full(8, 5.0), 20, 10).tolist() == [0, 2, 4, 6]


def test_the_middle_of_a_path_is_its_weighted_mean_over_the_moments_that_are_known():
    nan = np.nan
    paths = np.array(
        [[[0.0, 0.0], [4.0, 8.0]], [[nan, nan], [4.0, 8.0]], [[nan, nan], [nan, nan]], [[1.0, nan], [3.0, 5.0]]]
    )
    weights, otherwise = np.array([0.75, 0.25]), np.full((4, 2), 9.0)
    assert path_middles(paths, weights, otherwise).tolist() == [[1.0, 2.0], [4.0, 8.0], [9.0, 9.0], [3.0, 5.0]]
    assert path_middles(paths[:1], 2.0 * weights, otherwise[:1]).tolist() == [[1.0, 2.0]]


def test_an_attitude_at_a_stated_time_is_ahead_by_the_turn_in_its_error():
    """0.25 s late at 8 mrad/s about y: 2 mrad."""
    sources = TrueSources(*[np.zeros(0)] * 10)
    still = Attitude.from_radec_roll(10.0, 20.0, 30.0)
    truth = FrameTruth(still, still, np.array([0.0, 8e-3, 0.0]), 0.0, sources, time_tag_error_s=0.25)
    assert still.rotation_vector_to(truth.attitude_at_tag) == pytest.approx([0.0, 2e-3, 0.0], abs=1e-15)
    assert replace(truth, time_tag_error_s=0.0).attitude_at_tag is still


# ---------------------------------------------------------------- units and streams
def test_units_are_those_of_astropy():
    from astropy import units

    for ending, unit in UNITS.items():
        assert unit.words
        if unit.astropy is not None:
            units.Unit(unit.astropy)
        assert unit_suffix(f"a_{ending}") == ending
    found = [
        unit_suffix(name) for name in ("rate_deg_s", "rate_deg", "deg_s", "s", "exposure_s", "n", "rate_", "a_b_km")
    ]
    assert found == ["deg_s", "deg", "s", "", "s", "", "", "km"]


def test_seeds_of_named_objects_differ_and_fit_a_signed_integer():
    seeds = {seed_of(seed, stage, name) for seed in (1, 2) for stage in ("a", "b") for name in ("x", "y")}
    assert len(seeds) == 8
    assert all(0 <= seed < 2**63 for seed in seeds)
    assert seed_of(1, "a", "x") == seed_of(1, "a", "x")
    assert any(seed > 2**61 for seed in (seed_of(k, "a", "x") for k in range(20)))


@pytest.mark.parametrize(("seed", "trial"), [(-1, 0), (1, -2)])
def test_streams_need_a_seed_and_a_trial(seed, trial):
    with pytest.raises(ValueError, match="a stream needs a seed from 0 and a trial from -1 up"):
        stream(seed, "a", trial)
    assert stream(0, "a", -1).random() != stream(0, "a", 0).random()


# ---------------------------------------------------------------- renderers
TINY = ["detector.width=64", "detector.height=48", "sky.magnitude_limit=4", "optics.focal_length_mm=6"]
TINY += ["optics.aperture_mm=4", "detector.line_time_us=20", "detector.prnu=0.01"]


@pytest.fixture(scope="module")
def tiny():
    return Renderer(Scenario.load("cubesat_ideal", TINY))


@pytest.mark.parametrize(
    "values",
    [
        {"detector.exposure_s": 0.35},
        {"detector.shutter": "rolling"},
        {"detector.read_noise_e": 33.0},
        {"detector.prnu": 0.2},
        {"detector.pixel_pitch_um": 7.0},
        {"optics.aperture_mm": 3.0, "detector.temperature_c": 45.0},
        {"sky.magnitude_limit": 2.0},
        {"orbit.altitude_km": 700.0},
        {"pointing.jitter.rms_arcsec": (60.0, 60.0, 60.0)},
        {"environment.galactic": True},
        {"tracker.prior": False},
    ],
    ids=lambda values: next(iter(values)),
)
def test_a_renderer_with_other_values_is_that_of_the_other_scenario(tiny, values):
    """What is shared does not depend on the values: frame and truth are those of a new renderer, bit for bit."""
    shared, new = tiny.changed(values), Renderer(tiny.scenario.changed(values))
    (frame, truth), (expected, true) = (renderer.frame(2) for renderer in (shared, new))
    assert np.array_equal(frame.image, expected.image)
    assert np.array_equal(truth.mean_electrons, true.mean_electrons)
    assert (frame.camera, frame.exposure_s, frame.parameters) == (
        expected.camera,
        expected.exposure_s,
        expected.parameters,
    )
    assert (frame.read_noise_e, frame.gain_e_per_dn) == (expected.read_noise_e, expected.gain_e_per_dn)
    assert (frame.prior is None) is (expected.prior is None)
    assert truth.particles_cm2_s == true.particles_cm2_s
    assert np.array_equal(truth.attitude.quat, true.attitude.quat)
    same, _ = tiny.frame(2)
    assert np.array_equal(same.image, tiny.changed({"study.trials": 7}).frame(2)[0].image)


def test_a_frame_states_what_is_known_on_board(tiny):
    frame, truth = tiny.frame(3)
    section = tiny.scenario.detector
    assert (frame.index, frame.seed, frame.scenario) == (3, tiny.scenario.seed, tiny.scenario.name)
    assert (frame.offset_dn, frame.exposure_s) == (section.offset_dn, section.exposure_s)
    assert frame.read_noise_e == pytest.approx(section.read_noise_e)
    assert frame.prior_deg == tiny.scenario.pointing.error_deg
    assert frame.utc == tiny.scenes.clock.isot(truth.t_s)
    assert frame.observer.epoch_jyear == pytest.approx(tiny.scenes.clock.jyear(truth.t_s), abs=1e-12)
    still = tiny.changed({"pointing.error_deg": 0.0}).frame(3)[0]
    assert still.prior_deg == 0.1  # the least one that is stated


def test_the_prior_is_the_attitude_to_its_error_and_is_left_out_where_the_tracker_has_none(tiny):
    wide = tiny.changed({"pointing.error_deg": 2.0, "tracker.prior": True})
    frame, truth = wide.frame(3)
    off_deg = np.degrees(np.abs(frame.prior.rotation_vector_to(truth.attitude)))
    assert 0.0 < np.linalg.norm(off_deg) < 2.0 * math.sqrt(3.0)
    assert frame.prior_deg == 2.0
    assert wide.changed({"tracker.prior": False}).frame(3)[0].prior is None


@pytest.mark.parametrize("index", [-1, 2**63])
def test_trials_and_seeds_are_whole_numbers_of_63_bits(tiny, index):
    with pytest.raises(InputError, match="index"):
        tiny.scene(index)
    with pytest.raises(InputError, match="camera_seed"):
        Renderer(tiny.scenario, camera_seed=index)
    assert tiny.scene(2**63 - 1).t_s >= 0.0


def test_a_frame_with_an_error_of_its_time_is_taken_at_the_true_one(tiny):
    late = tiny.changed({"detector.time_tag.offset_s": 0.25})
    (frame, truth), (plain, true) = late.frame(3), tiny.frame(3)
    assert truth.time_tag_error_s == 0.25
    assert truth.t_s == true.t_s
    assert np.array_equal(frame.image, plain.image)
    assert frame.utc == tiny.scenes.clock.isot(truth.t_s + 0.25)
    jittered = tiny.changed({"detector.time_tag.offset_s": 0.25, "detector.time_tag.jitter_s": 0.01})
    errors = [jittered.frame(k)[1].time_tag_error_s for k in range(3)]
    assert len(set(errors)) == 3
    assert errors == pytest.approx([0.25] * 3, abs=0.05)


def test_read_noise_with_an_intensifier_is_in_photo_electrons():
    """⟨g⟩ = 50 and F² = 2.02: 101 of the detector's electrons are one of the curve of photon transfer."""
    keys = [*TINY, "detector.intensifier.gain=50", "detector.read_noise_e=202", "detector.reset_capacitance_ff=0"]
    assert Renderer(Scenario.load("cubesat_ideal", keys)).frame(0)[0].read_noise_e == pytest.approx(2.0, rel=1e-9)


def test_keys_of_a_header_are_scalars_and_texts(tiny):
    found = tiny.parameters
    assert found["detector.width"] == 64
    assert found["pointing.jitter.rms_arcsec"] == "0.0 0.0 0.0"
    assert "optics.baffle.pst" not in found  # null
    assert not any(key.startswith(("pointing.track.", "tracker.", "study.")) for key in found)
    assert all(isinstance(value, int | float | str | bool) for value in found.values())
    tracking = tiny.scenario.changed({"pointing.track.target": "nadir"})
    assert any(key.startswith("pointing.track.") for key in flat_parameters(tracking))


# ---------------------------------------------------------------- constants
def test_constants_are_those_of_their_sources():
    """CODATA as in SciPy, WGS 84 as in ERFA, and EGM96's normalised coefficients C̄n0 with Jn = −√(2n + 1) C̄n0."""
    assert constants.PLANCK_J_S == scipy_constants.h
    assert constants.BOLTZMANN_J_K == scipy_constants.k
    assert constants.ELEMENTARY_CHARGE_C == scipy_constants.e
    assert erfa.eform(1)[0] / 1e3 == constants.EARTH_RADIUS_KM
    assert constants.EARTH_GM_KM3_S2 == 398_600.4418
    assert constants.SECONDS_PER_YEAR == 31_557_600.0
    normalised = (-0.484165371736e-3, 0.957254173792e-6, 0.539873863789e-6, 0.685323475630e-7, -0.149957994714e-6)
    expected = [-math.sqrt(2.0 * n + 1.0) * c for n, c in enumerate(normalised, 2)]
    assert constants.EARTH_ZONALS == pytest.approx(expected, rel=3e-7)
    assert constants.EARTH_ZONALS[0] == constants.EARTH_J2


def test_damage_is_that_of_the_area_of_a_pixel():
    """Of a solar event: interactions in proportion to 5 × 8 µm², whichever way round."""
    keys = [*SMALL, "environment.age_years=1", "environment.solar_proton_events=1", "environment.depletion_um=3"]
    found = [
        build.build_damage(Scenario.load("cubesat_ideal", [*keys, f"detector.pixel_pitch_um=[{x}, {y}]"]))
        for x, y in ((5, 8), (8, 5), (5, 5))
    ]
    interactions = [one.displacement.interactions_per_pixel for one in found]
    assert interactions[0] == pytest.approx(interactions[1], rel=1e-12)
    assert interactions[0] / interactions[2] == pytest.approx(1.6, rel=1e-12)
    assert interactions[2] > 0.0
