"""Settings of all tests."""

import gc
import time

import pytest
import slow_tests
from hypothesis import settings
from undrawn import undrawn

from simulator.constants import GARBAGE_THRESHOLDS
from simulator.study.pages import drawing

# The same examples every time, so that a green run stays green; make test-all looks for new ones. Without a time limit
# of each: a loaded machine would exceed any.
settings.register_profile("repeat", derandomize=True, max_examples=60, deadline=None)
settings.register_profile("explore", max_examples=400, deadline=None)
settings.load_profile("repeat")


def pytest_addoption(parser):
    group = parser.getgroup("slow tests")
    group.addoption("--slow-slice", metavar="K/N", help="run slice K of N of the slow tests, even in duration")
    group.addoption("--slow-minutes", type=float, help="skip the slow tests that have not begun after this time")
    group.addoption("--record-slow", action="store_true", help="write durations of slow tests and the commit")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config, items):
    """Keep one slice of the slow tests."""
    wanted = config.getoption("--slow-slice")
    if wanted is None:
        return
    try:
        number, count = slow_tests.parse_slice(wanted)
    except ValueError as error:
        raise pytest.UsageError(str(error)) from None
    slow = [item.nodeid for item in items if item.get_closest_marker("slow")]
    chosen = slow_tests.slice_of(slow, slow_tests.read_records(), number, count)
    others = [item for item in items if item.nodeid in set(slow) - chosen]
    config.hook.pytest_deselected(items=others)
    items[:] = [item for item in items if item.nodeid not in set(slow) - chosen]


def pytest_configure(config):
    if config.getoption("--record-slow") and not hasattr(config, "workerinput"):  # once, not by each worker
        config.pluginmanager.register(slow_tests.Recorder(), "slow recorder")


@pytest.fixture(autouse=True, scope="session")
def began_s():
    """When the tests of this process began."""
    return time.monotonic()


@pytest.fixture(autouse=True)
def within_the_time_for_slow_tests(request, began_s):
    """With durations that are not yet known, a slice could take hours; what it leaves out stays due."""
    minutes = request.config.getoption("--slow-minutes")
    if minutes is not None and request.node.get_closest_marker("slow") and time.monotonic() - began_s > 60.0 * minutes:
        pytest.skip(f"the {minutes:g} minutes for slow tests are over")


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Collect the tests without searching them for garbage again and again, which would be a third of the time, and
    leave them out of later searches."""
    gc.disable()
    result = yield
    gc.freeze()
    gc.set_threshold(*GARBAGE_THRESHOLDS)
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


@pytest.fixture
def no_drawing():
    """For tests that look at no picture: figures are not drawn."""
    with undrawn():
        yield
