"""Self-contained HTML pages from the templates of the studies, and their common parts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from simulator.study.specification.verdicts import MET, NOT_MET, UNDECIDED, Judgement
from simulator.study.style import Panel, inline_svg, style_variables

_FOLDER = Path(__file__).parent

TONES = {MET: "good", NOT_MET: "bad", UNDECIDED: "open"}
"""Style of each verdict."""

DIGEST_DIGITS = 12
"""Number of hexadecimal digits of a digest that pages show."""


@dataclass(frozen=True)
class Table:
    """Headings and rows of text; columns in `words` are text, aligned to the left."""

    headings: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    words: tuple[int, ...] = ()
    note: str = ""


def verdict_table(judgement: Judgement) -> Table:
    """Requirements with their values and verdicts."""
    rows = [
        (
            verdict.requirement.title,
            verdict.value_text,
            verdict.interval_text or "–",
            verdict.limit_text,
            f"{verdict.margin:.3g} ×" if verdict.margin else "–",
            verdict.verdict,
        )
        for verdict in judgement.verdicts
    ]
    needed = max((verdict.needed for verdict in judgement.verdicts), default=0)
    return Table(
        ("requirement", judgement.basis, "95 % interval", "specified", "margin", "verdict"),
        tuple(rows),
        note="A requirement is met if the whole interval is within its limit, and not met if all of it is outside; "
        f"otherwise more {judgement.unit} are needed. A limit shown as – is beyond the largest error: upper limits "
        f"need {needed} {judgement.unit}.",
    )


def drawn(panel: Panel, key: str, anchor: str = "") -> dict[str, Any]:
    """A panel for the macro ``figure`` of the templates: SVG with the prefix `key` of its ids, and its anchor."""
    from markupsafe import Markup

    phone = Markup(inline_svg(panel, f"{key}n", narrow=True)) if panel.wide else ""
    return {"panel": panel, "svg": Markup(inline_svg(panel, key)), "phone": phone, "anchor": anchor}


def provenance(results: Mapping[str, Any], digest: str) -> str:
    """Origin of results: scenario and its digest, seed, version and date.

    Parameters
    ----------
    results : mapping
        With ``name``, ``seed``, ``version`` and, in results of this version, ``finished_utc``.
    digest : str
        SHA-256 of the scenario, in hexadecimal.
    """
    parts = [f"Scenario {results['name']}, digest {digest[:DIGEST_DIGITS]}", f"seed {results['seed']}"]
    parts.append(f"boresight {results['version']}")
    if finished := results.get("finished_utc"):
        parts.append(f"{finished[:16].replace('T', ' ')} UTC")
    return ", ".join(parts)


def render_page(template: str, **values: Any) -> str:
    """Rendered template, given by its path from this folder; undefined values are errors."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(_FOLDER),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(colours=style_variables(), **values)
