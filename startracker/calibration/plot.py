"""Residuals of a calibration as a figure: over the image, by radius before and after, and their distribution.

Colours follow Okabe & Ito (2008), which colour-blind readers can distinguish; markers differ as well. Matplotlib
is imported when the figure is drawn.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from startracker.calibration.result import Calibration
from startracker.core import ARCSEC_RAD
from startracker.images.picture import figure_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BLUE, _ORANGE, _GREY = "#0072B2", "#E69F00", "#777777"
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_BINS = 8


def residual_picture(calibration: Calibration, form: str = "png") -> bytes:
    """The figure as the bytes of a PNG, SVG or PDF file; equal calibrations give equal bytes."""
    return figure_bytes(residual_figure(calibration), form, dpi=130)


def residual_figure(calibration: Calibration) -> Figure:
    """Three panels: arrows of the residuals, radial residuals by radius, and normalised residuals of both axes."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=(15.0, 4.6), layout="constrained")
        FigureCanvasAgg(figure)
        arrows, radius, histogram = figure.subplots(1, 3, width_ratios=(1.25, 1.0, 1.0))
    _draw_arrows(arrows, calibration)
    _draw_radius(radius, calibration)
    _draw_histogram(histogram, calibration)
    return figure


def _draw_arrows(ax: Axes, calibration: Calibration) -> None:
    camera = calibration.camera
    scale = _round_down(0.04 * camera.width / max(calibration.weighted_rms_px, 1e-9))
    for k, one in enumerate(calibration.fields):
        ax.quiver(
            *one.xy.T,
            *one.residual_px.T,
            color=_COLOURS[k % len(_COLOURS)],
            angles="xy",
            scale_units="xy",
            scale=1.0 / scale,
            width=0.0022,
            alpha=0.8,
            label=one.name,
        )
    ax.set(
        xlim=(-0.5, camera.width - 0.5),
        ylim=(camera.height - 0.5, -0.5),
        aspect="equal",
        xlabel="column (px)",
        ylabel="row (px)",
        title=f"residuals × {scale:g}",
    )
    if len(calibration.fields) <= len(_COLOURS):
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), fontsize=7, ncols=2, frameon=False)


def _draw_radius(ax: Axes, calibration: Calibration) -> None:
    camera = calibration.camera
    scale = camera.pixel_rad / ARCSEC_RAD
    xy = np.concatenate([f.xy for f in calibration.fields])
    radius = np.hypot(xy[:, 0] - camera.cx, xy[:, 1] - camera.cy)
    outward = (xy - [camera.cx, camera.cy]) / np.maximum(radius, 1e-9)[:, None]
    weight = calibration.sigma_px**-2.0
    edges = np.quantile(radius, np.linspace(0.0, 1.0, _BINS + 1))
    for residual, colour, marker, label in (
        (np.concatenate(calibration.plain_residual_px), _ORANGE, "s", "focal length only"),
        (calibration.residual_px, _BLUE, "o", "calibrated"),
    ):
        radial = np.sum(residual * outward, axis=1) * scale
        ax.plot(radius, radial, marker, color=colour, markersize=2.5, alpha=0.35, linestyle="none")
        bins = np.clip(np.searchsorted(edges, radius, side="right") - 1, 0, _BINS - 1)
        total = np.bincount(bins, weight, _BINS)
        used = total > 0
        mean = np.bincount(bins, weight * radial, _BINS)[used] / total[used]
        middle = np.bincount(bins, weight * radius, _BINS)[used] / total[used]
        error = scale / np.sqrt(total[used])
        ax.errorbar(middle, mean, error, fmt=f"-{marker}", color=colour, capsize=2, markersize=5, label=label)
    # Quantiles, so that the noise of the faintest stars does not determine the scale.
    reach = 1.3 * float(np.quantile(np.abs(calibration.residual_px) * scale, 0.97)) + 1e-9
    plain = np.concatenate(calibration.plain_residual_px)
    reach = max(reach, 1.1 * float(np.quantile(np.abs(np.sum(plain * outward, axis=1)), 0.95)) * scale)
    ax.axhline(0.0, color=_GREY, linewidth=0.8)
    ax.set(
        ylim=(-reach, reach),
        xlabel="distance from the principal point (px)",
        ylabel="radial residual, outward positive (arcsec)",
        title="before and after calibration, weighted means",
    )
    ax.legend(fontsize=8, frameon=False)


def _draw_histogram(ax: Axes, calibration: Calibration) -> None:
    normal = (calibration.residual_px / calibration.sigma_px[:, None]).ravel()
    bins = np.linspace(-5.0, 5.0, 41)
    ax.hist(normal, bins=bins.tolist(), density=True, color=_BLUE, alpha=0.6, label="residuals, both axes")
    x = np.linspace(-5.0, 5.0, 201)
    ax.plot(x, np.exp(-0.5 * x * x) / np.sqrt(2.0 * np.pi), color="black", linewidth=1.2, label="Gaussian, σ = 1")
    outside = int(np.sum(np.abs(normal) > 5.0))
    note = f"; {outside} beyond ±5" if outside else ""
    ax.set(
        xlabel="residual / standard error",
        ylabel="density (1)",
        title=f"{calibration.stars} stars, {calibration.rejected} rejected{note}",
    )
    ax.legend(fontsize=8, frameon=False)


def _round_down(value: float) -> float:
    """Largest number of the form 1, 2, 5 times a power of ten that does not exceed `value`."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(m for m in (1.0, 2.0, 5.0) if m * power <= value * (1.0 + 1e-9)))
