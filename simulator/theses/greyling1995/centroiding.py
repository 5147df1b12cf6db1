"""Errors of the centroid (Greyling 1995, section 4.3): bias, noise, smear and distortion; what they are in degrees."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simulator.study.style import BLUE, GREEN, INK, ORANGE, SOFT, VERMILION
from simulator.theses.greyling1995.blur import OFFSETS, THESIS_FIT_SIGMA, THESIS_SIGMA, airy_bias
from simulator.theses.greyling1995.centre import (
    LISTING_OFFSETS,
    LISTING_SEED,
    LISTING_SIGMA,
    central_pixels,
    first_moments,
    lower_equal_peaks,
    noise_errors,
    smeared_frames,
)
from simulator.theses.greyling1995.centre import smear_errors as smear_errors_of_pixel
from simulator.theses.greyling1995.digits import compare_cut
from simulator.theses.greyling1995.star_images import (
    distortion_errors,
    smear_errors,
    smear_path,
    star_stamps,
    tracker_errors,
)
from simulator.theses.printed import NOTHING, Row, Section, compare, new_figure
from startracker.centroid.bias import moment_bias

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["TABLE_4_1", "TABLE_4_2", "section"]

FloatArray = NDArray[np.float64]

TABLE_4_1 = (
    "0", "0.010284", "0.020604", "0.030994", "0.041490", "0.052125", "0.062934", "0.073949", "0.085203", "0.096728",
    "0.10855",
)  # fmt: skip
"""Printed bias, detector lengths, at offsets 0, 0.05 … 0.5."""

TABLE_4_2 = {
    "TC211": ((192, 165), "21.8", "0.006"),
    "TH 7882": ((579, 400), "9", "0.025"),
    "Tektronix": ((512, 512), "7.03", "0.002"),
    "P8600": ((385, 576), "9.35", "0.0026"),
}
"""Format H × V, printed accuracy in seconds of arc and in degrees."""

FIELD_DEG = 10.0
CENTROID_ACCURACY = 0.1
"""Detector lengths: what section 4.3.3 concludes."""

MEDIAN_OF_LARGEST = 0.5 ** (1.0 / len(OFFSETS))
"""Quantile of single errors that is the median of the largest of eleven."""

RATES_PX_S = (4.0, 8.0, 10.0, 20.0)
_COLOURS = (BLUE, ORANGE, GREEN, VERMILION)
_LINES = ("-", "--", "-.", ":")
_MARKERS = "osD^"


def section(seeds: int = 200) -> Section:
    """Section 4.3: rows and Figs. 4.8 to 4.13, Tables 4.1 and 4.2.

    Parameters
    ----------
    seeds : int
        Draws of the noise that Figs. 4.10 and 4.11 rest on.
    """
    figures: dict[str, Callable[[], Figure]] = {
        "fig_4_8_offsets": _offsets_figure,
        "fig_4_9_bias": _bias_figure,
        "fig_4_10_noise": partial(_noise_figure, min(seeds, 40)),
        "fig_4_11_largest_noise_error": partial(_largest_figure, seeds),
        "fig_4_12_smear": _smear_figure,
        "fig_4_13_distortion": _distortion_figure,
    }
    rows = [*_bias_rows(), *_noise_rows(seeds), *_smear_and_distortion_rows(), *_angle_rows()]
    return Section("Chapter 4.3: centroids", rows, figures)


def _bias_rows() -> list[Row]:
    bias = moment_bias(OFFSETS, THESIS_SIGMA, 5, integrated=False)
    real = moment_bias(OFFSETS, THESIS_SIGMA, 5)
    rows = [
        compare_cut(
            "Table 4.1", f"bias at an offset of {offset:.2f}", printed, float(value), unit="L",
            why="" if offset else "Gaussian of σ = 1.23 sampled at the pixels' centres, first moment over 5 × 5",
        )
        for offset, printed, value in zip(OFFSETS, TABLE_4_1, bias, strict=True)
    ]  # fmt: skip
    rows.append(
        compare(
            "§ 4.3.3", "absolute error at dx = 0.5 L", "0.109", float(bias[-1]), unit="L",
            why=f"integrated over the pixels, as a detector does, it is {real[-1]:.4f} L",
        )
    )  # fmt: skip
    return [*rows, *_equal_peak_rows(float(bias[-1]))]


def _equal_peak_rows(bias: float) -> list[Row]:
    """What the choice between two equal central pixels costs."""
    still = smeared_frames((np.zeros((1, 2)), np.ones(1)), np.array([0.5]), THESIS_SIGMA)
    frame = np.rint(255.0 * still / still.max())
    shifts = [
        float((first_moments(lowered, *central_pixels(lowered)) - first_moments(frame, *central_pixels(frame)))[0])
        for lowered in (lower_equal_peaks(frame[0], levels)[None] for levels in (1, 3))
    ]
    return [
        Row(
            "Fig. 4.11", "error of the wrong one of two equal central pixels", "0.035 L", f"{2.0 * bias:.3f} L",
            "differs",
            "twice the bias where the table's value for the other pixel is taken off; 0 where its sign goes "
            "with the measured moment, or where the window moves, as with us. centre.m measures from the chosen pixel "
            f"and leaves the step of a whole pixel in: {1.0 - 2.0 * bias:.2f} L",
        ),
        Row(
            "§ 4.3.1", "two equal highest pixels, one lowered by 1 to 3 of 255 levels: shift of the centroid", NOTHING,
            f"{abs(shifts[0]):.4f} to {abs(shifts[1]):.4f} L", "not printed",
            "the perturbation that settles which pixel is the central one; a star between two pixels, at full scale",
        ),
    ]  # fmt: skip


def _noise_rows(seeds: int) -> list[Row]:
    rows = []
    for snr_db, printed in ((40.0, "0.0063"), (20.0, "0.088")):
        errors, wrong = noise_errors(snr_db)
        own = float(np.abs(errors[~wrong]).max())
        low, middle, high = _largest_quantiles(snr_db, seeds)
        listing = "centre.m" if snr_db == 40.0 else "centre.m with ten times its factor"
        rows.append(
            compare(
                "Fig. 4.10", f"largest error at {snr_db:g} dB, seed {LISTING_SEED}", printed, own, unit="L",
    why=f"{listing}: n = {10.0 ** (1.0 - snr_db / 20.0):g} (rand − 0.05) on I₀ = 10, σ = {LISTING_SIGMA}, "
                "offsets in steps of 0.01, noise-free error taken off, right central pixel "
                f"({np.count_nonzero(wrong)} of {wrong.size} have the wrong one); {seeds} seeds: "
                f"median {middle:.4f}, 95 % {low:.4f} to {high:.4f}. "
                "Which run the figure shows is not said",
            )
        )  # fmt: skip
    return rows


def _largest_quantiles(snr_db: float, seeds: int) -> FloatArray:
    """2.5, 50 and 97.5 % over the first seeds of the largest error with the right central pixel."""
    errors, wrong = noise_errors(snr_db, np.arange(1, seeds + 1))
    return np.asarray(np.quantile(np.where(wrong, 0.0, np.abs(errors)).max(axis=1), [0.025, 0.5, 0.975]))


def _smear_and_distortion_rows() -> list[Row]:
    tilted = distortion_errors(0.8)[-1]
    half = float(np.abs(distortion_errors(0.5)).max())
    smear = max(float(np.abs(smear_errors(4.0, angle)).max()) for angle in np.arange(0.0, 181.0, 7.5))
    spike = float(np.abs(smear_errors_of_pixel(smear_path(4.0, 45.0), other_of_equal=True)).max())
    bias = float(moment_bias(0.5, THESIS_SIGMA, 5, integrated=False))
    noisy, wrong = noise_errors(20.0, np.arange(1, 201))
    noise = np.where(wrong, 0.0, np.abs(noisy)).max(axis=1)
    limit, where = "≤ 0.1 L", "§ 4.3.3"
    ours = float(np.abs(tracker_errors(THESIS_SIGMA / 0.5, THESIS_SIGMA)).max())
    return [
        Row(
            "Fig. 4.13", "error at a distortion of 0.8", "nearly 0.09 L", f"{tilted:.4f} L", "exact",
            "eq. 4.12, σ_x = σ_y / d_r: at an offset of 0.5, the bias of a round star taken off. centre.m has σ₁σ₂ "
            f"under x and y alike, a round star, which gives {_listing_distortion(0.8):.3f} L at 0.8",
        ),
        Row(
            where, "first moment without any correction", limit, f"{bias:.4f} L", "differs",
            "the bias alone exceeds it near 0.5 L (Table 4.1)",
        ),
        Row(
            where, "SNR of 20 dB, bias taken off", limit, f"{noise.max():.3f} L, the largest of 200 seeds",
            "exact" if noise.max() <= CENTROID_ACCURACY else "differs",
            f"noise by centre.m, right central pixel; median {np.median(noise):.3f} L",
        ),
        Row(where, "smear of 4 pixels/s over 0.5 s in any direction, bias taken off", limit, f"{smear:.4f} L", "exact"),
        Row(
            "Fig. 4.12", "spike where the wrong one of two equal pixels is the centre, 4 pixels/s", NOTHING,
            f"{spike:.3f} L", "not printed",
            "the figure shows spikes without a number; a smeared star at half a pixel has two equal highest pixels in "
            "every direction, and rounding decides",
        ),
        Row(
            where, "distortion of 50 %, bias taken off", limit, f"{half:.3f} L", "differs",
            f"its own Fig. 4.13 has nearly 0.09 L at 20 %; our tracker, which measures the widths: {ours:.1e} L",
        ),
    ]  # fmt: skip


def _listing_distortion(ratio: float) -> float:
    """Largest error of `centre.m`'s distorted star: σ² → σ² d_r along both axes."""
    round_star, distorted = (
        moment_bias(LISTING_OFFSETS, LISTING_SIGMA * factor, 5, integrated=False) for factor in (1.0, np.sqrt(ratio))
    )
    return float(np.abs(distorted - round_star).max())


