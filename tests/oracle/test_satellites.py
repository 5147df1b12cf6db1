"""Satellites in the sky against Skyfield, an integral over the sphere, published magnitudes, and their own geometry."""

import math
from datetime import UTC, datetime
from types import SimpleNamespace

import numpy as np
import pytest
from astropy.table import Table
from skyfield.api import EarthSatellite
from skyfield.positionlib import Geocentric

from simulator.fits import write_fits
from simulator.mission.clock import Clock
from simulator.mission.element_files import read_elements
from simulator.mission.element_list import ElementList
from simulator.mission.walker import Walker, walker_tle
from simulator.optics.drift import Drift, drifting_paths
from simulator.optics.smear import star_paths
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.sky.ephemeris import is_sunlit
from simulator.sky.instants import sun_position_au
from simulator.sky.satellites import behind_earth, diffuse_phase, standard_magnitude, sunlit_share
from startracker.core import ARCSEC_RAD, AU_KM
from startracker.ephemeris import barycentric, de421, timescale
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude

EPOCH = datetime(2026, 3, 21, 12, tzinfo=UTC)
CLOCK = Clock(EPOCH)
SHELL = Walker(550.0, 53.0, 720, 36, 5)
QUIET = ("sky.background=false", "sky.planets=false", "sky.magnitude_limit=-2", "pointing.error_deg=0")


@pytest.fixture(scope="module")
def listed(tmp_path_factory):
    path = tmp_path_factory.mktemp("list") / "shell.tle"
    path.write_text(walker_tle(SHELL, EPOCH))
    return path


@pytest.fixture(scope="module")
def observed(listed, tmp_path_factory):
    """A renderer on the orbit of two-line elements at 500 km, and these elements."""
    own = walker_tle(Walker(500.0, 97.4, 1, 1, name="OWN"), EPOCH, 99_001)
    path = tmp_path_factory.mktemp("own") / "own.tle"
    path.write_text(own)
    return Renderer(scenario(listed, f"orbit.tle={path}")), own.splitlines()


def scenario(listed, *keys):
    return Scenario.load("cubesat_ideal", ["study.sampling=orbit", f"sky.satellites.file={listed}", *keys])


def skyfield_satellites(path):
    lines = path.read_text().splitlines()
    return {int(lines[k + 1][2:7]): EarthSatellite(*lines[k + 1 : k + 3]) for k in range(0, len(lines), 3)}


def at(t_s):
    return timescale().tt_jd(*CLOCK.tt_jd(t_s))


def skyfield_direction(own, other, t_s):
    """Apparent direction by Skyfield alone: light time, aberration and deflection."""
    earth = de421()["earth"]
    seen = (earth + own).at(at(t_s)).observe(earth + other).apparent().xyz.km
    return seen / np.linalg.norm(seen)


# ---------------------------------------------------------------------- orbits and directions
def test_positions_are_those_of_skyfield(listed):
    orbits, other = ElementList.read(listed, CLOCK, 30.0), skyfield_satellites(listed)
    t_s = np.array([0.0, 3600.0, 86_400.0])
    found = orbits.states(t_s, np.array([3, 500]))
    for row, number in enumerate((90_004, 90_501)):
        assert orbits.elements[(3, 500)[row]].number == str(number)
        expected = other[number].at(at(t_s))
        # TEME to GCRS: Skyfield's and ERFA's sidereal time and nutation differ by below 1 mas, 4 cm at 7000 km
        assert np.abs(found.r_km[row] - expected.xyz.km.T).max() < 1e-4
        assert np.abs(found.v_km_s[row] - expected.velocity.km_per_s.T).max() < 1e-7


def test_directions_are_those_of_skyfield(observed, listed):
    renderer, lines = observed
    own, others = EarthSatellite(*lines[1:3]), skyfield_satellites(listed)
    worst, shift, checked = [], [], 0
    for t_s in np.linspace(0.0, 5600.0, 30):
        near = renderer.scene(at_s=float(t_s)).satellites
        for k in range(len(near)):
            expected = skyfield_direction(own, others[int(near.number[k])], t_s)
            worst.append(math.dist(near.direction[k], expected))
            still = (others[int(near.number[k])] - own).at(at(t_s)).xyz.km
            shift.append(math.dist(still / np.linalg.norm(still), expected))
            checked += 1
    assert checked > 10
    # what light time and aberration move: the spacecraft's speed against the satellite's
    assert max(shift) > 5.0 * ARCSEC_RAD
    # 4 cm between the frames at 100 km or more is 0.08″, and the same for both, so that far less remains
    assert max(worst) < 0.005 * ARCSEC_RAD


