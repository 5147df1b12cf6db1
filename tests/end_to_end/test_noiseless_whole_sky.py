"""A frame without noise, solved again, gives back the attitude that made it.

The oracle is the truth the frame was rendered from. The limit is the issue's: 1″ for the whole rotation, the roll about
the boresight included. Everything that shifts stars is on: proper motion, parallax, light deflection, aberration (the
observer is in orbit), distortion, principal point; and the sky is drawn to V = 9, so that blends are in it.
"""

import numpy as np
import pytest

from simulator import Renderer, Scenario
from simulator.study.star_tracker import build_tracker
from simulator.study.trials.trial import solve_frame
from startracker import Attitude

LIMIT_ARCSEC = 1.0


@pytest.fixture(scope="module")
def chain():
    overrides = [
        "study.sampling=sky",
        "sky.planets=false",  # without a full well the Moon is a thousand million times a star
        "epoch=2026-06-10T00:00:00Z",  # the Sun far from the places below
        "optics.distortion={k1: -0.08, k2: 0.02, p1: 0.001, p2: -0.0005}",
        "optics.principal_point_offset_px=[13.3, -21.8]",
    ]
    renderer = Renderer(Scenario.load("cubesat_ideal", overrides).noiseless())
    return renderer, build_tracker(renderer.scenario, renderer.camera)


def error_arcsec(chain, **frame):
    renderer, tracker = chain
    image, truth = renderer.frame(**frame)
    solution = solve_frame(tracker, image)
    assert solution.solved, solution.reason
    return np.degrees(truth.attitude.angle_to(solution.attitude)) * 3600


SPECIAL = [
    *((0.0, 90.0, roll) for roll in (0.0, 90.0, 217.0)),
    *((123.4, -90.0, roll) for roll in (0.0, 180.0, 301.0)),
    *((ra, 0.0, roll) for ra in (0.0, 359.9999, 0.0001) for roll in (0.0, 90.0, 180.0, 270.0)),
    (180.0, 89.9, 45.0),
    (270.0, -66.56, 359.99),
    (266.4, -28.9, 12.0),  # the galactic centre
    (192.9, 27.1, 200.0),  # the galactic pole
]


@pytest.mark.parametrize("pointing", SPECIAL)
def test_special_places(chain, pointing):
    assert error_arcsec(chain, index=0, attitude=Attitude.from_radec_roll(*pointing)) < LIMIT_ARCSEC


def test_random_attitudes(chain):
    errors = [error_arcsec(chain, index=index) for index in range(40)]
    assert max(errors) < LIMIT_ARCSEC
    assert np.median(errors) < 0.1  # a hundredth of a typical pixel would be 0.3″


@pytest.mark.slow
def test_many_random_attitudes(chain):
    assert max(error_arcsec(chain, index=index) for index in range(40, 540)) < LIMIT_ARCSEC


def test_the_sun_in_the_field_is_a_status():
    renderer = Renderer(Scenario.load("cubesat_ideal", ["study.sampling=sky", "epoch=2026-03-20T14:46:00Z"]))
    frame, truth = renderer.frame(0, attitude=Attitude.from_radec_roll(0.0, 0.0, 0.0))
    assert "sun" in truth.sources.kind
    solution = solve_frame(build_tracker(renderer.scenario, renderer.camera), frame)
    assert not solution.solved or np.degrees(truth.attitude.angle_to(solution.attitude)) < 0.01
    assert solution.reason
