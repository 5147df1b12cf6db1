"""The star tracker of a scenario's ``tracker`` section."""

from __future__ import annotations

from functools import lru_cache

from simulator.randomness import stream
from simulator.scenario import Scenario
from simulator.sky.catalogue_errors import CatalogueErrors, with_errors
from startracker.catalog import load_catalog
from startracker.catalog.stars import StarCatalog
from startracker.geometry.camera import Camera
from startracker.tracker import StarTracker


def build_tracker(scenario: Scenario, camera: Camera) -> StarTracker:
    """Star tracker of a scenario's ``tracker`` section for a camera."""
    section = scenario.tracker
    catalog: str | StarCatalog = section.catalog
    if section.catalogue_errors != CatalogueErrors():
        catalog = _erroneous(load_catalog(section.catalog), section.catalogue_errors, scenario.seed)
    with scenario.located("tracker"):
        return StarTracker(
            camera,
            catalog=catalog,
            magnitude_limit=section.magnitude_limit,
            detector=section.detector,
            centroider=section.centroider,
            identifier=section.identifier,
            estimator=section.estimator,
            detection=section.detection,
            centroid=section.centroid,
            identification=section.identification,
        )


@lru_cache(maxsize=2)
def _erroneous(catalog: StarCatalog, errors: CatalogueErrors, seed: int) -> StarCatalog:
    """Catalogue with the errors of a seed; the same object again, for which guide stars are selected once."""
    return with_errors(catalog, errors, stream(seed, "catalogue errors"))