def test_paths_are_those_of_skyfield(observed, listed):
    renderer, lines = observed
    own, others = EarthSatellite(*lines[1:3]), skyfield_satellites(listed)
    for exposure_s in (0.2, 10.0):
        checked, worst = 0, 0.0
        for middle_s in np.linspace(0.0, 5600.0, 20):
            near = renderer.scene(at_s=float(middle_s), exposure_s=exposure_s).satellites
            for k in range(len(near)):
                moments = np.array([-0.5, -0.2, 0.5]) * exposure_s
                found = Drift(near.path_km[k : k + 1]).at(moments[None])[0]
                expected = [skyfield_direction(own, others[int(near.number[k])], middle_s + t) for t in moments]
                worst = max(worst, float(np.linalg.norm(found - expected, axis=1).max()))
                ends = [skyfield_direction(own, others[int(near.number[k])], middle_s + t) for t in (-0.05, 0.05)]
                assert near.rate_rad_s[k] == pytest.approx(math.dist(*ends) / 0.1, rel=1e-5)
                checked += 1
        assert checked > 5
        assert worst < 0.005 * ARCSEC_RAD


def test_the_spacecraft_does_not_see_itself(observed, tmp_path):
    _, lines = observed
    path = tmp_path / "own.tle"
    path.write_text("\n".join(lines) + "\n")
    renderer = Renderer(scenario(path, f"orbit.tle={path}"))
    assert len(renderer.scene(at_s=100.0).satellites) == 0


# ---------------------------------------------------------------------- brightness
def test_the_phase_function_is_the_integral_over_the_sphere():
    """Light of the elements cos i cos e dΩ of a unit sphere that are lit and seen, towards the observer."""
    cosine, node = np.polynomial.legendre.leggauss(400)
    azimuth = (np.arange(800) + 0.5) * math.tau / 800
    sine = np.sqrt(1.0 - cosine**2)[:, None]
    normal = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.broadcast_to(cosine[:, None], (400, 800))])
    weight = node[:, None] * math.tau / 800
    phases = np.radians([0.0, 20.0, 57.3, 90.0, 120.0, 160.0, 175.0])
    for phase in phases:
        seen = np.maximum(normal[0], 0.0)
        lit = np.maximum(math.cos(phase) * normal[0] + math.sin(phase) * normal[1], 0.0)
        total = float(np.sum(seen * lit * weight)) / math.pi  # of the irradiance times a²/d², for albedo 1
        assert 2.0 / 3.0 * float(diffuse_phase(phase)) == pytest.approx(total, abs=1e-5)
    # a Lambertian Moon would be π times brighter than at its quarters
    assert float(diffuse_phase(0.0) / diffuse_phase(math.pi / 2)) == pytest.approx(math.pi, rel=1e-14)
    assert float(diffuse_phase(math.pi)) == pytest.approx(0.0, abs=1e-15)


def test_magnitudes_by_size_and_by_standard_magnitude(observed, listed):
    renderer, lines = observed
    own, others = EarthSatellite(*lines[1:3]), skyfield_satellites(listed)
    # Hejduk 2011: E = E_sun A ρ F / d² with the cross-section A and F = 2/(3 π²) [sin φ + (π − φ) cos φ]
    flux = math.pi * 0.5**2 * 0.175 * 2.0 / (3.0 * math.pi**2) / 1e12
    assert standard_magnitude(1.0, 0.175) == pytest.approx(-26.74 - 2.5 * math.log10(flux), abs=1e-12)
    keys = (f"orbit.tle={renderer.scenario.orbit.tle}", "sky.satellites.standard_magnitude=5.5")
    given = Renderer(scenario(listed, *keys))
    checked = 0
    for t_s in np.linspace(0.0, 5600.0, 30):
        near, bright = (r.scene(at_s=float(t_s)).satellites for r in (renderer, given))
        assert np.allclose(near.v_mag - bright.v_mag, standard_magnitude(1.0, 0.175) - 5.5, atol=1e-12)
        for k in range(len(near)):
            other = others[int(near.number[k])].at(at(t_s))
            to_camera = own.at(at(t_s)).xyz.km - other.xyz.km
            to_sun = (sun_position_au(CLOCK, t_s) - barycentric("Earth", at(t_s)).xyz.au) * AU_KM - other.xyz.km
            range_km, sun_au = np.linalg.norm(to_camera), np.linalg.norm(to_sun) / AU_KM
            phase = math.acos(to_camera @ to_sun / (range_km * sun_au * AU_KM))
            # SeeSat-L (Matson 2001): m = standard − 15 + 5 log range − 2.5 log(sin B + (π − B) cos B)
            magnitude = 5.5 - 15.0 + 5.0 * math.log10(range_km)
            magnitude -= 2.5 * math.log10(math.sin(phase) + (math.pi - phase) * math.cos(phase))
            # the aberration changes the phase by 1e-4
            assert bright.v_mag[k] == pytest.approx(magnitude + 5.0 * math.log10(sun_au), abs=5e-4)
            checked += 1
    assert checked > 10


