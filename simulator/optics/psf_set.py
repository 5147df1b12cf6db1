"""The PSFs of a camera: a single one, or one for each star colour and field zone."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from simulator.constants import DEFAULT_B_V
from simulator.optics import diffraction
from simulator.optics.lens import Lens
from simulator.optics.psf import Psf, aberrated, psf_of
from simulator.optics.psf_model import FieldAberrations, PsfModel
from startracker.core import FloatArray, IntArray
from startracker.errors import InputError

WeightsOf = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]

SPECTRA_MADE = (
    *((-0.3, math.nan), (-0.05, math.nan), (0.2, math.nan), (0.7, math.nan), (1.2, math.nan)),
    *((1.6, 11.5), (1.6, 14.0), (1.5, 16.0)),
)
"""B−V and `giant` (`simulator.sky.photometry`) of the stars for which polychromatic images are computed; for other
stars two of these images are mixed so that the mean wavelength is correct."""

FEW_SPECTRA_MADE = ((-0.2, math.nan), (0.7, math.nan), (1.6, 11.5), (1.5, 16.0))
"""The same for images that also vary over the field."""

NODES, FEW_NODES = 9, 7
"""Number of wavelengths of a polychromatic image, at equal ratios; fewer if it varies over the field."""

_FINE_NM = np.arange(200.0, 2600.0, 10.0)
_TAIL = 5e-4
"""Fraction of the electrons outside the wavelength nodes, on each side."""
_TAPS = 4
"""Points of the Lagrange interpolation between wavelengths."""


class PsfSet:
    """The PSFs of a camera, computed on demand.

    Field zones are rings around the image centre, divided in azimuth; a star has the image computed for the centre of
    its zone. For its spectrum, the two images of `SPECTRA_MADE` whose mean wavelengths bracket its own are mixed. Such
    an image agrees with the direct sum over its spectrum to 0.3 % of the peak (1 % if the images also vary over the
    field, for which there are fewer spectra).

    Parameters
    ----------
    psf_model : PsfModel
        Model, aberrations, colours.
    lens : Lens
        Lens and detector.
    size_px : (int, int)
        Columns and rows of the detector.
    weights_of : callable, optional
        ``weights_of(b_v (N,), edges_nm (K + 1,), giant (N,)) -> (N, K)`` electrons (or fractions) of stars of these
        colours and classes between wavelength edges; needed if `psf_model.polychromatic` is set.

    Raises
    ------
    InputError
        For contradictory keys, or aberrations that are too large.
    """

    def __init__(
        self, psf_model: PsfModel, lens: Lens, size_px: tuple[int, int], weights_of: WeightsOf | None = None
    ) -> None:
        self._model, self._lens, self._size_px = psf_model, lens, size_px
        field = psf_model.field
        self._varies = field != FieldAberrations(rings=field.rings, azimuths=field.azimuths)
        if self._varies and psf_model.model != "diffraction":
            raise InputError(f"a PSF of model {psf_model.model} takes no field aberrations; set model: diffraction")
        if not (psf_model.polychromatic or self._varies):
            single = psf_of(psf_model, lens)
            self._psfs: dict[int, list[Psf]] = {0: [single]}
            self._colours, self._means_nm = np.array([DEFAULT_B_V]), np.array([psf_model.wavelength_nm])
            corner = single
        else:
            made = _spectra(psf_model, weights_of, self._varies)
            self._colours, self._means_nm, self._wavelengths_nm, self._weights = made
            self._psfs = {}
            self._made: dict[tuple[float, ...], list[Psf]] = {}
            corner = self._zone(self._zone_count - 1)[-1]
        # The extremes of all images: those on axis, which are sharpest, and the reddest in a corner. Images of other
        # zones are computed only if a star needs them. dict.fromkeys removes duplicates in order.
        ends = list(dict.fromkeys([*self._zone(0), corner]))
        self._widest = ends
        self.feature_px = min(psf.feature_px for psf in ends)
        """Finest structure of all images, for the sampling of smeared paths."""
        self.sigma_px = self._zone(0)[int(np.argmin(np.abs(self._colours - DEFAULT_B_V)))].sigma_px
        """σ of the Gaussian that fits the on-axis image, without aberrations, of a star of medium colour, px."""

    def radius_px(self, electrons: ArrayLike) -> FloatArray:
        """Maximum radius of star images, pixels, of the images on axis and of the reddest in a corner."""
        return functools.reduce(np.maximum, [psf.radius_px(electrons) for psf in self._widest])

    def psf(self, b_v: float = DEFAULT_B_V, xy: tuple[float, float] | None = None) -> Psf:
        """PSF of a star of a colour at a position, by default the centre of the image."""
        position = np.array([[(self._size_px[0] - 1) / 2, (self._size_px[1] - 1) / 2] if xy is None else xy])
        return self.groups(np.array([b_v]), position)[0][1]

    def groups(self, b_v: ArrayLike, xy: ArrayLike) -> list[tuple[IntArray, Psf]]:
        """Groups of stars with the same PSF.

        Parameters
        ----------
        b_v : (N,) array
            Colours B−V; NaN where unknown.
        xy : (N, 2) array
            Positions at mid-exposure, pixels. Stars outside the image have the zone at its edge, NaN the central one.

        Returns
        -------
        list of ((M,) array of indices, Psf)
            Every star is in one group; with a single image there is one group, of all stars.
        """
        xy = np.asarray(xy, dtype=float)
        if not (self._model.polychromatic or self._varies):
            return [(np.arange(len(xy)), self._psfs[0][0])]
        colour = np.asarray(b_v, dtype=float)
        colour = np.where(np.isnan(colour), DEFAULT_B_V, colour)
        nearest = np.abs(colour[:, None] - self._colours).argmin(axis=1)
        # One integer identifies zone and colour. After a stable sort the members of each are contiguous and in order.
        key = self.zones(xy) * len(self._colours) + nearest
        order = np.argsort(key, kind="stable")
        values, starts = np.unique(key[order], return_index=True)
        return [
            (members, self._zone(int(value) // len(self._colours))[int(value) % len(self._colours)])
            for value, members in zip(values, np.split(order, starts[1:]), strict=True)
        ]

    def blends(self, wavelength_nm: ArrayLike, xy: ArrayLike) -> list[tuple[IntArray, FloatArray, Psf]]:
        """Stars grouped by PSF, with the fraction of each star's light; a star may be a mixture of two PSFs.

        Parameters
        ----------
        wavelength_nm : (N,) array
            Mean wavelengths of the stars' electrons.
        xy : (N, 2) array
            As for `groups`.

        Returns
        -------
        list of ((M,) array of indices, (M,) array of fractions, Psf)
            The fractions of every star sum to 1.
        """
        xy = np.asarray(xy, dtype=float)
        count = len(self._means_nm)
        if not (self._model.polychromatic or self._varies):
            return [(np.arange(len(xy)), np.ones(len(xy)), self._psfs[0][0])]
        zone, stars = self.zones(xy) * count, np.arange(len(xy))
        # A star between two tabulated mean wavelengths is a mixture of both images, with the share that gives its own
        # mean wavelength.
        at = np.interp(np.asarray(wavelength_nm, dtype=float), self._means_nm, np.arange(count))
        low = np.minimum(at.astype(np.int64), max(count - 2, 0))
        part = at - low
        key = np.concatenate([zone + low, zone + np.minimum(low + 1, count - 1)])
        share, star = np.concatenate([1.0 - part, part]), np.tile(stars, 2)
        rows = np.flatnonzero(share > 0.0)
        rows = rows[np.argsort(key[rows], kind="stable")]
        values, starts = np.unique(key[rows], return_index=True)
        return [
            (star[members], share[members], self._zone(int(value) // count)[int(value) % count])
            for value, members in zip(values, np.split(rows, starts[1:]), strict=True)
        ]

    def zones(self, xy: FloatArray) -> IntArray:
        """Zone of each position: 0 in the middle, then ring by ring, each from azimuth 0 on."""
        if not self._varies:
            return np.zeros(len(xy), dtype=np.int64)
        field = self._model.field
        h, azimuth = self._polar(np.asarray(xy, dtype=float))
        # The central zone has the radius of half a ring. The other rings have equal width, the last one is centred on
        # the corners.
        ring = np.minimum(np.floor(np.minimum(h, 1.0) * field.rings + 0.5).astype(np.int64), field.rings)
        sector = np.floor(azimuth / math.tau * field.azimuths + 0.5).astype(np.int64) % field.azimuths
        return np.where(ring == 0, 0, 1 + (ring - 1) * field.azimuths + sector)

    @property
    def coloured(self) -> bool:
        """Whether images depend on the spectra of the stars."""
        return self._model.polychromatic

    @property
    def _zone_count(self) -> int:
        return 1 + self._model.field.rings * self._model.field.azimuths if self._varies else 1

    def _polar(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance from the image centre relative to that of the corners, and azimuth from 0 to 2π."""
        width, height = self._size_px
        row = self._lens.pitch_um[1] / self._lens.pitch_um[0]
        x, y = xy[:, 0] - (width - 1) / 2, (xy[:, 1] - (height - 1) / 2) * row
        corner = math.hypot((width - 1) / 2, (height - 1) / 2 * row)
        h = np.nan_to_num(np.hypot(x, y) / corner)
        return h, np.nan_to_num(np.arctan2(y, x)) % math.tau

    def _zone(self, zone: int) -> list[Psf]:
        """The images of a zone, one for each colour."""
        if zone not in self._psfs:
            field = self._model.field
            ring, sector = (0, 0) if zone == 0 else divmod(zone - 1 + field.azimuths, field.azimuths)
            coefficients = diffraction.axial_coefficients(self._model, self._lens.f_number)
            if self._varies:
                turned = sector * math.tau / field.azimuths
                coefficients = coefficients + diffraction.field_coefficients(field, ring / field.rings, turned)
            self._psfs[zone] = self._images(coefficients)
        return self._psfs[zone]

    def _images(self, coefficients: FloatArray) -> list[Psf]:
        """Images of a wavefront, one for each colour: computed, or mirrored from an existing one.

        With square pixels and a wavefront that rotates with azimuth, only 2 of 12 azimuths are computed.
        """
        for swap, sign_x, sign_y in itertools.product((False, True), (1, -1), (1, -1)):
            if swap and self._lens.aspect != 1.0:
                continue
            made = self._made.get(_key(diffraction.mirrored(coefficients, swap, sign_x, sign_y)))
            if made is not None:
                return [_mirrored(psf, swap, sign_x, sign_y) for psf in made]
        made = aberrated(self._model, self._lens, coefficients, self._wavelengths_nm, self._weights)
        self._made[_key(coefficients)] = made
        return made


