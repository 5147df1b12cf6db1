"""Animation of a sequence: the frame with its windows and matched stars, above a plot of the errors over time.

GIF by Pillow; MP4 by ffmpeg if it is installed.
"""

from __future__ import annotations

import io
import math
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from simulator.study.axes import BODY_AXES
from simulator.study.sequence.camera import TrackedFrame
from simulator.study.sequence.time_axis import nearly_all
from simulator.study.style import INK, STYLE
from startracker.core import Columns
from startracker.errors import BoresightError

SIDE_PX = 512
"""Longest side of the displayed frame."""
PLOT_HEIGHT_PX = 230
_MOST_PICTURES = 240
"""Longer sequences are subsampled."""
_PICTURE_MS = 100
_HEAD_PX = 38
_GREYS = 24
"""Number of grey levels of the sky: fewer levels compress better."""
_DPI = 100
_WINDOW, _MATCHED = (230, 159, 0), (86, 180, 233)


@dataclass(frozen=True, eq=False)
class FrameView:
    """Displayed content of one frame."""

    index: int
    """Row of the frame."""
    picture: NDArray[np.uint8]
    """(h, w): Reduced image, bright stars on a black sky."""
    factor: int
    """Pixels of the frame per pixel of the reduced image."""
    window_xy: NDArray[np.float64]
    window_half_px: int
    matched_xy: NDArray[np.float64]
    """Positions in the frame, pixels."""
    heading: str
    """Caption."""


