"""What defines the attitude in the ``pointing`` section: files with their mistakes, spans, sequences and trials."""

import pickle
from datetime import UTC, datetime

import numpy as np
import pytest

from simulator.checks import load_scenario
from simulator.mission.attitude_law import AttitudeLaw, law_attitude
from simulator.mission.attitudes import build_attitude_law
from simulator.mission.parameters import AttitudeSource, OrbitParameters, PointingParameters, Waypoint, Waypoints
from simulator.mission.trajectories import build_trajectory
from simulator.renderer import Renderer
from simulator.scenario.errors import ScenarioError
from simulator.study.coverage.boresights import along_path
from simulator.study.sequence.frames import SequenceRunner
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude

EPOCH = datetime(2026, 3, 21, 12, tzinfo=UTC)
ORBIT = build_trajectory(OrbitParameters(), EPOCH)
AEM = """CCSDS_AEM_VERS = 1.0
CREATION_DATE = 2026-03-21T00:00:00
ORIGINATOR = TEST
META_START
OBJECT_NAME = CRAFT
OBJECT_ID = 2026-001A
REF_FRAME_A = ICRF
REF_FRAME_B = SC_BODY_1
ATTITUDE_DIR = A2B
TIME_SYSTEM = UTC
START_TIME = 2026-03-21T12:00:00
STOP_TIME = 2026-03-21T12:00:20
ATTITUDE_TYPE = QUATERNION
QUATERNION_TYPE = LAST
INTERPOLATION_METHOD = SLERP
INTERPOLATION_DEGREE = 2
META_STOP
DATA_START
2026-03-21T12:00:00 0.0 0.0 0.0 1.0
2026-03-21T12:00:10 0.0 0.0 0.0871557427476582 0.9961946980917455
2026-03-21T12:00:20 0.0 0.0 0.1736481776669303 0.9848077530122081
DATA_STOP
"""
CSV = """t_s,qx,qy,qz,qw
0,0,0,0,1
10,0,0,0.0871557427476582,0.9961946980917455
20,0,0,0.1736481776669303,0.984807753012208
"""


def law_of(tmp_path, kind, text, **others):
    path = tmp_path / f"craft.{kind}"
    path.write_text(text)
    return build_attitude_law(PointingParameters(attitude=AttitudeSource(**{kind: str(path)}, **others)), ORBIT)


def test_two_laws_contradict_each_other(tmp_path):
    """Without the checks of a scenario too; none and one are laws."""
    path = tmp_path / "craft.csv"
    path.write_text(CSV)
    table, slew = AttitudeSource(csv=str(path)), Waypoints(points=(Waypoint(0.0, 10.0, 20.0),))
    assert build_attitude_law(PointingParameters(), ORBIT) is None
    assert build_attitude_law(PointingParameters(waypoints=slew), ORBIT) is not None
    with pytest.raises(InputError, match="both define the attitude; remove one of them") as caught:
        build_attitude_law(PointingParameters(attitude=table, waypoints=slew), ORBIT)
    assert "attitude" in str(caught.value)
    assert "waypoints" in str(caught.value)


@pytest.mark.parametrize(("kind", "text"), [("aem", AEM), ("csv", CSV)])
def test_laws_alone_together_and_pickled(kind, text, tmp_path):
    law = law_of(tmp_path, kind, text)
    assert isinstance(law, AttitudeLaw)
    t_s = np.array([0.0, 3.25, 10.0, 20.0])
    found = law.quaternions(t_s)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(law)).quaternions(t_s), found)
    for t, q in zip(t_s, found, strict=True):
        np.testing.assert_array_equal(law.quaternions(np.array([t]))[0], q)
        # about +z at 1 degree a second: the axes turn, coordinates the other way
        np.testing.assert_allclose(
            law_attitude(law, t).apply([1.0, 0.0, 0.0])[:2],
            [np.cos(np.radians(t)), -np.sin(np.radians(t))],
            atol=2e-6,
        )
    assert law.quaternions(np.empty(0)).shape == (0, 4)


