"""Every form of the messages of CCSDS that is read: versions, KVN and XML, epochs, time systems, centres, frames,
attitude types, directions, orders and sequences of rotation.

The messages are written here, and by the package ``ccsds-ndm-py``, from states that NAIF's CSPICE (DE421, rotations),
astropy (time scales) and Skyfield (frames) transform.
"""

import itertools
import math
import re
import warnings
from datetime import UTC, datetime

import ccsds_ndm
import erfa
import numpy as np
import pytest
import spiceypy
from astropy.time import Time, TimeDelta
from astropy.utils import iers
from skyfield.framelib import itrs
from skyfield.sgp4lib import TEME

from simulator.mission.aem import read_aem
from simulator.mission.attitude_table import TabulatedAttitude
from simulator.mission.clock import Clock
from simulator.mission.messages import Header, oem_text
from simulator.mission.oem import read_oem
from simulator.mission.parameters import KeplerianElements, OrbitParameters
from simulator.mission.trajectories import build_trajectory
from simulator.mission.trajectory import CENTRES as TRAJECTORY_CENTRES
from simulator.mission.trajectory import geocentric
from startracker.ephemeris import de421_file, timescale
from startracker.errors import InputError, InputWarning
from startracker.geometry.attitude import quat_to_matrix

EPOCH = datetime(2024, 3, 21, 12, tzinfo=UTC)
CLOCK = Clock(EPOCH)
T_S = np.arange(8) * 60.0
ELLIPSE = build_trajectory(
    OrbitParameters(elements=KeplerianElements(26_600.0, 0.3, 63.4, 10.0, 270.0, 30.0), propagator="kepler"), EPOCH
)
STATES = np.concatenate(ELLIPSE.state(T_S), axis=1)
"""Geocentric states (N, 6), axes of the ICRF."""


class GivenOrbit:
    """The same states relative to another centre."""

    clock = CLOCK

    def __init__(self, centre):
        self.centre = centre

    def state(self, t_s):
        return ELLIPSE.state(t_s)


def epochs(t_s, scale="UTC", form="calendar"):
    """Epochs as text, by astropy."""
    times = Time("2024-03-21T12:00:00", scale="utc", precision=9) + TimeDelta(t_s, format="sec")
    with iers.conf.set_temp("auto_download", False):
        shown = getattr(times, {"GPS": "tai", "TDT": "tt"}.get(scale, scale.lower()))
    if scale == "GPS":
        shown = shown - TimeDelta(19.0, format="sec")
    shown.precision = 9
    if form == "calendar":
        return shown.isot.tolist()
    return [text.replace(":", "-", 1).replace(":", "T", 1) for text in shown.yday.tolist()]


def xml_of(text, kind):
    """The same message in XML, written line by line; of every element the name is the keyword."""
    version, inside, out = re.search(r"_VERS = (\S+)", text)[1], "header", ["<header>"]
    for line in text.splitlines()[1:]:
        if line == "META_START":
            out.append(
                "</header><body><segment><metadata>" if inside == "header" else "</data></segment><segment><metadata>"
            )
            inside = "metadata"
        elif line == "META_STOP":
            out.append("</metadata><data>")
            inside = "data"
        elif "=" in line and inside != "data":
            key, _, value = line.partition(" = ")
            out.append(f"<{key}>{value}</{key}>")
        elif line.startswith("COMMENT"):
            out.append(f"<COMMENT>{line[8:]}</COMMENT>")
        elif inside == "data" and kind == "oem":
            at, *numbers = line.split()
            cells = zip(("X", "Y", "Z", "X_DOT", "Y_DOT", "Z_DOT", "X_DDOT", "Y_DDOT", "Z_DDOT"), numbers, strict=False)
            units = {1: "km", 5: "km/s", 6: "km/s**2"}
            row = "".join(f'<{key} units="{units[len(key)]}">{value}</{key}>' for key, value in cells)
            out.append(f"<stateVector><EPOCH>{at}</EPOCH>{row}</stateVector>")
    body = "\n".join([*out, "</data></segment></body>"])
    root = f'<{kind} id="CCSDS_{kind.upper()}_VERS" version="{version}">'
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{root}{body}</{kind}>'


