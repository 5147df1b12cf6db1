"""Pictures: pixels stretched for display, and pixels or Matplotlib figures as the bytes of a file."""

from __future__ import annotations

import base64
import html
import io
import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from startracker.display import PICTURE_PX

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = ("png", "jpg", "jpeg", "svg", "pdf")
"""Output formats of pictures, by file suffix."""
_NO_DATE: dict[str, dict[str, Any]] = {"png": {"Software": None}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}
_JPEG = {"quality": 92, "subsampling": 0}

_SAMPLES = 500_000
_BLACK_SIGMA, _SOFT_SIGMA = 2.0, 8.0
"""Black level below the sky, and signal above which brightness is compressed, in units of the noise: the sky is dark
grey."""
_LEAST_RANGE_SIGMA = 25.0
"""Least range between sky and white, in units of the noise: the noise of an image without stars is not exaggerated."""
_LEAST_SIDE_PX = 600


def figure_bytes(figure: Figure, form: str = "png", **options: Any) -> bytes:
    """Figure in one of `FORMATS`, deterministic; `options` are passed to `Figure.savefig`."""
    from matplotlib import rc_context

    if form in ("jpg", "jpeg"):
        options["pil_kwargs"] = _JPEG
    stream = io.BytesIO()
    with rc_context({"svg.hashsalt": "boresight"}):  # otherwise the identifiers in an SVG are random
        figure.savefig(stream, format=form, metadata=_NO_DATE.get(form), **options)
    return stream.getvalue()


def pixel_bytes(rgb: NDArray[np.uint8], form: str = "png") -> bytes:
    """Picture (H, W, 3) without margins in one of `FORMATS`; small pictures are enlarged by an integer factor."""
    factor = -(-_LEAST_SIDE_PX // max(rgb.shape[:2]))
    if form in ("svg", "pdf"):
        return _page_of_pixels(rgb, form)
    from PIL import Image

    stream = io.BytesIO()
    pixels = rgb[..., 0] if (rgb == rgb[..., :1]).all() else rgb  # grey in one channel: a smaller file
    enlarged = pixels.repeat(factor, axis=0).repeat(factor, axis=1) if factor > 1 else pixels
    Image.fromarray(enlarged).save(stream, "png" if form == "png" else "jpeg", **({} if form == "png" else _JPEG))
    return stream.getvalue()


def _page_of_pixels(rgb: NDArray[np.uint8], form: str) -> bytes:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    height, width = rgb.shape[:2]
    figure = Figure(figsize=(8.0, max(8.0 * height / width, 0.01)), dpi=width / 8.0)
    figure.set_layout_engine("none")  # another package of the program may have set one for all figures
    FigureCanvasAgg(figure)
    ax = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    ax.imshow(rgb, interpolation="nearest", aspect="auto")
    ax.set_axis_off()
    return figure_bytes(figure, form)


def photograph(image: NDArray[Any], alt: str) -> str:
    """Image (H, W) as HTML for notebooks: a stretched JPEG picture, averaged to twice the size at which it is
    displayed."""
    from PIL import Image

    height, width = image.shape
    step = max(1, max(height, width) // (2 * PICTURE_PX) + 1)
    whole = np.asarray(image, dtype=np.float32)
    if min(height, width) >= step:
        whole = whole[: height - height % step, : width - width % step]
        whole = whole.reshape(whole.shape[0] // step, step, whole.shape[1] // step, step).mean(axis=(1, 3))
    stream = io.BytesIO()
    Image.fromarray(rgb_pixels(stretch(whole))[..., 0]).save(stream, "jpeg", quality=65)
    code = base64.b64encode(stream.getvalue()).decode()
    style = f"display:block;width:100%;max-width:{PICTURE_PX}px;height:auto"
    return f'<img alt="{html.escape(alt)}" style="{style}" src="data:image/jpeg;base64,{code}"/>'


def stretch(image: NDArray[Any]) -> NDArray[np.float32]:
    """Brightness from 0 (black) to 1 as a camera displays the sky: dark grey sky, with faint and bright stars visible.

    It is the arcsinh of the signal in units of the noise; black is two standard deviations of the noise below the
    median.

    Parameters
    ----------
    image : array, shape (H, W) or (H, W, 3)
        Any unit; pixels that are not finite are displayed as sky. Colours keep their ratios (Lupton et al. 2004, PASP
        116, 133); each channel has its own black level, so that the sky is grey.

    Returns
    -------
    float32 array of the same shape
    """
    values = np.asarray(image, dtype=np.float32)
    if values.ndim == 3:
        return _stretched_colours(values)
    levels = _levels(values)
    if levels is None:
        return np.zeros(values.shape, np.float32)
    sky, top, noise = levels
    black = sky - _BLACK_SIGMA * noise
    signal = np.nan_to_num(values, nan=sky, posinf=top, neginf=black) - black
    np.clip(signal, 0.0, top - black, out=signal)
    soft = _SOFT_SIGMA * noise
    return np.asarray(np.arcsinh(signal / soft) / math.asinh((top - black) / soft), dtype=np.float32)


def rgb_pixels(brightness: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Eight-bit picture (H, W, 3) of brightness (H, W) or (H, W, 3) from 0 to 1."""
    shown = np.round(255.0 * np.clip(brightness, 0.0, 1.0)).astype(np.uint8)
    return shown if shown.ndim == 3 else np.repeat(shown[..., None], 3, axis=2)


def _stretched_colours(values: NDArray[np.float32]) -> NDArray[np.float32]:
    levels = [_levels(values[..., k]) for k in range(3)]
    blacks = np.array([0.0 if one is None else one[0] - _BLACK_SIGMA * one[2] for one in levels], np.float32)
    signal = np.clip(np.nan_to_num(values) - blacks, 0.0, None)
    grey = signal.mean(axis=2)
    # One stretch for the mean of the channels, applied as a common factor, keeps the ratios of the colours.
    bright = stretch(values.mean(axis=2))
    shown = signal * (bright / np.maximum(grey, 1e-6))[..., None]
    return np.asarray(shown / np.maximum(shown.max(axis=2, keepdims=True), 1.0))


def _levels(values: NDArray[np.float32]) -> tuple[float, float, float] | None:
    """Median, white level and robust standard deviation of an image (H, W), from a sample; None without values."""
    step = max(1, math.isqrt(values.size // _SAMPLES))
    sample = values[::step, ::step]
    sample = sample[np.isfinite(sample)]
    if not len(sample):
        return None
    sky, top = (float(v) for v in np.percentile(sample, (50.0, 99.95)))
    # The median absolute deviation is zero if more than half of the pixels are equal, as in dark 8-bit pictures.
    noise = 1.4826 * float(np.median(np.abs(sample - sky))) or float(sample.std()) or 1.0
    return sky, max(top, sky + _LEAST_RANGE_SIGMA * noise), noise
