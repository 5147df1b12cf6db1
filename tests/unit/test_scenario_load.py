"""What loading gives: values, bases, overrides, the way back to YAML, immutability."""

import json
import os
import pickle
from datetime import UTC, datetime
from pathlib import Path

import pytest
from pydantic import ValidationError

from simulator.scenario import Scenario, ScenarioError, find_scenario
from simulator.scenario.fields import all_keys, check_value, flatten
from simulator.scenario.output import json_schema, yaml_value

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = sorted((ROOT / "scenarios").glob("*.yaml"))
GOOD = """\
name: demo
epoch: 2026-03-21T12:00:00Z
optics: {focal_length_mm: 50, aperture_mm: 25}
detector: {width: 512, height: 512, pixel_pitch_um: 10, exposure_s: 0.1}
"""


@pytest.mark.parametrize("path", SHIPPED, ids=lambda p: p.stem)
def test_shipped_scenarios_load_and_come_back(path):
    scenario = Scenario.load(path)
    assert scenario.name == path.stem
    assert scenario.path == path
    assert scenario.base_dir == path.parent
    assert Scenario.parse(scenario.to_yaml()) == scenario
    assert Scenario.parse(scenario.to_yaml(comments=False)) == scenario
    assert path.read_text().startswith("# yaml-language-server: $schema=schema.json\n")
    json.dumps(scenario.resolved(), allow_nan=False)


def test_three_scenarios_ship():
    assert {"sunsat", "cubesat_ideal", "tc211"} <= {p.stem for p in SHIPPED}
    assert find_scenario("sunsat").read_text() == (ROOT / "scenarios/sunsat.yaml").read_text()


def test_sunsat_is_the_thesis_mission():
    s = Scenario.load(ROOT / "scenarios/sunsat.yaml")
    # 10° edge to edge over 512 pixels of 10 µm
    assert s.optics.focal_length_mm == pytest.approx(2.56 / 0.0874886635, abs=1e-4)
    assert (s.optics.aperture_mm, s.detector.exposure_s, s.tracker.magnitude_limit) == (120, 0.5, 6.5)
    assert s.study.trials >= 500
    assert len(s.unphysical) == 1
    assert s.unphysical[0].startswith("optics.aperture_mm: 120 mm at a focal length of 29.2609 mm is f/0.244, but")


def test_tc211_takes_its_orbit_from_sunsat():
    sunsat, prototype = (Scenario.load(ROOT / f"scenarios/{n}.yaml") for n in ("sunsat", "tc211"))
    assert prototype.orbit == sunsat.orbit
    assert prototype.detector.pitch_um == (13.75, 16.0)
    assert (prototype.detector.width, prototype.detector.height) == (192, 165)
    assert prototype.unphysical == ()


def test_schema_file_is_fresh():
    from simulator.cli.scenario_commands import schema_text

    message = "renew it: boresight schema > scenarios/schema.json"
    assert (ROOT / "scenarios/schema.json").read_text(encoding="utf-8") == schema_text(), message


def test_schema_tells_every_key_and_its_unit():
    schema = json_schema()
    for key in all_keys():
        node = schema
        for part in key.path.split("."):
            node = node["properties"][part]
        assert node["title"]
        assert node["description"], f"{key.path} has no description"
    focal = schema["properties"]["optics"]["properties"]["focal_length_mm"]
    assert focal["title"] == "Focal length (mm)"
    assert focal["exclusiveMinimum"] == 0
    assert schema["then"]["required"] == ["name", "epoch", "optics", "detector"]
    assert schema["then"]["properties"]["optics"] == {"required": ["focal_length_mm", "aperture_mm"]}


def test_every_default_fits_its_own_limits():
    for key in all_keys():
        if key.section is None and not isinstance(key.default, type(all_keys)) and "MISSING" not in repr(key.default):
            assert check_value(key, key.default) == (key.default, ""), key.path


def test_yaml_1_2_scalars():
    s = Scenario.parse(GOOD + "description: yes\nseed: 0x10\norbit: {altitude_km: 8.0e2, raan_deg: 012}\n")
    assert (s.description, s.seed, s.orbit.altitude_km, s.orbit.raan_deg) == ("yes", 16, 800.0, 12.0)


@pytest.mark.parametrize(
    ("written", "hour"),
    [("2026-03-21T12:00:00Z", 12), ("'2026-03-21T12:00:00'", 12), ("2026-03-21", 0), ("2026-03-21T12:00:00+02:00", 10)],
)
def test_epochs(written, hour):
    s = Scenario.parse(GOOD.replace("2026-03-21T12:00:00Z", written))
    assert s.epoch == datetime(2026, 3, 21, hour, tzinfo=UTC)


def test_anchors_and_aliases():
    s = Scenario.parse(GOOD + "tracker: {magnitude_limit: &m 5.5}\nsky: {magnitude_limit: *m}\n")
    assert s.sky.magnitude_limit == s.tracker.magnitude_limit == 5.5


def test_overrides_merge_sections_and_replace_lists():
    s = Scenario.parse(
        GOOD + "pointing: {offset_deg: [1, 2, 3], error_deg: 0.5}\norbit: {ltan_h: 6}\n",
        ["pointing.offset_deg=[0, 0, 1.5]", "orbit.ltan_h=null", "study={trials: 7}", "seed=3", "seed = 4"],
    )
    assert s.pointing.offset_deg == (0.0, 0.0, 1.5)
    assert s.pointing.error_deg == 0.5
    assert s.orbit.ltan_h is None
    assert (s.study.trials, s.seed) == (7, 4)
    assert Scenario.parse(GOOD, ["detector.adc_bits="]).detector.adc_bits is None