def _angle_rows() -> list[Row]:
    pixel_deg = FIELD_DEG / 192
    rows = [
        compare("§ 4.3.3", "detector length of the TC211 at a field of 10°", "0.0521", pixel_deg, unit="°"),
        Row(
            "§ 4.3", "specification of roll and yaw", "1.5 mrad", f"{1e3 * np.radians(0.025):.2f} mrad", "differs",
            "0.025°, which is 1.5 arc minutes (Table 3.1)",
        ),
        Row(
            "§ 4.3.3", "accuracy that the specification of 0.025° needs there", "L/2", f"{0.025 / pixel_deg:.2f} L",
            "exact",
        ),
    ]  # fmt: skip
    for name, (size, seconds, degrees) in TABLE_4_2.items():
        accuracy_deg = CENTROID_ACCURACY * FIELD_DEG / min(size)
        rows.append(
            compare(
                "Table 4.2", f"accuracy with the {name}, {size[0]} × {size[1]}", seconds, 3600.0 * accuracy_deg,
                unit="″", why="0.1 L along the side with fewer pixels",
            )
        )  # fmt: skip
        why = "misprint: ten times its own figure in seconds" if name == "TH 7882" else ""
        rows.append(compare("Table 4.2", f"the same, {name}", degrees, accuracy_deg, unit="°", why=why))
    return rows


