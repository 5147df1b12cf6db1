import math

import numpy as np
import pytest

from simulator.optics import stray_light
from simulator.optics.stray_light import stray_light_e_s_pixel
from simulator.scenario import Scenario
from startracker.errors import InputError

Z = np.array([0.0, 0.0, 1.0])


def build_baffle(base_dir=None, pst=None, sun_exclusion_deg=35.0, moon_exclusion_deg=20.0, earth_exclusion_deg=25.0):
    return stray_light.build_baffle(pst, sun_exclusion_deg, moon_exclusion_deg, earth_exclusion_deg, base_dir)


def at(angle_deg):
    return np.array([[math.sin(math.radians(angle_deg)), 0.0, math.cos(math.radians(angle_deg))]])


def light(baffle, angle_deg, rate=1e17, aperture=2.0, pixel=3e-7):
    return stray_light_e_s_pixel(baffle, Z, at(angle_deg), [rate], aperture, pixel)


def test_without_a_baffle_there_is_none():
    assert build_baffle() is None
    assert light(None, 20.0) == 0.0


def test_vane_model():
    baffle = build_baffle(pst="vane", sun_exclusion_deg=30.0)
    # 1e-9 × (1e17 / 2 cm²) × 3e-7 cm²
    assert light(baffle, 45.0) == pytest.approx(1e-9 * 1e17 / 2.0 * 3e-7, rel=1e-12)
    assert light(baffle, 15.0) == pytest.approx(1e-6 * 1e17 / 2.0 * 3e-7, rel=1e-9)
    assert light(baffle, 0.0) == pytest.approx(1e-3 * 1e17 / 2.0 * 3e-7, rel=1e-9)
    assert light(baffle, 91.0) == 0.0


def test_sources_add_up():
    baffle = build_baffle(pst="vane")
    both = stray_light_e_s_pixel(baffle, Z, np.concatenate([at(40.0), at(10.0)]), [1e17, 1e10], 2.0, 3e-7)
    assert both == pytest.approx(light(baffle, 40.0) + light(baffle, 10.0, 1e10), rel=1e-12)
    assert stray_light_e_s_pixel(baffle, Z, np.zeros((0, 3)), [], 2.0, 3e-7) == 0.0


def test_curve_from_a_file(tmp_path):
    (tmp_path / "mine.csv").write_text("# measured\nangle_deg,pst\n0,1e-2\n\n20,1e-6\n60,1e-8\n")
    baffle = build_baffle(tmp_path, pst="mine.csv")
    assert baffle.transmittance(np.radians([0.0, 10.0, 20.0, 40.0, 60.0, 61.0])) == pytest.approx(
        [1e-2, 1e-4, 1e-6, 1e-7, 1e-8, 0.0], rel=1e-9
    )


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("angle,pst\n0,1\n", ":1: the header"),
        ("angle_deg,pst\n0,1\nten,1e-3\n", ":3: 'ten,1e-3'"),
        ("angle_deg,pst\n0,1\n10,1e-3,5\n", ":3: a line holds an angle and a transmittance; found '10,1e-3,5'"),
        ("angle_deg,pst\n5,1\n10,1e-3\n", ":2: angles must be ascending from 0"),
        ("angle_deg,pst\n0,1\n10,0.1\n10,0.1\n", ":4: angles must be ascending"),
        ("angle_deg,pst\n0,1\n10,0\n", ":3: a transmittance"),
        ("angle_deg,pst\n0,1\n10,nan\n", ":3: a transmittance"),
        ("angle_deg,pst\n0,1\n", "two or more lines"),
        ("", "two or more lines"),
    ],
)
def test_faults_of_a_file(tmp_path, text, fault):
    (tmp_path / "bad.csv").write_text(text)
    with pytest.raises(InputError, match=fault):
        build_baffle(tmp_path, pst="bad.csv")


def test_missing_and_binary_files(tmp_path):
    with pytest.raises(InputError, match=r"'vane' or a CSV"):
        build_baffle(tmp_path, pst="none.csv")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(InputError, match="is not text"):
        build_baffle(tmp_path, pst="binary.csv")


def test_exclusion_angles():
    baffle = build_baffle(pst="vane", sun_exclusion_deg=35.0, moon_exclusion_deg=20.0, earth_exclusion_deg=25.0)
    names = np.array(["Sun", "Moon", "Earth", "Earth"])
    directions = np.concatenate([at(34.0), at(21.0), at(40.0), at(24.0)])
    assert baffle.within_exclusion(names, Z, directions) == ["Earth", "Sun"]
    # a planet has no exclusion angle, not even on the boresight
    assert baffle.within_exclusion(["Jupiter", "Moon"], Z, np.concatenate([at(0.0), at(19.9)])) == ["Moon"]


def test_scenario_takes_a_baffle(tmp_path):
    text = (
        "name: a\nepoch: 2026-03-21T12:00:00Z\noptics: {focal_length_mm: 25, aperture_mm: 17.8, "
        "baffle: {pst: vane, sun_exclusion_deg: 40}}\n"
        "detector: {width: 64, height: 64, pixel_pitch_um: 5.5, exposure_s: 0.1}\n"
    )
    (tmp_path / "a.yaml").write_text(text)
    section = Scenario.load(tmp_path / "a.yaml").optics.baffle
    assert (section.pst, section.sun_exclusion_deg, section.moon_exclusion_deg) == ("vane", 40.0, 20.0)
    (tmp_path / "b.yaml").write_text(text.replace("sun_exclusion_deg", "sun_exlusion_deg"))
    with pytest.raises(InputError, match="sun_exclusion_deg"):
        Scenario.load(tmp_path / "b.yaml")
