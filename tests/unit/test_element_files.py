"""Files of mean elements as they are found: text around two-line elements, every form of an OMM, and fields that select
another theory, frame or time scale, which are refused by their name."""

from datetime import UTC, datetime

import ccsds_ndm
import numpy as np
import pytest
from sgp4.api import WGS72, Satrec

from simulator.checks import load_scenario
from simulator.mission.clock import Clock
from simulator.mission.element_files import read_elements, read_omm, read_tle
from simulator.mission.mean_elements import epoch_s
from simulator.mission.messages import Header, aem_text, oem_text
from simulator.mission.oem import read_oem
from simulator.study.sequence.messages import sequence_messages
from startracker.errors import InputError, InputWarning

EPOCH = datetime(2024, 3, 27, 12, tzinfo=UTC)
HEADER = Header("scenario", "2024-03-27T00:00:00", "", "1998-067A")
CLOCK = Clock(EPOCH)
LINE_1 = "1 25544U 98067A   24087.50000000  .00016717  00000-0  30571-3 0  9997"
LINE_2 = "2 25544  51.6400 208.9163 0006317  69.9862  25.2906 15.49309432440163"
SET = f"{LINE_1}\n{LINE_2}\n"
T_S = np.linspace(0.0, 86_400.0, 7)
OMM = """CCSDS_OMM_VERS = 2.0
CREATION_DATE = 2024-090T16:00:00
ORIGINATOR = TEST
OBJECT_NAME = EXAMPLE [A]
OBJECT_ID = 1998-067A
CENTER_NAME = EARTH
REF_FRAME = TEME
TIME_SYSTEM = UTC
MEAN_ELEMENT_THEORY = SGP/SGP4
COMMENT mean elements
EPOCH = 2024-03-27T12:00:00.000
MEAN_MOTION = 15.49309432 [rev/day]
ECCENTRICITY = 0.0006317
INCLINATION = 51.64 [deg]
RA_OF_ASC_NODE = 208.9163 [deg]
ARG_OF_PERICENTER = 69.9862 [deg]
MEAN_ANOMALY = 25.2906 [deg]
EPHEMERIS_TYPE = 0
CLASSIFICATION_TYPE = U
NORAD_CAT_ID = 25544
BSTAR = 0.00030571 [1/ER]
MEAN_MOTION_DOT = 0.00016717 [rev/day**2]
MEAN_MOTION_DDOT = 0.0 [rev/day**3]
USER_DEFINED_EARTH_MODEL = WGS-84
"""


def checked(line):
    """The line with the check digit of its first 68 characters, by the definition: digits, and 1 for a minus sign."""
    total = sum(int(c) if c.isdigit() else c == "-" for c in line[:68])
    return line[:68] + str(total % 10)


def states(path, wanted=None, read=read_tle):
    return read(path, CLOCK, wanted, 30.0).state(T_S)


