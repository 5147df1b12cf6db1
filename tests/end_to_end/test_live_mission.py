"""A mission that is stepped: the bits of a sequence; parameters, kicks, jumps; recordings that a sequence repeats."""

import numpy as np
import pytest
from live_client import row_of, small

from simulator.checks import load_scenario
from simulator.live.messages import solution_message, truth_message
from simulator.live.mission import LiveMission
from simulator.live.motion import Given
from simulator.live.protocol import Refused
from simulator.renderer import Renderer
from simulator.study.sequence.frames import SequenceRunner
from simulator.study.trials.bounds import attitude_bound_deg, matched_sources
from startracker.errors import BoresightError, InputError

pytestmark = pytest.mark.system

MOVING = (
    "pointing.jitter.rms_arcsec=[3,3,3]",
    "pointing.rate_deg_s=[0.02,0.01,0.03]",
    "pointing.thermo_elastic.amplitude_arcsec=[5,5,5]",
    "sequence.start_s=12.3",
    "sequence.dropouts=[{start_s: 1.0, duration_s: 0.6}]",
)


def same_frames(tracked, other):
    assert row_of(tracked.row) == row_of(other.row)
    assert (tracked.frame is None) == (other.frame is None)
    if tracked.frame is not None:
        np.testing.assert_array_equal(tracked.frame.image, other.frame.image)


@pytest.mark.parametrize(
    "overrides",
    [MOVING, ("tracker.prior=true",), ("sequence.operation.use=true",), ("tracker.in_flight_calibration.use=true",)],
    ids=["moving", "prior", "rules", "calibrated"],
)
def test_rows_and_images_are_those_of_a_sequence_bit_for_bit(overrides):
    scenario = small(*overrides)
    mission = LiveMission(scenario)
    for tracked in SequenceRunner(scenario).frames():
        same_frames(mission.step().tracked, tracked)
    assert mission.step().index == scenario.sequence.frames  # it goes on


def test_ephemerides_do_not_depend_on_the_block_in_which_they_are_computed():
    # beyond the first 64 frames, and in lockstep, other times are computed together than in a sequence
    scenario = small(*MOVING, "sequence.step_s=60")
    scenes, t_s = Renderer(scenario).scenes, 12.3 + 60.0 * np.arange(20)
    scenes.plan(t_s)
    together = [scenes.instant_at(t) for t in t_s.tolist()]
    for t, one in zip(t_s.tolist(), together, strict=True):
        scenes.plan([t])
        alone = scenes.instant_at(t)
        for name in ("r_km", "v_km_s", "sun_au"):
            np.testing.assert_array_equal(getattr(alone, name), getattr(one, name))
        np.testing.assert_array_equal(alone.bodies.direction, one.bodies.direction)
        np.testing.assert_array_equal(alone.observer.velocity_km_s, one.observer.velocity_km_s)


def test_lockstep_with_the_attitudes_of_a_sequence_gives_its_attitudes():
    scenario = small("pointing.rate_deg_s=[0.02,0.01,0.03]")
    runner, mission = SequenceRunner(scenario), LiveMission(scenario)
    mission.use_source(external=True)
    for state, tracked in zip(runner.states, runner.frames(), strict=True):
        given = Given(state.t_s, tuple(state.camera.quat.tolist()), tuple(np.degrees(state.rate_camera_rad_s).tolist()))
        live = mission.step(given, lockstep=True)
        # normalising a unit quaternion again, and degrees, may change the last bit
        np.testing.assert_allclose(live.tracked.row["true_qw"], tracked.row["true_qw"], rtol=1e-15)
        np.testing.assert_array_equal(live.tracked.frame.image, tracked.frame.image)
        np.testing.assert_array_equal(live.tracked.solution.attitude.quat, tracked.solution.attitude.quat)
        np.testing.assert_array_equal(live.tracked.solution.covariance, tracked.solution.covariance)


def test_time_in_lockstep_does_not_go_back():
    mission = LiveMission(small())
    mission.use_source(external=True)
    quaternion = tuple(mission.start.camera.quat.tolist())
    mission.step(Given(5.0, quaternion, (0.0, 0.0, 0.0)), lockstep=True)
    for t_s in (5.0, 4.9):
        with pytest.raises(Refused, match="is not after 5 s"):
            mission.step(Given(t_s, quaternion, (0.0, 0.0, 0.0)), lockstep=True)
    assert mission.step(Given(5.1, quaternion, (0.0, 0.0, 0.0)), lockstep=True).index == 1


