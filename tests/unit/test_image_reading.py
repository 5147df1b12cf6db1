"""Image files of all kinds, sound and broken."""

import numpy as np
import pytest
from astropy.io import fits
from PIL import Image

from startracker import InputError, read_image

RNG = np.random.default_rng(4)
GREY8 = RNG.integers(0, 256, (7, 11)).astype(np.uint8)
GREY16 = RNG.integers(0, 65536, (7, 11)).astype(np.uint16)
COLOUR = RNG.integers(0, 256, (7, 11, 3)).astype(np.uint8)


def save(path, array, **options):
    Image.fromarray(array).save(path, **options)
    return path


@pytest.mark.parametrize(
    ("name", "array", "top"), [("a.png", GREY8, 255.0), ("a.tiff", GREY16, 65535.0), ("b.png", GREY16, 65535.0)]
)
def test_grey_is_taken_as_it_is(tmp_path, name, array, top):
    loaded = read_image(save(tmp_path / name, array))
    assert loaded.image.dtype == np.float32
    np.testing.assert_array_equal(loaded.image, array.astype(np.float32))
    assert loaded.saturation_dn == top
    assert loaded.notes == ()


def test_colour_is_averaged_and_transparency_left_out(tmp_path):
    loaded = read_image(save(tmp_path / "a.png", COLOUR))
    np.testing.assert_allclose(loaded.image, COLOUR.mean(axis=2), rtol=1e-6)
    assert "3 colour channels averaged" in loaded.notes
    clear = np.dstack([COLOUR, np.zeros((7, 11), np.uint8)])
    np.testing.assert_allclose(read_image(save(tmp_path / "b.png", clear)).image, COLOUR.mean(axis=2), rtol=1e-6)
    grey_clear = Image.merge("LA", [Image.fromarray(GREY8), Image.fromarray(GREY8 * 0)])
    grey_clear.save(tmp_path / "c.png")
    np.testing.assert_array_equal(read_image(tmp_path / "c.png").image, GREY8)


@pytest.mark.parametrize("mode", ["P", "1", "CMYK", "F", "I"])
def test_other_modes_become_numbers(tmp_path, mode):
    path = tmp_path / "a.tiff"
    Image.fromarray(GREY8).convert(mode).save(path)
    loaded = read_image(path)
    assert loaded.image.shape == (7, 11)
    if mode in ("P", "F", "I"):
        np.testing.assert_array_equal(loaded.image, GREY8)
    assert np.isfinite(loaded.image).all()


def test_jpeg_with_an_orientation_is_not_turned_and_says_so(tmp_path):
    exif = Image.Exif()
    exif[274] = 6
    path = save(tmp_path / "a.jpg", COLOUR, exif=exif)
    loaded = read_image(path)
    assert loaded.image.shape == (7, 11)
    assert any("orientation 6" in note for note in loaded.notes)


def test_fits_of_several_kinds(tmp_path):
    def written(name, data, **cards):
        unit = fits.PrimaryHDU(data)
        unit.header.update(cards)
        unit.writeto(tmp_path / name)
        return read_image(tmp_path / name)

    plain = written("a.fits", GREY16, SATURATE=4000.0, EXPTIME=0.5)
    np.testing.assert_array_equal(plain.image, GREY16)
    assert plain.saturation_dn == 4000.0
    assert plain.header["EXPTIME"] == 0.5
    assert written("b.fits", GREY16).saturation_dn == 65535.0
    real = GREY16.astype(float)
    real[2, 3], real[0, 0] = np.nan, np.inf
    loaded = written("c.fits", real)
    assert np.isnan(loaded.image[2, 3])
    assert np.isnan(loaded.image[0, 0])
    assert loaded.image[5, 5] == real[5, 5]
    np.testing.assert_allclose(written("d.fits", np.moveaxis(COLOUR, 2, 0)).image, COLOUR.mean(axis=2), rtol=1e-6)
    np.testing.assert_array_equal(written("e.fits", GREY8[None]).image, GREY8)
    units = fits.HDUList([fits.PrimaryHDU(), fits.ImageHDU(GREY8)])
    units.writeto(tmp_path / "f.fits")
    np.testing.assert_array_equal(read_image(tmp_path / "f.fits").image, GREY8)


def faulty_files(folder):
    good = save(folder / "good.png", np.tile(COLOUR, (40, 40, 1))).read_bytes()
    fits.PrimaryHDU(np.tile(GREY16, (60, 60))).writeto(folder / "good.fits")
    sound = (folder / "good.fits").read_bytes()
    fits.PrimaryHDU(np.full((4, 4), np.nan)).writeto(folder / "blank.fits")
    fits.PrimaryHDU(np.arange(5.0)).writeto(folder / "line.fits")
    fits.PrimaryHDU().writeto(folder / "nothing.fits")
    (folder / "empty.png").write_bytes(b"")
    (folder / "text.png").write_text("these are no pixels, but a line of text\n")
    (folder / "cut.png").write_bytes(good[: len(good) // 2])
    (folder / "head.png").write_bytes(good[:20])
    (folder / "cut.fits").write_bytes(sound[: len(sound) // 2])
    (folder / "head.fits").write_bytes(sound[:1000])
    (folder / "text.fits").write_text("no header at all")
    (folder / "folder").mkdir()


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("missing.png", "cannot be read"),
        ("folder", "is a folder"),
        ("empty.png", "is empty"),
        ("text.png", "is not an image"),
        ("cut.png", "damaged or truncated"),
        ("head.png", "not an image|damaged"),
        ("cut.fits", "not a readable FITS"),
        ("head.fits", "not a readable FITS|no two-dimensional"),
        ("text.fits", "not a readable FITS|no two-dimensional"),
        ("blank.fits", "finite"),
        ("line.fits", "no two-dimensional image"),
        ("nothing.fits", "no two-dimensional image"),
        ("a\0b.png", "is no file name"),
    ],
)
def test_faulty_files_are_one_clear_line(tmp_path, name, says):
    faulty_files(tmp_path)
    with pytest.raises(InputError, match=says) as caught:
        read_image(tmp_path / name)
    text = str(caught.value)
    assert "\n" not in text
    assert name.replace("\0", "\\x00") in text
