"""Errors of the centroid (Greyling 1995, section 4.3): bias, noise, smear and distortion; conversion to degrees."""

from __future__ import annotations

from functools import partial

import numpy as np

from simulator.theses.figures import section_of
from simulator.theses.greyling1995 import centre
from simulator.theses.greyling1995.blur import OFFSETS, THESIS_FIT_SIGMA, THESIS_SIGMA, airy_bias, stamp_cells
from simulator.theses.greyling1995.centre import LISTING_OFFSETS, LISTING_SEED, LISTING_SIGMA, noise_errors
from simulator.theses.greyling1995.star_images import (
    distortion_errors,
    smear_errors,
    smear_path,
    star_stamps,
    tracker_errors,
)
from simulator.theses.printed import Section
from simulator.theses.tables import Values
from startracker.centroid.bias import moment_bias
from startracker.core import FloatArray

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
"""Detector lengths: conclusion of section 4.3.3."""

MEDIAN_OF_LARGEST = 0.5 ** (1.0 / len(OFFSETS))
"""Quantile of single errors equal to the median of the maximum of eleven."""

RATES_PX_S = (4.0, 8.0, 10.0, 20.0)


def section(seeds: int = 200) -> Section:
    """Section 4.3: rows and Figs. 4.8 to 4.13, Tables 4.1 and 4.2; Figs. 4.10 and 4.11 with the noise of many seeds."""
    values = _bias_values() | _noise_values(seeds) | _smear_and_distortion_values() | _angle_values()
    values |= {
        "noise_panels": partial(_noise_curves, min(seeds, 40)),
        "largest": partial(_largest_errors, seeds),
        "smears": _smear_curves,
        "distortions": _distortion_curves,
    }
    return section_of("greyling1995/centroiding", "Chapter 4.3: centroids", values | _LIMIT)


def _bias_values() -> Values:
    bias = moment_bias(OFFSETS, THESIS_SIGMA, 5, integrated=False)
    fine = np.linspace(0.0, 0.5, 51)
    sampled = "Gaussian of σ = 1.23 sampled at pixel centres, first moment over 5 × 5"
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
        "stamps": _offsets(),
        "fine": fine,
        "gaussians": [
            {"sigma": sigma, "bias": moment_bias(fine, sigma, 5, integrated=False)}
            for sigma in (1.0, THESIS_SIGMA, THESIS_FIT_SIGMA)
        ],
        "some": fine[::5],
        "airy": airy_bias(fine[::5]),
        "printed": (OFFSETS, [float(value) for value in TABLE_4_1]),
        "integrated": moment_bias(fine, THESIS_SIGMA, 5),
    }


def _equal_peak_shifts() -> list[float]:
    """Shift of a star between two equal pixels if one is decreased by 1 or by 3 of 255 levels."""
    still = centre.smeared_frames((np.zeros((1, 2)), np.ones(1)), np.array([0.5]), THESIS_SIGMA)
    frame = np.rint(255.0 * still / still.max())
    lowered = [centre.lower_equal_peaks(frame[0], levels)[None] for levels in (1, 3)]
    moments = [centre.first_moments(frames, *centre.central_pixels(frames))[0] for frames in (frame, *lowered)]
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
    """2.5, 50 and 97.5 % quantiles over the first seeds of the largest error with the correct central pixel."""
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
        "spike": np.abs(centre.smear_errors(smear_path(4.0, 45.0), other_of_equal=True)).max(),
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
        why = "misprint: ten times its value in arcseconds" if name == "TH 7882" else ""
        printed = {"name": name, "size": size, "seconds": seconds, "degrees": degrees, "misprint": why}
        detectors.append(printed | {"accuracy_arcsec": 3600.0 * accuracy_deg, "accuracy_deg": accuracy_deg})
    specified_deg = 0.025
    return {
        "pixel_deg": pixel_deg,
        "specified_mrad": 1e3 * np.radians(specified_deg),
        "specified_px": specified_deg / pixel_deg,
        "detectors": detectors,
    }