# ---------------------------------------------------------------- OEM
def oem(tmp_path, rows=STATES, form="kvn", version="2.0", scale="UTC", written="calendar", **keys):
    at = epochs(T_S, scale, written)
    metadata = {
        "OBJECT_NAME": "CRAFT [A]",
        "OBJECT_ID": "2024-001A",
        "CENTER_NAME": "EARTH",
        "REF_FRAME": "ICRF",
        "TIME_SYSTEM": scale,
        "START_TIME": at[0],
        "STOP_TIME": at[-1],
        "INTERPOLATION": "HERMITE",
        "INTERPOLATION_DEGREE": 7,
    } | keys
    lines = [f"CCSDS_OEM_VERS = {version}", "CREATION_DATE = 2024-081T00:00:00", "ORIGINATOR = TEST", "META_START"]
    lines += [f"{key} = {value}" for key, value in metadata.items() if value is not None]
    lines += ["META_STOP", "COMMENT states"]
    lines += [f"{t} {' '.join(f'{x:.9f}' for x in row)}" for t, row in zip(at, rows, strict=True)]
    text = "\n".join(lines) + "\n"
    path = tmp_path / "craft.oem"
    path.write_text(text if form != "xml" else xml_of(text, "oem"))
    if form == "ndm":
        path.write_text(ccsds_ndm.from_file(str(path)).to_str("xml"))
    return path


def assert_states(path, position_km, speed_km_s=None):
    """The geocentric states within tolerances."""
    trajectory = read_oem(path, CLOCK, None)
    at_s = np.clip(T_S, *trajectory.span_s)  # which a tolerance of the time scale may shorten
    found = np.concatenate(geocentric(trajectory, at_s), axis=1)
    assert np.abs(found[:, :3] - STATES[:, :3]).max() < position_km
    assert np.abs(found[:, 3:] - STATES[:, 3:]).max() < (speed_km_s or position_km * 1e-2)


FORMS = [*itertools.product(["1.0", "2.0", "3.0"], ["kvn", "xml"]), ("2.0", "ndm"), ("3.0", "ndm")]
"""``ccsds-ndm-py`` writes versions 2 and 3."""


@pytest.mark.parametrize(("version", "form"), FORMS)
@pytest.mark.parametrize("written", ["calendar", "day of year"])
def test_oem_of_every_version_and_form(version, form, written, tmp_path):
    """Nine decimals of km, and epochs to 1e-8 s (the rounding of a day's fraction) at 5 km/s."""
    path = oem(tmp_path, form=form, version=version, written=written)
    assert_states(path, 1e-7)
    assert read_oem(path, CLOCK, "CRAFT [A]").object_id == "2024-001A"


@pytest.mark.parametrize("scale", ["UTC", "TAI", "TT", "TDT", "TDB", "GPS", "UT1", "TCG", "TCB"])
@pytest.mark.parametrize("form", ["kvn", "xml"])
def test_oem_of_every_time_system(scale, form, tmp_path):
    """Astropy's TDB and TCB are those of the geocentre within 2 µs of Earth's rotation; its UT1 (IERS bulletins A and
    B) and Skyfield's table agree within 1 ms. At 5 km/s and 1 m/s²."""
    slack_s = {"UT1": 1e-3, "TDB": 3e-6, "TCB": 3e-6}.get(scale, 1e-7)
    path = oem(tmp_path, scale=scale, form=form, written="day of year" if form == "xml" else "calendar")
    assert_states(path, 1e-7 + slack_s * 7.0, 1e-9 + slack_s * 1e-3)


CENTRES = {
    "EARTH": 399, "Earth": 399, "MOON": 301, "SUN": 10, "MERCURY": 199, "VENUS": 299, "MARS": 499, "JUPITER": 5,
    "SATURN": 6, "URANUS": 7, "NEPTUNE": 8, "MERCURY BARYCENTER": 1, "VENUS BARYCENTER": 2, "EARTH BARYCENTER": 3,
    "EARTH-MOON BARYCENTER": 3, "EMB": 3, "MARS BARYCENTER": 4, "MARS_BARYCENTER": 4, "JUPITER BARYCENTER": 5,
    "SATURN BARYCENTER": 6, "URANUS BARYCENTER": 7, "NEPTUNE BARYCENTER": 8, "PLUTO BARYCENTER": 9,
    "SOLAR SYSTEM BARYCENTER": 0, "SOLAR SYSTEM BARYCENTRE": 0, "SSB": 0,
}  # fmt: skip


@pytest.mark.parametrize("name", CENTRES)
def test_oem_of_every_centre(name, tmp_path):
    """By CSPICE with the same DE421; its TDB and Skyfield's differ by 10 µs, in which the Earth and a planet move 0.5 m
    relative to each other, and float64 resolves 0.1 m at the distance of Pluto after differences of barycentric
    positions."""
    spiceypy.furnsh(str(de421_file()))
    try:
        with iers.conf.set_temp("auto_download", False):
            et = (Time("2024-03-21T12:00:00", scale="utc").tdb.jd - 2_451_545.0) * 86_400.0 + T_S
        away = np.array([spiceypy.spkgeo(399, t, "J2000", CENTRES[name])[0] for t in et])
    finally:
        spiceypy.unload(str(de421_file()))
    assert_states(oem(tmp_path, STATES + away, CENTER_NAME=name), 2e-3, 1e-8)


