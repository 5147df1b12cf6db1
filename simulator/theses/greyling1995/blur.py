"""The star's image (Greyling 1995, section 4.1): Airy pattern, the Gaussian that stands for it, and its pixels."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize_scalar

from simulator.optics import airy
from simulator.optics.psf import SIGMA_PER_RING
from simulator.study.style import BLUE, GREEN, INK, ORANGE, SOFT, VERMILION
from simulator.theses.printed import Section, new_figure
from simulator.theses.tables import Values, table_rows
from startracker.centroid.bias import moment_bias

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["CRITERIA", "OFFSETS", "airy_bias", "airy_pattern", "best_sigma", "pixel_grid", "section", "sigma_of_bias"]

FloatArray = NDArray[np.float64]

FIRST_DARK_RING, SECOND_DARK_RING = airy.FIRST_RING * np.pi, 7.015586669815619
"""First zeros of J₁: 3.8317 and 7.0156."""

X_FIT: FloatArray = np.arange(1.0, 51.0) / 10.0
"""Where the thesis compares the two functions: 0.1 to 5 in steps of 0.1, the argument of the Bessel function."""

OFFSETS: FloatArray = np.arange(11.0) * 0.05
"""Offsets of Table 4.1, detector lengths."""

THESIS_SIGMA, THESIS_FIT_SIGMA = 1.23, 1.3497

CRITERIA: dict[str, Callable[[FloatArray], float]] = {
    "range of the error (max − min)": lambda e: float(np.ptp(e)),
    "largest absolute error": lambda e: float(np.abs(e).max()),
    "rms error": lambda e: float(np.sqrt(np.mean(e**2))),
}
"""What "the least error between the Airy and Gaussian representations" may mean."""


def airy_pattern(x: ArrayLike) -> FloatArray:
    """Airy pattern [2J₁(x)/x]², 1 in the middle, at x = ka sin θ (eq. 4.1)."""
    return np.asarray(airy.intensity(np.asarray(x, dtype=float) / np.pi) * 4.0 / np.pi)


def gaussian(x: ArrayLike, sigma: float) -> FloatArray:
    """exp(−x²/2σ²) (eq. 4.3)."""
    return np.asarray(np.exp(-0.5 * (np.asarray(x, dtype=float) / sigma) ** 2))


def best_sigma(criterion: Callable[[FloatArray], float], x: FloatArray = X_FIT) -> float:
    """σ of the Gaussian nearest to the Airy pattern at the places `x`, by a criterion of their difference."""
    truth = airy_pattern(x)
    found = minimize_scalar(
        lambda sigma: criterion(gaussian(x, sigma) - truth),
        bounds=(1.0, 2.0),
        method="bounded",
        options={"xatol": 1e-9},
    )
    return float(found.x)


def pixel_grid(side_px: int = 5) -> tuple[FloatArray, FloatArray]:
    """Column and row (side, side) of each pixel of a window, from its middle."""
    n = side_px // 2
    rows, columns = np.mgrid[-n : n + 1, -n : n + 1].astype(float)
    return columns, rows


def airy_bias(offset_px: ArrayLike = OFFSETS, ring_px: float = FIRST_DARK_RING) -> FloatArray:
    """Offset less first moment over 5 × 5 point samples of an Airy pattern whose first dark ring is `ring_px` out."""
    columns, rows = pixel_grid()
    out = []
    for offset in np.atleast_1d(np.asarray(offset_px, dtype=float)):
        samples = airy_pattern(np.hypot(columns - offset, rows) * FIRST_DARK_RING / ring_px)
        out.append(offset - float((samples * columns).sum() / samples.sum()))
    return np.array(out)


def sigma_of_bias(ring_px: float = FIRST_DARK_RING) -> float:
    """σ of the point-sampled Gaussian whose centroid bias is nearest, in least squares over `OFFSETS`, to the Airy
    pattern's."""
    truth = airy_bias(OFFSETS, ring_px)
    scale = ring_px / FIRST_DARK_RING
    found = minimize_scalar(
        lambda sigma: float(((moment_bias(OFFSETS, sigma, 5, integrated=False) - truth) ** 2).sum()),
        bounds=(0.7 * scale, 1.6 * scale),
        method="bounded",
        options={"xatol": 1e-9},
    )
    return float(found.x)


