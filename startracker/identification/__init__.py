"""Star identification: which observed star is which guide star.

Every method has the signature ``method(observed, guide, settings, prior) -> Identification``.
"""

from __future__ import annotations

from collections.abc import Callable

from startracker.catalog.guide import GuideDatabase
from startracker.identification.match_groups import match_groups
from startracker.identification.observed import Identification, Observed, Prior
from startracker.settings import IdentificationSettings

Identifier = Callable[[Observed, GuideDatabase, IdentificationSettings, Prior | None], Identification]

METHODS: dict[str, Identifier] = {"match_groups": match_groups}

__all__ = ["METHODS", "Identification", "Identifier", "Observed", "Prior", "match_groups"]
