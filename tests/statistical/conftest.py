"""What several tests of tracking share."""

import pytest

from startracker.geometry.camera import Camera
from startracker.tracker import StarTracker


@pytest.fixture(scope="session")
def tracker():
    return StarTracker(Camera.from_fov(10.0, 1024, 1024), magnitude_limit=6.5, identifier="adaptive")