def written(tmp_path, text, name="craft.tle"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@pytest.mark.parametrize(
    ("text", "name"),
    [
        (SET, ""),
        (f"EXAMPLE SAT\n{SET}/EX\n", "EXAMPLE SAT"),
        (f"0 EXAMPLE SAT\n{SET}", "EXAMPLE SAT"),
        (f"  {LINE_1}\n  {LINE_2}\n", ""),
        (f"\t 0 EXAMPLE\n\t{LINE_1}\n \t{LINE_2}  \n\n", "EXAMPLE"),
        (f"EXAMPLE\n{SET}".replace("\n", "\r\n"), "EXAMPLE"),
        (b"\xef\xbb\xbf" + SET.encode(), ""),
        (f"# a comment\n\nEXAMPLE\n{LINE_1}\n  # between\n{LINE_2}\n", "EXAMPLE"),
        (f"BULLETIN 12 OF 24087\nTWO LINE ELEMENTS FOLLOW\nEXAMPLE\n{SET}\nEND OF BULLETIN\nNNNN\n", "EXAMPLE"),
        (f"OTHER\n{SET.replace('25544', '25545').replace('9997', '9998').replace('0163', '0164')}/EX\n{SET}/EX\n", ""),
        (f"1 EXAMPLE\n{SET}", "1 EXAMPLE"),
        (SET.replace("25544U", "25544C"), ""),
        (checked(LINE_1[:62] + "2" + LINE_1[63:]) + f"\n{LINE_2}\n", ""),
        (checked(LINE_1[:62] + " " + LINE_1[63:]) + f"\n{LINE_2}\n", ""),
    ],
)
def test_two_line_elements_as_bulletins_have_them(text, name, tmp_path):
    """The states of python-sgp4's own reading of the two lines, bit for bit in TEME."""
    path = written(tmp_path, text)
    orbit = read_tle(path, CLOCK, 25544, 30.0)
    assert orbit.elements.name == name
    np.testing.assert_array_equal(orbit.state(T_S), states(written(tmp_path, SET, "plain.tle")))
    theirs = Satrec.twoline2rv(LINE_1, LINE_2, WGS72)
    assert (orbit.elements.mean_anomaly_rad, orbit.elements.bstar) == (theirs.mo, theirs.bstar)
    assert orbit.object_id == "1998-067A"


def test_sets_without_check_digits_and_numbers_with_letters(tmp_path):
    path = written(tmp_path, f"{LINE_1[:68]}\n{LINE_2[:68]}\n")
    with pytest.warns(InputWarning, match=r"craft.tle:\d: the line has no check digit; is the file complete\?"):
        found = states(path)
    np.testing.assert_array_equal(found, states(written(tmp_path, SET, "plain.tle")))
    letters = "\n".join(checked(line.replace("25544", "B0012")) for line in (LINE_1, LINE_2))
    path = written(tmp_path, f"{letters}\n{SET}")
    assert [e.number for e in read_elements(path)] == ["110012", "25544"]
    for wanted in (110012, "110012", "B0012", "b0012"):
        assert read_tle(path, CLOCK, wanted, 30.0).elements.number == "110012"
    assert read_tle(written(tmp_path, SET), CLOCK, "1998-067a", 30.0).elements.number == "25544"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            checked(LINE_1[:62] + "4" + LINE_1[63:]) + f"\n{LINE_2}\n",
            r"tle:1: elements of ephemeris type 4, SGP4-XP or S",
        ),
        (
            checked(LINE_1[:62] + "1" + LINE_1[63:]) + f"\n{LINE_2}\n",
            r"tle:1: elements of ephemeris type 1, SGP, in col",
        ),
        (
            checked(LINE_1[:62] + "X" + LINE_1[63:]) + f"\n{LINE_2}\n",
            r"tle:1: .* type X in column 63; SGP4 needs type 0",
        ),
        (f"{SET}{LINE_1}\n", r"tle:3: the set of elements ends after line 1; the file is truncated"),
        (f"{SET}{LINE_1[:20]}\n", r"tle:3: the set of elements ends after line 1; the file is truncated"),
        (f"{SET}{LINE_2}\n", r"tle:3: line 2 of a set without its line 1"),
        (f"{SET}{LINE_2[:12]}\n", r"tle:3: line 2 of a set without its line 1"),
        (f"{LINE_1}\n/EX\n{LINE_2}\n", r"tle:2: is not line 2 of two-line elements, 69 characters"),
        (f"{LINE_1[:67]}\n{LINE_2}\n", r"tle:1: is not line 1 of two-line elements, 69 characters"),
        (SET.replace("9997", "9996"), r"tle:1: check digit 6, but the line adds up to 7"),
        ("a bulletin\nwithout elements\n", r"tle:2: is not a line of two-line elements"),
        (
            f"{LINE_1}\n" + checked(LINE_2[:52] + "00.00000000" + LINE_2[63:]) + "\n",
            r"tle:2: .* is less than zero",
        ),
    ],
)
def test_two_line_elements_that_cannot_be_read(text, message, tmp_path):
    with pytest.raises(InputError, match=message) as error:
        states(written(tmp_path, text))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("line", "first", "end"),
    [(0, 18, 20), (0, 20, 32), (1, 8, 16), (1, 17, 25), (1, 34, 42), (1, 43, 51), (1, 52, 63)],
)
def test_fields_of_two_line_elements_that_are_blank_or_no_numbers(line, first, end, tmp_path):
    """Year and day of the epoch, inclination, node, perigee, anomaly and mean motion: a blank one is not the next."""
    for filler in (" " * (end - first), "x" * (end - first)):
        lines = [LINE_1, LINE_2]
        lines[line] = checked(lines[line][:first] + filler + lines[line][end:])
        with pytest.raises(InputError, match=r"tle:[12]: ") as error:
            states(written(tmp_path, "\n".join(lines) + "\n"))
        assert "\n" not in str(error.value)


def test_both_lines_are_of_one_object(tmp_path):
    other = checked(LINE_2.replace("25544", "25545"))
    with pytest.raises(InputError, match="lines 1 and 2 are of the objects 25544 and 25545"):
        states(written(tmp_path, f"{LINE_1}\n{other}\n"))


