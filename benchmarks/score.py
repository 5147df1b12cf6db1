"""Score solutions against the truth: correct or wrong, accuracy and time."""

from __future__ import annotations

import math
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from benchmarks import oracle
from benchmarks.scenes import Case, Scene, SceneMaker
from benchmarks.solvers import Answer, Solver, build

FloatArray = NDArray[np.float64]

IDENTIFIED, WRONG, AMBIGUOUS, NO_MATCH, TOO_FEW = "identified", "wrong", "ambiguous", "no_match", "too_few_stars"
RAISED = "raised"
"""An internal exception, which is always a bug."""
OUTCOMES = (IDENTIFIED, WRONG, AMBIGUOUS, NO_MATCH, TOO_FEW, RAISED)
WRONG_CROSS_PX = 5.0
WRONG_ROLL_DEG = 1.0
WRONG_SIGMAS = 10.0
ENOUGH = 4
"""With fewer true stars than this an attitude cannot be distinguished from chance."""
WARM_UP = 20
_CHUNK = 50

ROW = np.dtype(
    [
        ("index", np.int64),
        ("outcome", "U16"),
        ("true_stars", np.int32),
        ("matched", np.int32),
        ("cpu_ms", np.float64),
        ("identification_ms", np.float64),
        ("operations", np.int64),
        # rotation vector of the error, rad, camera axes: of the solver, of Wahba's problem with the true pairs, ...
        ("error", np.float64, 3),
        ("oracle", np.float64, 3),
        # ... and the Cramér–Rao bounds, cross-boresight and roll, without and with the focal length fitted
        ("bound", np.float64, 2),
        ("bound_focal", np.float64, 2),
    ]
)


def wrong_limits_rad(bound: tuple[float, float], pixel_rad: float) -> tuple[float, float]:
    """Errors above which an accepted attitude is wrong, rad: cross-boresight and about the boresight.

    Five pixels and one degree, or ten times the Cramér–Rao bound if that is larger: a few stars in a corner determine
    the roll poorly, which is not a misidentification. With fewer than two true stars no attitude is correct.
    """
    if not all(map(math.isfinite, bound)):
        return 0.0, 0.0
    return (
        max(WRONG_CROSS_PX * pixel_rad, WRONG_SIGMAS * bound[0]),
        max(math.radians(WRONG_ROLL_DEG), WRONG_SIGMAS * bound[1]),
    )


def judge(maker: SceneMaker, scene: Scene, answer: Answer, index: int) -> np.void:
    """Row of one solution."""
    row = np.zeros(1, ROW)[0]
    row["index"], row["true_stars"], row["matched"] = index, scene.true_stars, answer.matched
    row["cpu_ms"], row["identification_ms"] = answer.cpu_ms, answer.identification_ms
    row["operations"] = answer.operations
    for name in ("error", "oracle", "bound", "bound_focal"):
        row[name] = np.nan
    bound = (math.inf, math.inf)
    xy, reference = maker.true_vectors(scene)
    if len(xy) >= 2:
        centred = np.column_stack([xy - (maker.camera.cx, maker.camera.cy), np.full(len(xy), scene.focal_px)])
        observed = centred / np.linalg.norm(centred, axis=1, keepdims=True)
        row["oracle"] = oracle.rotation_error(scene.matrix, oracle.wahba(observed, reference))
        sigma = maker.case.noise_px
        bound = oracle.bound(observed, scene.focal_px, sigma)
        row["bound"] = bound
        row["bound_focal"] = oracle.bound(observed, scene.focal_px, sigma, fit_focal=True)
    if answer.matrix is None:
        row["outcome"] = answer.status if answer.status in OUTCOMES else NO_MATCH
        return row
    error = oracle.rotation_error(scene.matrix, answer.matrix)
    row["error"] = error
    cross, roll = wrong_limits_rad(bound, maker.camera.pixel_rad)
    right = math.hypot(error[0], error[1]) <= cross and abs(error[2]) <= roll and maker.case.sky
    row["outcome"] = IDENTIFIED if right else WRONG
    return row


@lru_cache(maxsize=4)
def _ready(name: str, case: Case, seed: int) -> tuple[SceneMaker, Solver]:
    """Scenes and solver of a case, created and warmed up once per process with scenes that are not part of the run."""
    maker, solver = SceneMaker(case, seed), build(name, case)
    warm = SceneMaker(case, seed + 1_000_000)
    for index in range(WARM_UP):
        solver.answer(warm.scene(index))
    return maker, solver


def run_chunk(name: str, case: Case, seed: int, indices: range) -> NDArray[np.void]:
    """Rows of some scenes of a case."""
    maker, solver = _ready(name, case, seed)
    rows = []
    for index in indices:
        scene = maker.scene(index)
        rows.append(judge(maker, scene, solver.answer(scene), index))
    return np.array(rows, ROW)


def run_case(
    name: str, case: Case, n: int, seed: int, pool: ProcessPoolExecutor | None, start: int = 0
) -> NDArray[np.void]:
    """Rows of the scenes `start` to `start` + n − 1, in order, independent of the number of processes."""
    chunks = [range(k, min(k + _CHUNK, start + n)) for k in range(start, start + n, _CHUNK)]
    work = partial(run_chunk, name, case, seed)
    done: Iterable[NDArray[np.void]] = map(work, chunks) if pool is None else pool.map(work, chunks)
    return np.concatenate(list(done))


def accuracy(rows: NDArray[np.void]) -> dict[str, FloatArray]:
    """Rms errors (cross-boresight two-axis, roll), rad, over the identified scenes, of solver and reference.

    ``bound`` and ``bound_focal`` are the rms of the Cramér–Rao bounds of the same scenes. Scenes whose bound exceeds
    ten times the median are excluded: one of them would dominate the rms of thousands.
    """
    loose = rows["bound_focal"][:, 1] > 10.0 * np.nanmedian(rows["bound_focal"][:, 1])
    loose |= rows["bound_focal"][:, 0] > 10.0 * np.nanmedian(rows["bound_focal"][:, 0])
    good = rows[(rows["outcome"] == IDENTIFIED) & ~loose & (rows["true_stars"] >= ENOUGH)]

    def rms(errors: FloatArray) -> FloatArray:
        squares = np.mean(errors**2, axis=0)
        return np.sqrt([squares[0] + squares[1], squares[2]])

    def of_bounds(bounds: FloatArray) -> FloatArray:
        return np.sqrt(np.mean(bounds**2, axis=0))

    return {
        "solver": rms(good["error"]),
        "oracle": rms(good["oracle"]),
        "bound": of_bounds(good["bound"]),
        "bound_focal": of_bounds(good["bound_focal"]),
    }
