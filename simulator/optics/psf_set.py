"""The images of all stars of a camera: one PSF, or one for each colour of star and zone of the field."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.optics import diffraction
from simulator.optics.psf import Lens, Psf, aberrated, build_psf
from simulator.scenario.schema import FieldAberrationsSection, PsfSection
from startracker.errors import InputError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
WeightsOf = Callable[[FloatArray, FloatArray], FloatArray]

COLOURS = (-0.2, 0.2, 0.6, 1.0, 1.4, 1.9)
"""B−V of the stars that polychromatic images are made for; others take the nearest."""

FEW_COLOURS = (0.0, 0.7, 1.5)
"""The same where the images vary over the field too."""

DEFAULT_B_V = 0.6
"""Colour of a star whose B−V is not known, as in `simulator.sky.spectra`."""

BINS, FEW_BINS = 7, 5
"""Wavelengths of a polychromatic image; fewer where it varies over the field."""

_FINE_NM = np.arange(200.0, 2600.0, 10.0)
_TAIL = 0.01


class PsfSet:
    """The PSFs of a camera, made when a star first asks for one.

    Zones of the field are rings about the centre of the image, cut by azimuth; a star takes the image computed for the
    middle of its zone, and for the nearest of `COLOURS`.

    Parameters
    ----------
    section : PsfSection
        Model, aberrations, colours.
    lens : Lens
        Lens and detector.
    size_px : (int, int)
        Columns and rows of the detector.
    weights_of : callable, optional
        ``weights_of(b_v (N,), edges_nm (K + 1,)) -> (N, K)`` electrons (or their share) that stars of these colours
        leave between edges of wavelength; needed where `section.polychromatic` is set.

    Raises
    ------
    InputError
        For keys that contradict each other, or aberrations too large to draw.
    """

    def __init__(
        self, section: PsfSection, lens: Lens, size_px: tuple[int, int], weights_of: WeightsOf | None = None
    ) -> None:
        self._section, self._lens, self._size_px = section, lens, size_px
        field = section.field
        self._varies = field != FieldAberrationsSection(rings=field.rings, azimuths=field.azimuths)
        if self._varies and section.model != "diffraction":
            raise InputError(f"a PSF of model {section.model} takes no field aberrations; set model: diffraction")
        if not (section.polychromatic or self._varies):
            single = build_psf(section, lens.f_number, lens.pitch_um, lens.obscuration, lens.diffusion_um)
            self._psfs: dict[int, list[Psf]] = {0: [single]}
            self._colours = np.array([DEFAULT_B_V])
            corner = single
        else:
            self._colours, self._wavelengths_nm, self._weights = _spectra(section, weights_of, self._varies)
            self._psfs = {}
            self._made: dict[tuple[float, ...], list[Psf]] = {}
            corner = self._zone(self._zone_count - 1)[-1]
        ends = list(dict.fromkeys([*self._zone(0), corner]))  # a single image once
        self._widest = ends
        self.feature_px = min(psf.feature_px for psf in ends)
        """Finest structure of all images, for the sampling of smeared paths."""
        self.sigma_px = self._zone(0)[int(np.argmin(np.abs(self._colours - DEFAULT_B_V)))].sigma_px
        """σ of the Gaussian that fits the image of a star of middling colour on the axis without aberrations, px."""

    def radius_px(self, electrons: ArrayLike) -> FloatArray:
        """How far stars may reach, pixels: the most of the images on the axis and of the reddest in a corner."""
        return functools.reduce(np.maximum, [psf.radius_px(electrons) for psf in self._widest])

    def psf(self, b_v: float = DEFAULT_B_V, xy: tuple[float, float] | None = None) -> Psf:
        """The image of a star of a colour at a place (the centre of the image if left out)."""
        place = np.array([[(self._size_px[0] - 1) / 2, (self._size_px[1] - 1) / 2] if xy is None else xy])
        return self.groups(np.array([b_v]), place)[0][1]

    def groups(self, b_v: ArrayLike, xy: ArrayLike) -> list[tuple[IntArray, Psf]]:
        """Stars that share an image.

        Parameters
        ----------
        b_v : (N,) array
            Colours B−V; NaN where unknown.
        xy : (N, 2) array
            Places in the middle of the exposure, pixels; those off the image count as its edge, NaN as its centre.

        Returns
        -------
        list of ((M,) array of indices, Psf)
            Every star is in one group; with a single image there is one group, of all stars.
        """
        xy = np.asarray(xy, dtype=float)
        if not (self._section.polychromatic or self._varies):
            return [(np.arange(len(xy)), self._psfs[0][0])]
        colour = np.asarray(b_v, dtype=float)
        colour = np.where(np.isnan(colour), DEFAULT_B_V, colour)
        nearest = np.abs(colour[:, None] - self._colours).argmin(axis=1)
        key = self.zones(xy) * len(self._colours) + nearest
        order = np.argsort(key, kind="stable")
        values, starts = np.unique(key[order], return_index=True)
        return [
            (members, self._zone(int(value) // len(self._colours))[int(value) % len(self._colours)])
            for value, members in zip(values, np.split(order, starts[1:]), strict=True)
        ]

    def zones(self, xy: FloatArray) -> IntArray:
        """Zone of each place: 0 in the middle, then ring by ring, each from azimuth 0 on."""
        if not self._varies:
            return np.zeros(len(xy), dtype=np.int64)
        field = self._section.field
        h, azimuth = self._polar(np.asarray(xy, dtype=float))
        # the middle zone reaches to half a ring; then rings of equal width, the last about the corners
        ring = np.minimum(np.floor(np.minimum(h, 1.0) * field.rings + 0.5).astype(np.int64), field.rings)
        sector = np.floor(azimuth / math.tau * field.azimuths + 0.5).astype(np.int64) % field.azimuths
        return np.where(ring == 0, 0, 1 + (ring - 1) * field.azimuths + sector)

    @property
    def _zone_count(self) -> int:
        return 1 + self._section.field.rings * self._section.field.azimuths if self._varies else 1

    def _polar(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance from the centre of the image relative to the corners', and azimuth from 0 to 2π."""
        width, height = self._size_px
        row = self._lens.pitch_um[1] / self._lens.pitch_um[0]
        x, y = xy[:, 0] - (width - 1) / 2, (xy[:, 1] - (height - 1) / 2) * row
        corner = math.hypot((width - 1) / 2, (height - 1) / 2 * row)
        h = np.nan_to_num(np.hypot(x, y) / corner)
        return h, np.nan_to_num(np.arctan2(y, x)) % math.tau

    def _zone(self, zone: int) -> list[Psf]:
        """The images of a zone, one for each colour."""
        if zone not in self._psfs:
            field = self._section.field
            ring, sector = (0, 0) if zone == 0 else divmod(zone - 1 + field.azimuths, field.azimuths)
            coefficients = diffraction.axial_coefficients(self._section, self._lens.f_number)
            if self._varies:
                turned = sector * math.tau / field.azimuths
                coefficients = coefficients + diffraction.field_coefficients(field, ring / field.rings, turned)
            self._psfs[zone] = self._images(coefficients)
        return self._psfs[zone]

    def _images(self, coefficients: FloatArray) -> list[Psf]:
        """The images by a wavefront, one for each colour: computed, or mirrored from one that is its mirror image.

        With square pixels and a wavefront that turns with the azimuth, 2 of 12 azimuths are computed.
        """
        for swap, sign_x, sign_y in itertools.product((False, True), (1, -1), (1, -1)):
            if swap and self._lens.aspect != 1.0:
                continue
            made = self._made.get(_key(diffraction.mirrored(coefficients, swap, sign_x, sign_y)))
            if made is not None:
                return [_mirrored(psf, swap, sign_x, sign_y) for psf in made]
        made = aberrated(self._section, self._lens, coefficients, self._wavelengths_nm, self._weights)
        self._made[_key(coefficients)] = made
        return made