@pytest.mark.parametrize("centre", TRAJECTORY_CENTRES)
def test_our_own_oem_of_every_centre_is_read_again(centre, tmp_path):
    """CENTER_NAME as written is a name of the centre: an outer planet's is that of its barycentre."""
    trajectory = GivenOrbit(centre)
    path = tmp_path / "own.oem"
    path.write_text(oem_text(trajectory, T_S, Header("craft", "2024-03-21T00:00:00")))
    again = read_oem(path, CLOCK, None)
    assert again.centre == centre
    np.testing.assert_allclose(again.state(T_S)[0], STATES[:, :3], rtol=0, atol=1e-7)
    name = re.search("CENTER_NAME = (.*)", path.read_text())[1]
    barycentres = {"Earth-Moon barycentre": 3, "Solar system barycentre": 0, "Pluto barycentre": 9}
    assert CENTRES[name] == (barycentres[centre] if centre in barycentres else CENTRES[centre.upper()])


def rotation_to(frame, t_s):
    """Matrices (N, 3, 3) from the ICRF, by Skyfield and ERFA."""
    time = timescale().tt_jd(*CLOCK.tt_jd(t_s))
    if frame in ("ITRF", "TDR"):
        return np.moveaxis(itrs.rotation_at(time), -1, 0)
    if frame == "TEME":
        return np.moveaxis(TEME.rotation_at(time), -1, 0)
    if frame == "TOD":
        return np.moveaxis(time.M, -1, 0)
    if frame == "MOD":
        return np.moveaxis(time.P, -1, 0) @ erfa.bp06(2_451_545.0, 0.0)[0]
    return np.broadcast_to(erfa.bp06(2_451_545.0, 0.0)[0] if frame == "EME2000" else np.eye(3), (len(t_s), 3, 3))


FRAMES = {
    "ICRF": "ICRF", "ICRF3": "ICRF", "GCRF": "ICRF", "EME2000": "EME2000", "J2000": "EME2000", "TEME": "TEME",
    "TOD": "TOD", "TOD_EARTH": "TOD", "MOD": "MOD", "MOD_EARTH": "MOD", "ITRF": "ITRF", "ITRF2000": "ITRF",
    "ITRF-97": "ITRF", "ITRF2014": "ITRF", "TDR": "TDR", "GTOD": "TDR", "TIRS": "TDR", "TEMEOFDATE": "TEME",
}  # fmt: skip
MAS = 4.85e-9


@pytest.mark.parametrize("name", FRAMES)
def test_oem_of_every_frame(name, tmp_path):
    """1 mas of 35,000 km, 0.2 m; velocities of the rotating frame by central differences of 1 s, n³ h²/6 = 1e-8
    km/s."""

    def there(t_s):
        return (rotation_to(FRAMES[name], t_s) @ ELLIPSE.state(t_s)[0][..., None])[..., 0]

    velocity = (rotation_to(FRAMES[name], T_S) @ STATES[:, 3:, None])[..., 0]
    if FRAMES[name] in ("ITRF", "TDR"):
        velocity = (there(T_S + 1.0) - there(T_S - 1.0)) / 2.0
    path = oem(tmp_path, np.hstack([there(T_S), velocity]), REF_FRAME=name)
    assert_states(path, MAS * 4e4, 2e-7)


