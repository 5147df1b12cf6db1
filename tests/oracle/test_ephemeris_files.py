"""Ephemeris files against independent readers and writers: SpiceyPy (NAIF's CSPICE) for SPK, the packages ``oem``
(KVN and XML, with its own interpolation) and ``ccsds-ndm-py`` (OEM, AEM and ACM), Skyfield for frames.

Tolerances: SpiceyPy reads the same doubles with the same polynomials, so that 1e-12 is left for their rounding.
"""

import math
from datetime import UTC, datetime

import ccsds_ndm
import numpy as np
import oem as oem_package
import pytest
import spiceypy
from astropy.time import Time, TimeDelta
from skyfield.api import load
from skyfield.framelib import ICRS_to_J2000, itrs
from skyfield.positionlib import Geocentric
from skyfield.sgp4lib import TEME

from simulator import Scenario
from simulator.build import build_orbit
from simulator.mission.clock import Clock
from simulator.mission.elliptic import EllipticOrbit
from simulator.mission.epochs import elapsed_s, tdb_seconds
from simulator.mission.frames import states_to_gcrs, to_frame
from simulator.mission.interpolation import StateTable
from simulator.mission.kepler import Elements
from simulator.mission.oem import read_oem
from simulator.mission.spk import read_spk
from simulator.study.sequence.run import run_sequence
from startracker.core import AU_KM
from startracker.ephemeris import de421_file

EPOCH = datetime(2026, 3, 21, 12, tzinfo=UTC)
CLOCK = Clock(EPOCH)
TARGET, STEP_S = -31_415, 120.0
TIMESCALE = load.timescale(builtin=True)
ORBIT = EllipticOrbit(Elements(9_000.0, 0.2, 1.0, 2.0, 3.0, 0.0), CLOCK, frame="icrf", j2=False)


def states(t_s):
    return np.concatenate(ORBIT.state(t_s), axis=1)


# ---------------------------------------------------------------- SPK
def write_spk(path, kind, centre=399, frame="J2000"):
    """A kernel of 200 states every two minutes, written by CSPICE; times are TDB seconds after J2000."""
    et = round(tdb_seconds(CLOCK, np.zeros(1))[0]) + np.arange(200) * STEP_S
    table = states(np.arange(200) * STEP_S)
    handle = spiceypy.spkopn(str(path), "a test", 0)
    common = (handle, TARGET, centre, frame, et[0], et[-1], "segment")
    if kind in (8, 12):
        write = spiceypy.spkw08 if kind == 8 else spiceypy.spkw12
        write(*common, 9, len(et), table, et[0], STEP_S)
    elif kind in (9, 13):
        write = spiceypy.spkw09 if kind == 9 else spiceypy.spkw13
        write(*common, 9, len(et), table, et)
    else:
        fitted = fitted_chebyshev(et, table[:, :3] if kind == 2 else table)
        write = spiceypy.spkw02 if kind == 2 else spiceypy.spkw03
        write(*common, 10 * STEP_S, 20, 9, fitted, et[0])
    spiceypy.spkcls(handle)
    return et


def fitted_chebyshev(et, table):
    """Coefficients (intervals, columns, 10) of intervals of ten steps; how well they fit does not matter."""
    at = np.linspace(-1.0, 1.0, 11)
    fits = [np.polynomial.chebyshev.chebfit(at, table[k : k + 11], 9).T for k in range(0, len(et) - 10, 10)]
    return np.array([*fits, fits[-1]]).ravel()