def test_base_in_another_folder(tmp_path, monkeypatch):
    (tmp_path / "bases").mkdir()
    (tmp_path / "bases/low.yaml").write_text(
        GOOD.replace("aperture_mm: 25", "aperture_mm: 25, transmission: glass.csv")
        + "study: {trials: 5, sampling: sky}\n"
    )
    (tmp_path / "high.yaml").write_text("base: bases/low.yaml\nname: high\nstudy: {trials: 6}\n")
    monkeypatch.chdir(tmp_path)
    s = Scenario.load("high.yaml", ["detector.quantum_efficiency=./qe.csv"])
    assert (s.name, s.study.trials, s.study.sampling) == ("high", 6, "sky")
    assert s.optics.transmission == str(tmp_path / "bases/glass.csv")
    assert s.detector.quantum_efficiency == str(tmp_path / "qe.csv")
    assert s.base_dir == Path()
    assert Scenario.load(tmp_path / "high.yaml").optics.transmission == str(tmp_path / "bases/glass.csv")


def test_every_file_that_a_scenario_names_is_found_from_elsewhere(tmp_path, monkeypatch):
    """A resolved scenario stands in another folder than its baffle's and its jitter's tables."""
    (tmp_path / "tables").mkdir()
    for name in ("pst", "psd"):
        (tmp_path / "tables" / f"{name}.csv").write_text("0,1\n90,1\n")
    (tmp_path / "s.yaml").write_text(
        GOOD.replace("aperture_mm: 25", "aperture_mm: 25, baffle: {pst: tables/pst.csv}")
        + "pointing: {jitter: {psd: table, table: tables/psd.csv}}\n"
    )
    scenario = Scenario.load(tmp_path / "s.yaml")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "resolved.yaml").write_text(scenario.to_yaml())
    again = Scenario.load(tmp_path / "out" / "resolved.yaml")
    assert again == scenario
    assert again.optics.baffle.pst == str(tmp_path / "tables/pst.csv")
    assert again.files() == {
        "optics.baffle.pst": tmp_path / "tables/pst.csv",
        "pointing.jitter.table": tmp_path / "tables/psd.csv",
    }


def test_a_file_of_a_shipped_name_goes_first(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("sunsat").write_text(GOOD)
    assert Scenario.load("sunsat").name == "demo"
    assert Scenario.load("cubesat_ideal").name == "cubesat_ideal"
    assert os.path.isabs(find_scenario("cubesat_ideal"))


def test_frozen():
    s = Scenario.parse(GOOD)
    with pytest.raises(ValidationError, match="frozen"):
        s.seed = 3
    with pytest.raises(ValidationError, match="frozen"):
        s.optics.aperture_mm = 3
    with pytest.raises(AttributeError):
        s.tracker.detection.max_stars = 3


def test_equality_hash_pickle_and_fingerprint():
    a, b = Scenario.parse(GOOD), Scenario.parse(GOOD, name="elsewhere")
    c = a.with_values(seed=9, trials=3)
    assert a == b
    assert hash(a) == hash(b)
    assert a.fingerprint() == b.fingerprint()
    assert (c.seed, c.study.trials) == (9, 3)
    assert c != a
    assert c.fingerprint() != a.fingerprint()
    assert pickle.loads(pickle.dumps(c)) == c
    with pytest.raises(ScenarioError, match="trials: must be a whole number of at least 1, not 0"):
        a.with_values(trials=0)


def test_noiseless_leaves_the_optics_alone():
    s = Scenario.load(ROOT / "scenarios/cubesat_ideal.yaml")
    quiet = s.noiseless()
    assert quiet.optics == s.optics
    assert quiet.path == s.path
    changed = {k for k, v in flatten(quiet).items() if v != flatten(s)[k]}
    assert "detector.read_noise_e" in changed
    assert "sky.background" in changed
    assert all(k.startswith("detector.") or k == "sky.background" for k in changed)


def test_made_directly_it_is_checked_too():
    parts = Scenario.parse(GOOD).model_dump()
    assert Scenario(**parts) == Scenario.parse(GOOD)
    with pytest.raises(ValueError, match="no lens in air is faster"):
        Scenario(**(parts | {"optics": parts["optics"] | {"aperture_mm": 120.0}}))
    with pytest.raises(ValueError, match=r"window_px is 1; it must be a number from 3 to 101"):
        Scenario(**(parts | {"tracker": {"centroid": {"window_px": 1}}}))


@pytest.mark.parametrize(
    "text",
    ["", "null", "yes", "1", "1.5", "a: b", "# x", 'q"\\', "é\n\t\x01\U0001f600\u2028", " x", "2026-01-01", "~", "-"],
)
def test_any_text_survives_yaml(text):
    s = Scenario.parse(GOOD.replace("name:", f"description: {yaml_value(text)}\nname:")) if "\x01" not in text else None
    if s is None:
        with pytest.raises(ScenarioError, match="control character"):
            Scenario.parse(GOOD + f"description: {yaml_value(text)}\n")
    else:
        assert s.description == text
        assert Scenario.parse(s.to_yaml()) == s
