"""Parts of the radiation environment with spectra, fluxes and doses of which the answer is known by hand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from simulator import Scenario
from simulator.build import build_orbit
from simulator.environment import dose, matter, shield, solar, transients
from simulator.environment.coefficients import COEFFICIENTS
from simulator.environment.damage import Damage, Pixel, damage, displacement_dark_e_s
from simulator.environment.dose import Dose, OrbitRadiation
from simulator.environment.galactic import GalacticCosmicRays, proton_rigidity_gv, visible_share
from simulator.environment.parameters import Environment
from simulator.environment.spectrum import Spectrum
from simulator.environment.transients import LocalFlux, Transients
from simulator.environment.trapped import TrappedBelts
from simulator.mission.frames import itrs_km
from simulator.study.environment import derived, survey
from simulator.study.environment.survey import EnvironmentSurvey, Track

YEAR_S = 365.25 * 86_400.0
RAD_MEV_G = 1.602_176_634e-8  # 1 rad = 100 erg/g
EARTH_KM = 6378.137


def line(energy_mev, flux, energies):
    """All particles within a narrow step of energy."""
    return Spectrum(energies, np.where(energies <= energy_mev, flux, 0.0))


# ---------------------------------------------------------------- spectra
def test_a_spectrum_is_a_power_law_constant_below_and_nothing_above():
    spectrum = Spectrum(np.array([1.0, 10.0, 100.0]), np.array([1e6, 1e4, 1e1]))
    found = spectrum.integral([0.01, 1.0, 3.0, 30.0, 100.0, 100.1])
    expected = [1e6, 1e6, 1e6 * 3.0**-2, 1e4 * 3.0**-3, 10.0, 0.0]
    assert found == pytest.approx(expected, rel=1e-12)
    assert spectrum.times(2.5).integral(10.0) == pytest.approx(2.5e4)
    assert spectrum.times(2.5).energy_mev is spectrum.energy_mev


def test_a_spectrum_that_ends_in_zeros_is_zero_there():
    spectrum = Spectrum(np.array([1.0, 10.0, 100.0]), np.array([5.0, 0.0, 0.0]))
    assert spectrum.integral([1.0, 10.0, 50.0]) == pytest.approx([5.0, 0.0, 0.0], rel=1e-12, abs=0.0)
    assert Spectrum(np.array([1.0, 10.0]), np.zeros(2)).integral([1.0, 3.0]).tolist() == [0.0, 0.0]


def test_solar_protons_between_two_energies_arrive_with_the_mean_of_their_shares():
    fluence = Spectrum(np.array([10.0, 30.0, 100.0]), np.array([100.0, 40.0, 10.0]))
    found = solar.reaching(fluence, np.array([0.2, 0.4, 1.0]))
    assert found.above == pytest.approx([60.0 * 0.3 + 30.0 * 0.7 + 10.0, 30.0 * 0.7 + 10.0, 10.0])
    assert found.energy_mev is fluence.energy_mev


# ---------------------------------------------------------------- doses
def test_protons_of_one_energy_lose_what_they_lose_behind_the_wall():
    """100 MeV behind 0, 5 and 20 mm: range less thickness, energy of that range, stopping power of silicon."""
    energies = np.array([50.0, 99.9, 100.1, 150.0])
    for mm in (0.0, 5.0, 20.0):
        rest = float(matter.proton_range_g_cm2(100.0)) - mm / 10.0 * 2.699
        behind = float(matter.proton_energy_mev(rest))
        expected = 1e6 * float(matter.proton_stopping_silicon(behind))
        found = shield.proton_dose_mev_g(line(99.95, 1e6, energies), mm)
        assert found == pytest.approx(expected, rel=5e-3), mm  # the step of 0.2 MeV, within which the loss varies
    stopped = shield.proton_dose_mev_g(line(99.95, 1e6, energies), 50.0)  # the range is 41 mm
    assert stopped == 0.0


def test_electrons_of_one_energy_lose_what_they_lose_behind_the_wall():
    energies = np.array([1.0, 2.998, 3.002, 5.0])
    for mm in (1.0, 4.0):
        rest = float(matter.electron_range_g_cm2(3.0)) - mm / 10.0 * 2.699
        expected = 1e6 * float(matter.electron_stopping(matter.electron_energy_mev(rest)))
        assert shield.electron_dose_mev_g(line(3.0, 1e6, energies), mm) == pytest.approx(expected, rel=5e-3), mm
    assert shield.electron_dose_mev_g(line(3.0, 1e6, energies), 6.0) == 0.0  # 1.48 g/cm² stop 3 MeV, these are 1.62


ENERGIES = np.array([10.0, 99.9, 100.1, 200.0])
ELECTRONS = np.array([0.5, 2.998, 3.002, 7.0])


def one_line_each():
    return OrbitRadiation(
        line(99.95, 1e3, ENERGIES), line(3.0, 1e5, ELECTRONS), np.linspace(0.1, 0.3, len(solar.EVENT_MEV))
    )


@pytest.mark.parametrize("estimate", ["low", "nominal", "high"])
def test_the_dose_is_flux_times_time_times_its_coefficient(estimate):
    radiation, mm, years = one_line_each(), 3.0, 2.5
    environment = Environment(estimate=estimate, solar_proton_events=1.5)
    found = dose.dose(radiation, environment, mm, years)
    rate = {name: getattr(COEFFICIENTS[name], "value" if estimate == "nominal" else estimate) for name in COEFFICIENTS}
    krad = RAD_MEV_G * 1e-3
    seconds = years * YEAR_S
    protons = shield.proton_dose_mev_g(radiation.protons, mm) * seconds * rate["trapped_protons"]
    electrons = shield.electron_dose_mev_g(radiation.electrons, mm) * seconds * rate["trapped_electrons"]
    arriving = solar.reaching(solar.event_fluence(1.5), radiation.solar_share)
    assert found.protons_krad == pytest.approx(protons * krad, rel=1e-6)
    assert found.electrons_krad == pytest.approx(electrons * krad, rel=1e-6)
    assert found.solar_krad == pytest.approx(shield.proton_dose_mev_g(arriving, mm) * krad, rel=1e-6)
    niel = matter.proton_niel_silicon
    displaced = shield.proton_dose_mev_g(radiation.protons, mm, niel) * seconds * rate["trapped_protons"]
    displaced += shield.proton_dose_mev_g(arriving, mm, niel)
    assert found.displacement_mev_g == pytest.approx(rate["niel_scale"] * displaced, rel=1e-6)
    assert found.ionising_krad == found.protons_krad + found.electrons_krad + found.solar_krad
    assert min(found.protons_krad, found.electrons_krad, found.solar_krad) > 0.0


def test_the_mean_is_over_a_month_or_over_what_a_file_covers_of_it():
    orbit = build_orbit(Scenario.load("cubesat_ideal"))
    t_s, positions = dose.orbit_positions(orbit, 1000)
    assert (t_s[0], len(t_s), positions.shape) == (0.0, 1000, (1000, 3))
    assert t_s[1] * 1000 == pytest.approx(30.03 * 86_400.0)
    for span, first, last in (((-500.0, 7000.0), 0.0, 7000.0), ((900.0, 1e9), 900.0, 30.03 * 86_400.0)):
        part = SimpleNamespace(span_s=span, clock=orbit.clock, state=orbit.state, centre="Earth")
        t_s, _ = dose.orbit_positions(part, 10)
        assert t_s[0] == first
        assert t_s[-1] + (t_s[1] - t_s[0]) == pytest.approx(last)


def test_without_trapped_particles_there_are_none_and_solar_ones_arrive():
    found = dose.orbit_radiation(build_orbit(Scenario.load("cubesat_ideal")), Environment(), 50)
    assert not found.protons.above.any()
    assert not found.electrons.above.any()
    assert found.solar_share.shape == solar.EVENT_MEV.shape
    assert (np.diff(found.solar_share) >= 0.0).all()
    assert 0.0 < found.solar_share[-1] < 1.0


# ---------------------------------------------------------------- damage
def test_a_detector_without_a_dose_is_undamaged():
    none = Dose(0.0, 0.0, 0.0, 0.0)
    found = damage(none, none, Pixel(30.0, 25.0, True), Environment(age_years=1.0, glass="standard"))
    assert found.displacement.mean_e_s == found.displacement.dark_e_s == found.mean_dark_e_s == 0.0
    assert (found.cti_parallel, found.cti_serial, found.transmission) == (0.0, 0.0, 1.0)
    assert found.telegraph.pixel_fraction == 0.0


@pytest.mark.parametrize("estimate", ["low", "nominal", "high"])
def test_serial_transfer_and_ionising_dose(estimate):
    inner, glass = Dose(2.0, 1.0, 0.5, 3e6), Dose(10.0, 0.0, 0.0, 0.0)
    environment = Environment(age_years=1.0, dark_per_krad_e_s=4.0, glass="cerium", glass_path_mm=35.0)
    environment = replace(environment, estimate=estimate)
    found = damage(inner, glass, Pixel(100.0, 20.0, True), environment)
    assert (found.detector_dose, found.glass_dose) == (inner, glass)
    assert found.dark_current_e_s == 14.0
    of = {name: getattr(COEFFICIENTS[name], "value" if estimate == "nominal" else estimate) for name in COEFFICIENTS}
    assert found.cti_parallel == pytest.approx(3.0 * of["transfer_damage"], rel=1e-12)
    assert found.cti_serial == pytest.approx(found.cti_parallel * of["serial_transfer_share"], rel=1e-12)
    assert found.transmission == pytest.approx(np.exp(-of["glass_cerium"] * 10.0 * 3.5), rel=1e-12)
    # telegraph pixels of a few per cent leave the rest of the whole to the displacements
    whole = displacement_dark_e_s(3e6, 100.0 * environment.depletion_um, 20.0, estimate)
    moving = found.telegraph.pixel_fraction * found.telegraph.dark_e_s * found.telegraph.high_share
    assert found.displacement.mean_e_s == pytest.approx(max(whole - moving, 0.0), rel=1e-9)
    assert found.mean_dark_e_s == pytest.approx(14.0 + found.displacement.mean_e_s + moving, rel=1e-12)


def test_dark_currents_of_damage_follow_arrhenius():
    """0.63 eV: from 0 °C to 27 °C by exp(E/k (1/273.15 − 1/300.15)) = 11.1 (k = 8.617333e-5 eV/K)."""
    ratio = np.exp(0.63 / 8.617333262e-5 * (1.0 / 273.15 - 1.0 / 300.15))
    cold, warm = (displacement_dark_e_s(1e6, 100.0, t, "nominal") for t in (0.0, 27.0))
    assert warm / cold == pytest.approx(ratio, rel=1e-6)
    # amplitudes of telegraph pixels refer to 22 °C
    inner = Dose(0.0, 0.0, 0.0, 1e6)
    found = damage(inner, inner, Pixel(100.0, 22.0, False), Environment(age_years=1.0))
    assert found.telegraph.dark_e_s == pytest.approx(COEFFICIENTS["telegraph_amplitude"].value, rel=1e-12)
    hot = damage(inner, inner, Pixel(100.0, 49.0, False), Environment(age_years=1.0)).telegraph.dark_e_s
    expected = np.exp(0.63 / 8.617333262e-5 * (1.0 / 295.15 - 1.0 / 322.15))
    assert hot / found.telegraph.dark_e_s == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(
    ("keys", "particles", "aged"),
    [
        ({}, False, False),
        ({"trapped": "ap8"}, True, False),
        ({"galactic": True}, True, False),
        ({"galactic": True, "transients": False}, False, False),
        ({"trapped": "ap8", "transients": False, "age_years": 0.5}, False, True),
        ({"age_years": 0.5}, False, False),
        ({"age_years": 0.5, "solar_proton_events": 0.5}, False, True),
        ({"solar_proton_events": 0.5}, False, False),
        ({"galactic": True, "age_years": 2.0}, True, False),
    ],
)
def test_what_an_environment_has(keys, particles, aged):
    found = Environment(**keys)
    assert (found.has_particles, found.has_damage) == (particles, aged)
    assert found.sources == Environment(trapped=found.trapped, solar=found.solar)


# ---------------------------------------------------------------- fluxes
def test_the_share_of_directions_is_the_cap_that_the_earth_hides():
    for radii in (1.0, 1.2, 6.6):
        half = np.arcsin(1.0 / radii)
        assert visible_share(radii * EARTH_KM) == pytest.approx(1.0 - 0.5 * (1.0 - np.cos(half)), rel=1e-12)


def test_rigidity_of_protons_and_helium():
    """1 GeV: √(1 (1 + 2 × 0.938272)) = 1.696 GV. Helium at a rigidity has half of it per nucleon's momentum."""
    assert proton_rigidity_gv([1000.0, 100.0]) == pytest.approx([1.6960, 0.44458], rel=1e-4)
    far = np.array([[0.0, 0.0, 1e6]])
    rays = GalacticCosmicRays("min")
    protons, helium = rays.flux_cm2_s(far, 3.0)
    more_protons, more_helium = rays.flux_cm2_s(far, 1.0)
    assert 0.1 < (helium / protons)[0] < 0.25  # above a rigidity, about a sixth to a tenth of the protons
    assert more_protons[0] > 2.0 * protons[0]
    assert more_helium[0] > 1.5 * helium[0]


