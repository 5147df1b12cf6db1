"""The stages' results in words: what `Solution.steps` and ``boresight solve --explain`` tell.

Each function takes what its stage gave; the words are made when someone reads them (`startracker.trace.Steps`), maps
looked at on a lattice of about a thousand pixels: the explanation is always there and hardly paid for.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from startracker.camera import Camera
from startracker.centroid.result import Centroids
from startracker.constants import ARCSEC_RAD
from startracker.detection.background import Background
from startracker.detection.plane import sample_plane
from startracker.detection.spots import Spots
from startracker.settings import DetectionSettings
from startracker.solution import Solution, Status
from startracker.trace import Step

__all__ = [
    "as_text",
    "attitude_steps",
    "background_step",
    "centroid_step",
    "detection_steps",
    "hints",
    "identification_steps",
    "image_sample",
    "image_step",
    "listed_step",
    "search_step",
]

FloatArray = NDArray[np.float64]

_LATTICE = 32
_FEW_STARS = 6


def _steps(shape: tuple[int, ...]) -> tuple[int, int]:
    """Steps of a lattice of about 32 × 32 places."""
    return max(1, shape[0] // _LATTICE), max(1, shape[1] // _LATTICE)


def _extent(values: NDArray[Any]) -> tuple[float, float, float]:
    """Least, median, largest."""
    ordered = np.sort(values, axis=None)
    last = len(ordered) - 1
    return float(ordered[0]), 0.5 * (float(ordered[last // 2]) + float(ordered[(last + 1) // 2])), float(ordered[last])


def image_sample(image: NDArray[Any]) -> NDArray[Any]:
    """Values on a lattice: what `image_step` needs of an image that may have changed by the time it is told of."""
    rows, columns = _steps(image.shape)
    return image[rows // 2 :: rows, columns // 2 :: columns].flatten()


def image_step(shape: tuple[int, ...], sample: NDArray[Any], saturated_share: float, saturation_dn: float) -> Step:
    """Size, type, range and saturation of an image of the shape (H, W) with such a sample."""
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
    """Background and noise over the image: least, median, largest."""
    steps = _steps(background.shape)
    level = _extent(sample_plane(background.level_plane, *steps))
    noise = _extent(sample_plane(background.noise_plane, *steps))
    return Step("background", f"level {_range(level)} DN, noise of a pixel {_range(noise)} DN (min / median / max)")


def detection_steps(spots: Spots, settings: DetectionSettings, background: Background) -> tuple[Step, ...]:
    """Threshold, candidates kept, and those rejected by reason, where the detector counts them."""
    noise = _extent(sample_plane(background.noise_plane, *_steps(background.shape)))[1]
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
    """Number of centroids, span of magnitudes, standard errors."""
    if not len(centroids):
        return Step("centroids", "none")
    sigma = np.sqrt(np.trace(centroids.covariance, axis1=1, axis2=2) / 2.0)
    low, middle, high = _extent(sigma)
    return Step(
        "centroids",
        f"{len(centroids)} over {_magnitudes(centroids.flux)}, standard error {low:.2g} / {middle:.2g} / {high:.2g} px"
        " on one axis (min / median / max)",
    )


def listed_step(given: int, xy: FloatArray, flux: FloatArray | None) -> Step:
    """Centroids that came as a list: how many are fit for use."""
    left_out = given - len(xy)
    text = f"{given} given"
    if left_out:
        text += f", {left_out} left out (not finite, outside the image or repeated)"
    text += f", {_magnitudes(flux)}" if flux is not None and len(flux) else ", without flux"
    return Step("centroids", text)


def identification_steps(
    texts: Sequence[str], reason: str, stars: int, magnitude: float, camera: Camera
) -> tuple[Step, ...]:
    """What identification had before it, tried, and concluded.

    Parameters
    ----------
    texts : sequence of str
        The identifier's own account.
    reason : str
        Its verdict.
    stars, magnitude : int, float
        Guide stars and the faintest one's V.
    camera : Camera
        For the stars to be expected in the field.
    """
    area = math.radians(camera.fov_deg) * math.radians(camera.fov_y_deg)
    expected = stars * min(area / (4.0 * math.pi), 1.0)
    first = f"{stars} guide stars to V = {magnitude:.1f}, about {expected:.0f} in a field of {camera.fov_deg:.2f}°"
    return tuple(Step("identification", text) for text in (first, *texts, reason))


def search_step(trials: int, bands: tuple[tuple[float, float, float], ...], sides: tuple[int, ...]) -> Step:
    """What a search with the focal length free went through."""
    low, high = min(band[0] for band in bands), max(band[2] for band in bands)
    seen = "as seen and mirrored" if len(sides) > 1 else "as seen" if sides[0] > 0 else "mirrored"
    return Step(
        "identification", f"field of view sought from {low:.3g}° to {high:.3g}°, {seen}; {trials} patterns tried"
    )


def attitude_steps(solution: Solution) -> tuple[Step, ...]:
    """Stars used, those left out, residuals and standard errors of a solved field."""
    stars, camera = solution.stars.fitted, solution.camera
    if not solution.solved or camera is None:
        return ()
    length = np.hypot(*stars.residual_px.T)
    left, named = len(solution.centroids) - len(solution.stars), len(solution.stars) - len(stars)
    steps = [
        Step(
            "attitude",
            f"{len(stars)} stars used, V {stars.v_mag.min():.1f} to {stars.v_mag.max():.1f}; residual "
            f"{math.sqrt(float(np.mean(length**2))):.3f} px rms ({solution.rmse_arcsec:.1f}″), largest "
            f"{length.max():.3f} px ({stars.catalog_id[int(np.argmax(length))]})",
        )
    ]
    if named:
        steps.append(Step("attitude", f"{named} stars named and not used: off by more than their errors explain"))
    if left:
        steps.append(Step("attitude", f"{left} detections not used: no guide star near enough"))
    if solution.covariance is not None:
        x, y, z = np.sqrt(np.diag(solution.covariance)) / ARCSEC_RAD
        steps.append(Step("attitude", f"standard errors {x:.2g}″ and {y:.2g}″ across the boresight, {z:.2g}″ about it"))
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
    """What to do next about a field that was not solved.

    Parameters
    ----------
    status : Status
    stars : int
        Centroids that identification had.
    known_camera : bool
        Whether the focal length was given as exact.
    fov_known : bool
        Whether it was given roughly.
    saturated : int
        Saturated star images among them.
    settings : DetectionSettings, optional
        Of the detection, where there was one.
    """
    if status is Status.SOLVED:
        return ()
    says: list[str] = []
    if status is Status.BAD_IMAGE:
        says.append("give a two-dimensional image of the size that the camera has")
    elif status is Status.SATURATED:
        says.append("expose for less time, or keep Sun, Moon and lamps out of the field")
    elif stars < _FEW_STARS:
        if settings is not None:
            says.append(
                f"few stars: lower detection.threshold_sigma (now {settings.threshold_sigma:g}), or expose longer"
            )
        else:
            says.append("few stars: give more centroids")
        if not known_camera:
            says.append("with the camera known (--camera) three or four stars can do")
    else:
        if known_camera:
            says.append("check the camera: its focal length (--fov is fitted, --camera taken as exact) and parity")
            says.append("stars fainter than the guide stars count as false: raise --magnitude-limit for long exposures")
        elif fov_known:
            says.append("check --fov: it must be right to 5 %; without it every field from 3° to 72° is tried")
        else:
            says.append("field not known: give --fov, which narrows the search")
        if settings is not None and stars >= settings.max_stars:
            says.append("many detections: raise detection.threshold_sigma, if trees, clouds or noise are among them")
        if status is Status.SEARCH_LIMIT:
            says.append("the search was ended: raise identification.max_operations, or give fewer, better centroids")
        if saturated > stars // 2:
            says.append("most stars are saturated, which spoils their places: expose for less time")
    return tuple(Step("hint", text) for text in says)


def as_text(steps: Iterable[Step]) -> str:
    """Steps as lines, the stage's name before its first one."""
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
