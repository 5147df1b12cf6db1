"""Read images: FITS, PNG, TIFF, JPEG and other formats that Pillow reads; every error is one line."""

from __future__ import annotations

import io
import math
import re
import shlex
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from startracker.arguments import file_path, switch, text
from startracker.display import described, html_card
from startracker.errors import InputError
from startracker.files import IMAGE_BYTES, read_bytes
from startracker.images.bayer import bayer_to_grey
from startracker.images.picture import photograph

_FITS_SUFFIXES = (".fits", ".fit", ".fts", ".fits.gz", ".fit.gz", ".fits.fz")
_MOST_PIXELS = 400_000_000
_ORIENTATION_TAG = 274
_TURNS: dict[int, Callable[[NDArray[Any]], NDArray[Any]]] = {
    2: np.fliplr,
    3: lambda a: np.rot90(a, 2),
    4: np.flipud,
    5: lambda a: np.swapaxes(a, 0, 1),
    6: lambda a: np.rot90(a, -1),
    7: lambda a: np.rot90(np.swapaxes(a, 0, 1), 2),
    8: np.rot90,
}
"""Operation that makes a stored picture upright, by EXIF orientation (Exif 2.32, tag 274); 1 is already upright."""
_UNDOES = {6: 8, 8: 6}
"""Orientation whose operation is the inverse of another; the others are their own inverse."""
_HEIC_BRANDS = (b"heic", b"heix", b"hevc", b"heim", b"heis", b"mif1", b"msf1")
"""Major brands of HEIF files with HEVC images (ISO/IEC 23008-12, annex B)."""
_RAW_SUFFIXES = re.compile(r"\.(3fr|arw|cr2|cr3|crw|dng|iiq|nef|nrw|orf|pef|raf|raw|rw2|sr2|srf|srw)", re.IGNORECASE)
_RAW_STARTS = (b"FUJIFILMCCD-RAW", b"IIRO", b"IIRS", b"MMOR", b"IIU\0", b"FOVb")
"""First bytes of raw files of Fujifilm, Olympus, Panasonic, Phase One and Sigma; others are known by their name."""
_HINT = "give a PNG, TIFF, JPEG or FITS image"
_REVERSED = "FITS has its first row at the bottom: rows are counted from the top of the picture, its last row"


RowOrder = Literal["TOP-DOWN", "BOTTOM-UP"]
"""Whether the first row of a file is the top or the bottom of the picture; values of the FITS keyword ROWORDER."""


@dataclass(frozen=True, eq=False)
class LoadedImage:
    """An image as it is passed to the tracker.

    Parameters
    ----------
    image : float32 array, shape (H, W)
        DN, the top row first; colour channels averaged; NaN for blank pixels of a FITS file.
    saturation_dn : float, optional
        Largest value of the file's integer type; None if it sets no limit.
    header : dict
        Metadata of the file (FITS keywords; Pillow's format and mode).
    notes : tuple of str
        Notes for the user: channels averaged, EXIF orientation applied or not.
    colours : float32 array, shape (H, W, 3), optional
        Red, green and blue of a colour picture, for display; only if requested.
    row_order : {"TOP-DOWN", "BOTTOM-UP"}
        Order of the rows in the file; those of `image` are always from the top down.
    """

    image: NDArray[np.float32]
    saturation_dn: float | None = None
    header: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    colours: NDArray[np.float32] | None = None
    row_order: RowOrder = "TOP-DOWN"

    def __repr__(self) -> str:
        height, width = self.image.shape
        full = "" if self.saturation_dn is None else f"saturation {self.saturation_dn:g} DN"
        return described("LoadedImage", f"{width}×{height} px", full, *self.notes)

    def _repr_html_(self) -> str:
        """The image with its size, for notebooks."""
        height, width = self.image.shape
        full = "" if self.saturation_dn is None else f"{self.saturation_dn:g} DN"
        rows = {"size": f"{width}×{height} px", "saturation": full, "notes": "; ".join(self.notes)}
        return html_card("Image", rows, photograph(self.image, "image"))