def test_the_newest_attitude_is_turned_on_by_its_rate():
    mission = LiveMission(small("sequence.step_s=0.5"))
    mission.use_source(external=True)
    given = Given(100.0, tuple(mission.start.camera.quat.tolist()), (0.0, 0.0, 2.0))
    first, second = (mission.step(given).moment.state for _ in range(2))
    assert (first.t_s, second.t_s) == (100.0, 100.5)
    np.testing.assert_allclose(first.camera.rotation_vector_to(second.camera), np.radians([0.0, 0.0, 1.0]), atol=1e-15)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("detector.exposure_s", 0.05),
        ("optics.aperture_mm", 6.0),
        ("detector.gain_e_per_dn", 7.0),
        ("detector.temperature_c", 45.0),
        ("detector.read_noise_e", 40.0),
        ("detector.hot_pixel_fraction", 0.004),
        ("environment.age_years", 4.0),
    ],
)
def test_a_changed_parameter_gives_the_frame_of_a_new_camera(path, value):
    mission = LiveMission(small())
    before = mission.step().tracked.frame.image
    scenes = mission.renderer.scenes
    mission.set({path: value})
    live = mission.step()
    assert mission.values()[path] == pytest.approx(value, rel=1e-12)
    assert mission.renderer.scenes is scenes
    state = live.moment.state
    given = {"at_s": state.t_s, "attitude": state.camera, "rate_camera_rad_s": state.rate_camera_rad_s}
    expected, _ = Renderer(mission.scenario).frame(1, **given)
    np.testing.assert_array_equal(live.tracked.frame.image, expected.image)
    assert live.tracked.frame.parameters == expected.parameters
    assert live.tracked.frame.read_noise_e == expected.read_noise_e
    unchanged, _ = Renderer(small()).frame(1, **given)
    assert (unchanged.image != live.tracked.frame.image).any()
    assert before.shape == expected.image.shape


def test_only_what_depends_on_a_parameter_is_built_again():
    mission = LiveMission(small())
    renderer, tracker = mission.renderer, mission.camera.tracker
    mission.set({"detector.exposure_s": 0.05})
    exposed = mission.renderer
    assert exposed.focal_plane is renderer.focal_plane
    assert exposed.detector is renderer.detector
    mission.set({"detector.temperature_c": 30.0})
    assert mission.renderer.focal_plane is renderer.focal_plane
    assert mission.renderer.detector is not renderer.detector
    mission.set({"optics.aperture_mm": 7.0})
    assert mission.renderer.focal_plane is not renderer.focal_plane
    assert mission.camera.tracker is tracker


@pytest.mark.parametrize(
    ("path", "value", "reason"),
    [
        ("detector.exposure_s", 1e9, "is outside"),
        ("detector.exposure_s", float("nan"), "is outside"),
        ("seed", 3.0, "not a parameter of this mission"),
        ("tracker.magnitude_limit", 3.0, "not a parameter of this mission"),
        ("detector.temperature_c", 80.0, "dark current"),  # within its range, and refused by the physics
    ],
)
def test_an_invalid_value_is_refused_and_nothing_changes(path, value, reason):
    mission = LiveMission(small("detector.dark_current_e_s=20000", "detector.temperature_c=0"))
    renderer, values = mission.renderer, mission.values()
    with pytest.raises(Refused, match=reason) as refused:
        mission.set({path: value})
    assert "\n" not in refused.value.reason
    assert mission.renderer is renderer
    assert mission.values() == values


def test_a_kick_turns_the_body_about_its_axes():
    scenario = small("sequence.step_s=0.5")
    quiet, kicked = LiveMission(scenario), LiveMission(scenario)
    quiet.step(), kicked.step()
    kicked.kick((0.0, 0.0, 0.4))
    assert kicked.values()["pointing.rate_deg_s.yaw"] == pytest.approx(0.4)
    expected, found = quiet.step().moment.state.camera, kicked.step().moment.state.camera
    body = kicked.start.mounting.inverse
    turn = body.apply(expected.rotation_vector_to(found))
    np.testing.assert_allclose(np.degrees(turn), [0.0, 0.0, 0.2], atol=1e-5)  # 0.4°/s for half a second
    kicked.set({"pointing.rate_deg_s.yaw": 0.0})
    still = body.apply(quiet.step().moment.state.camera.rotation_vector_to(kicked.step().moment.state.camera))
    np.testing.assert_allclose(np.degrees(still), [0.0, 0.0, 0.2], atol=1e-5)


def test_a_jump_is_to_the_scenarios_own_motion():
    scenario = small("sequence.start_s=10", "pointing.rate_deg_s=[0.02,0.01,0.03]", "sequence.frames=9")
    mission, states = LiveMission(scenario), SequenceRunner(scenario).states
    mission.step()
    mission.seek(states[6].t_s)
    live = mission.step()
    assert live.index == 1
    np.testing.assert_allclose(live.moment.state.camera.rotation_vector_to(states[6].camera), 0.0, atol=1e-12)
    assert live.tracked.row["mode"] == "lost_in_space"
    with pytest.raises(Refused, match="before the first frame"):
        mission.seek(9.0)


def test_the_anomaly_is_over_the_south_atlantic_with_particles():
    pytest.importorskip("aep8")
    mission = LiveMission(small())
    mission.step()
    t_s = mission.seek_anomaly()
    live, here = mission.step(), mission.renderer.scenes.instant_at(t_s)
    assert live.moment.state.t_s == t_s
    # wide limits of the region between South America and southern Africa, where the inner belt is nearest to the ground
    assert -55.0 < here.latitude_deg < 10.0
    assert -110.0 < (here.longitude_deg + 180.0) % 360.0 - 180.0 < 40.0
    assert live.tracked.truth.particles_cm2_s > 1.0


