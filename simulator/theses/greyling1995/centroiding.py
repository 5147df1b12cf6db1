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
from simulator.theses.greyling1995.star_images import (
    distortion_errors,
    smear_errors,
    smear_path,
    star_stamps,
    tracker_errors,
)
from simulator.theses.printed import Section, new_figure
from simulator.theses.tables import Values, table_rows
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
    values = _bias_values() | _noise_values(seeds) | _smear_and_distortion_values() | _angle_values()
    rows = table_rows("greyling1995/centroiding", values)
    return Section("Chapter 4.3: centroids", rows, figures)


def _bias_values() -> Values:
    bias = moment_bias(OFFSETS, THESIS_SIGMA, 5, integrated=False)
    sampled = "Gaussian of σ = 1.23 sampled at the pixels' centres, first moment over 5 × 5"
    return {
        "bias": [
            {"offset": offset, "listed": listed, "own": own, "how": "" if offset else sampled}
            for offset, listed, own in zip(OFFSETS, TABLE_4_1, bias, strict=True)
        ],
        "half_bias": bias[-1],
        "integrated_bias": moment_bias(OFFSETS, THESIS_SIGMA, 5)[-1],
        "twice_bias": 2.0 * bias[-1],
        "step": 1.0 - 2.0 * bias[-1],
        "shifts": _equal_peak_shifts(),
    }


def _equal_peak_shifts() -> list[float]:
    """How far a star between two pixels of equal height moves when one is lowered by 1 or by 3 of 255 levels."""
    still = smeared_frames((np.zeros((1, 2)), np.ones(1)), np.array([0.5]), THESIS_SIGMA)
    frame = np.rint(255.0 * still / still.max())
    lowered = [lower_equal_peaks(frame[0], levels)[None] for levels in (1, 3)]
    moments = [first_moments(frames, *central_pixels(frames))[0] for frames in (frame, *lowered)]
    return [abs(float(moment - moments[0])) for moment in moments[1:]]


def _noise_values(seeds: int) -> Values:
    rows = []
    for snr_db, printed in ((40.0, "0.0063"), (20.0, "0.088")):
        errors, wrong = noise_errors(snr_db)
        rows.append(
            {
                "snr_db": snr_db,
                "largest": printed,
                "own": np.abs(errors[~wrong]).max(),
                "script": "centre.m" if snr_db == 40.0 else "centre.m with ten times its factor",
                "factor": 10.0 ** (1.0 - snr_db / 20.0),
                "wrong": np.count_nonzero(wrong),
                "offsets": wrong.size,
                "quantiles": _largest_quantiles(snr_db, seeds),
            }
        )
    return {"noise": rows, "seed": LISTING_SEED, "seeds": seeds, "sigma": LISTING_SIGMA}


def _largest_quantiles(snr_db: float, seeds: int) -> FloatArray:
    """2.5, 50 and 97.5 % over the first seeds of the largest error with the right central pixel."""
    errors, wrong = noise_errors(snr_db, np.arange(1, seeds + 1))
    return np.asarray(np.quantile(np.where(wrong, 0.0, np.abs(errors)).max(axis=1), [0.025, 0.5, 0.975]))


def _smear_and_distortion_values() -> Values:
    noisy, wrong = noise_errors(20.0, np.arange(1, 201))
    noise = np.where(wrong, 0.0, np.abs(noisy)).max(axis=1)
    return {
        "tilted": distortion_errors(0.8)[-1],
        "listing": _listing_distortion(0.8),
        "own_bias": float(moment_bias(0.5, THESIS_SIGMA, 5, integrated=False)),
        "noise_largest": noise.max(),
        "noise_small": noise.max() <= CENTROID_ACCURACY,
        "noise_median": np.median(noise),
        "smear": max(float(np.abs(smear_errors(4.0, angle)).max()) for angle in np.arange(0.0, 181.0, 7.5)),
        "spike": np.abs(smear_errors_of_pixel(smear_path(4.0, 45.0), other_of_equal=True)).max(),
        "half": np.abs(distortion_errors(0.5)).max(),
        "ours": np.abs(tracker_errors(THESIS_SIGMA / 0.5, THESIS_SIGMA)).max(),
    }


def _listing_distortion(ratio: float) -> float:
    """Largest error of `centre.m`'s distorted star: σ² → σ² d_r along both axes."""
    round_star, distorted = (
        moment_bias(LISTING_OFFSETS, LISTING_SIGMA * factor, 5, integrated=False) for factor in (1.0, np.sqrt(ratio))
    )
    return float(np.abs(distorted - round_star).max())


def _angle_values() -> Values:
    pixel_deg = FIELD_DEG / 192
    detectors = []
    for name, (size, seconds, degrees) in TABLE_4_2.items():
        accuracy_deg = CENTROID_ACCURACY * FIELD_DEG / min(size)
        why = "misprint: ten times its own figure in seconds" if name == "TH 7882" else ""
        printed = {"name": name, "size": size, "seconds": seconds, "degrees": degrees, "misprint": why}
        detectors.append(printed | {"accuracy_arcsec": 3600.0 * accuracy_deg, "accuracy_deg": accuracy_deg})
    specified_deg = 0.025
    return {
        "pixel_deg": pixel_deg,
        "specified_mrad": 1e3 * np.radians(specified_deg),
        "specified_px": specified_deg / pixel_deg,
        "detectors": detectors,
    }


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
    axes.set(
        xlabel="offset from the central pixel [L]", ylabel="bias error [L]", title="Fig. 4.9  Algorithm bias error"
    )
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
        axes.set(
            title=f"({letter}) SNR = {snr_db:g} dB", xlabel="offset from the central pixel [L]", ylabel="error [L]"
        )
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
    axes.set(
        yscale="log",
        xlim=(41.0, 19.0),
        xlabel="signal-to-noise ratio [dB]",
        ylim=(4e-3, 3.0),
        ylabel="largest error [L]",
        title="Fig. 4.11  Maximum noise error after bias correction",
    )
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
    left.set(ylabel="largest error along x [L]", yscale="log", ylim=(1e-5, 100.0))
    for axes in (left, middle, right):
        axes.set(xlabel="direction of the smear [°]", xticks=np.arange(0, 181, 45))
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
    axes.set(
        xlabel="distortion d_r = dy / dx",
        ylabel="largest error [L]",
        title="Fig. 4.13  Maximum error against distortion",
    )
    axes.legend(loc="upper right")
    return figure