def read_image(
    path: str | Path, *, bayer: str | None = None, upright: bool = True, colours: bool = False
) -> LoadedImage:
    """Read an image file.

    Colour channels are averaged (without transparency), palettes are resolved; 16 bits per channel stay 16 bits.

    For every format the first row of the array is the top of the picture. FITS files have the bottom row first (FITS
    Standard 4.0, section 3.3.2 and figure 1) unless their keyword ROWORDER is ``TOP-DOWN``; their rows are reversed.
    Frames of `simulator` have the top row first, and state it.

    Parameters
    ----------
    path : str or Path
        FITS, PNG, TIFF, JPEG or another format that Pillow reads.
    bayer : str, optional
        The file holds a raw Bayer mosaic of this pattern (RGGB, BGGR, GRBG, GBRG), which is converted to grey
        (`startracker.images.bayer.bayer_to_grey`); of a FITS file the pattern of its first two rows.
    upright : bool
        Apply the EXIF orientation, as viewers do; pixel coordinates are those of the upright picture. False keeps the
        rows and columns of the sensor, to which a calibrated camera or a bad-pixel map refers; a raw mosaic always
        keeps them, as its pattern depends on them.
    colours : bool
        Keep the colour channels as well, in `LoadedImage.colours`.

    Raises
    ------
    InputError
        If the file is missing, unreadable, damaged, truncated, empty, or not an image.
    """
    file = file_path("path", path)
    switch("upright", upright)
    switch("colours", colours)
    bayer = None if bayer is None else text("bayer", bayer)
    data = _bytes_of(file)
    if not data:
        raise InputError(f"{file}: is empty (0 bytes); {_HINT}")
    _refuse_unreadable(file, data)
    is_fits = data.startswith(b"SIMPLE  =") or file.name.lower().endswith(_FITS_SUFFIXES)
    loaded = _read_fits(file) if is_fits else _read_picture(file, data, upright and bayer is None)
    if not colours:
        loaded = replace(loaded, colours=None)
    if bayer is not None:
        if any("averaged" in note for note in loaded.notes):
            raise InputError(f"{file}: has colour channels, so it is not a raw mosaic; omit bayer")
        # The pattern refers to the rows as stored, so the mosaic is converted before its rows are reversed.
        grey = bayer_to_grey(loaded.image, bayer)
        notes = (*loaded.notes, f"Bayer mosaic {bayer.upper()} balanced to the green pixels")
        # The gains differ by colour, so the lowest level at which any pixel saturates is used.
        full = None
        if loaded.saturation_dn is not None:
            top = bayer_to_grey(
                np.where(loaded.image < loaded.saturation_dn, np.nan, loaded.image), bayer, balance=False
            )
            full = float(np.nanmin(np.where(np.isfinite(top), grey, np.inf)))
        full = full if full is not None and np.isfinite(full) else None
        loaded = LoadedImage(grey, full, loaded.header, notes, row_order=loaded.row_order)
    if loaded.row_order == "BOTTOM-UP":
        loaded = replace(loaded, image=np.ascontiguousarray(loaded.image[::-1]), notes=(*loaded.notes, _REVERSED))
    if not np.isfinite(loaded.image).any():
        raise InputError(f"{file}: no pixel is a finite number; {_HINT} of the sky")
    return loaded


def _bytes_of(file: Path) -> bytes:
    if "\0" not in str(file) and file.is_dir():
        raise InputError(f"{file}: is a folder; give the image files inside it")
    return read_bytes(file, IMAGE_BYTES, _HINT)


