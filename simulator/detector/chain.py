"""Definition of the order of the detector's effects, and the detector that applies them.

`CHARGE` lists the effects in the pixels, in electrons, and `READOUT` those between charge and digital numbers. An
effect that is off is skipped and uses no random numbers. Each random effect has its own named stream, so that switching
one effect on or off does not change the noise of the others. Consecutive effects on single pixels are run together
(`pixels.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulator.detector import blooming, cosmic_rays, intensifier, readout, steps, transfer, video
from simulator.detector.fixed_pattern import FixedPattern
from simulator.detector.parameters import CosmicRays, DetectorParameters
from simulator.detector.pixels import PixelPipeline
from simulator.detector.steps import Step, of_map
from simulator.randomness import Streams
from startracker.core import FloatArray
from startracker.errors import InputError


class Moment(NamedTuple):
    """Time of an exposure, and the particles that cross the detector in it."""

    exposure_s: float
    """Exposure time."""
    t_s: float = 0.0
    """Mid-exposure, seconds after the epoch; only random telegraph pixels depend on it."""
    particles: tuple[CosmicRays, ...] | None = None
    """Kinds of particles at the position of the frame; None for the detector's own parameters."""


FrameEffect = Callable[[FloatArray, Moment, Streams], FloatArray]


@dataclass(frozen=True)
class Effect:
    """One effect of the detector."""

    name: str
    on: Callable[[DetectorParameters, FixedPattern], bool]
    """Whether a detector has the effect."""
    act: Callable[[DetectorParameters, FixedPattern], Step | FrameEffect]
    """The operation: a step on single pixels, or a function of a whole frame."""


def _telegraph(pattern: FixedPattern) -> FrameEffect:
    pixels = pattern.telegraph
    assert pixels is not None
    return lambda s, t, rng: pixels.add_to(s, t.exposure_s, t.t_s)


# Arguments of the functions below: d, detector; p, fixed pattern; t, moment with the exposure time; rng, random stream
# by name; s, signal (H, W), which an effect modifies in place or replaces.
CHARGE: tuple[Effect, ...] = (
    Effect(
        "intensifier",  # mean photo-electrons of a photocathode → mean electrons of the detector
        lambda d, p: d.intensifier.gain > 0,
        lambda d, p: lambda s, t, rng: intensifier.intensify(s, d, t.exposure_s, rng("intensifier")),
    ),
    Effect(
        "photo_response",  # mean photo-electrons × response of each pixel
        lambda d, p: np.ndim(p.prnu) > 0 or p.prnu != 1.0,
        lambda d, p: of_map(steps.PHOTO_RESPONSE, p.prnu),
    ),
    Effect(
        "dark_signal",  # + mean dark electrons, exposure × dark current: temperature, DSNU, hot pixels
        lambda d, p: np.ndim(p.dark_e_s) > 0 or bool(p.dark_e_s > 0),
        lambda d, p: of_map(steps.DARK_CURRENT, p.dark_e_s),
    ),
    Effect(
        "random_telegraph",  # + mean dark electrons of the random telegraph pixels in their upper level
        lambda d, p: p.telegraph is not None,
        lambda d, p: _telegraph(p),
    ),
    Effect(
        "shot_noise",  # mean → Poisson-distributed electrons
        lambda d, p: d.shot_noise,
        lambda d, p: Step(steps.SHOT_NOISE, rng="shot_noise"),
    ),
    Effect(
        "cosmic_rays",  # + charge along the tracks of cosmic rays
        lambda d, p: d.cosmic_rays.rate_cm2_s > 0,
        lambda d, p: lambda s, t, rng: cosmic_rays.add_cosmic_rays(s, d, t.exposure_s, rng("cosmic_rays"), t.particles),
    ),
    Effect(
        "full_well",  # the excess drains or blooms
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
        "charge_transfer",  # trails of charge left behind by transfers
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
        "video",  # analogue link or recorder: bandwidth, noise
        lambda d, p: d.video.noise_dn > 0 or d.video.line_blur_px > 0,
        lambda d, p: lambda s, t, rng: video.video_signal(s, d.video, rng("video")),
    ),
    Effect(
        "adc",  # fractional DN → integer DN
        lambda d, p: d.adc_bits is not None,
        lambda d, p: Step(steps.CONVERT, (2.0 ** (d.adc_bits or 0) - 1.0,)),
    ),
)