def _offsets_figure() -> Figure:
    figure, panels = new_figure(2, 3, (7.4, 5.2))
    offsets = np.arange(6) * 0.1
    stamps = star_stamps(offsets)
    for axes, offset, stamp, letter in zip(panels.ravel(), offsets, stamps, "abcdef", strict=True):
        axes.imshow(stamp, extent=(-2.5, 2.5, -2.5, 2.5), origin="lower", cmap="Blues", vmin=0.0, vmax=1.8)
        for row in range(5):
            for column in range(5):
                value = f"{stamp[row, column]:.2f}"
                axes.text(column - 2, row - 2, value, ha="center", va="center", fontsize=7, color=INK)
        axes.plot(offset, -0.32, "+", color=VERMILION, markersize=9, markeredgewidth=1.5)
        axes.set_title(f"({letter}) dx = {offset:.1f}")
        axes.grid(visible=False)
    for axes in panels[1]:
        axes.set_xlabel("x [L]")
    for axes in panels[:, 0]:
        axes.set_ylabel("y [L]")
    figure.suptitle("Fig. 4.8  Intensity distribution for offset from 0 to 0.5, σ = 1.23", fontsize=10)
    return figure


def _bias_figure() -> Figure:
    figure, axes = new_figure(1, 1, (5.8, 4.0))
    fine = np.linspace(0.0, 0.5, 51)
    for sigma, colour, line in ((1.0, GREEN, "-."), (THESIS_SIGMA, BLUE, "-"), (THESIS_FIT_SIGMA, VERMILION, "--")):
        axes.plot(
            fine, moment_bias(fine, sigma, 5, integrated=False), color=colour, linestyle=line,
            label=f"Gaussian, σ = {sigma:g}",
        )  # fmt: skip
    axes.plot(fine[::5], airy_bias(fine[::5]), "x", color=INK, label="Airy, ring at 3.83 L")
    printed = [float(value) for value in TABLE_4_1]
    axes.plot(OFFSETS, printed, "o", color=BLUE, markerfacecolor="none", label="Table 4.1, as printed")
    axes.plot(
        fine, moment_bias(fine, THESIS_SIGMA, 5), color=ORANGE, linestyle=":", label="σ = 1.23, integrated over pixels"
    )
    axes.set_xlabel("offset from the central pixel [L]")
    axes.set_ylabel("bias error [L]")
    axes.set_title("Fig. 4.9  Algorithm bias error")
    axes.legend(loc="upper left")
    return figure