def test_transmission_is_the_mean_over_positions_of_open_sky():
    """Of three positions the pole lets 1 GV in, the equator does not; each sees its own share of the sky."""
    rays, radius = GalacticCosmicRays("max"), 7000.0
    positions = radius * np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    seen = float(visible_share(radius))
    assert rays.transmission(positions, [1.0, 100.0]) == pytest.approx([seen / 3.0, seen], rel=1e-12)


CLOCK = build_orbit(Scenario.load("cubesat_ideal")).clock
POSITION = np.array([[0.0, 9000.0, 0.0]])


def test_a_thick_shield_stops_all_electrons_of_the_map():
    pytest.importorskip("aep8")
    thin, thick = (
        Transients(Environment(trapped="ap8", shield_mm=mm), CLOCK).flux(np.zeros(1), POSITION) for mm in (3.0, 20.0)
    )
    assert thin.trapped_electrons[0] > 100.0
    assert thick.trapped_electrons[0] == 0.0
    assert 0.0 < thick.trapped_protons.sum() < thin.trapped_protons.sum()
    assert thick.trapped_protons[0, -1] > 0.0
    assert thick.galactic_protons[0] == thick.galactic_helium[0] == 0.0
    total = thin.trapped_protons.sum() + thin.trapped_electrons[0]
    assert thin.total[0] == pytest.approx(total, rel=1e-12)


