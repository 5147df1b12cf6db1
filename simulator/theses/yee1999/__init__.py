"""Yee 1999, every table computed again.

Tammy K. Yee, *Attitude Determination Using Stellar Images*, M.Sc. thesis, University of Saskatchewan, 1999.
"""

from __future__ import annotations

from collections.abc import Callable

from simulator.theses.printed import PrintedStudy, Section, run_sections
from simulator.theses.yee1999.deneb_sadr import deneb_tables, recommendations, sadr_tables
from simulator.theses.yee1999.examples import cassiopeia, rotation_example
from simulator.theses.yee1999.integer_build import integer_build
from simulator.theses.yee1999.integers import integers
from simulator.theses.yee1999.picture import Analysis, Options, Picture, analyse, centred, step_tables, vega
from simulator.theses.yee1999.rendered_flight import section as rendered_flight_section
from simulator.theses.yee1999.rendered_vega import section as rendered_vega_section
from simulator.theses.yee1999.run_times import run_times
from simulator.theses.yee1999.subsets import three_star_subsets
from simulator.theses.yee1999.threshold_sweep import section as threshold_sweep_section
from simulator.theses.yee1999.vega_tables import vega_tables
from simulator.theses.yee1999.video_field import video_field

__all__ = ["SECTIONS", "Analysis", "Options", "Picture", "analyse", "centred", "run", "step_tables", "vega"]

TITLE = "Tammy K. Yee, Attitude Determination Using Stellar Images (M.Sc., University of Saskatchewan, 1999)"

SECTIONS: dict[str, Callable[[], Section]] = {
    "rotations": rotation_example,
    "databases": cassiopeia,
    "integers": integers,
    "build": integer_build,
    "times": run_times,
    "vega": vega_tables,
    "deneb": deneb_tables,
    "sadr": sadr_tables,
    "votes": recommendations,
    "subsets": three_star_subsets,
    "field": video_field,
    "rendered_vega": rendered_vega_section,
    "rendered_flight": rendered_flight_section,
    "thresholds": threshold_sweep_section,
}
"""Name of a section to the function that computes it, in the order of the thesis."""


def run(
    only: str | None = None, progress: Callable[[str], None] | None = None, analysis: Analysis | None = None
) -> PrintedStudy:
    """Compute the study, or one of its sections.

    Parameters
    ----------
    only : str, optional
        Name of the one section wanted.
    progress : callable, optional
        Called with the name of each section.
    analysis : Analysis, optional
        The Vega image as it was identified; made anew otherwise.

    Raises
    ------
    InputError
        No section of that name.
    """
    sections = SECTIONS | {"vega": lambda: vega_tables(analysis), "subsets": lambda: three_star_subsets(analysis)}
    return run_sections("yee1999", TITLE, sections, only, progress)
