"""The page of a sequence: a self-contained HTML file with the answer in its first lines."""

from __future__ import annotations

import base64
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simulator.study.html_page import TONES, Table, drawn, provenance, render_page, verdict_table
from simulator.study.sequence.frames import MODES
from simulator.study.sequence.heads_plots import heads_panels, heads_table
from simulator.study.sequence.plots import MODE_TITLES, panels
from simulator.study.specification.outcome import outcome_text
from simulator.study.statistics import AXES
from simulator.study.texts import deg_text

if TYPE_CHECKING:
    from simulator.study.sequence.result import Sequence

_LARGEST_GIF_BYTES = 12_000_000
"""A larger animation remains a separate file."""

_MOST_UNSOLVED = 20
"""Maximum number of unsolved frames that the page lists."""


def sequence_html(sequence: Sequence, gif: bytes | None = None) -> str:
    """Complete page without scripts or external links.

    Parameters
    ----------
    sequence : Sequence
        Its scenario, frames and summary.
    gif : bytes, optional
        The animation.
    """
    scenario, summary, columns = sequence.scenario, sequence.summary, sequence.columns
    judged, heads = sequence.judgement, [head.name for head in scenario.heads]
    groups = [
        (heading, [drawn(panel, f"s{i}-{k}") for k, panel in enumerate(group)])
        for i, (heading, group) in enumerate((heads_panels(columns, heads) | panels(columns)).items())
    ]
    embedded = gif is not None and len(gif) <= _LARGEST_GIF_BYTES
    return render_page(
        "sequence/sequence.html.j2",
        scenario=scenario,
        summary=summary,
        provenance=provenance(summary, scenario.fingerprint()),
        outcome=outcome_text(summary),
        tone=TONES[judged.state],
        verdict=judged.text,
        requirements=verdict_table(judged),
        accuracy=_accuracy(summary),
        heads=heads_table(summary["heads"]) if heads else None,
        modes=Table(("mode", "time"), tuple((MODE_TITLES[m], f"{summary['time_in_mode_s'][m]:g} s") for m in MODES)),
        groups=groups,
        calibration=_calibration(summary["in_flight_calibration"]) if "in_flight_calibration" in summary else None,
        unsolved=_unsolved(summary, columns),
        animation="data:image/gif;base64," + base64.b64encode(gif).decode("ascii") if embedded and gif else None,
        beside=gif is not None and not embedded,
        resolved=scenario.to_yaml(),
    )


def _accuracy(summary: dict[str, Any]) -> Table:
    single = summary.get("single")
    rows = []
    for axis in AXES:
        errors = summary["errors_deg"][axis]
        row = [
            axis.replace("_", " "),
            *(deg_text(errors[name]) for name in ("mean", "std", "rms", "p997", "max")),
        ]
        if single:
            gain = single["gain"][axis]
            row += [deg_text(single["errors_deg"][axis]["rms"]), f"{gain:.2f}" if gain else "–"]
        rows.append(tuple(row))
    note = "The error is the rotation vector from the true to the estimated attitude, over the solved frames"
    if single:
        note += f"; single frames: {single['solved']} frames solved one by one without prediction"
    headings = (
        "axis",
        "mean",
        "std",
        "rms",
        "99.7th percentile",
        "max",
        *(("rms, single frames", "gain") if single else ()),
    )
    return Table(headings, tuple(rows), note=f"{note}.")


def _calibration(found: dict[str, Any]) -> Table:
    """Parameters of the lens at the end of a calibration in flight, compared with the truth."""
    rows = []
    for name, value in found["parameters"].items():
        constant_s = value["time_constant_s"]
        rows.append(
            (
                name.replace("_", " "),
                *(f"{value[key]:.4g}" for key in ("value", "sigma", "true")),
                f"{value['error_sigmas']:+.2f}",
                "–" if constant_s is None else f"{constant_s:.0f} s",
            )
        )
    chi2, pixels, used = found["chi2"], found["defective_pixels"], found["frames_used"]
    good = f"{pixels['sound_mapped']} good ones"
    note = (
        f"Changes since the calibration on the ground, after {used} frames. χ² of all parameters "
        f"{chi2['value']:.1f} (95 % bounds {chi2['bounds95'][0]:.1f} to {chi2['bounds95'][1]:.1f}). Of "
        f"{pixels['certain']} defective pixels {pixels['certain_mapped']} are mapped, and {good}."
    )
    return Table(("parameter", "estimate", "σ", "truth", "error / σ", "time constant"), tuple(rows), note=note)


def _unsolved(summary: dict[str, Any], columns: dict[str, NDArray[Any]]) -> Table:
    """Frames that are unsolved or wrong, up to `_MOST_UNSOLVED`."""
    found = np.flatnonzero((columns["status"] != "solved") | columns["wrong"])[:_MOST_UNSOLVED]
    count = summary["frames"] - summary["solved"] + summary["wrong"]
    return Table(
        ("frame", "time", "status", "reason"),
        tuple(
            (
                str(columns["index"][i]),
                f"{columns['elapsed_s'][i]:g} s",
                str(columns["status"][i]),
                str(columns["reason"][i]),
            )
            for i in found
        ),
        (2, 3),
        f"The first {_MOST_UNSOLVED} of {count}; all are in sequence.parquet." if count > _MOST_UNSOLVED else "",
    )
