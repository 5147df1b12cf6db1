"""Components of lists by their index: in options, mappings, changes and sweeps."""

import pytest

from simulator.scenario import Scenario, ScenarioError
from simulator.scenario.grid import parse_swept_keys
from simulator.study.texts import short_name
from startracker.errors import InputError


@pytest.mark.parametrize(
    "options",
    [
        ("pointing.rate_deg_s=[1, 0.5, 0]", "pointing.rate_deg_s.0=0.25"),
        ("pointing.rate_deg_s.1=0.5", "pointing.rate_deg_s.0=0.25"),
        {"pointing.rate_deg_s.1": 0.5, "pointing.rate_deg_s.0": 0.25},
    ],
)
def test_a_component_leaves_the_others(options):
    scenario = Scenario.load("cubesat_ideal", options)
    x, y, z = scenario.pointing.rate_deg_s
    assert (x, z) == (0.25, 0.0)
    assert y == (0.0 if "[" in str(options[0] if isinstance(options, tuple) else "") else 0.5)


def test_a_change_of_components_leaves_the_others():
    scenario = Scenario.load("cubesat_ideal").changed({"pointing.rate_deg_s": [1.0, 2.0, 3.0]})
    changed = scenario.changed({"pointing.rate_deg_s.1": 5, "pointing.rate_deg_s.2": 6.0})
    assert changed.pointing.rate_deg_s == (1.0, 5.0, 6.0)
    with pytest.raises(InputError, match=r"pointing.target.0: pointing.target is None, which has no such component"):
        scenario.changed({"pointing.target.0": 3.0})


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("pointing.rate_deg_s.3=1", r"pointing.rate_deg_s has the components 0 to 2"),
        ("pointing.rate_deg_s.x=1", r"must be a list of 3 numbers, not a section"),
        ("detector.pixel_pitch_um.0=4", r"detector.pixel_pitch_um has no components; give the whole value"),
        ("detector.width.0=4", r"detector.width has no components"),
        ("sequence.rates.0=3", r"sequence.rates has no components"),
        ("pointing.rate_deg_s.0=fast", r"must be a list of 3 numbers"),
    ],
)
def test_what_is_not_a_component_is_refused(option, message):
    with pytest.raises(ScenarioError, match=message):
        Scenario.load("cubesat_ideal", [option])


def test_a_sweep_over_a_component_has_its_unit_and_numbers():
    (swept,) = parse_swept_keys(["pointing.rate_deg_s.0=0,0.5,1"])
    assert (swept.path, swept.values, swept.numeric) == ("pointing.rate_deg_s.0", (0, 0.5, 1), True)
    assert swept.key.unit == parse_swept_keys(["pointing.spin.rate_deg_s=0,1"])[0].key.unit
    (ranged,) = parse_swept_keys(["pointing.rate_deg_s.2=0:1:3"])
    assert ranged.values == (0.0, 0.5, 1.0)
    assert [short_name(path) for path in (swept.path, "seed", "optics.psf.sigma_px")] == [
        "rate_deg_s.0",
        "seed",
        "sigma_px",
    ]
    with pytest.raises(ScenarioError, match="has the components 0 to 2"):
        parse_swept_keys(["pointing.rate_deg_s.3=0,1"])
    with pytest.raises(ScenarioError, match="must be"):
        parse_swept_keys(["pointing.rate_deg_s.0=fast,slow"])
