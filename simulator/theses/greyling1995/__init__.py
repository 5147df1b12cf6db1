"""Greyling 1995 computed again, figure by figure.

B. C. Greyling, *A Charge Coupled Device Star Sensor System for a Low Earth Orbit Microsatellite*, M.Eng. thesis,
University of Stellenbosch, 1995. Each module is a part of the thesis with a function `section() -> Section`;
`SECTIONS` lists them in the order of the thesis.
"""

from __future__ import annotations

from collections.abc import Callable

from simulator.theses.greyling1995.blur import section as blur_section
from simulator.theses.greyling1995.centroiding import section as centroiding_section
from simulator.theses.greyling1995.density import section as density_section
from simulator.theses.greyling1995.guide_stars import section as guide_stars_section
from simulator.theses.greyling1995.identification import section as identification_section
from simulator.theses.greyling1995.noise import section as noise_section
from simulator.theses.greyling1995.path import section as path_section
from simulator.theses.greyling1995.photometry import section as photometry_section
from simulator.theses.greyling1995.pitch import section as pitch_section
from simulator.theses.greyling1995.prototype import section as prototype_section
from simulator.theses.greyling1995.recommendations import section as recommendations_section
from simulator.theses.greyling1995.review import section as review_section
from simulator.theses.greyling1995.segmentation import section as segmentation_section
from simulator.theses.printed import PrintedStudy, Section, run_sections

__all__ = ["SECTIONS", "TITLE", "run"]

TITLE = (
    "B. C. Greyling, A Charge Coupled Device Star Sensor System for a Low Earth Orbit Microsatellite "
    "(M.Eng., University of Stellenbosch, 1995)"
)

SECTIONS: dict[str, Callable[[], Section]] = {
    "path": path_section,
    "density": density_section,
    "photometry": photometry_section,
    "noise": noise_section,
    "blur": blur_section,
    "segmentation": segmentation_section,
    "centroiding": centroiding_section,
    "guide_stars": guide_stars_section,
    "identification": identification_section,
    "review": review_section,
    "pitch": pitch_section,
    "prototype": prototype_section,
    "recommendations": recommendations_section,
}
"""Name of a section to the function that computes it, in the order of the thesis."""


def run(only: str | None = None, progress: Callable[[str], None] | None = None) -> PrintedStudy:
    """The study: all sections, or the one that is named.

    Parameters
    ----------
    only : str, optional
        Name of a section; left out, all are computed.
    progress : callable, optional
        Called with the name of each section before it is computed.

    Raises
    ------
    InputError
        When there is no section of that name.
    """
    return run_sections("greyling1995", TITLE, SECTIONS, only, progress)
