"""Findings in words are made when they are read, once."""

import pickle
from functools import partial

import pytest

from startracker.trace import Step, Steps

FIRST, SECOND = Step("image", "one"), Step("detection", "two")


def test_words_are_made_when_they_are_first_read():
    calls = []

    def tell(step):
        calls.append(step)
        return step

    steps = Steps(partial(tell, FIRST), (SECOND,), lambda: (FIRST, SECOND))
    whole = Steps(steps, SECOND)
    assert not calls
    assert list(whole) == [FIRST, SECOND, FIRST, SECOND, SECOND]
    assert len(whole) == 5
    assert steps[1] == SECOND
    assert whole[-2:] == (SECOND, SECOND)
    assert calls == [FIRST]


def test_steps_are_equal_to_a_tuple_of_them_and_can_be_sent():
    steps = Steps(lambda: FIRST, SECOND)
    assert pickle.loads(pickle.dumps(steps)) == (FIRST, SECOND)
    assert steps == Steps((FIRST, SECOND))
    assert steps != Steps(FIRST)
    assert steps != 3
    assert hash(steps) == hash((FIRST, SECOND))
    assert repr(steps) == "<2 steps: image, detection>"
    with pytest.raises(IndexError):
        Steps()[0]


def test_plain_words_may_stand_in_place_of_steps():
    assert Steps("one", ("two", "three"), lambda: "four", lambda: ("five",)) == ("one", "two", "three", "four", "five")
