"""Photometry: electrons per second from a star's magnitude and colour, and from the diffuse sky."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.constants import DEFAULT_B_V
from simulator.optics.curves import Curve
from simulator.sky.albedo import body_photons
from simulator.sky.colours import population_giant_share
from simulator.sky.spectra import B_V_RANGE, LATE_GIANT, SOLAR_B_V, SPECTRA, Spectrum
from startracker.catalog.stars import StarCatalog
from startracker.core import FloatArray, IntArray
from startracker.errors import InputError
from startracker.settings.registry import lookup

_Tables = tuple[FloatArray, FloatArray, FloatArray]

# Steps at which linear interpolation of the tables has a relative error below 1e-4.
_B_V_GRID = np.linspace(*B_V_RANGE, round((B_V_RANGE[1] - B_V_RANGE[0]) / 0.0025) + 1)
_LATE_GRID = np.linspace(*LATE_GIANT, round((LATE_GIANT[1] - LATE_GIANT[0]) / 0.02) + 1)
_LATE_B_V = 1.6  # B−V of M giants, for families of spectra that have no subtypes
_SPECTRA_AT_ONCE = 128  # limits the memory of intermediate arrays
_GRID_STEP_NM = 1.0
_SQUARE_DEGREE_SR = math.radians(1.0) ** 2


@dataclass(frozen=True, eq=False)
class Photometer:
    """Electron rates of stars for an aperture and a spectral response.

    N = A ∫ n_λ(star) η_λ dλ × 10^(−0.4 V) electrons per second, with n_λ the photon flux density of a V = 0 star of
    that colour and class (`simulator.sky.spectra`), η transmission × quantum efficiency and A the area of the aperture.
    The integrals are done once for colours 0.0025 apart; between them the tables are interpolated (relative error below
    1 × 10⁻⁴).

    The argument `giant` of the methods is 0 for a dwarf, 1 for a giant, a fraction between, or 10 + the subtype (0 to
    6) of an M giant. If omitted or NaN (unknown), the fraction of giants among bright stars of that B−V is used
    (`simulator.sky.colours`, whose `spectral_coordinates` gives B−V and `giant` from a catalogue's columns). B−V of NaN
    is replaced by `DEFAULT_B_V`; others are clipped to `B_V_RANGE`.

    Raises
    ------
    InputError
        For an area that is not positive, or an unknown name.
    """

    response: Curve
    """Transmission × quantum efficiency."""
    aperture_area_cm2: float
    """Area of the entrance pupil, cm²."""
    spectrum: str = "colour_sequence"
    """Name of a family of spectra, including those registered in the entry-point group ``boresight.spectra``."""
    _wavelength_nm: FloatArray = field(init=False, repr=False)
    _efficiency: FloatArray = field(init=False, repr=False)
    _rate: _Tables = field(init=False, repr=False)
    _first_moment: _Tables = field(init=False, repr=False)
    _bins: dict[tuple[float, ...], _Tables] = field(init=False, repr=False)
    _bodies: dict[str, tuple[float, float]] = field(init=False, repr=False)
    _stars: dict[StarCatalog, FloatArray] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.aperture_area_cm2) and self.aperture_area_cm2 > 0):
            raise InputError(f"the area of an aperture must be positive; got {self.aperture_area_cm2} cm²")
        lookup("spectra", SPECTRA, self.spectrum)
        wavelength_nm, efficiency = _sampled(self.response)
        moments = np.stack([efficiency, efficiency * wavelength_nm], axis=1)
        # Weights of the trapezoidal rule: half of the interval on either side of a point.
        half = np.diff(wavelength_nm, prepend=wavelength_nm[0]) / 2
        weight = half + np.append(half[1:], 0.0)
        both = self._integrals(wavelength_nm, moments * weight[:, None])
        # The dataclass is frozen, as photometers are shared; these tables and caches are assigned only here.
        for name, value in (
            ("_wavelength_nm", wavelength_nm),
            ("_efficiency", efficiency),
            ("_rate", tuple(self.aperture_area_cm2 * table[:, 0] for table in both)),
            ("_first_moment", tuple(self.aperture_area_cm2 * table[:, 1] for table in both)),
            ("_bins", {}),
            ("_bodies", {}),
            ("_stars", {}),
        ):
            object.__setattr__(self, name, value)

    def electrons_per_s(self, v_mag: ArrayLike, b_v: ArrayLike, giant: ArrayLike | None = None) -> FloatArray:
        """Photo-electrons per second of stars, over all their pixels.

        Parameters
        ----------
        v_mag : (N,) array
            Magnitudes V.
        b_v : (N,) array
            Colours B−V.
        giant : (N,) array, optional
            Luminosity class, see above.
        """
        scale = 10.0 ** (-0.4 * np.asarray(v_mag, dtype=float))
        return np.asarray(_looked_up(self._rate, b_v, giant) * scale)

    def star_electrons_per_s(self, catalog: StarCatalog, b_v: FloatArray, giant: FloatArray) -> FloatArray:
        """`electrons_per_s` of all stars of a catalogue, whose colours and classes these are; cached."""
        if catalog not in self._stars:
            self._stars[catalog] = self.electrons_per_s(catalog.v_mag, b_v, giant)
        return self._stars[catalog]

    def body_electrons_per_s(self, names: NDArray[np.str_], v_mag: ArrayLike) -> FloatArray:
        """Photo-electrons per second of bodies of the solar system: sunlight times albedo (`simulator.sky.albedo`).

        Parameters
        ----------
        names : (N,) array of str
            English names.
        v_mag : (N,) array
            Magnitudes V of the whole bodies.
        """
        at_zero = np.array([self._body(str(name))[0] for name in names])
        return at_zero * 10.0 ** (-0.4 * np.asarray(v_mag, dtype=float))

    def body_wavelength_nm(self, names: NDArray[np.str_]) -> FloatArray:
        """Mean wavelength (N,) of the photo-electrons of bodies of the solar system, nm."""
        return np.array([self._body(str(name))[1] for name in names])

    def _body(self, name: str) -> tuple[float, float]:
        """Electrons per second of a body with V = 0, and their mean wavelength; cached."""
        if name not in self._bodies:
            nm = self._wavelength_nm
            electrons = body_photons(nm, name, self.spectrum) * self._efficiency
            rate = float(np.trapezoid(electrons, nm))
            mean = float(np.trapezoid(electrons * nm, nm)) / rate if rate > 0.0 else 0.0
            self._bodies[name] = (self.aperture_area_cm2 * rate, mean)
        return self._bodies[name]

    def effective_wavelength_nm(self, b_v: ArrayLike, giant: ArrayLike | None = None) -> FloatArray:
        """Mean wavelength of a star's photo-electrons, ∫ λ n η dλ / ∫ n η dλ, nm; (N,)."""
        return np.asarray(_looked_up(self._first_moment, b_v, giant) / _looked_up(self._rate, b_v, giant))

    def bin_weights(self, b_v: ArrayLike, edges_nm: ArrayLike, giant: ArrayLike | None = None) -> FloatArray:
        """Fraction of a star's photo-electrons in wavelength bins.

        Parameters
        ----------
        b_v : (N,) array
            Colours B−V.
        edges_nm : (K + 1,) array
            Edges of the bins, ascending, nm. Electrons outside are counted in the first and the last bin.
        giant : (N,) array, optional
            Luminosity class, see above.

        Returns
        -------
        (N, K) array
            Fractions; the sum of each row is 1.

        Raises
        ------
        InputError
            For fewer than two edges, or edges that are not ascending.
        """
        edges = np.asarray(edges_nm, dtype=float)
        if edges.ndim != 1 or len(edges) < 2 or not (np.diff(edges) > 0).all():
            raise InputError(f"wavelength bins need at least two ascending edges; got {edges.tolist()} nm")
        key = tuple(edges.tolist())
        if key not in self._bins:
            inner = edges[1:-1]
            wavelength_nm = np.unique(np.concatenate([self._wavelength_nm, inner]))
            steps = np.diff(wavelength_nm)
            middle = (wavelength_nm[1:] + wavelength_nm[:-1]) / 2
            member = np.searchsorted(inner, middle)[:, None] == np.arange(len(edges) - 1)  # (W−1, K)
            # Trapezoidal rule: each interval adds half of its width to either end, in the bin to which it belongs.
            weight = np.zeros((len(wavelength_nm), len(edges) - 1))
            weight[:-1] += member * steps[:, None] / 2
            weight[1:] += member * steps[:, None] / 2
            self._bins[key] = self._integrals(wavelength_nm, weight * self.response(wavelength_nm)[:, None])
        binned = np.atleast_2d(_looked_up(self._bins[key], b_v, giant))
        return np.asarray(binned / binned.sum(axis=1, keepdims=True))

    def background_e_s_pixel(self, s10: float, solid_angle_sr: float) -> float:
        """Electrons per second and pixel of diffuse light of the Sun's colour.

        Parameters
        ----------
        s10 : float
            Surface brightness in stars of V = 10 per square degree (1 S10 = 27.78 mag arcsec⁻²; Leinert et al. 1998).
        solid_angle_sr : float
            Solid angle of a pixel.
        """
        stars = s10 * solid_angle_sr / _SQUARE_DEGREE_SR
        return float(stars * self.electrons_per_s(10.0, SOLAR_B_V, 0.0))

    def _integrals(self, wavelength_nm: FloatArray, kernels: FloatArray) -> _Tables:
        """∫ n_λ k dλ of the family of spectra; kernels (W, K) with the weights of the integration."""
        spectrum = lookup("spectra", SPECTRA, self.spectrum)
        return _spectral_integrals(spectrum, wavelength_nm.tobytes(), kernels.tobytes())


@functools.lru_cache(maxsize=32)
def _spectral_integrals(spectrum: Spectrum, wavelength_nm: bytes, kernels: bytes) -> _Tables:
    """∫ n_λ k dλ of dwarfs and giants along B−V and of late giants along their subtype, each (M, K).

    Cached, as the cameras of a sweep share their response: it takes a tenth of a second.
    """
    nm = np.frombuffer(wavelength_nm)
    weighted = np.frombuffer(kernels).reshape(len(nm), -1)

    def along(b_v: FloatArray, giant: FloatArray) -> FloatArray:
        # All spectra at once would take several arrays of tens of megabytes.
        parts = [slice(k, k + _SPECTRA_AT_ONCE) for k in range(0, len(b_v), _SPECTRA_AT_ONCE)]
        return np.concatenate([spectrum(nm, b_v[part], giant[part]) @ weighted for part in parts])

    return (
        along(_B_V_GRID, np.zeros(len(_B_V_GRID))),
        along(_B_V_GRID, np.ones(len(_B_V_GRID))),
        along(np.full(len(_LATE_GRID), _LATE_B_V), _LATE_GRID),
    )


def _looked_up(tables: _Tables, b_v: ArrayLike, giant: ArrayLike | None) -> FloatArray:
    """Tables (dwarfs, giants, late giants; each (M,) or (M, K)) at stars (N,): (N,) or (N, K)."""
    dwarfs, giants, late = tables
    colour = np.asarray(b_v, dtype=float)
    share = np.asarray(math.nan if giant is None else giant, dtype=float)
    if colour.shape != share.shape:
        colour, share = np.broadcast_arrays(colour, share)
    colour = np.where(np.isnan(colour), DEFAULT_B_V, colour)
    unknown = np.isnan(share)
    if unknown.any():
        share = np.where(unknown, population_giant_share(colour), share)
    # np.minimum and np.maximum have less overhead than np.clip, which matters for the few stars of a frame.
    clipped = np.minimum(np.maximum(colour, B_V_RANGE[0]), B_V_RANGE[1])
    at = _rows((clipped - B_V_RANGE[0]) / _B_V_STEP, dwarfs)
    of_giants = np.minimum(np.maximum(share, 0.0), 1.0).reshape(at[1].shape)
    out = np.asarray(_between(dwarfs, *at) * (1.0 - of_giants) + _between(giants, *at) * of_giants)
    is_late = share >= LATE_GIANT[0]
    if is_late.any():
        out[is_late] = _between(late, *_rows((share[is_late] - LATE_GIANT[0]) / _LATE_STEP, late))
    return out


_B_V_STEP, _LATE_STEP = float(_B_V_GRID[1] - _B_V_GRID[0]), float(_LATE_GRID[1] - _LATE_GRID[0])


def _rows(at: FloatArray, table: FloatArray) -> tuple[IntArray, FloatArray]:
    """Rows of a uniform table (M,) or (M, K) below positions (N,) in units of rows, clipped at the ends, and the
    remaining fractions, (N,) or (N, 1)."""
    at = np.minimum(np.maximum(at, 0.0), len(table) - 1.0)
    row = np.minimum(at.astype(np.int64), len(table) - 2)
    return row, (at - row).reshape(at.shape + (1,) * (table.ndim - 1))


def _between(table: FloatArray, row: IntArray, part: FloatArray) -> FloatArray:
    """Linear interpolation between the rows of a table."""
    return np.asarray(table[row] * (1.0 - part) + table[row + 1] * part)


def _sampled(response: Curve) -> tuple[FloatArray, FloatArray]:
    """Wavelengths (W,) and values (W,) of a response at its own points and at least every nanometre, because spectra
    vary where the response is flat."""
    low, high = response.wavelength_nm[0], response.wavelength_nm[-1]
    fine = np.linspace(low, high, math.ceil((high - low) / _GRID_STEP_NM) + 1)
    wavelength_nm = np.unique(np.concatenate([fine, response.wavelength_nm]))
    return wavelength_nm, response(wavelength_nm)