def test_groups_of_trapped_protons_behind_a_wall_begin_before_it_and_end_with_the_map():
    """The energies before 20 mm of aluminium that are left behind it; the map ends at 400 MeV."""
    pytest.importorskip("aep8")
    groups = Transients(Environment(trapped="ap8", shield_mm=20.0), CLOCK).flux(np.zeros(1), POSITION).trapped_protons
    before = shield.incident_proton_mev(np.array([0.5, 5.0, 15.0, 40.0, 100.0]), 20.0)
    assert before[0] > 60.0
    positions = itrs_km(CLOCK, np.zeros(1), POSITION)
    above, _ = TrappedBelts("min").fluxes(positions, float(CLOCK.jyear(0.0)), np.append(before, 400.0), np.empty(0))
    assert groups[0] == pytest.approx(-0.5 * np.diff(above[0]), rel=1e-9)


def test_groups_of_particles_have_their_charge_and_empty_ones_are_left_out(monkeypatch):
    """Electrons and protons of cosmic rays ionise alike; helium four times as much; slow protons most."""
    found = Transients(Environment(galactic=True), CLOCK)
    protons = np.array([[7.0, 0.0, 5.0, 0.0, 3.0]])
    flux = LocalFlux(np.array([2.0]), np.array([0.25]), protons, np.array([1.5]))
    monkeypatch.setattr(Transients, "flux", lambda *_: flux)
    groups = found.particles(10.0, POSITION[0], 12.0)
    assert [group.rate_cm2_s for group in groups] == [3.5, 0.25, 7.0, 5.0, 3.0]
    assert {group.depth_um for group in groups} == {12.0}
    charges = [group.charge_e_um for group in groups]
    assert charges[:2] == [80.0, 320.0]
    edges = np.array([0.5, 5.0, 15.0, 40.0, 100.0, 400.0])
    middles = np.sqrt(edges[1:] * edges[:-1])[[0, 2, 4]]
    loss_e_um = matter.proton_stopping_silicon(middles) * 2.329 * 100.0 / 3.65
    assert charges[2:] == pytest.approx(loss_e_um / (1.0 + 26.2 / 80.0), rel=1e-9)
    nothing = LocalFlux(*(np.zeros(1),) * 2, np.zeros((1, 5)), np.zeros(1))
    monkeypatch.setattr(Transients, "flux", lambda *_: nothing)
    assert found.particles(10.0, POSITION[0], 12.0) == ()


