"""The order of the detector's effects, declared once, and the walk along it.

`CHARGE` is what happens in the pixels, in electrons; `READOUT` what happens on the way to the numbers of the frame.
An effect that is off is passed over: it costs nothing, changes nothing and draws from no stream. Each random effect has
a stream of its own, by name, so that switching one changes no other's draws. Neighbours in the order that act on each
pixel by itself are walked together (`pixels.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.detector import blooming, cosmic_rays, intensifier, readout, steps, transfer, video
from simulator.detector.fixed_pattern import FixedPattern
from simulator.detector.pixels import Row
from simulator.detector.steps import Step, of_map
from simulator.randomness import Streams
from simulator.scenario.schema import DetectorSection
from startracker.errors import InputError

FloatArray = NDArray[np.float64]
FrameEffect = Callable[[FloatArray, Streams], FloatArray]


@dataclass(frozen=True)
class Effect:
    """One effect: its name, whether a detector has it, and what it does: a step on each pixel, or to a whole frame."""

    name: str
    on: Callable[[DetectorSection, FixedPattern], bool]
    act: Callable[[DetectorSection, FixedPattern], Step | FrameEffect]


# d: detector section; p: fixed pattern; rng: random stream by name; s: signal (H, W), changed in place or anew
CHARGE: tuple[Effect, ...] = (
    Effect(
        "intensifier",  # mean photo-electrons of a photocathode → mean electrons of the detector
        lambda d, p: d.intensifier.gain > 0,
        lambda d, p: lambda s, rng: intensifier.intensify(s, d, rng("intensifier")),
    ),
    Effect(
        "photo_response",  # mean photo-electrons → the same, by the response of each pixel
        lambda d, p: np.ndim(p.prnu) > 0 or p.prnu != 1.0,
        lambda d, p: of_map(steps.PHOTO_RESPONSE, p.prnu),
    ),
    Effect(
        "dark_signal",  # + mean dark electrons: temperature, DSNU, hot pixels
        lambda d, p: np.ndim(p.dark_e) > 0 or bool(p.dark_e > 0),
        lambda d, p: of_map(steps.DARK_SIGNAL, p.dark_e),
    ),
    Effect(
        "shot_noise",  # mean → counted electrons
        lambda d, p: d.shot_noise,
        lambda d, p: Step(steps.SHOT_NOISE, rng="shot_noise"),
    ),
    Effect(
        "cosmic_rays",  # + charge along the tracks of particles
        lambda d, p: d.cosmic_rays.rate_cm2_s > 0,
        lambda d, p: lambda s, rng: cosmic_rays.add_cosmic_rays(s, d, rng("cosmic_rays")),
    ),
    Effect(
        "full_well",  # the rest drains or blooms
        lambda d, p: True,
        lambda d, p: (
            Step(steps.CLIP, (d.full_well_e,))
            if d.antiblooming >= 1.0
            else lambda s, rng: blooming.full_well(s, d.full_well_e, d.antiblooming)
        ),
    ),
)
READOUT: tuple[Effect, ...] = (
    Effect(
        "charge_transfer",  # trails of what the transfers leave behind
        lambda d, p: d.cti_parallel > 0 or d.cti_serial > 0,
        lambda d, p: lambda s, rng: transfer.transfer(s, d.cti_parallel, d.cti_serial, d.readout_corner),
    ),
    Effect(
        "reset_noise",
        lambda d, p: d.reset_capacitance_ff > 0,
        lambda d, p: Step(steps.NORMAL_NOISE, (readout.section_reset_noise_e(d),), rng="reset_noise"),
    ),
    Effect(
        "read_noise",
        lambda d, p: d.read_noise_e > 0,
        lambda d, p: Step(steps.NORMAL_NOISE, (d.read_noise_e,), rng="read_noise"),
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
        lambda d, p: lambda s, rng: video.video_signal(s, d.video, rng("video")),
    ),
    Effect(
        "adc",  # fractional DN → whole DN
        lambda d, p: d.adc_bits is not None,
        lambda d, p: Step(steps.CONVERT, (2.0 ** (d.adc_bits or 0) - 1.0,)),
    ),
)


@dataclass(frozen=True, eq=False)
class Readout:
    """A frame as it leaves the detector.

    Parameters
    ----------
    image : (H, W) uint16, or float64 without a converter
        Digital numbers.
    electrons : (H, W) float64, optional
        Charge in the pixels at the end of the exposure, before the noise of the readout; None where it was not kept.
    saturated : (H, W) bool, optional
        Pixels at the full well or at the top of the converter: truth, which a tracker has to find by `saturation_dn`.
        None where the charge was not kept.
    saturation_dn : float
        DN from which on a pixel counts as saturated.
    gain_e_per_dn : float
        Electrons a DN, as a photon-transfer curve gives them: signal over variance. Behind an intensifier these are
        photo-electrons of the photocathode, over the excess noise factor.
    """

    image: NDArray[np.uint16] | NDArray[np.float64]
    electrons: FloatArray | None
    saturated: NDArray[np.bool_] | None
    saturation_dn: float
    gain_e_per_dn: float


def detect(
    mean_photo_e: FloatArray,
    section: DetectorSection,
    pattern: FixedPattern,
    streams: Streams,
    *,
    keep_charge: bool = True,
    level_e: float | None = None,
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
    keep_charge : bool
        Also hand out the charge before readout; without a level the image is the same either way, and sooner there
        without the charge.
    level_e : float, optional
        Mean photo-electrons that most pixels share, an even background: without maps and charge their numbers are drawn
        at once from the distribution of what leaves the converter (`level.py`).

    Raises
    ------
    InputError
        When the image or the pattern has another size than the detector, a mean is negative or not finite, or the
        offset leaves nothing of the converter.
    """
    made = Detector(section, pattern)
    return made.expose(mean_photo_e, streams, keep_charge=keep_charge, level_e=level_e)


