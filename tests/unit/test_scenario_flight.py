"""`tracker.engine: flight`: what the flight build does not have is refused at its key, in one line."""

import pytest

from simulator.checks import load_scenario
from simulator.scenario.errors import ScenarioError
from simulator.scenario.flight_rules import LARGEST
from simulator.study.budget.effects import EFFECTS
from startracker import Camera, StarTracker
from startracker.errors import InputError, InputWarning
from startracker.flight.front_tables import HALF, LARGEST_SIDE
from startracker.flight.search_tables import MOST_STARS

REFUSED = {
    "tracker.detector=clustering": "has no 'clustering'; use components",
    "tracker.centroider=moment": "has no 'moment'; use maximum_likelihood",
    "tracker.identifier=pyramid": "has no 'pyramid'; use adaptive",
    "tracker.estimator=quest": "has no 'quest'; use field_fit",
    "tracker.detection.min_pixels=4": "has no effect on the flight build; use 3",
    "tracker.detection.matched_filter=false": "has no effect on the flight build; use true",
    "tracker.detection.isolation=2": "has no effect",
    "tracker.centroid.bias_correction=false": "has no effect",
    "tracker.centroid.psf_sigma_px=0.8": "has no effect",
    "tracker.identification.max_centroids=20": "has no effect on the flight build; use 250",
    "tracker.identification.separation_tolerance_deg=0.1": "has no effect on the flight build; use null",
    "tracker.in_flight_calibration.use=true": "is not part of the flight build",
    "sequence.operation.use=true": "is not part of the flight build",
    "detector.shutter=rolling": "has no rolling shutter; use global",
    "detector.adc_bits=null": "reads whole numbers; use 1 to 16 bits",
    "detector.width=4097": "takes up to 4096; use fewer",
    "tracker.detection.max_stars=121": "takes up to 120; use fewer",
    "tracker.centroid.window_px=13": "takes up to 11; use fewer",
    "tracker.identification.min_stars=2": "needs 3 stars; use 3",
    "optics.focal_length_mm=2.8": "sees 45.2° from its axis along rows or columns, the flight build less than 45°",
}
"""Values, and what is said of each."""
ALLOWED = [
    "tracker.identifier=triads",
    "tracker.identification.min_stars=4",
    "tracker.identification.false_alarm_rate=1e-9",
    "tracker.detection.psf_sigma_px=1.0",
    "tracker.flight.arithmetic=float",
    "optics.focal_length_mm=2.83",
]
UNPHYSICAL = "allow_unphysical=true"  # of the short lenses, whose f-number is not of interest here


@pytest.mark.parametrize("value", REFUSED)
def test_what_the_flight_build_lacks_is_refused_at_its_key(value):
    with pytest.raises(ScenarioError) as caught:
        load_scenario("cubesat_ideal", ["tracker.engine=flight", UNPHYSICAL, value])
    said = str(caught.value).splitlines()
    assert len(said) == 1
    assert said[0].startswith(f"--set {value.partition('=')[0]}:")
    assert REFUSED[value] in said[0]
    assert said[0].endswith(", or tracker.engine: reference")


@pytest.mark.parametrize("value", [*REFUSED, *ALLOWED])
def test_the_reference_takes_all_of_it(value):
    assert load_scenario("cubesat_ideal", [UNPHYSICAL, value]).tracker.engine == "reference"


@pytest.mark.parametrize("value", ALLOWED)
def test_what_it_has_is_allowed(value):
    assert load_scenario("cubesat_ideal", ["tracker.engine=flight", UNPHYSICAL, value]).tracker.engine == "flight"


def test_the_limits_are_those_of_the_flight_build():
    assert LARGEST["detector.width"] == LARGEST["detector.height"] == LARGEST_SIDE
    assert LARGEST["tracker.detection.max_stars"] == MOST_STARS
    assert LARGEST["tracker.centroid.window_px"] == 2 * HALF + 1


def test_a_scenario_is_checked_when_its_values_change():
    scenario = load_scenario("cubesat_ideal", ["tracker.engine=flight"])
    with pytest.raises(ScenarioError, match=r"tracker.estimator: the flight build has no 'svd'"):
        scenario.changed({"tracker.estimator": "svd"})


def test_heads_may_have_different_engines():
    head = "{name: a, mounting: orbit_normal, tracker: {engine: flight}}"
    scenario = load_scenario("cubesat_ideal", [f"heads=[{head}, {{name: b, mounting: zenith}}]"])
    assert scenario.heads[0].tracker == {"engine": "flight"}
    refused = "{name: a, mounting: orbit_normal, tracker: {engine: flight, estimator: svd}}"
    with pytest.raises(ScenarioError, match=r"heads\[0\].tracker.estimator: the flight build has no 'svd'"):
        load_scenario("cubesat_ideal", [f"heads=[{refused}, {{name: b, mounting: zenith}}]"])


def test_every_effect_of_the_budget_can_be_switched_off():
    scenario = load_scenario("cubesat", ["tracker.engine=flight"])
    changes = {effect.name: effect.off(scenario) for effect in EFFECTS}
    assert changes["shot noise"]
    assert not changes["quantisation"]  # the flight build reads whole numbers
    for values in changes.values():
        assert scenario.changed(values).tracker.engine == "flight"


def test_triads_in_integers_are_the_flight_build():
    with pytest.warns(InputWarning, match="tracker.identifier: 'triads_integer' is the flight build now"):
        scenario = load_scenario("cubesat_ideal", ["tracker.identifier=triads_integer"])
    assert (scenario.tracker.engine, scenario.tracker.identifier) == ("flight", "triads")
    head = "{name: a, mounting: orbit_normal, tracker: {identifier: triads_integer}}"
    with pytest.raises(ScenarioError, match=r"heads\[0\].tracker.identifier: .* set tracker.engine: flight and"):
        load_scenario("cubesat_ideal", [f"heads=[{head}, {{name: b, mounting: zenith}}]"])


def test_a_star_tracker_of_triads_in_integers_says_what_to_do():
    with pytest.raises(InputError, match=r"not one of the identifiers any more: .* tracker.engine: flight"):
        StarTracker(Camera.from_fov(12.0, 512, 512), identifier="triads_integer")
