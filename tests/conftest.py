"""Settings of all tests."""

from hypothesis import settings

# The same examples every time, so that a green run stays green; make test-all looks for new ones.
settings.register_profile("repeat", derandomize=True)
settings.register_profile("explore", max_examples=400)
settings.load_profile("repeat")