def _offsets() -> list[Values]:
    """Images of stars from the centre of a pixel to its edge, with the labels of the outer panels."""
    offsets = np.arange(6) * 0.1
    labels = [{"x_label": "x [L]" if k > 2 else "", "y_label": "" if k % 3 else "y [L]"} for k in range(6)]
    return [
        {"offset": offset, "stamp": stamp, "cells": stamp_cells(stamp, "{:.2f}"), "letter": letter} | label
        for offset, stamp, letter, label in zip(offsets, star_stamps(offsets), "abcdef", labels, strict=True)
    ]


def _noise_curves(seeds: int) -> list[Values]:
    """Noise errors by centre.m, with bias correction."""
    panels = []
    for snr_db, letter in ((40.0, "a"), (20.0, "b")):
        errors, wrong = noise_errors(snr_db, np.arange(1, seeds + 1))
        shown = np.where(wrong, np.nan, errors)
        reach = 1.5 * float(np.nanmax(np.abs(shown)))
        others = [{"errors": row} for row in np.delete(shown, LISTING_SEED - 1, axis=0)]
        own = {"own": shown[LISTING_SEED - 1], "others": others, "offsets": LISTING_OFFSETS, "count": seeds - 1}
        panels.append({"snr_db": snr_db, "letter": letter, "range": (-reach, reach)} | own)
    return panels


def _largest_errors(seeds: int) -> Values:
    """Largest noise error after bias correction, by centre.m and by our tracker, which does not know the offset."""
    snr_db = np.arange(20.0, 41.0, 2.0)
    return {
        "snr_db": snr_db,
        "quantiles": np.array([_largest_quantiles(float(snr), seeds) for snr in snr_db]).T,
        "with_wrong": [float(np.abs(noise_errors(float(snr))[0]).max()) for snr in snr_db],
        "ours": [np.quantile(np.abs(tracker_errors(snr_db=snr)), MEDIAN_OF_LARGEST) for snr in snr_db],
    }


_LIMIT = {"accuracy": CENTROID_ACCURACY, "dots": (0, (1, 2))}


def _smear_curves() -> Values:
    """Largest error along x by direction of the smear: correct pixel, brightest pixel, our tracker."""
    angles, fine = np.arange(0.0, 181.0, 7.5), np.arange(0.0, 181.0, 2.5)
    rates = []
    for rate in RATES_PX_S:
        found = [tracker_errors(path=smear_path(rate, angle), centroider="least_squares") for angle in angles[::2]]
        rates.append(
            {
                "rate": rate,
                "right": [float(np.abs(smear_errors(rate, angle)).max()) for angle in angles],
                "brightest": [_errors_by_maximum(rate, float(angle)) for angle in fine],
                "ours": [float(np.abs(e[:, 0]).max()) if len(e) else np.nan for e in found],
            }
        )
    return {"rates": rates, "angles": angles, "fine": fine, "some": angles[::2]}


def _errors_by_maximum(rate_px_s: float, angle_deg: float) -> float:
    """Largest error over Table 4.1's offsets with the brightest pixel as the central one.

    At half a pixel two pixels are equal for any direction. Their sums over the smear are computed in a different order,
    so that rounding makes one or the other larger: the spikes of Fig. 4.12.
    """
    path = smear_path(rate_px_s, angle_deg)
    frame = centre.smeared_frames(path, OFFSETS[-1:], THESIS_SIGMA)
    wrong = int(centre.central_pixels(frame)[1][0]) != frame.shape[2] // 2
    return float(np.abs(centre.smear_errors(path, other_of_equal=wrong)).max())


def _distortion_curves() -> Values:
    ratios = np.linspace(0.3, 1.0, 29)
    ours = [np.abs(tracker_errors(THESIS_SIGMA / ratio, THESIS_SIGMA)).max(initial=0.0) for ratio in ratios[::4]]
    sampled, integrated = (
        [float(np.abs(distortion_errors(ratio, integrated=whole)).max()) for ratio in ratios] for whole in (False, True)
    )
    curves = {"sampled": sampled, "integrated": integrated, "ours": ours}
    return curves | {"ratios": ratios, "some": ratios[::4]}
