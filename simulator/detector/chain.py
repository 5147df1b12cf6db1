"""The order of the detector's effects, declared once, and the walk along it.

`CHARGE` is what happens in the pixels, in electrons; `READOUT` what happens on the way to the numbers of the frame.
An effect that is off is passed over: it costs nothing, changes nothing and draws from no stream. Each random effect has
a stream of its own, by name, so that switching one changes no other's draws.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.detector import blooming, cosmic_rays, exposure, intensifier, readout, transfer, video
from simulator.detector.fixed_pattern import FixedPattern
from simulator.scenario.schema import DetectorSection
from startracker.errors import InputError

Array = NDArray[Any]
Streams = Callable[[str], np.random.Generator]


@dataclass(frozen=True)
class Effect:
    """One effect: its name, whether a detector has it, and what it makes of the signal, in place or anew."""

    name: str
    on: Callable[[DetectorSection, FixedPattern], bool]
    apply: Callable[[Array, DetectorSection, FixedPattern, Streams], Array]


# s: signal (H, W); d: detector section; p: fixed pattern; rng: random stream by name
CHARGE: tuple[Effect, ...] = (
    Effect(
        "intensifier",  # mean photo-electrons of a photocathode → mean electrons of the detector
        lambda d, p: d.intensifier.gain > 0,
        lambda s, d, p, rng: intensifier.intensify(s, d, rng("intensifier")),
    ),
    Effect(
        "photo_response",  # mean photo-electrons → the same, by the response of each pixel
        lambda d, p: np.ndim(p.prnu) > 0 or p.prnu != 1.0,
        lambda s, d, p, rng: exposure.photo_response(s, p.prnu),
    ),
    Effect(
        "dark_signal",  # + mean dark electrons: temperature, DSNU, hot pixels
        lambda d, p: np.ndim(p.dark_e) > 0 or bool(p.dark_e > 0),
        lambda s, d, p, rng: exposure.dark_signal(s, p.dark_e),
    ),
    Effect(
        "shot_noise",  # mean → counted electrons
        lambda d, p: d.shot_noise,
        lambda s, d, p, rng: exposure.shot_noise(s, rng("shot_noise")),
    ),
    Effect(
        "cosmic_rays",  # + charge along the tracks of particles
        lambda d, p: d.cosmic_rays.rate_cm2_s > 0,
        lambda s, d, p, rng: cosmic_rays.add_cosmic_rays(s, d, rng("cosmic_rays")),
    ),
    Effect(
        "full_well",  # the rest drains or blooms
        lambda d, p: True,
        lambda s, d, p, rng: blooming.full_well(s, d.full_well_e, d.antiblooming),
    ),
)
READOUT: tuple[Effect, ...] = (
    Effect(
        "charge_transfer",  # trails of what the transfers leave behind
        lambda d, p: d.cti_parallel > 0 or d.cti_serial > 0,
        lambda s, d, p, rng: transfer.transfer(s, d.cti_parallel, d.cti_serial, d.readout_corner),
    ),
    Effect(
        "reset_noise",
        lambda d, p: d.reset_capacitance_ff > 0,
        lambda s, d, p, rng: readout.gaussian_noise(s, readout.section_reset_noise_e(d), rng("reset_noise")),
    ),
    Effect(
        "read_noise",
        lambda d, p: d.read_noise_e > 0,
        lambda s, d, p, rng: readout.gaussian_noise(s, d.read_noise_e, rng("read_noise")),
    ),
    Effect(
        "nonlinearity",
        lambda d, p: any(d.nonlinearity),
        lambda s, d, p, rng: readout.bend(s, d.full_well_e, d.nonlinearity),
    ),
    Effect(
        "gain_offset",  # electrons → DN
        lambda d, p: True,
        lambda s, d, p, rng: readout.amplify(s, readout.gain_e_per_dn(d), d.offset_dn),
    ),
    Effect(
        "video",  # analogue line and recorder: bandwidth, noise
        lambda d, p: d.video.noise_dn > 0 or d.video.line_blur_px > 0,
        lambda s, d, p, rng: video.video_signal(s, d.video, rng("video")),
    ),
    Effect(
        "adc",  # fractional DN → whole DN
        lambda d, p: d.adc_bits is not None,
        lambda s, d, p, rng: readout.convert(s, 2 ** (d.adc_bits or 0) - 1),
    ),
)


@dataclass(frozen=True, eq=False)
class Readout:
    """A frame as it leaves the detector.

    Parameters
    ----------
    image : (H, W) uint16, or float64 without a converter
        Digital numbers.
    electrons : (H, W) float64
        Charge in the pixels at the end of the exposure, before the noise of the readout.
    saturated : (H, W) bool
        Pixels at the full well or at the top of the converter: truth, which a tracker has to find by `saturation_dn`.
    saturation_dn : float
        DN from which on a pixel counts as saturated.
    gain_e_per_dn : float
        Electrons a DN, as a photon-transfer curve gives them: signal over variance. Behind an intensifier these are
        photo-electrons of the photocathode, over the excess noise factor.
    """

    image: NDArray[np.uint16] | NDArray[np.float64]
    electrons: NDArray[np.float64]
    saturated: NDArray[np.bool_]
    saturation_dn: float
    gain_e_per_dn: float


def detect(
    mean_photo_e: NDArray[np.float64], section: DetectorSection, pattern: FixedPattern, streams: Streams
) -> Readout:
    """Expose and read out the detector.

    Parameters
    ----------
    mean_photo_e : (H, W) float64
        Mean photo-electrons of each pixel over the exposure, stars and background, quantum efficiency included.
        Left as it is.
    section : DetectorSection
        The detector.
    pattern : FixedPattern
        From `build_fixed_pattern` with the same section.
    streams : callable
        Gives the generator of a stream by name: ``intensifier``, ``shot_noise``, ``cosmic_rays``, ``reset_noise``,
        ``read_noise``, ``video``. Asked only for those that are on.

    Raises
    ------
    InputError
        When the image or the pattern has another size than the detector, a mean is negative or not finite, or the
        offset leaves nothing of the converter.
    """
    shape = (section.height, section.width)
    named = {"mean_photo_e": mean_photo_e, "pattern.prnu": pattern.prnu, "pattern.dark_e": pattern.dark_e}
    for name, array in named.items():
        if np.shape(array) != shape and (array is mean_photo_e or np.ndim(array) > 0):
            raise InputError(f"{name} has the shape {np.shape(array)}; this detector has {shape} (rows, columns)")
    if not (np.min(mean_photo_e) >= 0.0 and np.max(mean_photo_e) < np.inf):
        raise InputError("mean_photo_e has a pixel that is negative or not finite; electrons are counted from zero up")

    electrons = np.array(mean_photo_e, dtype=np.float64, order="C")
    for effect in CHARGE:
        if effect.on(section, pattern):
            electrons = effect.apply(electrons, section, pattern, streams)
    image: Array = electrons.copy()
    for effect in READOUT:
        if effect.on(section, pattern):
            image = effect.apply(image, section, pattern, streams)

    saturated = electrons >= section.full_well_e
    top = readout.highest_dn(section)
    if top is not None:
        saturated |= image >= top
    return Readout(image, electrons, saturated, readout.saturation_dn(section), readout.noise_gain_e_per_dn(section))