def view_of(tracked: TrackedFrame) -> FrameView:
    """Reduced image of a tracked frame: the brightest pixel of every block, so that no star is lost."""
    row = tracked.row
    state = (
        row["mode"].replace("_", " ")
        if row["status"] == "solved"
        else f"{row['status']}, {row['mode']}".replace("_", " ")
    )
    heading = f"{row['elapsed_s']:8.2f} s   {state}   {row['stars_matched']} stars"
    if tracked.frame is None:
        nothing = np.zeros((1, 1), np.uint8)
        return FrameView(row["index"], nothing, 1, np.empty((0, 2)), 0, np.empty((0, 2)), heading)
    image = np.asarray(tracked.frame.image, dtype=np.float32)
    factor = max(1, -(-max(image.shape) // SIDE_PX))
    height, width = (n // factor * factor for n in image.shape)
    low = float(np.nanmedian(image))
    spread = 1.4826 * float(np.nanmedian(np.abs(image - low))) or float(np.nanstd(image)) or 1.0
    blocks = image[:height, :width].reshape(height // factor, factor, width // factor, factor).max(axis=(1, 3))
    # arcsinh stretch from two standard deviations above the sky to a hundred times as much
    stretched = np.arcsinh(np.clip((blocks - low) / spread - 2.5, 0.0, None) / 4.0) / np.arcsinh(60.0)
    shades = np.round(np.clip(np.nan_to_num(stretched), 0.0, 1.0) * (_GREYS - 1)) * (255.0 / (_GREYS - 1))
    return FrameView(
        row["index"],
        shades.astype(np.uint8),
        factor,
        tracked.window_xy,
        tracked.window_half_px,
        tracked.solution.stars.xy,
        heading,
    )


def pictures(views: list[FrameView], columns: Columns, name: str) -> Iterator[Image.Image]:
    """Images of the animation, all of the same size."""
    shown = views[:: -(-len(views) // _MOST_PICTURES)]
    height, width = max((view.picture.shape for view in views), key=lambda shape: shape[0] * shape[1])
    wide = max(width, 420)
    strip, (left, right, bottom) = _plot(columns, wide)
    font = ImageFont.load_default(size=13)
    last = max(float(columns["elapsed_s"][-1]), 1e-9)
    for view in shown:
        canvas = Image.new("RGB", (wide, _HEAD_PX + height + PLOT_HEIGHT_PX), "white")
        draw = ImageDraw.Draw(canvas)
        draw.text((8, 3), name, fill=INK, font=font)
        draw.text((8, 19), view.heading, fill=INK, font=font)
        corner = ((wide - width) // 2, _HEAD_PX)
        if view.picture.shape == (height, width):
            canvas.paste(Image.fromarray(view.picture), corner)
        else:
            draw.rectangle((*corner, corner[0] + width - 1, corner[1] + height - 1), fill=(64, 64, 64))
            draw.text((corner[0] + 12, corner[1] + 12), "no frame", fill="white", font=font)
        _marks(draw, view, corner)
        canvas.paste(strip, (0, _HEAD_PX + height))
        x = left + (right - left) * float(columns["elapsed_s"][view.index]) / last
        draw.line((x, _HEAD_PX + height + 4, x, _HEAD_PX + height + bottom), fill=(194, 74, 0), width=1)
        yield canvas


def gif_bytes(views: list[FrameView], columns: Columns, name: str) -> bytes:
    """The animation as a GIF; the same bytes for the same sequence."""
    palette: Image.Image | None = None
    reduced = []
    for picture in pictures(views, columns, name):
        if palette is None:
            palette = _palette(picture)
        reduced.append(picture.quantize(palette=palette, dither=Image.Dither.NONE))
    stream = io.BytesIO()
    reduced[0].save(
        stream, "GIF", save_all=True, append_images=reduced[1:], duration=_PICTURE_MS, loop=0, optimize=False
    )
    return stream.getvalue()


def _palette(picture: Image.Image) -> Image.Image:
    """Common palette: grey levels of the sky, marks, and the most frequent colours of the plot."""
    plot = picture.crop((0, picture.height - PLOT_HEIGHT_PX, picture.width, picture.height))
    reduced = plot.quantize(colors=96, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    shades = [round(k * 255.0 / (_GREYS - 1)) for k in range(_GREYS)]
    colours = [(v, v, v) for v in (*shades, 64)] + [_WINDOW, _MATCHED]
    found = reduced.getpalette() or []
    flat = [channel for colour in colours for channel in colour] + found[: 3 * 96]
    palette = Image.new("P", (1, 1))
    palette.putpalette((flat + flat[-3:] * 256)[:768])
    return palette


def find_ffmpeg() -> str | None:
    """Path of ffmpeg, or None."""
    return shutil.which("ffmpeg")


def mp4_bytes(views: list[FrameView], columns: Columns, name: str, program: str) -> bytes:
    """The animation as MP4 (H.264 if available in ffmpeg, otherwise its default codec).

    Raises
    ------
    BoresightError
        If ffmpeg fails, with its last message.
    """
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "sequence.mp4"
        images = [np.asarray(picture) for picture in pictures(views, columns, name)]
        height, width = images[0].shape[0] // 2 * 2, images[0].shape[1] // 2 * 2  # yuv420p requires even sides
        command = [
            program,
            "-y",
            "-loglevel",
            "error",
            "-f",
            "rawvideo",
            "-pix_fmt",
            "rgb24",
            "-s",
            f"{width}x{height}",
        ]
        command += ["-r", str(1000 // _PICTURE_MS), "-i", "-", "-pix_fmt", "yuv420p", "-map_metadata", "-1"]
        command += ["-fflags", "+bitexact", str(target)]
        data = b"".join(np.ascontiguousarray(image[:height, :width]).tobytes() for image in images)
        done = subprocess.run(command, input=data, capture_output=True, check=False)
        if done.returncode or not target.is_file():
            words = done.stderr.decode(errors="replace").strip().splitlines() or ["no output file"]
            raise BoresightError(f"{program}: the animation could not be created ({words[-1]})")
        return target.read_bytes()


def _marks(draw: ImageDraw.ImageDraw, view: FrameView, corner: tuple[int, int]) -> None:
    """Windows as squares, matched stars as circles."""

    def position(xy: NDArray[np.float64]) -> tuple[float, float]:
        x, y = (xy + 0.5) / view.factor - 0.5
        return corner[0] + float(x), corner[1] + float(y)

    half = max(view.window_half_px / view.factor, 3.0)
    for xy in view.window_xy:
        x, y = position(xy)
        draw.rectangle((x - half, y - half, x + half, y + half), outline=_WINDOW)
    around = len(view.window_xy) and half < 8.0  # a circle about as large as the square would merge with it
    ring = 1.0 + math.sqrt(2.0) * half if around else 6.0
    for xy in view.matched_xy:
        x, y = position(xy)
        draw.ellipse((x - ring, y - ring, x + ring, y + ring), outline=_MATCHED)


def _plot(columns: Columns, width: int) -> tuple[Image.Image, tuple[float, float, float]]:
    """Plot of the errors about the body axes over time; left, right and bottom of its time axis, pixels."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from simulator.study.style import BLUE, GREEN, VERMILION

    style = STYLE | {"figure.facecolor": "white", "savefig.facecolor": "white", "font.size": 8}
    with rc_context(style):
        figure = Figure(figsize=(width / _DPI, PLOT_HEIGHT_PX / _DPI), dpi=_DPI)
        canvas: Any = FigureCanvasAgg(figure)
        axes = figure.subplots(len(BODY_AXES), 1, sharex=True)
        t = columns["elapsed_s"]
        for ax, axis, colour in zip(axes, BODY_AXES, (BLUE, GREEN, VERMILION), strict=True):
            error, sigma = columns[f"error_{axis}_deg"] * 3600.0, columns[f"sigma_{axis}_deg"] * 3600.0
            ax.fill_between(t, -3.0 * sigma, 3.0 * sigma, color=colour, alpha=0.15, linewidth=0)
            ax.plot(t, error, "-", color=colour, linewidth=1.0)
            reach = nearly_all(error, 3.0 * sigma)
            ax.set_ylim(-1.3 * reach or -1.0, 1.3 * reach or 1.0)
            ax.set_ylabel(f"{axis} [″]")
        axes[-1].set_xlim(0.0, max(float(t[-1]), 1e-9))
        axes[-1].set_xlabel("time [s], ±3σ shaded")
        figure.align_ylabels()
        canvas.draw()
        box = axes[-1].get_window_extent()
        pixels = np.asarray(canvas.buffer_rgba())[:PLOT_HEIGHT_PX, :width, :3]
    return Image.fromarray(np.ascontiguousarray(pixels)), (float(box.x0), float(box.x1), PLOT_HEIGHT_PX - float(box.y0))