@pytest.mark.parametrize("form", ["kvn", "xml", "ndm"])
@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("epoch", ["2024-03-27T12:00:00.000", "2024-087T12:00:00.000Z", "2024-087T12:00:00"])
@pytest.mark.parametrize("theory", ["SGP4", "SGP/SGP4", "sgp4"])
def test_omm_of_every_form(form, version, epoch, theory, tmp_path):
    """The state of the two lines of the same numbers: the same doubles but for degrees and radians, 1e-6 km."""
    text = OMM.replace("2024-03-27T12:00:00.000", epoch).replace("VERS = 2.0", f"VERS = {version}")
    text = text.replace("SGP/SGP4", theory)
    path = written(tmp_path, text, "craft.omm")
    if form != "kvn":
        xml = ccsds_ndm.from_file(str(path)).to_str("xml")
        body = xml.partition("?>")[2]
        path.write_text(xml if form == "xml" else f"<ndm>{body}{body.replace('25544', '25545')}</ndm>")
    orbit = read_omm(path, CLOCK, 25544, 30.0)
    expected = states(written(tmp_path, SET))
    np.testing.assert_allclose(orbit.state(T_S), expected, rtol=0, atol=1e-6)
    assert (orbit.elements.name, orbit.object_id) == ("EXAMPLE [A]", "1998-067A")
    assert orbit.elements.epoch_jd == (2_460_396.5, 0.5)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("SGP/SGP4", "SGP4-XP", r"MEAN_ELEMENT_THEORY is SGP4-XP; SGP4 needs SGP4 or SGP/SGP4"),
        ("SGP/SGP4", "SGP", r"MEAN_ELEMENT_THEORY is SGP;"),
        ("SGP/SGP4", "DSST", r"MEAN_ELEMENT_THEORY is DSST;"),
        ("SGP/SGP4", "PPT3", r"MEAN_ELEMENT_THEORY is PPT3;"),
        ("= TEME", "= GCRF", r"REF_FRAME is GCRF; SGP4 needs TEME or TEMEOFDATE"),
        ("= TEME", "= TEMEOFEPOCH", r"REF_FRAME is TEMEOFEPOCH; SGP4 needs TEME"),
        ("TIME_SYSTEM = UTC", "TIME_SYSTEM = TAI", r"TIME_SYSTEM is TAI; SGP4 needs UTC"),
        ("= EARTH\n", "= MARS\n", r"CENTER_NAME is MARS; SGP4 needs EARTH"),
        ("EPHEMERIS_TYPE = 0", "EPHEMERIS_TYPE = 4", r"EPHEMERIS_TYPE is 4 \(SGP4-XP or SGP8\); SGP4 needs 0"),
        ("EPHEMERIS_TYPE = 0", "EPHEMERIS_TYPE = 9", r"EPHEMERIS_TYPE is 9; SGP4 needs 0"),
        (
            "TIME_SYSTEM",
            "REF_FRAME_EPOCH = 2024-001T00:00:00\nTIME_SYSTEM",
            r"REF_FRAME_EPOCH cannot be used; the axes",
        ),
        ("BSTAR = 0.00030571 [1/ER]", "BTERM = 0.02 [m**2/kg]", r"BTERM cannot be used; SGP4 needs BSTAR"),
        (
            "MEAN_MOTION = 15.49309432 [rev/day]",
            "SEMI_MAJOR_AXIS = 6790 [km]",
            r"SEMI_MAJOR_AXIS cannot be used; SGP4 n",
        ),
        ("51.64 [deg]", "0.9013 [rad]", r"INCLINATION is in rad; the standard has deg"),
        ("15.49309432 [rev/day]", "5577.5 [deg/day]", r"MEAN_MOTION is in deg/day; the standard has rev/day"),
        ("VERS = 2.0", "VERS = 7.0", r"version 7.0 of the OMM is not known"),
        ("EPOCH = 2024-03-27", "EPOCH = 2024-02-30", r"'2024-02-30T12:00:00.000' is not a date and time of UTC"),
        ("EPOCH = 2024-03-27", "EPOCH = 2023-366", r"'2023-366T12:00:00.000' is not an epoch"),
        ("12:00:00.000", "12:00:00.000+02:00", r"is not an epoch such as"),
        ("0.0006317", "1.1", r"eccentricity 1.1 with mean motion"),
        ("51.64 [deg]", "nan [deg]", r"INCLINATION is 'nan \[deg\]', which is not a number"),
        ("MEAN_ANOMALY = 25.2906 [deg]\n", "", r"craft.omm: the message has no MEAN_ANOMALY; it is incomplete"),
        ("CCSDS_OMM", "CCSDS_OPM", r"craft.omm:1: no CCSDS OMM; .*; this is a CCSDS OPM"),
    ],
)
def test_every_field_that_selects_something_else_is_refused_by_name(old, new, message, tmp_path):
    assert OMM.count(old) == 1
    with pytest.raises(InputError, match=message) as error:
        states(written(tmp_path, OMM.replace(old, new), "craft.omm"), read=read_omm)
    assert "\n" not in str(error.value)


