"""Write data/calibration_opencv.json: noisy star images of three attitudes, and the cameras that OpenCV makes of them.

Run it where OpenCV is installed (``pip install '.[oracles]'``): ``python tests/oracle/build_calibration_opencv.py``.

``least_squares``: SciPy's Levenberg–Marquardt over ``cv2.projectPoints`` with the translation at zero, as stars have
none, and numerical derivatives. ``calibrate_camera``: ``cv2.calibrateCamera`` of points without noise; it always fits
translations, which these then leave at zero where the field is wide (in a narrow one they are all but a change of the
focal length).
"""

import json
from datetime import date
from pathlib import Path

import cv2
import numpy as np
import scipy
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

OUTPUT = Path(__file__).parent / "data" / "calibration_opencv.json"
SIZE = (1600, 1200)
TRUTH = {
    "narrow": (7900.0, 7915.0, 810.0, 590.0, 0.3, 0.0, 1e-3, -5e-4),
    "wide": (1400.0, 1402.0, 790.0, 610.0, -0.25, 0.08, 1e-3, 5e-4),
}
STARS, IMAGES, NOISE_PX = 60, 3, 0.2


def project(directions: np.ndarray, turn: np.ndarray, lens: np.ndarray) -> np.ndarray:
    fx, fy, cx, cy, *coefficients = lens
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    points, _ = cv2.projectPoints(directions, turn, np.zeros(3), matrix, np.array(coefficients))
    return points.reshape(-1, 2)


def solve(directions: list, xy: list, turns: list, lens: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Parameters (8 and 3 an image) and their covariance, errors of NOISE_PX."""
    scale = np.array([1e3, 1e3, 1e2, 1e2, 0.1, 0.1, 1e-2, 1e-2] + [1e-2] * (3 * len(xy)))

    def off(values: np.ndarray) -> np.ndarray:
        values = values * scale
        return np.concatenate(
            [
                (project(d, values[8 + 3 * i : 11 + 3 * i], values[:8]) - p).ravel() / NOISE_PX
                for i, (d, p) in enumerate(zip(directions, xy, strict=True))
            ]
        )

    start = np.concatenate([lens, *turns]) / scale
    found = least_squares(off, start, jac="3-point", method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    return found.x * scale, np.linalg.inv(found.jac.T @ found.jac) * np.outer(scale, scale)


def build() -> dict:
    """Versions, stars, measured pixels and fitted cameras."""
    cameras = {}
    for number, (name, truth) in enumerate(TRUTH.items()):
        rng = np.random.default_rng([1971, number])
        lens = np.array(truth)
        directions, turns, exact, measured = [], [], [], []
        for _ in range(IMAGES):
            rotation = Rotation.random(random_state=rng)
            plane = rng.uniform(-0.48, 0.48, (STARS, 2)) * np.array(SIZE) / lens[0]
            seen = np.column_stack([plane, np.ones(STARS)])
            seen /= np.linalg.norm(seen, axis=1, keepdims=True)
            directions.append(rotation.inv().apply(seen))
            turns.append(rotation.as_rotvec())
            exact.append(project(directions[-1], turns[-1], lens))
            measured.append(exact[-1] + rng.normal(0, NOISE_PX, (STARS, 2)))
        values, covariance = solve(directions, measured, turns, lens)
        guess = np.array([[lens[0] * 1.005, 0, 799.5], [0, lens[0] * 1.005, 599.5], [0, 0, 1.0]])
        flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3
        criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 500, 1e-15)
        rms, matrix, coefficients, *_ = cv2.calibrateCamera(
            [d.astype(np.float32) for d in directions],
            [p.astype(np.float32).reshape(-1, 1, 2) for p in exact],
            SIZE,
            guess,
            np.zeros(5),
            flags=flags,
            criteria=criteria,
        )
        k1, k2, p1, p2 = coefficients.ravel()[:4]
        cameras[name] = {
            "truth": list(truth),
            "directions": np.round(directions, 14).tolist(),
            "turns": np.round(turns, 14).tolist(),
            "exact": np.round(exact, 9).tolist(),
            "measured": np.round(measured, 9).tolist(),
            "least_squares": values[:8].tolist(),
            "least_squares_sigma": np.sqrt(np.diag(covariance))[:8].tolist(),
            "calibrate_camera": [float(v) for v in (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2])]
            + [float(k1), float(k2), float(p1), float(p2)],
            "calibrate_camera_rms_px": float(rms),
        }
    return {
        "source": f"OpenCV {cv2.__version__}, SciPy {scipy.__version__}",
        "built": date.today().isoformat(),
        "order": ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"],
        "noise_px": NOISE_PX,
        "cameras": cameras,
    }


if __name__ == "__main__":
    OUTPUT.parent.mkdir(exist_ok=True)
    OUTPUT.write_text(json.dumps(build()) + "\n", encoding="utf-8")