@pytest.mark.parametrize(("name", "of_epoch"), [("TEME", "TEMEOFEPOCH"), ("TOD", "TOE_EARTH"), ("MOD", "MOE")])
def test_axes_of_a_stated_date(name, of_epoch, tmp_path):
    """REF_FRAME_EPOCH: the axes of that date, a month earlier (4″ of precession, 0.7 km here), at all states."""
    fixed = rotation_to(name, np.array([-30.0 * 86_400.0]))[0]
    rows = np.hstack([STATES[:, :3] @ fixed.T, STATES[:, 3:] @ fixed.T])
    path = oem(tmp_path, rows, REF_FRAME=name, REF_FRAME_EPOCH="2024-02-20T12:00:00")
    assert_states(path, MAS * 4e4, 2e-7)
    off = np.abs(read_oem(oem(tmp_path, rows, REF_FRAME=name), CLOCK, None).state(T_S)[0] - STATES[:, :3]).max()
    assert off > 0.1
    path = oem(tmp_path, rows, REF_FRAME=of_epoch, REF_FRAME_EPOCH="2024-051T12:00:00")
    assert_states(path, MAS * 4e4, 2e-7)
    with pytest.raises(InputError, match=rf"frame {of_epoch} needs REF_FRAME_EPOCH, the date of its axes"):
        read_oem(oem(tmp_path, rows, REF_FRAME=of_epoch), CLOCK, None)
    with pytest.raises(InputError, match=r"REF_FRAME_EPOCH is for axes of date; ITRF rotates"):
        read_oem(oem(tmp_path, REF_FRAME="ITRF", REF_FRAME_EPOCH="2024-02-20T12:00:00"), CLOCK, None)
    assert_states(oem(tmp_path, REF_FRAME="ICRF", REF_FRAME_EPOCH="2024-02-20T12:00:00"), 1e-7)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"CENTER_NAME": "CERES"}, r"craft.oem:7: centre CERES is not supported; use Mercury, .* barycentre"),
        ({"REF_FRAME": "MCI"}, r"craft.oem:8: frame MCI is not supported"),
        ({"REF_FRAME": "GRC"}, r"craft.oem:8: frame GRC is not supported"),
        ({"REF_FRAME": "ITRFX"}, r"craft.oem:8: frame ITRFX is not supported"),
        ({"TIME_SYSTEM": "MET"}, r"time scale 'MET' cannot be read; convert to UTC"),
        ({"TIME_SYSTEM": "GMST"}, r"time scale 'GMST' cannot be read"),
        ({"TIME_SYSTEM": "SCLK"}, r"time scale 'SCLK' cannot be read"),
        ({"INTERPOLATION": "SPLINE"}, r"interpolation SPLINE is not supported"),
        ({"version": "4.0"}, r"craft.oem:1: version 4.0 of the OEM is not known; use 1.0, 2.0, 3.0"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("form", ["kvn", "xml"])
def test_what_an_oem_cannot_be(keys, message, form, tmp_path):
    message = message.replace("craft.oem:7", r"craft.oem:\d+").replace("craft.oem:8", r"craft.oem:\d+")
    with pytest.raises(InputError, match=message.replace("craft.oem:1:", r"craft.oem:\d:")) as error:
        read_oem(oem(tmp_path, form=form, **keys), CLOCK, None)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("form", ["kvn", "xml"])
def test_a_span_or_a_degree_beyond_the_states_is_a_warning(form, tmp_path):
    """As Orekit reads them: up to the states, and with the degree that they give."""
    late = epochs(np.array([3600.0]))[0]
    for key, value in (("STOP_TIME", late), ("START_TIME", "2024-03-21T11:00:00")):
        with pytest.warns(InputWarning, match=rf"craft.oem:\d+: the states do not reach {key} = {value}, only 2024"):
            trajectory = read_oem(oem(tmp_path, form=form, **{key: value}), CLOCK, None)
        assert trajectory.span_s == pytest.approx((0.0, 420.0), abs=2e-6)
    with pytest.raises(InputError, match=r"2024-03-21T12:07:00.010 is outside"):
        trajectory.state(420.01)
    for method, degree, used in (("HERMITE", 25, 15), ("LAGRANGE", 9, 7)):
        path = oem(tmp_path, form=form, INTERPOLATION=method, INTERPOLATION_DEGREE=degree)
        with pytest.warns(InputWarning, match=rf"{method} of degree {degree} needs \d+ states, .* 8: degree {used} is"):
            trajectory = read_oem(path, CLOCK, None)
        # the remainder of degree 7, (n h)^8 a/8!/…, is below that of nine decimals
        assert np.abs(trajectory.state(T_S[:-1] + 30.0)[0] - ELLIPSE.state(T_S[:-1] + 30.0)[0]).max() < 1e-6


@pytest.mark.parametrize("form", ["kvn", "xml"])
def test_several_segments_with_covariances_accelerations_and_comments(form, tmp_path):
    rows = np.hstack([STATES, np.zeros((8, 3))])
    first = oem(tmp_path, rows).read_text()
    second = first[first.index("META_START") :]
    for t in (*epochs(T_S), "2024-03-21T12:07:00"):
        minute = int(t[14:16])
        second = second.replace(f"T12:{minute:02d}:", f"T13:{minute:02d}:")
    covariance = "COVARIANCE_START\nEPOCH = 2024-03-21T12:00:00\nCOV_REF_FRAME = RTN\n"
    covariance += "\n".join(" ".join(["1.0e-6"] * k) for k in range(1, 7)) + "\nCOVARIANCE_STOP\n"
    path = tmp_path / "two.oem"
    path.write_text(first + covariance + "COMMENT the second\n" + second)
    if form == "xml":
        path.write_text(ccsds_ndm.from_file(str(path)).to_str("xml"))
        assert "covarianceMatrix" in path.read_text()
    trajectory = read_oem(path, CLOCK, None)
    assert len(trajectory.segments) == 2
    found = trajectory.state(np.concatenate([T_S, T_S + 3600.0]))[0]
    assert np.abs(found - np.tile(STATES[:, :3], (2, 1))).max() < 1e-7


def test_messages_of_other_kinds_and_units(tmp_path):
    """An OPM is not an OEM; of several messages in an NDM the right kind is read; a unit is not read over."""
    path = tmp_path / "x.oem"
    for text, message in (
        ("CCSDS_OPM_VERS = 2.0\n", r"x.oem:1: no CCSDS OEM; .*; this is a CCSDS OPM"),
        ("<ndm><opm><body/></opm></ndm>", r"x.oem:1: no CCSDS OEM; it has no element <oem>; this is a CCSDS OPM"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=message):
            read_oem(path, CLOCK, None)
    whole = oem(tmp_path, form="xml").read_text().partition("\n")[2]
    other = whole.replace("<CENTER_NAME>EARTH", "<CENTER_NAME>CERES").replace("oem", "ocm").replace("OEM", "OCM")
    path.write_text(f'<?xml version="1.0"?><ndm>{other}{whole}</ndm>')
    assert_states(path, 1e-7)
    path.write_text(whole.replace('units="km"', 'units="m"'))
    with pytest.raises(InputError, match=r"x.oem:\d+: X is in m; the standard has km, in which the value is needed"):
        read_oem(path, CLOCK, None)
    path.write_bytes(whole.encode("utf-16"))
    assert_states(path, 1e-7)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('encoding="UTF-8"', 'encoding="UTX-8"', r"own.oem:1: XML in an encoding that cannot be read .*; use UTF-8"),
        ("<TIME_SYSTEM>UTC", "<TIME_SYSTEM>U\nTC", r"time scale 'U TC' cannot be read"),
        ("metadata>", "metadatum>", r"own.oem:\d+: data before META_START"),
        ("<Z_DOT", "<W_DOT", r"own.oem:\d+: damaged or truncated XML \(mismatched tag\)"),
    ],
)
def test_damaged_xml_is_one_line(old, new, message, tmp_path):
    path = tmp_path / "own.oem"
    path.write_text(oem(tmp_path, form="xml").read_text().replace(old, new))
    with pytest.raises(InputError, match=message) as error:
        read_oem(path, CLOCK, None)
    assert "\n" not in str(error.value)