def test_helium_has_the_charge_squared_and_a_plane_half_of_the_flux():
    assert (transients.HELIUM_CHARGE_RATIO, transients.PLANE_SHARE) == (2.0**2, 0.5)


# ---------------------------------------------------------------- survey
def a_survey(protons, galactic=1.0):
    count = len(protons)
    groups = np.column_stack([0.25 * np.asarray(protons), 0.75 * np.asarray(protons)])
    flux = LocalFlux(np.full(count, galactic), np.full(count, 0.5), groups, np.linspace(0.0, 3.0, count))
    track = Track(30.0 * np.arange(count), np.zeros(count), np.zeros(count), flux)
    none = Dose(1.0, 2.0, 4.0, 8e6)
    aged = damage(none, none, Pixel(30.0, 25.0, True), Environment(age_years=1.0))
    ageing = {estimate: [aged] * 2 for estimate in survey.ESTIMATES}
    return EnvironmentSurvey(
        "a", Environment(age_years=1.0), track, track, 0.02, {3.0: none}, np.array([0.0, 1.0]), ageing
    )


@pytest.mark.parametrize(
    ("protons", "passes", "share"),
    [
        ([0.0, 11.0, 12.0, 0.0, 0.0, 13.0, 9.0, 0.0], 2, 3 / 8),
        ([11.0, 0.0, 11.0, 11.0], 2, 3 / 4),
        ([11.0, 11.0], 1, 1.0),
        ([0.0, 9.9], 0, 0.0),
        ([0.0, 0.0, 11.0], 1, 1 / 3),
    ],
)
def test_passes_through_the_anomaly_are_entries(protons, passes, share):
    assert a_survey(protons).anomaly() == {"passes": passes, "share_of_time": pytest.approx(share)}