@pytest.mark.parametrize("kind", [2, 3, 8, 9, 12, 13])
def test_spk_as_spice_reads_it(kind, tmp_path):
    path = tmp_path / "craft.bsp"
    et = write_spk(path, kind)
    (segment,) = read_spk(path, CLOCK, TARGET, "Earth").segments
    at = np.sort(np.random.default_rng(kind).uniform(et[0], et[-1], 300))
    at = np.concatenate([et[[0, 1, 50, -2, -1]], at])
    spiceypy.furnsh(str(path))
    try:
        expected = np.array([spiceypy.spkezr(str(TARGET), x, "J2000", "NONE", "399")[0] for x in at])
    finally:
        spiceypy.kclear()
    found = segment.table.table.state(at)
    for columns in (slice(3), slice(3, 6)):
        size = np.linalg.norm(expected[:, columns], axis=1).max()
        assert np.abs(found[:, columns] - expected[:, columns]).max() < 1e-12 * size


def test_spk_times_frames_and_centres(tmp_path):
    """ET of SPICE's leap seconds and TDB − TT is within 30 µs of ERFA's (SPICE's *Time Required Reading*): 0.2 m at 8
    km/s. The ecliptic is a constant rotation."""
    path = tmp_path / "craft.bsp"
    et = write_spk(path, 13, frame="ECLIPJ2000")
    trajectory = read_spk(path, CLOCK, None, "Earth")
    t_s = np.linspace(100.0, 20_000.0, 50)
    # SPICE's own TDB − TT: K sin(M + e sin M), with the constants of its leap-second kernel naif0012.tls
    tt = (CLOCK.tt_jd(0.0)[0] - 2_451_545.0 + CLOCK.tt_jd(0.0)[1]) * 86_400.0 + t_s
    anomaly = 6.239996 + 1.99096871e-7 * tt
    at = tt + 1.657e-3 * np.sin(anomaly + 1.671e-2 * np.sin(anomaly))
    spiceypy.furnsh(str(path))
    try:
        expected = np.array([spiceypy.spkezr(str(TARGET), x, "J2000", "NONE", "399")[0] for x in at])
    finally:
        spiceypy.kclear()
    r, v = trajectory.state(t_s)
    assert np.abs(r - expected[:, :3]).max() < 30e-6 * 9.0
    assert np.abs(v - expected[:, 3:]).max() < 30e-6 * 0.01
    # TDB gains at most 4e-10 on TT
    assert trajectory.span_s[1] - trajectory.span_s[0] == pytest.approx(et[-1] - et[0], abs=1e-5)
    rotation = spiceypy.pxform("J2000", "ECLIPJ2000", 0.0)
    np.testing.assert_allclose(to_frame("ecliptic", CLOCK, 0.0), rotation, rtol=0, atol=1e-15)


@pytest.mark.parametrize("centre", [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 199, 299, 301, 399, 499])
def test_spk_of_every_centre_of_the_ephemeris(centre, tmp_path):
    """The geocentric states by CSPICE with the same DE421: its ET and Skyfield's TDB differ by up to 30 µs, in which a
    planet and the Earth move 3 m; velocities by 30 µs of 1 cm/s²."""
    path = tmp_path / "craft.bsp"
    write_spk(path, 13, centre=centre)
    t_s = np.linspace(100.0, 20_000.0, 5)
    for file in (path, de421_file()):
        spiceypy.furnsh(str(file))
    try:
        expected = np.array([spiceypy.spkgeo(TARGET, x, "J2000", 399)[0] for x in tdb_seconds(CLOCK, t_s)])
    finally:
        spiceypy.kclear()
    trajectory = read_spk(path, CLOCK, None, "Earth")
    found = np.concatenate(trajectory.state(t_s), axis=1)
    assert np.abs(found[:, :3] - expected[:, :3]).max() < 3e-3
    assert np.abs(found[:, 3:] - expected[:, 3:]).max() < 3e-8


# ---------------------------------------------------------------- OEM
HEADER = """CCSDS_OEM_VERS = 2.0
CREATION_DATE = 2026-03-21T00:00:00
ORIGINATOR = TEST
"""


