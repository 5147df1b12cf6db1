"""The page of a sequence: a self-contained HTML file with the answer in its first lines."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.scenario import Scenario
from simulator.study.html_page import render_page
from simulator.study.sequence.frames import MODES
from simulator.study.sequence.plots import MODE_TITLES, panels
from simulator.study.statistics import AXES, BODY_AXES, deg_text
from simulator.study.style import inline_svg, style_variables

_LARGEST_GIF_BYTES = 12_000_000
"""A larger animation remains a separate file."""


def sequence_html(
    scenario: Scenario, summary: dict[str, Any], columns: dict[str, NDArray[Any]], gif: bytes | None = None
) -> str:
    """Complete page without scripts or external links.

    Parameters
    ----------
    scenario : Scenario
        The scenario.
    summary, columns : dict
        As in ``sequence.json`` and ``sequence.parquet``.
    gif : bytes, optional
        The animation.
    """
    groups = [
        (heading, [(panel, inline_svg(panel, f"s{i}-{k}")) for k, panel in enumerate(group)])
        for i, (heading, group) in enumerate(panels(columns).items())
    ]
    limits = {axis: getattr(scenario.specification, f"{axis}_deg") for axis in BODY_AXES}
    p997 = {axis: summary["errors_deg"][axis]["p997"] for axis in BODY_AXES}
    # no interval: the errors of successive frames are not independent
    met = summary["wrong"] == 0 and all(p997[axis] is not None and p997[axis] <= limits[axis] for axis in BODY_AXES)
    unsolved = [
        (int(columns["index"][i]), float(columns["elapsed_s"][i]), str(columns["status"][i]), str(columns["reason"][i]))
        for i in np.flatnonzero((columns["status"] != "solved") | columns["wrong"])[:20]
    ]
    embedded = gif is not None and len(gif) <= _LARGEST_GIF_BYTES
    return render_page(
        "sequence/sequence.html.j2",
        scenario=scenario,
        summary=summary,
        met=met,
        verdicts=[(axis, p997[axis], limits[axis]) for axis in BODY_AXES],
        axes=[(axis.replace("_", " "), axis) for axis in AXES],
        modes=[(MODE_TITLES[mode], summary["time_in_mode_s"][mode]) for mode in MODES],
        groups=groups,
        unsolved=unsolved,
        missing=summary["frames"] - summary["solved"] + summary["wrong"],
        animation="data:image/gif;base64," + base64.b64encode(gif).decode("ascii") if embedded and gif else None,
        beside=gif is not None and not embedded,
        colours=style_variables(),
        resolved=scenario.to_yaml(),
        deg=deg_text,
    )
