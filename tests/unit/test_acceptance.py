"""The rule of acceptance: chance, limit and the margin beyond which a search ends."""

import math
from dataclasses import replace

import numpy as np
import pytest

from startracker.estimation.association import merge_pairs
from startracker.identification.acceptance import (
    SURE_BEYOND,
    WITHIN_PRIOR_BEYOND,
    accepts,
    log_chance,
    passes_confirmation_threshold,
    power_of_ten,
)
from startracker.identification.observed import Identification
from startracker.settings import IdentificationSettings
from startracker.solution import Status

SETTINGS = IdentificationSettings()
LIMIT = math.log(SETTINGS.false_alarm_rate)


@pytest.mark.parametrize("beyond", [SURE_BEYOND, WITHIN_PRIOR_BEYOND])
def test_an_accepted_answer_ends_the_search_only_with_a_margin(beyond):
    """A chance just below the limit is accepted, and other attitudes are still searched for; only below e^−15 times the
    limit (e^−5 within a prior) none can compete."""
    found = Identification(Status.SOLVED, "", log_false_alarm=LIMIT - 0.1)
    assert accepts(found.log_false_alarm, SETTINGS)
    assert not passes_confirmation_threshold(found, SETTINGS, beyond)
    assert not passes_confirmation_threshold(replace(found, log_false_alarm=LIMIT - beyond + 0.1), SETTINGS, beyond)
    assert passes_confirmation_threshold(replace(found, log_false_alarm=LIMIT - beyond - 0.1), SETTINGS, beyond)
    assert not passes_confirmation_threshold(
        replace(found, status=Status.AMBIGUOUS, log_false_alarm=-1e3), SETTINGS, beyond
    )


def test_the_chance_is_the_rivals_share_of_the_evidence():
    """p (1 + Σ Bₖ)/B, in logarithms; a prior multiplies all B."""
    assert log_chance(30.0, log_density=-4.0) == pytest.approx(-34.0)
    assert log_chance(30.0, log_density=-4.0, log_gain=5.0) == pytest.approx(-39.0)
    rivals = [27.0, 25.0]
    expected = math.log((1.0 + sum(math.exp(rival) for rival in rivals)) / math.exp(30.0)) - 4.0
    assert log_chance(30.0, rivals, log_density=-4.0) == pytest.approx(expected, rel=1e-12)
    gained = math.log((1.0 + sum(math.exp(rival + 5.0) for rival in rivals)) / math.exp(35.0)) - 4.0
    assert log_chance(30.0, rivals, log_density=-4.0, log_gain=5.0) == pytest.approx(gained, rel=1e-12)
    assert not accepts(math.nan, SETTINGS)
    assert power_of_ten(-2000.0) == "1e-869"
    assert power_of_ten(0.0) == "1"


def test_pairs_that_are_not_used_are_not_flagged():
    """Of three used pairs and three identified ones, one of which shares a star, the other two are not used."""
    used = np.array([[4, 10], [0, 11], [2, 12]])
    identified = np.array([[1, 20], [2, 21], [5, 22]])
    pairs, flags = merge_pairs(used, identified)
    assert pairs.tolist() == [[0, 11], [1, 20], [2, 12], [4, 10], [5, 22]]
    assert flags.tolist() == [True, False, True, True, False]
