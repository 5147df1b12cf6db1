"""Write data/distortion_opencv.json: points through OpenCV's own camera model.

Run it where OpenCV is installed (``pip install '.[oracles]'``): ``python tests/oracle/build_distortion_opencv.py``.
"""

import json
from datetime import date
from pathlib import Path

import cv2
import numpy as np

OUTPUT = Path(__file__).parent / "data" / "distortion_opencv.json"

# fx, fy, cx, cy, (k1, k2, p1, p2, k3, k4, k5, k6), half width of the field in normalised coordinates
CAMERAS = {
    "barrel": (9090.9, 9090.9, 511.5, 511.5, (-0.02, 0, 0, 0, 0, 0, 0, 0), 0.08),
    "pincushion": (1200.0, 1180.0, 640.2, 355.9, (0.12, -0.05, 0, 0, 0.01, 0, 0, 0), 0.55),
    "wide": (800.0, 800.0, 960.0, 540.0, (-0.28, 0.09, 0, 0, -0.012, 0, 0, 0), 0.8),
    "tangential": (1500.0, 1289.0, 96.0, 82.0, (-0.1, 0.02, 0.003, -0.002, 0, 0, 0, 0), 0.3),
    "rational": (1000.0, 1010.0, 500.0, 400.0, (0.4, -0.1, 1e-3, 5e-4, 0.02, 0.7, -0.05, 0.01), 0.7),
}


def build() -> dict:
    """Versions and, for each camera, vectors in the camera frame and their pixels."""
    rng = np.random.default_rng(19710855)
    cameras = {}
    for name, (fx, fy, cx, cy, coefficients, half) in CAMERAS.items():
        plane = np.concatenate([rng.uniform(-half, half, (16, 2)), half * np.array([[1, 1], [-1, 1], [0, -1], [0, 0]])])
        depth = rng.uniform(0.5, 3.0, (len(plane), 1))
        vectors = np.concatenate([plane * depth, depth], axis=1)
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dtype=float)
        pixels, _ = cv2.projectPoints(vectors, np.zeros(3), np.zeros(3), matrix, np.array(coefficients, dtype=float))
        cameras[name] = {
            "fx": fx,
            "fy": fy,
            "cx": cx,
            "cy": cy,
            "k1_k2_p1_p2_k3_k4_k5_k6": list(coefficients),
            "vectors": vectors.tolist(),
            "pixels": pixels.reshape(-1, 2).tolist(),
        }
    return {"source": f"OpenCV {cv2.__version__}, projectPoints", "built": date.today().isoformat(), "cameras": cameras}


if __name__ == "__main__":
    OUTPUT.parent.mkdir(exist_ok=True)
    OUTPUT.write_text(json.dumps(build(), indent=1) + "\n", encoding="utf-8")
