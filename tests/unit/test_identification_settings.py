"""Settings of the identifiers: a class each, what they share, old keywords, and scenario keys that nothing reads."""

import copy
import dataclasses
import pickle

import numpy as np
import pytest

from simulator.checks import load_scenario
from simulator.cli import _run
from simulator.scenario import Scenario
from simulator.scenario.fields import keys_of
from startracker import Attitude, Camera, IdentificationSettings, StarTracker, settings
from startracker.errors import InputError, InputWarning
from startracker.identification import METHODS
from startracker.settings import (
    AdaptiveSettings,
    MatchGroupSettings,
    PatternHashSettings,
    PyramidSettings,
    TriadSettings,
)
from startracker.settings.identification import SETTINGS, AnyIdentificationSettings, settings_of, unread_keys

CAMERA = Camera.from_fov(10.0, 512, 512)


def names(kind):
    return {field.name for field in dataclasses.fields(kind)}


def test_every_identifier_has_its_class():
    assert SETTINGS.keys() == METHODS.keys()


def test_a_scenario_has_the_keys_of_all_classes_and_their_defaults():
    assert set.union(*(names(kind) for kind in SETTINGS.values())) == names(AnyIdentificationSettings)
    for kind in SETTINGS.values():
        for field in dataclasses.fields(kind):
            if field.name != "max_stars":  # each method's own, where a scenario says none
                assert field.default == getattr(AnyIdentificationSettings(), field.name)
        assert kind.of(AnyIdentificationSettings()) == kind()


@pytest.mark.parametrize("kind", [*dict.fromkeys(SETTINGS.values()), AnyIdentificationSettings])
def test_every_setting_is_described(kind):
    assert all(key.description for key in keys_of(kind).values())


def test_what_is_shared_leaves_the_methods_own_at_their_defaults():
    chosen = PyramidSettings.of(IdentificationSettings(false_alarm_rate=0.01, min_stars=5))
    assert chosen == PyramidSettings(false_alarm_rate=0.01, min_stars=5)
    assert chosen.max_stars == 30
    own = TriadSettings(vote_number=3)
    assert TriadSettings.of(own) is own


def test_settings_of_another_identifier_are_refused():
    with pytest.raises(InputError, match="TriadSettings are the settings of another identifier; give PyramidSettings"):
        StarTracker(CAMERA, identifier="pyramid", identification=TriadSettings())


def test_an_identifier_of_another_package_takes_any():
    assert settings_of("theirs", None) == AnyIdentificationSettings()
    own = PatternHashSettings()
    assert settings_of("theirs", own) is own
    assert unread_keys("theirs") == []


def test_keywords_of_single_methods_are_taken_with_a_warning():
    with pytest.warns(FutureWarning, match="max_stars, vote_number now belong to the identifier's own settings"):
        old = IdentificationSettings(max_stars=20, vote_number=4, false_alarm_rate=0.01)
    assert isinstance(old, IdentificationSettings)
    assert (old.max_stars, old.vote_number, old.false_alarm_rate) == (20, 4, 0.01)
    assert TriadSettings.of(old) == TriadSettings(max_stars=20, vote_number=4, false_alarm_rate=0.01)
    assert MatchGroupSettings.of(old) == MatchGroupSettings(max_stars=20, false_alarm_rate=0.01)
    assert AdaptiveSettings.of(old) == AdaptiveSettings(false_alarm_rate=0.01)


@pytest.mark.parametrize("kind", [IdentificationSettings, TriadSettings, AnyIdentificationSettings])
def test_settings_are_copied_and_sent_to_other_processes(kind):
    one = kind(min_stars=4)
    assert pickle.loads(pickle.dumps(one)) == copy.copy(one) == dataclasses.replace(kind(), min_stars=4) == one
    assert type(pickle.loads(pickle.dumps(one))) is kind


@pytest.mark.parametrize("kind", [PyramidSettings, TriadSettings])
def test_max_stars_is_kept_to(kind):
    """Of four stars with two false ones among them no method finds the attitude; of all stars it does."""
    with pytest.raises(InputError, match="max_stars is 1; it must be a number at least 2"):
        kind(max_stars=1)
    name = next(name for name, one in SETTINGS.items() if one is kind)
    tracker = StarTracker(CAMERA, magnitude_limit=6.0, identifier=name)
    index, _vectors, xy = tracker.guide.in_field(Attitude.from_radec_roll(80.0, 0.0, 30.0).as_matrix())
    order = np.argsort(tracker.guide.v_mag[index])
    xy, flux = xy[order], 10.0 ** (-0.4 * tracker.guide.v_mag[index][order])
    xy = np.concatenate([[[20.0, 500.0], [499.0, 30.0]], xy])
    flux = np.concatenate([[2.0 * flux[0], 1.9 * flux[0]], flux])
    assert tracker.solve_centroids(xy, flux).solved
    few = StarTracker(CAMERA, magnitude_limit=6.0, identifier=name, identification=kind(max_stars=4))
    assert not few.solve_centroids(xy, flux).solved


# ---------------------------------------------------------------------- scenarios
def test_keys_that_nothing_reads_are_told_with_their_line(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("base: cubesat_ideal\ntracker:\n  identification:\n    vote_number: 3\n    min_stars: 4\n")
    with pytest.warns(InputWarning) as told:
        load_scenario(file)
    assert [str(one.message) for one in told] == [
        f"{file}:4:5: tracker.identification.vote_number: not used by the identifier 'adaptive'"
    ]


def test_an_option_that_nothing_reads_is_one_line_of_the_command(capsys):
    assert _run(["show", "cubesat_ideal", "--set", "tracker.identification.max_stars=9"]) == 0
    told = capsys.readouterr().err
    assert told == "warning: --set tracker.identification.max_stars: not used by the identifier 'adaptive'\n"


def test_what_is_shown_is_loaded_without_a_warning():
    scenario = Scenario.load("oedipus")
    assert Scenario.parse(scenario.to_yaml()) == scenario
    plain = Scenario.load("cubesat_ideal")
    assert Scenario.parse(plain.to_yaml()) == plain


def test_a_scenario_gives_its_tracker_the_identifiers_settings():
    from simulator.build import build_camera
    from simulator.study.star_tracker import build_tracker

    scenario = load_scenario("sunsat")
    found = build_tracker(scenario, build_camera(scenario)).identification
    assert found == MatchGroupSettings(separation_tolerance_deg=0.2)


def test_every_class_is_public():
    assert {kind.__name__ for kind in SETTINGS.values()} <= set(settings.__all__)
