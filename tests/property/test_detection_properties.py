"""Detection and centroiding never fail on what an image may hold, and do not depend on where a star lies."""

import numpy as np
import pytest
from all_detectors import GENERAL
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from startracker.centroid import first_moment
from startracker.detection import estimate
from startracker.settings import CentroidSettings, DetectionSettings

SHAPES = hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=40)
IMAGES = st.one_of(
    hnp.arrays(np.uint8, SHAPES),
    hnp.arrays(np.uint16, SHAPES),
    hnp.arrays(np.int32, SHAPES),
    hnp.arrays(np.float32, SHAPES, elements=st.floats(width=32)),
    hnp.arrays(np.float64, SHAPES, elements=st.floats(-1e6, 1e6) | st.just(np.nan)),
)


def check(image, method, saturation):
    shape = np.shape(image)
    background = estimate(image, 16)
    assert background.level.shape == background.noise.shape == shape
    assert not (background.noise <= 0).any()
    spots = GENERAL[method](image, background, DetectionSettings(min_pixels=1, max_stars=20), saturation)
    assert len(spots) <= 20
    assert np.all((spots.x_peak >= 0) & (spots.x_peak < shape[1]))
    assert np.all((spots.y_peak >= 0) & (spots.y_peak < shape[0]))
    assert np.all(np.diff(spots.flux) <= 0)
    found = first_moment(image, background, spots, CentroidSettings(), None)
    assert len(found) <= len(spots)
    assert np.isfinite(found.xy).all()
    assert np.isfinite(found.covariance).all()
    assert np.all(np.diff(found.flux) <= 0)
    assert np.all(found.covariance[:, 0, 0] > 0)


@pytest.mark.parametrize("method", GENERAL)
@settings(max_examples=60, deadline=None)
@example(image=np.array([[0.0, np.inf]], np.float32), saturation=None)
@example(image=np.array([[-np.inf, np.inf]], np.float32), saturation=None)
@given(image=IMAGES, saturation=st.none() | st.floats(-10, 70000))
def test_any_image(method, image, saturation):
    check(image, method, saturation)


@pytest.mark.parametrize("method", GENERAL)
@pytest.mark.parametrize("shape", [(0, 0), (0, 7), (1, 1), (16, 16), (3, 200)])
@pytest.mark.parametrize("value", [0, 1, 255, 65535, np.nan, np.inf])
def test_constant_images(method, shape, value):
    check(np.full(shape, value), method, 255.0)
    check(np.full(shape, value), method, None)


@pytest.mark.parametrize("method", GENERAL)
@settings(max_examples=40, deadline=None)
@given(
    x=st.floats(8, 31),
    y=st.floats(8, 31),
    sigma=st.floats(0.6, 1.6),
    level=st.sampled_from([0.0, 100.0, -30.0]),
    flips=st.tuples(st.booleans(), st.booleans(), st.booleans()),
)
def test_a_turned_image_gives_turned_stars(method, x, y, sigma, level, flips):
    row, column = np.mgrid[:40, :40]
    image = 1e4 * np.exp(-0.5 * ((column - x) ** 2 + (row - y) ** 2) / sigma**2) + level
    point = [x, y]
    if flips[0]:
        image, point = image[:, ::-1], [39 - point[0], point[1]]
    if flips[1]:
        image, point = image[::-1], [point[0], 39 - point[1]]
    if flips[2]:
        image, point = image.T, point[::-1]
    background = estimate(image, 64)
    spots = GENERAL[method](image, background, DetectionSettings(search_step_px=1), None)
    found = first_moment(image, background, spots, CentroidSettings(), 1.0)
    assert len(found) == 1
    # sampled at the centres instead of integrated: as a Gaussian of σ² − 1/12 integrated would be, to 0.01 px
    assert np.abs(found.xy[0] - point).max() < 0.01