def replaced(old, new, text=AEM):
    assert old in text
    return text.replace(old, new)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (AEM[: AEM.index("0.0871")], r"craft.aem:20: a line has an epoch and 4 numbers, this one 2"),
        (replaced("2026-03-21T12:00:10 0.0", "2026-03-21T12:00:10 x"), r"craft.aem:20: 'x' is not a number"),
        (replaced("0.9961946980917455", "0.7"), r"craft.aem:20: the quaternion has a length of 0.705"),
        (replaced("12:00:10 0.0 0.0 0.0871557427476582 0.9961946980917455", "12:00:10 0 0 1 0"), r"craft.aem:20: 180°"),
        (replaced("2026-03-21T12:00:10", "2026-03-21T11:59:59"), r"craft.aem:20: the epoch is not after the one befor"),
        (replaced("= ICRF", "= SC_BODY_2"), r"craft.aem:7: attitudes from SC_BODY_2 to SC_BODY_1; one of the two"),
        (replaced("SC_BODY_1", "ANTENNA_1"), r"craft.aem:8: ANTENNA_1 is neither .* pointing.attitude.gives"),
        (replaced("= A2B", "= A3B"), r"craft.aem:9: ATTITUDE_DIR is A2B or B2A, not A3B"),
        (replaced("= LAST", "= MIDDLE"), r"craft.aem:14: QUATERNION_TYPE is FIRST or LAST, not MIDDLE"),
        (replaced("= QUATERNION\n", "= SPIN/X\n"), r"craft.aem:13: attitude type SPIN/X is not supported; use QUATER"),
        (replaced("= QUATERNION\n", "= EULER_ANGLE\n"), r"craft.aem:19: a line has an epoch and 3 numbers"),
        (
            replaced("SLERP\nINTERPOLATION_DEGREE = 2", "LAGRANGE\nINTERPOLATION_DEGREE = 1.5"),
            r"craft.aem:16: LAGRANGE of degree 1.5 is impossible",
        ),
        (replaced("= SLERP", "= CUBIC"), r"craft.aem:15: interpolation CUBIC is not supported; use LINEAR"),
        (replaced("= UTC", "= MARS"), r"craft.aem:19: time scale 'MARS' cannot be read"),
        (replaced("OBJECT_ID = 2026-001A\n", ""), r"craft.aem:4: the metadata has no OBJECT_ID"),
        (replaced("CCSDS_AEM", "CCSDS_OEM"), r"craft.aem:1: no CCSDS AEM; it starts with CCSDS_AEM_VERS"),
        ("<aem><body>", r"craft.aem:1: damaged or truncated XML"),
    ],
)
def test_mistakes_in_an_aem(text, message, tmp_path):
    with pytest.raises(InputError, match=message):
        law_of(tmp_path, "aem", text)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (replaced("qw", "q4", CSV), r"craft.csv:1: columns are missing: qw"),
        (replaced("t_s", "time", CSV), r"craft.csv:1: columns are missing: utc or t_s"),
        (replaced("10,0,0,", "10,0,0", CSV), r"craft.csv:3: 4 of 5 columns; is the file truncated"),
        (replaced("0.9961946980917455", "nan", CSV), r"craft.csv:3: qw is 'nan', which is not a finite number"),
        (replaced("10,0,0", "30,0,0", CSV), r"craft.csv:4: the time is not after the one before"),
        (CSV[: CSV.index("10,")], r"craft.csv: has fewer than two rows"),
    ],
)
def test_mistakes_in_a_table(text, message, tmp_path):
    with pytest.raises(InputError, match=message):
        law_of(tmp_path, "csv", text)


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(InputError, match=r"none.aem: cannot be read"):
        build_attitude_law(PointingParameters(attitude=AttitudeSource(aem=str(tmp_path / "none.aem"))), ORBIT)
    with pytest.raises(InputError, match=r"craft.parquet: is not a Parquet table"):
        law_of(tmp_path, "parquet", CSV)
    with pytest.raises(InputError, match=r"choose one of its objects by pointing.attitude.object: CRAFT \(2026-001A\)"):
        law_of(tmp_path, "aem", AEM, object="OTHER")
    with pytest.raises(InputError, match=r"aem and csv both define the attitude"):
        law_of(tmp_path, "aem", AEM, csv="x.csv")


