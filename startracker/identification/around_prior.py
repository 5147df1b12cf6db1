"""Identification within a prior attitude and, unless its result is beyond doubt, over the whole sky."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from startracker.catalog.guide import GuideDatabase
from startracker.identification.acceptance import WITHIN_PRIOR_BEYOND, passes_confirmation_threshold
from startracker.identification.observed import Identification, Observed, Prior
from startracker.settings import IdentificationSettings
from startracker.solution import Status

Identifier = Callable[[Observed, GuideDatabase, IdentificationSettings, Prior | None], Identification]

_DOUBTFUL = (Status.SOLVED, Status.NO_MATCH, Status.AMBIGUOUS, Status.SEARCH_LIMIT)
"""Results after which the sky outside the prior is searched too, unless they are beyond doubt."""


def identify_around(
    identify: Identifier,
    observed: Observed,
    guide: GuideDatabase,
    settings: IdentificationSettings,
    prior: Prior | None,
) -> tuple[Identification, bool]:
    """Identification with the stronger evidence, and whether it contradicts the prior."""
    found = identify(observed, guide, settings, prior)
    if (
        prior is None
        or found.status not in _DOUBTFUL
        or passes_confirmation_threshold(found, settings, WITHIN_PRIOR_BEYOND)
    ):
        return found, False
    elsewhere = identify(observed, guide, settings, None)
    operations = found.operations + elsewhere.operations
    better = found.status is not Status.SOLVED or elsewhere.log_false_alarm < found.log_false_alarm
    if elsewhere.status is Status.SOLVED and better:
        # If a pair is common to both results the attitude is the same, and the prior is not contradicted.
        matched = set(map(tuple, elsewhere.pairs.tolist()))
        same = found.status is Status.SOLVED and not matched.isdisjoint(map(tuple, found.pairs.tolist()))
        found = elsewhere if same else _beside_prior(elsewhere)
        return replace(found, operations=operations), not same
    return replace(found, operations=operations), False


def _beside_prior(found: Identification) -> Identification:
    reason = f"{found.reason}; found in the search of the whole sky, outside the prior"
    return replace(found, reason=reason)
