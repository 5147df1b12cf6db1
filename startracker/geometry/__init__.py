"""Attitude, camera and lens: rotations between frames, pixel ↔ unit vector, linear algebra of a few unknowns."""
