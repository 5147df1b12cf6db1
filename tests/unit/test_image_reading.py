"""Image files of all kinds, sound and broken."""

import struct
import zlib

import numpy as np
import pytest
from astropy.io import fits
from PIL import Image

from startracker import InputError, read_image
from startracker.images.bayer import bayer_to_grey

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


def test_jpeg_with_an_orientation_is_turned_and_says_so(tmp_path):
    exif = Image.Exif()
    exif[274] = 6
    path = save(tmp_path / "a.jpg", COLOUR, exif=exif)
    loaded = read_image(path)
    assert loaded.image.shape == (11, 7)
    assert any("orientation 6 applied" in note for note in loaded.notes)


def test_fits_of_several_kinds(tmp_path):
    """The bottom row comes first in the file (FITS Standard 4.0), the top row in the array."""

    def written(name, data, **cards):
        unit = fits.PrimaryHDU(data)
        unit.header.update(cards)
        unit.writeto(tmp_path / name)
        return read_image(tmp_path / name)

    plain = written("a.fits", GREY16, SATURATE=4000.0, EXPTIME=0.5)
    np.testing.assert_array_equal(plain.image, GREY16[::-1])
    assert plain.saturation_dn == 4000.0
    assert plain.header["EXPTIME"] == 0.5
    assert written("b.fits", GREY16).saturation_dn == 65535.0
    real = GREY16.astype(float)
    real[2, 3], real[0, 0] = np.nan, np.inf
    loaded = written("c.fits", real)
    assert np.isnan(loaded.image[-3, 3])
    assert np.isnan(loaded.image[-1, 0])
    assert loaded.image[-6, 5] == real[5, 5]
    colour = written("d.fits", np.moveaxis(COLOUR, 2, 0)).image
    np.testing.assert_allclose(colour, COLOUR.mean(axis=2)[::-1], rtol=1e-6)
    np.testing.assert_array_equal(written("e.fits", GREY8[None]).image, GREY8[::-1])
    units = fits.HDUList([fits.PrimaryHDU(), fits.ImageHDU(GREY8)])
    units.writeto(tmp_path / "f.fits")
    np.testing.assert_array_equal(read_image(tmp_path / "f.fits").image, GREY8[::-1])


@pytest.mark.parametrize(
    ("cards", "order"),
    [
        ({}, "BOTTOM-UP"),
        ({"ROWORDER": "BOTTOM-UP"}, "BOTTOM-UP"),
        ({"ROWORDER": "bottom-up "}, "BOTTOM-UP"),
        ({"ROWORDER": "TOP-DOWN"}, "TOP-DOWN"),
        ({"ROWORDER": "top-down"}, "TOP-DOWN"),
        ({"ROWORDER": "unknown"}, "BOTTOM-UP"),
        ({"CAM_FX": 1000.0}, "TOP-DOWN"),
        ({"CAM_FX": 1000.0, "ROWORDER": "BOTTOM-UP"}, "BOTTOM-UP"),
    ],
)
@pytest.mark.parametrize("upright", [True, False])
def test_rows_of_fits_files(cards, order, upright, tmp_path):
    """By ROWORDER; without it from the bottom up, but for frames of boresight, which have the top row first. A camera
    file counts the rows of a photograph from the top in every format."""
    unit = fits.PrimaryHDU(GREY16 if order == "TOP-DOWN" else GREY16[::-1])
    unit.header.update(cards)
    unit.writeto(tmp_path / "a.fits")
    loaded = read_image(tmp_path / "a.fits", upright=upright)
    np.testing.assert_array_equal(loaded.image, GREY16)
    assert loaded.image.flags.c_contiguous
    assert loaded.row_order == order
    assert any("first row at the bottom" in note for note in loaded.notes) == (order == "BOTTOM-UP")


def test_a_mosaic_in_fits_has_the_pattern_of_its_first_rows(tmp_path):
    """Of an odd number of rows the pattern of the reversed rows would be another one."""
    mosaic = np.random.default_rng(5).normal(500.0, 5.0, (31, 40)).astype(np.float32)
    mosaic[0::2, 0::2] *= 2.0
    fits.PrimaryHDU(mosaic).writeto(tmp_path / "m.fits")
    fits.PrimaryHDU(mosaic, fits.Header({"ROWORDER": "TOP-DOWN"})).writeto(tmp_path / "t.fits")
    stored = read_image(tmp_path / "t.fits", bayer="RGGB").image
    np.testing.assert_array_equal(read_image(tmp_path / "m.fits", bayer="RGGB").image, stored[::-1])


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
        ("a\0b.png", "is not a file name"),
    ],
)
def test_faulty_files_are_one_clear_line(tmp_path, name, says):
    faulty_files(tmp_path)
    with pytest.raises(InputError, match=says) as caught:
        read_image(tmp_path / name)
    text = str(caught.value)
    assert "\n" not in text
    assert name.replace("\0", "\\x00") in text