# ---------------------------------------------------------------- AEM
SEQUENCES = ["".join(s) for s in itertools.product("XYZ", repeat=3) if s[0] != s[1] != s[2]]


def body(t_s):
    """Matrices (N, 3, 3) from the ICRF to the body, an uneven rotation of some degrees a minute, by CSPICE."""
    return np.array([spiceypy.eul2m(1.0 + 2e-3 * t, 0.7 + 0.1 * math.sin(0.005 * t), 0.3, 3, 1, 2) for t in t_s])


def angles_of(matrices, sequence):
    """Euler angles (N, 3), degrees, of successive rotations about the axes of a sequence, by CSPICE."""
    axes = ["XYZ".index(axis) + 1 for axis in sequence]
    return np.degrees([spiceypy.m2eul(np.ascontiguousarray(m), *axes[::-1])[::-1] for m in matrices])


def quaternions_of(matrices):
    """(N, 4), Q1 Q2 Q3 QC, of the same coordinate transformation: SPICE's quaternion has the scalar first, and is that
    of the transformation with the vector's sign changed (Rotation Required Reading)."""
    q = np.array([spiceypy.m2q(np.ascontiguousarray(m)) for m in matrices])
    q *= np.sign(np.sum(q * q[:1], axis=1, keepdims=True))
    return np.column_stack([-q[:, 1:], q[:, 0]])


def rate_of(function, t_s):
    """Derivative by differences of 0.1 s of fourth order, 1e-12 of slow functions."""
    h = 0.1
    ends = [function(t_s + k * h) for k in (-2, -1, 1, 2)]
    return (ends[0] - 8.0 * ends[1] + 8.0 * ends[2] - ends[3]) / (12.0 * h)


def angular_velocity(t_s):
    """(N, 3) rad/s of the body relative to the ICRF in its own axes: M' = −[ω×] M."""
    rate = -rate_of(body, t_s) @ np.swapaxes(body(t_s), 1, 2)
    return np.stack([rate[:, 2, 1], rate[:, 0, 2], rate[:, 1, 0]], axis=1)


def aem(tmp_path, kind, rows, form="kvn", version="2.0", scale="UTC", written="calendar", **keys):
    at = epochs(T_S[: len(rows)], scale, written)
    metadata = {
        "OBJECT_NAME": "CRAFT",
        "OBJECT_ID": "2024-001A",
        "CENTER_NAME": "EARTH",
        "REF_FRAME_A": "ICRF",
        "REF_FRAME_B": "SC_BODY_1",
        "TIME_SYSTEM": scale,
        "START_TIME": at[0],
        "STOP_TIME": at[-1],
        "ATTITUDE_TYPE": kind,
    } | keys
    lines = [f"CCSDS_AEM_VERS = {version}", "CREATION_DATE = 2024-081T00:00:00", "ORIGINATOR = TEST", "META_START"]
    lines += [f"{key} = {value}" for key, value in metadata.items() if value is not None]
    lines += ["META_STOP", "DATA_START", "COMMENT attitudes"]
    lines += [f"{t} {' '.join(f'{x:.15g}' for x in row)}" for t, row in zip(at, rows, strict=True)]
    path = tmp_path / "craft.aem"
    path.write_text("\n".join([*lines, "DATA_STOP", ""]))
    if form == "xml":
        path.write_text(ccsds_ndm.from_file(str(path)).to_str("xml"))
    return path