def test_the_summary_holds_means_medians_and_maxima():
    protons = np.array([0.0, 4.0, 20.0, 100.0, 1.0])
    found = a_survey(protons).summary()
    fluxes, frames = found["flux_cm2_s"], found["particles_per_frame"]
    assert fluxes["galactic"] == {"mean": 1.5, "median": 1.5, "max": 1.5}
    assert fluxes["trapped_protons"] == {"mean": 25.0, "median": 4.0, "max": 100.0}
    assert fluxes["trapped_electrons"] == {"mean": 1.5, "median": 1.5, "max": 3.0}
    total = 1.5 + protons + np.linspace(0.0, 3.0, 5)
    assert fluxes["total"] == pytest.approx({"mean": 28.0, "median": np.median(total), "max": total.max()})
    for kind, values in fluxes.items():
        assert frames[kind] == pytest.approx({"median": 0.02 * values["median"], "max": 0.02 * values["max"]}), kind
    assert (found["positions"], found["days"], found["name"]) == (5, 30.03, "a")
    assert found["anomaly_first_day"] == {"passes": 1, "share_of_time": 0.4, "above_cm2_s": 10.0}
    assert found["dose_by_shield_mm"]["3"]["ionising_krad"] == 7.0
    rows = found["ageing"]["nominal"]
    assert [row["years"] for row in rows] == [0.0, 1.0]
    assert (rows[1]["ionising_krad"], rows[1]["displacement_mev_g"], rows[1]["glass_krad"]) == (7.0, 8e6, 7.0)