def test_segments_objects_and_usable_spans(tmp_path):
    """Between segments nothing is interpolated; of two that overlap the later one holds; one object is chosen."""
    later = AEM[AEM.index("META_START") :].replace("T12:00:", "T12:01:")
    law = law_of(tmp_path, "aem", AEM + later)
    assert law.span_s == pytest.approx((0.0, 80.0), abs=2e-6)
    np.testing.assert_allclose(law.quaternions(np.array([70.0])), law.quaternions(np.array([10.0])), atol=1e-12)
    with pytest.raises(InputError, match=r"no attitudes from 2026-03-21T12:00:20.000 to 2026-03-21T12:01:00.000 UTC"):
        law.quaternions(np.array([5.0, 40.0]))
    still = AEM[AEM.index("META_START") :].replace("0.0871557427476582 0.9961946980917455", "0.0 1.0")
    still = still.replace("0.1736481776669303 0.9848077530122081", "0.0 1.0").replace("T12:00:00 0", "T12:00:05 0")
    still = still.replace("START_TIME = 2026-03-21T12:00:00", "START_TIME = 2026-03-21T12:00:05")
    both = law_of(tmp_path, "aem", AEM + still).quaternions(np.array([4.0, 6.0]))
    assert abs(both[0, 2]) > 0.03
    assert abs(both[1, 2]) < 1e-12
    other = later.replace("2026-001A", "2026-001B").replace("= CRAFT", "= OTHER")
    with pytest.raises(InputError, match=r"pointing.attitude.object: CRAFT \(2026-001A\), OTHER \(2026-001B\)"):
        law_of(tmp_path, "aem", AEM + other)
    assert law_of(tmp_path, "aem", AEM + other, object="OTHER").span_s[0] == pytest.approx(60.0, abs=2e-6)
    usable = "STOP_TIME = 2026-03-21T12:00:20\nUSEABLE_STOP_TIME = 2026-03-21T12:00:15"
    short = law_of(tmp_path, "aem", replaced("STOP_TIME = 2026-03-21T12:00:20", usable))
    assert short.span_s == pytest.approx((0.0, 15.0), abs=2e-6)
    frames = later.replace("SC_BODY_1", "SC_BODY_2")
    with pytest.raises(InputError, match=r"has attitudes of SC_BODY_1 and SC_BODY_2"):
        law_of(tmp_path, "aem", AEM + frames)


# ---------------------------------------------------------------- in scenarios
def scenario(tmp_path, text="", overrides=(), base="orbit"):
    (tmp_path / "craft.aem").write_text(AEM)
    file = tmp_path / "s.yaml"
    file.write_text(f"base: {base}\nname: s\npointing:\n  attitude: {{aem: craft.aem}}\n{text}")
    return load_scenario(file, overrides)


def test_mistakes_have_the_lines_of_the_scenario(tmp_path):
    for text, message in (
        (
            "  target: Sirius\n",
            r"s.yaml:4:14: pointing.attitude.aem: the attitude is already defined by pointing.target",
        ),
        ("  spin: {rate_deg_s: 1}\n", r"pointing.attitude.aem: the attitude is already defined by pointing.spin"),
    ):
        with pytest.raises(ScenarioError, match=message):
            scenario(tmp_path, text)
    with pytest.raises(ScenarioError, match=r"pointing.attitude.aem: .*none.aem: cannot be read"):
        scenario(tmp_path, overrides=["pointing.attitude.aem=none.aem"])
    with pytest.raises(ScenarioError, match=r"pointing.attitude.ck: .*x.bc: needs pointing.attitude.sclk"):
        scenario(tmp_path, overrides=["pointing.attitude.aem=null", "pointing.attitude.ck=x.bc"])


def test_trials_and_paths_within_the_span(tmp_path):
    """Trials over the span of the attitudes; the prior is the attitude of the file, seen by the mounting."""
    given = scenario(tmp_path, "study: {sampling: span}\n", ["pointing.rate_deg_s=[0, 0, 0]"])
    renderer = Renderer(given)
    path = along_path(given, 4)
    for index in range(4):
        scene = renderer.scene(index)
        assert 0.0 <= scene.t_s <= 20.0
        nominal = law_attitude(renderer.scenes.law, scene.t_s)
        expected = scene.pointing.mounting.as_matrix() @ nominal.as_matrix()
        np.testing.assert_allclose(scene.pointing.prior.as_matrix(), expected, atol=1e-14)
        np.testing.assert_allclose(path.matrices[index], expected, atol=1e-14)
        assert np.degrees(np.linalg.norm(scene.pointing.rate_camera_rad_s)) == pytest.approx(1.0, abs=1e-4)
    yearly = scenario(tmp_path, "study: {sampling: mission_year}\n")
    with pytest.raises(InputError, match=r"craft.aem covers 2026-03-21T12:00:00.000 to 2026-03-21T12:00:20.000 UTC; 2"):
        Renderer(yearly).scene(0)


