"""Maps of defective pixels, from frames of different pointings."""

import inspect

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from startracker import Camera
from startracker.detection.background import estimate
from startracker.detection.defect_map import BadPixelCount, DefectMap, find_bad_pixels
from startracker.geometry.attitude import Attitude


# ---------------------------------------------------------------------- defects
def test_deviations_are_counted_by_direction():
    """A pixel must deviate in one direction in three quarters of the frames that test it, twice at least."""
    count = BadPixelCount(5.0, 0.75, 32)
    rng = np.random.default_rng(12)
    ignore = np.zeros((64, 64), bool)
    ignore[30, 30] = True
    for k in range(4):
        frame = rng.normal(100.0, 1.0, (64, 64))
        frame[5, 5] = 200.0  # always
        frame[6, 6] = 200.0 if k < 3 else 100.0
        frame[7, 7] = 200.0 if k < 2 else 100.0
        frame[8, 8] = 200.0 if k % 2 else 0.0  # either way
        frame[9, 9] = 0.0 if k else 100.0
        frame[10, 10] = np.nan if k else 100.0
        frame[30, 30] = 200.0
        count.add(frame, ignore if k != 3 else None)
    assert count.frames == 4
    assert np.argwhere(count.bad()).tolist() == [[5, 5], [6, 6], [9, 9], [10, 10]]
    assert np.argwhere(count.bad(1)).tolist() == [[5, 5], [6, 6], [9, 9], [10, 10]]  # once is not twice
    assert not count.bad(5).any()


def test_a_tile_is_tested_where_its_stars_have_moved():
    """The least motion of nine points of a tile since it was last counted, those that left the field left out."""
    camera = Camera.from_fov(4.0, 160, 128)
    found = DefectMap(camera, frames=2, share=0.75, sigma=5.0, shift_px=6.0)
    first = Attitude.from_radec_roll(30.0, 20.0, 10.0).as_matrix()
    found._seen[:] = first
    for vector in ([0.0, 3e-3, 0.0], [1e-3, -2e-3, 0.0], [0.0, 0.0, 0.2], [0.03, 0.0, 0.0], [2.0, 0.0, 0.0]):
        now = Rotation.from_rotvec(vector).as_matrix() @ first
        motion = found._motion_px(now)
        for j in (0, 5, 15):
            for i in (0, 9, 15):
                x, y = np.meshgrid(
                    -0.5 + 160.0 * (i + np.array([0.0, 0.5, 1.0])) / 16,
                    -0.5 + 128.0 * (j + np.array([0.0, 0.5, 1.0])) / 16,
                )
                points = np.column_stack([x.ravel(), y.ravel()])
                moved = camera.project(camera.unproject(points) @ first @ now.T) - points
                shift = np.hypot(*moved.T)
                expected = np.min(shift[np.isfinite(shift)], initial=np.inf)
                assert motion[j, i] == pytest.approx(expected, rel=1e-6)


def test_pixels_that_are_not_tested():
    """Within 3 px of a known star, those that the caller names, and those of tiles whose stars stayed."""
    camera = Camera.from_fov(4.0, 160, 128)
    pixel = camera.pixel_rad
    found = DefectMap(camera, frames=3, share=0.75, sigma=5.0, shift_px=6.0, tile_px=32)
    hot = [(40, 50), (47, 50), (100, 20), (5, 5)]
    rng, ignore = np.random.default_rng(13), np.zeros((128, 160), bool)
    ignore[20, 100] = True
    for k in range(4):
        image = rng.normal(100.0, 1.0, (128, 160))
        for x, y in hot:
            image[y, x] = 300.0
        attitude = Attitude.from_matrix(Rotation.from_rotvec([0.0, 8.0 * pixel * k, 0.0]).as_matrix())
        found.add(image, attitude, np.array([[43.4, 47.4]]), ignore)
        assert found._count.frames == k + 1
        assert found.mask.any() == (k >= 2)
    # three to the right, and three below the star at (43, 47): (40, 50) is not tested, (47, 50) is
    assert sorted(map(tuple, found.xy.tolist())) == [(5, 5), (47, 50)]
    before = found._count.frames
    found.add(image, attitude, np.empty((0, 2)))  # the stars have not moved
    assert found._count.frames == before
    nothing = DefectMap(camera, frames=0, share=0.75, sigma=5.0, shift_px=6.0)
    nothing.add(image, attitude, np.empty((0, 2)))
    assert nothing._count.frames == 0


def test_tiles_of_the_background_are_as_large_as_elsewhere():
    sizes = {
        inspect.signature(one).parameters["tile_px"].default for one in (DefectMap, BadPixelCount, find_bad_pixels)
    }
    assert sizes == {inspect.signature(estimate).parameters["tile_px"].default} == {64}