class Detector:
    """A detector with its effects made ready, for any number of frames: see `detect`."""

    def __init__(self, section: DetectorSection, pattern: FixedPattern) -> None:
        self._shape = (section.height, section.width)
        for name, map_ in (("prnu", pattern.prnu), ("dark_e", pattern.dark_e)):
            if np.ndim(map_) > 0:
                self._check(f"pattern.{name}", np.shape(map_))
        charge: list[Step | FrameEffect] = [Step(steps.LIGHT), *_acts(CHARGE, section, pattern)]
        read = _acts(READOUT, section, pattern)
        self._charge, self._read, self._both = _rows(charge), _rows(read), _rows(charge + read)
        self._top, self._full_well_e = readout.highest_dn(section), section.full_well_e
        self._saturation_dn, self._gain_e_per_dn = readout.saturation_dn(section), readout.noise_gain_e_per_dn(section)

    def expose(
        self, mean_photo_e: FloatArray, streams: Streams, *, keep_charge: bool = True, level_e: float | None = None
    ) -> Readout:
        """One frame; parameters as in `detect`."""
        self._check("mean_photo_e", np.shape(mean_photo_e))
        light = np.ascontiguousarray(mean_photo_e, dtype=np.float64)
        image: NDArray[Any] = np.empty(self._shape, dtype=np.float64 if self._top is None else np.uint16)
        electrons = saturated = None
        if keep_charge:
            electrons = np.empty(self._shape)
            _run(light, self._charge, electrons, streams)
            _run(electrons, self._read, image, streams)
            saturated = electrons >= self._full_well_e
            if self._top is not None:
                saturated |= image >= self._top
        else:
            _run(light, self._both, image, streams, level_e)
        return Readout(image, electrons, saturated, self._saturation_dn, self._gain_e_per_dn)

    def _check(self, name: str, shape: tuple[int, ...]) -> None:
        if shape != self._shape:
            raise InputError(f"{name} has the shape {shape}; this detector has {self._shape} (rows, columns)")


def _acts(effects: Sequence[Effect], section: DetectorSection, pattern: FixedPattern) -> list[Step | FrameEffect]:
    return [effect.act(section, pattern) for effect in effects if effect.on(section, pattern)]


def _rows(acts: Sequence[Step | FrameEffect]) -> list[Row | FrameEffect]:
    """Neighbouring steps in one row; a row, maybe an empty one, before and after each effect on whole frames."""
    rows: list[Row | FrameEffect] = []
    waiting: list[Step] = []
    for act in acts:
        if isinstance(act, Step):
            waiting.append(act)
        else:
            rows += [Row(waiting), act]
            waiting = []
    return [*rows, Row(waiting)]


def _run(
    signal: FloatArray,
    rows: Sequence[Row | FrameEffect],
    out: NDArray[Any],
    streams: Streams,
    level: float | None = None,
) -> None:
    """Take an image (it stays as it is) and its level through rows and effects on whole frames into `out`."""
    for row in rows[:-1]:
        if isinstance(row, Row):
            room = np.empty_like(signal)
            row.walk(signal, room, None, streams)
            signal = room
        else:
            signal, level = row(signal, streams), None
    last = rows[-1]
    assert isinstance(last, Row)
    last.walk(signal, out, level, streams)
