"""The position of a star's image: that of a symmetric image is its centre, however far the lens is out of focus."""

import pytest

from simulator.optics.psf_model import PsfModel
from simulator.optics.psf_set import build_psf_set


@pytest.mark.parametrize(
    ("defocus_um", "f_number", "pitch_um"),
    [
        (20.0, 1.4, 5.5),
        (20.0, 4.0, 3.0),
        (60.0, 1.4, 5.5),
        (60.0, 4.0, 3.0),
        (100.0, 4.0, 3.0),
        pytest.param(100.0, 1.4, 5.5, marks=pytest.mark.slow),
    ],
)
def test_a_defocused_image_is_where_the_star_is(f_number, pitch_um, defocus_um):
    """The brightest point of such an image lies on a ring: a window about it gave 0.06 px at 60 µm and f/1.4, and 0.37
    px at 100 µm. The image is symmetric to the rounding of its table."""
    model = PsfModel(model="diffraction", defocus_um=defocus_um)
    psf = build_psf_set(model, f_number, (pitch_um, pitch_um), (1024, 1024)).psf()
    assert psf.geometric_px == pytest.approx((0.0, 0.0), abs=1e-6)
