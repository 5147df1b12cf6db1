"""The ``orbit`` section: what defines it, its files and their mistakes, spans, and what a process pool needs of it."""

import math
import pickle
import warnings
from datetime import UTC, datetime

import numpy as np
import pytest

from simulator import Scenario
from simulator.build import build_orbit
from simulator.checks import NAME_CHECKS, load_scenario
from simulator.cli import _run
from simulator.mission.clock import Clock
from simulator.mission.parameters import ForceModel, KeplerianElements, OrbitParameters, StateVector
from simulator.mission.sampling import trial_time_s
from simulator.mission.trajectories import build_trajectory
from simulator.mission.trajectory import UNLIMITED, Trajectory, from_earth
from startracker.errors import InputError, InputWarning

EPOCH = datetime(2026, 3, 21, 12, tzinfo=UTC)
CLOCK = Clock(EPOCH)
MOLNIYA = KeplerianElements(26_600.0, 0.72, 63.4, 10.0, 270.0, 30.0)
TLE = """VANGUARD 1
1 00005U 58002B   00179.78495062  .00000023  00000-0  28098-4 0  4753
2 00005  34.2682 348.7242 1859667 331.7664  19.3264 10.82419157413667
"""
OMM = """CCSDS_OMM_VERS = 2.0
CREATION_DATE = 2000-06-28T00:00:00
ORIGINATOR = TEST
OBJECT_NAME = VANGUARD 1
OBJECT_ID = 1958-002B
CENTER_NAME = EARTH
REF_FRAME = TEME
TIME_SYSTEM = UTC
MEAN_ELEMENT_THEORY = SGP4
EPOCH = 2000-06-27T18:50:19.733568
MEAN_MOTION = 10.82419157 [rev/day]
ECCENTRICITY = 0.1859667
INCLINATION = 34.2682 [deg]
RA_OF_ASC_NODE = 348.7242 [deg]
ARG_OF_PERICENTER = 331.7664
MEAN_ANOMALY = 19.3264
NORAD_CAT_ID = 5
BSTAR = 0.000028098
"""
META = """CCSDS_OEM_VERS = 2.0
CREATION_DATE = 2026-03-21T00:00:00
ORIGINATOR = TEST
META_START
OBJECT_NAME = CRAFT
OBJECT_ID = 2026-001A
CENTER_NAME = EARTH
REF_FRAME = ICRF
TIME_SYSTEM = UTC
START_TIME = 2026-03-21T12:00:00
STOP_TIME = 2026-03-21T12:04:00
META_STOP
"""


def table(count=5, step_s=60.0):
    orbit = build_trajectory(OrbitParameters(elements=MOLNIYA, propagator="kepler"), EPOCH)
    t_s = np.arange(count) * step_s
    return t_s, np.concatenate(orbit.state(t_s), axis=1)


def oem(edit=lambda lines: lines):
    t_s, rows = table()
    lines = META.splitlines()
    lines += [f"{CLOCK.isot(t)} {' '.join(f'{x:.6f}' for x in row)}" for t, row in zip(t_s, rows, strict=True)]
    return "\n".join(edit(lines)) + "\n"


def csv():
    t_s, rows = table()
    header = "utc,x_km,y_km,z_km,vx_km_s,vy_km_s,vz_km_s"
    lines = [f"{CLOCK.isot(t)},{','.join(f'{x:.6f}' for x in row)}" for t, row in zip(t_s, rows, strict=True)]
    return "# a table\n" + "\n".join([header, *lines]) + "\n"


def replaced(old, new):
    def edit(lines):
        assert any(old in line for line in lines)
        return [line.replace(old, new) for line in lines]

    return edit


def build(tmp_path, key, text, **others):
    path = tmp_path / f"craft.{key}"
    path.write_text(text)
    return build_trajectory(OrbitParameters(**{key: str(path)}, **others), others.pop("epoch", EPOCH))