def _noise_figure(seeds: int) -> Figure:
    figure, panels = new_figure(1, 2, (7.4, 3.4))
    for axes, snr_db, letter in zip(panels, (40.0, 20.0), "ab", strict=True):
        errors, wrong = noise_errors(snr_db, np.arange(1, seeds + 1))
        shown = np.where(wrong, np.nan, errors)
        for row in np.delete(shown, LISTING_SEED - 1, axis=0):
            axes.plot(LISTING_OFFSETS, row, color=SOFT, linewidth=0.4, alpha=0.5)
        axes.plot(LISTING_OFFSETS, shown[LISTING_SEED - 1], color=BLUE, linewidth=1.2, label=f"seed {LISTING_SEED}")
        axes.plot([], [], color=SOFT, linewidth=0.8, label=f"{seeds - 1} others")
        axes.axhline(0.0, color=INK, linewidth=0.6)
        axes.set_title(f"({letter}) SNR = {snr_db:g} dB")
        axes.set_xlabel("offset from the central pixel [L]")
        axes.set_ylabel("error [L]")
        reach = 1.5 * float(np.nanmax(np.abs(shown)))
        axes.set_ylim(-reach, reach)
        axes.legend(loc="upper left", ncols=2)
    figure.suptitle("Fig. 4.10  Noise error by centre.m, bias taken off", fontsize=10)
    return figure


def _largest_figure(seeds: int) -> Figure:
    figure, axes = new_figure(1, 1, (6.0, 4.0))
    snr_db = np.arange(20.0, 41.0, 2.0)
    quantiles = np.array([_largest_quantiles(float(snr), seeds) for snr in snr_db])
    axes.fill_between(
        snr_db, quantiles[:, 0], quantiles[:, 2], color=BLUE, alpha=0.2, linewidth=0, label="95 % of seeds"
    )
    axes.plot(snr_db, quantiles[:, 1], color=BLUE, marker="o", markersize=4, label="median seed")
    with_wrong = [float(np.abs(noise_errors(float(snr))[0]).max()) for snr in snr_db]
    axes.plot(
        snr_db,
        with_wrong,
        color=ORANGE,
        linestyle=":",
        marker="^",
        markersize=4,
        label=f"seed {LISTING_SEED}, wrong one of two equal pixels too",
    )
    ours = [np.quantile(np.abs(tracker_errors(snr_db=snr)), MEDIAN_OF_LARGEST) for snr in snr_db]
    axes.plot(
        snr_db,
        ours,
        color=VERMILION,
        linestyle="--",
        marker="s",
        markersize=4,
        label="our tracker, which does not know the offset",
    )
    axes.plot([40.0, 20.0], [0.0063, 0.088], "k*", markersize=11, label="printed")
    axes.set_yscale("log")
    axes.set_xlim(41.0, 19.0)
    axes.set_xlabel("signal-to-noise ratio [dB]")
    axes.set_ylim(4e-3, 3.0)
    axes.set_ylabel("largest error [L]")
    axes.set_title("Fig. 4.11  Maximum noise error after bias correction")
    axes.legend(loc="upper left")
    return figure


