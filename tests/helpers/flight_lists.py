"""Lists of stars for the tests of the flight build's identification."""

from benchmarks.flight_lists import FIELDS, field_list
from simulator.randomness import stream


def random_fields(star_tracker, name, kind, count, seed=1):
    """Fields of a kind, from the random numbers of a name."""
    rng = stream(seed, f"flight {name} {kind}")
    return [field_list(star_tracker, FIELDS[kind], rng) for _ in range(count)]