SECTIONS = [
    OrbitParameters(),
    OrbitParameters(propagator="sgp4"),
    OrbitParameters(propagator="numerical"),
    OrbitParameters(elements=MOLNIYA),
    OrbitParameters(elements=MOLNIYA, propagator="kepler"),
    OrbitParameters(elements=KeplerianElements(2_000.0, 0.01, 90.0), centre="Moon"),
    OrbitParameters(elements=KeplerianElements(1.6e8, 0.1, 2.0), centre="Sun", propagator="numerical"),
    OrbitParameters(state=StateVector((42_164.0, 0.0, 0.0), (0.0, 3.0747, 0.0)), forces=ForceModel(2, False)),
]


@pytest.mark.parametrize("section", SECTIONS, ids=lambda s: f"{s.source}-{s.propagator}-{s.centre}")
def test_instants_alone_and_together_and_pickled(section):
    orbit = build_trajectory(section, EPOCH)
    assert isinstance(orbit, Trajectory)
    assert orbit.centre == section.centre
    t_s = np.array([[0.0, 17.25, 5e4], [1e5, -1e5, 3e5]])
    r, v = orbit.state(t_s)
    assert r.shape == v.shape == (2, 3, 3)
    copy = pickle.loads(pickle.dumps(orbit))
    np.testing.assert_array_equal(copy.state(t_s), (r, v))
    assert copy.period_s == orbit.period_s
    size = np.abs(r).max()
    for index in np.ndindex(2, 3):
        alone = orbit.state(float(t_s[index]))
        assert alone[0].shape == alone[1].shape == (3,)
        np.testing.assert_allclose(alone[0], r[index], rtol=0, atol=1e-14 * size + 1e-8)
    assert orbit.state(np.zeros(0))[0].shape == (0, 3)
    # velocity is the derivative: by central differences of 1 s, n² h²/6 of it; J2's cross-track term is left out
    middle = (orbit.state(1001.0)[0] - orbit.state(999.0)[0]) / 2.0
    speed = np.linalg.norm(orbit.state(1000.0)[1])
    assert np.linalg.norm(middle - orbit.state(1000.0)[1]) < 3e-4 * speed


def test_files_of_all_kinds_give_the_same_states(tmp_path):
    t_s, rows = table()
    for key, text in (("oem", oem()), ("csv", csv())):
        trajectory = build(tmp_path, key, text)
        found = np.concatenate(trajectory.state(t_s), axis=1)
        np.testing.assert_allclose(found, rows, rtol=0, atol=1e-6)
        between = np.concatenate(trajectory.state(t_s[:-1] + 30.0), axis=1)
        two_bodies = build_trajectory(OrbitParameters(elements=MOLNIYA, propagator="kepler"), EPOCH)
        expected = np.concatenate(two_bodies.state(t_s[:-1] + 30.0), axis=1)
        np.testing.assert_allclose(between, expected, rtol=0, atol=3e-5)  # velocities of 6 decimals, over 30 s
    in_seconds = csv().replace("utc", "t_s")
    for t in t_s:
        in_seconds = in_seconds.replace(CLOCK.isot(t), str(t))
    np.testing.assert_allclose(build(tmp_path, "csv", in_seconds).state(t_s)[0], rows[:, :3], rtol=0, atol=1e-6)


def test_tle_and_omm_are_the_same_orbit(tmp_path):
    epoch = datetime(2000, 6, 28, tzinfo=UTC)
    for key, text in (("tle", TLE), ("omm", OMM)):
        (tmp_path / f"v.{key}").write_text(text)
    orbits = [
        build_trajectory(OrbitParameters(**{key: f"v.{key}"}, object=5), epoch, tmp_path) for key in ("tle", "omm")
    ]
    t_s = np.linspace(0.0, 1e5, 20)
    # OMM has B* to five digits as the TLE, and the epoch to 1 µs: 8 mm
    np.testing.assert_allclose(orbits[0].state(t_s)[0], orbits[1].state(t_s)[0], rtol=0, atol=2e-5)
    assert orbits[0].period_s == pytest.approx(1440 * 60 / 10.824, rel=2e-3)


