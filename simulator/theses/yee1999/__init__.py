"""Yee 1999 recomputed, with all tables.

Tammy K. Yee, *Attitude Determination Using Stellar Images*, M.Sc. thesis, University of Saskatchewan, 1999.
"""

from __future__ import annotations

from collections.abc import Callable

from simulator.theses.printed import PrintedStudy, Section, run_sections
from simulator.theses.yee1999 import (
    deneb_sadr,
    examples,
    integer_build,
    integers,
    rendered_flight,
    rendered_vega,
    run_times,
    threshold_sweep,
    video_field,
)
from simulator.theses.yee1999.picture import Analysis, Options, Picture, analyse, centred, step_tables, vega
from simulator.theses.yee1999.subsets import three_star_subsets
from simulator.theses.yee1999.vega_tables import vega_tables

__all__ = ["SECTIONS", "Analysis", "Options", "Picture", "analyse", "centred", "run", "step_tables", "vega"]

TITLE = "Tammy K. Yee, Attitude Determination Using Stellar Images (M.Sc., University of Saskatchewan, 1999)"

SECTIONS: dict[str, Callable[[], Section]] = {
    "rotations": examples.rotation_example,
    "databases": examples.cassiopeia,
    "integers": integers.integers,
    "build": integer_build.integer_build,
    "times": run_times.run_times,
    "vega": vega_tables,
    "deneb": deneb_sadr.deneb_tables,
    "sadr": deneb_sadr.sadr_tables,
    "votes": deneb_sadr.recommendations,
    "subsets": three_star_subsets,
    "field": video_field.video_field,
    "rendered_vega": rendered_vega.section,
    "rendered_flight": rendered_flight.section,
    "thresholds": threshold_sweep.section,
}
"""Name of a section to the function that computes it, in the order of the thesis."""


def run(
    only: str | None = None, progress: Callable[[str], None] | None = None, analysis: Analysis | None = None
) -> PrintedStudy:
    """All sections, or the one given by name; see `simulator.theses.printed.run_sections`.

    The identified Vega image may be given; otherwise it is identified again.
    """
    sections = SECTIONS | {"vega": lambda: vega_tables(analysis), "subsets": lambda: three_star_subsets(analysis)}
    return run_sections("yee1999", TITLE, sections, only, progress)