def oem_text(t_s, table, interpolation="HERMITE", degree=7, frame="ICRF", scale="UTC"):
    texts = [CLOCK.isot(t) for t in t_s]
    lines = [
        "META_START",
        "OBJECT_NAME = CRAFT",
        "OBJECT_ID = 2026-001A",
        "CENTER_NAME = EARTH",
        f"REF_FRAME = {frame}",
        f"TIME_SYSTEM = {scale}",
        f"START_TIME = {texts[0]}",
        f"STOP_TIME = {texts[-1]}",
        *([f"INTERPOLATION = {interpolation}", f"INTERPOLATION_DEGREE = {degree}"] if interpolation else []),
        "META_STOP",
        "",
    ]
    for text, row in zip(texts, table, strict=True):
        lines.append(" ".join([text, *(f"{value:.9f}" for value in row)]))
    return HEADER + "\n".join(lines) + "\n"


T_S = np.arange(60) * STEP_S


@pytest.mark.parametrize(
    ("interpolation", "degree"), [("HERMITE", 7), ("HERMITE", 3), ("LAGRANGE", 5), ("LAGRANGE", 8)]
)
@pytest.mark.parametrize("form", ["kvn", "xml", "ndm"])
def test_oem_as_other_packages_read_and_write_it(form, interpolation, degree, tmp_path):
    """``oem`` solves a Vandermonde system of powers of up to 900 s⁷, which loses ten digits: 1e-5 of 9000 km is its own
    error; its nodes are the nearest in the mean, as ours for an even number."""
    path = tmp_path / "craft.oem"
    path.write_text(oem_text(T_S, states(T_S), interpolation, degree))
    message = oem_package.OrbitEphemerisMessage.open(str(path))
    given = path
    if form == "xml":  # written by oem
        given = tmp_path / "craft.xml"
        message.save_as(str(given), file_format="xml")
    elif form == "ndm":  # written by ccsds-ndm-py
        given = tmp_path / "craft_ndm.xml"
        given.write_text(ccsds_ndm.from_file(str(path)).to_str("xml"))
    trajectory = read_oem(given, CLOCK, None)
    t_s = np.linspace(0.0, T_S[-1], 37)
    r, v = trajectory.state(t_s)
    epoch = Time("2026-03-21T12:00:00", scale="utc", precision=9)
    for k in range(0, 37, 3):
        theirs = message(epoch + TimeDelta(t_s[k], format="sec"))
        assert np.linalg.norm(r[k] - theirs.position) < 2e-4
        assert np.linalg.norm(v[k] - theirs.velocity) < 2e-6


def test_oem_at_its_own_states(tmp_path):
    path = tmp_path / "craft.oem"
    for interpolation in ("HERMITE", "LAGRANGE", ""):
        path.write_text(oem_text(T_S, states(T_S), interpolation))
        found = np.concatenate(read_oem(path, CLOCK, None).state(T_S), axis=1)
        # the file has nine decimals; times to 1e-8 s by the rounding of a day's fraction
        assert np.abs(found - np.round(states(T_S), 9)).max() < 1e-9 + 1e-8 * 9.0


@pytest.mark.parametrize("form", ["kvn", "xml", "crlf"])
def test_accelerations_and_covariances_are_read_over(form, tmp_path):
    """A message of 9 columns with a covariance after each segment gives the states of one without."""
    path = tmp_path / "craft.oem"
    rows = np.concatenate([states(T_S), np.zeros((len(T_S), 3))], axis=1)
    covariance = "\n".join(" ".join(["1.0e-6"] * k) for k in range(1, 7))
    block = f"COVARIANCE_START\nEPOCH = {CLOCK.isot(0.0)}\n{covariance}\nCOVARIANCE_STOP\n"
    text = oem_text(T_S, rows) + block
    path.write_text(text)
    if form == "xml":
        oem_package.OrbitEphemerisMessage.open(str(path)).save_as(str(path), file_format="xml")
        assert "covarianceMatrix" in path.read_text()
    elif form == "crlf":
        path.write_bytes(text.replace("\n", "\r\n").encode())
    found = np.concatenate(read_oem(path, CLOCK, None).state(T_S), axis=1)
    assert np.abs(found - np.round(states(T_S), 9)).max() < 1e-9 + 1e-8 * 9.0


