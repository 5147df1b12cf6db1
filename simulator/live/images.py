"""Frames as bytes in the formats of the protocol."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulator.fits import fits_bytes
from simulator.frame import Frame
from startracker.images.picture import stretch

__all__ = ["Encoded", "encode", "raw16"]


class Encoded(NamedTuple):
    """A frame in one format."""

    data: bytes
    bits: int
    """Bits of a pixel."""


def encode(frame: Frame, form: str) -> Encoded:
    """A frame as ``png``, ``raw16``, ``fits`` or ``none`` (no bytes)."""
    if form == "raw16":
        return Encoded(raw16(frame.image), 16)
    if form == "png":
        return Encoded(_png(frame.image), 8)
    if form == "fits":
        return Encoded(fits_bytes(frame), 16 if frame.image.dtype == np.uint16 else -64)
    return Encoded(b"", 0)


def raw16(image: NDArray[Any]) -> bytes:
    """Digital numbers, little-endian 16 bits, row by row; those of a camera without a converter are rounded."""
    if image.dtype != np.uint16:
        image = np.rint(np.clip(image, 0.0, 65535.0))
    return np.ascontiguousarray(image, dtype="<u2").tobytes()


def _png(image: NDArray[Any]) -> bytes:
    """Grey picture of 8 bits, stretched for display, in little time."""
    import cv2

    grey = np.rint(255.0 * stretch(image)).astype(np.uint8)
    done, data = cv2.imencode(".png", grey, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    assert done
    return bytes(data)