@pytest.mark.parametrize("lockstep", [False, True])
def test_a_recording_is_repeated_bit_for_bit(tmp_path, lockstep):
    mission = LiveMission(small(*MOVING[:3], "sequence.dropouts=[]"))
    mission.set({"detector.exposure_s": 0.12, "optics.aperture_mm": 7.0})
    for _ in range(3):
        mission.step()
    states = [mission.motion.at(20.0 + 0.4 * k).camera.quat for k in range(8)]
    if lockstep:
        mission.use_source(external=True)
    mission.record()
    recorded = []
    for k in range(8):
        mission.blinded = k in (3, 4)
        if k == 2 and not lockstep:
            mission.kick((0.05, -0.02, 0.1))
        given = Given(20.0 + 0.4 * k, tuple(states[k].tolist()), (0.01, 0.0, 0.06)) if lockstep else None
        recorded.append(mission.step(given, lockstep=lockstep))
    with pytest.raises(Refused, match="end it first"):
        mission.set({"detector.exposure_s": 0.2})
    recording = mission.stop_recording()
    recording.write(tmp_path / "session")
    scenario = load_scenario(tmp_path / "session/scenario.yaml")
    replayed = list(SequenceRunner(scenario).frames())
    assert len(replayed) == len(recorded) == 8
    for live, tracked in zip(recorded, replayed, strict=True):
        same_frames(live.tracked, tracked)
    assert [t.row["status"] for t in replayed][2:6] == ["solved", "no_frame", "no_frame", "solved"]
    assert recorded[0].index == 3  # the index of clients ascends, that of the recording begins at 0


def test_the_table_of_a_recording_is_one_of_attitudes(tmp_path):
    mission = LiveMission(small("sequence.step_s=0.5"))
    mission.record()
    live = [mission.step() for _ in range(3)]
    mission.stop_recording().write(tmp_path)
    laws = [f"pointing.attitude.csv={tmp_path / 'attitudes.csv'}", "pointing.attitude.gives=camera"]
    states = SequenceRunner(small("sequence.step_s=0.5", "sequence.frames=3", "pointing.error_deg=0", *laws)).states
    for one, state in zip(live, states, strict=True):
        np.testing.assert_allclose(one.moment.state.camera.rotation_vector_to(state.camera), 0.0, atol=1e-14)


def test_a_recording_with_other_times_is_refused(tmp_path):
    mission = LiveMission(small())
    mission.record()
    mission.step(), mission.step()
    mission.stop_recording().write(tmp_path)
    for override, reason in (("sequence.step_s=0.7", "but frame 1 is at 0.7 s"), ("sequence.frames=3", "has 2 of 3")):
        with pytest.raises(InputError, match=reason):
            SequenceRunner(load_scenario(tmp_path / "scenario.yaml", [override]))
    with pytest.raises(BoresightError, match="scenario has heads"):
        load_scenario("two_heads", [f"sequence.recording={tmp_path / 'attitudes.csv'}"])


@pytest.mark.parametrize(("name", "overrides"), [("two_heads", []), ("cubesat_ideal", ["sequence.gyro.use=true"])])
def test_several_heads_and_a_gyro_are_refused(name, overrides):
    with pytest.raises(InputError, match="a live mission has one camera and no gyro"):
        LiveMission(load_scenario(name, overrides))


def test_messages_of_a_frame_agree_with_its_row():
    mission = LiveMission(small())
    mission.step()
    live = mission.step()
    row = live.tracked.row
    solution, truth = solution_message(live, mission.camera.session, 1.0), truth_message(live)
    assert solution.status == row["status"] == "solved"
    assert list(solution.quaternion) == [row[f"q{axis}"] for axis in "xyzw"]
    assert len(solution.stars) == row["stars_matched"]
    assert len(solution.detections) == row["stars_detected"]
    errors = [3600.0 * row[f"error_{axis}_deg"] for axis in ("cross_x", "cross_y", "about_boresight")]
    np.testing.assert_allclose(truth.error_arcsec, errors, rtol=1e-15)
    assert list(truth.quaternion) == [row[f"true_q{axis}"] for axis in "xyzw"]
    bound_deg = attitude_bound_deg(
        mission.renderer, live.tracked.truth, matched_sources(live.tracked.truth, live.tracked.solution.stars.fitted.xy)
    )
    np.testing.assert_allclose(truth.bound_arcsec, 3600.0 * bound_deg, rtol=1e-15)
    unit = np.linalg.norm([truth.sun, truth.moon, truth.earth], axis=1)
    np.testing.assert_allclose(unit, 1.0, rtol=1e-12)
    # asin(6378.137 / (6378.137 + 800)) for a spherical orbit of 800 km altitude: 62.69°
    assert truth.earth_radius_deg == pytest.approx(62.69, abs=0.2)