def found_at(path, t_s):
    """Matrices (T, 3, 3) from the ICRF of a message."""
    law = TabulatedAttitude.of(read_aem(path, CLOCK, None).segments, CLOCK, str(path), None)
    return np.array([quat_to_matrix(q) for q in law.quaternions(t_s)])


FRAME_1 = {"ANGVEL_FRAME": "SC_BODY_1"}
TYPES = {
    "QUATERNION": (lambda t: quaternions_of(body(t)), {}),
    "QUATERNION/DERIVATIVE": (
        lambda t: np.hstack([quaternions_of(body(t)), rate_of(lambda x: quaternions_of(body(x)), t)]), {}
    ),
    "QUATERNION/ANGVEL": (
        lambda t: np.hstack([quaternions_of(body(t)), np.degrees(angular_velocity(t))]), FRAME_1
    ),
    "EULER_ANGLE": (lambda t: angles_of(body(t), "ZXZ"), {"EULER_ROT_SEQ": "ZXZ"}),
    "EULER_ANGLE/DERIVATIVE": (
        lambda t: np.hstack([angles_of(body(t), "XZY"), rate_of(lambda x: angles_of(body(x), "XZY"), t)]),
        {"EULER_ROT_SEQ": "XZY"},
    ),
    "EULER_ANGLE/ANGVEL": (
        lambda t: np.hstack([angles_of(body(t), "YXY"), np.degrees(angular_velocity(t))]),
        {"EULER_ROT_SEQ": "YXY"} | FRAME_1,
    ),
}  # fmt: skip
BETWEEN_S = T_S[:-1] + 25.0


@pytest.mark.parametrize("form", ["kvn", "xml"])
@pytest.mark.parametrize("kind", TYPES)
@pytest.mark.parametrize("written", ["calendar", "day of year"])
def test_aem_of_every_type(kind, form, written, tmp_path):
    """At the states 15 digits. Between them Hermite's polynomial of degree 7 where the type has rates, else Lagrange's;
    the remainder of eight states in the first interval, 0.1 (n h)⁸ 600/8! of n h = 0.3, is 1e-7 of an angle, and four
    times that with the second harmonic in the quaternion; a rate about the wrong axis or of the wrong sign is 1e-3."""
    make, keys = TYPES[kind]
    keys = keys | {"INTERPOLATION_METHOD": "HERMITE", "INTERPOLATION_DEGREE": 7}
    path = aem(tmp_path, kind, make(T_S), form, written=written, **keys)
    np.testing.assert_allclose(found_at(path, T_S), body(T_S), rtol=0, atol=2e-10)
    np.testing.assert_allclose(found_at(path, BETWEEN_S), body(BETWEEN_S), rtol=0, atol=5e-7)


@pytest.mark.parametrize("sequence", [*SEQUENCES, "321", "313", "121"])
@pytest.mark.parametrize("direction", ["A2B", "B2A", None])
def test_aem_of_every_sequence_and_direction(sequence, direction, tmp_path):
    """Version 1, with the directions of ATTITUDE_DIR: 15 digits of a degree."""
    letters = sequence.translate(str.maketrans("123", "XYZ"))
    matrices = body(T_S) if direction != "B2A" else np.swapaxes(body(T_S), 1, 2)
    rows = angles_of(matrices, letters)
    keys = {"EULER_ROT_SEQ": sequence, "ATTITUDE_DIR": direction, "version": "1.0", "RATE_FRAME": "REF_FRAME_B"}
    path = aem(tmp_path, "EULER_ANGLE", rows, **keys)
    np.testing.assert_allclose(found_at(path, T_S), body(T_S), rtol=0, atol=1e-9)
    other = keys | {"REF_FRAME_A": "SC_BODY_1", "REF_FRAME_B": "ICRF"}
    back = np.swapaxes(matrices, 1, 2)
    path = aem(tmp_path, "EULER_ANGLE", angles_of(back, letters), **other)
    np.testing.assert_allclose(found_at(path, T_S), body(T_S), rtol=0, atol=1e-9)


