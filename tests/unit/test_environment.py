"""The environment of a scenario: off it changes nothing; on, particles follow the position and the camera ages."""

import builtins
import math

import numpy as np
import pytest

from simulator import Renderer, Scenario
from simulator.build import aged_detector, build_damage, build_focal_plane, build_transients, detector_parameters
from simulator.constants import EARTH_RADIUS_KM
from simulator.detector.cosmic_rays import PAIR_ENERGY_EV, SILICON_XI_EV_UM
from simulator.environment import shield
from simulator.environment.coefficients import COEFFICIENTS
from simulator.environment.damage import Pixel, damage, glass_transmission
from simulator.environment.dose import Dose
from simulator.environment.galactic import CUTOFF_GV, DIPOLE_AXIS, GalacticCosmicRays, cutoff_gv
from simulator.environment.parameters import Environment
from simulator.environment.solar import event_fluence, reaching
from simulator.environment.spectrum import Spectrum
from simulator.environment.transients import proton_charge_e_um
from simulator.mission.frames import itrs_km
from startracker.errors import InputError

SMALL = ["detector.width=128", "detector.height=96", "sky.magnitude_limit=3"]
AP8 = ["environment.trapped=ap8", "environment.galactic=true"]


def load(*keys):
    return Scenario.load("cubesat_ideal", [*SMALL, *keys])


def test_coefficients_have_sources_and_ordered_ranges():
    for name, coefficient in COEFFICIENTS.items():
        assert coefficient.name == name
        assert 0 < coefficient.low <= coefficient.value <= coefficient.high
        assert len(coefficient.source) > 20
        assert [coefficient.at(e) for e in ("low", "nominal", "high")] == sorted(
            [coefficient.low, coefficient.value, coefficient.high]
        )


def test_off_the_environment_changes_no_byte():
    """An age without a source of dose, and a shield without particles, leave the frame as it is."""
    plain = Renderer(load()).frame(0)[0]
    idle = Renderer(load("environment.shield_mm=9", "environment.age_years=7", "environment.solar=max")).frame(0)[0]
    assert np.array_equal(plain.image, idle.image)
    assert not load("environment.age_years=7").environment.has_damage
    assert build_transients(load("environment.shield_mm=9")) is None
    assert aged_detector(load()) == detector_parameters(load().detector)


def test_particles_cross_the_detector_in_the_anomaly_and_not_outside():
    """At the time of most protons along the orbit, and at that of the fewest particles of all."""
    pytest.importorskip("aep8")
    keys = [*AP8, "detector.exposure_s=1", "detector.width=512", "detector.height=512", "allow_unphysical=true"]
    scenario = load(*keys, "optics.aperture_mm=1", "optics.focal_length_mm=25")
    renderer = Renderer(scenario)
    times = np.arange(0.0, 6.0e4, 60.0)
    r_km, _ = renderer.scenes.orbit.state(times)
    flux = renderer.transients.flux(times, r_km)
    protons = flux.trapped_protons.sum(axis=1)
    calm, storm = times[np.argmin(flux.total)], times[np.argmax(protons)]
    area_cm2 = (512 * 5.5e-4) ** 2
    assert flux.total.min() * area_cm2 < 0.1
    assert protons.max() * area_cm2 > 50.0
    dark = {t: renderer.frame(0, at_s=t)[0].image for t in (calm, storm)}
    without = Renderer(load(*keys, "optics.aperture_mm=1", "optics.focal_length_mm=25", "environment.transients=false"))
    changed = {t: int(np.count_nonzero(dark[t] != without.frame(0, at_s=t)[0].image)) for t in dark}
    assert changed[calm] < 20
    assert changed[storm] > 100
    again = Renderer(scenario).frame(0, at_s=storm)[0].image
    assert np.array_equal(again, dark[storm])


def test_truth_states_the_particles_of_the_frame():
    assert Renderer(load("detector.cosmic_rays.rate_cm2_s=7")).frame(0)[1].particles_cm2_s == 7.0
    assert Renderer(load()).frame(0)[1].particles_cm2_s == 0.0
    renderer = Renderer(load("environment.galactic=true"))
    truth = renderer.frame(5)[1]
    r_km, _ = renderer.scenes.orbit.state(np.array([truth.t_s]))
    assert truth.particles_cm2_s == pytest.approx(renderer.transients.flux(np.array([truth.t_s]), r_km).total[0])


def test_groups_of_particles_carry_the_local_flux():
    pytest.importorskip("aep8")
    scenario = load(*AP8)
    renderer = Renderer(scenario)
    t_s = 2000.0
    r_km, _ = renderer.scenes.orbit.state(np.array([t_s]))
    groups = renderer.transients.particles(t_s, r_km[0], 10.0)
    assert sum(group.rate_cm2_s for group in groups) == pytest.approx(
        renderer.transients.flux(np.array([t_s]), r_km).total[0], rel=1e-12
    )
    assert all(group.depth_um == 10.0 for group in groups)