@pytest.mark.parametrize(("method", "nodes", "order"), [("hermite", 4, 8), ("hermite", 3, 6), ("lagrange", 6, 6)])
def test_interpolation_converges_at_its_order(method, nodes, order):
    errors = []
    at = np.array([4000.0])
    for step_s in (320.0, 160.0):
        t_s = at + (np.arange(-8, 9) + (0.5 if nodes % 2 == 0 else 0.3)) * step_s
        off = StateTable(t_s, states(t_s), method, nodes).state(at) - states(at)
        errors.append(np.linalg.norm(off[0, :3]))
    # the next term is (n h)² = 5 % of the first, 0.07 in the logarithm, or n h of an odd number of nodes
    assert math.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.3)


# ---------------------------------------------------------------- epochs and frames
@pytest.mark.parametrize("scale", ["UTC", "TAI", "TT", "TDT", "TDB", "GPS"])
def test_epochs_against_astropy(scale):
    """Across the leap second at the end of 2016, by calendar and by day of year. Both use ERFA; 1 ns is the rounding of
    seconds in a float of some years."""
    texts = [
        "2016-12-31T23:59:59.5",
        "2017-01-01T00:00:00.25",
        "2024-060T12:00:01.125",
        "2026-03-21T12:00:00.000000001",
    ]
    if scale == "UTC":
        texts.append("2016-12-31T23:59:60.75")
    clock = Clock(datetime(2016, 12, 31, 12, tzinfo=UTC))
    found = elapsed_s(clock, texts, scale, ["f:1"] * len(texts))
    calendar = [text.replace("2024-060", "2024-02-29") for text in texts]
    offset_s = 19.0 if scale == "GPS" else 0.0
    name = {"TDT": "tt", "GPS": "tai"}.get(scale, scale.lower())
    times = Time(calendar, scale=name, format="isot").tt
    start = Time("2016-12-31T12:00:00", scale="utc").tt
    np.testing.assert_allclose(found, (times - start).sec + offset_s, rtol=0, atol=7e-8 if scale != "TDB" else 3e-6)


def test_frames_of_files_against_skyfield():
    """1 mas is 4.85e-9 rad: 4.4e-5 km at 9000 km. ITRS by Skyfield with its own table of UT1, without polar motion; its
    velocities are those in the rotating frame."""
    t_s = np.linspace(0.0, 86_400.0, 30)
    table = states(t_s)
    r, v = table[:, :3], table[:, 3:]
    time = TIMESCALE.tt_jd(*CLOCK.tt_jd(t_s))
    seen = Geocentric(r.T / AU_KM, v.T / AU_KM * 86_400.0, time)
    for frame, theirs in (("itrf", itrs), ("teme", TEME)):
        there = seen.frame_xyz_and_velocity(theirs)
        r_there, v_there = there[0].km.T, there[1].km_per_s.T
        if frame == "teme":  # SGP4's velocities are in axes taken as inertial, to which Skyfield adds their slow turn
            v_there = np.einsum("nij,nj->ni", to_frame("teme", CLOCK, t_s), v)
        r_back, v_back = states_to_gcrs(frame, CLOCK, t_s, r_there, v_there)
        assert np.linalg.norm(r_back - r, axis=1).max() < 4.4e-5
        assert np.linalg.norm(v_back - v, axis=1).max() < 4.4e-8
    of_date = np.moveaxis(time.M, -1, 0)
    assert np.abs(to_frame("equator_of_date", CLOCK, t_s) - of_date).max() < 4.85e-9


