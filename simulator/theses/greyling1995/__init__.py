"""Greyling 1995 recomputed, figure by figure.

B. C. Greyling, *A Charge Coupled Device Star Sensor System for a Low Earth Orbit Microsatellite*, M.Eng. thesis,
University of Stellenbosch, 1995. Each module is a part of the thesis with a function `section() -> Section`; `SECTIONS`
lists them in order.
"""

from __future__ import annotations

from collections.abc import Callable

from simulator.theses.greyling1995 import (
    blur,
    centroiding,
    density,
    guide_stars,
    identification,
    noise,
    path,
    photometry,
    pitch,
    prototype,
    recommendations,
    review,
    segmentation,
)
from simulator.theses.printed import PrintedStudy, Section, run_sections

__all__ = ["SECTIONS", "TITLE", "run"]

TITLE = (
    "B. C. Greyling, A Charge Coupled Device Star Sensor System for a Low Earth Orbit Microsatellite "
    "(M.Eng., University of Stellenbosch, 1995)"
)

SECTIONS: dict[str, Callable[[], Section]] = {
    "path": path.section,
    "density": density.section,
    "photometry": photometry.section,
    "noise": noise.section,
    "blur": blur.section,
    "segmentation": segmentation.section,
    "centroiding": centroiding.section,
    "guide_stars": guide_stars.section,
    "identification": identification.section,
    "review": review.section,
    "pitch": pitch.section,
    "prototype": prototype.section,
    "recommendations": recommendations.section,
}
"""Name of a section to the function that computes it, in the order of the thesis."""


def run(only: str | None = None, progress: Callable[[str], None] | None = None) -> PrintedStudy:
    """All sections, or the one given by name; see `simulator.theses.printed.run_sections`."""
    return run_sections("greyling1995", TITLE, SECTIONS, only, progress)