def _refuse_unreadable(file: Path, data: bytes) -> None:
    """Raise `InputError` for photographs of formats that need a converter, saying how to convert them."""
    if data[4:8] == b"ftyp" and data[8:12] in _HEIC_BRANDS:
        raise InputError(
            f"{file}: HEIC images are not supported; convert it first, for example: "
            f"heif-convert {shlex.quote(file.name)} {shlex.quote(file.stem)}.png"
        )
    if _RAW_SUFFIXES.fullmatch(file.suffix) or data.startswith(_RAW_STARTS) or data[4:12] == b"ftypcrx ":
        raise InputError(
            f"{file}: raw images of a camera are not supported; convert it first, for example: "
            f"dcraw -T -4 -h {shlex.quote(file.name)}, which writes a 16-bit TIFF"
        )


def sample_photo() -> Path:
    """File of a photograph that ships with the package: Orion, 42.5° across, JPEG in colour.

    It was rendered with `simulator` (``tests/oracle/build_sample_photograph.py``) and may be used freely. Its boresight
    is RA 83°, Dec +1°, roll 12°.
    """
    return Path(str(files("startracker"))) / "sample_photo.jpg"


def _read_picture(file: Path, data: bytes, upright: bool) -> LoadedImage:
    import warnings

    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # size is checked here; damaged metadata does not matter
            # Read from memory, because Pillow maps an uncompressed TIFF file with rows and columns of the upright
            # picture.
            with Image.open(io.BytesIO(data)) as picture:
                # The header is checked before the pixels are decoded, so that a huge picture needs no memory.
                width, height = picture.size
                if width * height > _MOST_PIXELS:
                    raise InputError(f"{file}: {width}×{height} pixels are too many; crop or bin it")
                orientation = picture.getexif().get(_ORIENTATION_TAG) or 1
                deep = _has_deep_colour(picture, data)
                picture.load()
                header = {"format": picture.format, "mode": picture.mode}
                array, notes = _channels(picture)
                if deep:
                    array = _deep_colour(data, array)
                turned = picture.format == "TIFF"  # Pillow and OpenCV apply the orientation of these
    except InputError:
        raise
    except UnidentifiedImageError as error:
        raise InputError(f"{file}: is not an image that can be read; {_HINT}") from error
    except Image.DecompressionBombError as error:
        raise InputError(f"{file}: has too many pixels; crop or bin it") from error
    except Exception as error:
        text = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{file}: is damaged or truncated ({text}); use an intact copy") from error
    if orientation in _TURNS:
        if upright and not turned:
            array = _TURNS[orientation](array)
        elif turned and not upright:
            array = _TURNS[_UNDOES.get(orientation, orientation)](array)
        done, whose = ("applied", "the upright picture") if upright else ("not applied", "the stored pixels")
        notes = (*notes, f"EXIF orientation {orientation} {done}: coordinates are those of {whose}")
    return _finish(array, header, notes, file)


def _channels(picture: Any) -> tuple[NDArray[Any], tuple[str, ...]]:
    """Values (H, W) or (H, W, C) without transparency, and notes."""
    mode = picture.mode
    if mode in ("P", "PA") or mode in ("CMYK", "YCbCr", "LAB", "HSV", "RGBX", "RGBa"):
        picture = picture.convert("RGB")
    elif mode in ("La", "1"):
        picture = picture.convert("L")
    array = np.asarray(picture)
    if picture.mode in ("RGBA", "LA"):
        array = array[..., :-1]
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[..., 0]
    notes = (f"{array.shape[2]} colour channels averaged",) if array.ndim == 3 else ()
    return array, notes


def _has_deep_colour(picture: Any, data: bytes) -> bool:
    """Whether a PNG or TIFF picture has 16 bits per colour channel, of which Pillow keeps eight."""
    if picture.mode not in ("RGB", "RGBA", "RGBX"):
        return False
    if picture.format == "PNG":
        return data[24] == 16  # bit depth (PNG specification, third edition, section 11.2.1)
    return picture.format == "TIFF" and 16 in picture.tag_v2.get(258, ())