def _key(coefficients: FloatArray) -> tuple[float, ...]:
    return tuple((np.round(coefficients, 9) + 0.0).tolist())  # + 0.0: no −0.0


def _mirrored(psf: Psf, swap: bool, sign_x: int, sign_y: int) -> Psf:
    """The image by W where `psf` is that by `diffraction.mirrored(W, swap, sign_x, sign_y)`."""
    if psf.core is None or (not swap and sign_x > 0 and sign_y > 0):
        return psf
    core = np.asarray(psf.core[::sign_y, ::sign_x, ::sign_y, ::sign_x], dtype=np.float32)
    x, y = sign_x * psf.geometric_px[0], sign_y * psf.geometric_px[1]
    return replace(
        psf,
        core=np.ascontiguousarray(core.transpose(1, 0, 3, 2) if swap else core),
        geometric_px=(y, x) if swap else (x, y),
    )


def build_psf_set(
    section: PsfSection,
    f_number: float,
    pitch_um: tuple[float, float],
    size_px: tuple[int, int],
    *,
    obscuration: float = 0.0,
    diffusion_um: float = 0.0,
    weights_of: WeightsOf | None = None,
) -> PsfSet:
    """The PSFs of a scenario; parameters as in `simulator.optics.psf.Lens` and `PsfSet`."""
    return PsfSet(section, Lens(f_number, pitch_um, obscuration, diffusion_um), size_px, weights_of)


def _spectra(
    section: PsfSection, weights_of: WeightsOf | None, varies: bool
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Colours (C,), wavelengths (K,) and share of the electrons (C, K).

    The bins hold equal shares of the electrons that all colours together leave, and their wavelengths are the means
    over these, so that no colour is left with a coarse spectrum; the outermost 1 % on each side join their neighbours.
    """
    if not section.polychromatic:
        return np.array([DEFAULT_B_V]), np.array([section.wavelength_nm]), np.ones((1, 1))
    if section.model not in ("airy", "diffraction"):
        raise InputError(f"a PSF of model {section.model} is the same in every colour; set model: airy or diffraction")
    if weights_of is None:
        raise InputError("a polychromatic PSF needs the spectra of the stars: pass weights_of")
    colours = np.array(FEW_COLOURS if varies else COLOURS)
    shares = np.asarray(weights_of(colours, _FINE_NM), dtype=float)
    shares = shares / shares.sum(axis=1, keepdims=True)
    middles = (_FINE_NM[1:] + _FINE_NM[:-1]) / 2.0
    mean = shares.mean(axis=0)
    level = np.cumsum(mean) - 0.5 * mean
    count = FEW_BINS if varies else BINS
    bins = np.clip(((level - _TAIL) / (1.0 - 2.0 * _TAIL) * count).astype(int), 0, count - 1)
    weights = np.array([shares[:, bins == k].sum(axis=1) for k in range(count)]).T
    wavelengths = np.array([np.average(middles[bins == k], weights=mean[bins == k]) for k in range(count)])
    return colours, wavelengths, weights