@pytest.mark.parametrize(
    ("key", "text", "message"),
    [
        ("tle", TLE.replace("4753", "4754"), r"craft\.tle:2: check digit 4, but the line adds up to 3"),
        ("tle", "\n".join(TLE.splitlines()[:2]), r"craft\.tle:2: the set of elements ends after line 1.*truncated"),
        ("tle", TLE.splitlines()[2], r"craft\.tle:1: line 2 of a set without its line 1"),
        ("tle", "VANGUARD\nno elements\n", r"craft\.tle:2: is not a line of two-line elements"),
        ("tle", TLE.replace("34.2682", "34.26x2").replace("413667", "413665"), r"craft\.tle:3: "),
        ("tle", "", r"craft\.tle: choose one of its objects"),
        ("omm", OMM.replace("= TEME", "= ICRF"), r"craft\.omm:7: REF_FRAME is ICRF; SGP4 needs TEME"),
        ("omm", OMM.replace("34.2682 [deg]", "x"), r"craft\.omm:13: INCLINATION is 'x', which is not a number"),
        ("omm", "\n".join(OMM.splitlines()[:12]), r"craft\.omm: the message has no BSTAR; it is incomplete"),
        ("omm", "hello\n", r"craft\.omm:1: no CCSDS OMM"),
        ("oem", oem(lambda lines: [*lines[:-1], lines[-1][:60]]), r"craft\.oem:17: a line has an epoch and 6"),
        ("oem", oem(lambda lines: lines[:8]), r"craft\.oem:8: the file ends before META_STOP; it is truncated"),
        ("oem", oem(lambda lines: lines[:12]), r"craft\.oem:4: the segment has no states"),
        ("oem", oem(replaced("CENTER_NAME = EARTH", "CENTER_NAME = CERES")), r"craft\.oem:7: centre CERES is not supp"),
        ("oem", oem(replaced("REF_FRAME = ICRF", "REF_FRAME = RTN")), r"craft\.oem:8: frame RTN is not supported"),
        ("oem", oem(replaced("= UTC", "= LOCAL")), r"craft\.oem:13: time scale 'LOCAL' cannot be read"),
        ("oem", oem(replaced("OBJECT_ID = 2026-001A", "")), r"craft\.oem:4: the metadata has no OBJECT_ID"),
        ("oem", oem(replaced("T12:02:00.000 ", "T12:01:00.000 ")), r"craft\.oem:15: the epoch is not after"),
        ("oem", oem(replaced("T12:02:00.000 ", "T12:61:00.000 ")), r"craft\.oem:15: .* is not a date and time of UTC"),
        ("oem", oem(replaced("T12:02:00.000 ", "T12.02 ")), r"craft\.oem:15: .* is not an epoch"),
        (
            "oem",
            oem(replaced("META_STOP", "INTERPOLATION = HERMITE\nINTERPOLATION_DEGREE = 6\nMETA_STOP")),
            r"craft\.oem:13: HERMITE of degree 6 is impossible",
        ),
        ("oem", "<oem><body></oem>", r"craft\.oem:1: damaged or truncated XML"),
        ("oem", "<oem><body>", r"craft\.oem:1: damaged or truncated XML"),
        ("oem", "<opm><body/></opm>", r"craft\.oem:1: no CCSDS OEM; it has no element <oem>"),
        ("csv", csv().replace("vz_km_s", "vz"), r"craft\.csv:2: columns are missing: vz_km_s"),
        ("csv", csv().replace("utc", "when"), r"craft\.csv:2: columns are missing: utc or t_s"),
        ("csv", csv().rstrip()[:-30], r"craft\.csv:7: 4 of 7 columns; is the file truncated"),
        ("csv", csv().replace("T12:02", "T12:00"), r"craft\.csv:5: the time is not after the one before"),
        ("csv", csv().replace(",1", ",x1"), r"craft\.csv:\d: .* which is not a finite number"),
        ("csv", "", r"craft\.csv:1: columns are missing: utc or t_s"),
        ("spk", "no kernel at all", r"craft\.spk: is not an SPK kernel, or is truncated"),
    ],
)  # fmt: skip
def test_bad_files_are_named_with_their_line(tmp_path, key, text, message):
    with pytest.raises(InputError, match=message) as error:
        build(tmp_path, key, text).state(0.0)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("key", ["tle", "omm", "oem", "spk", "csv"])