def _deep_colour(data: bytes, array: NDArray[Any]) -> NDArray[Any]:
    """Red, green and blue (H, W, 3) at 16 bits, read with OpenCV; Pillow's `array` if OpenCV cannot read it."""
    import cv2

    decoded: NDArray[Any] | None = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if decoded is None or decoded.dtype != np.uint16 or decoded.shape[:2] != array.shape[:2]:
        return array
    return np.asarray(decoded[..., 2::-1])  # OpenCV has blue first


def _finish(array: NDArray[Any], header: dict[str, Any], notes: tuple[str, ...], file: Path) -> LoadedImage:
    if array.size == 0 or array.ndim not in (2, 3):
        raise InputError(f"{file}: has no pixels (shape {array.shape}); {_HINT}")
    saturation: float | None = None
    if array.dtype.kind == "u" and array.dtype.itemsize <= 2:
        saturation = float(np.iinfo(array.dtype).max)
    elif array.dtype == np.int32 and header.get("mode", "").startswith("I"):  # Pillow's name for 16 bits and more
        saturation = 65535.0 if float(array.max()) <= 65535.0 else None
    colours = array.astype(np.float32) if array.ndim == 3 and array.shape[2] == 3 else None
    if array.ndim == 3:
        array = array.mean(axis=2, dtype=np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        pixels = np.ascontiguousarray(array, dtype=np.float32)
    return LoadedImage(np.where(np.isfinite(pixels), pixels, np.float32(np.nan)), saturation, header, notes, colours)


def _read_fits(file: Path) -> LoadedImage:
    """Image of a FITS file with its rows as they are stored."""
    import warnings

    from astropy.io import fits

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # minor header violations; truncation is detected when the data are read
            with fits.open(file, memmap=False) as units:
                for unit in units:
                    if not unit.is_image or unit.header.get("NAXIS", 0) < 2:
                        continue
                    if math.prod(unit.shape) > _MOST_PIXELS:
                        raise InputError(f"{file}: has too many pixels {unit.shape}; crop or bin it")
                    if math.prod(unit.shape) == 0:
                        continue
                    array = np.asarray(unit.data)
                    bits = unit.header.get("BITPIX", 0)
                    unsigned = bits == 16 and unit.header.get("BZERO", 0) == 32768
                    header = {
                        key: value for key, value in unit.header.items() if key and key not in ("COMMENT", "HISTORY")
                    }
                    break
                else:
                    raise InputError(f"{file}: contains no two-dimensional image; {_HINT}")
    except InputError:
        raise
    except Exception as error:
        text = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{file}: is not a readable FITS file ({text}); use an intact copy") from error
    array = np.squeeze(array)
    notes: tuple[str, ...] = ()
    if array.ndim == 3 and array.shape[0] in (2, 3, 4):  # planes of colour come first in FITS
        array = array.mean(axis=0, dtype=np.float64)
        notes = ("colour planes averaged",)
    if array.ndim != 2:
        raise InputError(f"{file}: its image has the shape {array.shape}, not rows and columns; {_HINT}")
    loaded = _finish(array.astype(array.dtype.newbyteorder("=")), header, notes, file)
    saturation = 65535.0 if unsigned else (255.0 if bits == 8 else None)
    stated = header.get("SATURATE")
    if isinstance(stated, int | float) and not isinstance(stated, bool) and stated > 0:
        saturation = float(stated)
    return LoadedImage(loaded.image, saturation, header, notes, row_order=row_order_of(header))


def row_order_of(header: dict[str, Any]) -> RowOrder:
    """Order of the rows of a FITS image.

    It is ROWORDER, which cameras' programs write, or else that of the standard, from the bottom up. Frames of
    `simulator` that do not state it, which have the keyword CAM_FX, have the top row first.
    """
    stated = str(header.get("ROWORDER", "")).strip().upper()
    if stated in ("TOP-DOWN", "BOTTOM-UP"):
        return "TOP-DOWN" if stated == "TOP-DOWN" else "BOTTOM-UP"
    return "TOP-DOWN" if "CAM_FX" in header else "BOTTOM-UP"
