"""Settings of all tests."""

import os

import pytest
from hypothesis import settings
from undrawn import undrawn

from simulator.study.report import drawing

# The same examples every time, so that a green run stays green; make test-all looks for new ones.
settings.register_profile("repeat", derandomize=True, max_examples=60)
settings.register_profile("explore", max_examples=400)
settings.load_profile("repeat")


@pytest.fixture(autouse=True, scope="session")
def process_of_pages():
    """Pages are drawn by the process of the tests, as another imports matplotlib anew for three seconds; the function
    that starts one is for the tests of it."""
    with pytest.MonkeyPatch.context() as patch:
        before = drawing.in_a_process
        patch.setattr(drawing, "in_a_process", drawing.answer)
        yield before


@pytest.fixture(autouse=True, scope="session")
def one_core_each():
    """The processes of pytest-xdist share the cores: none of them starts another that compiles beside it."""
    with pytest.MonkeyPatch.context() as patch:
        if "PYTEST_XDIST_WORKER" in os.environ:
            from simulator.study.trials import warm_up

            patch.setattr(warm_up, "_cores", lambda: 1)
        yield


@pytest.fixture
def no_drawing():
    """For tests that look at no picture: figures are not drawn."""
    with undrawn():
        yield
