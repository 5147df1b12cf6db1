"""Merge stars that are closer together than a camera can resolve."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from startracker.catalog.stars import StarCatalog
from startracker.errors import InputError
from startracker.geometry.attitude import direction_to_radec


def merge_doubles(catalog: StarCatalog, separation_rad: float) -> StarCatalog:
    """The catalogue with every group of stars closer than `separation_rad` replaced by one star at their photocentre.

    Groups are connected components: two stars are in one group if a chain of stars, each within `separation_rad` of the
    next, connects them. With fluxes Fᵢ = 10^(−0.4 Vᵢ), a group has V = −2.5 log₁₀ ΣFᵢ and the F-weighted mean of
    position (unit vector), proper motion, parallax and radial velocity; id, name, colour and spectral type are those of
    its brightest star; it is variable if any of its stars is. Separations are those at the catalogue's epoch.

    Parameters
    ----------
    catalog : StarCatalog
        Not modified.
    separation_rad : float
        Great-circle angle, 0 to 0.1 rad; at 0 only stars with the same position are merged. A star with V = NaN is
        never merged.

    Returns
    -------
    StarCatalog
        In the order of the catalogue, each group in the row of its brightest star; single stars unchanged.

    Raises
    ------
    InputError
        If the separation is negative, not finite or above 0.1 rad.
    """
    if not 0.0 <= separation_rad <= 0.1:
        raise InputError(f"the separation of doubles must be between 0 and 0.1 rad; got {separation_rad}")
    directions = catalog.directions(catalog.epoch_jyear)
    known = np.flatnonzero(np.isfinite(catalog.v_mag))
    chord = 2.0 * np.sin(separation_rad / 2.0)
    pairs = known[cKDTree(directions[known]).query_pairs(chord, output_type="ndarray")] if known.size else known
    if pairs.size == 0:
        return catalog
    n = len(catalog)
    graph = coo_array((np.ones(len(pairs), dtype=bool), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    groups, label = connected_components(graph, directed=False)

    flux = np.where(np.isfinite(catalog.v_mag), 10.0 ** (-0.4 * catalog.v_mag), 0.0)
    total = np.bincount(label, flux, groups)
    alone = np.bincount(label, minlength=groups) == 1
    # The brightest star of each group is the last one in the order of (label, flux).
    order = np.lexsort((-np.arange(n), flux, label))
    brightest = order[np.flatnonzero(np.diff(label[order], append=groups))]

    single = alone[label[brightest]]
    merged = catalog.select(brightest)
    columns = {column: getattr(merged, column).copy() for column in StarCatalog.columns()}
    several = np.flatnonzero(~single)
    which = label[brightest[several]]

    def mean(values: np.ndarray) -> np.ndarray:
        return np.asarray(np.bincount(label, flux * values, groups)[which] / total[which])

    centre = np.stack([mean(directions[:, axis]) for axis in range(3)], axis=1)
    columns["ra_rad"][several], columns["dec_rad"][several] = direction_to_radec(centre)
    for column in ("pm_ra_rad_yr", "pm_dec_rad_yr", "parallax_rad", "radial_velocity_km_s"):
        columns[column][several] = mean(getattr(catalog, column))
    columns["variable"][several] = np.bincount(label, catalog.variable, groups)[which] > 0.0
    columns["v_mag"][several] = -2.5 * np.log10(total[which])
    rows = np.argsort(brightest, kind="stable")
    return replace(catalog, **{name: values[rows] for name, values in columns.items()})