def _key(coefficients: FloatArray) -> tuple[float, ...]:
    return tuple((np.round(coefficients, 9) + 0.0).tolist())  # adding 0 turns −0.0 into 0.0, for equal keys


def _mirrored(psf: Psf, swap: bool, sign_x: int, sign_y: int) -> Psf:
    """The image of W, given that of `diffraction.mirrored(W, swap, sign_x, sign_y)`."""
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
    psf_model: PsfModel,
    f_number: float,
    pitch_um: tuple[float, float],
    size_px: tuple[int, int],
    *,
    obscuration: float = 0.0,
    diffusion_um: float = 0.0,
    weights_of: WeightsOf | None = None,
) -> PsfSet:
    """The PSFs of a scenario; parameters as in `simulator.optics.lens.Lens` and `PsfSet`."""
    return PsfSet(psf_model, Lens(f_number, pitch_um, obscuration, diffusion_um), size_px, weights_of)


def _spectra(
    psf_model: PsfModel, weights_of: WeightsOf | None, varies: bool
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """B−V (C,) and mean wavelengths (C,), ascending, of spectra; wavelengths (K,) of their images and weights (C, K).

    The image is a smooth function of the wavelength λ and is interpolated by a cubic between nodes. The electrons at λ
    contribute to four nodes with Lagrange weights, some of them negative, and the sum over a spectrum is accurate to
    1e-3 of the peak with seven nodes. The nodes cover all but 0.05 % of the electrons on each side.
    """
    if not psf_model.polychromatic:
        one = np.array([psf_model.wavelength_nm])
        return np.array([DEFAULT_B_V]), one, one, np.ones((1, 1))
    if psf_model.model not in ("airy", "diffraction"):
        raise InputError(f"a PSF of model {psf_model.model} does not depend on colour; set model: airy or diffraction")
    if weights_of is None:
        raise InputError("a polychromatic PSF needs the spectra of the stars: pass weights_of")
    b_v, giant = np.array(FEW_SPECTRA_MADE if varies else SPECTRA_MADE).T
    shares = np.asarray(weights_of(b_v, _FINE_NM, giant), dtype=float)
    shares = shares / shares.sum(axis=1, keepdims=True)
    middles = (_FINE_NM[1:] + _FINE_NM[:-1]) / 2.0
    means = shares @ middles
    order = np.argsort(means, kind="stable")
    # Nodes at equal ratios of wavelength, because an image scales with the wavelength.
    level = np.cumsum(shares.mean(axis=0))
    low, high = (float(middles[np.searchsorted(level, part)]) for part in (_TAIL, 1.0 - _TAIL))
    nodes = np.geomspace(low, max(high, low * 1.01), FEW_NODES if varies else NODES)
    return b_v[order], means[order], nodes, shares[order] @ _lagrange(np.clip(middles, low, nodes[-1]), nodes)


def _lagrange(at: FloatArray, nodes: FloatArray) -> FloatArray:
    """Weights (N, K) of nodes (K,) for cubic interpolation at each point (N,)."""
    first = np.clip(np.searchsorted(nodes, at) - _TAPS // 2, 0, len(nodes) - _TAPS)
    weights = np.zeros((len(at), len(nodes)))
    for a in range(_TAPS):
        product = np.ones(len(at))
        for b in range(_TAPS):
            if b != a:
                product *= (at - nodes[first + b]) / (nodes[first + a] - nodes[first + b])
        weights[np.arange(len(at)), first + a] = product
    return weights