def test_a_gravitational_parameter_that_sgp4_does_not_have(tmp_path):
    for value in ("398600.8", "398600.8 [km**3/s**2]"):
        states(written(tmp_path, f"{OMM}GM = {value}\n", "craft.omm"), read=read_omm)
    with pytest.warns(InputWarning, match=r"craft.omm:25: GM is not used; SGP4 has that of WGS 72, 398600.8 km"):
        states(written(tmp_path, f"{OMM}GM = 398600.4415 [km**3/s**2]\n", "craft.omm"), read=read_omm)


def test_epochs_at_a_leap_second(tmp_path):
    """23:59:60.25 at the end of 2016 is a quarter of a second before 2017, not after its start."""
    clock = Clock(datetime(2016, 12, 31, 23, 59, tzinfo=UTC))
    for text, expected_s in (
        ("2016-12-31T23:59:59.25", 59.25),
        ("2016-12-31T23:59:60.25", 60.25),
        ("2017-001T00:00:00.25", 61.25),
    ):
        path = written(tmp_path, OMM.replace("2024-03-27T12:00:00.000", text), "craft.omm")
        # Julian dates of seconds in a double of days: 1e-11 d
        assert epoch_s(read_elements(path)[0], clock) == pytest.approx(expected_s, abs=2e-6)


def test_messages_of_an_orbit_carry_the_identifier_of_its_elements(tmp_path):
    """The international designator of a TLE or OMM becomes OBJECT_ID, which a second reading keeps."""
    for orbit in (
        read_tle(written(tmp_path, SET), CLOCK, None, 30.0),
        read_omm(written(tmp_path, OMM, "craft.omm"), CLOCK, None, 30.0),
    ):
        header = Header("scenario", "2024-03-27T00:00:00", "", orbit.object_id)
        text = oem_text(orbit, np.array([0.0, 60.0, 120.0]), header)
        assert "\nOBJECT_NAME = scenario\nOBJECT_ID = 1998-067A\n" in text
        assert read_oem(written(tmp_path, text, "again.oem"), CLOCK, None).object_id == "1998-067A"
        attitudes = aem_text(CLOCK, np.array([0.0]), np.array([[0.0, 0.0, 0.0, 1.0]]), header)
        assert "\nOBJECT_ID = 1998-067A\n" in attitudes
    nameless = SET.replace("98067A", "      ").replace("9997", "9994")
    lines = [checked(line) for line in nameless.splitlines()]
    assert read_tle(written(tmp_path, "\n".join(lines)), CLOCK, None, 30.0).object_id == ""
    without = oem_text(orbit, np.array([0.0, 60.0]), Header("scenario", "2024-03-27T00:00:00"))
    assert "\nOBJECT_ID = scenario\n" in without


@pytest.mark.parametrize("key", ["tle", "omm", "oem"])
def test_messages_of_a_sequence_carry_it_too(key, tmp_path):
    """OEM, AEM and ACM of ``run --sequence --ccsds``, with the scenario's name; `ccsds-ndm-py` reads them."""
    orbit = read_tle(written(tmp_path, SET), CLOCK, None, 30.0)
    text = {"tle": SET, "omm": OMM, "oem": oem_text(orbit, T_S[:3], HEADER)}
    written(tmp_path, text[key], f"craft.{key}")
    scenario = f"base: orbit\nname: mine\nepoch: {EPOCH:%Y-%m-%dT%H:%M:%SZ}\norbit: {{{key}: craft.{key}}}\n"
    file = written(tmp_path, scenario, "s.yaml")
    columns = {"t_s": np.array([0.0, 60.0])}
    columns |= {f"{p}q{a}": np.full(2, float(a == "w")) for p in ("true_", "") for a in "xyzw"}
    columns |= {f"sigma_{axis}_deg": np.full(2, 1e-4) for axis in ("cross_x", "cross_y", "about_boresight")}
    files = sequence_messages(load_scenario(file), columns, "2024-03-27T00:00:00")
    for name in ("trajectory.oem", "true.aem", "estimated.aem"):
        assert "\nOBJECT_NAME = mine\nOBJECT_ID = 1998-067A\n" in files[name]
    acm = ccsds_ndm.from_file(str(written(tmp_path, files["estimated.acm"], "e.acm")))
    assert acm.segment.metadata.international_designator == "1998-067A"
