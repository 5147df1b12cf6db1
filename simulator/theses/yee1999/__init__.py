"""Yee 1999 recomputed, with all tables.

Tammy K. Yee, *Attitude Determination Using Stellar Images*, M.Sc. thesis, University of Saskatchewan, 1999.
"""

from __future__ import annotations

from collections.abc import Callable

from simulator.theses.printed import PrintedStudy, Section, run_sections
from simulator.theses.yee1999 import (
    examples,
    integer_build,
    integers,
    rendered,
    rendered_flight,
    run_times,
    threshold_sweep,
    vega_tables,
)
from simulator.theses.yee1999.picture import Analysis, Options, Picture, analyse, centred, step_tables, vega
from simulator.theses.yee1999.subsets import three_star_subsets

__all__ = ["SECTIONS", "Analysis", "Options", "Picture", "analyse", "centred", "run", "step_tables", "vega"]

TITLE = "Tammy K. Yee, Attitude Determination Using Stellar Images (M.Sc., University of Saskatchewan, 1999)"

SECTIONS: dict[str, Callable[[], Section]] = {
    "rotations": examples.rotation_example,
    "databases": examples.cassiopeia,
    "integers": integers.integers,
    "build": integer_build.integer_build,
    "times": run_times.run_times,
    "vega": vega_tables.vega_tables,
    "deneb": vega_tables.deneb_tables,
    "sadr": vega_tables.sadr_tables,
    "votes": vega_tables.recommendations,
    "subsets": three_star_subsets,
    "field": rendered_flight.video_field,
    "rendered_vega": rendered.section,
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
    sections = SECTIONS | {
        "vega": lambda: vega_tables.vega_tables(analysis),
        "subsets": lambda: three_star_subsets(analysis),
    }
    return run_sections("yee1999", TITLE, sections, only, progress)