def test_sequences_follow_the_file_with_offset_and_rate(tmp_path):
    """A = S C L: with no error, the offset and a rate of its own on top of the file's attitudes."""
    overrides = ["pointing.error_deg=0", "pointing.rate_deg_s=[0, 0, 0.5]", "pointing.offset_deg=[0, 0, 3]"]
    runner = SequenceRunner(scenario(tmp_path, "sequence: {frames: 11, step_s: 2.0}\n", overrides))
    for k, state in enumerate(runner.states):
        law = law_attitude(runner.renderer.scenes.law, 2.0 * k)
        turned = Attitude.from_rotation_vector(np.radians([0.0, 0.0, 3.0 + k]), "local_level", "body")
        expected = runner.start.mounting @ turned @ law
        np.testing.assert_allclose(state.camera.as_matrix(), expected.as_matrix(), atol=1e-13)
        assert np.degrees(np.linalg.norm(state.rate_camera_rad_s)) == pytest.approx(1.5, abs=1e-4)
    late = scenario(tmp_path, "sequence: {frames: 12, step_s: 2.0}\n", overrides)
    with pytest.raises(InputError, match=r"2026-03-21T12:00:22.000 is outside"):
        SequenceRunner(late)


def test_laws_of_scenarios(tmp_path):
    """Targets and slews by the keys of a scenario, and the mistakes in them."""
    ground = (
        "base: orbit\nname: g\npointing:\n  track: {target: ground, ground: {latitude_deg: 10, longitude_deg: 20}}\n"
    )
    slew = (
        "base: orbit\nname: w\npointing:\n  waypoints:\n    points:\n"
        "      - {at_s: 0, ra_deg: 10, dec_deg: 20}\n      - {at_s: 60, ra_deg: 50, dec_deg: 20, roll_deg: 5}\n"
    )
    files = {}
    for name, text in (("g", ground), ("w", slew)):
        files[name] = tmp_path / f"{name}.yaml"
        files[name].write_text(text)
    fixed = ["pointing.error_deg=0", "pointing.rate_deg_s=[0, 0, 0]", "sequence.frames=3", "sequence.step_s=30"]
    runner = SequenceRunner(load_scenario(files["w"], fixed))
    last = Attitude.from_radec_roll(50.0, 20.0, 5.0)
    np.testing.assert_allclose(runner.cameras[2].rotation_vector_to(last), 0.0, atol=1e-12)
    # the parameters of frames have the keys of a target only where there is one
    assert not any("track" in key for key in runner.renderer.parameters)
    renderer = Renderer(load_scenario(files["g"]))
    assert renderer.parameters["pointing.track.ground.latitude_deg"] == 10.0
    assert renderer.scenes.law.span_s == ORBIT.span_s
    (tmp_path / "other.csv").write_text("t_s\n0\n")
    for name, override, message in (
        (
            "w",
            "pointing.waypoints.max_rate_deg_s=0.1",
            r"waypoints.points: the slew of 38.57° .* takes 386.7 s, and 60 s",
        ),
        ("g", "pointing.track.ground.latitude_deg=91", r"pointing.track.ground.latitude_deg"),
        ("g", f"pointing.track.spacecraft.csv={tmp_path / 'other.csv'}", r"spacecraft.csv: .*other.csv:1: columns are"),
        ("g", "pointing.track.target=Pluto", r"pointing.track.target"),
    ):
        with pytest.raises(ScenarioError, match=message):
            load_scenario(files[name], [override])
    assert load_scenario(files["w"], ["pointing.track.target=Sun"]).pointing.laws == ("track",)  # replaces the slews
    both = ["pointing.track.target=Sun", "pointing.target=Moon"]
    with pytest.raises(ScenarioError, match=r"pointing.track.target: the attitude is already defined by pointing.targ"):
        load_scenario(files["w"], both)
    spline = ["pointing.waypoints.profile=spline", "study.sampling=span"]
    assert all(0.0 <= Renderer(load_scenario(files["w"], spline)).scene(k).t_s <= 60.0 for k in range(3))
    for name in ("w", "g"):
        with pytest.raises(ScenarioError, match=r"study.sampling: span is for orbits and attitudes that end"):
            load_scenario(files[name], ["study.sampling=span"])