def mosaic(pattern, shape=(40, 60), noise=0.0):
    """A grey sky of 1000 DN behind filters that let 0.5 (red), 1 (green), 0.4 (blue) through, and a uniform field."""
    rng = np.random.default_rng(3)
    share = {"R": 0.5, "G": 1.0, "B": 0.4}
    image = np.empty(shape)
    for k, colour in enumerate(pattern):
        row, column = divmod(k, 2)
        site = image[row::2, column::2]
        site[...] = share[colour] * (1000 + rng.normal(0, noise, site.shape))
    return image


@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_a_balanced_mosaic_is_even(pattern):
    raw = mosaic(pattern, (400, 600), noise=20.0)
    grey = bayer_to_grey(raw, pattern)
    assert grey.shape == raw.shape
    sites = [grey[row::2, column::2] for row in (0, 1) for column in (0, 1)]
    # 60,000 pixels a site: median to 20 · 1.25 / 245 = 0.1 DN, spread to 0.3 %; the greens are two such samples
    assert np.ptp([np.median(site) for site in sites]) < 0.6
    assert np.ptp([site.std() for site in sites]) < 0.4
    assert np.median(grey) == pytest.approx(1000.0, abs=0.5)
    np.testing.assert_array_equal(bayer_to_grey(raw, pattern, balance=False), raw.astype(np.float32))


def test_a_raw_mosaic_file_is_read_and_nonsense_refused(tmp_path):
    raw = mosaic("RGGB", noise=20.0).astype(np.uint16)
    raw[10, 10] = 65535
    path = save(tmp_path / "raw.tiff", raw)
    loaded = read_image(path, bayer="rggb")
    np.testing.assert_array_equal(loaded.image, bayer_to_grey(raw, "RGGB"))
    assert loaded.saturation_dn == loaded.image[10, 10]
    assert any("RGGB" in note for note in loaded.notes)
    with pytest.raises(InputError, match="must be one of RGGB"):
        read_image(path, bayer="RGB")
    with pytest.raises(InputError, match="not a raw mosaic"):
        read_image(save(tmp_path / "colour.png", COLOUR), bayer="RGGB")
    with pytest.raises(InputError, match="2-D array"):
        bayer_to_grey(np.zeros((4, 4, 3)))


def png_chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


@pytest.mark.parametrize("channels", [3, 4])
def test_colour_png_of_16_bits_keeps_them(tmp_path, channels):
    # written by the book (PNG specification, third edition, section 9): every row with another of the five filters
    deep = RNG.integers(0, 65536, (10, 13, channels)).astype(">u2")
    size = 2 * channels
    rows = deep.view(np.uint8).reshape(10, -1).astype(int)
    data = b""
    for y, row in enumerate(rows):
        above = rows[y - 1] if y else np.zeros_like(row)
        left, corner = (np.concatenate([np.zeros(size, int), r[:-size]]) for r in (row, above))
        guess = left + above - corner
        far = [np.abs(guess - p) for p in (left, above, corner)]
        paeth = np.where((far[0] <= far[1]) & (far[0] <= far[2]), left, np.where(far[1] <= far[2], above, corner))
        predicted = [0, left, above, (left + above) // 2, paeth][y % 5]
        data += bytes([y % 5]) + ((row - predicted) % 256).astype(np.uint8).tobytes()
    head = struct.pack(">IIBBBBB", 13, 10, 16, 2 if channels == 3 else 6, 0, 0, 0)
    path = tmp_path / "deep.png"
    body = png_chunk(b"IHDR", head) + png_chunk(b"IDAT", zlib.compress(data)) + png_chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + body)
    loaded = read_image(path)
    np.testing.assert_allclose(loaded.image, deep[..., :3].astype(float).mean(axis=2), rtol=1e-6)
    assert loaded.saturation_dn == 65535.0


def lzw(data):
    """TIFF 6.0, section 13, the encoder as printed there."""
    codes, table, word = [256], {bytes([k]): k for k in range(256)}, b""
    widths, width, following = [9], 9, 258
    for byte in data:
        longer = word + bytes([byte])
        if longer in table:
            word = longer
            continue
        codes.append(table[word])
        widths.append(width)
        table[longer] = following
        following += 1
        width = 9 if following < 512 else 10 if following < 1024 else 11 if following < 2048 else 12
        if following == 4095:
            codes.append(256)
            widths.append(12)
            table, following, width = {bytes([k]): k for k in range(256)}, 258, 9
        word = bytes([byte])
    codes += [table[word], 257]
    # the end may come with the width of the next code
    widths += [width, 9 if following < 511 else 10 if following < 1023 else 11 if following < 2047 else 12]
    bits = "".join(f"{code:0{width}b}" for code, width in zip(codes, widths, strict=True))
    bits += "0" * (-len(bits) % 8)
    return bytes(int(bits[k : k + 8], 2) for k in range(0, len(bits), 8))


