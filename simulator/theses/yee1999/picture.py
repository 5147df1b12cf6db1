"""One picture solved by the thesis' method: identification by triads, plate constants, all intermediate tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from simulator.theses.yee1999.catalogue import SubCatalog, printed_rows, sub_catalog
from startracker.core import FloatArray
from startracker.errors import InputError
from startracker.estimation.plate import Plate, solve_plate
from startracker.identification.arithmetic import Arithmetic
from startracker.identification.triad_search import TriadLimits, image_pairs
from startracker.identification.triad_votes import GroupMatch, TriadMatch, match_triads

VEGA_SIZE_PX = (427, 319)
VEGA_FOV_DEG = (9.0130, 6.9049)
PRINTED_MATCHES = (7001, 17139, 17056, 17051, 6872)
"""HR numbers of the Vega image's stars, section 4.2.1; 10,000 more if several catalogue stars are combined."""

MOST_STARS = 12
"""Number of stars matched, the brightest (section 2.3.4 of the thesis)."""


class Picture(NamedTuple):
    """Star images of one picture: centroids (N, 2), x right and y up from the image's centre, brightest first; columns
    and rows; the field across and down, from which the scale is computed by division by the size (section 2.3.4)."""

    xy_px: FloatArray
    size_px: tuple[int, int]
    fov_deg: tuple[float, float]

    @property
    def scale_deg(self) -> tuple[float, float]:
        """Degrees per pixel, across and down."""
        return self.fov_deg[0] / self.size_px[0], self.fov_deg[1] / self.size_px[1]

    @property
    def diagonal_deg(self) -> float:
        """Diagonal of the field, in plane geometry."""
        return float(np.hypot(*self.fov_deg))


def centred(xy: ArrayLike, size_px: tuple[int, int], origin: str = "auto") -> FloatArray:
    """Centroids (N, 2) from the image's centre with y up, from any origin.

    ``centre``: already in this form (Table 4.14). ``corner``: columns and rows, (0, 0) the centre of the first pixel
    and y down, as everywhere else in this package. ``auto``: ``centre`` if a coordinate is to the left of or above the
    corner pixel.

    Raises
    ------
    InputError
        For another origin, or centroids outside the image.
    """
    points = np.array(xy, dtype=float).reshape(-1, 2)
    if origin not in ("auto", "centre", "corner"):
        raise InputError(f"--origin: must be auto, centre or corner, not '{origin}'")
    if origin == "auto":
        origin = "centre" if len(points) and points.min() < -0.5 else "corner"
    size = np.array(size_px, dtype=float)
    if origin == "corner":
        points = (points - (size - 1.0) / 2.0) * [1.0, -1.0]
    outside = np.flatnonzero((np.abs(points) > size / 2.0).any(axis=1))
    if len(outside):
        raise InputError(
            f"centroid {outside[0] + 1} is outside the image of {size_px[0]}x{size_px[1]} pixels; check --size and "
            "--origin"
        )
    return points


def vega() -> Picture:
    """The Vega image: the five centroids of Table 4.14."""
    return _printed_picture("table_4_14", VEGA_SIZE_PX)


def deneb() -> Picture:
    """The Deneb image: the nine centroids of Table 4.15."""
    return _printed_picture("table_4_15", (424, 320))


def sadr() -> Picture:
    """The Sadr image: the three centroids of Table 4.16."""
    return _printed_picture("table_4_16", (469, 360))


def _printed_picture(table: str, size_px: tuple[int, int]) -> Picture:
    """Field and lens are those of the Vega image ("all the parameters ... are the same", section 4.2.2)."""
    xy = [(float(row["x"]), float(row["y"])) for row in printed_rows(table)]
    return Picture(np.array(xy), size_px, VEGA_FOV_DEG)