def test_missing_and_binary_files(tmp_path, key):
    with pytest.raises(InputError, match=r"nowhere.*cannot be read"):
        build_trajectory(OrbitParameters(**{key: "nowhere"}), EPOCH, tmp_path)
    (tmp_path / "binary").write_bytes(b"\xff\xfe\x00\x80" * 300)
    with pytest.raises(InputError, match=r"binary: is (not text|not an SPK kernel)"):
        build_trajectory(OrbitParameters(**{key: "binary"}), EPOCH, tmp_path)


def test_every_truncation_of_a_file_is_an_error_or_the_whole(tmp_path):
    """Cut after any character, an OEM is refused in one line, or ends at its last whole state with a line that asks
    whether it is truncated, unless only the end of its last number is lost."""
    text = oem()
    for cut in range(1, len(text.rstrip()) - 6, 7):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                whole = build(tmp_path, "oem", text[:cut])
                assert whole.span_s[1] <= 180.0 + 2e-6
                told = [str(warning.message) for warning in caught]
                assert len(told) == 1
                assert "do not reach STOP_TIME" in told[0]
            except InputError as error:
                told = [str(error)]
        assert "\n" not in told[0]
        assert "craft.oem" in told[0]


def test_nothing_extrapolates(tmp_path):
    for key, text in (("oem", oem()), ("csv", csv())):
        trajectory = build(tmp_path, key, text)
        assert trajectory.span_s == pytest.approx((0.0, 240.0), abs=2e-6)
        for t_s in (-0.01, 240.01, math.nan):
            with pytest.raises(
                InputError, match=r"craft.*covers 2026-03-21T12:00:00.000 to 2026-03-21T12:04:00.000 UTC"
            ):
                trajectory.state(np.array([100.0, t_s]))
    with pytest.raises(InputError, match=r"craft.tle:2: .*max_age_days = 30 covers 2000-05-28T18:50:19.734 to"):
        build(tmp_path, "tle", TLE).state(0.0)


def test_gap_between_segments(tmp_path):
    whole = oem()
    later = whole.replace("T12:", "T13:").partition("META_START")[2]
    trajectory = build(tmp_path, "oem", whole + "META_START" + later)
    assert trajectory.span_s == pytest.approx((0.0, 3840.0), abs=2e-6)
    trajectory.state(np.array([10.0, 3700.0]))
    with pytest.raises(InputError, match=r"no states from 2026-03-21T12:04:00.000 to 2026-03-21T13:00:00.000 UTC"):
        trajectory.state(np.array([10.0, 300.0]))


def test_usable_span_of_a_segment(tmp_path):
    edit = replaced("STOP_TIME = 2026-03-21T12:04:00", "STOP_TIME = 2026-03-21T12:04:00\n"
                    "USEABLE_START_TIME = 2026-03-21T12:01:00\nUSEABLE_STOP_TIME = 2026-080T12:03:00")  # fmt: skip
    assert build(tmp_path, "oem", oem(edit)).span_s == pytest.approx((60.0, 180.0), abs=2e-6)


def test_several_objects_need_a_choice(tmp_path):
    both = oem() + oem().partition("META_START")[1] + oem().partition("META_START")[2].replace("CRAFT", "OTHER")
    with pytest.raises(InputError, match=r"choose one of its objects by orbit.object: CRAFT \(2026-001A\), OTHER"):
        build(tmp_path, "oem", both)
    assert len(build(tmp_path, "oem", both, object="OTHER").segments) == 1
    two = TLE + TLE.replace("00005", "00006").replace("4753", "4754").replace("413667", "413668")
    epoch = datetime(2000, 6, 28, tzinfo=UTC)
    path = tmp_path / "two.tle"
    path.write_text(two)
    with pytest.raises(InputError, match=r"choose one of its objects by orbit.object: 5 VANGUARD 1, 6 VANGUARD 1"):
        build_trajectory(OrbitParameters(tle=str(path)), epoch)
    assert build_trajectory(OrbitParameters(tle=str(path), object=6), epoch).elements.number == "6"