def spread(sigma_px: float) -> FloatArray:
    """Intensity (5, 5) at the pixels' centres of a star in the middle of one, relative to the middle."""
    columns, rows = pixel_grid()
    return gaussian(np.hypot(columns, rows), sigma_px)


def section(
    f_number: float = 1.4, wavelength_um: float = 0.555, ring_px: float = 2.0, pitch_um: float = 10.0
) -> Section:
    """Section 4.1: rows and Figs. 4.1 to 4.4.

    Parameters
    ----------
    f_number, wavelength_um : float
        The focused lens.
    ring_px, pitch_um : float
        Where defocus puts the first dark ring, and the pixel's side, for Fig. 4.2 (a).
    """
    figures: dict[str, Callable[[], Figure]] = {
        "fig_4_1_airy": _airy_figure,
        "fig_4_2_airy_and_gaussian": partial(_both_figure, f_number, wavelength_um, ring_px, pitch_um),
        "fig_4_3_difference": _difference_figure,
        "fig_4_4_pixel_spread": _spread_figure,
    }
    rows = table_rows("greyling1995/blur", _airy_values(f_number, wavelength_um) | _fit_values(ring_px))
    return Section("Chapter 4.1: the stellar image", rows, figures)


def _airy_values(f_number: float, wavelength_um: float) -> Values:
    return {
        "disk_um": 2.0 * airy.first_ring() * f_number * wavelength_um,
        "within_first_percent": 100.0 * float(airy.encircled_energy(FIRST_DARK_RING / np.pi)),
        "within_second_percent": 100.0 * float(airy.encircled_energy(SECOND_DARK_RING / np.pi)),
    }


def _fit_values(ring_px: float) -> Values:
    found = {name: best_sigma(criterion) for name, criterion in CRITERIA.items()}
    minimax = found["range of the error (max − min)"]
    truth, light = airy_pattern(X_FIT), spread(THESIS_FIT_SIGMA)
    excess = [np.ptp(gaussian(X_FIT, s) - truth) for s in (THESIS_FIT_SIGMA, minimax)]
    return {
        "minimax": minimax,
        "range_excess": excess[0] / excess[1] - 1,
        "sigmas": found,
        "ring": best_sigma(CRITERIA["range of the error (max − min)"], X_FIT[X_FIT < FIRST_DARK_RING]),
        "bias_sigma": sigma_of_bias(),
        "ring_px": ring_px,
        "ring_sigma_px": SIGMA_PER_RING * ring_px,
        "fitted_ring_px": THESIS_FIT_SIGMA / SIGMA_PER_RING,
        "largest_error": np.abs(gaussian(X_FIT, THESIS_FIT_SIGMA) - truth).max(),
        "share_123": 100.0 * _central_share(THESIS_SIGMA),
        "share_135": 100.0 * _central_share(THESIS_FIT_SIGMA),
        "sigma_of_80": _sigma_of_share(0.8),
        "above": int((light > 0.3).sum()),
        "light": light,
    }


def _central_share(sigma_px: float) -> float:
    """Share of the central 3 × 3 in the 5 × 5 pixels."""
    light = spread(sigma_px)
    return float(light[1:4, 1:4].sum() / light.sum())


def _sigma_of_share(share: float) -> float:
    found = minimize_scalar(lambda s: (_central_share(s) - share) ** 2, bounds=(0.5, 2.0), method="bounded")
    return float(found.x)


def _airy_figure() -> Figure:
    figure, (left, right) = new_figure(1, 2, (7.6, 3.4))
    x = np.linspace(-12.0, 12.0, 961)
    left.plot(x, airy_pattern(x), color=BLUE)
    rings = np.where(np.abs(x) >= FIRST_DARK_RING, 20.0 * airy_pattern(x), np.nan)
    left.plot(x, rings, color=VERMILION, linestyle="--", label="20 times, the rings")
    for k, ring in enumerate((FIRST_DARK_RING, SECOND_DARK_RING)):
        left.axvline(ring, color=SOFT, ymax=0.76, linestyle=":", label="dark rings, 3.83 and 7.02" if k == 0 else None)
        left.axvline(-ring, color=SOFT, ymax=0.76, linestyle=":")
    left.set(ylim=(0.0, 1.35), xlabel="ka sin θ", ylabel="I(θ) / I(0)")
    left.legend(loc="upper right")
    u, v = np.meshgrid(x[::4], x[::4])
    picture = right.imshow(
        np.log10(np.maximum(airy_pattern(np.hypot(u, v)), 1e-4)), extent=(-12, 12, -12, 12), cmap="Greys_r"
    )
    right.grid(visible=False)
    right.set(xlabel="ka sin θ along x", ylabel="ka sin θ along y")
    figure.colorbar(picture, ax=right, label="log₁₀ I(θ) / I(0)")
    figure.suptitle("Fig. 4.1  The Airy function", fontsize=10)
    return figure