def deep_tiff(pixels, order="<", compression=1, orientation=1):
    """A colour TIFF of 16 bits a channel, by the book (TIFF 6.0, section 2)."""
    height, width, _ = pixels.shape
    data = {1: bytes, 8: zlib.compress, 5: lzw}[compression](pixels.astype(order + "u2").tobytes())
    tags = [(256, 4, 1, width), (257, 4, 1, height), (258, 3, 3, 8), (259, 4, 1, compression), (262, 4, 1, 2)]
    tags += [(273, 4, 1, 14), (274, 4, 1, orientation), (277, 4, 1, 3), (278, 4, 1, height), (279, 4, 1, len(data))]
    tags += [(284, 4, 1, 1)]
    return (
        (b"II" if order == "<" else b"MM")
        + struct.pack(order + "HI", 42, 14 + len(data) + len(data) % 2)
        + struct.pack(order + "HHH", 16, 16, 16)
        + data
        + b"\0" * (len(data) % 2)
        + struct.pack(order + "H", len(tags))
        # a single short stands in the first half of the value
        + b"".join(
            struct.pack(order + "HHIHH", tag, 3, 1, value, 0)
            if tag == 274
            else struct.pack(order + "HHII", tag, kind, count, value)
            for tag, kind, count, value in tags
        )
        + b"\0" * 4
    )


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("compression", [1, 8, 5])
def test_colour_tiff_of_16_bits_keeps_them(tmp_path, order, compression):
    deep = 300 * RNG.integers(0, 9, (50, 41, 3)) + 7
    path = tmp_path / "deep.tiff"
    path.write_bytes(deep_tiff(deep, order, compression))
    loaded = read_image(path)
    np.testing.assert_allclose(loaded.image, deep.astype(float).mean(axis=2), rtol=1e-6)
    assert loaded.saturation_dn == 65535.0


@pytest.mark.parametrize(
    ("orientation", "turn"), [(2, np.fliplr), (6, lambda a: np.rot90(a, -1)), (7, lambda a: np.rot90(a, 2).T)]
)
def test_colour_tiff_of_16_bits_is_turned_and_turned_back(tmp_path, orientation, turn):
    deep = RNG.integers(0, 65536, (50, 41, 3))
    path = tmp_path / "deep.tiff"
    path.write_bytes(deep_tiff(deep, orientation=orientation))
    stored = deep.astype(float).mean(axis=2)
    np.testing.assert_allclose(read_image(path).image, turn(stored), rtol=1e-6)
    np.testing.assert_allclose(read_image(path, upright=False).image, stored, rtol=1e-6)


def test_a_truncated_colour_tiff_of_16_bits_is_one_clear_line(tmp_path):
    path = tmp_path / "deep.tiff"
    whole = deep_tiff(RNG.integers(0, 65536, (50, 41, 3)), compression=8)
    path.write_bytes(whole[:9000] + whole[-200:])
    with pytest.raises(InputError, match=r"deep\.tiff: .*(damaged or truncated|not an image)"):
        read_image(path)


@pytest.mark.parametrize(
    ("name", "start", "says"),
    [
        ("a.heic", b"\0\0\0\x18ftypheic\0\0\0\0mif1heic", "HEIC images are not supported; .*heif-convert a.heic a.png"),
        ("a.jpg", b"\0\0\0\x18ftypmif1\0\0\0\0mif1heic", "HEIC images are not supported"),
        ("IMG 1.CR2", b"II*\0\x10\0\0\0CR\x02\0", "raw images .* dcraw -T -4 -h 'IMG 1.CR2'"),
        ("a.nef", b"MM\0*\0\0\0\x08", "raw images"),
        ("a.cr3", b"\0\0\0\x18ftypcrx \0\0\0\x01", "raw images"),
        ("b", b"FUJIFILMCCD-RAW 0201", "raw images"),
    ],
)
def test_photographs_to_be_converted_first_say_how(tmp_path, name, start, says):
    (tmp_path / name).write_bytes(start + bytes(200))
    with pytest.raises(InputError, match=says) as caught:
        read_image(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_colours_are_kept_where_asked_for(tmp_path):
    path = save(tmp_path / "a.png", COLOUR)
    np.testing.assert_array_equal(read_image(path, colours=True).colours, COLOUR)
    assert read_image(path).colours is None
    assert read_image(save(tmp_path / "b.png", GREY8), colours=True).colours is None
    exif = Image.Exif()
    exif[274] = 6
    turned = read_image(save(tmp_path / "c.jpg", COLOUR, exif=exif), colours=True)
    np.testing.assert_allclose(turned.colours.mean(axis=2), turned.image, rtol=1e-6)