# ---------------------------------------------------------------- scenarios
@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["orbit.tle=a.tle", "orbit.oem=b.oem"], r"orbit.oem: the orbit is already defined by orbit.tle"),
        (["orbit.state.position_km=[7000,0,0]"], r"orbit.state.velocity_km_s: a state vector needs both"),
        (["orbit.elements={semi_major_axis_km: 6600, eccentricity: 0.1}"], r"periapsis is at a height of -438"),
        (["orbit.state={position_km: [0,0,42164], velocity_km_s: [1,0,0]}"], r"velocity_km_s: .* height of -4024 km"),
        (["orbit.elements.semi_major_axis_km=9000", "orbit.propagator=sgp4"], r"sgp4 is not for these elements"),
        (["orbit.propagator=kepler"], r"kepler is not for a circular orbit; use auto or j2 or sgp4 or numerical"),
        (["orbit.centre=Sun"], r"orbit.centre: circular orbits are around the Earth"),
        (["orbit.elements.eccentricity=1.0"], r"orbit.elements.eccentricity: must be a number from 0 to below 1"),
        (["study.sampling=span"], r"study.sampling: span is for orbits and attitudes that"),
    ],
)  # fmt: skip
def test_contradictions_of_the_section(overrides, message):
    with pytest.raises(InputError, match=message):
        Scenario.load("cubesat_ideal", overrides=overrides)


def test_files_are_found_beside_the_scenario(tmp_path):
    folder = tmp_path / "mission"
    folder.mkdir()
    (folder / "craft.oem").write_text(oem())
    scenario = folder / "s.yaml"
    scenario.write_text("base: cubesat_ideal\norbit: {oem: craft.oem}\nstudy: {sampling: span}\n")
    loaded = load_scenario(scenario)
    assert loaded.files()["orbit.oem"] == folder / "craft.oem"
    assert "orbit of craft.oem" in loaded.orbit.described
    t_s = trial_time_s("span", 1, np.arange(100), 1.0, build_orbit(loaded).span_s)
    assert 0.0 <= t_s.min() < 10.0
    assert 230.0 < t_s.max() <= 240.0
    (folder / "craft.oem").write_text(oem(lambda lines: lines[:-1]))
    with pytest.warns(InputWarning, match=r"craft.oem:16: the states do not reach STOP_TIME"):
        assert build_orbit(load_scenario(scenario)).span_s[1] == pytest.approx(180.0, abs=2e-6)
    (folder / "craft.oem").write_text(oem(lambda lines: [*lines[:-1], lines[-1][:60]]))
    with pytest.raises(InputError, match=r"s.yaml:2:\d+: orbit.oem: .*craft.oem:17: a line has an epoch and 6"):
        load_scenario(scenario)
    assert "orbit.oem" in NAME_CHECKS


def test_a_warning_of_a_file_is_printed_once_a_command(tmp_path, capsys):
    """The check of a scenario reads the file, and its frame again."""
    (tmp_path / "craft.oem").write_text(oem(lambda lines: lines[:-1]))
    (tmp_path / "s.yaml").write_text("base: cubesat_ideal\norbit: {oem: craft.oem}\nstudy: {sampling: span}\n")
    assert _run(["render", str(tmp_path / "s.yaml"), "--out", str(tmp_path / "frame.fits")]) == 0
    printed = capsys.readouterr().err.splitlines()
    assert [line.partition("craft.oem:16: ")[2][:26] for line in printed] == ["the states do not reach ST"]


def test_sampling_says_what_does_not_apply():
    index = np.arange(3)
    with pytest.raises(InputError, match="orbit: the trajectory is not a closed orbit; use mission_year or span"):
        trial_time_s("orbit", 1, index, math.inf)
    with pytest.raises(InputError, match="span: the trajectory has no end; use mission_year or orbit"):
        trial_time_s("span", 1, index, 6000.0, UNLIMITED)
    with pytest.raises(InputError, match="span: the trajectory ends before the epoch"):
        trial_time_s("span", 1, index, 6000.0, (-100.0, -10.0))


def test_geocentric_states_of_other_centres():
    orbit = build_trajectory(OrbitParameters(elements=KeplerianElements(1.6e8, 0.1, 2.0), centre="Sun"), EPOCH)
    t_s = np.array([0.0, 1e6])
    r, v = orbit.state(t_s)
    seen = from_earth(orbit, t_s, r, v)
    assert 1e7 < np.linalg.norm(seen.r_km[0]) < 3.3e8
    assert np.linalg.norm(seen.v_km_s[0]) < 65.0
