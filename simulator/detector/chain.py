"""The order of the detector's effects, declared once, and run in it.

`CHARGE` is what happens in the pixels, in electrons; `READOUT` what happens on the way to the digital numbers of the
frame. An effect that is off is passed over: it costs nothing, changes nothing and draws from no stream. Each random
effect has a stream of its own, by name, so that switching one changes no other's draws. Neighbours in the order that
act on each pixel by itself run together (`pixels.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.detector import blooming, cosmic_rays, intensifier, readout, steps, transfer, video
from simulator.detector.fixed_pattern import FixedPattern
from simulator.detector.parameters import DetectorParameters
from simulator.detector.pixels import PixelPipeline
from simulator.detector.steps import Step, of_map
from simulator.randomness import Streams
from startracker.errors import InputError

FloatArray = NDArray[np.float64]
FrameEffect = Callable[[FloatArray, float, Streams], FloatArray]


@dataclass(frozen=True)
class Effect:
    """One effect: its name, whether a detector has it, and what it does: a step on each pixel, or to a whole frame."""

    name: str
    on: Callable[[DetectorParameters, FixedPattern], bool]
    act: Callable[[DetectorParameters, FixedPattern], Step | FrameEffect]


# d: detector; p: fixed pattern; t: exposure time, s; rng: random stream by name; s: signal (H, W), changed in place or
# anew
CHARGE: tuple[Effect, ...] = (
    Effect(
        "intensifier",  # mean photo-electrons of a photocathode → mean electrons of the detector
        lambda d, p: d.intensifier.gain > 0,
        lambda d, p: lambda s, t, rng: intensifier.intensify(s, d, t, rng("intensifier")),
    ),
    Effect(
        "photo_response",  # mean photo-electrons → the same, by the response of each pixel
        lambda d, p: np.ndim(p.prnu) > 0 or p.prnu != 1.0,
        lambda d, p: of_map(steps.PHOTO_RESPONSE, p.prnu),
    ),
    Effect(
        "dark_signal",  # + mean dark electrons, exposure × dark current: temperature, DSNU, hot pixels
        lambda d, p: np.ndim(p.dark_e_s) > 0 or bool(p.dark_e_s > 0),
        lambda d, p: of_map(steps.DARK_CURRENT, p.dark_e_s),
    ),
    Effect(
        "shot_noise",  # mean → counted electrons
        lambda d, p: d.shot_noise,
        lambda d, p: Step(steps.SHOT_NOISE, rng="shot_noise"),
    ),
    Effect(
        "cosmic_rays",  # + charge along the tracks of particles
        lambda d, p: d.cosmic_rays.rate_cm2_s > 0,
        lambda d, p: lambda s, t, rng: cosmic_rays.add_cosmic_rays(s, d, t, rng("cosmic_rays")),
    ),
    Effect(
        "full_well",  # the rest drains or blooms
        lambda d, p: True,
        lambda d, p: (
            Step(steps.CLIP, (d.full_well_e,))
            if d.antiblooming >= 1.0
            else lambda s, t, rng: blooming.full_well(s, d.full_well_e, d.antiblooming)
        ),
    ),
)
READOUT: tuple[Effect, ...] = (
    Effect(
        "charge_transfer",  # trails of what the transfers leave behind
        lambda d, p: d.cti_parallel > 0 or d.cti_serial > 0,
        lambda d, p: lambda s, t, rng: transfer.transfer(s, d.cti_parallel, d.cti_serial, d.readout_corner),
    ),
    Effect(
        "reset_noise",
        lambda d, p: d.reset_capacitance_ff > 0,
        lambda d, p: Step(steps.GAUSSIAN_NOISE, (readout.detector_reset_noise_e(d),), rng="reset_noise"),
    ),
    Effect(
        "read_noise",
        lambda d, p: d.read_noise_e > 0,
        lambda d, p: Step(steps.GAUSSIAN_NOISE, (d.read_noise_e,), rng="read_noise"),
    ),
    Effect(
        "nonlinearity",
        lambda d, p: any(d.nonlinearity),
        lambda d, p: Step(steps.BEND, (d.full_well_e, *d.nonlinearity)),
    ),
    Effect(
        "gain_offset",  # electrons → DN
        lambda d, p: True,
        lambda d, p: Step(steps.AMPLIFY, (readout.gain_e_per_dn(d), d.offset_dn)),
    ),
    Effect(
        "video",  # analogue line and recorder: bandwidth, noise
        lambda d, p: d.video.noise_dn > 0 or d.video.line_blur_px > 0,
        lambda d, p: lambda s, t, rng: video.video_signal(s, d.video, rng("video")),
    ),
    Effect(
        "adc",  # fractional DN → whole DN
        lambda d, p: d.adc_bits is not None,
        lambda d, p: Step(steps.CONVERT, (2.0 ** (d.adc_bits or 0) - 1.0,)),
    ),
)


@dataclass(frozen=True, eq=False)
class Readout:
    """A frame as it leaves the detector."""

    image: NDArray[np.uint16] | NDArray[np.float64]
    """(H, W): Digital numbers."""
    electrons: FloatArray | None
    """(H, W): Charge in the pixels at the end of the exposure, before the noise of the readout; None where it was not
    kept."""
    saturated: NDArray[np.bool_] | None
    """(H, W): Pixels at the full well or at the top of the converter: truth, which a tracker has to find by
    `saturation_dn`. None where the charge was not kept."""
    saturation_dn: float
    """DN from which on a pixel counts as saturated."""
    gain_e_per_dn: float
    """Electrons a DN, as a photon-transfer curve gives them: signal over variance. Behind an intensifier these are
    photo-electrons of the photocathode, over the excess noise factor."""


def detect(
    mean_photo_e: FloatArray,
    detector: DetectorParameters,
    pattern: FixedPattern,
    streams: Streams,
    *,
    exposure_s: float,
    keep_charge: bool = True,
) -> Readout:
    """Expose and read out the detector.

    Parameters
    ----------
    mean_photo_e : (H, W) float64
        Mean photo-electrons of each pixel over the exposure, stars and background, quantum efficiency included.
        Left as it is.
    detector : DetectorParameters
        The detector.
    pattern : FixedPattern
        From `build_fixed_pattern` of the same detector.
    streams : callable
        Gives the generator of a stream by name: ``intensifier``, ``shot_noise``, ``cosmic_rays``, ``reset_noise``,
        ``read_noise``, ``video``. Asked only for those that are on.
    exposure_s : float
        Exposure time, for what does not come with the light: dark current, cosmic rays, the dark of a photocathode.
    keep_charge : bool
        Also hand out the charge before readout; the image is the same either way, and sooner there without.

    Raises
    ------
    InputError
        When the image or the pattern has another size than the detector, a mean is negative or not finite, or the
        offset leaves nothing of the converter.
    """
    return Detector(detector, pattern).expose(mean_photo_e, exposure_s, streams, keep_charge=keep_charge)


class Detector:
    """A detector with its effects made ready, for any number of frames and exposures: see `detect`."""

    def __init__(self, detector: DetectorParameters, pattern: FixedPattern) -> None:
        self.parameters, self.pattern = detector, pattern
        self._shape = (detector.height, detector.width)
        for name, map_ in (("prnu", pattern.prnu), ("dark_e_s", pattern.dark_e_s)):
            if np.ndim(map_) > 0:
                self._check(f"pattern.{name}", np.shape(map_))
        charge: list[Step | FrameEffect] = [Step(steps.LIGHT), *_acts(CHARGE, detector, pattern)]
        read = _acts(READOUT, detector, pattern)
        self._charge, self._read, self._both = _stages(charge), _stages(read), _stages(charge + read)
        self._top, self._full_well_e = readout.highest_dn(detector), detector.full_well_e
        self._saturation_dn, self._gain_e_per_dn = (
            readout.saturation_dn(detector),
            readout.noise_gain_e_per_dn(detector),
        )

    def expose(
        self, mean_photo_e: FloatArray, exposure_s: float, streams: Streams, *, keep_charge: bool = True
    ) -> Readout:
        """One frame; parameters as in `detect`."""
        self._check("mean_photo_e", np.shape(mean_photo_e))
        light = np.ascontiguousarray(mean_photo_e, dtype=np.float64)
        image: NDArray[Any] = np.empty(self._shape, dtype=np.float64 if self._top is None else np.uint16)
        electrons = saturated = None
        if keep_charge:
            electrons = np.empty(self._shape)
            _run(light, self._charge, electrons, exposure_s, streams)
            _run(electrons, self._read, image, exposure_s, streams)
            saturated = electrons >= self._full_well_e
            if self._top is not None:
                saturated |= image >= self._top
        else:
            _run(light, self._both, image, exposure_s, streams)
        return Readout(image, electrons, saturated, self._saturation_dn, self._gain_e_per_dn)

    def _check(self, name: str, shape: tuple[int, ...]) -> None:
        if shape != self._shape:
            raise InputError(f"{name} has the shape {shape}; this detector has {self._shape} (rows, columns)")


def _acts(effects: Sequence[Effect], detector: DetectorParameters, pattern: FixedPattern) -> list[Step | FrameEffect]:
    return [effect.act(detector, pattern) for effect in effects if effect.on(detector, pattern)]


def _stages(acts: Sequence[Step | FrameEffect]) -> list[PixelPipeline | FrameEffect]:
    """Neighbouring steps as one pipeline; a pipeline, maybe an empty one, before and after each effect on whole
    frames."""
    stages: list[PixelPipeline | FrameEffect] = []
    waiting: list[Step] = []
    for act in acts:
        if isinstance(act, Step):
            waiting.append(act)
        else:
            stages += [PixelPipeline(waiting), act]
            waiting = []
    return [*stages, PixelPipeline(waiting)]


def _run(
    signal: FloatArray,
    stages: Sequence[PixelPipeline | FrameEffect],
    out: NDArray[Any],
    exposure_s: float,
    streams: Streams,
) -> None:
    """Take an image (it stays as it is) through pipelines and effects on whole frames into `out`."""
    for stage in stages[:-1]:
        if isinstance(stage, PixelPipeline):
            into = np.empty_like(signal)
            stage.run(signal, into, streams, exposure_s)
            signal = into
        else:
            signal = stage(signal, exposure_s, streams)
    last = stages[-1]
    assert isinstance(last, PixelPipeline)
    last.run(signal, out, streams, exposure_s)