def _both_figure(f_number: float, wavelength_um: float, ring_px: float, pitch_um: float) -> Figure:
    figure, (left, right) = new_figure(1, 2, (7.6, 3.4))
    r_um = np.linspace(-30.0, 30.0, 1201)
    focused = airy.first_ring() * f_number * wavelength_um
    left.plot(r_um, airy_pattern(r_um / focused * FIRST_DARK_RING), color=BLUE, label=f"focused, ring {focused:.2f} µm")
    wide = ring_px * pitch_um
    left.plot(
        r_um, airy_pattern(r_um / wide * FIRST_DARK_RING), color=VERMILION, linestyle="--",
        label=f"defocused, ring {wide:g} µm",
    )  # fmt: skip
    left.set(
        xlabel="distance from the centre [µm]",
        ylabel="intensity / that of the centre",
        title="(a) focused and defocused Airy pattern",
        ylim=(0.0, 1.35),
    )
    left.legend(loc="upper right")
    x = np.linspace(-5.0, 5.0, 401)
    right.plot(x, airy_pattern(x), color=BLUE, label="Airy")
    right.plot(x, gaussian(x, THESIS_FIT_SIGMA), color=VERMILION, linestyle="--", label="Gaussian, σ = 1.3497")
    right.plot(x, gaussian(x, THESIS_SIGMA), color=GREEN, linestyle="-.", label="Gaussian, σ = 1.23")
    right.set(
        xlabel="x",
        ylabel="intensity / that of the centre",
        title="(b) Airy and Gaussian distributions",
        ylim=(0.0, 1.35),
    )
    right.legend(loc="upper right")
    figure.suptitle("Fig. 4.2  The Airy and Gaussian functions", fontsize=10)
    return figure


def _difference_figure() -> Figure:
    figure, axes = new_figure(1, 1, (5.6, 3.7))
    x = np.linspace(0.0, 5.0, 501)
    for sigma, colour, line in ((THESIS_FIT_SIGMA, BLUE, "-"), (THESIS_SIGMA, VERMILION, "--")):
        axes.plot(x, gaussian(x, sigma) - airy_pattern(x), color=colour, linestyle=line, label=f"σ = {sigma:g}")
    axes.axhline(0.0, color=INK, linewidth=0.6)
    axes.axvline(FIRST_DARK_RING, color=SOFT, linestyle=":", label="first dark ring")
    axes.fill_between(x, -0.0008, 0.0008, color=ORANGE, alpha=0.5, linewidth=0, label="± 0.0008")
    axes.set(
        xlabel="x",
        ylabel="(Gaussian − Airy) / peak",
        title="Fig. 4.3  Relative error between Airy and Gaussian functions",
    )
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=4)
    return figure


def _spread_figure() -> Figure:
    figure, panels = new_figure(1, 2, (7.2, 3.7))
    for axes, sigma in zip(panels, (THESIS_FIT_SIGMA, THESIS_SIGMA), strict=True):
        image = 100.0 * spread(sigma)
        axes.imshow(image, extent=(-2.5, 2.5, -2.5, 2.5), cmap="Blues", vmin=0.0, vmax=180.0)
        for row in range(5):
            for column in range(5):
                axes.text(column - 2, 2 - row, f"{image[row, column]:.0f}", ha="center", va="center", color=INK)
        axes.plot([-1.5, 1.5, 1.5, -1.5, -1.5], [-1.5, -1.5, 1.5, 1.5, -1.5], color=VERMILION, linewidth=1.2)
        axes.set_title(f"σ = {sigma:g} px: {100 * _central_share(sigma):.0f} % in the 3 × 3")
        axes.grid(visible=False)
        axes.set(xlabel="x [pixels]", ylabel="y [pixels]")
    figure.suptitle("Fig. 4.4  Gaussian pixel intensity spread, per cent of the centre", fontsize=10)
    return figure