@pytest.mark.parametrize("order", ["FIRST", "LAST"])
@pytest.mark.parametrize("kind", ["QUATERNION", "QUATERNION/DERIVATIVE", "QUATERNION/RATE"])
def test_aem_of_the_first_version_with_both_orders(order, kind, tmp_path):
    q, rate = quaternions_of(body(T_S)), rate_of(lambda x: quaternions_of(body(x)), T_S)
    rows = {"QUATERNION": [q], "QUATERNION/DERIVATIVE": [q, rate], "QUATERNION/RATE": [q, np.full((8, 3), 99.0)]}[kind]
    if order == "FIRST":
        rows = [part[:, [3, 0, 1, 2]] if part.shape[1] == 4 else part for part in rows]
    keys = {"INTERPOLATION_METHOD": "HERMITE", "INTERPOLATION_DEGREE": 7}
    path = aem(tmp_path, kind, np.hstack(rows), version="1.0", QUATERNION_TYPE=order, EULER_ROT_SEQ="321", **keys)
    np.testing.assert_allclose(found_at(path, T_S), body(T_S), rtol=0, atol=2e-10)
    np.testing.assert_allclose(found_at(path, BETWEEN_S), body(BETWEEN_S), rtol=0, atol=5e-7)


def test_aem_of_angles_and_rates_of_the_first_version(tmp_path):
    """Six numbers a line, the last three of which that version leaves undefined: they are read and not used."""
    rows = np.hstack([angles_of(body(T_S), "ZYX"), np.full((len(T_S), 3), 99.0)])
    path = aem(tmp_path, "EULER_ANGLE/RATE", rows, version="1.0", EULER_ROT_SEQ="321")
    np.testing.assert_allclose(found_at(path, T_S), body(T_S), rtol=0, atol=1e-9)


def test_aem_in_xml_of_the_first_version(tmp_path):
    """505.0-B-1: ``rotationAngles`` with ``rotation1`` to ``rotation3``, whose axes are those of the sequence."""
    rows = angles_of(body(T_S), "ZYX")
    header = aem(tmp_path, "EULER_ANGLE/RATE", np.hstack([rows, rows]), EULER_ROT_SEQ="321").read_text()
    keys = re.findall(r"^([A-Z_]+) = (.*)$", header[header.index("META_START") :], re.MULTILINE)
    metadata = "".join(f"<{key}>{value}</{key}>" for key, value in keys)
    states = "".join(
        f"<attitudeState><eulerAngleRate><EPOCH>{t}</EPOCH><rotationAngles>"
        + "".join(
            f'<rotation{k} angle="{"ZYX"[k - 1]}_ANGLE" units="deg">{x:.13f}</rotation{k}>'
            for k, x in enumerate(row, 1)
        )
        + '</rotationAngles><rotationRates><rotation1 rate="Z_RATE" units="deg/s">0.1</rotation1></rotationRates>'
        + "</eulerAngleRate></attitudeState>"
        for t, row in zip(epochs(T_S), rows, strict=True)
    )
    text = f'<aem id="CCSDS_AEM_VERS" version="1.0"><header/><body><segment><metadata>{metadata}</metadata><data>'
    path = tmp_path / "one.aem"
    path.write_text(f"{text}{states}</data></segment></body></aem>")
    np.testing.assert_allclose(found_at(path, T_S), body(T_S), rtol=0, atol=1e-9)
    path.write_text(f"{text}{states}</data></segment></body></aem>".replace('"Z_ANGLE"', '"X_ANGLE"'))
    with pytest.raises(InputError, match=r"one.aem:1: rotation 1 is about X, but EULER_ROT_SEQ = ZYX"):
        found_at(path, T_S)


@pytest.mark.parametrize("name", FRAMES)
@pytest.mark.parametrize("scale", ["UTC", "TAI", "UT1"])
def test_aem_of_every_frame(name, scale, tmp_path):
    """1 mas; UT1 to 1 ms at 2e-3 rad/s, and 7e-5 rad/s of the Earth."""
    relative = body(T_S) @ np.swapaxes(rotation_to(FRAMES[name], T_S), 1, 2)
    path = aem(tmp_path, "QUATERNION", quaternions_of(relative), REF_FRAME_A=name, scale=scale)
    atol = 2.0 * MAS + (3e-6 if scale == "UT1" else 3e-10)
    law = TabulatedAttitude.of(read_aem(path, CLOCK, None).segments, CLOCK, str(path), None)
    inside = np.clip(T_S, *law.span_s)
    found = np.array([quat_to_matrix(q) for q in law.quaternions(inside)])
    np.testing.assert_allclose(found, body(T_S), rtol=0, atol=atol)


# a spin of three revolutions between states, on a cone of 4° in 97 s about a fixed momentum
SPIN_DEG_S, CONE_DEG, CONE_S = 18.3, 4.0, 97.0
MOMENTUM_DEG = (211.0, -38.0)


def spinning(t_s, cone_deg):
    """Matrices (N, 3, 3) of a torque-free symmetrical body: 3-1-3 angles about the momentum, two of them uniform."""
    ra, dec = np.radians(MOMENTUM_DEG)
    to_momentum = spiceypy.eul2m(0.0, math.pi / 2 - dec, math.pi / 2 + ra, 3, 1, 3)
    cone_rate = 2 * math.pi / CONE_S if cone_deg else 0.0
    return np.array(
        [
            spiceypy.eul2m(0.4 + math.radians(SPIN_DEG_S) * t, math.radians(cone_deg), 0.9 + cone_rate * t, 3, 1, 3)
            @ to_momentum
            for t in t_s
        ]
    )


