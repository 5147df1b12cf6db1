"""Star identification: which observed star is which guide star.

Every method has the signature ``method(observed, guide, settings, prior) -> Identification`` (`observed`). A method
proposes attitudes. All methods share their verification against every star of the field (`verification`), the evidence
(`bayes_factor`, `clustering_null`), and the acceptance (`acceptance`).

==================  ==================================================================================================
adaptive            first triangles (`triangles`), then votes (`pole_votes`, planned by `search_plan`); candidates are
                    confirmed by other stars (`other_stars`) and verified (`candidate_search`)
match_groups        with the kernels in `match_kernels`
pyramid             with the k-vector in `pairs`
pattern_hash        with the kernels in `pattern_kernels` and the table in `pattern_table`
triads              `triad_tables`, `triad_search`, `triad_votes`, for each `arithmetic`
unknown scale       `free_scale` and `last_fit`, over the patterns of `quads`; see `startracker.blind`
known attitude      `startracker.estimation.association` of centroids and guide stars
==================  ==================================================================================================
"""

from __future__ import annotations

from collections.abc import Callable

from startracker.catalog.guide import GuideDatabase
from startracker.identification.adaptive import adaptive
from startracker.identification.match_groups import match_groups
from startracker.identification.observed import Identification, Observed, Prior
from startracker.identification.pattern_hash import pattern_hash
from startracker.identification.pyramid import pyramid
from startracker.identification.triads import triads
from startracker.settings import IdentificationSettings

Identifier = Callable[[Observed, GuideDatabase, IdentificationSettings, Prior | None], Identification]

METHODS: dict[str, Identifier] = {
    "adaptive": adaptive,
    "match_groups": match_groups,
    "pyramid": pyramid,
    "pattern_hash": pattern_hash,
    "triads": triads,
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
]


def __dir__() -> list[str]:
    return sorted(__all__)