@dataclass(frozen=True, eq=False)
class Analysis:
    """All steps of the identification of one picture, and its attitude.

    The catalogue of an edition; separations, triads and groups; the group that matched three stars, centre and plate
    constants (None if there are none), and the reason.
    """

    picture: Picture
    catalog: SubCatalog
    edition: int
    match: TriadMatch
    found: GroupMatch | None
    plate: Plate | None
    reason: str = ""

    @cached_property
    def separations_deg(self) -> FloatArray:
        """Separations (P,) of the image stars, in the order 1-2, 1-3, ..., 2-3, ..."""
        return self.match.tables.arithmetic.separation_degrees(self.match.separations)

    @cached_property
    def groups(self) -> list[tuple[int, float]]:
        """Size and mean rotation (degrees) of each group, in the order found."""
        means = self.match.tables.arithmetic.angle_degrees(self.match.triads.group_rotations)
        return [(int(n), float(mean)) for n, mean in zip(self.match.triads.group_sizes, means, strict=True)]

    @cached_property
    def triads(self) -> list[dict[str, Any]]:
        """HR number per image star (0 for none), two rotations, and group from 1 of each triad (Table 4.2)."""
        triads, number = self.match.triads, self.match.tables.id
        rotations = self.match.tables.arithmetic.angle_degrees(triads.rotations)
        rows = []
        for t in np.argsort(triads.group, kind="stable"):
            hr = np.zeros(self.match.stars, dtype=np.int64)
            hr[triads.stars[t]] = number[triads.catalog[t]]
            rows.append({"hr": hr.tolist(), "rotations_deg": rotations[t].tolist(), "group": int(triads.group[t]) + 1})
        return rows

    @cached_property
    def votes(self) -> list[list[dict[str, Any]]]:
        """Candidate HR numbers per image star, their frequency, and V (Tables 4.3 and 4.4)."""
        tables, order = self.match.tables, self.match.groups()
        if self.found is None and not len(order):
            return [[] for _ in range(self.match.stars)]
        group = self.found or self.match.vote(int(order[0]))
        return [
            [
                {"hr": v.number(tables), "frequency": v.frequency, "v_mag": float(tables.v_mag[v.catalog])}
                for v in possible
            ]
            for possible in group.votes
        ]

    @cached_property
    def matches(self) -> list[int | None]:
        """HR number of each image star, None if not matched."""
        if self.found is None:
            return [None] * self.match.stars
        return [None if vote is None else vote.number(self.match.tables) for vote in self.found.matches]

    def sky_deg(self, xy_px: ArrayLike) -> FloatArray:
        """Right ascension and declination (..., 2) of points (..., 2) of the image, x right and y up from its centre.

        Raises
        ------
        InputError
            If no centre was found.
        """
        if self.plate is None:
            raise InputError(f"the image has no plate constants: {self.reason}")
        return self.plate.sky_deg(xy_px)

    def to_dict(self) -> dict[str, Any]:
        """All results as plain values, for JSON."""
        plate = self.plate
        return {
            "status": "solved" if plate is not None else "no_match",
            "reason": self.reason,
            "edition": self.edition,
            "size_px": list(self.picture.size_px),
            "fov_deg": list(self.picture.fov_deg),
            "centroids": self.picture.xy_px.tolist(),
            "catalog_stars": len(self.catalog),
            "catalog_pairs": len(self.match.tables.separation),
            "image_pairs": (np.stack(image_pairs(self.match.stars), axis=1) + 1).tolist(),
            "separations": self.separations_deg.tolist(),
            "pair_counts": self.match.pair_counts.tolist(),
            "triads": self.triads,
            "groups": [{"size": size, "mean_rotation_deg": mean} for size, mean in self.groups],
            "group": None if self.found is None else self.found.group + 1,
            "votes": self.votes,
            "matches": self.matches,
            "center_deg": None if plate is None else plate.center_deg.tolist(),
            "residuals_deg": [] if plate is None else plate.residual_deg.tolist(),
            "iterations": None if plate is None else plate.iterations,
            "plate_constants": None if plate is None else plate.constants.tolist(),
        }


@dataclass(frozen=True)
class Options:
    """Options of the method; the defaults are those of the Vega image (section 4.2).

    The sub-catalogue; the maximum separation of the pair database, or None for the field's diagonal rounded up to a
    full degree (12 in the thesis); thresholds; arithmetic, None for floating point.
    """

    edition: int = 4
    magnitude_limit: float = 6.0
    dec_range_deg: tuple[float, float] = (30.0, 90.0)
    max_separation_deg: float | None = None
    limits: TriadLimits = field(default_factory=TriadLimits)
    arithmetic: Arithmetic | None = None