def test_j2000_against_skyfield():
    """The frame bias of Skyfield (IERS Conventions 2003): 23 mas, the same to 0.1 mas."""
    bias = to_frame("eme2000", CLOCK, 0.0)
    assert np.abs(bias - ICRS_to_J2000).max() < 0.1 * 4.85e-9
    assert 22.0 < np.degrees(np.arccos((np.trace(bias) - 1.0) / 2.0)) * 3.6e6 < 24.5


# ---------------------------------------------------------------- out
@pytest.fixture(scope="module")
def sequence(tmp_path_factory):
    scenario = Scenario.load(
        "molniya", overrides=["sequence.frames=6", "sequence.step_s=60.125", "tracker.prior=false"]
    )
    return run_sequence(scenario, out=tmp_path_factory.mktemp("out") / "s", ccsds=True)


def test_trajectory_of_a_sequence_in_an_oem(sequence):
    """Read by ``oem``, ``ccsds-ndm-py`` and ourselves: the written decimals, 1e-9 km, and between them the
    interpolation, whose error is 7e3 km × (n h)⁸/8! with n h = 0.08: 1e-9 km."""
    path = sequence.folder / "trajectory.oem"
    orbit, t_s = build_orbit(sequence.scenario), sequence.columns["t_s"]
    message = oem_package.OrbitEphemerisMessage.open(str(path))
    for state, r, v in zip(message.states, *orbit.state(t_s), strict=True):
        assert np.abs(state.position - r).max() < 1e-9
        assert np.abs(state.velocity - v).max() < 1e-12
    assert len(ccsds_ndm.from_file(str(path)).segments[0].data.state_vector) == 6
    ours = read_oem(path, orbit.clock, None)
    assert ours.span_s == pytest.approx((t_s[0], t_s[-1]), abs=2e-6)
    between = (t_s[:-1] + t_s[1:]) / 2.0
    # epochs of 9 decimals, and seconds in a float of days: 1e-8 s at 10 km/s
    assert np.abs(np.array(ours.state(between)) - orbit.state(between)).max() < 2e-7


def test_attitudes_of_a_sequence_in_aem_and_acm(sequence):
    """Read by ``ccsds-ndm-py``; the quaternion's coordinate transformation, M = (qc² − q²) I + 2 q qᵀ − 2 qc [q×]
    (Wertz 1978, eq. 12-13), takes vectors from ICRF to the camera."""
    columns = sequence.columns
    attitudes = {}
    for name, prefix in (("true", "true_"), ("estimated", "")):
        message = ccsds_ndm.from_file(str(sequence.folder / f"{name}.aem"))
        attitudes[name] = [np.array(state.values) for state in message.segments[0].data.attitude_states]
        ra, dec = np.radians(columns[f"{prefix}ra_deg"]), np.radians(columns[f"{prefix}dec_deg"])
        for k, q in enumerate(attitudes[name]):
            cross = np.cross(np.eye(3), q[:3])  # rows are e × q: the matrix −[q×]
            matrix = (q[3] ** 2 - q[:3] @ q[:3]) * np.eye(3) + 2 * np.outer(q[:3], q[:3]) - 2 * q[3] * -cross.T
            along = [np.cos(dec[k]) * np.cos(ra[k]), np.cos(dec[k]) * np.sin(ra[k]), np.sin(dec[k])]
            np.testing.assert_allclose(matrix[2], along, rtol=0, atol=1e-13)
    assert len(attitudes["true"]) == 6
    message = ccsds_ndm.from_file(str(sequence.folder / "estimated.acm"))
    found = np.array([list(line) for line in message.segment.data.cov[0].cov_lines])
    np.testing.assert_allclose(found[:, 0], columns["t_s"] - columns["t_s"][0], rtol=0, atol=1e-9)
    sigma = [columns[f"sigma_{axis}_deg"] for axis in ("cross_x", "cross_y", "about_boresight")]
    np.testing.assert_allclose(np.sqrt(found[:, 1:]), np.transpose(sigma), rtol=1e-9)