def test_half_of_an_isotropic_flux_crosses_a_plane():
    """The rate per area is the omnidirectional flux times the mean of |cos θ| over all directions."""
    position = np.array([[0.0, 0.0, 7178.0]])
    transients = build_transients(load("environment.galactic=true"))
    itrs = itrs_km(Renderer(load()).scenes.clock, np.zeros(1), position)
    flux, _ = GalacticCosmicRays("min").flux_cm2_s(itrs, 0.2)
    cosine = np.linspace(-1.0, 1.0, 2001)
    crossing = transients.flux(np.zeros(1), position).galactic_protons
    assert crossing == pytest.approx(flux * np.mean(np.abs(cosine)), rel=1e-3)


def test_charge_of_protons():
    """A proton of 100 MeV ionises 5.04/1.664 = 3.0 times as strongly as a minimum-ionising particle (PSTAR, PDG), whose
    most probable charge is 80 e⁻/µm; 1 %: the mean of 106 e⁻/µm."""
    assert proton_charge_e_um(np.array([100.0]))[0] == pytest.approx(80.0 * 5.043 / 1.664, rel=0.01)
    assert SILICON_XI_EV_UM / PAIR_ENERGY_EV == pytest.approx(4.885, abs=0.01)


def test_an_aged_camera_has_the_damage_of_its_dose():
    pytest.importorskip("aep8")
    new = load(*AP8)
    old = load(*AP8, "environment.age_years=5", "environment.glass=standard", "environment.dark_per_krad_e_s=3")
    aged, parameters, before = build_damage(old), aged_detector(old), detector_parameters(new.detector)
    assert aged.detector_dose.ionising_krad > 0.5
    assert parameters.dark_current_e_s == before.dark_current_e_s + 3 * aged.detector_dose.ionising_krad
    assert parameters.displacement == aged.displacement
    assert parameters.telegraph.pixel_fraction == aged.telegraph.pixel_fraction > 0
    assert (parameters.cti_parallel, parameters.cti_serial) == (0.0, 0.0)  # a CMOS detector transfers no charge
    curves = [build_focal_plane(scenario).photometer.response for scenario in (old, new)]
    np.testing.assert_allclose(curves[0].value, aged.transmission * curves[1].value, rtol=1e-12)
    assert 0.3 < aged.transmission < 0.95
    dark = [Renderer(scenario).detector.pattern.dark_e_s.mean() for scenario in (old, new)]
    assert dark[0] > dark[1]


def test_doses_add_up_over_the_years_and_fall_with_the_shield():
    pytest.importorskip("aep8")
    year, five, thick = (
        build_damage(load(*AP8, f"environment.age_years={age}", f"environment.shield_mm={mm}")).detector_dose
        for age, mm in ((1, 3), (5, 3), (1, 8))
    )
    assert five.ionising_krad == pytest.approx(5 * year.ionising_krad, rel=1e-12)
    assert five.displacement_mev_g == pytest.approx(5 * year.displacement_mev_g, rel=1e-12)
    assert thick.electrons_krad < 0.02 * year.electrons_krad  # 0.009 at 550 km by SHIELDOSE-2
    assert 0.5 * year.protons_krad < thick.protons_krad < year.protons_krad


def test_estimates_are_bounds():
    pytest.importorskip("aep8")
    keys = [*AP8, "environment.age_years=3", "environment.glass=cerium"]
    low, nominal, high = (build_damage(load(*keys, f"environment.estimate={e}")) for e in ("low", "nominal", "high"))
    for value in ("mean_dark_e_s", "cti_parallel"):
        values = [getattr(case, value) for case in (low, nominal, high)]
        assert values == sorted(values)
    assert low.transmission > nominal.transmission > high.transmission
    assert high.mean_dark_e_s / nominal.mean_dark_e_s == pytest.approx(2 * 1 / 0.85 * 2.5 / 1.9 / 0.72, rel=0.01)


def test_mean_dark_current_contains_that_of_telegraph_pixels():
    """The universal damage factor is of the whole dark current: 1.9e5 × 0.72 carriers/cm³/s per MeV/g at 300 K."""
    inner = Dose(1.0, 0.0, 0.0, 5e6)
    aged = damage(inner, inner, Pixel(100.0, 26.85, False), Environment(depletion_um=4.0, age_years=1.0))
    assert aged.mean_dark_e_s == pytest.approx(1.9e5 * 0.72 * 5e6 * 400e-12, rel=1e-9)
    assert aged.telegraph.pixel_fraction == pytest.approx(1 - math.exp(-30 * 5e6 * 400e-12), rel=1e-12)


def test_a_ccd_loses_charge_transfer():
    inner = Dose(1.0, 0.0, 0.0, 2e6)
    aged = damage(inner, inner, Pixel(100.0, 25.0, True), Environment(age_years=1.0))
    assert aged.cti_parallel == pytest.approx(2 * COEFFICIENTS["transfer_damage"].value)
    assert 0 < aged.cti_serial < aged.cti_parallel


