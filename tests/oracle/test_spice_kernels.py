"""Trajectory and attitudes written as SPICE kernels, read by CSPICE through SpiceyPy."""

from datetime import UTC, datetime

import numpy as np
import pytest
import spiceypy
from scipy.spatial.transform import Rotation, Slerp
from spiceypy.utils.exceptions import SpiceyError

from simulator.build import build_orbit
from simulator.mission.clock import Clock
from simulator.mission.elliptic import EllipticOrbit
from simulator.mission.epochs import tdb_seconds
from simulator.mission.kepler import Elements
from simulator.mission.spice import CAMERA_FRAME, SPACECRAFT_ID, Attitudes, spice_kernels
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.study.sequence.run import run_sequence
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude

CLOCK = Clock(datetime(2026, 3, 21, 12, tzinfo=UTC))
ORBIT = EllipticOrbit(Elements(9_000.0, 0.2, 1.0, 2.0, 3.0, 0.0), CLOCK, frame="icrf", j2=False)


@pytest.fixture
def loaded(tmp_path):
    """Writes files and loads them; SPICE is cleared afterwards."""

    def load(files):
        for name, data in files.items():
            (tmp_path / name).write_bytes(data)
            spiceypy.furnsh(str(tmp_path / name))

    yield load
    spiceypy.kclear()


def attitudes(t_s):
    return np.array([Attitude.from_radec_roll(350.0 + 0.06 * t, 60.0 - 0.02 * t, 1.3 * t).quat for t in t_s])


def matrix_at(et_s):
    return spiceypy.pxform("J2000", CAMERA_FRAME, et_s)


def test_attitudes_and_states_as_spice_reads_them(loaded):
    t_s = np.arange(50) * 10.0
    quaternions = attitudes(t_s)
    loaded(spice_kernels(ORBIT, t_s, {"true.bc": Attitudes(t_s, quaternions)}))
    et_s = tdb_seconds(CLOCK, t_s)
    found = np.array([matrix_at(et) for et in et_s])
    expected = np.array([Attitude(q).as_matrix() for q in quaternions])
    assert np.abs(found - expected).max() < 1e-12
    states = np.array([spiceypy.spkezr(str(SPACECRAFT_ID), et, "J2000", "NONE", "399")[0] for et in et_s])
    r_km, v_km_s = ORBIT.state(t_s)
    assert np.abs(states[:, :3] - r_km).max() < 1e-12 * np.abs(r_km).max()
    assert np.abs(states[:, 3:] - v_km_s).max() < 1e-12 * np.abs(v_km_s).max()


def test_spice_interpolates_between_frames_and_not_across_gaps(loaded):
    t_s = np.concatenate([np.arange(8), np.arange(12, 20)]) * 10.0
    quaternions = attitudes(t_s)
    loaded(spice_kernels(ORBIT, t_s, {"estimated.bc": Attitudes(t_s, quaternions)}))
    between = Slerp(t_s, Rotation.from_matrix([Attitude(q).as_matrix() for q in quaternions]))
    at = np.array([3.0, 44.4, 69.0, 125.0, 189.0])
    for t, et in zip(at, tdb_seconds(CLOCK, at), strict=True):
        # times are doubles of seconds after J2000, 1e-7 s, at 1.3°/s
        assert np.abs(matrix_at(et) - between(t).as_matrix()).max() < 1e-8
    for et in tdb_seconds(CLOCK, np.array([75.0, 115.0])):
        with pytest.raises(SpiceyError):
            matrix_at(et)


def test_files_of_a_sequence(tmp_path, loaded):
    scenario = Scenario.load(
        "cubesat_ideal", ["sequence.frames=4", "sequence.step_s=5", "detector.width=512", "detector.height=512"]
    )
    sequence = run_sequence(scenario, out=tmp_path / "out", spice=True)
    names = {"trajectory.bsp", "true.bc", "estimated.bc", "camera.tsc", "camera.tf"}
    assert names <= set(sequence.files)
    columns = sequence.columns
    for name in sorted(names - {"true.bc"}):
        spiceypy.furnsh(str(tmp_path / "out" / name))
    et_s = tdb_seconds(build_orbit(scenario).clock, columns["t_s"])
    for k, et in enumerate(et_s):
        estimate = np.array([columns[f"q{axis}"][k] for axis in "xyzw"])
        assert np.abs(matrix_at(et) - Attitude(estimate).as_matrix()).max() < 1e-12
        state = spiceypy.spkezr(str(SPACECRAFT_ID), et, "J2000", "NONE", "399")[0]
        row = [columns[f"{axis}_km"][k] for axis in "xyz"] + [columns[f"v{axis}_km_s"][k] for axis in "xyz"]
        assert state == pytest.approx(row, rel=1e-12, abs=1e-9)


def test_a_single_frame_has_no_trajectory(loaded):
    files = spice_kernels(ORBIT, np.array([5.0]), {"true.bc": Attitudes(np.array([5.0]), attitudes([5.0]))})
    assert "trajectory.bsp" not in files
    loaded(files)
    expected = Attitude(attitudes([5.0])[0]).as_matrix()
    assert np.abs(matrix_at(tdb_seconds(CLOCK, np.array([5.0]))[0]) - expected).max() < 1e-12


def test_without_the_package_it_is_said_before_the_run(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "spiceypy", None)
    with pytest.raises(InputError, match=r"boresight\[spice\]"):
        run_sequence(Scenario.load("cubesat_ideal"), out=tmp_path / "out", spice=True)
    assert not (tmp_path / "out").exists()


def test_a_scenario_flies_the_kernels_again(tmp_path):
    """Orbit and attitude from the kernels of a sequence: the same sky at its frames."""
    first = Scenario.load("cubesat_ideal", ["sequence.frames=4", "sequence.step_s=5"])
    columns = run_sequence(first, out=tmp_path / "out", spice=True).columns
    given = {"orbit.spk": "trajectory.bsp", "pointing.attitude.ck": "true.bc", "pointing.attitude.sclk": "camera.tsc"}
    keys = [f"{key}={tmp_path / 'out' / name}" for key, name in given.items()]
    again = Renderer(Scenario.load("cubesat_ideal", [*keys, "pointing.attitude.gives=camera", "pointing.error_deg=0"]))
    for k in range(4):
        scene = again.scene(at_s=float(columns["t_s"][k]))
        true = np.array([columns[f"true_q{axis}"][k] for axis in "xyzw"])
        # TDB − TT of SPICE and of ERFA differ by up to 30 µs, in which the camera turns by 3e-8 rad
        assert np.abs(scene.pointing.camera.as_matrix() - Attitude(true).as_matrix()).max() < 1e-7
        assert scene.r_km == pytest.approx([columns[f"{axis}_km"][k] for axis in "xyz"], abs=1e-3)
