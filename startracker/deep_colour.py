"""Colour pictures of 16 bits a channel, of which Pillow keeps eight: PNG and TIFF."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["read_deep"]

_PNG_COLOURS = {2: 3, 6: 4}
_TIFF_DEFLATE = (8, 32946)
_TIFF_LZW = 5


def read_deep(picture: Any, file: Path) -> NDArray[np.uint16] | None:
    """Red, green and blue (H, W, 3) of an opened picture at their full 16 bits; None where the file has no such.

    Not read so: interlaced PNG, TIFF in tiles or in separate planes, for which Pillow's eight bits remain.
    """
    if picture.format == "PNG":
        return _read_png(file.read_bytes(), *picture.size)
    if picture.format == "TIFF":
        tags = picture.tag_v2  # the size of the picture may be that of the upright one
        return _read_tiff(tags, file.read_bytes(), int(tags[256]), int(tags[257]))
    return None


def _read_png(data: bytes, width: int, height: int) -> NDArray[np.uint16] | None:
    """By the PNG specification (third edition, sections 5, 9 and 10)."""
    depth, colour, interlaced = data[24], data[25], data[28]
    if depth != 16 or colour not in _PNG_COLOURS or interlaced:
        return None
    channels = _PNG_COLOURS[colour]
    place, packed = 8, []
    while place + 8 <= len(data):
        length = int.from_bytes(data[place : place + 4], "big")
        if data[place + 4 : place + 8] == b"IDAT":
            packed.append(data[place + 8 : place + 8 + length])
        place += 12 + length
    raw = np.frombuffer(zlib.decompress(b"".join(packed)), np.uint8).reshape(height, 1 + 2 * channels * width)
    rows = np.ascontiguousarray(raw[:, 1:])
    _unfilter(rows, np.ascontiguousarray(raw[:, 0]), 2 * channels)
    return rows.view(">u2").reshape(height, width, channels)[..., :3].astype(np.uint16)


@njit(cache=True)
def _unfilter(rows: NDArray[np.uint8], kinds: NDArray[np.uint8], size: int) -> None:
    """Undo the filter of each row in place; `size` bytes make a pixel."""
    for y in range(len(rows)):
        for x in range(rows.shape[1]):
            left = int(rows[y, x - size]) if x >= size else 0
            above = int(rows[y - 1, x]) if y > 0 else 0
            corner = int(rows[y - 1, x - size]) if x >= size and y > 0 else 0
            kind = kinds[y]
            predicted = 0
            if kind == 1:
                predicted = left
            elif kind == 2:
                predicted = above
            elif kind == 3:
                predicted = (left + above) // 2
            elif kind == 4:
                a, b, c = abs(above - corner), abs(left - corner), abs(left + above - 2 * corner)
                predicted = left if a <= b and a <= c else (above if b <= c else corner)
            rows[y, x] = (int(rows[y, x]) + predicted) % 256


@njit(cache=True)
def _unpack_lzw(data: NDArray[np.uint8], size: int) -> NDArray[np.uint8]:
    """At most `size` bytes of a strip (TIFF 6.0, section 13): codes of 9 to 12 bits, the highest bit first.

    A string of the table is kept as where it stands in what has been put out already, and its length.
    """
    out = np.empty(size, np.uint8)
    start, length = np.zeros(4096, np.int64), np.zeros(4096, np.int64)
    following, bits, place, count, previous = 258, 9, 0, 0, -1
    while place + bits <= 8 * len(data) and count < size:
        code = 0
        for k in range(place, place + bits):
            code = 2 * code + ((int(data[k // 8]) >> (7 - k % 8)) & 1)
        place += bits
        if code == 257:
            break
        if code == 256:
            following, bits, previous = 258, 9, -1
            continue
        first = count
        if code < 256:
            out[count] = code
            count += 1
        else:
            # the string not yet in the table is the one before and its own first byte, which stand side by side
            source, total = start[code], length[code]
            for k in range(min(total, size - count)):
                out[count + k] = out[source + k]
            count += min(total, size - count)
        if previous >= 0 and following < 4096:
            following += 1
        # the string that the next code completes: this one and one byte more
        if following < 4096:
            start[following], length[following] = first, count - first + 1
        previous = code
        if following >= 511 and bits < 10:
            bits = 10
        if following >= 1023 and bits < 11:
            bits = 11
        if following >= 2047 and bits < 12:
            bits = 12
    return out[:count]


def _read_tiff(tags: Any, data: bytes, width: int, height: int) -> NDArray[np.uint16] | None:
    """By the TIFF specification, revision 6.0, strips of chunky RGB."""
    channels = int(tags.get(277, 1))
    compression, predictor = int(tags.get(259, 1)), int(tags.get(317, 1))
    bits, kind = tuple(tags.get(258, ())), tuple(tags.get(339, (1,)))
    plain = int(tags.get(284, 1)) == 1 and 273 in tags and 279 in tags and int(tags.get(262, 0)) == 2
    if channels < 3 or bits[:3] != (16, 16, 16) or kind[0] != 1 or not plain or predictor not in (1, 2):
        return None
    if compression not in (1, _TIFF_LZW, *_TIFF_DEFLATE):
        return None
    strips = [data[at : at + count] for at, count in zip(tags[273], tags[279], strict=True)]
    if compression in _TIFF_DEFLATE:
        strips = [zlib.decompress(strip) for strip in strips]
    elif compression == _TIFF_LZW:
        size = 2 * channels * width * int(tags.get(278, height))
        strips = [_unpack_lzw(np.frombuffer(strip, np.uint8), size).tobytes() for strip in strips]
    order = ">u2" if data[:2] == b"MM" else "<u2"
    values = np.frombuffer(b"".join(strips), order, count=height * width * channels)
    pixels = values.reshape(height, width, channels).astype(np.uint16)
    if predictor == 2:
        pixels = np.cumsum(pixels, axis=1, dtype=np.uint16)
    return pixels[..., :3]