def test_a_row_of_ageing_has_each_damage_under_its_name():
    inner, glass = Dose(1.0, 2.0, 4.0, 8e6), Dose(9.0, 0.0, 0.0, 0.0)
    aged = damage(inner, glass, Pixel(30.0, 25.0, True), Environment(age_years=1.0, glass="standard"))
    assert isinstance(aged, Damage)
    assert survey._damage_values(aged) == {
        "ionising_krad": 7.0,
        "displacement_mev_g": 8e6,
        "mean_dark_e_s": aged.mean_dark_e_s,
        "interactions_per_pixel": aged.displacement.interactions_per_pixel,
        "dark_per_interaction_e_s": aged.displacement.dark_e_s,
        "telegraph_fraction": aged.telegraph.pixel_fraction,
        "telegraph_dark_e_s": aged.telegraph.dark_e_s,
        "cti_parallel": aged.cti_parallel,
        "glass_krad": 9.0,
        "transmission": aged.transmission,
    }


def test_the_table_of_the_first_day_sums_groups():
    table = a_survey([0.0, 4.0, 8.0], galactic=2.0).to_table().to_pydict()
    assert table["t_s"] == [0.0, 30.0, 60.0]
    assert table["galactic_cm2_s"] == [2.5] * 3
    assert table["trapped_protons_cm2_s"] == [0.0, 4.0, 8.0]
    assert table["trapped_electrons_cm2_s"] == [0.0, 1.5, 3.0]


def test_solar_events_are_spread_evenly_over_the_age(monkeypatch):
    asked = []
    monkeypatch.setattr(survey, "build_damage", lambda _scenario, row: asked.append(row))
    survey._ageing(None, Environment(age_years=4.0, solar_proton_events=2.0), np.array([0.0, 1.0, 4.0]))
    assert [(row.age_years, row.solar_proton_events) for row in asked] == [(0.0, 0.0), (1.0, 0.5), (4.0, 2.0)]


def test_lines_of_an_aged_detector_state_what_was_built():
    keys = ["detector.width=64", "detector.height=48", "environment.age_years=5", "environment.solar_proton_events=2"]
    keys += ["environment.glass=standard", "detector.dark_current_e_s=20", "detector.temperature_c=25"]
    keys += ["detector.dsnu=0", "detector.prnu=0"]
    scenario = Scenario.load("cubesat_ideal", keys)
    lines = derived.aged_lines(scenario)
    aged, broken = derived.build_detector(scenario), derived.build_damage(scenario)
    assert lines[0] == "after 5 years behind 3 mm of aluminium (nominal estimate), detector at 25 °C:"
    assert f"{broken.detector_dose.ionising_krad:.3g} krad ionising" in lines[1]
    dark = aged.pattern.dark_e_s
    assert f"mean {dark.mean():.3g}, percentiles {np.median(dark):.3g} at 50 %" in lines[2]
    assert f"{np.percentile(dark, 99.9):.3g} at 99.9 %" in lines[2]
    assert lines[3] == "of the new detector: mean 20, percentiles 20 at 50 %, 20 at 99 %, 20 at 99.9 %"
    assert lines[4] == f"random telegraph pixels: {len(aged.pattern.telegraph.pixels)} of 3072"
    assert lines[6] == f"transmission of the glass: {broken.transmission:.3f} of the new"
    assert broken.transmission < 0.999
