"""Settings of all tests."""

import gc
import os

import pytest
from hypothesis import settings
from undrawn import undrawn

from simulator.study.report import drawing

# The same examples every time, so that a green run stays green; make test-all looks for new ones. Without a time limit
# of each: a loaded machine would exceed any.
settings.register_profile("repeat", derandomize=True, max_examples=60, deadline=None)
settings.register_profile("explore", max_examples=400, deadline=None)
settings.load_profile("repeat")


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Collect the tests without searching them for garbage again and again, which would be a third of the time, and
    leave them out of later searches."""
    gc.disable()
    result = yield
    gc.freeze()
    gc.set_threshold(10_000, 20, 20)
    gc.enable()
    return result


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
