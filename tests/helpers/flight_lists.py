"""Lists of stars for the tests of the flight build's identification."""

import numpy as np

from benchmarks.flight_lists import FIELDS, field_list
from simulator.randomness import stream
from startracker.flight.directions import plane_of, vectors_of
from startracker.flight.evidence import sight


def apparent_to(tracker, stars):
    """Stars of a list as the search of a `FlightTracker` takes them."""
    plane, inside = plane_of(np.column_stack([stars.x, stars.y]), tracker.grid)
    return sight(stars, vectors_of(plane, tracker.grid), inside, tracker.search_tables)


def random_fields(star_tracker, name, kind, count, seed=1):
    """Fields of a kind, from the random numbers of a name."""
    rng = stream(seed, f"flight {name} {kind}")
    return [field_list(star_tracker, FIELDS[kind], rng) for _ in range(count)]
