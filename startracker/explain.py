"""Text explanations of the stages' results, for `Solution.steps` and ``boresight solve --explain``.

The text is formatted only when it is read (`startracker.trace.Steps`), and maps are sampled on a lattice of about a
thousand pixels, so that the explanation is always available at little cost.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from startracker.catalog.source import CatalogSource
from startracker.centroid.result import Centroids
from startracker.core import ARCSEC_RAD, FloatArray
from startracker.detection.background import Background
from startracker.detection.spots import Spots
from startracker.detection.tiles import sample_plane
from startracker.geometry.camera import Camera
from startracker.inputs import lattice_steps
from startracker.settings import DetectionSettings
from startracker.solution import Solution, Status
from startracker.trace import Step

_FEW_STARS = 6


def _extent(values: NDArray[Any]) -> tuple[float, float, float]:
    """Minimum, median and maximum."""
    ordered = np.sort(values, axis=None)
    last = len(ordered) - 1
    return float(ordered[0]), 0.5 * (float(ordered[last // 2]) + float(ordered[(last + 1) // 2])), float(ordered[last])


def image_step(shape: tuple[int, ...], sample: NDArray[Any], saturated_share: float, saturation_dn: float) -> Step:
    """Size, type, range and saturation of an image of shape (H, W), from a sample of its values."""
    height, width = shape
    text = f"{width}×{height} pixels, {sample.dtype}"
    sample = sample[np.isfinite(sample)]
    if len(sample):
        low, middle, high = _extent(sample)
        text += f", values {low:g} to {high:g} (median {middle:g}, sampled)"
    if math.isfinite(saturation_dn):
        text += f"; {_share(saturated_share)} at saturation ({saturation_dn:g})"
    return Step("image", text)


def background_step(background: Background) -> Step:
    """Minimum, median and maximum of background and noise over the image."""
    steps = lattice_steps(background.shape)
    level = _extent(sample_plane(background.level_plane, *steps))
    noise = _extent(sample_plane(background.noise_plane, *steps))
    return Step("background", f"level {_range(level)} DN, noise per pixel {_range(noise)} DN (min / median / max)")


def detection_steps(spots: Spots, settings: DetectionSettings, background: Background) -> tuple[Step, ...]:
    """Threshold, number of candidates kept and, if the detector counts them, number rejected for each reason."""
    noise = _extent(sample_plane(background.noise_plane, *lattice_steps(background.shape)))[1]
    first = f"threshold {settings.threshold_sigma:g} σ ({settings.threshold_sigma * noise:.3g} DN above the background)"
    rejected: Mapping[str, int] = getattr(spots, "rejected", {})
    found = len(spots) + sum(rejected.values())
    first += f", {found} objects found" if rejected else ""
    steps = [Step("detection", first)]
    if rejected:
        reasons = ", ".join(f"{count} {reason}" for reason, count in rejected.items() if count)
        steps.append(Step("detection", f"rejected: {reasons or 'none'}"))
    marks = [
        f"{int(np.count_nonzero(flag))} {word}"
        for flag, word in ((spots.saturated, "saturated"), (spots.edge, "at the border"))
        if np.any(flag)
    ]
    most = f"; max_stars is {settings.max_stars}" if len(spots) == settings.max_stars else ""
    steps.append(Step("detection", f"kept {len(spots)}" + (f" ({', '.join(marks)})" if marks else "") + most))
    return tuple(steps)


def centroid_step(centroids: Centroids) -> Step:
    """Number of centroids, range of magnitudes, standard errors."""
    if not len(centroids):
        return Step("centroids", "none")
    sigma = np.sqrt(np.trace(centroids.covariance, axis1=1, axis2=2) / 2.0)
    low, middle, high = _extent(sigma)
    return Step(
        "centroids",
        f"{len(centroids)} over {_magnitudes(centroids.flux)}, standard error {low:.2g} / {middle:.2g} / {high:.2g} px"
        " per axis (min / median / max)",
    )


def listed_step(given: int, xy: FloatArray, flux: FloatArray | None) -> Step:
    """Number of given centroids and how many of them are usable."""
    left_out = given - len(xy)
    text = f"{given} given"
    if left_out:
        text += f", {left_out} left out (not finite, outside the image or repeated)"
    text += f", {_magnitudes(flux)}" if flux is not None and len(flux) else ", without flux"
    return Step("centroids", text)


def catalogue_step(source: CatalogSource) -> Step:
    """Files, number of stars, epoch and depth of the catalogue."""
    return Step("identification", str(source))


def identification_steps(
    texts: Sequence[str], reason: str, stars: int, magnitude: float, camera: Camera
) -> tuple[Step, ...]:
    """Input, attempts and result of identification.

    Parameters
    ----------
    texts : sequence of str
        Explanations from the identifier.
    reason : str
        Reason of its result.
    stars, magnitude : int, float
        Number of guide stars and V of the faintest.
    camera : Camera
        For the number of stars expected in the field.
    """
    area = math.radians(camera.fov_deg) * math.radians(camera.fov_y_deg)
    expected = stars * min(area / (4.0 * math.pi), 1.0)
    first = f"{stars} guide stars to V = {magnitude:.1f}, about {expected:.0f} in a field of {camera.fov_text}"
    return tuple(Step("identification", text) for text in (first, *texts, reason))


def search_step(trials: int, bands: tuple[tuple[float, float, float], ...], sides: tuple[int, ...]) -> Step:
    """Range and number of patterns of a search with the focal length free."""
    low, high = min(band[0] for band in bands), max(band[2] for band in bands)
    seen = "direct and mirrored" if len(sides) > 1 else "direct" if sides[0] > 0 else "mirrored"
    return Step(
        "identification", f"field of view searched from {low:.3g}° to {high:.3g}°, {seen}; {trials} patterns tried"
    )


def attitude_steps(solution: Solution) -> tuple[Step, ...]:
    """Stars used and rejected, residuals and standard errors of a solved field."""
    stars, camera = solution.stars.fitted, solution.camera
    if not solution.solved or camera is None:
        return ()
    length = np.hypot(*stars.residual_px.T)
    bodies = solution.bodies.name.tolist()
    left, unused = len(solution.centroids) - len(solution.stars) - len(bodies), len(solution.stars) - len(stars)
    steps = [
        Step(
            "attitude",
            f"{len(stars)} stars used, V {stars.v_mag.min():.1f} to {stars.v_mag.max():.1f}; residual "
            f"{math.sqrt(float(np.mean(length**2))):.3f} px rms ({solution.rmse_arcsec:.1f}″), largest "
            f"{length.max():.3f} px ({stars.catalog_id[int(np.argmax(length))]})",
        )
    ]
    if unused:
        steps.append(Step("attitude", f"{unused} identified stars not used: residual not explained by their error"))
    if bodies:
        steps.append(Step("attitude", f"recognised by ephemeris and not used: {', '.join(bodies)}"))
    if left:
        steps.append(Step("attitude", f"{left} detections not used: no guide star nearby"))
    if solution.covariance is not None:
        x, y, z = np.sqrt(np.diag(solution.covariance)) / ARCSEC_RAD
        steps.append(Step("attitude", f"standard errors {x:.2g}″ and {y:.2g}″ across the boresight, {z:.2g}″ about it"))
    if not solution.aberration_corrected:
        unknown = "aberration (up to 26″) is not corrected, as the observer's velocity was not given"
        steps.append(Step("attitude", f"{unknown}; the standard errors include it"))
    return tuple(steps)


def hints(
    status: Status,
    stars: int,
    *,
    known_camera: bool,
    fov_known: bool = False,
    saturated: int = 0,
    settings: DetectionSettings | None = None,
) -> tuple[Step, ...]:
    """Suggestions for a field that was not solved.

    Parameters
    ----------
    status : Status
    stars : int
        Number of centroids passed to identification.
    known_camera : bool
        Whether the focal length was given exactly.
    fov_known : bool
        Whether the focal length was given approximately.
    saturated : int
        Number of saturated star images among the centroids.
    settings : DetectionSettings, optional
        Settings of the detection, if there was one.
    """
    if status is Status.SOLVED:
        return ()
    texts: list[str] = []
    if status is Status.BAD_IMAGE:
        texts.append("give a two-dimensional image with the size of the camera")
    elif status is Status.SATURATED:
        texts.append("shorten the exposure, or keep Sun, Moon and artificial lights out of the field")
    elif stars < _FEW_STARS:
        if settings is not None:
            texts.append(
                f"few stars: decrease detection.threshold_sigma (now {settings.threshold_sigma:g}), or expose longer"
            )
        else:
            texts.append("few stars: give more centroids")
        if not known_camera:
            texts.append("with a calibrated camera (--camera) three or four stars are sufficient")
    else:
        if known_camera:
            texts.append("check the camera's focal length (--fov is fitted, --camera is taken as exact) and parity")
            texts.append(
                "stars fainter than the guide stars count as false: increase --magnitude-limit for long exposures"
            )
        elif fov_known:
            texts.append("check --fov: it must be accurate to 5 %; without it fields from 3° to 72° are searched")
        else:
            texts.append("unknown field of view: give --fov to narrow the search")
        if settings is not None and stars >= settings.max_stars:
            texts.append("many detections: increase detection.threshold_sigma if they include trees, clouds or noise")
        if status is Status.SEARCH_LIMIT:
            texts.append(
                "search limit reached: increase identification.max_operations, or give fewer, more accurate centroids"
            )
        if saturated > stars // 2:
            texts.append("most stars are saturated, which biases their centroids: shorten the exposure")
    return tuple(Step("hint", text) for text in texts)


def as_text(steps: Iterable[Step]) -> str:
    """Steps as lines of text, with the stage's name before its first line."""
    steps = tuple(steps)
    width = max((len(step.stage) for step in steps), default=0)
    lines, last = [], ""
    for step in steps:
        lines.append(f"  {step.stage if step.stage != last else '':<{width}}  {step.text}")
        last = step.stage
    return "\n".join(lines)


def _magnitudes(flux: FloatArray) -> str:
    good = flux[flux > 0]
    return f"{2.5 * math.log10(good.max() / good.min()):.1f} mag" if len(good) else "no flux"


def _range(values: tuple[float, float, float]) -> str:
    return " / ".join(f"{value:.4g}" for value in values)


def _share(value: float) -> str:
    return "none" if value == 0.0 else f"{100.0 * value:.3g} %"
