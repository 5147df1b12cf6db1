"""What commands check of their numbers, and the words they say it in."""

import io
from contextlib import redirect_stderr

import pytest

from simulator.cli.checks import at_least, processes
from simulator.cli.terminal import open_console, progress_bar
from startracker.errors import InputError


@pytest.mark.parametrize(
    ("least", "given", "text"),
    [
        (1, {"trials": 0}, "--trials: must be at least 1, not 0"),
        (0, {"seed": -3}, "--seed: must be 0 or more, not -3"),
        (1, {"trials": 5, "lhs": -1}, "--lhs: must be at least 1, not -1"),
    ],
)
def test_the_first_number_too_small_is_named(least, given, text):
    with pytest.raises(InputError, match=f"^{text}$"):
        at_least(least, **given)


def test_what_was_not_given_is_not_checked():
    at_least(1, trials=None, lhs=1)


def test_processes_are_those_asked_for_or_as_many_as_are_worth_starting():
    assert processes(7, None, 1) == 7
    assert processes(None, None, 99) == 1
    assert 1 <= processes(None, None, 10**6)
    with pytest.raises(InputError, match="--workers: must be at least 1"):
        processes(0, None, 1)
    with pytest.raises(InputError, match="give one of the two"):
        processes(2, "tcp://somewhere", 1)


def test_without_a_terminal_there_is_no_bar_and_tables_have_a_width():
    errors = io.StringIO()
    with redirect_stderr(errors), progress_bar("name", "trials", 3) as tell:
        tell(1, 3)
        tell(3, 3)
    assert errors.getvalue() == ""
    assert open_console(77).width == 77
