"""What a solve did, stage by stage: found, tried, rejected."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Step"]


@dataclass(frozen=True)
class Step:
    """One finding.

    Parameters
    ----------
    stage : str
        Stage it belongs to: image, background, detection, centroids, identification, attitude, hint.
    text : str
        The finding in words, with its numbers and units.
    """

    stage: str
    text: str