def test_glass_darkens_by_beers_law():
    assert glass_transmission("none", 100.0, 50.0, "nominal") == 1.0
    once = glass_transmission("cerium", 20.0, 10.0, "nominal")
    assert glass_transmission("cerium", 20.0, 30.0, "nominal") == pytest.approx(once**3)
    assert glass_transmission("standard", 20.0, 10.0, "nominal") < once


def test_a_power_law_is_integrated_exactly():
    """Monoenergetic limit and power law: the dose without a shield is ∫ loss dN, computed here by quadrature."""
    energies = np.geomspace(1.0, 400.0, 60)
    spectrum = Spectrum(energies, 1e6 * energies**-1.5)
    fine = np.geomspace(1.0, 400.0, 200_001)
    number = -np.diff(1e6 * fine**-1.5)
    from simulator.environment.matter import proton_stopping_silicon

    expected = np.sum(number * proton_stopping_silicon(np.sqrt(fine[1:] * fine[:-1])))
    expected += 1e6 * 400.0**-1.5 * 0.0  # nothing above the last energy
    assert shield.proton_dose_mev_g(spectrum, 1e-9) == pytest.approx(expected, rel=0.002)


def test_solar_events_arrive_where_the_field_lets_them():
    """King 1974: 7.9e9 protons/cm² above 30 MeV in one event."""
    event = event_fluence(1.0)
    assert event.integral(30.0) == pytest.approx(7.9e9)
    everywhere = reaching(event, np.ones(len(event.energy_mev)))
    np.testing.assert_allclose(everywhere.above, event.above, rtol=1e-12)
    half = reaching(event_fluence(2.0), np.full(len(event.energy_mev), 0.5))
    np.testing.assert_allclose(half.above, event.above, rtol=1e-12)


def test_levels_that_switch_within_an_exposure_are_refused():
    keys = ["detector.telegraph.pixel_fraction=0.1", "detector.telegraph.dark_e_s=100", "detector.telegraph.high_s=1.5"]
    with pytest.raises(InputError, match=r"detector\.telegraph\.high_s: 1\.5 s is less than ten exposures of 0\.2 s"):
        load(*keys)
    load(*keys[:2])


def test_a_missing_package_is_said_in_one_line(monkeypatch):
    whole = builtins.__import__

    def without(name, *args, **kwargs):
        if name == "aep8":
            raise ImportError(name)
        return whole(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(InputError, match=r"needs the package aep8; install it with: pip install 'boresight\[env"):
        build_transients(load(*AP8))


def test_galactic_rays_alone_need_no_package(monkeypatch):
    transients = build_transients(load("environment.galactic=true"))
    rate = transients.flux(np.zeros(1), np.array([[0.0, 0.0, 7178.0]])).total[0]
    assert 1.0 < rate < 3.0  # half of the polar flux, 4 to 5 /cm²/s outside the field at solar minimum, less the Earth


def test_number_of_displacement_interactions_is_dose_over_dose_per_interaction():
    """Interactions in a pixel = D V / (dose × volume of one), and their mean dark current times their number, with that
    of telegraph pixels, is the whole (Belloir et al. 2016)."""
    inner = Dose(1.0, 0.0, 0.0, 5e6)
    aged = damage(inner, inner, Pixel(100.0, 26.85, False), Environment(depletion_um=4.0, age_years=1.0))
    per_interaction = COEFFICIENTS["dose_per_interaction"].value
    assert aged.displacement.interactions_per_pixel == pytest.approx(5e6 / 1e6 * 400.0 / per_interaction, rel=1e-12)
    moving = aged.telegraph.pixel_fraction * aged.telegraph.dark_e_s * aged.telegraph.high_share
    assert aged.mean_dark_e_s == pytest.approx(aged.displacement.mean_e_s + moving, rel=1e-12)


def test_the_axis_of_the_dipole_is_that_of_igrf_13():
    """Its coefficients of degree 1 of 2020, nT (Alken et al. 2021); 0.06° from them, as its latitude is geodetic."""
    pole = -np.array([-1450.9, 4652.5, -29404.8])
    assert np.linalg.norm(np.cross(DIPOLE_AXIS, pole / np.linalg.norm(pole))) < math.radians(0.1)
    assert np.linalg.norm(DIPOLE_AXIS) == pytest.approx(1.0)
    assert DIPOLE_AXIS[2] > 0.0


@pytest.mark.parametrize("radii", [1.0, 1.1, 2.0])
@pytest.mark.parametrize("latitude_deg", [0.0, 30.0, -60.0])
def test_the_vertical_cutoff_is_stoermers(radii, latitude_deg):
    """C cos⁴λ / r², with the latitude from the axis of the dipole and r in radii of the Earth."""
    axis = np.asarray(DIPOLE_AXIS) / np.linalg.norm(DIPOLE_AXIS)
    across = np.cross(axis, [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    latitude = np.radians(latitude_deg)
    position = radii * EARTH_RADIUS_KM * (np.cos(latitude) * across + np.sin(latitude) * axis)
    expected = CUTOFF_GV * np.cos(latitude) ** 4 / radii**2
    np.testing.assert_allclose(cutoff_gv(position[None]), [expected], rtol=1e-6)
