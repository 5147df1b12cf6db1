"""Attitudes from files: AEM against the package ``ccsds-ndm-py`` and SciPy's interpolators, CK against SpiceyPy, the
frames against Skyfield, tables against SciPy's rotations.

Tolerances: 1e-13 where the same doubles go through a few operations, 1e-12 for polynomials of degree 7.
"""

import math
from datetime import UTC, datetime

import ccsds_ndm
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import spiceypy
from scipy.interpolate import BarycentricInterpolator, KroghInterpolator
from scipy.spatial.transform import Rotation, RotationSpline, Slerp
from skyfield.api import load
from skyfield.framelib import itrs

from simulator.mission.attitude_law import law_attitude, law_rate_rad_s
from simulator.mission.attitudes import build_attitude_law
from simulator.mission.clock import Clock
from simulator.mission.epochs import tdb_seconds
from simulator.mission.frames import to_frame
from simulator.mission.messages import Header, aem_text
from simulator.mission.parameters import AttitudeSource, OrbitParameters, PointingParameters
from simulator.mission.pointing import local_level
from simulator.mission.spice import Attitudes, spice_kernels
from simulator.mission.trajectories import build_trajectory
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude, quat_to_matrix

EPOCH = datetime(2026, 3, 21, 12, tzinfo=UTC)
CLOCK = Clock(EPOCH)
ORBIT = build_trajectory(OrbitParameters(), EPOCH)
MOUNTING = (0.1, -0.2, 0.3, 0.9)
T_S = np.arange(12) * 10.0
BETWEEN_S = np.sort(np.random.default_rng(1).uniform(T_S[0], T_S[-1], 40))


def tumbling(t_s):
    """Quaternions (N, 4) of a body in an uneven rotation of about 1°/s; coordinates ICRS → body."""
    t = np.asarray(t_s, dtype=float)[:, None]
    axes = np.hstack([np.cos(0.02 * t), np.sin(0.03 * t), 0.3 + 0.01 * t])
    return (Rotation.from_rotvec([1.0, 2.0, 0.5]) * Rotation.from_rotvec(0.6 * axes)).as_quat()


def law_of(**keys):
    return build_attitude_law(PointingParameters(mounting=MOUNTING, attitude=AttitudeSource(**keys)), ORBIT)


def assert_same(found, expected, atol):
    """Quaternions up to their sign."""
    sign = np.sign(np.sum(found * expected, axis=-1, keepdims=True))
    np.testing.assert_allclose(found * sign, expected, rtol=0, atol=atol)


# ---------------------------------------------------------------- AEM
def aem(tmp_path, rows, form="kvn", **metadata):
    keys = {
        "OBJECT_NAME": "CRAFT",
        "OBJECT_ID": "2026-001A",
        "REF_FRAME_A": "ICRF",
        "REF_FRAME_B": "SC_BODY_1",
        "TIME_SYSTEM": "UTC",
        "START_TIME": CLOCK.isot(0.0),
        "STOP_TIME": CLOCK.isot(T_S[-1]),
        "ATTITUDE_TYPE": "QUATERNION",
    } | metadata
    lines = ["CCSDS_AEM_VERS = 2.0", "CREATION_DATE = 2026-03-21T00:00:00", "ORIGINATOR = TEST", "META_START"]
    lines += [f"{key} = {value}" for key, value in keys.items() if value is not None]
    lines += ["META_STOP", "DATA_START"]
    lines += [f"{CLOCK.isot(t)} {' '.join(f'{x:.16f}' for x in row)}" for t, row in zip(T_S, rows, strict=True)]
    path = tmp_path / "craft.aem"
    path.write_text("\n".join([*lines, "DATA_STOP", ""]))
    if form == "xml":
        path.write_text(ccsds_ndm.from_file(str(path)).to_str("xml"))
    return path


def rates(t_s):
    """Derivatives (N, 4) of `tumbling` by central differences of 1 ms, good to 1e-9, and rates (N, 3) in body axes."""
    h = 1e-3
    q, before, later = tumbling(t_s), tumbling(np.array(t_s) - h), tumbling(np.array(t_s) + h)
    before, later = (x * np.sign(np.sum(x * q, axis=1, keepdims=True)) for x in (before, later))
    turn = (Rotation.from_quat(before).inv() * Rotation.from_quat(later)).as_rotvec()
    return (later - before) / (2.0 * h), turn / (2.0 * h)