@pytest.mark.parametrize("form", ["kvn", "xml"])
@pytest.mark.parametrize("kind", ["SPIN", "SPIN/NUTATION", "SPIN/NUTATION_MOM"])
@pytest.mark.parametrize("direction", ["A2B", "B2A"])
def test_aem_of_a_spinning_body(kind, form, direction, tmp_path):
    """At the states and between them, three revolutions apart, the motion itself: 15 digits of degrees over 60 s."""
    cone_deg = 0.0 if kind == "SPIN" else CONE_DEG
    matrices = spinning(T_S, cone_deg)
    phase = np.degrees([spiceypy.m2eul(np.ascontiguousarray(m), 3, 1, 3)[0] for m in matrices])
    axis = matrices[:, 2]
    ra, dec = np.degrees(np.arctan2(axis[:, 1], axis[:, 0])), np.degrees(np.arcsin(axis[:, 2]))
    columns = [ra, dec, phase, np.full(8, SPIN_DEG_S)]
    if kind == "SPIN/NUTATION":
        in_body = matrices @ np.array(spinning([0.0], 0.0)[0][2])
        columns += [np.full(8, CONE_DEG), np.full(8, CONE_S), np.degrees(np.arctan2(-in_body[:, 1], in_body[:, 0]))]
    elif kind == "SPIN/NUTATION_MOM":
        columns += [np.full(8, MOMENTUM_DEG[0]), np.full(8, MOMENTUM_DEG[1]), np.full(8, 360.0 / CONE_S)]
    keys = {} if form == "xml" else {"ATTITUDE_DIR": direction}
    path = aem(tmp_path, kind, np.stack(columns, axis=1), form, **keys)
    t_s = np.concatenate([T_S, BETWEEN_S])
    expected = spinning(t_s, cone_deg)
    if keys.get("ATTITUDE_DIR") == "B2A":
        expected = np.swapaxes(expected, 1, 2)
    np.testing.assert_allclose(found_at(path, t_s), expected, rtol=0, atol=3e-9)


def test_a_spin_whose_rate_contradicts_its_phases(tmp_path):
    rows = np.array([[10.0, 20.0, 0.0, 0.0], [10.0, 20.0, 175.0, 0.0]])
    with pytest.raises(InputError, match=r"craft.aem:\d+: 175° from the attitude that the state before and its rate"):
        found_at(aem(tmp_path, "SPIN", rows), T_S[:2])
    rows = np.hstack([rows, np.zeros((2, 3))])
    with pytest.raises(InputError, match=r"craft.aem:\d+: NUTATION_PER must be above 0 s"):
        found_at(aem(tmp_path, "SPIN/NUTATION", rows), T_S[:2])


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"version": "3.0"}, r"craft.aem:1: version 3.0 of the AEM is not known; use 1.0, 2.0"),
        ({"kind": "QUATERNION/SPIN"}, r"attitude type QUATERNION/SPIN is not supported"),
        ({"REF_FRAME_A": "RTN"}, r"attitudes from RTN to SC_BODY_1; one of the two must be of ICRF"),
        ({"ATTITUDE_DIR": "A3B"}, r"ATTITUDE_DIR is A2B or B2A"),
        ({"QUATERNION_TYPE": "MIDDLE"}, r"QUATERNION_TYPE is FIRST or LAST"),
        ({"TIME_SYSTEM": "MRT"}, r"time scale 'MRT' cannot be read"),
    ],
)
def test_what_an_aem_cannot_be(keys, message, tmp_path):
    keys = dict(keys)
    path = aem(tmp_path, keys.pop("kind", "QUATERNION"), quaternions_of(body(T_S)), **keys)
    with pytest.raises(InputError, match=message):
        found_at(path, T_S)


def test_an_aem_whose_span_or_degree_is_beyond_its_states(tmp_path):
    late = {"STOP_TIME": "2024-03-21T13:00:00"}
    with pytest.warns(InputWarning, match=r"the states do not reach STOP_TIME = 2024-03-21T13:00:00, only 2024-03-21T"):
        found_at(aem(tmp_path, "QUATERNION", quaternions_of(body(T_S)), **late), T_S)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        keys = {"INTERPOLATION_METHOD": "LAGRANGE", "INTERPOLATION_DEGREE": 20}
        found_at(aem(tmp_path, "QUATERNION", quaternions_of(body(T_S)), **keys), T_S)
    assert [str(w.message).partition(": ")[2] for w in caught] == [
        "LAGRANGE of degree 20 needs 21 states, and the segment has 8: degree 7 is used"
    ]
