"""Write data/fisheye_opencv.json: points through OpenCV's own fisheye model.

Run it where OpenCV is installed (``pip install '.[oracles]'``): ``python tests/oracle/build_fisheye_opencv.py``.
"""

import json
from datetime import date
from pathlib import Path

import cv2
import numpy as np

OUTPUT = Path(__file__).parent / "data" / "fisheye_opencv.json"

# fx, fy, cx, cy, (k1, k2, k3, k4), largest angle off the axis in degrees
CAMERAS = {
    "equidistant": (325.9, 325.9, 511.5, 511.5, (0.0, 0.0, 0.0, 0.0), 89.0),
    "barrel": (640.0, 638.5, 960.2, 539.1, (-0.045, 0.012, -0.004, 0.0006), 85.0),
    "stretched": (285.7, 285.7, 423.9, 399.2, (0.021, 0.0087, -0.0059, 0.0008), 88.0),
    "narrow": (4000.0, 4010.0, 2000.0, 1500.0, (0.1, -0.05, 0.02, -0.004), 30.0),
}


def build() -> dict:
    """Versions and, for each camera, vectors in the camera frame and their pixels."""
    rng = np.random.default_rng(20061335)
    cameras = {}
    for name, (fx, fy, cx, cy, coefficients, edge_deg) in CAMERAS.items():
        theta = np.radians(np.concatenate([rng.uniform(0.0, edge_deg, 24), [1e-7, 0.01, edge_deg, edge_deg]]))
        turn = rng.uniform(0.0, 2.0 * np.pi, len(theta))
        length = rng.uniform(0.5, 3.0, (len(theta), 1))
        unit = np.stack([np.sin(theta) * np.cos(turn), np.sin(theta) * np.sin(turn), np.cos(theta)], axis=1)
        vectors = unit * length
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dtype=float)
        pixels, _ = cv2.fisheye.projectPoints(
            vectors[:, None, :], np.zeros(3), np.zeros(3), matrix, np.array(coefficients, dtype=float)
        )
        cameras[name] = {
            "fx": fx,
            "fy": fy,
            "cx": cx,
            "cy": cy,
            "k1_k2_k3_k4": list(coefficients),
            "vectors": vectors.tolist(),
            "pixels": pixels.reshape(-1, 2).tolist(),
        }
    return {
        "source": f"OpenCV {cv2.__version__}, fisheye.projectPoints",
        "built": date.today().isoformat(),
        "cameras": cameras,
    }


if __name__ == "__main__":
    OUTPUT.parent.mkdir(exist_ok=True)
    OUTPUT.write_text(json.dumps(build(), indent=1) + "\n", encoding="utf-8")
