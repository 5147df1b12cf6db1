"""Clumps, grids, lines and arcs of points are no sky: the lists of `benchmarks/adversarial.py`, a few of each kind."""

import pytest

from benchmarks.adversarial import KINDS, drawn, run_chunk, tracker
from simulator.randomness import stream
from startracker.identification import METHODS

RATE = 1e-7


@pytest.mark.parametrize("kind", KINDS)
def test_no_list_is_accepted(kind):
    found = run_chunk("adaptive", kind, "10deg", 11, RATE, 0, 5)
    assert not found["accepted"]
    assert 0 < found["worst"][0] <= tracker("10deg", "adaptive", RATE).identification.max_operations


@pytest.mark.parametrize("method", sorted(set(METHODS) - {"adaptive", "triads"}))
@pytest.mark.parametrize("kind", ["clump", "cluster size"])
def test_no_clump_is_accepted_by_any_method(kind, method):
    assert not run_chunk(method, kind, "10deg", 11, RATE, 0, 5)["accepted"]


def test_a_clump_that_was_once_taken_for_the_pleiades():
    """33 points within 5 % of the image: seven fit the cluster, by chance with 1e-8 were points spread evenly."""
    rng = stream(1, "adversarial clump 15deg", 95)
    xy, flux = drawn(rng, "clump", "15deg", int(rng.integers(5, 61)))
    assert len(xy) == 33
    found = tracker("15deg", "adaptive", RATE).solve_centroids(xy, flux)
    assert found.status == "no_match"


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_no_list_of_many_is_accepted(kind):
    assert not run_chunk("adaptive", kind, "15deg", 12, RATE, 0, 300)["accepted"]
