"""Fixed pattern of a device, the same in every frame: response and dark current of each pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simulator.detector.defects import dead_defects, displacement_dark, hot_defects
from simulator.detector.parameters import DetectorParameters
from simulator.detector.poisson import LARGEST_MEAN
from simulator.detector.telegraph import TelegraphPixels, telegraph_pixels
from simulator.randomness import stream
from startracker.errors import InputError

Map = NDArray[np.float64] | NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class FixedPattern:
    """Fixed pattern of one device at one temperature."""

    prnu: Map | float
    """Response of each pixel relative to the mean; the scalar 1.0 if photo-response non-uniformity is off."""
    dark_e_s: Map | float
    """Mean dark current of each pixel, electrons per second; a scalar if it is the same for all pixels."""
    dead: NDArray[np.bool_] | None = None
    """(H, W): Dead pixels and columns; None if there are none."""
    hot: NDArray[np.bool_] | None = None
    """(H, W): Hot pixels and columns with any additional dark current; None if there are none."""
    telegraph: TelegraphPixels | None = None
    """Random telegraph pixels; `dark_e_s` is that of their lower level. None if there are none."""

    def single(self) -> FixedPattern:
        """The same pattern in single precision, which is used for frames: it halves the memory traffic, and seven
        digits are more than any measured pattern has."""
        prnu, dark_e_s = (
            map_.astype(np.float32) if isinstance(map_, np.ndarray) else map_ for map_ in (self.prnu, self.dark_e_s)
        )
        return replace(self, prnu=prnu, dark_e_s=dark_e_s)

    def bad_pixels(self, shape: tuple[int, int]) -> NDArray[np.bool_]:
        """Mask (H, W) of all defects, which a calibrated tracker may exclude."""
        bad = np.zeros(shape, dtype=bool)
        for defects in (self.dead, self.hot):
            if defects is not None:
                bad |= defects
        return bad


def build_fixed_pattern(detector: DetectorParameters, seed: int) -> FixedPattern:
    """Generate the fixed pattern of a device.

    Response and dark current of a pixel are products of many small independent factors (area, thickness, coating;
    volume, generation rate, activation energy). They are therefore log-normal with mean 1 and the given relative
    standard deviation, and never negative. Up to a few percent this is practically the Gaussian with which EMVA 1288
    describes PRNU; at tens of percent it has the long upper tail of measured dark-current histograms. The dark pattern
    scales as a whole with temperature, as in Greyling 1995, section 3.4.2.

    Hot pixels: a binomial number of random pixels, each with an exponentially distributed additional dark current. Hot
    columns: a given number of random columns, each with one such current in all its pixels. Displacement damage: a
    Poisson-distributed number of such currents in each pixel. Dead pixels (a binomial number) and dead columns (a given
    number) collect neither light nor dark current and read the offset.

    Parameters
    ----------
    detector : DetectorParameters
        Its size, temperature and the keys of PRNU, dark current, DSNU and hot pixels.
    seed : int
        Seed of the run; the streams ``prnu``, ``dsnu``, ``hot_pixels``, ``hot_columns``, ``displacement``,
        ``telegraph``, ``dead_pixels`` and ``dead_columns`` of the device are independent.

    Raises
    ------
    InputError
        If the dark current is too large, or the number of hot or dead columns exceeds that of the detector.
    """
    shape = (detector.height, detector.width)
    prnu: NDArray[np.float64] | float = 1.0
    if detector.prnu > 0:
        prnu = _unit_mean_lognormal(detector.prnu, shape, stream(seed, "prnu"))

    factor = dark_current_factor(detector.temperature_c, detector.dark_reference_c, detector.dark_doubling_c)
    dark: NDArray[np.float64] | float = detector.dark_current_e_s * factor if detector.dark_current_e_s > 0 else 0.0
    if detector.dsnu > 0 and dark > 0:
        dark = dark * _unit_mean_lognormal(detector.dsnu, shape, stream(seed, "dsnu"))
    hot = hot_defects(detector, factor, seed)
    if hot is not None:
        dark = dark + hot[0]
    damage = displacement_dark(detector, factor, seed)
    if damage is not None:
        dark = dark + damage
    # Checked before the Poisson deviates, whose message could not name these keys.
    _check_countable(float(np.max(dark)), detector)
    dead = dead_defects(detector, seed)
    if dead is not None:
        prnu = np.where(dead, 0.0, prnu)
        # A detector without dark current keeps its scalar 0, with which the effect is skipped.
        dark = np.where(dead, 0.0, dark) if np.any(np.asarray(dark) > 0) else dark
    telegraph = telegraph_pixels(detector, factor, seed)
    if telegraph is not None and dead is not None:
        telegraph = telegraph.without(dead)
    return FixedPattern(prnu, dark, dead, None if hot is None else hot[1], telegraph)


def dark_current_factor(temperature_c: float, reference_c: float, doubling_c: float) -> float:
    """Dark current relative to that at the reference temperature.

    2^((T − T_reference) / T_doubling): the diode law over the operating range of a detector. The doubling temperature
    is 6 to 8 °C for modern silicon, and 10 °C above −15 °C in Greyling 1995, eq. 3.11.

    Returns infinity if the power overflows.
    """
    doublings = (temperature_c - reference_c) / doubling_c
    return math.inf if doublings > 1000.0 else 2.0**doublings


def _unit_mean_lognormal(sigma: float, shape: tuple[int, int], rng: np.random.Generator) -> NDArray[np.float64]:
    # exp(N(m, s²)) has the mean exp(m + s²/2), which m = −s²/2 makes 1, and the relative variance exp(s²) − 1.
    variance = math.log1p(sigma * sigma)
    return np.exp(math.sqrt(variance) * rng.standard_normal(shape) - 0.5 * variance)


def _check_countable(dark_e_s: float, detector: DetectorParameters) -> None:
    if not dark_e_s <= LARGEST_MEAN:
        raise InputError(
            f"the dark current comes to {dark_e_s:.3g} electrons per second and pixel at detector.temperature_c = "
            f"{detector.temperature_c:g}; lower dark_current_e_s, hot_pixel_dark_e_s, dsnu or temperature_c, or "
            "raise dark_doubling_c"
        )