def test_umbra_and_penumbra(listed):
    """The Sun's centre is hidden where Skyfield says so, and the light goes from 1 to 0 across its diameter."""
    orbits = ElementList.read(listed, CLOCK, 30.0)
    t_s = 1234.0
    r_km = orbits.states(np.array([t_s])).r_km[:, 0]
    sun_km = (sun_position_au(CLOCK, t_s) - barycentric("Earth", at(t_s)).xyz.au) * AU_KM
    share = sunlit_share(r_km, sun_km)
    lit = np.array([Geocentric(r / AU_KM, t=at(t_s)).is_sunlit(de421()) for r in r_km])
    assert 100 < lit.sum() < 620
    assert np.array_equal(share > 0.5, lit)
    # along the shadow's edge at 6928 km: the rays from the ends of the Sun's diameter
    sun, side = sun_km / np.linalg.norm(sun_km), np.cross(sun_km, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    angle = np.radians(np.linspace(112.0, 115.0, 601))  # from the Sun
    track = 6928.0 * (np.cos(angle)[:, None] * sun + np.sin(angle)[:, None] * side)
    share = sunlit_share(track, sun_km)
    assert share[0] == 1.0
    assert share[-1] == 0.0
    assert (np.diff(share) <= 1e-12).all()
    turning = np.flatnonzero((share > 0.0) & (share < 1.0))
    # a diameter of 2 arcsin(695,700 / 149e6) = 0.534° of the way
    width = angle[turning[-1]] - angle[turning[0]]
    assert width == pytest.approx(2.0 * math.asin(695_700.0 / np.linalg.norm(sun_km)), abs=np.radians(0.012))
    middle = np.interp(0.5, share[::-1], angle[::-1])
    edge = [bool(is_sunlit(CLOCK, t_s, r)) for r in track]
    assert middle == pytest.approx(angle[edge.index(False)], abs=np.radians(0.006))


def test_no_satellite_is_seen_through_the_earth():
    rng = np.random.default_rng(3)
    r_km = rng.normal(size=(4000, 3)) * 9000.0
    r_km = r_km[np.linalg.norm(r_km, axis=1) > 6400.0]
    camera_km = np.array([6878.0, 0.0, 0.0])
    part = np.linspace(0.0, 1.0, 2001)[:, None, None]
    lowest = np.linalg.norm(camera_km + part * (r_km - camera_km), axis=-1).min(axis=0)
    clear = np.abs(lowest - 6378.137) > 5.0  # the samples are up to 20 km apart
    hidden = behind_earth(r_km, camera_km)
    assert 500 < hidden.sum() < len(r_km) - 500
    assert np.array_equal(hidden[clear], (lowest < 6378.137)[clear])
    # nearer than the ground below, in front of the Earth's disk
    assert not behind_earth(np.array([[6678.0, 100.0, 0.0]]), camera_km)[0]


def test_satellites_in_shadow_or_behind_the_earth_are_not_in_the_truth(observed, listed):
    renderer, _ = observed
    half_rad = renderer.focal_plane.half_field_rad(0.2)
    orbits, found = ElementList.read(listed, CLOCK, 30.0), []
    for t_s in np.linspace(0.0, 5600.0, 8):
        scene = renderer.scene(at_s=float(t_s), attitude=Attitude.from_radec_roll(10.0 * t_s, -5.0, 0.0))
        r_km = orbits.states(np.array([t_s])).r_km[:, 0]
        away = r_km - scene.r_km
        cosine = away @ scene.pointing.camera.boresight / np.linalg.norm(away, axis=1)
        lit = np.array([is_sunlit(CLOCK, float(t_s), r) for r in r_km])
        seen = lit & ~behind_earth(r_km, scene.r_km)
        numbers = set(scene.satellites.number.tolist())
        well_inside = cosine > math.cos(half_rad)
        expected = {int(orbits.elements[k].number) for k in np.flatnonzero(seen & well_inside)}
        assert expected <= numbers  # those beyond come from outside the field during the exposure
        dark = {int(orbits.elements[k].number) for k in np.flatnonzero(~seen)}
        assert not dark & numbers
        found += list(expected)
    assert len(found) > 5


# ---------------------------------------------------------------------- images
def test_a_trail_is_as_long_as_rate_times_exposure(observed, listed):
    """The second moment along a uniform trail is L²/12 beyond that of the star image."""
    _, lines = observed
    own, others = EarthSatellite(*lines[1:3]), skyfield_satellites(listed)
    exposure_s = 0.5
    keys = (f"orbit.tle={observed[0].scenario.orbit.tle}", f"detector.exposure_s={exposure_s}", *QUIET)
    renderer, checked = Renderer(scenario(listed, *keys, "sky.satellites.diameter_m=30")), 0
    sigma_px = renderer.scenario.optics.psf.sigma_px
    for t_s in np.linspace(0.0, 5600.0, 40):
        scene = renderer.scene(at_s=float(t_s))
        light = renderer.expose(scene)
        trails = np.flatnonzero(light.sources.kind == "satellite")
        ends = {}
        for k in trails:
            other = others[int(light.sources.id[k])]
            # the camera turns meanwhile: the attitude at either end
            for sign in (-0.5, 0.5):
                turn = scene.pointing.rate_camera_rad_s * sign * exposure_s
                turned = Attitude.from_rotation_vector(turn, "camera", "camera") @ scene.pointing.camera
                direction = skyfield_direction(own, other, t_s + sign * exposure_s)
                ends[k, sign] = renderer.camera.project(turned.apply(direction[None]))[0]
        inside = [all(renderer.camera.contains(ends[k, s][None], -12.0)[0] for s in (-0.5, 0.5)) for k in trails]
        if len(trails) != 1 or not all(inside):
            continue
        k, image = trails[0], light.mean_e
        along = ends[k, 0.5] - ends[k, -0.5]
        length = math.hypot(*along)
        y, x = np.indices(image.shape)
        total = image.sum()
        centre = np.array([(x * image).sum(), (y * image).sum()]) / total
        measured = ((x - centre[0]) * along[0] + (y - centre[1]) * along[1]) / length
        variance = (measured**2 * image).sum() / total - sigma_px**2 - 1.0 / 12.0  # of the image and of the pixel
        assert math.sqrt(12.0 * variance) == pytest.approx(length, rel=0.003)
        assert centre == pytest.approx((ends[k, 0.5] + ends[k, -0.5]) / 2.0, abs=0.02)
        assert centre == pytest.approx(light.sources.image_xy[k], abs=0.02)
        assert total == pytest.approx(light.sources.electrons[k], rel=1e-3)
        checked += 1
        if checked >= 3 and length > 5.0:
            break
    assert checked >= 3


def test_a_source_at_rest_drifts_as_a_star(observed):
    """Paths of a constant direction, with roll and jitter off, are those of stars to rounding."""
    camera, rate = observed[0].camera, np.array([0.01, -0.02, 0.3])
    directions = camera.unproject(np.array([[100.0, 200.0], [900.0, 30.0]]))
    drift = Drift(np.concatenate([directions[:, None] * 700.0, np.zeros((2, 4, 3))], axis=1))
    found, weights = drifting_paths(camera, drift, rate, 0.2)
    expected, star_weights = star_paths(camera, directions, rate, 0.2)
    assert len(weights) == pytest.approx(len(star_weights), abs=1)
    ends = [np.array([path[0, 0], path[0, -1]]) for path in (found, expected)]
    assert np.abs(ends[0] - ends[1]).max() < 0.3  # the nodes next to the ends
    assert weights @ found[0] == pytest.approx(star_weights @ expected[0], abs=1e-6)


@pytest.mark.parametrize("shutter", [(), ("detector.shutter=rolling", "detector.line_time_us=50")])
def test_a_frame_with_satellites_elsewhere_is_the_same(observed, listed, shutter):
    """No random number depends on them, and no pixel of a frame that they do not reach."""
    keys = (f"orbit.tle={observed[0].scenario.orbit.tle}", *shutter)
    with_list = Renderer(scenario(listed, *keys))
    without = Renderer(Scenario.load("cubesat_ideal", ["study.sampling=orbit", *keys]))
    counts = []
    for index in range(6):
        (frame, truth), (plain, plain_truth) = with_list.frame(index), without.frame(index)
        counts.append(int((truth.sources.kind == "satellite").sum()))
        assert np.array_equal(frame.image, plain.image) == (counts[-1] == 0)
        stars = truth.sources.select(np.flatnonzero(truth.sources.kind != "satellite"))
        assert np.array_equal(stars.electrons, plain_truth.sources.electrons)
    assert min(counts) == 0 < max(counts)


def test_the_truth_table_flags_satellites(observed, tmp_path):
    renderer, _ = observed
    for index in range(20):
        frame, truth = renderer.frame(index)
        if (truth.sources.kind == "satellite").any():
            break
    write_fits(tmp_path / "frame.fits", frame, truth)
    table = Table.read(tmp_path / "frame.fits", hdu="TRUTH")
    rows = table[table["kind"] == "satellite"]
    assert len(rows)
    assert rows["id"][0] > 90_000
    assert rows["name"][0].startswith("WALKER")
    assert np.isfinite(rows["v_mag"]).all()
    assert (rows["electrons"] > 0).all()


# ---------------------------------------------------------------------- files and their mistakes
OMM = """CCSDS_OMM_VERS = 2.0
CREATION_DATE = 2026-03-21T00:00:00
ORIGINATOR = TEST
OBJECT_NAME = WALKER 01-01
OBJECT_ID = 2026-000A
CENTER_NAME = EARTH
REF_FRAME = TEME
TIME_SYSTEM = UTC
MEAN_ELEMENT_THEORY = SGP4
EPOCH = 2026-03-21T12:00:00
MEAN_MOTION = 15.05490646
ECCENTRICITY = 0
INCLINATION = 53
RA_OF_ASC_NODE = 0
ARG_OF_PERICENTER = 0
MEAN_ANOMALY = 0
NORAD_CAT_ID = 90001
BSTAR = 0
"""


def test_a_list_of_omm_is_the_same_list(listed, tmp_path):
    path = tmp_path / "one.omm"
    path.write_text(OMM)
    one, all_of_them = (ElementList.read(p, CLOCK, 30.0) for p in (path, listed))
    t_s = np.array([0.0, 5000.0])
    assert np.abs(one.states(t_s).r_km[0] - all_of_them.states(t_s, np.array([0])).r_km[0]).max() < 1e-5


def test_sets_before_and_after_a_leap_second(tmp_path):
    """Elements of 31 December 2016 and 2 January 2017, between which UTC had a leap second."""
    days = [datetime(2016, 12, 31, 12, tzinfo=UTC), datetime(2017, 1, 2, 12, tzinfo=UTC)]
    text = "".join(walker_tle(Walker(550.0, 53.0, 1, 1), day, 90_001 + k) for k, day in enumerate(days))
    path = tmp_path / "leap.tle"
    path.write_text(text)
    clock = Clock(days[0])
    orbits, t_s = ElementList.read(path, clock, 30.0), np.array([86_400.0])
    time = timescale().tt_jd(*clock.tt_jd(t_s))
    lines = text.splitlines()
    for row, line in enumerate((1, 4)):
        # Skyfield takes the difference of UTC dates, and is a second, 7.6 km, off where a leap second is between them
        expected = EarthSatellite(*lines[line : line + 2]).at(time).xyz.km.T
        error_km = np.linalg.norm(orbits.states(t_s).r_km[row] - expected)
        assert error_km == pytest.approx((7.6, 0.0)[row], abs=0.1)


def test_the_nearest_set_of_an_object_and_a_decayed_one(tmp_path):
    days = [datetime(2026, 3, day, 12, tzinfo=UTC) for day in (1, 20, 30)]
    text = "".join(walker_tle(Walker(550.0, 53.0, 1, 1), day) for day in days)
    falling = walker_tle(Walker(120.0, 53.0, 1, 1, name="FALLING"), EPOCH, 90_007).splitlines()
    # a drag term of 0.9: re-entry within a day
    first = falling[1][:53] + " 90000+0" + falling[1][61:68]
    digit = sum(int(c) if c.isdigit() else c == "-" for c in first) % 10
    path = tmp_path / "sets.tle"
    path.write_text("\n".join([text.rstrip(), falling[0], f"{first}{digit}", falling[2]]) + "\n")
    assert len(read_elements(path)) == 4
    orbits = ElementList.read(path, CLOCK, 30.0)
    assert len(orbits) == 2
    assert orbits.epoch_s[0] == pytest.approx(-86_400.0, abs=0.01)
    states = orbits.states(np.array([86_400.0]))
    assert np.isfinite(states.r_km[0]).all()
    assert np.isnan(states.r_km[1]).all()
    assert len(Renderer(scenario(path)).scene(at_s=86_400.0).satellites) <= 1


def test_sizes_of_single_objects(listed):
    given = "[{object: WALKER 01-02, diameter_m: 10}, {object: 90003, standard_magnitude: 3.5}]"
    found = Renderer(scenario(listed, f"sky.satellites.objects={given}")).scenes.satellites
    assert found.standard_magnitude[:4] == pytest.approx(
        [standard_magnitude(d, 0.175) if d else 3.5 for d in (1.0, 10.0, None, 1.0)], abs=1e-12
    )
    assert found.radius_km[:3] == pytest.approx([0.0005, 0.005, 0.0005])


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        (("sky.satellites.objects=[{object: VANGUARD, diameter_m: 2}]",), r"has no object VANGUARD"),
        (
            ("sky.satellites.max_age_days=0.01",),
            r"shell.tle:2: the elements of WALKER 01-01 are of 2026-03-21T12:00:00",
        ),
    ],
)
def test_mistakes_of_lists(listed, keys, message):
    with pytest.raises(InputError, match=message):
        Renderer(scenario(listed, *keys)).scene(at_s=5000.0)