def _smear_figure() -> Figure:
    figure, (left, middle, right) = new_figure(1, 3, (9.6, 3.9), sharey=True)
    angles = np.arange(0.0, 181.0, 7.5)
    for rate, colour, line, marker in zip(RATES_PX_S, _COLOURS, _LINES, _MARKERS, strict=True):
        errors = [float(np.abs(smear_errors(rate, angle)).max()) for angle in angles]
        left.plot(angles, errors, color=colour, linestyle=line, label=f"{rate:g} pixels/s")
        fine = np.arange(0.0, 181.0, 2.5)
        chosen = [_errors_by_maximum(rate, float(angle)) for angle in fine]
        middle.plot(fine, chosen, color=colour, linestyle=line, label=f"{rate:g} pixels/s")
        found = [tracker_errors(path=smear_path(rate, angle), centroider="least_squares") for angle in angles[::2]]
        ours = [float(np.abs(e[:, 0]).max()) if len(e) else np.nan for e in found]
        right.plot(
            angles[::2], ours, color=colour, linestyle=line, marker=marker, markersize=4, label=f"{rate:g} pixels/s"
        )
    left.set_title("right central pixel")
    middle.set_title("brightest pixel: spikes where two are equal")
    right.set_title("our tracker, least_squares")
    left.set_ylabel("largest error along x [L]")
    left.set_yscale("log")
    left.set_ylim(1e-5, 100.0)
    for axes in (left, middle, right):
        axes.set_xlabel("direction of the smear [°]")
        axes.set_xticks(np.arange(0, 181, 45))
        axes.axhline(CENTROID_ACCURACY, color=INK, linewidth=0.8, linestyle=(0, (1, 2)))
        axes.legend(loc="upper center", ncols=2)
    figure.suptitle("Fig. 4.12  Maximum error against smear direction, 0.5 s (dotted: 0.1 L)", fontsize=10)
    return figure


def _errors_by_maximum(rate_px_s: float, angle_deg: float) -> float:
    """Largest error over Table 4.1's offsets with the brightest pixel as the central one.

    At half a pixel two pixels are equal whatever the direction. Their sums over the smear are made in another order, so
    that floating point makes one or the other greater: the spikes of Fig. 4.12.
    """
    path = smear_path(rate_px_s, angle_deg)
    frame = smeared_frames(path, OFFSETS[-1:], THESIS_SIGMA)
    wrong = int(central_pixels(frame)[1][0]) != frame.shape[2] // 2
    return float(np.abs(smear_errors_of_pixel(path, other_of_equal=wrong)).max())


def _distortion_figure() -> Figure:
    figure, axes = new_figure(1, 1, (5.8, 4.0))
    ratios = np.linspace(0.3, 1.0, 29)
    for integrated, colour, line, name in (
        (False, BLUE, "-", "point samples, as in the thesis"),
        (True, ORANGE, ":", "integrated over pixels"),
    ):
        errors = [float(np.abs(distortion_errors(ratio, integrated=integrated)).max()) for ratio in ratios]
        axes.plot(ratios, errors, color=colour, linestyle=line, label=name)
    some = ratios[::4]
    ours = [float(np.abs(tracker_errors(THESIS_SIGMA / ratio, THESIS_SIGMA)).max(initial=0.0)) for ratio in some]
    axes.plot(
        some, ours, color=VERMILION, linestyle="--", marker="s", markersize=4, label="our tracker, widths measured"
    )
    axes.plot(0.8, 0.09, "k*", markersize=11, label="printed: nearly 0.09 at 0.8")
    axes.axhline(CENTROID_ACCURACY, color=SOFT, linewidth=0.8, linestyle="--")
    axes.set_xlabel("distortion d_r = dy / dx")
    axes.set_ylabel("largest error [L]")
    axes.set_title("Fig. 4.13  Maximum error against distortion")
    axes.legend(loc="upper right")
    return figure
