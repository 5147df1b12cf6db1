"""Images from users: arguments and attributes, and what is checked of the pixels."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from startracker import Observer
from startracker.errors import InputError
from startracker.inputs import (
    STATED_PRIOR_DEG,
    GivenImage,
    check_image,
    given_image,
    plain,
    prior_of,
    saturation_message,
    shape_fault,
)

HERE, THERE = Observer(2025.0), Observer(2030.0)
IMAGE = np.arange(12.0).reshape(3, 4)


# ---------------------------------------------------------------------- arguments
def test_arguments_take_precedence_over_the_attributes_of_an_image():
    shot = SimpleNamespace(image=IMAGE, observer=HERE, saturation_dn=100.0, gain_e_per_dn=2.0, exposure_s=0.5)
    assert given_image(shot) == GivenImage(IMAGE, HERE, 100.0, 2.0, 0.5)
    assert given_image(shot, THERE, None, 50.0, 3.0) == GivenImage(IMAGE, THERE, 50.0, 3.0, 0.5)
    assert given_image(SimpleNamespace(image=IMAGE)) == GivenImage(IMAGE, None, None, None, None)
    assert given_image(IMAGE, HERE, None, 50.0, 3.0) == GivenImage(IMAGE, HERE, 50.0, 3.0, None)
    table = np.zeros((3, 4), [("image", float)]).view(np.recarray)  # an array with a field of this name is an array
    assert given_image(table).image is table
    assert given_image(IMAGE, saturation_dn=math.inf).saturation_dn == math.inf
    for bad in ({"saturation_dn": "a"}, {"gain_e_per_dn": "a"}):
        with pytest.raises(InputError):
            given_image(IMAGE, **bad)


def test_a_prior_is_that_of_the_call_or_of_the_image():
    shot = SimpleNamespace(prior="own", prior_deg=0.2)
    assert prior_of(shot, None, None) == ("own", 0.2)
    assert prior_of(shot, None, 0.4) == ("own", 0.4)
    assert prior_of(shot, "given", None) == ("given", STATED_PRIOR_DEG)
    assert prior_of(shot, "given", 0.4) == ("given", 0.4)
    assert prior_of(SimpleNamespace(prior="own"), None, None) == ("own", STATED_PRIOR_DEG)
    assert prior_of(SimpleNamespace(), None, None) == (None, STATED_PRIOR_DEG)
    assert prior_of(shot, None, 0.4, lost_in_space=True) == (None, STATED_PRIOR_DEG)
    assert prior_of(IMAGE, None, 0.4) == (None, 0.4)
    with pytest.raises(InputError, match="exclude each other"):
        prior_of(IMAGE, "given", None, lost_in_space=True)


def test_masked_elements_become_nan_in_a_type_that_holds_the_others():
    for kind, wider in ((np.uint8, np.float32), (np.uint16, np.float32), (np.int32, np.float64), (float, np.float64)):
        values = np.ma.MaskedArray(np.array([1, 2, 3], kind), [False, True, False])
        found = plain(values)
        assert found.dtype == wider
        np.testing.assert_array_equal(found, [1.0, np.nan, 3.0])
    whole = np.ma.MaskedArray(np.array([1, 2], np.uint8))
    assert plain(whole).dtype == np.uint8
    assert not isinstance(plain(whole), np.ma.MaskedArray)
    assert plain(np.ma.MaskedArray(np.array(["a"]), [True])).dtype.kind == "U"
    with pytest.raises(InputError, match="not an array of numbers"):
        plain([[1], [2, 3]])


def test_shapes_of_images():
    assert shape_fault((3, 4), None) == ""
    assert shape_fault((3, 4), (3, 4)) == ""
    assert shape_fault((3,), None) == "an image must have two dimensions (rows, columns); got (3,)"
    assert shape_fault((3, 4), (4, 3)).startswith("the image is 4×3 pixels, the camera 3×4: ")


# ---------------------------------------------------------------------- images
def checked(image, saturation_dn=None):
    found, fault = check_image(image, None, saturation_dn)
    assert fault == ""
    return found


@pytest.mark.parametrize(
    ("values", "stated", "level", "full"),
    [
        (np.array([[0, 65535, 65535], [9, 8, 7]], np.uint16), None, 65535.0, 2),
        (np.array([[0, 255, 255], [9, 8, 7]], np.uint8), None, 255.0, 2),
        (np.array([[0, 200, 255], [9, 8, 7]], np.uint16), 200.0, 200.0, 2),
        (np.array([[0, 200, 255], [9, 8, 7]], np.uint16), 199.5, 199.5, 2),
        (np.array([[0, 200, 255], [9, 8, 7]], np.uint16), 200.5, 200.5, 1),
        (np.array([[0, 200, 255], [9, 8, 7]], np.uint16), 1e9, 1e9, 0),
        (np.array([[0, 200, 255], [9, 8, 7]], np.uint16), -5.0, -5.0, 6),
        (np.array([[0, 200, 255], [9, 8, 7]], np.int32), None, 255.0, 1),  # the highest of a signed type
        (np.array([[0.0, 200.0, 255.0], [9.0, 8.0, 255.0]]), None, 255.0, 2),
        (np.array([[0.0, 200.0, 255.0], [9.0, 8.0, 7.0]]), 200.0, 200.0, 2),
        (np.array([[0.0, 200.0, 255.0], [9.0, 8.0, 7.0]]), 256.0, 256.0, 0),
        (np.array([[-9.0, -8.0, 0.0], [-9.0, -8.0, 0.0]]), None, math.inf, 0),  # no light at all
    ],
)
def test_saturation_of_an_image(values, stated, level, full):
    found = checked(values, stated)
    assert (found.saturation_dn, found.saturated_share) == (level, pytest.approx(full / 6.0))
    assert (found.lowest, found.highest) == (values.min(), values.max())
    assert (found.masked, found.gaps) == (0, False)
    np.testing.assert_array_equal(found.pixels, values)


def test_pixels_that_are_not_finite_are_gaps():
    for bad in (np.nan, np.inf, -np.inf):
        found = checked(np.array([[1.0, bad], [3.0, 9.0]]))
        assert np.isnan(found.pixels[0, 1])
        assert (found.lowest, found.highest, found.saturation_dn, found.gaps) == (1.0, 9.0, 9.0, True)
        assert found.saturated_share == 0.25
    masked = checked(np.ma.MaskedArray(np.array([[1, 255], [3, 9]], np.uint8), [[False, False], [True, False]]))
    assert (masked.highest, masked.saturation_dn, masked.gaps) == (255.0, 255.0, True)  # that of its type
    assert np.isnan(masked.pixels[1, 0])


def test_values_that_light_cannot_cause_are_masked():
    """A border of −1e30 in a frame of noise 1: the range is then that of the light."""
    image = np.random.default_rng(1).normal(100.0, 1.0, (40, 40)).astype(np.float32)
    lowest, highest = image[2:].min(), image[2:].max()
    image[:2] = -1e30
    found = checked(image)
    assert (found.masked, found.gaps) == (80, True)
    assert (found.lowest, found.highest, found.saturation_dn) == (lowest, highest, highest)
    assert found.saturated_share == 1.0 / 1600.0


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (np.array([["a"]]), "an image needs real numbers; got <U1"),
        (np.array([[1j]]), "an image needs real numbers; got complex128"),
        ([[1], [2, 3]], "an image must be an array of numbers"),
        (np.zeros(4), "an image must have two dimensions"),
        (np.zeros((0, 4)), "no pixel of the image is a finite number"),
        (np.full((2, 2), np.nan), "no pixel of the image is a finite number"),
        (np.full((2, 2), np.inf), "no pixel of the image is a finite number"),
    ],
)
def test_images_that_cannot_be_used(image, words):
    found, fault = check_image(image, None, None)
    assert found is None
    assert fault.startswith(words)


def test_a_saturated_image_says_how_much():
    assert saturation_message(0.514, 255.0) == (
        "51 % of the pixels are at or above 255: saturated; shorten the exposure"
    )
