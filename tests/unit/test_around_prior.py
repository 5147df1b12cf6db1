"""Identification within a prior attitude, and when the rest of the sky is searched as well."""

import math
from dataclasses import replace

import numpy as np
import pytest

from startracker.field_solution import identify_around
from startracker.identification.acceptance import WITHIN_PRIOR_BEYOND
from startracker.identification.observed import Identification
from startracker.settings import IdentificationSettings
from startracker.solution import Status

SETTINGS = IdentificationSettings()
LIMIT = math.log(SETTINGS.false_alarm_rate)
PRIOR = object()


def found(status, beyond=0.0, stars=(), operations=10):
    """An answer `beyond` the limit, with some (centroid, guide star) pairs."""
    pairs = np.array(stars, dtype=np.int64).reshape(-1, 2)
    return Identification(status, status.name, pairs, log_false_alarm=LIMIT - beyond, operations=operations)


def around(within, elsewhere, prior=PRIOR):
    """The answer, whether it contradicts the prior, and the priors that were searched."""
    asked = []

    def identify(observed, guide, settings, given):
        asked.append(given)
        return elsewhere if given is None else within

    answer, contradicts = identify_around(identify, None, None, SETTINGS, prior)
    return answer, contradicts, asked


def fields(answer):
    return answer.status, answer.reason, answer.pairs.tolist(), answer.log_false_alarm, answer.operations


def test_without_a_prior_the_sky_is_searched_once():
    elsewhere = found(Status.SOLVED)
    assert around(None, elsewhere, None) == (elsewhere, False, [None])


@pytest.mark.parametrize("status", [s for s in Status if s is not Status.SOLVED])
def test_what_no_other_part_of_the_sky_can_mend_is_answered(status):
    within, elsewhere = found(status), found(Status.SOLVED, 50.0, [(0, 5)], 7)
    answer, contradicts, asked = around(within, elsewhere)
    if status in (Status.NO_MATCH, Status.AMBIGUOUS, Status.SEARCH_LIMIT):
        assert asked == [PRIOR, None]
        assert (answer.status, answer.operations, contradicts) == (Status.SOLVED, 17, True)
        assert answer.pairs.tolist() == [[0, 5]]
    else:
        assert (answer, contradicts, asked) == (within, False, [PRIOR])


@pytest.mark.parametrize(
    ("beyond", "searches"), [(WITHIN_PRIOR_BEYOND - 0.1, True), (WITHIN_PRIOR_BEYOND + 0.1, False)]
)
def test_an_answer_beyond_doubt_ends_the_search(beyond, searches):
    within = found(Status.SOLVED, beyond, [(0, 5)])
    answer, contradicts, asked = around(within, found(Status.NO_MATCH, operations=7))
    assert asked == ([PRIOR, None] if searches else [PRIOR])
    assert fields(answer) == fields(replace(within, operations=17 if searches else 10))
    assert not contradicts


@pytest.mark.parametrize(("more", "better"), [(-0.1, False), (0.0, False), (0.1, True)])
def test_the_stronger_evidence_is_answered(more, better):
    within = found(Status.SOLVED, 1.0, [(0, 5), (1, 6)])
    elsewhere = found(Status.SOLVED, 1.0 + more, [(0, 8), (1, 9)])
    answer, contradicts, _ = around(within, elsewhere)
    assert answer.pairs.tolist() == (elsewhere if better else within).pairs.tolist()
    assert contradicts is better
    assert answer.operations == 20


def test_the_same_stars_found_again_do_not_contradict():
    within = found(Status.SOLVED, 1.0, [(0, 5), (1, 6)])
    elsewhere = found(Status.SOLVED, 2.0, [(0, 8), (1, 6), (2, 7)])
    answer, contradicts, _ = around(within, elsewhere)
    assert fields(answer) == fields(replace(elsewhere, operations=20))
    assert not contradicts


def test_unsolved_in_both_is_the_answer_within_the_prior():
    within = found(Status.AMBIGUOUS)
    answer, contradicts, _ = around(within, found(Status.NO_MATCH, 50.0, operations=7))
    assert fields(answer) == fields(replace(within, operations=17))
    assert not contradicts
