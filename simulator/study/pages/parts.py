"""Contents that the pages of several studies share."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from simulator.study.pages.page import Table
from simulator.study.specification.verdicts import Judgement

DIGEST_DIGITS = 12
"""Number of hexadecimal digits of a digest that pages show."""


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


def provenance(results: Mapping[str, Any], digest: str) -> str:
    """Origin of results: scenario and its digest, seed, version and date.

    Parameters
    ----------
    results : mapping
        With ``name``, ``seed``, ``version`` and, in results of this version, ``finished_utc`` and ``catalogs``.
    digest : str
        SHA-256 of the scenario, in hexadecimal.
    """
    parts = [f"Scenario {results['name']}, digest {digest[:DIGEST_DIGITS]}", f"seed {results['seed']}"]
    parts.append(f"boresight {results['version']}")
    if finished := results.get("finished_utc"):
        parts.append(f"{finished[:16].replace('T', ' ')} UTC")
    for use, source in results.get("catalogs", {}).items():
        digests = ", ".join(file["sha256"][:DIGEST_DIGITS] for file in source["files"])
        parts.append(f"stars of the {use}: {source['name']} ({source['stars']:,} stars, digests {digests})")
    return ", ".join(parts)


def unphysical_notes(reasons: Iterable[str]) -> list[str]:
    """Notes on values that a scenario permits although no camera has them."""
    return [f"Unphysical value permitted by the scenario: {reason}" for reason in reasons]
