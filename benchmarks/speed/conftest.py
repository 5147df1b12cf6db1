"""Options of the speed benchmarks."""

import pytest


@pytest.fixture
def timed(benchmark):
    """Times a function on new arguments for each round: `timed(function, make, rounds)`; the last result."""

    def run(function, make, rounds, warm=2):
        count = iter(range(rounds + warm + 1))
        return benchmark.pedantic(function, setup=lambda: ((make(next(count)),), {}), rounds=rounds, warmup_rounds=warm)

    return run