def analyse(picture: Picture, options: Options | None = None) -> Analysis:
    """Identify the stars of a picture and find its centre, as in chapter 2.

    Raises
    ------
    InputError
        For an invalid edition or sub-catalogue.
    """
    options = options or Options()
    catalog = sub_catalog(options.edition, options.magnitude_limit, *options.dec_range_deg)
    widest = options.max_separation_deg or float(np.ceil(picture.diagonal_deg))
    tables = catalog.tables(min(widest, 180.0), options.arithmetic)
    shown = Picture(picture.xy_px[:MOST_STARS], picture.size_px, picture.fov_deg)
    match = match_triads(tables, shown.xy_px, shown.scale_deg, options.limits)
    found = match.best()
    if found is None:
        reason = f"no group of triads contains three stars: {_tally(match)}"
        return Analysis(shown, catalog, options.edition, match, None, None, reason)
    try:
        plate = solve_plate(shown.xy_px[found.pairs[:, 0]], catalog.sky_deg[found.pairs[:, 1]])
    except InputError as error:
        return Analysis(shown, catalog, options.edition, match, found, None, str(error))
    return Analysis(shown, catalog, options.edition, match, found, plate)


def _tally(match: TriadMatch) -> str:
    sizes = match.triads.group_sizes
    return f"{match.stars} image stars, {len(match.triads)} triads, largest group {sizes.max(initial=0)}"


def merged_name(number: int | None) -> str:
    """An HR number as printed; "–" for none."""
    return "–" if number is None else str(number)


def step_tables(analysis: Analysis) -> Sequence[tuple[str, Sequence[str], list[Sequence[str]]]]:
    """Tables of one picture: title, headings, rows (Tables 4.1 to 4.5 of the thesis)."""
    stars, means = analysis.match.stars, [mean for _size, mean in analysis.groups]
    first, second = image_pairs(stars)
    pairs: list[Sequence[str]] = [
        (f"{i + 1}", f"{j + 1}", f"{deg:.4f}", f"{count}")
        for i, j, deg, count in zip(first, second, analysis.separations_deg, analysis.match.pair_counts, strict=True)
    ]
    triads: list[Sequence[str]] = [
        (
            f"{row['group']}",
            f"{means[row['group'] - 1]:.1f}",
            *map(str, row["hr"]),
            *map("{:.1f}".format, row["rotations_deg"]),
        )
        for row in analysis.triads
    ]
    votes: list[Sequence[str]] = [
        (f"{star + 1}", f"{vote['hr']}", f"{vote['frequency']}", f"{vote['v_mag']:.2f}")
        for star, possible in enumerate(analysis.votes)
        for vote in possible
    ]
    names = [f"star {s + 1}" for s in range(stars)]
    out: list[tuple[str, Sequence[str], list[Sequence[str]]]] = [
        ("Angular separations (as Table 4.1)", ("star", "star", "separation [°]", "catalogue pairs"), pairs),
        (
            "Catalogue triads by group (as Table 4.2)",
            ("group", "mean rotation [°]", *names, "rotation 1 [°]", "rotation 2 [°]"),
            triads,
        ),
        ("Votes (as Tables 4.3 and 4.4)", ("star", "HR", "frequency", "V [mag]"), votes),
    ]
    if analysis.plate is not None and analysis.found is not None:
        headings = ("HR", "RA [°]", "computed", "Dec [°]", "computed", "ΔRA [°]", "ΔDec [°]")
        out.append(("Matched stars (as Table 4.5)", headings, _matched_stars(analysis, analysis.plate, analysis.found)))
    return out


def _matched_stars(analysis: Analysis, plate: Plate, found: GroupMatch) -> list[Sequence[str]]:
    seen, stars = found.pairs.T
    computed, catalog = plate.sky_deg(analysis.picture.xy_px[seen]), analysis.catalog.sky_deg[stars]
    return [
        (
            merged_name(analysis.matches[star]),
            *(f"{c[axis]:.5f}" for axis in range(2) for c in (theirs, ours)),
            *(f"{residual[axis]:+.5f}" for axis in range(2)),
        )
        for star, theirs, ours, residual in zip(seen, catalog, computed, plate.residual_deg, strict=True)
    ]