def normalised(q):
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def four(t):
    """The nearest four rows, two before and two after; at the ends the first or last."""
    first = min(max(int(t // 10.0) - 1, 0), len(T_S) - 4)
    return slice(first, first + 4)


def hermite(t, q, dot):
    values = np.stack([q[four(t)], dot[four(t)]], axis=1).reshape(8, 4)
    return normalised(KroghInterpolator(np.repeat(T_S[four(t)], 2), values)(np.array([t])))[0]


@pytest.mark.parametrize("form", ["kvn", "xml"])
@pytest.mark.parametrize("method", ["SLERP", "LINEAR", "LAGRANGE", "HERMITE", None])
def test_aem_by_its_own_interpolation(form, method, tmp_path):
    """SciPy's Slerp, linear interpolation, and barycentric and Krogh's polynomials through the nearest rows."""
    q, (dot, _) = tumbling(T_S), rates(T_S)
    degree = {"SLERP": 1, "LINEAR": 1, "LAGRANGE": 3, "HERMITE": 7}.get(method)
    derivative = method == "HERMITE"
    rows = np.hstack([q, dot]) if derivative else q
    kind = "QUATERNION/DERIVATIVE" if derivative else "QUATERNION"
    path = aem(tmp_path, rows, form, ATTITUDE_TYPE=kind, INTERPOLATION_METHOD=method, INTERPOLATION_DEGREE=degree)
    law = law_of(aem=str(path))
    assert_same(law.quaternions(T_S), q, 1e-13)
    found = law.quaternions(BETWEEN_S)
    for t, ours in zip(BETWEEN_S, found, strict=True):
        k = min(int(t // 10.0), len(T_S) - 2)
        if method in ("SLERP", None):
            expected = Slerp(T_S, Rotation.from_quat(q))(t).as_quat()
        elif method == "LINEAR":
            expected = normalised((q[[k]] * (T_S[k + 1] - t) + q[[k + 1]] * (t - T_S[k])) / 10.0)[0]
        elif method == "LAGRANGE":
            expected = normalised(BarycentricInterpolator(T_S[four(t)], q[four(t)])(np.array([t])))[0]
        else:
            expected = hermite(t, q, dot)
        assert_same(ours, expected, 1e-12)


def test_angular_velocities_are_those_of_the_derivatives(tmp_path):
    """By either frame, in degrees per second; derivative and rate of the oracle are good to 1e-9 each, and a
    derivative counts for at most 2.5 s between two rows."""
    q, (dot, omega) = tumbling(T_S), rates(T_S)
    keys = {"ATTITUDE_TYPE": "QUATERNION/ANGVEL", "INTERPOLATION_METHOD": "HERMITE", "INTERPOLATION_DEGREE": 7}
    for frame, rate in (("SC_BODY_1", omega), ("ICRF", Rotation.from_quat(q).apply(omega))):
        path = aem(tmp_path, np.hstack([q, np.degrees(rate)]), ANGVEL_FRAME=frame, **keys)
        law = law_of(aem=str(path))
        expected = np.array([hermite(t, q, dot) for t in BETWEEN_S])
        assert_same(law.quaternions(BETWEEN_S), expected, 5e-9)
        # at a row the rate is the one given; 0.02 s of its numerical mean: w'' h^2/6 = 1e-9
        np.testing.assert_allclose(law_rate_rad_s(law, 30.0), omega[3], rtol=0, atol=5e-9)


def test_conventions_of_the_first_version(tmp_path):
    """Scalar first, and rotations from B to A: the same attitudes."""
    q = tumbling(T_S)
    for rows, keys in (
        (q[:, [3, 0, 1, 2]], {"QUATERNION_TYPE": "FIRST", "ATTITUDE_DIR": "A2B"}),
        (q * [-1, -1, -1, 1], {"QUATERNION_TYPE": "LAST", "ATTITUDE_DIR": "B2A"}),
        (q, {"REF_FRAME_A": "SC_BODY_1", "REF_FRAME_B": "ICRF", "ATTITUDE_DIR": "B2A"}),
        (q * [-1, -1, -1, 1], {"REF_FRAME_A": "SC_BODY_1", "REF_FRAME_B": "ICRF", "ATTITUDE_DIR": "A2B"}),
        (q * (-1.0) ** np.arange(12)[:, None], {}),
    ):
        assert_same(law_of(aem=str(aem(tmp_path, rows, **keys))).quaternions(T_S), q, 1e-13)


@pytest.mark.parametrize("form", ["kvn", "xml"])
def test_euler_angles_by_elementary_rotations(form, tmp_path):
    """M = R₃(c) R₁(b) R₃(a) with the elementary rotations of axes (Wertz 1978, eq. 12-4 to 12-7); epochs are rounded
    to 1e-11 s, of steps of up to 0.1 rad/s."""
    angles = np.random.default_rng(3).uniform(-40.0, 40.0, (12, 3))
    path = aem(tmp_path, angles, form, ATTITUDE_TYPE="EULER_ANGLE", EULER_ROT_SEQ="ZXZ")
    found = law_of(aem=str(path)).quaternions(T_S)
    for q, (a, b, c) in zip(found, np.radians(angles), strict=True):
        about_z = [np.array([[math.cos(x), math.sin(x), 0], [-math.sin(x), math.cos(x), 0], [0, 0, 1]]) for x in (a, c)]
        about_x = np.array([[1, 0, 0], [0, math.cos(b), math.sin(b)], [0, -math.sin(b), math.cos(b)]])
        np.testing.assert_allclose(quat_to_matrix(q), about_z[1] @ about_x @ about_z[0], rtol=0, atol=2e-12)


def test_the_camera_s_attitudes_and_our_own_messages(tmp_path):
    """``aem_text`` names the frame STARTRACKER_1: the body's attitude is without the mounting. Epochs are rounded to
    1e-11 s, at 0.02 rad/s."""
    camera = tumbling(T_S)
    path = tmp_path / "own.aem"
    path.write_text(aem_text(CLOCK, T_S, camera, Header("craft", "2026-01-01")))
    mounting = Attitude(np.array(MOUNTING), "body", "camera")
    for k, q in enumerate(law_of(aem=str(path)).quaternions(T_S)):
        seen = mounting @ Attitude(q, "icrs", "body")
        assert_same(seen.quat, Attitude(camera[k]).quat, 1e-12)
    assert_same(law_of(aem=str(path), gives="body").quaternions(T_S), camera, 1e-12)


def test_frames_of_attitudes_against_skyfield(tmp_path):
    """ITRF by Skyfield, with its own UT1 and without polar motion; EME2000 by the constant frame bias. 1 mas."""
    q = tumbling(T_S)
    times = load.timescale(builtin=True).tt_jd(*CLOCK.tt_jd(T_S))
    fixed = np.moveaxis(itrs.rotation_at(times), -1, 0)
    bias = np.broadcast_to(to_frame("eme2000", CLOCK, 0.0), (12, 3, 3))
    for frame, axes in (("ITRF2014", fixed), ("EME2000", bias)):
        found = law_of(aem=str(aem(tmp_path, q, REF_FRAME_A=frame))).quaternions(T_S)
        for k in range(12):
            np.testing.assert_allclose(quat_to_matrix(found[k]), quat_to_matrix(q[k]) @ axes[k], rtol=0, atol=4.85e-9)


# ---------------------------------------------------------------- CK
CLOCK_KERNEL = """KPL/SCLK
\\begindata
SCLK_KERNEL_ID = ( @2026-01-01/00:00:00 )
SCLK_DATA_TYPE_31 = ( 1 )
SCLK01_TIME_SYSTEM_31 = ( 2 )
SCLK01_N_FIELDS_31 = ( 2 )
SCLK01_MODULI_31 = ( 4294967296 65536 )
SCLK01_OFFSETS_31 = ( 0 0 )
SCLK01_OUTPUT_DELIM_31 = ( 2 )
SCLK_PARTITION_START_31 = ( 0.0 )
SCLK_PARTITION_END_31 = ( 2.8147497671065E+14 )
SCLK01_COEFFICIENTS_31 = ( 0.0 0.0 1.0 )
\\begintext
"""
LEAPSECONDS = (("DELTA_T_A", [32.184]), ("K", [1.657e-3]), ("EB", [1.671e-2]), ("M", [6.239996, 1.99096871e-7]))
INSTRUMENT = -31000


@pytest.fixture
def kernels(tmp_path):
    """Kernels written by CSPICE: type 3, two intervals with a gap of a minute between rows 5 and 6."""
    sclk, path = tmp_path / "craft.tsc", tmp_path / "craft.bc"
    sclk.write_text(CLOCK_KERNEL)
    spiceypy.kclear()
    spiceypy.furnsh(str(sclk))
    for name, values in LEAPSECONDS:
        spiceypy.pdpool(f"DELTET/{name}", values)
    t_s = np.where(T_S > 55.0, T_S + 60.0, T_S)
    et = tdb_seconds(CLOCK, t_s)
    ticks = np.array([spiceypy.sce2c(-31, x) for x in et])
    quaternions = np.array([spiceypy.m2q(quat_to_matrix(q)) for q in tumbling(t_s)])
    omega = Rotation.from_quat(tumbling(t_s)).apply(rates(t_s)[1])
    handle = spiceypy.ckopn(str(path), "test", 0)
    starts = [ticks[0], ticks[6]]
    spiceypy.ckw03(
        handle, ticks[0], ticks[-1], INSTRUMENT, "J2000", True, "a", 12, ticks, quaternions, omega, 2, starts
    )
    spiceypy.ckcls(handle)
    at = np.concatenate([t_s, np.linspace(0.5, 49.5, 30), np.linspace(120.5, 169.5, 30)])
    spiceypy.furnsh(str(path))
    matrices = [spiceypy.ckgp(INSTRUMENT, spiceypy.sce2c(-31, x), 1000.0, "J2000")[0] for x in tdb_seconds(CLOCK, at)]
    spiceypy.kclear()
    yield path, sclk, at, np.array(matrices)
    spiceypy.kclear()


def test_ck_as_spice_reads_it(kernels):
    """Seconds after J2000 are rounded to 1.2e-7, at 0.03 rad/s: 4e-9; at the same instants 1e-12."""
    path, sclk, at, matrices = kernels
    law = law_of(ck=str(path), sclk=str(sclk))
    found = np.array([quat_to_matrix(q) for q in law.quaternions(at)])
    np.testing.assert_allclose(found, matrices, rtol=0, atol=1e-12)
    assert law.span_s == pytest.approx((0.0, 170.0), abs=2e-6)
    assert not spiceypy.expool("DELTET/DELTA_T_A")
    assert spiceypy.ktotal("ALL") == 0
    # a kernel of the camera's attitudes
    camera = law_of(ck=str(path), sclk=str(sclk), object=INSTRUMENT, gives="camera")
    mounting = Attitude(np.array(MOUNTING), "body", "camera")
    seen = (mounting @ Attitude(camera.quaternions(at[:1])[0], "icrs", "body")).as_matrix()
    np.testing.assert_allclose(seen, matrices[0], rtol=0, atol=1e-12)


def test_kernels_of_our_own(tmp_path):
    """Written as ``run --sequence`` does; seconds after J2000 are rounded to 1.2e-7, at 0.02 rad/s: 3e-9."""
    files = spice_kernels(ORBIT, T_S, {"true.bc": Attitudes(T_S, tumbling(T_S))})
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    law = law_of(ck=str(tmp_path / "true.bc"), sclk=str(tmp_path / "camera.tsc"), gives="camera")
    mounting = Attitude(np.array(MOUNTING), "body", "camera")
    seen = np.array([(mounting @ Attitude(q, "icrs", "body")).quat for q in law.quaternions(T_S)])
    assert_same(seen, tumbling(T_S), 3e-9)
    assert law.span_s == pytest.approx((0.0, 110.0), abs=2e-6)


def test_mistakes_with_ck(kernels, tmp_path, monkeypatch):
    path, sclk, *_ = kernels
    law = law_of(ck=str(path), sclk=str(sclk))
    with pytest.raises(InputError, match=r"no attitudes from 2026-03-21T12:00:50.000 to 2026-03-21T12:02:00.000 UTC"):
        law.quaternions(np.array([90.0]))
    with pytest.raises(InputError, match=r"covers 2026-03-21T12:00:00.000 to 2026-03-21T12:02:50.000 UTC"):
        law_attitude(law, 171.0)
    with pytest.raises(InputError, match=r"has no object -5; pointing.attitude.object can be -31000"):
        law_of(ck=str(path), sclk=str(sclk), object=-5)
    with pytest.raises(InputError, match=r"needs pointing.attitude.sclk"):
        law_of(ck=str(path))
    with pytest.raises(InputError, match=r"none.tsc: no such file"):
        law_of(ck=str(path), sclk=str(tmp_path / "none.tsc"))
    with pytest.raises(InputError, match=r"craft.tsc: cannot be used .* must be a binary CK file"):
        law_of(ck=str(sclk), sclk=str(sclk))
    cut = tmp_path / "cut.bc"
    cut.write_bytes(path.read_bytes()[:1500])
    with pytest.raises(InputError, match=r"cut.bc"):
        law_of(ck=str(cut), sclk=str(sclk))
    import builtins

    real = builtins.__import__
    monkeypatch.setattr(builtins, "__import__", lambda n, *a, **k: _fail() if n == "spiceypy" else real(n, *a, **k))
    with pytest.raises(InputError, match=r"pip install 'boresight\[spice\]'"):
        law_of(ck=str(path), sclk=str(sclk))


def _fail():
    raise ImportError


# ---------------------------------------------------------------- tables
def table(tmp_path, kind, rows=None, **columns):
    """A table of `tumbling` by CSV or Parquet."""
    rows = tumbling(T_S) if rows is None else rows
    columns = {"t_s": T_S, **dict(zip(("qx", "qy", "qz", "qw"), rows.T, strict=True)), **columns}
    path = tmp_path / f"craft.{kind}"
    if kind == "parquet":
        pq.write_table(pa.table(columns), path)
    else:
        cells = zip(*columns.values(), strict=True)
        lines = [",".join(str(x) if isinstance(x, str) else f"{x:.17g}" for x in row) for row in cells]
        path.write_text("# telemetry\n" + "\n".join([",".join(columns), *lines]) + "\n")
    return path


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_tables_by_scipy_s_rotations(kind, tmp_path):
    q = tumbling(T_S)
    path = table(tmp_path, kind)
    for method, along in (("slerp", Slerp), ("spline", RotationSpline)):
        law = law_of(**{kind: str(path)}, interpolation=method)
        expected = along(T_S, Rotation.from_quat(q))(BETWEEN_S).as_quat()
        assert_same(law.quaternions(BETWEEN_S), expected, 1e-13)
        assert law.span_s == pytest.approx((0.0, 110.0), abs=2e-6)
    utc = np.array([CLOCK.isot(t) for t in T_S])
    stamps = pa.array(utc.astype("datetime64[ms]")) if kind == "parquet" else utc
    dated = law_of(**{kind: str(table(tmp_path, kind, utc=stamps))})
    # utc comes before t_s; epochs are rounded to 1e-11 s
    assert_same(dated.quaternions(BETWEEN_S), Slerp(T_S, Rotation.from_quat(q))(BETWEEN_S).as_quat(), 1e-12)
    fixed = law_of(**{kind: str(path)}, frame="itrf").quaternions(T_S)
    axes = to_frame("itrf", CLOCK, T_S)
    for k in range(12):
        np.testing.assert_allclose(quat_to_matrix(fixed[k]), quat_to_matrix(q[k]) @ axes[k], rtol=0, atol=1e-12)


def test_tables_relative_to_the_local_level(tmp_path):
    """The identity is the local level, and a rotation about +Z a yaw from it."""
    yaw = np.radians(0.5 * T_S)
    rows = np.stack([np.zeros(12), np.zeros(12), np.sin(yaw / 2.0), np.cos(yaw / 2.0)], axis=1)
    law = law_of(csv=str(table(tmp_path, "csv", rows)), frame="local_level")
    for t in (0.0, 30.0, 47.0):
        turn = Attitude.from_rotation_vector([0.0, 0.0, math.radians(0.5 * t)], "local_level", "local_level")
        expected = turn @ local_level(*ORBIT.state(t))
        np.testing.assert_allclose(law_attitude(law, t).as_matrix(), expected.as_matrix(), rtol=0, atol=1e-13)


def test_the_convention_is_checked_by_the_boresight(tmp_path):
    """The third row of a camera's matrix is its boresight; transposed or reordered quaternions contradict it."""
    q = tumbling(T_S)
    seen = [Attitude(row) for row in q]
    columns = {"ra_deg": [a.ra_deg for a in seen], "dec_deg": [a.dec_deg for a in seen]}
    law_of(csv=str(table(tmp_path, "csv", **columns)), gives="camera")
    for wrong in (q * [-1, -1, -1, 1], q[:, [3, 0, 1, 2]]):
        with pytest.raises(InputError, match=r"craft.csv:3: the boresight by the quaternion is .*° from ra_deg"):
            law_of(csv=str(table(tmp_path, "csv", wrong, **columns)), gives="camera")
        law_of(csv=str(table(tmp_path, "csv", wrong, **columns)))  # body axes are not those of the columns
