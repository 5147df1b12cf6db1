"""Star identification: which observed star is which guide star.

Every method has the signature ``method(observed, guide, settings, prior) -> Identification``.
"""

from __future__ import annotations

from collections.abc import Callable

from startracker.catalog.guide import GuideDatabase
from startracker.identification.adaptive import adaptive
from startracker.identification.match_groups import match_groups
from startracker.identification.observed import Identification, Observed, Prior
from startracker.identification.pattern_hash import pattern_hash
from startracker.identification.pyramid import pyramid
from startracker.identification.triads import triads, triads_integer
from startracker.settings import IdentificationSettings

Identifier = Callable[[Observed, GuideDatabase, IdentificationSettings, Prior | None], Identification]

METHODS: dict[str, Identifier] = {
    "adaptive": adaptive,
    "match_groups": match_groups,
    "pyramid": pyramid,
    "pattern_hash": pattern_hash,
    "triads": triads,
    "triads_integer": triads_integer,
}

__all__ = [
    "METHODS",
    "Identification",
    "Identifier",
    "Observed",
    "Prior",
    "adaptive",
    "match_groups",
    "pattern_hash",
    "pyramid",
    "triads",
    "triads_integer",
]


def __dir__() -> list[str]:
    return sorted(__all__)