def test_a_damaged_list_is_an_error_of_the_scenario_with_file_and_line(listed, tmp_path):
    from simulator.checks import load_scenario

    lines = listed.read_text().splitlines()
    lines[4] = lines[4][:20] + "9" + lines[4][21:]
    path = tmp_path / "damaged.tle"
    path.write_text("\n".join(lines))
    with pytest.raises(InputError, match=r"sky.satellites.file: .*damaged.tle:5: check digit"):
        load_scenario("cubesat_ideal", [f"sky.satellites.file={path}"])
    path.write_text("\n")
    with pytest.raises(InputError, match=r"damaged.tle: has no elements"):
        load_scenario("cubesat_ideal", [f"sky.satellites.file={path}"])
    with pytest.raises(InputError, match=r"missing.tle: cannot be read"):
        load_scenario("cubesat_ideal", [f"sky.satellites.file={tmp_path / 'missing.tle'}"])


def test_a_satellite_that_passes_closer_than_its_path_is_near():
    """Within the distance that it covers during the exposure its direction turns by up to 90°: at 2 km, with 10 km/s,
    it is listed across the boresight in 0.5 s, and 30° from it at most in 0.1 s; those at 1000 km are not, nor the
    spacecraft itself."""
    from simulator.mission.trajectory import States
    from simulator.sky.satellites import Look, SatelliteList

    class Rows(SatelliteList):
        def _seen(self, rows, *_):
            return rows.tolist()

    def states(r_km, v_km_s):
        return lambda t_s: States(np.array(r_km, dtype=float), np.array(v_km_s, dtype=float))

    own = states([[42000.0, 0.0, 0.0]], [[0.0, 3.0, 0.0]])
    others = SimpleNamespace(
        states=states(
            [[[42002.0, 0.0, 0.0]], [[43000.0, 0.0, 0.0]], [[41000.0, 0.0, 0.0]], [[42000.0, 0.0, 0.0]]],
            [[[0.0, -7.0, 0.0]]] * 4,
        )
    )
    satellites = Rows(others, np.zeros(4), np.full(4, 1e-3))
    direction = np.array([0.0, 0.0, 1.0])
    look = Look(0.0, 0.5, own, (0.0, 1.0), np.zeros(3), np.array([0.0, 1.5e8, 0.0]), direction, 0.1)
    dark = SimpleNamespace(earth=False)
    assert satellites.near(look, dark) == [0]
    assert satellites.near(look._replace(exposure_s=0.1), dark) == []