@dataclass(frozen=True, eq=False)
class Readout:
    """Output of the detector for one frame."""

    image: NDArray[np.uint16] | NDArray[np.float64]
    """(H, W): Digital numbers."""
    electrons: FloatArray | None
    """(H, W): Charge in the pixels at the end of the exposure, before readout noise; None unless requested."""
    saturated: NDArray[np.bool_] | None
    """(H, W): Pixels at the full well or at the largest digital number. This is truth; a tracker uses `saturation_dn`.
    None unless the charge was requested."""
    saturation_dn: float
    """DN at and above which a pixel is saturated."""
    gain_e_per_dn: float
    """Electrons per DN, as measured by a photon-transfer curve: signal over variance. With an intensifier they are
    photo-electrons of the photocathode divided by the excess noise factor."""


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
        Mean photo-electrons of each pixel over the exposure, stars and background, including the quantum efficiency.
        Not modified.
    detector : DetectorParameters
        The detector.
    pattern : FixedPattern
        From `build_fixed_pattern` of the same detector.
    streams : callable
        Returns the generator of a stream by name: ``intensifier``, ``shot_noise``, ``cosmic_rays``, ``reset_noise``,
        ``read_noise``, ``video``. It is called only for effects that are on.
    exposure_s : float
        Exposure time, for dark current, cosmic rays and dark emission of a photocathode.
    keep_charge : bool
        Also return the charge before readout. The image is the same, but takes longer to compute.

    Raises
    ------
    InputError
        If the size of the image or the pattern differs from that of the detector, a mean is negative or not finite, or
        the offset exceeds the range of the converter.
    """
    return Detector(detector, pattern).expose(mean_photo_e, exposure_s, streams, keep_charge=keep_charge)


class Detector:
    """A detector with prepared effects for any number of frames and exposures; see `detect`."""

    def __init__(self, detector: DetectorParameters, pattern: FixedPattern) -> None:
        self.parameters, self.pattern = detector, pattern
        self._shape = (detector.height, detector.width)
        for name, map_ in (("prnu", pattern.prnu), ("dark_e_s", pattern.dark_e_s)):
            if np.ndim(map_) > 0:
                self._check(f"pattern.{name}", np.shape(map_))
        # If the charge is not requested, all effects form one sequence, in which the last steps on charge and the first
        # ones of the readout share a pass over the image.
        charge: list[Step | FrameEffect] = [Step(steps.LIGHT), *_acts(CHARGE, detector, pattern)]
        read = _acts(READOUT, detector, pattern)
        self._charge, self._read, self._both = _stages(charge), _stages(read), _stages(charge + read)
        self._top, self._full_well_e = readout.highest_dn(detector), detector.full_well_e
        self._saturation_dn, self._gain_e_per_dn = (
            readout.saturation_dn(detector),
            readout.noise_gain_e_per_dn(detector),
        )

    def expose(
        self, mean_photo_e: FloatArray, exposure: float | Moment, streams: Streams, *, keep_charge: bool = True
    ) -> Readout:
        """One frame; parameters as in `detect`, with an exposure time or a `Moment`."""
        moment = exposure if isinstance(exposure, Moment) else Moment(exposure)
        self._check("mean_photo_e", np.shape(mean_photo_e))
        light = np.ascontiguousarray(mean_photo_e, dtype=np.float64)
        image: NDArray[Any] = np.empty(self._shape, dtype=np.float64 if self._top is None else np.uint16)
        electrons = saturated = None
        if keep_charge:
            electrons = np.empty(self._shape)
            _run(light, self._charge, electrons, moment, streams)
            _run(electrons, self._read, image, moment, streams)
            saturated = electrons >= self._full_well_e
            if self._top is not None:
                saturated |= image >= self._top
        else:
            _run(light, self._both, image, moment, streams)
        return Readout(image, electrons, saturated, self._saturation_dn, self._gain_e_per_dn)

    def _check(self, name: str, shape: tuple[int, ...]) -> None:
        if shape != self._shape:
            raise InputError(f"{name} has the shape {shape}; this detector has {self._shape} (rows, columns)")


def _acts(effects: Sequence[Effect], detector: DetectorParameters, pattern: FixedPattern) -> list[Step | FrameEffect]:
    return [effect.act(detector, pattern) for effect in effects if effect.on(detector, pattern)]


def _stages(acts: Sequence[Step | FrameEffect]) -> list[PixelPipeline | FrameEffect]:
    """Combine consecutive steps into pipelines.

    There is a pipeline, possibly empty, before and after each effect on whole frames: the first one checks the light,
    and the last one writes the output array.
    """
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
    moment: Moment,
    streams: Streams,
) -> None:
    """Apply pipelines and effects on whole frames to an image, which is not modified, and write the result to `out`."""
    for stage in stages[:-1]:
        if isinstance(stage, PixelPipeline):
            into = np.empty_like(signal)
            stage.run(signal, into, streams, moment.exposure_s)
            signal = into
        else:
            signal = stage(signal, moment, streams)
    last = stages[-1]
    assert isinstance(last, PixelPipeline)
    last.run(signal, out, streams, moment.exposure_s)
